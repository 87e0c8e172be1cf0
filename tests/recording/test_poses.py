"""Pose messages of every type become the same trajectory."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.errors import RecordingError
from tests.recording.conftest import MS, UNPLACED_CAMERA, configured, some_clouds, some_poses
from tests.recordings import START_NS, Message, pose_message, write_recording

TYPES = [
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "nav_msgs/msg/Odometry",
    "tf2_msgs/msg/TFMessage",
]
IDENTITY = (0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize("kind", ["bag", "mcap", "mcap-ros1"])
@pytest.mark.parametrize("pose_type", TYPES)
def test_open_flight__every_pose_type(fly, kind, pose_type):
    poses = some_poses()
    flight = fly(kind=kind, pose_type=pose_type, pose_topic="/pose", cloud_frame="base_link")
    np.testing.assert_array_equal(flight.trajectory.stamps_ns, [pose[0] for pose in poses])
    np.testing.assert_array_equal(flight.trajectory.positions, [pose[1] for pose in poses])
    np.testing.assert_allclose(
        flight.trajectory.quaternions_xyzw, [pose[2] for pose in poses], atol=1e-15
    )
    assert (flight.info.world_frame, flight.info.body_frame) == ("map", "base_link")
    assert flight.n_clouds == len(list(flight.scans())) == 4


def test_open_flight__tf_of_the_first_ros(fly):
    flight = fly(
        kind="bag",
        pose_type="tf/msg/tfMessage",
        pose_topic="/tf",
        world_frame="/map",
        body_frame="/base_link",
        cloud_frame="base_link",
    )
    assert (flight.info.world_frame, flight.info.body_frame) == ("map", "base_link")
    assert len(flight.trajectory) == 40


def test_open_flight__poses_are_sorted_by_stamp(fly):
    poses = some_poses()
    # Log time and stamp disagree: every message is logged at the mirrored time.
    late = [
        Message(
            "/mavros/local_position/pose",
            poses[-1 - k][0],
            TYPES[0],
            pose_message("mcap", TYPES[0], *pose),
        )
        for k, pose in enumerate(poses)
    ]
    flight = fly(poses=[], more=late)
    np.testing.assert_array_equal(flight.trajectory.stamps_ns, [pose[0] for pose in poses])
    np.testing.assert_array_equal(flight.trajectory.positions, [pose[1] for pose in poses])


def test_open_flight__of_repeated_stamps_the_first_counts(fly):
    poses = [(START_NS, (1, 0, 0), IDENTITY), (START_NS, (2, 0, 0), IDENTITY)]
    flight = fly(poses=poses)
    np.testing.assert_array_equal(flight.trajectory.positions, [[1, 0, 0]])
    assert flight.info.notes == (
        "1 of 2 poses dropped: their stamps repeat another's",
        UNPLACED_CAMERA,
    )


def test_open_flight__quaternions_become_unit(fly):
    flight = fly(
        poses=[(START_NS, (0, 0, 0), (0, 0, 0, 2)), (START_NS + 1, (0, 0, 0), (0, 3, 0, 4))]
    )
    np.testing.assert_allclose(
        flight.trajectory.quaternions_xyzw, [[0, 0, 0, 1], [0, 0.6, 0, 0.8]], atol=1e-15
    )


def test_open_flight__unusable_poses_are_refused_and_counted(fly):
    bad = [
        ((0, 0, 0), (0, 0, 0, 0)),
        ((np.nan, 0, 0), IDENTITY),
        ((0, 0, np.inf), IDENTITY),
        ((0, 0, 0), (0, 0, np.nan, 1)),
        ((0, 0, 0), (0, 0, -np.inf, 1)),
        ((0, 0, 0), (1e300, 0, 1e300, 1)),
    ]
    poses = [(START_NS + k * MS, *pose) for k, pose in enumerate(bad, start=1)]
    flight = fly(poses=[(START_NS, (1, 2, 3), IDENTITY), *poses])
    np.testing.assert_array_equal(flight.trajectory.positions, [[1, 2, 3]])
    assert flight.info.notes[0].startswith("6 of 7 poses refused")


def test_open_flight__raise_when_no_pose_is_usable(fly):
    with pytest.raises(RecordingError, match="no usable pose; 1 of 1 poses refused"):
        fly(poses=[(START_NS, (0, 0, 0), (0, 0, 0, 0))])


def test_open_flight__poses_of_several_children(fly):
    def other(stamp):
        content = pose_message(
            "mcap", "nav_msgs/msg/Odometry", stamp, (9, 9, 9), IDENTITY, child="rover"
        )
        return Message("/odom", stamp, "nav_msgs/msg/Odometry", content)

    content = {
        "pose_type": "nav_msgs/msg/Odometry",
        "pose_topic": "/odom",
        "more": [other(START_NS + 3 * MS)],
    }
    with pytest.raises(RecordingError, match=r"'map' -> 'rover'.*recording\.body_frame"):
        fly(**content)
    flight = fly(configured(recording={"body_frame": "rover"}), **content)
    np.testing.assert_array_equal(flight.trajectory.positions, [[9, 9, 9]])


def test_open_flight__poses_without_stamps_take_the_log_time(fly):
    flight = fly(stamped=False)
    assert "40 of 40 poses have no stamp: their log time is used" in flight.info.notes
    assert "the clouds have no stamps: their log time is used" in flight.info.notes
    np.testing.assert_array_equal(flight.trajectory.stamps_ns, [pose[0] for pose in some_poses()])
    assert [scan.stamp_ns for scan in flight.scans()] == [stamp for stamp, _ in some_clouds()]


def test_open_flight__undecodable_poses_are_left_out(tmp_path):
    """A CDR message that claims a string beyond its end, in the middle of good ones."""
    from beamseg_batch.config import RunConfig
    from beamseg_batch.recording import open_flight, open_recording

    path = write_recording(tmp_path, "mcap-cdr", some_clouds(), some_poses())
    recording = open_recording(path)
    streamed = recording.messages

    def spoiled(topics):
        for k, message in enumerate(streamed(topics)):
            bad = message.topic != "/tof_pc" and k == 3
            yield message._replace(data=message.data[:30]) if bad else message

    recording.messages = spoiled
    flight = open_flight(recording, RunConfig())
    assert len(flight.trajectory) == 39
    assert flight.notes[0].startswith("1 message of /mavros/local_position/pose left out")
