"""Roles of frames, tf trees and the extrinsic."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.errors import RecordingError
from beamseg_batch.geometry import RigidTransform, matrix_from_rpy
from beamseg_batch.recording.frames import TransformTree
from tests.recording.conftest import MS, UNPLACED_CAMERA, configured
from tests.recordings import START_NS, Message, pose_message

IDENTITY = (0.0, 0.0, 0.0, 1.0)
TURN_Z = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))
TF = "tf2_msgs/msg/TFMessage"


def moving(parent: str, child: str, position=(5.0, 0.0, 0.0)) -> Message:
    content = pose_message("mcap", TF, START_NS + MS, position, IDENTITY, parent, child)
    return Message("/tf", START_NS + MS, TF, content)


def test_transform__chains_in_any_direction():
    a_b = RigidTransform(matrix_from_rpy(0.1, 0.2, 0.3), np.array([1.0, 2.0, 3.0]))
    a_c = RigidTransform(matrix_from_rpy(-0.5, 0.0, 1.0), np.array([0.0, -1.0, 0.5]))
    c_d = RigidTransform(matrix_from_rpy(0.0, 0.7, 0.0), np.array([0.1, 0.0, 0.0]))
    tree = TransformTree({"b": ("a", a_b), "c": ("a", a_c), "d": ("c", c_d)})
    expected = a_b.inverse() @ a_c @ c_d
    np.testing.assert_allclose(tree.transform("b", "d").rotation, expected.rotation)
    np.testing.assert_allclose(tree.transform("b", "d").translation, expected.translation)
    back = tree.transform("d", "b") @ expected
    np.testing.assert_allclose(back.rotation, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(back.translation, np.zeros(3), atol=1e-15)
    assert tree.transform("a", "elsewhere") is None
    np.testing.assert_array_equal(tree.transform("b", "b").translation, np.zeros(3))


def test_transform__loop_in_the_tree_ends():
    step = RigidTransform.identity()
    tree = TransformTree({"a": ("b", step), "b": ("a", step)})
    assert tree.transform("a", "x") is None
    assert tree.transform("a", "b") is not None


def test_open_flight__names_of_frames_mean_nothing(fly):
    """In the original node's logs the moving frame is called world."""
    info = fly(cloud_frame="world", world_frame="mocap").info
    assert (info.sensor_frame, info.body_frame, info.world_frame) == ("world", "world", "mocap")
    assert info.extrinsic_source == "identity"
    np.testing.assert_array_equal(info.T_body_sensor.translation, np.zeros(3))


