"""Every bad use gets one clear line and the right exit code, and never a traceback."""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
from pathlib import Path

import pytest

from tests.recordings import KINDS, write_messages

USAGE = 2
DATA = 1


def snapshot(path: Path) -> dict[str, str]:
    """Hash all files of a folder."""
    return {
        str(file.relative_to(path)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(path.rglob("*"))
        if file.is_file()
    }


# Recordings


@pytest.mark.parametrize("command", ["run", "info"])
def test_recording__no_such_file(refused, command):
    assert refused(USAGE, command, "nix.bag") == "nix.bag: no such file or folder"


@pytest.mark.parametrize("command", ["run", "info"])
@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("notes.txt", b"hello world, not a bag"),
        ("image.bag", b"\x89PNG\r\n\x1a\n" + bytes(64)),
        ("one_byte.mcap", b"\x89"),
        ("zeros.db3", bytes(4096)),
    ],
)
def test_recording__not_a_bag(refused, here, command, name, content):
    (here / name).write_bytes(content)
    assert refused(DATA, command, name).startswith(
        f"{name}: not a ROS 1 bag, ROS 2 bag or MCAP file"
    )


@pytest.mark.parametrize("command", ["run", "info"])
def test_recording__empty_file(refused, here, command):
    (here / "e.bag").touch()
    assert refused(DATA, command, "e.bag") == "e.bag: the file is empty (0 bytes)"


@pytest.mark.parametrize("command", ["run", "info"])
def test_recording__empty_bag(refused, empty_bag, command):
    assert refused(DATA, command, empty_bag) == f"{empty_bag}: the recording holds no messages"


@pytest.mark.parametrize("kind", KINDS)
def test_recording__empty_of_every_kind(refused, tmp_path, kind):
    path = write_messages(tmp_path / "x", kind, [], [("/tof_pc", "sensor_msgs/msg/PointCloud2")])
    assert "holds no messages" in refused(DATA, "run", path)


def test_recording__no_cloud_topic(refused, flight_without_clouds):
    line = refused(DATA, "run", flight_without_clouds)
    assert line.startswith(f"{flight_without_clouds}: no cloud topic")
    assert "sensor_msgs/msg/PointCloud2" in line
    assert "/mavros/local_position/pose (geometry_msgs/msg/PoseStamped, 40 messages)" in line


def test_recording__no_pose_topic(refused, flight_without_poses):
    line = refused(DATA, "run", flight_without_poses)
    assert line.startswith(f"{flight_without_poses}: no pose topic")
    assert "/tof_pc (sensor_msgs/msg/PointCloud2, 6 messages)" in line


def test_recording__two_candidate_topics(refused, ok, flight_of_two_cameras):
    line = refused(USAGE, "run", flight_of_two_cameras)
    assert line.startswith(f"{flight_of_two_cameras}: 2 topics could hold the clouds")
    assert "/front (sensor_msgs/msg/PointCloud2, 6 messages)" in line
    assert "/rear (sensor_msgs/msg/PointCloud2, 2 messages)" in line
    assert line.endswith("choose one with --cloud-topic")
    ok("run", flight_of_two_cameras, "--cloud-topic", "/front")


@pytest.mark.parametrize("topic", ["/nix", ""])
def test_recording__named_topic_is_missing(refused, flight_of_two_cameras, topic):
    line = refused(DATA, "run", flight_of_two_cameras, "--cloud-topic", topic)
    assert f"cloud topic {topic!r} is not in the recording" in line
    assert "/front" in line
    assert "/rear" in line


def test_recording__named_topic_is_of_another_type(refused, flight):
    line = refused(DATA, "run", flight, "--pose-topic", "/tof_pc")
    assert "'/tof_pc' is of type sensor_msgs/msg/PointCloud2, which holds no poses" in line


def test_recording__no_pose_within_gap(refused, flight_with_late_poses):
    line = refused(DATA, "run", flight_with_late_poses)
    assert "none of 6 clouds is usable: 6 no_pose_within_gap" in line
    assert "nearest pose 100.000 s away, limit 0.050 s; see matching.max_gap_s" in line


def test_recording__another_clock(refused, flight):
    line = refused(DATA, "run", flight, "--set", "recording.time_offset_s=1e9")
    assert "see --time-source log or --time-offset" in line


