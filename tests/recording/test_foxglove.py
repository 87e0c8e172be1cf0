"""Foxglove's messages in MCAP, in protobuf and in JSON, with every compression."""

from __future__ import annotations

import json
from base64 import b64encode
from typing import Any

import numpy as np
import pytest
from google.protobuf import timestamp_pb2
from google.protobuf.descriptor_pb2 import FieldDescriptorProto as Field
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.json_format import ParseDict
from google.protobuf.message_factory import GetMessageClass
from mcap.writer import CompressionType, Writer

from beamseg_batch.config import RunConfig
from beamseg_batch.model import Scan
from beamseg_batch.recording import open_flight, open_recording
from tests.recording.conftest import some_poses
from tests.recordings import START_NS

TYPES: dict[str, list[tuple[str, str]]] = {
    "Vector3": [(axis, "double") for axis in "xyz"],
    "Quaternion": [(axis, "double") for axis in "xyzw"],
    "Pose": [("position", "Vector3"), ("orientation", "Quaternion")],
    "PackedElementField": [("name", "string"), ("offset", "fixed32"), ("type", "int32")],
    "PointCloud": [
        ("timestamp", "time"), ("frame_id", "string"), ("pose", "Pose"),
        ("point_stride", "fixed32"), ("fields", "PackedElementField*"), ("data", "bytes"),
    ],
    "PoseInFrame": [("timestamp", "time"), ("frame_id", "string"), ("pose", "Pose")],
    "PosesInFrame": [("timestamp", "time"), ("frame_id", "string"), ("poses", "Pose*")],
    "FrameTransform": [
        ("timestamp", "time"), ("parent_frame_id", "string"), ("child_frame_id", "string"),
        ("translation", "Vector3"), ("rotation", "Quaternion"),
    ],
    "FrameTransforms": [("transforms", "FrameTransform*")],
}  # fmt: skip
"""The types that are read, with what their fields are; a star stands for a list."""


def descriptors() -> FileDescriptorSet:
    """Describe all types to protobuf, numbering their fields from 1."""
    file = FileDescriptorProto(name="all.proto", package="foxglove", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    for name, fields in TYPES.items():
        entry = file.message_type.add(name=name)
        for number, (field, kind) in enumerate(fields, start=1):
            base = kind.rstrip("*")
            label = Field.LABEL_REPEATED if kind.endswith("*") else Field.LABEL_OPTIONAL
            made = entry.field.add(name=field, number=number, label=label)
            if base == "time":
                made.type, made.type_name = Field.TYPE_MESSAGE, ".google.protobuf.Timestamp"
            elif base in TYPES:
                made.type, made.type_name = Field.TYPE_MESSAGE, f".foxglove.{base}"
            else:
                made.type = getattr(Field, f"TYPE_{base.upper()}")
    stamp = FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamp)
    return FileDescriptorSet(file=[file, stamp])


def as_protobuf(msgtype: str, content: dict[str, Any]) -> bytes:
    pool = DescriptorPool()
    for file in reversed(descriptors().file):
        pool.Add(file)
    message = GetMessageClass(pool.FindMessageTypeByName(msgtype))()
    return ParseDict(_with_protobuf_times(content), message).SerializeToString()


def _with_protobuf_times(value: Any) -> Any:
    if isinstance(value, list):
        return [_with_protobuf_times(item) for item in value]
    if not isinstance(value, dict):
        return value
    if set(value) == {"sec", "nsec"}:
        return np.datetime_as_string(
            np.datetime64(value["sec"] * 10**9 + value["nsec"], "ns"), timezone="UTC"
        )
    return {key: _with_protobuf_times(item) for key, item in value.items()}


def schema_of(msgtype: str) -> bytes:
    names = TYPES[msgtype.partition(".")[2]]
    rules = {n: {"type": "string", "contentEncoding": "base64"} for n, k in names if k == "bytes"}
    return json.dumps({"type": "object", "properties": rules}).encode()


