"""Tiny recordings on disk, and the command line called in this process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from beamseg_batch.cli.main import beamseg
from tests.recordings import START_NS, cloud_message, message, write_messages, write_recording
from tests.recordings import Message as RosMessage

LIGHT = ("--set", "outputs.report=false")
"""For runs whose report nobody looks at: it takes longer than all the rest."""
N_CLOUDS = 6
CLOUDS_NS = [START_NS + i * 100_000_000 for i in range(N_CLOUDS)]
POSES = [(START_NS + i * 20_000_000, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)) for i in range(40)]


def beam_points() -> np.ndarray:
    """Build the near side of a level beam, 1.6 m long and 1 m ahead."""
    rng = np.random.default_rng(7)
    along = np.linspace(-0.8, 0.8, 160)
    points = np.stack([np.ones_like(along), along, np.zeros_like(along)], axis=1)
    return points + rng.normal(0.0, 0.003, points.shape)


CLOUDS = [(stamp, beam_points()) for stamp in CLOUDS_NS]


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recordings")


@pytest.fixture(scope="session")
def flight(folder: Path) -> Path:
    """Give a flight along one beam."""
    return write_recording(folder / "good", "mcap", CLOUDS, POSES)


@pytest.fixture(scope="session")
def ros2_bag(folder: Path) -> Path:
    """Give the same flight as a ROS 2 bag folder."""
    return write_recording(folder / "ros2", "ros2-sqlite3", CLOUDS, POSES)


@pytest.fixture(scope="session")
def empty_bag(folder: Path) -> Path:
    topics = [("/tof_pc", "sensor_msgs/msg/PointCloud2")]
    return write_messages(folder / "empty", "bag", [], topics)


@pytest.fixture(scope="session")
def flight_without_clouds(folder: Path) -> Path:
    return write_recording(folder / "no_clouds", "mcap", [], POSES)


@pytest.fixture(scope="session")
def flight_without_poses(folder: Path) -> Path:
    return write_recording(folder / "no_poses", "mcap", CLOUDS, [])


@pytest.fixture(scope="session")
def flight_of_two_cameras(folder: Path) -> Path:
    other = [
        RosMessage(
            "/rear", t, "sensor_msgs/msg/PointCloud2", cloud_message("mcap", t, CLOUDS[0][1])
        )
        for t in CLOUDS_NS[:2]
    ]
    return write_recording(folder / "two", "mcap", CLOUDS, POSES, cloud_topic="/front", more=other)


@pytest.fixture(scope="session")
def flight_with_late_poses(folder: Path) -> Path:
    """Give a flight whose poses start 100 s after its clouds."""
    late = [(stamp + 100 * 10**9, *pose) for stamp, *pose in POSES]
    return write_recording(folder / "late", "mcap", CLOUDS, late)


@pytest.fixture(scope="session")
def flight_far_from_beams(folder: Path) -> Path:
    far = [(stamp, np.full((50, 3), 9.0)) for stamp in CLOUDS_NS]
    return write_recording(folder / "far", "mcap", far, POSES)


@pytest.fixture(scope="session")
def flight_with_odd_topic(folder: Path) -> Path:
    """Give a flight with a topic whose name would clear a terminal."""
    odd = RosMessage(
        "/a\x1b[2Jb", START_NS, "std_msgs/msg/String", message("mcap", "std_msgs/msg/String")
    )
    return write_recording(folder / "odd", "mcap", [], POSES, more=[odd])


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make an empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def call(here: Path) -> Callable[..., Result]:
    """Give the command line, called in an empty working folder."""

    def run_command(*arguments: Any) -> Result:
        return CliRunner().invoke(beamseg, [str(argument) for argument in arguments])

    return run_command


@pytest.fixture
def ok(call: Callable[..., Result]) -> Callable[..., Result]:
    """Call a command that must succeed."""

    def succeed(*arguments: Any) -> Result:
        result = call(*arguments)
        assert result.exit_code == 0, result.output
        return result

    return succeed


@pytest.fixture
def refused(call: Callable[..., Result]) -> Callable[..., str]:
    """Call a command that must end with an exit code and one line on stderr; give the line."""

    def fail(exit_code: int, *arguments: Any) -> str:
        quiet = ["-q"] if arguments[0] == "run" else []
        result = call(*arguments, *quiet)
        assert isinstance(result.exception, SystemExit), result.exception
        assert result.exit_code == exit_code, result.output
        assert result.stdout == ""
        (line,) = result.stderr.splitlines()
        assert line.startswith("beamseg: error: ")
        return line.removeprefix("beamseg: error: ")

    return fail
