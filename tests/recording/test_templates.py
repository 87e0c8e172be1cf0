"""Messages read by their places give what decoding each of them gives."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.model import Scan
from beamseg_batch.recording import cloud_reader, open_recording, poses
from beamseg_batch.recording import flight as flight_module
from beamseg_batch.recording.templates import PoseTemplate, pose_values_at
from tests.recording.conftest import some_poses
from tests.recordings import START_NS, Message, pose_message, write_recording

POSE_TYPES = [
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "nav_msgs/msg/Odometry",
]
POSE = (START_NS, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))
NAMES = ["", "m", "map", "mapp", "map_of", "a_rather_long_name"]


@pytest.fixture
def decoding(monkeypatch):
    """Decode every message, as if there were no templates."""
    monkeypatch.setattr(poses, "pose_values_at", lambda *_: None)
    monkeypatch.setattr(cloud_reader, "cloud_template", lambda *_: None)


@pytest.fixture
def stored(tmp_path):
    """Bytes of pose messages as a recording holds them."""

    def store(kind, msgtype, *names):
        messages = [
            Message("/p", START_NS + k, msgtype, pose_message(kind, msgtype, *POSE, *pair))
            for k, pair in enumerate(names)
        ]
        recording = open_recording(write_recording(tmp_path, kind, poses=[], more=messages))
        return [raw.data for raw in recording.messages(["/p"])], recording.encoding_of(msgtype)

    return store


@pytest.mark.parametrize("kind", ["bag", "mcap"])
@pytest.mark.parametrize("msgtype", POSE_TYPES)
@pytest.mark.parametrize("world", NAMES)
def test_pose_values_at__whatever_the_names(stored, kind, msgtype, world):
    """Padding behind the names depends on their lengths."""
    (raw,), encoding = stored(kind, msgtype, (world, world[::-1] + "b"))
    stamps, values = PoseTemplate(raw, pose_values_at(raw, msgtype, encoding)).parse([raw] * 3)
    np.testing.assert_array_equal(stamps, [START_NS] * 3)
    np.testing.assert_array_equal(values, [[1, 2, 3, 0, 0, 0, 1]] * 3)


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_pose_template__another_name_is_not_taken_for_the_first(stored, kind):
    (raw, other, longer), encoding = stored(kind, POSE_TYPES[0], ("map",), ("mop",), ("world",))
    template = PoseTemplate(raw, pose_values_at(raw, POSE_TYPES[0], encoding))
    assert template.parse([raw]) is not None
    assert template.parse([raw, other]) is None
    assert template.parse([raw, longer]) is None


def test_pose_values_at__cut_or_foreign_message(stored):
    (raw,), _ = stored("mcap", POSE_TYPES[0], ("map",))
    assert all(pose_values_at(raw[:n], POSE_TYPES[0], "cdr") is None for n in range(len(raw)))
    assert pose_values_at(raw, "tf2_msgs/msg/TFMessage", "cdr") is None
    assert pose_values_at(raw, POSE_TYPES[0], "protobuf") is None
    assert pose_values_at(b"\x00\x00" + raw[2:], POSE_TYPES[0], "cdr") is None, "big-endian"


@pytest.mark.parametrize("kind", ["bag", "mcap", "mcap-ros1"])
@pytest.mark.parametrize("msgtype", POSE_TYPES)
def test_open_flight__as_if_every_message_was_decoded(fly, request, kind, msgtype):
    arguments = {"kind": kind, "pose_type": msgtype, "pose_topic": "/p", "cloud_frame": "base_link"}
    quick = fly(**arguments)
    quick_scans = list(quick.scans())
    request.getfixturevalue("decoding")
    slow = flight_module.open_flight(quick.recording, quick.config)
    slow_scans = list(slow.scans())
    for name in ("stamps_ns", "positions", "quaternions_xyzw"):
        np.testing.assert_array_equal(
            getattr(quick.trajectory, name), getattr(slow.trajectory, name)
        )
    assert len(quick_scans) == len(slow_scans)
    for one, other in zip(quick_scans, slow_scans, strict=True):
        assert isinstance(one, Scan)
        assert isinstance(other, Scan)
        assert (one.stamp_ns, one.width, one.height) == (other.stamp_ns, other.width, other.height)
        np.testing.assert_array_equal(one.points, other.points)


def test_open_flight__log_time_stands_in_for_stamps_of_zero(fly):
    rest = some_poses()
    unset = [
        Message("/mavros/local_position/pose", pose[0], POSE_TYPES[0],
                pose_message("mcap", POSE_TYPES[0], 0, *pose[1:]))
        for pose in rest
    ]  # fmt: skip
    flight = fly(poses=[], more=unset)
    np.testing.assert_array_equal(flight.trajectory.stamps_ns, [pose[0] for pose in rest])
    assert any("have no stamp" in note for note in flight.info.notes)
