"""The drone's pose as a product of transforms."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.errors import RecordingError
from beamseg_batch.geometry import RigidTransform, matrix_from_quaternion, matrix_from_rpy
from beamseg_batch.model import Trajectory
from beamseg_batch.recording import pose_arrays
from beamseg_batch.recording.matching import interpolated_pose
from tests.recording.conftest import MS, configured, some_poses
from tests.recordings import START_NS, Message, pose_message

IDENTITY = (0.0, 0.0, 0.0, 1.0)
TURN_Z = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))
TF = "tf2_msgs/msg/TFMessage"


def tf(parent, child, stamp_ns=START_NS + MS, position=(5.0, 0.0, 0.0), turn=IDENTITY) -> Message:
    content = pose_message("mcap", TF, stamp_ns, position, turn, parent, child)
    return Message("/tf", stamp_ns, TF, content)


def odometry(**content):
    return {"pose_type": TF, "pose_topic": "/tf", "world_frame": "odom", **content}


def drifting(count=5) -> list[Message]:
    """map -> odom, ten times slower than odom -> base_link, along y."""
    return [
        tf("map", "odom", START_NS + k * 100 * MS, (0.0, 0.1 * k, 0.0), TURN_Z)
        for k in range(count)
    ]


def test_open_flight__chain_of_moving_transforms_is_interpolated(fly):
    flight = fly(**odometry(cloud_frame="base_link", more=drifting()))
    assert (flight.roles.world, flight.roles.body) == ("map", "base_link")
    assert any("map -> odom -> base_link" in note for note in flight.notes)
    assert len(flight.trajectory) == 40
    for k, (stamp, (x, y, z), quaternion) in enumerate(some_poses()):
        # The slow transform moves 0.01 m in the 10 ms between two poses.
        expected = (-y, x + 0.01 * k, z)
        np.testing.assert_allclose(flight.trajectory.positions[k], expected, atol=1e-12)
        np.testing.assert_allclose(
            matrix_from_quaternion(flight.trajectory.quaternions_xyzw[k]),
            matrix_from_quaternion(np.array(TURN_Z)) @ matrix_from_quaternion(np.array(quaternion)),
            atol=1e-12,
        )
        assert flight.trajectory.stamps_ns[k] == stamp


def test_open_flight__chain_ends_with_its_shortest_transform(fly):
    flight = fly(**odometry(cloud_frame="base_link", more=drifting(3)))
    assert flight.trajectory.stamps_ns[-1] == START_NS + 200 * MS


def test_open_flight__transform_that_never_changes_holds_all_the_time(fly):
    flight = fly(**odometry(cloud_frame="base_link", more=[tf("map", "odom")]))
    assert (flight.roles.world, len(flight.trajectory)) == ("odom", 40)
    config = configured(recording={"world_frame": "map"})
    flight = fly(config, **odometry(cloud_frame="base_link", more=[tf("map", "odom")]))
    expected = [np.add(position, (5.0, 0.0, 0.0)) for _, position, _ in some_poses()]
    np.testing.assert_allclose(flight.trajectory.positions, expected, atol=1e-12)


def test_open_flight__extrinsic_that_a_moving_topic_repeats(fly):
    """The static publisher of ROS 1 writes to /tf."""
    more = [tf("base_link", "tof", START_NS + k * 100 * MS, (0.1, 0.0, 0.0)) for k in range(3)]
    flight = fly(**odometry(world_frame="map", more=more))
    assert flight.roles.body == "base_link"
    np.testing.assert_allclose(flight.extrinsic.T_body_sensor.translation, [0.1, 0.0, 0.0])


def test_open_flight__tree_with_the_drone_above_the_world(fly):
    """Some trackers publish the world as a child of their camera."""
    config = configured(recording={"world_frame": "map", "body_frame": "base_link"})
    flight = fly(config, pose_type=TF, pose_topic="/tf", world_frame="base_link", body_frame="map")
    for pose, (_, position, quaternion) in zip(
        flight.trajectory.positions, some_poses(), strict=True
    ):
        inverse = RigidTransform.from_quaternion(np.array(position), np.array(quaternion)).inverse()
        np.testing.assert_allclose(pose, inverse.translation, atol=1e-12)


def test_open_flight__static_transforms_lie_in_the_chain(fly):
    config = configured(recording={"world_frame": "site"})
    static = [("site", "odom", (0.0, 0.0, 2.0), TURN_Z)]
    flight = fly(config, **odometry(cloud_frame="base_link", tf_static=static))
    x, y, z = some_poses()[3][1]
    np.testing.assert_allclose(flight.trajectory.positions[3], (-y, x, z + 2.0), atol=1e-12)


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ({"world_frame": "moon"}, "no chain of transforms leads from 'moon' to 'base_link'"),
        ({"world_frame": "base_link", "body_frame": "tof"}, "'tof' does not move in 'base_link'"),
    ],
)
def test_open_flight__frames_that_nothing_links(fly, frames, message):
    static = [("base_link", "tof", (0.1, 0.0, 0.0), IDENTITY)]
    with pytest.raises(RecordingError, match=message):
        fly(configured(recording=frames), **odometry(tf_static=static))


def random_trajectory(count=30, seed=5) -> Trajectory:
    rng = np.random.default_rng(seed)
    quaternions = rng.normal(size=(count, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    stamps = np.cumsum(rng.integers(1, 10**9, count))
    return Trajectory(stamps, rng.normal(size=(count, 3)), quaternions)


def poses_of(trajectory) -> list[RigidTransform]:
    return [
        RigidTransform.from_quaternion(position, quaternion)
        for position, quaternion in zip(
            trajectory.positions, trajectory.quaternions_xyzw, strict=True
        )
    ]


def assert_same_poses(found, expected):
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one.rotation, other.rotation, atol=1e-12)
        np.testing.assert_allclose(one.translation, other.translation, atol=1e-12)


def test_chained__as_one_by_one():
    first, second = random_trajectory(), random_trajectory(seed=6)
    expected = [a @ b for a, b in zip(poses_of(first), poses_of(second), strict=True)]
    assert_same_poses(poses_of(pose_arrays.chained(first, second)), expected)


def test_reversed_poses__as_one_by_one():
    trajectory = random_trajectory()
    expected = [pose.inverse() for pose in poses_of(trajectory)]
    assert_same_poses(poses_of(pose_arrays.reversed_poses(trajectory)), expected)


def test_resampled__as_one_by_one():
    trajectory = random_trajectory()
    first, last = trajectory.stamps_ns[[0, -1]]
    stamps = np.linspace(first, last - 1, 77).astype(np.int64)
    found = pose_arrays.resampled(trajectory, np.r_[first - 1, stamps, last + 1])
    np.testing.assert_array_equal(found.stamps_ns, stamps)
    expected = [interpolated_pose(trajectory, int(stamp), 2**62) for stamp in stamps]
    assert_same_poses(poses_of(found), expected)


def test_resampled__a_single_pose():
    trajectory = random_trajectory(1)
    found = pose_arrays.resampled(trajectory, trajectory.stamps_ns)
    assert_same_poses(poses_of(found), poses_of(trajectory))


@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), (np.pi, 0.0, 0.0), (0.3, -1.2, 3.0)])
def test_constant__keeps_the_rotation(rpy):
    pose = RigidTransform(matrix_from_rpy(*rpy), np.array([1.0, 2.0, 3.0]))
    stamps = np.array([3, 4, 5])
    assert_same_poses(poses_of(pose_arrays.constant(pose, stamps)), [pose] * 3)


def test_smoothed__keeps_the_time_of_a_turn():
    stamps = np.arange(0, 4 * 10**9, 33 * 10**6)
    half = np.sin(stamps * 1e-9) / 2
    zeros = np.zeros_like(half)
    quaternions = np.stack([zeros, zeros, np.sin(half), np.cos(half)], axis=1)
    quaternions[::2] *= -1.0  # the same rotations
    trajectory = Trajectory(stamps, np.stack([half, zeros, zeros], axis=1), quaternions)
    smooth = pose_arrays.smoothed(trajectory, 0.2)
    times = smooth.stamps_ns * 1e-9
    inner = (times > 0.2) & (times < 3.7)
    yaw = 2 * np.arctan2(smooth.quaternions_xyzw[:, 2], smooth.quaternions_xyzw[:, 3])
    yaw = (yaw + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(yaw[inner], np.sin(times[inner]), atol=3e-3)
    np.testing.assert_allclose(smooth.positions[inner, 0], np.sin(times[inner]) / 2, atol=2e-3)
