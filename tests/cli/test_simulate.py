"""`beamseg simulate`: worlds, flights and sensors by their names and files."""

from __future__ import annotations

import json
import re
import sqlite3

import pytest

from beamseg_batch.recording import open_recording
from beamseg_batch.simulation.recorder import Recorder
from beamseg_batch.world import world_names

WORLD = """\
members:
  - {name: rail, ends: [[0, -0.5, 1.2], [0, 0.5, 1.2]], radius: 0.05}
flight:
  kind: orbit
  centre: [0, 0, 1.2]
  radius: 0.9
  speed: 1.5
"""
WAYPOINTS = "x,y,z,yaw,duration\n1,0,1,3.14,2\n"
FAST = ("--set", "camera.width=24", "--set", "camera.height=24")


@pytest.fixture
def world(here):
    path = here / "world.yaml"
    path.write_text(WORLD, encoding="utf-8")
    return path


@pytest.fixture
def waypoints(here):
    path = here / "wp.csv"
    path.write_text(WAYPOINTS, encoding="utf-8")
    return path


def scene_json(here):
    return json.loads((here / "sim" / "truth" / "scene.json").read_text())


def test_simulate__writes_a_flight_and_sums_it_up(ok, world, here):
    result = ok("simulate", world, "-o", "sim/f.mcap", *FAST)
    recording, truth, clearance, following = result.stdout.splitlines()
    assert "18 scans, 472 poses, 3.8 s" in recording
    assert "1 of 1 members seen, 0 joints" in truth
    assert clearance.startswith("clearance  0.4")
    assert "member 'rail'" in clearance
    assert following.split() == ["next", "beamseg", "run", "sim/f.mcap"]
    assert result.stderr == ""
    assert sorted(path.name for path in (here / "sim").rglob("*")) == [
        "f.mcap", "scene.json", "true_poses.tum", "truth", "truth.csv", "truth_joints.csv",
    ]  # fmt: skip


def test_simulate__quiet(ok, world):
    result = ok("simulate", world, "-o", "sim/f.mcap", "-q", *FAST)
    assert (result.stdout, result.stderr) == ("", "")


def test_simulate__verbose(ok, world):
    result = ok("simulate", world, "-o", "sim/f.mcap", "-v", *FAST)
    assert "24 x 24 pixels, 2.04 rad, 5 clouds and 125 poses a second" in result.stderr


def test_simulate__is_run(ok, world, here):
    ok("simulate", world, "-o", "sim/f.mcap")
    ok("run", "sim/f.mcap", "-o", "out", "-q")
    assert len((here / "out" / "segments.csv").read_text().splitlines()) == 2


def test_simulate__shipped_world(ok, here):
    ok("simulate", "arena", "-o", "sim/f.bag", "--duration", "1", *FAST)
    assert scene_json(here)["members"] == 7


def test_simulate__waypoints(ok, world, waypoints, here):
    ok("simulate", world, "-o", "sim/f.mcap", "--waypoints", waypoints, *FAST)
    scene = scene_json(here)
    assert scene["flight"]["kind"] == "waypoints"
    assert scene["seconds"] == 2.0


def test_simulate__trajectory(ok, world, here):
    (here / "eight.yaml").write_text(
        "kind: figure_eight\ncentre: [1, 0, 1.2]\nyaw_deg: 180\nwidth: 1\nheight: 0.4\n"
    )
    ok("simulate", world, "-o", "sim/f.mcap", "--trajectory", "eight.yaml", *FAST)
    assert scene_json(here)["flight"]["kind"] == "figure_eight"


def test_simulate__options_reach_the_sensor(ok, world, here):
    options = ("--noise", "0.02", "--drift", "0.001,0.0005", "--extrinsic", "0.1,0,0,0,5,0")
    result = ok(
        "simulate", world, "-o", "sim/f.mcap", *options, "--extrinsic-in", "none", "--seed", 7,
        "--set", "camera.dropout=0.1", *FAST,
    )  # fmt: skip
    scene = scene_json(here)
    sensor = scene["sensor"]
    assert scene["seed"] == 7
    assert (sensor["camera"]["noise"], sensor["camera"]["dropout"]) == (0.02, 0.1)
    assert (sensor["poses"]["walk_position"], sensor["poses"]["walk_attitude"]) == (0.001, 0.0005)
    assert sensor["extrinsic"]["rotation_rpy_deg"] == [0, 5, 0]
    assert result.stdout.endswith("beamseg run sim/f.mcap --extrinsic 0.1,0,0,0,5,0\n")


