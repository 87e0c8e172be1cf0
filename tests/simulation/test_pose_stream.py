"""Recorded poses: rate, gaps, jitter and drift."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.errors import ConfigError
from beamseg_batch.geometry import matrix_from_quaternion
from beamseg_batch.simulation.pose_stream import (
    START_NS,
    pose_times,
    recorded_poses,
    true_poses,
)
from beamseg_batch.simulation.sensor import PoseSource
from beamseg_batch.simulation.trajectory import Orbit, TruePath

PATH = TruePath(Orbit(centre=(0, 0, 1), radius=1.5, turns=20), seed=1)


def errors(seed=0, duration_s=100.0, **source):
    """Errors of the positions (N, 3) and, as rotation vectors, of the attitudes (N, 3)."""
    poses = PoseSource(rate_hz=50, **source)
    truth = true_poses(PATH, pose_times(poses, duration_s))
    recorded = recorded_poses(truth, poses, np.random.default_rng(seed))
    np.testing.assert_array_equal(recorded.stamps_ns, truth.stamps_ns)
    turns = [
        matrix_from_quaternion(r) @ matrix_from_quaternion(t).T
        for r, t in zip(recorded.quaternions_xyzw, truth.quaternions_xyzw, strict=True)
    ]
    vectors = [(m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]) for m in turns]
    return recorded.positions - truth.positions, np.array(vectors) / 2


def test_pose_times__rate():
    times = pose_times(PoseSource(rate_hz=125), 2.0)
    assert len(times) == 251
    np.testing.assert_allclose(np.diff(times), 0.008)


def test_pose_times__gaps():
    times = pose_times(PoseSource(rate_hz=10, gaps=((1.0, 0.5), (3.05, 0.2))), 4.0)
    assert len(times) == 41 - 5 - 2
    assert not np.any((times >= 1.0) & (times < 1.5))
    assert np.diff(times).max() == pytest.approx(0.6)


def test_pose_times__nothing_but_gaps():
    with pytest.raises(ConfigError, match=r"poses\.gaps leave no pose of a flight of 4 s"):
        pose_times(PoseSource(gaps=((0, 10),)), 4.0)


def test_true_poses__many_are_those_of_each_alone():
    times = pose_times(PoseSource(rate_hz=100), 100.0)
    truth = true_poses(PATH, times)
    assert truth.stamps_ns[0] == START_NS
    for k in (0, 4095, 4096, 9000):
        alone = PATH.pose(times[k])
        np.testing.assert_allclose(truth.positions[k], alone.translation, atol=1e-12)
        np.testing.assert_allclose(
            matrix_from_quaternion(truth.quaternions_xyzw[k]), alone.rotation, atol=1e-12
        )


def test_recorded_poses__without_errors_are_the_true_ones():
    shift, turn = errors()
    assert np.abs(shift).max() == 0.0
    assert np.abs(turn).max() < 1e-15


def test_recorded_poses__jitter():
    shift, turn = errors(jitter_position=0.003, jitter_attitude_deg=0.15)
    np.testing.assert_allclose(shift.std(axis=0), 0.003, rtol=0.05)
    np.testing.assert_allclose(np.degrees(turn.std(axis=0)), 0.15, rtol=0.05)
    assert np.abs(np.corrcoef(shift[:-1, 0], shift[1:, 0])[0, 1]) < 0.05


def test_recorded_poses__random_walk():
    shift, turn = errors(walk_position=0.002, walk_attitude=0.0005)
    assert np.abs(shift[0]).max() == 0.0
    steps, bends = np.diff(shift, axis=0), np.diff(turn, axis=0)
    np.testing.assert_allclose(steps.std(axis=0), 0.002, rtol=0.05)
    np.testing.assert_allclose(bends.std(axis=0), 0.0005, rtol=0.05)
    assert np.abs(np.corrcoef(steps[:-1, 0], steps[1:, 0])[0, 1]) < 0.05


def test_recorded_poses__random_walk_grows_with_the_root_of_time():
    source = PoseSource(rate_hz=50, walk_position=0.001)
    truth = true_poses(PATH, pose_times(source, 20.0))
    shifts = [
        recorded_poses(truth, source, np.random.default_rng(seed)).positions - truth.positions
        for seed in range(100)
    ]
    deviations = np.std(np.array(shifts)[:, [100, 400, 1000]], axis=(0, 2))
    np.testing.assert_allclose(deviations, 0.001 * np.sqrt([100, 400, 1000]), rtol=0.15)


def test_recorded_poses__steady_drift():
    shift, turn = errors(drift_velocity=(0.001, 0.0, -0.002), drift_yaw_rate_deg=0.01)
    np.testing.assert_allclose(shift[-1], [0.1, 0.0, -0.2], atol=1e-9)
    np.testing.assert_allclose(np.degrees(turn[-1]), [0.0, 0.0, 1.0], atol=1e-3)
