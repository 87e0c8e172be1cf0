"""`beamseg info`: what a recording holds and how it would be used."""

from __future__ import annotations

import json

import pytest


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