def test_open_flight__extrinsic_from_a_chain(fly):
    """The body is the root above the sensor, since a PoseStamped names no child."""
    tf = [
        ("base_link", "arm", (1.0, 0.0, 0.0), TURN_Z),
        ("arm", "tof", (0.0, 2.0, 0.0), IDENTITY),
    ]
    info = fly(tf_static=tf).info
    assert (info.body_frame, info.extrinsic_source) == ("base_link", "tf_static")
    np.testing.assert_allclose(info.T_body_sensor.translation, [-1.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(
        info.T_body_sensor.rotation, matrix_from_rpy(0, 0, np.pi / 2), atol=1e-15
    )


def test_open_flight__extrinsic_from_a_reversed_transform(fly):
    """The tree hangs the body below the sensor."""
    flight = fly(
        pose_type="nav_msgs/msg/Odometry",
        pose_topic="/odom",
        tf_static=[("tof", "base_link", (1.0, 0.0, 0.0), TURN_Z)],
    )
    assert flight.info.extrinsic_source == "tf_static"
    np.testing.assert_allclose(flight.info.T_body_sensor.translation, [0.0, 1.0, 0.0], atol=1e-15)


def test_open_flight__extrinsic_through_a_common_parent(fly):
    tf = [
        ("frame", "base_link", (0.0, 0.0, 1.0), IDENTITY),
        ("frame", "tof", (0.5, 0.0, 0.0), IDENTITY),
    ]
    config = configured(recording={"body_frame": "/base_link"})
    info = fly(config, tf_static=tf).info
    assert info.body_frame == "base_link"
    np.testing.assert_allclose(info.T_body_sensor.translation, [0.5, 0.0, -1.0])


def test_open_flight__body_is_not_a_fixed_frame_above(fly):
    tf = [
        ("map", "base_link", (7.0, 0.0, 0.0), IDENTITY),
        ("base_link", "tof", (0.5, 0.0, 0.0), IDENTITY),
    ]
    info = fly(tf_static=tf).info
    assert info.body_frame == "base_link"
    np.testing.assert_allclose(info.T_body_sensor.translation, [0.5, 0.0, 0.0])


def test_open_flight__configured_extrinsic_comes_first(fly):
    config = configured(
        sensor={"extrinsic": {"translation": (1, 2, 3), "rotation_rpy_deg": (0, 0, 90)}}
    )
    info = fly(config, tf_static=[("base_link", "tof", (9.0, 0.0, 0.0), IDENTITY)]).info
    assert info.extrinsic_source == "configuration"
    np.testing.assert_allclose(info.T_body_sensor.translation, [1, 2, 3])
    np.testing.assert_allclose(info.T_body_sensor.rotation, matrix_from_rpy(0, 0, np.pi / 2))


def test_open_flight__unused_extrinsic_is_noted(fly):
    config = configured(sensor={"extrinsic_from_tf": False})
    info = fly(config, tf_static=[("base_link", "tof", (0.071, 0.011, 0.04), IDENTITY)]).info
    assert info.extrinsic_source == "identity"
    (note,) = info.notes
    assert "(0.071, 0.011, 0.040) m on 'base_link'" in note
    assert "sensor.extrinsic_from_tf is false" in note


def test_open_flight__unlinked_frames_are_noted(fly):
    info = fly(pose_type="nav_msgs/msg/Odometry", pose_topic="/odom").info
    assert info.extrinsic_source == "identity"
    assert any("no transform links" in note for note in info.notes)


def test_open_flight__broken_static_transform_is_ignored(fly):
    info = fly(tf_static=[("base_link", "tof", (1.0, 0.0, 0.0), (0, 0, 0, 0))]).info
    assert (info.body_frame, info.extrinsic_source) == ("tof", "identity")


def test_open_flight__configured_world_frame_is_a_name(fly):
    info = fly(configured(recording={"world_frame": "hall"})).info
    assert info.world_frame == "hall"
    assert info.notes == (
        "the poses call the world frame 'map', the configuration 'hall'; it is only a name",
        UNPLACED_CAMERA,
    )


def test_open_flight__tf_finds_the_body_through_both_trees(fly):
    flight = fly(
        pose_type=TF,
        pose_topic="/tf",
        tf_static=[("base_link", "tof", (0.5, 0.0, 0.0), IDENTITY)],
        more=[moving("map", "rover"), moving("rover", "wheel")],
    )
    info = flight.info
    assert (info.world_frame, info.body_frame, info.sensor_frame) == ("map", "base_link", "tof")
    assert info.extrinsic_source == "tf_static"
    assert len(flight.trajectory) == 40


def test_open_flight__tf_frames_from_the_configuration(fly):
    config = configured(recording={"world_frame": "map", "body_frame": "rover"})
    flight = fly(config, pose_type=TF, pose_topic="/tf", more=[moving("map", "rover")])
    np.testing.assert_array_equal(flight.trajectory.positions, [[5.0, 0.0, 0.0]])


def test_open_flight__tf_with_one_moving_transform_needs_no_tree(fly):
    assert fly(pose_type=TF, pose_topic="/tf").info.body_frame == "base_link"


def test_open_flight__tf_undecidable(fly):
    with pytest.raises(
        RecordingError,
        match=r"cloud's frame is 'tof'.*no moving transform.*set recording\.body_frame.*'rover'",
    ):
        fly(pose_type=TF, pose_topic="/tf", more=[moving("map", "rover")])