def test_simulate__sensor_of_the_world(ok, world, here):
    (here / "worlds").mkdir()
    (here / "worlds" / "cam.yaml").write_text(
        "camera: {width: 20, height: 10, horizontal_fov: 1.5}\n"
    )
    (here / "worlds" / "world.yaml").write_text(WORLD + "sensor: cam.yaml\n")
    ok("simulate", "worlds/world.yaml", "-o", "sim/f.mcap")
    assert scene_json(here)["sensor"]["camera"]["width"] == 20
    ok("simulate", "worlds/world.yaml", "-o", "sim/f.mcap", "--overwrite", "--sensor", "voxl_tof",
       "--duration", "0.5", *FAST)  # fmt: skip
    assert scene_json(here)["sensor"]["camera"]["footprint"] == 3


@pytest.mark.parametrize(
    ("arguments", "container"),
    [
        (["-o", "sim/f.bag", "--compression", "lz4"], "ROS 1 bag"),
        (["-o", "sim/f.db3"], "ROS 2 bag file (sqlite3)"),
        (["-o", "sim/f"], "ROS 2 bag folder (sqlite3)"),
        (["-o", "sim/f", "--format", "ros2-mcap"], "ROS 2 bag folder (mcap)"),
        (["-o", "sim/f.mcap", "--format", "mcap-ros1"], "MCAP (ROS 1)"),
    ],
)
def test_simulate__formats(ok, world, arguments, container):
    ok("simulate", world, *arguments, "--duration", "1", *FAST)
    assert open_recording(arguments[1]).container == container


def test_simulate__warns_of_a_collision(ok, world, waypoints):
    (world.parent / "wp.csv").write_text("x,y,z,yaw,duration\n1,0,1.2,0,1\n-1,0,1.2,0,4\n")
    result = ok("simulate", world, "-o", "sim/f.mcap", "--waypoints", waypoints, *FAST)
    assert "warning: the drone flies through member 'rail' at" in result.stderr
    (world.parent / "wp.csv").write_text("x,y,z,yaw,duration\n1,0,1.36,0,1\n-1,0,1.36,0,4\n")
    result = ok(
        "simulate", world, "-o", "sim/f.mcap", "--overwrite", "--waypoints", waypoints, *FAST
    )
    assert "warning: the drone comes within 0.1" in result.stderr


def test_simulate__notes_of_the_world(ok, here):
    (here / "w.wbt").write_text(
        "#VRML_SIM R2023b utf8\nHovercraft {\n}\nSolid {\n  translation 0 0 1\n  children [\n"
        "    Shape { geometry Cylinder { height 1 radius 0.05 } }\n  ]\n}\n"
    )
    (here / "wp.csv").write_text(WAYPOINTS)
    result = ok("simulate", "w.wbt", "-o", "sim/f.mcap", "--waypoints", "wp.csv", *FAST)
    assert "Hovercraft" in result.stderr


def test_simulate__existing_flight(ok, refused, world, here):
    ok("simulate", world, "-o", "sim/f.mcap", "--duration", "1", *FAST)
    before = (here / "sim" / "f.mcap").read_bytes()
    line = refused(2, "simulate", world, "-o", "sim/f.mcap", "--seed", "1", *FAST)
    assert line.startswith("sim/f.mcap exists already; use --overwrite")
    assert (here / "sim" / "f.mcap").read_bytes() == before
    ok("simulate", world, "-o", "sim/f.mcap", "--overwrite", "--duration", "1", "--seed", 1, *FAST)
    assert (here / "sim" / "f.mcap").read_bytes() != before


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["world.yaml", "-o", "f.txt"], "f.txt: the ending '.txt' tells no format"),
        (["aren", "-o", "f.mcap"], "did you mean 'arena'"),
        (["world.yaml", "-o", "f.mcap", "--waypoints", "no.csv"], "no.csv: cannot be read"),
        (["world.yaml", "-o", "f.mcap", "--waypoints", "bad.csv"], "bad.csv:1: has no column yaw"),
        (["world.yaml", "-o", "f.mcap", "--sensor", "voxl"], "unknown sensor 'voxl'"),
        (["world.yaml", "-o", "f.mcap", "--duration", "-1"], "--duration must be above 0, not -1"),
        (["world.yaml", "-o", "f.mcap", "--noise", "-1"], "camera.noise=-1.0: "),
        (
            ["world.yaml", "-o", "f.mcap", "--drift", "much"],
            "--drift 'much': write metres",
        ),
        (["world.yaml", "-o", "f.mcap", "--extrinsic", "1,2"], "write 3 or 6 numbers"),
        (["world.yaml", "-o", "f.mcap", "--duration", "0.01"], "is too short for a scan"),
        (["bad.yaml", "-o", "f.mcap"], "bad.yaml:6: flight.radius: must be above 0, not -1"),
    ],
)
def test_simulate__errors_are_one_line(refused, world, here, arguments, complaint):
    (here / "bad.csv").write_text("x,y,z,duration\n1,0,1,2\n")
    (here / "bad.yaml").write_text(WORLD.replace("radius: 0.9", "radius: -1"))
    before = sorted(here.iterdir())
    assert complaint in refused(2, "simulate", *arguments)
    assert sorted(here.iterdir()) == before


