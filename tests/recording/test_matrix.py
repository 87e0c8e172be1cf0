"""The same simulated flight in every form, with every kind of poses and layout of clouds."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from beamseg_batch.config import RunConfig
from beamseg_batch.detection import Detector
from beamseg_batch.geometry import RigidTransform
from beamseg_batch.model import Scan
from beamseg_batch.recording import open_flight, open_recording
from beamseg_batch.recording.matching import pose_at
from beamseg_batch.structure import Structure
from tests.recording.forms import (
    FILES,
    FORMS,
    N_SCANS,
    SIZE,
    layouts_of,
    poses_of,
    simulated,
    topic_of,
    true_trajectory,
    write_form,
    write_pose_files,
)

MATRIX = [
    (form, layout, pose) for form in FORMS for layout in layouts_of(form) for pose in poses_of(form)
]
IDS = [f"{form.name}-{layout}-{pose}" for form, layout, pose in MATRIX]
IN_FLOAT32 = {"depth-image", "px4-odometry", "px4-position"}
"""Where numbers are computed that pass through float32 once more than those simulated."""


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The recording of a form and layout, and the files of poses, each written once."""
    folder = tmp_path_factory.mktemp("forms")
    files = write_pose_files(folder)

    @cache
    def recorded(form, layout):
        return open_recording(write_form(folder / f"{form.name}-{layout}", form, layout))

    return recorded, files


@cache
def simulated_scans():
    """Scans as they were simulated, without any recording."""
    trajectory = true_trajectory()
    return [
        Scan(
            index=k,
            stamp_ns=stamp,
            pose_stamp_ns=stamp,
            T_world_body=pose_at(trajectory, k),
            T_body_sensor=RigidTransform.identity(),
            points=points.reshape(-1, 3),
            width=SIZE,
            height=SIZE,
        )
        for k, (stamp, points) in enumerate(simulated()[0])
    ]


@pytest.fixture(scope="module")
def segments_of():
    """Segments that scans show; of scans that are the same, bit by bit, found once."""
    known = {}

    def found(scans):
        key = tuple(map(_bits, scans))
        if key not in known:
            # Clouds with and without rows are searched alike.
            config = RunConfig.model_validate({"filtering": {"foreground": "all"}})
            detect, structure = Detector(config), Structure(config)
            for scan in scans:
                structure.update(detect(scan))
            known[key] = structure.segments()
        return known[key]

    return found


def _bits(scan):
    """All that a scan's segments are made of."""
    poses = [scan.T_world_body, scan.T_body_sensor]
    arrays = [scan.points, *(array for T in poses for array in (T.rotation, T.translation))]
    sizes = (scan.width, scan.height, scan.points.dtype)
    return (*sizes, *(np.ascontiguousarray(array).tobytes() for array in arrays))


@pytest.mark.parametrize(("form", "layout", "pose"), MATRIX, ids=IDS)
def test_segments__are_the_same_in_every_form(written, segments_of, form, layout, pose):
    recorded, files = written
    choice = {"pose_file": files[pose]} if pose in FILES else {"pose_topic": topic_of(pose)}
    flight = open_flight(recorded(form, layout), RunConfig.model_validate({"recording": choice}))
    scans, true_scans = list(flight.scans()), simulated_scans()
    atol = 1e-6 if {layout, pose} & IN_FLOAT32 else 1e-9
    assert len(scans) == N_SCANS
    for scan, true in zip(scans, true_scans, strict=True):
        assert (scan.index, scan.stamp_ns) == (true.index, true.stamp_ns)
        _assert_points(scan.T_world_sensor, scan.points, true, atol)
    _assert_segments(segments_of(scans), segments_of(true_scans), atol)


def _assert_points(T_world_sensor, points, true, atol):
    returned = np.isfinite(true.points).all(axis=1)
    assert np.array_equal(np.isfinite(points).all(axis=1), returned)
    world = T_world_sensor.apply(points[returned].astype(np.float64))
    expected = true.T_world_sensor.apply(true.points[returned].astype(np.float64))
    assert np.abs(world - expected).max() <= atol


def _assert_segments(found, expected, atol):
    assert len(found) == len(expected) >= 2
    for segment, true in zip(found, expected, strict=True):
        assert np.abs(_numbers(segment) - _numbers(true)).max() <= atol
        assert segment.n_points == true.n_points


def _numbers(segment):
    ends = [segment.t_min, segment.t_max, segment.radius]
    return np.concatenate([segment.anchor, segment.direction, ends])


def test_matrix__is_the_whole_product():
    """Three bags and three MCAP files of ROS 1, fourteen files of ROS 2, six of Foxglove."""
    assert len(set(IDS)) == len(MATRIX) == 6 * 9 * 9 + 14 * 9 * 10 + 6 * 5 * 7