def test_recording__all_points_outside_window(refused, flight_far_from_beams):
    line = refused(DATA, "run", flight_far_from_beams)
    assert "none of the 300 points in 6 scans lies in the window x [0.0, 1.5]" in line
    assert line.endswith("see filtering.window")


def test_recording__one_of_several_is_missing(refused, flight):
    assert refused(USAGE, "run", flight, "nix.mcap") == "nix.mcap: no such file or folder"


@pytest.mark.parametrize("name", ["/dev/null", "/dev/zero"])
def test_recording__device(refused, name):
    assert refused(DATA, "run", name) == f"{name}: not a regular file"


@pytest.mark.parametrize("command", ["run", "info"])
def test_recording__link_to_itself(refused, here, command):
    (here / "loop.bag").symlink_to("loop.bag")
    assert refused(USAGE, command, "loop.bag") == "loop.bag: no such file or folder"


def test_recording__name_with_control_characters(refused):
    line = refused(USAGE, "run", "two\nlines\x1b[2J.bag")
    assert line == "two\\nlines\\x1b[2J.bag: no such file or folder"


def test_recording__topic_name_with_control_characters(refused, flight_with_odd_topic):
    assert r"/a\x1b[2Jb" in refused(DATA, "run", flight_with_odd_topic)


@pytest.mark.parametrize("content", [None, "x: [", "hello", "rosbag2_bagfile_information: {}"])
def test_recording__folder_of_junk(refused, here, content):
    (here / "junk").mkdir()
    (here / "junk" / "notes.txt").write_text("x", encoding="utf-8")
    if content is not None:
        (here / "junk" / "metadata.yaml").write_text(content, encoding="utf-8")
    assert refused(DATA, "run", "junk").startswith("junk: ")


def test_recording__ros2_bag_without_its_file(refused, here, ros2_bag):
    shutil.copytree(ros2_bag, "bag")
    Path("bag/flight.db3").unlink()
    assert "flight.db3" in refused(DATA, "run", "bag")


@pytest.mark.parametrize("name", ["arena.mcap", "arena.bag"])
@pytest.mark.parametrize("part", [8, 13, 100, 5000, 0.33, 0.9999])
def test_recording__cut(call, here, name, part):
    sample = Path(__file__).parents[2] / "data" / "samples" / name
    content = sample.read_bytes()
    size = part if isinstance(part, int) else int(part * len(content))
    (here / name).write_bytes(content[:size])
    result = call("info", name)
    assert isinstance(result.exception, SystemExit | None), result.exception
    assert result.exit_code in {0, DATA}
    assert all(line.startswith("beamseg: ") for line in result.stderr.splitlines())
    if result.exit_code:
        assert result.stderr.startswith(f"beamseg: error: {name}: ")


# Configuration


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        (
            "filtering.radius=[0.1]",
            "unknown key 'filtering.radius'; did you mean 'filtering.radii'?",
        ),
        ("granularty=5", "unknown key 'granularty'; did you mean 'granularity'?"),
        ("filtering.radii=[0]", "filtering.radii.0 is 0: input should be greater than 0"),
        ("filtering.radii=[-0.05]", "filtering.radii.0 is -0.05: input should be greater than 0"),
        ("filtering.radii=[.nan]", "filtering.radii.0 is nan: input should be a finite number"),
        ("filtering.radii=[.inf]", "filtering.radii.0 is inf: input should be a finite number"),
        ("filtering.radii=[]", "filtering.radii is []"),
        (
            "detection.hough.granularity=9",
            "granularity is 9: input should be less than or equal to 6",
        ),
        ("granularity=9", "granularity is 9: input should be less than or equal to 6"),
        ("filtering.window.x=[2, 1]", "x: the lower bound 2 must be below 1"),
        ("filtering.window.x=[.nan, 1]", "filtering.window.x.0 is nan"),
        ("recording.time_offset_s=.nan", "recording.time_offset_s is nan"),
        ("filtering=3", "filtering is 3"),
        ("filtering.radii=[", "'filtering.radii=[': the value is not valid YAML"),
        ("filtering.radii=!!python/name:os.system", "is not valid YAML"),
        ("nonsense", "'nonsense' is not a setting; write KEY=VALUE"),
        ("=3", "'=3' is not a setting; write KEY=VALUE"),
        ("", "'' is not a setting; write KEY=VALUE"),
    ],
)
def test_set__bad_value(refused, flight, setting, message):
    assert message in refused(USAGE, "run", flight, "--set", setting)


