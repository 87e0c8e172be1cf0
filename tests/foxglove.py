"""Foxglove's messages for tests, in protobuf and in JSON, and MCAP files of them."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf import timestamp_pb2
from google.protobuf.descriptor_pb2 import FieldDescriptorProto as Field
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.json_format import ParseDict
from google.protobuf.message_factory import GetMessageClass
from mcap.writer import CompressionType, Writer

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


@cache
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


@cache
def message_class(msgtype: str) -> Any:
    """Class of a protobuf message."""
    pool = DescriptorPool()
    for file in reversed(descriptors().file):
        pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(msgtype))


def encoded(encoding: str, msgtype: str, content: dict[str, Any]) -> bytes:
    """Make the bytes of a message, whose content is written as Foxglove's JSON has it."""
    if encoding == "json":
        return json.dumps(content).encode()
    message = ParseDict(_with_protobuf_times(content), message_class(msgtype)())
    return message.SerializeToString()


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


def schema_of(encoding: str, msgtype: str) -> tuple[str, bytes]:
    """Language and text of the schema of a type."""
    if encoding == "protobuf":
        return "protobuf", descriptors().SerializeToString()
    names = TYPES[msgtype.partition(".")[2]]
    rules = {n: {"type": "string", "contentEncoding": "base64"} for n, k in names if k == "bytes"}
    return "jsonschema", json.dumps({"type": "object", "properties": rules}).encode()


def write(
    path: Path,
    encoding: str,
    compression: CompressionType,
    messages: Iterable[tuple[str, int, str, Any]],
) -> Path:
    """Write an MCAP file.

    Parameters
    ----------
    path : Path
    encoding : str
        ``protobuf`` or ``json``.
    compression : CompressionType
    messages : iterable of (topic, log time, type, content)

    Returns
    -------
    Path
        The file.
    """
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression)
        writer.start()
        channels: dict[str, int] = {}
        for topic, stamp, msgtype, content in sorted(messages, key=lambda entry: entry[1]):
            if topic not in channels:
                schema = writer.register_schema(msgtype, *schema_of(encoding, msgtype))
                channels[topic] = writer.register_channel(topic, encoding, schema)
            raw = encoded(encoding, msgtype, content)
            writer.add_message(channels[topic], stamp, raw, stamp)
        writer.finish()
    return path


def time(stamp):
    return dict(zip(("sec", "nsec"), divmod(stamp, 10**9), strict=True))


def vector(values):
    return dict(zip("xyzw", map(float, values), strict=False))


def pose(position, quaternion):
    return {"position": vector(position), "orientation": vector(quaternion)}


def cloud(stamp, points, **content):
    """Make a cloud of float32 x, y, z; any field may be set otherwise."""
    fields = [{"name": name, "offset": 4 * k, "type": 7} for k, name in enumerate("xyz")]
    data = content.pop("data", np.asarray(points, "<f4").tobytes())
    values = {
        "timestamp": time(stamp),
        "frame_id": "tof",
        "pose": pose((0, 0, 0), (0, 0, 0, 1)),
        "point_stride": 12,
        "fields": fields,
        "data": b64encode(data).decode(),
    }
    return ("/tof_pc", stamp, "foxglove.PointCloud", {**values, **content})


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
