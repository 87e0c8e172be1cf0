"""`beamseg info`: what a recording holds and how it would be used."""

from __future__ import annotations

import json

import pytest

from tests.recordings import START_NS


def test_info__tells_topics_choices_and_match(ok, flight):
    result = ok("info", flight)
    lines = {line.split()[0]: line for line in result.stdout.splitlines() if line.strip()}
    assert str(flight) in lines["recording"]
    assert lines["/tof_pc"].split()[1:3] == ["sensor_msgs/msg/PointCloud2", "6"]
    assert "the default topic" in lines["clouds"]
    assert "the default topic" in lines["poses"]
    assert "100.0% of clouds have a pose within 0.05 s" in lines["match"]
    assert "extrinsic" in lines
    assert result.stderr == ""


def test_info__writes_nothing(ok, flight, here):
    ok("info", flight)
    assert list(here.iterdir()) == []


def test_info__json_is_all_there_is_on_stdout(ok, flight):
    result = ok("info", flight, "--json")
    summary = json.loads(result.stdout)
    assert summary["paths"] == [str(flight)]
    assert {topic["name"] for topic in summary["topics"]} == {
        "/tof_pc",
        "/mavros/local_position/pose",
    }
    assert summary["problems"] == []
    assert result.stderr == ""


def test_info__uses_the_options_of_a_run(ok, flight):
    text = ok("info", flight, "--extrinsic", "0.25,0,0,0,0,90").stdout
    assert "0.25, 0, 0 m, roll 0.00, pitch 0.00, yaw 90.00 degrees" in text
    text = ok("info", flight, "--set", "matching.max_gap_s=0.001").stdout
    assert "within 0.001 s" in text


@pytest.mark.parametrize(
    ("fixture", "problem"),
    [
        ("flight_without_clouds", "no cloud topic"),
        ("flight_without_poses", "no pose topic"),
        ("flight_of_two_cameras", "--cloud-topic"),
    ],
)
def test_info__lists_what_would_stop_a_run(ok, request, fixture, problem):
    path = request.getfixturevalue(fixture)
    (line,) = [line for line in ok("info", path).stdout.splitlines() if line.startswith("problem")]
    assert problem in line
    (text,) = json.loads(ok("info", path, "--json").stdout)["problems"]
    assert problem in text


def test_info__clouds_without_pose(ok, flight_with_late_poses):
    assert "0.0% of clouds have a pose within 0.05 s" in ok("info", flight_with_late_poses).stdout


def test_info__several_paths(ok, flight, ros2_bag):
    text = ok("info", flight, ros2_bag).stdout
    assert str(flight) in text
    assert str(ros2_bag) in text


def test_info__suggests_a_configuration_that_runs(ok, flight, here):
    text = ok("info", flight, "--suggest").stdout
    (here / "site.yaml").write_text(text)
    assert "# the default topic" in text
    summary = json.loads(ok("run", flight, "-c", here / "site.yaml", "--json").stdout)
    assert summary["counts"]["processed"] == 6


def test_info__suggestion_is_no_json(call, flight):
    assert call("info", flight, "--suggest", "--json").exit_code == 2


def test_info__offset_that_cannot_be_told(call, flight):
    result = call("info", flight, "--estimate-time-offset")
    assert result.exit_code == 1
    assert "the time offset cannot be told" in result.stderr


def test_info__of_a_range(ok, flight):
    summary = json.loads(ok("info", flight, "--every", "2", "--max-scans", "2", "--json").stdout)
    assert summary["clouds"]["count"] == 2
    summary = json.loads(ok("info", flight, "--start", "0.25", "--json").stdout)
    assert summary["clouds"]["count"] == 3


def test_run__of_a_range(ok, flight):
    options = ("--start", "0.1", "--duration", "0.35", "--json")
    summary = json.loads(ok("run", flight, *options).stdout)
    assert summary["counts"]["processed"] == 4


def test_run__poses_of_a_file(ok, flight_without_poses, here):
    lines = [f"{stamp},0,0,1,0,0,0,1" for stamp in range(START_NS, START_NS + 10**9, 10**7)]
    (here / "p.csv").write_text("\n".join(["stamp_ns,x,y,z,qx,qy,qz,qw", *lines]))
    summary = json.loads(ok("run", flight_without_poses, "--poses", "p.csv", "--json").stdout)
    assert summary["counts"]["processed"] == 6


@pytest.mark.parametrize(
    ("option", "value", "problem"),
    [
        ("--start", "soon", "--start 'soon': is not a number"),
        ("--time-offset", "nan", "--time-offset 'nan': is not a number"),
        ("--every", "0", "recording.every is 0"),
        ("--max-scans", "1.5", "recording.max_scans is 1.5"),
        ("--time-source", "sun", "recording.time_source is 'sun'"),
        ("--poses", "none.csv", "none.csv: cannot be read: No such file"),
    ],
)
def test_run__bad_values_of_options(call, flight, option, value, problem):
    result = call("run", flight, option, value)
    assert result.exit_code == 2
    assert problem in result.stderr