@pytest.mark.parametrize("radius", ["1e-9", "1e-300"])
def test_set__radius_too_small_for_any_grid(refused, flight, radius):
    line = refused(USAGE, "run", flight, "--set", f"filtering.radii=[{radius}]")
    assert "see filtering.radii" in line


@pytest.mark.parametrize(
    "setting",
    ["filtering.radii=[1e4]", "filtering.window.x=[-1e6, 1e6]", "matching.max_gap_s=1e6"],
)
def test_set__largest_value(ok, flight, setting):
    ok("run", flight, "--set", setting)


@pytest.mark.parametrize(
    "setting",
    [
        "filtering.radii=[1e300]",
        "filtering.window.x=[-1e300, 1e300]",
        "matching.max_gap_s=1e300",
        "recording.time_offset_s=1e300",
        "detection.hough.minvotes=99999999999999999999999999",
        "sensor.extrinsic.translation=[1e300, 0, 0]",
    ],
)
def test_set__value_beyond_all_structures(refused, flight, setting):
    line = refused(USAGE, "run", flight, "--set", setting)
    assert setting.partition("=")[0] in line
    assert "than or equal to" in line


@pytest.mark.parametrize(
    "text",
    ["", "1,2", "a,b,c", "1,2,3,4", "1,2,3,", ",,", "nan,0,0", "0,0,inf", "1;2;3", "0x1,0,0"],
)
def test_extrinsic__not_three_or_six_numbers(refused, flight, text):
    line = refused(USAGE, "run", flight, "--extrinsic", text)
    assert line.startswith(f"--extrinsic {text!r}: write 3 or 6 numbers")


@pytest.mark.parametrize("command", [["run"], ["info"]])
def test_config_file__missing(refused, flight, command):
    line = refused(USAGE, *command, flight, "-c", "nix.yaml")
    assert line == "nix.yaml: cannot be read: No such file or directory"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"a: [1\nb: }", "is not valid YAML"),
        (b"filtering:\n\tradii: [1]\n", "is not valid YAML"),
        (bytes(range(256)), "is not valid YAML"),
        (b"\0\0", "is not valid YAML"),
        ("filtering: {}".encode("utf-16"), "is not valid YAML"),
        (b"filtering: !!python/object:os.system x", "is not valid YAML"),
        (b"filtering: {}\nfiltering: {}\n", "is not valid YAML"),
        (b"- 1\n- 2\n", "must be a mapping of keys to values"),
        (b"hello", "must be a mapping of keys to values"),
        (b"1: 2", "must be a mapping of keys to values"),
        (
            b"filtering: {radius: [0.1]}",
            "unknown key 'filtering.radius'; did you mean 'filtering.radii'?",
        ),
        (b"filtering: &f\n  radii: *f\n", "filtering.radii"),
        (b"profile: 3", "profile must be a name, not 3"),
    ],
)
def test_config_file__unusable(refused, flight, here, content, message):
    (here / "c.yaml").write_bytes(content)
    for command in (["run", flight, "-c"], ["info", flight, "-c"], ["config", "check"]):
        line = refused(USAGE, *command, "c.yaml")
        assert line.startswith("c.yaml: ")
        assert message in line


def test_config_file__is_a_folder(refused, here):
    assert refused(USAGE, "config", "check", ".") == ".: cannot be read: Is a directory"


def test_config_file__all_problems_at_once(refused, here):
    text = "detection: {hough: {granularity: 9}}\nfiltering: {radii: [-1]}\n"
    (here / "c.yaml").write_text(text, encoding="utf-8")
    line = refused(USAGE, "config", "check", "c.yaml")
    assert "detection.hough.granularity is 9" in line
    assert "filtering.radii.0 is -1" in line


@pytest.mark.parametrize("command", ["run", "info"])
@pytest.mark.parametrize("name", ["reprot", "../configs/report"])
def test_profile__unknown(refused, flight, command, name):
    line = refused(USAGE, command, flight, "--profile", name)
    assert line.startswith(f"unknown profile {name!r}")
    assert line.endswith("there are: precise, report")


# Output


def test_output__exists(refused, ok, flight, here):
    ok("run", flight, "-o", "out")
    before = snapshot(here / "out")
    line = refused(USAGE, "run", flight, "-o", "out")
    assert line.startswith("out already holds a run; use --overwrite")
    assert snapshot(here / "out") == before