def test_simulate__a_line_for_each_problem(call, here):
    (here / "bad.yaml").write_text(
        "members:\n"
        "  - {name: a, ends: [[0, 0, 0], [0, 0, 1]], radius: -1}\n"
        "  - {name: b, ends: [[0, 0, 0], [0, 0, 1]], shape: hex}\n"
    )
    result = call("simulate", "bad.yaml", "-o", "f.mcap")
    assert result.exit_code == 2
    first, second = result.stderr.splitlines()
    assert first == "beamseg: error: bad.yaml:2: members[0].radius: must be above 0, not -1"
    assert second.startswith("beamseg: error: bad.yaml:3: members[1].shape: must be 'round',")


def test_simulate__overwrites_no_input(refused, world):
    before = world.read_bytes()
    line = refused(2, "simulate", world, "-o", world, "--overwrite", "--format", "mcap")
    assert line.endswith("world.yaml is no recording: it stays as it is")
    assert world.read_bytes() == before


def test_simulate__interrupt_leaves_nothing(call, world, here, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(Recorder, "cloud", interrupt)
    result = call("simulate", world, "-o", "sim/f.mcap", "-q", *FAST)
    assert (result.exit_code, result.stderr) == (130, "beamseg: interrupted\n")
    assert [path.name for path in here.iterdir()] == ["world.yaml"]


@pytest.mark.parametrize("kind", ["db3", "ros2"])
def test_simulate__full_disk(refused, world, here, monkeypatch, kind):
    def full(*_):
        raise sqlite3.OperationalError("database or disk is full")

    monkeypatch.setattr(Recorder, "cloud", full)
    line = refused(2, "simulate", world, "-o", "f", "--format", kind, "-q", *FAST)
    assert line == "f: cannot be written: SQLite: database or disk is full"
    assert [path.name for path in here.iterdir()] == ["world.yaml"]


def test_simulate__world_that_says_no_flight(call, here):
    (here / "world.yaml").write_text(WORLD.partition("flight")[0])
    result = call("simulate", "world.yaml", "-o", "f.mcap")
    assert result.exit_code == 2
    assert "does not say how to fly: name a --waypoints or --trajectory file" in result.stderr


def test_simulate__two_flights(call, world, waypoints):
    result = call(
        "simulate", world, "-o", "f.mcap", "--waypoints", waypoints, "--trajectory", "t.yaml"
    )
    assert result.exit_code == 2
    assert "name one of them" in result.stderr


def test_simulate__help_names_shipped_worlds(ok):
    text = ok("simulate", "--help").stdout
    named = set(re.findall(r"beamseg simulate (\w+) ", text))
    assert named
    assert named <= set(world_names())


@pytest.mark.parametrize("command", ["simulate", "evaluate", "compare"])
def test_help__fits_a_terminal(ok, command):
    lines = ok(command, "--help").stdout.splitlines()
    assert max(map(len, lines)) <= 80
    assert "  Examples:" in lines


def test_simulate__help_teaches(ok):
    text = ok("simulate", "--help").stdout
    assert "beamseg simulate arena -o sim/flight.mcap" in text
    assert "--waypoints" in text