def write(path, encoding, compression, messages):
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression)
        writer.start()
        channels: dict[str, int] = {}
        for topic, stamp, msgtype, content in sorted(messages, key=lambda entry: entry[1]):
            if topic not in channels:
                language = "protobuf" if encoding == "protobuf" else "jsonschema"
                text = (
                    descriptors().SerializeToString()
                    if encoding == "protobuf"
                    else schema_of(msgtype)
                )
                schema = writer.register_schema(msgtype, language, text)
                channels[topic] = writer.register_channel(topic, encoding, schema)
            raw = (
                as_protobuf(msgtype, content)
                if encoding == "protobuf"
                else json.dumps(content).encode()
            )
            writer.add_message(channels[topic], stamp, raw, stamp)
        writer.finish()
    return path


def time(stamp):
    return dict(zip(("sec", "nsec"), divmod(stamp, 10**9), strict=True))


def vector(values):
    return dict(zip("xyzw", map(float, values), strict=False))


def pose(position, quaternion):
    return {"position": vector(position), "orientation": vector(quaternion)}


def clouds(count=3):
    rng = np.random.default_rng(4)
    return [
        (START_NS + k * 10**8, rng.uniform(0.2, 2.0, size=(50, 3)).astype(np.float32))
        for k in range(count)
    ]


def cloud(stamp, points):
    fields = [{"name": name, "offset": 4 * k, "type": 7} for k, name in enumerate("xyz")]
    content = {
        "timestamp": time(stamp),
        "frame_id": "tof",
        "pose": pose((0, 0, 0), (0, 0, 0, 1)),
        "point_stride": 12,
        "fields": fields,
        "data": b64encode(points.tobytes()).decode(),
    }
    return ("/tof_pc", stamp, "foxglove.PointCloud", content)


def transform(stamp, position, quaternion, parent="map", child="base_link"):
    return {
        "timestamp": time(stamp),
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": vector(position),
        "rotation": vector(quaternion),
    }


def pose_content(msgtype, stamp, position, quaternion):
    framed = {"timestamp": time(stamp), "frame_id": "map"}
    return {
        "PoseInFrame": lambda: {**framed, "pose": pose(position, quaternion)},
        "PosesInFrame": lambda: {**framed, "poses": [pose(position, quaternion)]},
        "FrameTransform": lambda: transform(stamp, position, quaternion),
        "FrameTransforms": lambda: {"transforms": [transform(stamp, position, quaternion)]},
    }[msgtype]()


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("encoding", ["protobuf", "json"])
@pytest.mark.parametrize(
    "msgtype", ["PoseInFrame", "PosesInFrame", "FrameTransform", "FrameTransforms"]
)
def test_scans__of_foxglove(tmp_path, encoding, msgtype, compression):
    messages = [cloud(*entry) for entry in clouds()]
    messages += [
        ("/pose", stamp, f"foxglove.{msgtype}", pose_content(msgtype, stamp, *rest))
        for stamp, *rest in some_poses()
    ]
    static = {"transforms": [transform(START_NS, (0.1, 0, 0), (0, 0, 0, 1), "base_link", "tof")]}
    messages.append(("/tf_static", START_NS, "foxglove.FrameTransforms", static))
    path = write(tmp_path / "flight.mcap", encoding, compression, messages)
    flight = open_flight(open_recording(path), RunConfig())
    scans = [scan for scan in flight.scans() if isinstance(scan, Scan)]
    assert [scan.stamp_ns for scan in scans] == [stamp for stamp, _ in clouds()]
    for scan, (_, points) in zip(scans, clouds(), strict=True):
        np.testing.assert_array_equal(scan.points, points)
    np.testing.assert_allclose(flight.trajectory.positions, [p for _, p, _ in some_poses()])
    np.testing.assert_allclose(flight.extrinsic.T_body_sensor.translation, [0.1, 0.0, 0.0])
    assert (flight.roles.world, flight.roles.body) == ("map", "base_link")
