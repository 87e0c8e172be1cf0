"""Definitions of message types: the recording's own, a broken one, none."""

from __future__ import annotations

import sqlite3

import pytest

from beamseg_batch.config import RunConfig
from beamseg_batch.recording import open_flight, open_recording
from beamseg_batch.recording.codec import (
    CDR,
    ROS1,
    Definition,
    MessageCodec,
    UndecodableMessageError,
    default_typestore,
    ros2_name,
)
from tests.recording.conftest import some_clouds, some_poses
from tests.recordings import STORES, cloud_message, pose_message, write_recording


def whole(message):
    return message


CLOUD = "sensor_msgs/msg/PointCloud2"


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("sensor_msgs/PointCloud2", CLOUD),
        (CLOUD, CLOUD),
        ("foxglove.PointCloud", "foxglove.PointCloud"),
        ("", ""),
    ],
)
def test_ros2_name(name, expected):
    assert ros2_name(name) == expected


@pytest.mark.parametrize("encoding", [ROS1, CDR])
@pytest.mark.parametrize(
    ("language", "text"),
    [("", ""), ("msg", "this is ? not a definition"), ("idl", "nor } is this")],
)
def test_decode__falls_back_on_the_common_definitions(encoding, language, text):
    kind = "bag" if encoding == ROS1 else "mcap"
    content = cloud_message(kind, 5, [[1, 2, 3]])
    store = STORES[encoding]
    serialize = store.serialize_ros1 if encoding == ROS1 else store.serialize_cdr
    codec = MessageCodec({CLOUD: Definition(encoding, language, text)})
    assert codec.read(bytes(serialize(content, CLOUD)), CLOUD, whole).width == 1


def test_read__a_definition_without_the_field_is_an_error_of_the_message():
    raw = b"\x00\x01\x00\x00" + bytes(4)
    codec = MessageCodec({CLOUD: Definition(CDR, "msg", "uint32 something")})
    assert codec.read(raw, CLOUD, whole).something == 0
    with pytest.raises(UndecodableMessageError, match="no attribute 'width'"):
        codec.read(raw, CLOUD, lambda message: message.width)


def test_decode__idl_definition():
    text = """module demo { module msg { struct Pair { float x; float y; }; }; };"""
    bundle = "=" * 80 + "\nIDL: demo/msg/Pair\n" + text
    raw = b"\x00\x01\x00\x00" + bytes.fromhex("0000803f00000040")
    for definition in (text, bundle):
        codec = MessageCodec({"demo/msg/Pair": Definition(CDR, "idl", definition)})
        pair = codec.read(raw, "demo/msg/Pair", whole)
        assert (pair.x, pair.y) == (1.0, 2.0)


def test_decode__ros1_transforms_have_a_default():
    store = default_typestore(ROS1)
    for msgtype in ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"):
        content = pose_message("bag", msgtype, 5, (1, 2, 3), (0, 0, 0, 1))
        raw = bytes(store.serialize_ros1(content, msgtype))
        decoded = MessageCodec({msgtype: Definition(ROS1)}).read(raw, msgtype, whole)
        assert decoded.transforms[0].transform.translation.y == 2.0


@pytest.mark.parametrize("raw", [b"", b"\x00\x01\x00\x00", b"\x00\x01\x00\x00" + b"\xff" * 40])
def test_decode__raise_on_bytes_that_do_not_fit(raw):
    codec = MessageCodec({CLOUD: Definition(CDR)})
    with pytest.raises(UndecodableMessageError, match=rf"type {CLOUD} \({len(raw)} bytes\)"):
        codec.read(raw, CLOUD, whole)


def test_decode__raise_on_unknown_type_or_encoding():
    codec = MessageCodec({"a/msg/B": Definition("protobuf"), "a/msg/C": Definition(CDR)})
    with pytest.raises(UndecodableMessageError, match="a/msg/B in protobuf"):
        codec.read(b"", "a/msg/B", whole)
    with pytest.raises(UndecodableMessageError, match="a/msg/C"):
        codec.read(b"\x00\x01\x00\x00", "a/msg/C", whole)
    with pytest.raises(UndecodableMessageError, match="unknown encoding"):
        codec.read(b"", "a/msg/D", whole)


def test_open_recording__old_db3_without_definitions(tmp_path):
    path = write_recording(tmp_path, "db3", some_clouds(), some_poses())
    with sqlite3.connect(path) as database:
        database.execute("UPDATE schema SET schema_version = 3")
        database.execute("DELETE FROM message_definitions")
    database.close()
    scans = list(open_flight(open_recording(path), RunConfig()).scans())
    assert len(scans) == 4