def test_output__exists_and_may_be_replaced(ok, flight, here):
    ok("run", flight, "-o", "out", "--set", "outputs.report=true")
    (here / "out" / "notes.txt").write_text("mine", encoding="utf-8")
    ok("run", flight, "-o", "out", "--overwrite", "--set", "outputs.report=false")
    assert (here / "out" / "notes.txt").read_text(encoding="utf-8") == "mine"
    assert not (here / "out" / "report.html").exists()
    summary = json.loads((here / "out" / "summary.json").read_bytes())
    assert summary["configuration"]["outputs"]["report"] is False


def test_output__users_file_has_a_name_of_ours(refused, flight, here):
    (here / "out").mkdir()
    (here / "out" / "segments.csv").write_text("mine", encoding="utf-8")
    line = refused(USAGE, "run", flight, "-o", "out", "--overwrite")
    assert line.startswith("out/segments.csv is in the way")
    assert snapshot(here / "out").keys() == {"segments.csv"}


def test_output__is_a_file(refused, flight, here):
    (here / "out").write_text("mine", encoding="utf-8")
    for extra in ([], ["--overwrite"]):
        line = refused(USAGE, "run", flight, "-o", "out", *extra)
        assert line == "out is a file, not a folder; choose another place with -o"
    assert (here / "out").read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize("recording", ["flight", "ros2_bag"])
@pytest.mark.parametrize("place", ["file/out", "/proc/out", "/dev/full", "x" * 300])
def test_output__cannot_be_written(refused, request, here, recording, place):
    (here / "file").touch()
    path = request.getfixturevalue(recording)
    assert refused(USAGE, "run", path, "-o", place).startswith(place)
    assert snapshot(here).keys() == {"file"}


def test_output__link_to_itself(refused, flight, here):
    (here / "loop").symlink_to("loop")
    assert refused(USAGE, "run", flight, "-o", "loop").startswith("loop: cannot be")


def test_output__name_in_the_configuration_is_no_path(refused, ros2_bag):
    line = refused(USAGE, "run", ros2_bag, "--set", r'outputs.path="a\0b"')
    assert r"a\x00b: cannot be used" in line


def test_output__refused_before_the_flight_is_processed(refused, flight, here, monkeypatch):
    monkeypatch.setattr("beamseg_batch.pipeline.process_flight", None)
    refused(USAGE, "run", flight, "-o", "/proc/out")


@pytest.mark.parametrize("extra", [[], ["--overwrite"]])
def test_output__is_the_recording(call, flight, here, extra):
    Path("bag").mkdir()
    shutil.copy(flight, "bag/flight.mcap")
    before = snapshot(here)
    call("run", "bag/flight.mcap", "-o", "bag/flight.mcap", *extra)
    assert snapshot(here) == before
    call("run", "bag/flight.mcap", "-o", "bag", *extra)
    assert before.items() <= snapshot(here).items()


@pytest.mark.parametrize("extra", [[], ["--overwrite"]])
def test_output__is_the_ros2_bag(refused, ros2_bag, here, extra):
    shutil.copytree(ros2_bag, "bag")
    before = snapshot(here)
    for place in ("bag", "./bag/", here / "bag"):
        line = refused(USAGE, "run", "bag", "-o", place, *extra)
        assert line.endswith("is the recording itself; choose another place with -o")
    assert snapshot(here) == before


# Usage


@pytest.mark.parametrize(
    "arguments",
    [
        ["run"],
        ["info"],
        ["config", "check"],
        ["config", "nix"],
        ["run", "--nope", "x"],
        ["run", "x", "-o"],
        ["run", "x", "--jobs", "-1"],
        ["run", "x", "-j", "many"],
        ["--nope"],
        ["rn", "x"],
    ],
)
def test_usage__is_explained(call, arguments):
    result = call(*arguments)
    assert result.exit_code == USAGE
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
    assert result.stderr.splitlines()[-1].startswith("Error: ")


def test_usage__unknown_command_lists_the_commands(call):
    assert "no such command 'rn'; there are: run, info, config" in call("rn").stderr


def test_run__filter_without_open3d(refused, flight, here, monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    line = refused(USAGE, "run", flight, "-o", "out", "--set", "filtering.outliers=plane")
    assert line.startswith("filtering.outliers: plane needs Open3D, which cannot be loaded")
    assert "apt-get install" in line
    assert not (here / "out").exists()
