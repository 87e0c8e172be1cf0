"""Nearest and interpolated poses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beamseg_batch.config import MatchingConfig
from beamseg_batch.errors import ShapeError
from beamseg_batch.geometry import matrix_from_rpy
from beamseg_batch.model import Trajectory
from beamseg_batch.recording.matching import (
    interpolated_pose,
    match_pose,
    nearest_index,
    seconds_to_ns,
    within_int64,
)

MS = 1_000_000


def line(*stamps_ms: int) -> Trajectory:
    """Fly along x at 1 m per second while turning about z at 1 rad per second."""
    seconds = np.array(stamps_ms) * 1e-3
    zeros = np.zeros_like(seconds)
    return Trajectory(
        np.array(stamps_ms, dtype=np.int64) * MS,
        np.stack([seconds, zeros, zeros], axis=1),
        np.stack([zeros, zeros, np.sin(seconds / 2), np.cos(seconds / 2)], axis=1),
    )


@given(
    st.lists(st.integers(-50, 50), min_size=1, max_size=8, unique=True),
    st.integers(-60, 60),
)
def test_nearest_index__agrees_with_brute_force(stamps, stamp):
    stamps = np.array(sorted(stamps), dtype=np.int64)
    # The first of the least distances is the earlier one of a tie.
    assert nearest_index(stamps, stamp) == int(np.argmin(np.abs(stamps - stamp)))


def test_nearest_index__nanoseconds_are_exact():
    start = 1_700_000_000_000_000_000
    stamps = np.array([start, start + 3], dtype=np.int64)
    assert [nearest_index(stamps, start + k) for k in range(4)] == [0, 0, 1, 1]


def test_nearest_index__raise_on_no_stamps():
    with pytest.raises(ShapeError, match="no stamps"):
        nearest_index(np.array([], dtype=np.int64), 3)


def test_match_pose__nearest_uses_the_pose_as_it_is():
    match = match_pose(line(0, 10, 20), 13 * MS, MatchingConfig(method="nearest"))
    assert (match.stamp_ns, match.gap_ns) == (10 * MS, 3 * MS)
    np.testing.assert_allclose(match.T_world_body.translation, [0.010, 0, 0])
    np.testing.assert_allclose(match.T_world_body.rotation, matrix_from_rpy(0, 0, 0.010))


def test_match_pose__interpolate_lies_between_but_reports_the_nearest():
    match = match_pose(line(0, 10, 20), 13 * MS, MatchingConfig(method="interpolate"))
    assert (match.stamp_ns, match.gap_ns) == (10 * MS, 3 * MS)
    np.testing.assert_allclose(match.T_world_body.translation, [0.013, 0, 0])
    np.testing.assert_allclose(match.T_world_body.rotation, matrix_from_rpy(0, 0, 0.013))


@pytest.mark.parametrize("method", ["nearest", "interpolate"])
def test_match_pose__on_a_stamp_is_that_pose(method):
    match = match_pose(line(0, 10, 20), 10 * MS, MatchingConfig(method=method))
    assert (match.stamp_ns, match.gap_ns) == (10 * MS, 0)
    np.testing.assert_allclose(match.T_world_body.translation, [0.010, 0, 0], atol=1e-15)


@pytest.mark.parametrize(("stamp_ms", "nearest_ms"), [(-5, 0), (25, 20)])
def test_match_pose__interpolate_outside_falls_back_to_nearest(stamp_ms, nearest_ms):
    match = match_pose(line(0, 10, 20), stamp_ms * MS, MatchingConfig(method="interpolate"))
    np.testing.assert_allclose(match.T_world_body.translation, [nearest_ms * 1e-3, 0, 0])


def test_match_pose__interpolate_over_a_wide_gap_falls_back_to_nearest():
    config = MatchingConfig(method="interpolate", max_gap_s=0.05)
    match = match_pose(line(0, 500), 40 * MS, config)
    np.testing.assert_allclose(match.T_world_body.translation, [0, 0, 0], atol=1e-15)


@pytest.mark.parametrize("method", ["nearest", "interpolate"])
def test_match_pose__a_tie_goes_to_the_earlier(method):
    match = match_pose(line(0, 10), 5 * MS, MatchingConfig(method=method))
    assert match.stamp_ns == 0


@pytest.mark.parametrize("method", ["nearest", "interpolate"])
def test_match_pose__gap_limit_is_inclusive(method):
    config = MatchingConfig(method=method, max_gap_s=0.05)
    assert match_pose(line(0), 50 * MS, config).T_world_body is not None
    beyond = match_pose(line(0), 50 * MS + 1, config)
    assert beyond.T_world_body is None
    assert (beyond.stamp_ns, beyond.gap_ns) == (0, 50 * MS + 1)


def test_match_pose__zero_gap_takes_equal_stamps_only():
    config = MatchingConfig(method="nearest", max_gap_s=0.0)
    assert match_pose(line(0, 10), 10 * MS, config).T_world_body is not None
    assert match_pose(line(0, 10), 10 * MS + 1, config).T_world_body is None


def test_interpolated_pose__takes_the_shorter_arc():
    flipped = line(0, 10)
    quaternions = flipped.quaternions_xyzw * np.array([[1.0], [-1.0]])
    pose = interpolated_pose(
        Trajectory(flipped.stamps_ns, flipped.positions, quaternions), 5 * MS, 10 * MS
    )
    np.testing.assert_allclose(pose.rotation, matrix_from_rpy(0, 0, 0.005))


def test_seconds_to_ns__rounds():
    assert seconds_to_ns(0.05) == 50_000_000
    assert seconds_to_ns(-0.0000000015) == -2


def test_within_int64():
    assert within_int64(5) == 5
    assert within_int64(2**70) == 2**63 - 1
    assert within_int64(-(2**70)) == -(2**63)
