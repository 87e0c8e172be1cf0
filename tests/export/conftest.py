"""A small run on disk, with points on its beams."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from beamseg_batch.config import OutputConfig, RunConfig
from beamseg_batch.export.content import Content
from beamseg_batch.outputs import Run, read_run, write_run
from tests.outputs.conftest import build_flight

OFF_AXIS = 0.05


def points_on(segments) -> np.ndarray:
    """Ten points on each beam, and one far from all."""
    found = [np.full((1, 3), 50.0)]
    for segment in segments:
        across = np.cross(segment.direction, [0.3, 0.5, 0.8])
        t = np.linspace(segment.t_min, segment.t_max, 10)[:, None]
        on_axis = segment.anchor + t * segment.direction
        found.append(on_axis + OFF_AXIS * across / np.linalg.norm(across))
    return np.concatenate(found).astype(np.float32)


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Seven beams, nine members, two joints."""
    config = RunConfig(outputs=OutputConfig(report=False))
    flight = build_flight()
    flight = build_flight(config=config, cloud=points_on(flight.segments))
    folder: Path = tmp_path_factory.mktemp("run") / "out"
    write_run(flight, folder)
    return read_run(folder)


@pytest.fixture
def content(run: Run) -> Content:
    """Give the members of the run, as a writer gets them."""
    return Content(run, "members", None, np.eye(3))
