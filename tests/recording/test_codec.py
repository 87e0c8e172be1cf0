"""Definitions of message types: the recording's own, a broken one, none."""

from __future__ import annotations

import sqlite3

import pytest

from beamseg_batch.config import RunConfig
from beamseg_batch.recording import open_flight, open_recording
from beamseg_batch.recording.codec import (
    CDR,
    JSON,
    PROTOBUF,
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
    codec = MessageCodec({"a/msg/B": Definition("cbor"), "a/msg/C": Definition(CDR)})
    with pytest.raises(UndecodableMessageError, match="a/msg/B in cbor"):
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


# --- Foxglove's messages ----------------------------------------------------------------


def foxglove_descriptors():
    """Descriptors of a cloud, cut down to what is read of it; its parts come last."""
    from google.protobuf import timestamp_pb2
    from google.protobuf.descriptor_pb2 import FieldDescriptorProto as Field
    from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet

    parts = FileDescriptorProto(name="parts.proto", package="foxglove", syntax="proto3")
    kinds = parts.enum_type.add(name="NumericType")
    for name, number in (("UNKNOWN", 0), ("FLOAT32", 7)):
        kinds.value.add(name=name, number=number)
    element = parts.message_type.add(name="PackedElementField")
    element.field.add(name="name", number=1, type=Field.TYPE_STRING, label=1)
    element.field.add(name="offset", number=2, type=Field.TYPE_FIXED32, label=1)
    element.field.add(
        name="type", number=3, type=Field.TYPE_ENUM, type_name=".foxglove.NumericType", label=1
    )
    cloud = FileDescriptorProto(name="cloud.proto", package="foxglove", syntax="proto3")
    cloud.dependency.extend(["google/protobuf/timestamp.proto", "parts.proto"])
    fields = cloud.message_type.add(name="PointCloud").field
    stamp, part = ".google.protobuf.Timestamp", ".foxglove.PackedElementField"
    fields.add(name="timestamp", number=1, type=Field.TYPE_MESSAGE, type_name=stamp, label=1)
    fields.add(name="frame_id", number=2, type=Field.TYPE_STRING, label=1)
    fields.add(name="point_stride", number=4, type=Field.TYPE_FIXED32, label=1)
    fields.add(name="fields", number=5, type=Field.TYPE_MESSAGE, type_name=part, label=3)
    fields.add(name="data", number=6, type=Field.TYPE_BYTES, label=1)
    fields.add(name="weights", number=7, type=Field.TYPE_DOUBLE, label=3)
    time = FileDescriptorProto.FromString(timestamp_pb2.DESCRIPTOR.serialized_pb)
    return FileDescriptorSet(file=[cloud, parts, time])


def test_decode__protobuf():
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass

    descriptors = foxglove_descriptors()
    pool = DescriptorPool()
    for file in reversed(descriptors.file):
        pool.Add(file)
    message = GetMessageClass(pool.FindMessageTypeByName("foxglove.PointCloud"))()
    message.timestamp.seconds, message.timestamp.nanos = 12, 34
    message.point_stride, message.data = 12, b"\x01\x02"
    message.weights.extend([0.5, 2.0])
    message.fields.add(name="x", type=7)
    definition = Definition(PROTOBUF, "protobuf", descriptors=descriptors.SerializeToString())
    codec = MessageCodec({"foxglove.PointCloud": definition})
    cloud = codec.read(message.SerializeToString(), "foxglove.PointCloud", whole)
    assert (cloud.timestamp.sec, cloud.timestamp.nsec) == (12, 34)
    assert (cloud.frame_id, cloud.point_stride, cloud.data) == ("", 12, b"\x01\x02")
    assert cloud.weights == [0.5, 2.0]
    (field,) = cloud.fields
    assert (field.name, field.offset, field.type) == ("x", 0, 7)
    with pytest.raises(UndecodableMessageError):
        codec.read(b"\xff\xff\xff", "foxglove.PointCloud", whole)


def test_decode__json():
    schema = """{"type": "object", "properties": {
        "timestamp": {"type": "object", "properties": {"sec": {"type": "integer"}}},
        "frame_id": {"type": "string"},
        "fields": {"type": "array", "items": {"type": "object", "properties": {
            "name": {"type": "string"}, "offset": {"type": "integer"},
            "type": {"oneOf": [{"title": "UNKNOWN", "const": 0}, {"title": "FLOAT32", "const": 7}]}
        }}},
        "data": {"type": "string", "contentEncoding": "base64"}}}"""
    raw = b"""{"timestamp": {"sec": 12, "nsec": 34}, "data": "AQI=",
        "fields": [{"name": "x", "type": "FLOAT32"}, {"name": "y", "type": 7}]}"""
    codec = MessageCodec({"foxglove.PointCloud": Definition(JSON, "jsonschema", schema)})
    cloud = codec.read(raw, "foxglove.PointCloud", whole)
    assert (cloud.timestamp.sec, cloud.timestamp.nsec) == (12, 34)
    assert (cloud.frame_id, cloud.data) == ("", b"\x01\x02")
    assert [(field.name, field.offset, field.type) for field in cloud.fields] == [
        ("x", 0, 7),
        ("y", 0, 7),
    ]
    for bad in (b"{", b"\xff", raw.replace(b"AQI=", b"!")):
        with pytest.raises(UndecodableMessageError):
            codec.read(bad, "foxglove.PointCloud", whole)


@pytest.mark.parametrize("schema", ["", "no JSON", "[]", '{"properties": {}}'])
def test_decode__json_without_a_useful_schema(schema):
    codec = MessageCodec({"a": Definition(JSON, "jsonschema", schema)})
    assert codec.read(b'{"b": [{"c": 1}]}', "a", lambda message: message.b[0].c) == 1
