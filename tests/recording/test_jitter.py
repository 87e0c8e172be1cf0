"""The jitter of poses: what is told of it, and what is taken out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamseg_batch.config import MatchingConfig, SensorConfig
from beamseg_batch.model import PoseJitter, Trajectory
from beamseg_batch.recording.jitter import measured_jitter, smoothed_locally, without_jitter
from beamseg_batch.recording.matching import match_pose
from beamseg_batch.recording.pose_arrays import product, quaternions_of, rotation_vectors
from tests.recording.conftest import configured, some_clouds
from tests.recordings import START_NS

JITTER = np.array([0.003, np.radians(0.15)])


def flown(count=1500, rate_hz=30.0, *, turn_s=None):
    """Poses of a drone that wanders and looks about; at a waypoint it turns round at once."""
    times = np.arange(count) / rate_hz
    ways = np.array([0.11, 0.17, 0.07])
    positions = np.stack([np.sin(2 * np.pi * way * times) for way in ways], axis=1)
    if turn_s is not None:
        positions[:, 0] += 1.5 * np.abs(times - turn_s)
    yaw = np.column_stack([0.05 * np.sin(times), 0.05 * np.cos(times), np.sin(0.4 * times)])
    stamps = START_NS + np.rint(times * 1e9).astype(np.int64)
    return Trajectory(stamps, positions, quaternions_of(yaw))


def jittered(truth, seed=0, jitter=JITTER):
    rng = np.random.default_rng(seed)
    shifts, turns = rng.normal(size=(2, len(truth), 3)) * jitter[:, None, None]
    return replace(
        truth,
        positions=truth.positions + shifts,
        quaternions_xyzw=product(quaternions_of(turns), truth.quaternions_xyzw),
    )


def errors(poses, truth):
    """Deviations of the position along and the attitude about each axis."""
    turns = product(truth.quaternions_xyzw * [-1, -1, -1, 1], poses.quaternions_xyzw)
    apart = poses.positions - truth.positions, rotation_vectors(turns)
    return np.array([np.sqrt(np.mean(each**2)) for each in apart])


def part_of(poses, kept):
    return Trajectory(poses.stamps_ns[kept], poses.positions[kept], poses.quaternions_xyzw[kept])


# --- rotation vectors -----------------------------------------------------------------


def test_rotation_vectors__of_their_quaternions():
    vectors = np.random.default_rng(1).normal(size=(50, 3))
    vectors[0], vectors[1] = 0.0, [1e-12, 0.0, 0.0]
    quaternions = quaternions_of(vectors)
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0)
    short = np.linalg.norm(vectors, axis=1) < np.pi
    for sign in (1.0, -1.0):
        found = rotation_vectors(sign * quaternions)
        np.testing.assert_allclose(found[short], vectors[short], atol=1e-12)


# --- how large it is ------------------------------------------------------------------


@pytest.mark.parametrize("rate_hz", [10.0, 30.0, 125.0])
@pytest.mark.parametrize("seed", range(3))
def test_measured_jitter__of_white_noise(rate_hz, seed):
    found = measured_jitter([jittered(flown(3000, rate_hz), seed)])
    np.testing.assert_allclose(found, JITTER, rtol=0.1)


@pytest.mark.parametrize("rate_hz", [10.0, 30.0, 125.0])
def test_measured_jitter__exact_poses_have_none(rate_hz):
    assert (measured_jitter([flown(1500, rate_hz)]) < (3e-5, 3e-5)).all()


def test_measured_jitter__waypoints_are_none():
    assert (measured_jitter([flown(turn_s=20.0)]) < (3e-5, 3e-5)).all()


def test_measured_jitter__stamps_in_whole_milliseconds():
    truth = jittered(flown(3000))
    whole = replace(truth, stamps_ns=truth.stamps_ns // 1_000_000 * 1_000_000)
    np.testing.assert_allclose(measured_jitter([whole]), JITTER, rtol=0.1)


def test_measured_jitter__some_poses_lost_and_a_gap():
    poses = jittered(flown(3000))
    kept = np.random.default_rng(5).random(3000) > 0.1
    kept[1000:1300] = False
    np.testing.assert_allclose(measured_jitter([part_of(poses, kept)]), JITTER, rtol=0.1)


def test_measured_jitter__jumps_between_two_clocks_do_not_count():
    first = jittered(flown(1000), 1)
    second = replace(jittered(flown(1000), 2), positions=first.positions + 50.0)
    np.testing.assert_allclose(measured_jitter([first, second]), JITTER, rtol=0.1)


@pytest.mark.parametrize("count", [0, 1, 6, 20])
def test_measured_jitter__of_too_few_is_not_known(count):
    assert np.isnan(measured_jitter([part_of(flown(50), np.arange(count))])).all()


# --- smoothing ------------------------------------------------------------------------


@pytest.mark.parametrize("turn_s", [None, 20.0])
@pytest.mark.parametrize("rate_hz", [30.0, 125.0])
def test_smoothed_locally__lowers_the_error(rate_hz, turn_s):
    truth = flown(1500, rate_hz, turn_s=turn_s)
    smooth = smoothed_locally(jittered(truth), JITTER)
    left = errors(smooth.trajectory, truth)
    assert (left < 0.45 * JITTER).all()
    np.testing.assert_allclose(left, JITTER * np.sqrt(smooth.shares), rtol=0.3)


def test_smoothed_locally__does_not_cut_the_corner_of_a_waypoint():
    truth = flown(turn_s=20.0)
    smooth = smoothed_locally(jittered(truth), JITTER).trajectory
    near = np.abs(np.arange(len(truth)) / 30.0 - 20.0) < 0.5
    assert np.abs(smooth.positions - truth.positions)[near].max() < 0.05  # a parabola's: 0.3 m
    assert errors(part_of(smooth, near), part_of(truth, near))[0] < 3.0 * JITTER[0]


def test_smoothed_locally__does_not_reach_across_a_gap():
    truth = flown(600)
    stamps = truth.stamps_ns.copy()
    stamps[300:] += 5_000_000_000
    moved = truth.positions + np.where(np.arange(600) < 300, 0.0, 7.0)[:, None]
    truth = replace(truth, stamps_ns=stamps, positions=moved)
    poses = jittered(truth)
    smooth = smoothed_locally(poses, JITTER).trajectory
    assert (errors(smooth, truth) < 0.5 * JITTER).all()
    first = part_of(poses, np.arange(300))
    alone = smoothed_locally(first, JITTER).trajectory
    # Which window is taken is an average over the poses around, yet what is in it is not.
    np.testing.assert_allclose(alone.positions[:250], smooth.positions[:250], atol=1e-12)


def test_smoothed_locally__knows_of_either_sign_of_a_quaternion():
    truth = flown(400)
    poses = jittered(truth)
    signs = np.where(np.random.default_rng(1).random(400) < 0.5, -1.0, 1.0)
    flipped = replace(poses, quaternions_xyzw=poses.quaternions_xyzw * signs[:, None])
    one, other = (smoothed_locally(p, JITTER).trajectory for p in (poses, flipped))
    np.testing.assert_allclose(errors(one, other), 0.0, atol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_smoothed_locally__few_poses_stay(count):
    poses = jittered(part_of(flown(10), np.arange(count)))
    smooth = smoothed_locally(poses, JITTER).trajectory
    np.testing.assert_array_equal(smooth.stamps_ns, poses.stamps_ns)
    assert np.isfinite(smooth.positions).all()
    assert np.abs(smooth.positions - poses.positions).max() < 0.02


def test_smoothed_locally__a_wild_motion_is_left_alone():
    """What no parabola through neighbours comes near is smoothed by none."""
    rng = np.random.default_rng(2)
    wild = replace(flown(400), positions=rng.normal(size=(400, 3)))
    smooth = smoothed_locally(wild, JITTER)
    np.testing.assert_array_equal(smooth.trajectory.positions, wild.positions)
    assert smooth.shares[0] == 1.0


# --- as configured --------------------------------------------------------------------


def test_without_jitter__exact_poses_are_used_as_they_are():
    poses = [flown()]
    steady, jitter = without_jitter(poses, SensorConfig(), "auto")
    assert steady[0] is poses[0]
    assert not jitter.smoothed
    assert jitter.memory_s == 0.0
    assert (jitter.position_source, jitter.attitude_source) == ("measured", "measured")


def test_without_jitter__tells_what_is_left():
    truth = flown()
    (steady,), jitter = without_jitter([jittered(truth)], SensorConfig(), "auto")
    left = jitter.left_position, jitter.left_attitude
    np.testing.assert_allclose(errors(steady, truth), left, rtol=0.3)
    assert jitter.smoothed
    assert 0.2 < jitter.memory_s < 2.0  # of windows about a second wide


def test_without_jitter__off():
    poses = [jittered(flown())]
    steady, jitter = without_jitter(poses, SensorConfig(), "off")
    assert steady[0] is poses[0]
    assert not jitter.smoothed
    assert jitter.left_position == jitter.position == pytest.approx(0.003, rel=0.1)
    assert jitter.memory_s == pytest.approx(1 / 30, rel=1e-3)


def test_without_jitter__as_configured():
    poses = [jittered(flown())]
    config = SensorConfig(pose_jitter_m=0.0, pose_jitter_deg=0.15)
    (steady,), jitter = without_jitter(poses, config, "auto")
    np.testing.assert_array_equal(steady.positions, poses[0].positions)
    assert not np.array_equal(steady.quaternions_xyzw, poses[0].quaternions_xyzw)
    assert (jitter.position, jitter.attitude) == (0.0, np.radians(0.15))
    assert jitter.position_source == "configured"


def test_without_jitter__of_too_few_poses_nothing_is_known():
    poses = [part_of(flown(), np.arange(10))]
    steady, jitter = without_jitter(poses, SensorConfig(), "auto")
    assert steady[0] is poses[0]
    assert jitter == PoseJitter()


def test_open_flight__matches_smoothed_poses_by_the_stamps_of_messages(fly):
    truth = flown(400)
    poses = jittered(truth)
    rows = zip(poses.stamps_ns.tolist(), poses.positions, poses.quaternions_xyzw, strict=True)
    messages = [(stamp, tuple(xyz), tuple(xyzw)) for stamp, xyz, xyzw in rows]
    found = {}
    for smooth in ("auto", "off"):
        config = configured(matching={"smooth": smooth})
        flight = fly(config, clouds=some_clouds(20, 500), poses=messages)
        found[smooth] = list(flight.scans())
        assert flight.jitter.smoothed is (smooth == "auto")
    true = [match_pose(truth, scan.stamp_ns, MatchingConfig()) for scan in found["off"]]
    missed = {
        name: np.array(
            [
                scan.T_world_body.translation - match.T_world_body.translation
                for scan, match in zip(scans, true, strict=True)
            ]
        ).std()
        for name, scans in found.items()
    }
    assert missed["auto"] < 0.6 * missed["off"]
    for one, other in zip(found["auto"], found["off"], strict=True):
        assert (one.pose_stamp_ns, one.pose_gap_s) == (other.pose_stamp_ns, other.pose_gap_s)
