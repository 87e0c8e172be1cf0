"""Recordings and configurations that several tests of this folder share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from beamseg_batch.config import RunConfig
from beamseg_batch.recording import Flight, open_flight, open_recording
from tests.recordings import START_NS, write_recording

MS = 1_000_000
"""Nanoseconds in a millisecond."""


def some_clouds(count: int = 4, every_ms: int = 100) -> list[tuple[int, Any]]:
    """Organised clouds of 3 by 5 pixels, some without return."""
    generator = np.random.default_rng(7)
    clouds = generator.normal(size=(count, 3, 5, 3)).astype(np.float32)
    clouds[:, 1, 2] = np.nan
    clouds[:, 2, 4] = np.inf
    return [(START_NS + k * every_ms * MS, cloud) for k, cloud in enumerate(clouds)]


def some_poses(count: int = 40, every_ms: int = 10) -> list[tuple[int, Any, Any]]:
    """Poses that move along x, 1 m per second, and turn about z."""
    poses = []
    for k in range(count):
        half = 0.01 * k
        quaternion = (0.0, 0.0, np.sin(half), np.cos(half))
        poses.append((START_NS + k * every_ms * MS, (0.001 * k * every_ms, 2.0, 3.0), quaternion))
    return poses


def configured(**sections: dict[str, Any]) -> RunConfig:
    """Configuration with some values set, by section."""
    return RunConfig.model_validate(sections)


@pytest.fixture
def fly(tmp_path) -> Callable[..., Flight]:
    """Write a recording and open it as a flight; keywords go to `write_recording`."""

    def open_written(config: RunConfig | None = None, **content: Any) -> Flight:
        content.setdefault("clouds", some_clouds())
        content.setdefault("poses", some_poses())
        path = write_recording(tmp_path / f"r{len(list(tmp_path.iterdir()))}", **content)
        return open_flight(open_recording(path), config or RunConfig())

    return open_written


UNPLACED_CAMERA = (
    "the recording does not say where the camera sits on the drone: it is taken to sit at its "
    "origin; see sensor.extrinsic"
)
