"""Tiny recordings for tests, of every kind that the package reads.

`write_recording` writes clouds, poses and static transforms given as plain arrays;
`write_messages` writes any messages, made with `message` and the functions built on it.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from numpy.typing import ArrayLike
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer

from beamseg_batch.recording.codec import CDR, ROS1, default_typestore

START_NS = 1_700_000_000_000_000_000
"""Stamp that recordings in tests start at."""

KINDS = (
    "bag",
    "bag-bz2",
    "bag-lz4",
    "ros2-sqlite3",
    "ros2-mcap",
    "db3",
    "mcap",
    "mcap-ros1",
    "mcap-cdr",
)
"""ROS 1 bags; ROS 2 folders; bare ROS 2 files; MCAP with ROS 1 messages; MCAP with CDR
messages but without the ``ros2`` profile."""

STORES = {ROS1: default_typestore(ROS1), CDR: default_typestore(CDR)}


class Message(NamedTuple):
    """A message to write: its topic, log time, type and object."""

    topic: str
    log_ns: int
    msgtype: str
    content: Any


def encoding_of(kind: str) -> str:
    """Encoding of the messages in a kind of recording."""
    return ROS1 if kind.startswith("bag") or kind == "mcap-ros1" else CDR


def filename_of(kind: str) -> str:
    """Usual file name of a kind of recording."""
    if kind.startswith("bag"):
        return "flight.bag"
    return {"db3": "flight.db3", "ros2-sqlite3": "flight", "ros2-mcap": "flight"}.get(
        kind, "flight.mcap"
    )


def message(kind: str, msgtype: str, **content: Any) -> Any:
    """Make a message; fields that are not given are zero, empty or false.

    Parameters
    ----------
    kind : str
        Kind of recording it is for: messages of ROS 1 and ROS 2 differ.
    msgtype : str
    **content
        Values of fields.

    Returns
    -------
    object
    """
    store = STORES[encoding_of(kind)]
    values = {
        name: content.pop(name) if name in content else _empty(kind, description)
        for name, description in store.fielddefs[msgtype][1]
    }
    assert not content, f"{msgtype} has no fields {sorted(content)}"
    return store.types[msgtype](**values)


def _empty(kind: str, description: Any) -> Any:
    node, detail = description
    if node.name == "NAME":
        return message(kind, detail)
    if node.name == "BASE":
        return {"string": "", "bool": False}.get(detail[0], 0)
    (_, inner), length = detail
    basic = isinstance(inner, tuple) and inner[0] not in ("string", "bool")
    return np.zeros(length, dtype=inner[0]) if basic else []


def header(kind: str, stamp_ns: int, frame: str) -> Any:
    """Make a header."""
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    stamp = message(kind, "builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    return message(kind, "std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def cloud_message(
    kind: str, stamp_ns: int, points: ArrayLike, frame: str = "tof", **content: Any
) -> Any:
    """Make a cloud of float32 x, y, z.

    Parameters
    ----------
    kind : str
    stamp_ns : int
    points : (N, 3) or (height, width, 3) array, metres
    frame : str
    **content
        Fields of the message to set otherwise.

    Returns
    -------
    object
    """
    array = np.atleast_2d(np.asarray(points, dtype="<f4"))
    height, width = array.shape[:2] if array.ndim == 3 else (1, len(array))
    layout = [
        message(kind, "sensor_msgs/msg/PointField", name=name, offset=4 * k, datatype=7, count=1)
        for k, name in enumerate("xyz")
    ]
    values = {
        "header": header(kind, stamp_ns, frame),
        "height": height,
        "width": width,
        "fields": layout,
        "point_step": 12,
        "row_step": 12 * width,
        "data": np.frombuffer(array.tobytes(), dtype=np.uint8),
    }
    return message(kind, "sensor_msgs/msg/PointCloud2", **{**values, **content})


def _vector(kind: str, name: str, values: ArrayLike) -> Any:
    return message(
        kind,
        f"geometry_msgs/msg/{name}",
        **dict(zip("xyzw", np.asarray(values, dtype=float).tolist(), strict=False)),
    )


def pose_message(
    kind: str,
    msgtype: str,
    stamp_ns: int,
    position: ArrayLike,
    quaternion_xyzw: ArrayLike,
    frame: str = "map",
    child: str = "base_link",
) -> Any:
    """Make a pose message of any type; `child` goes where the type has room for it."""
    head = header(kind, stamp_ns, frame)
    if msgtype.endswith(("TransformStamped", "TFMessage", "tfMessage")):
        transform = message(
            kind,
            "geometry_msgs/msg/TransformStamped",
            header=head,
            child_frame_id=child,
            transform=message(
                kind,
                "geometry_msgs/msg/Transform",
                translation=_vector(kind, "Vector3", position),
                rotation=_vector(kind, "Quaternion", quaternion_xyzw),
            ),
        )
        if msgtype.endswith("TransformStamped"):
            return transform
        return message(kind, msgtype, transforms=[transform])
    pose = message(
        kind,
        "geometry_msgs/msg/Pose",
        position=_vector(kind, "Point", position),
        orientation=_vector(kind, "Quaternion", quaternion_xyzw),
    )
    if msgtype == "geometry_msgs/msg/PoseStamped":
        return message(kind, msgtype, header=head, pose=pose)
    pose = message(kind, "geometry_msgs/msg/PoseWithCovariance", pose=pose)
    if msgtype == "nav_msgs/msg/Odometry":
        return message(kind, msgtype, header=head, child_frame_id=child, pose=pose)
    return message(kind, msgtype, header=head, pose=pose)


def write_recording(
    path: Path,
    kind: str = "mcap",
    clouds: Iterable[tuple[int, ArrayLike]] = (),
    poses: Iterable[tuple[int, ArrayLike, ArrayLike]] = (),
    *,
    cloud_topic: str = "/tof_pc",
    pose_topic: str = "/mavros/local_position/pose",
    pose_type: str = "geometry_msgs/msg/PoseStamped",
    tf_static: Sequence[tuple[str, str, ArrayLike, ArrayLike]] = (),
    cloud_frame: str = "tof",
    world_frame: str = "map",
    body_frame: str = "base_link",
    stamped: bool = True,
    more: Sequence[Message] = (),
) -> Path:
    """Write a recording of clouds and poses.

    Parameters
    ----------
    path : Path
        Folder in which it is written, made when missing.
    kind : str
        One of `KINDS`.
    clouds : iterable of (stamp_ns, points)
        Points are (N, 3) or (height, width, 3), metres, sensor frame. The stamp is also
        the log time.
    poses : iterable of (stamp_ns, position, quaternion_xyzw)
        Metres, world frame.
    cloud_topic, pose_topic, pose_type : str
    tf_static : sequence of (parent, child, translation, quaternion_xyzw)
        Written in one message at the start.
    cloud_frame, world_frame, body_frame : str
        The body's frame stands only in types that name a child frame.
    stamped : bool
        False leaves all header stamps at zero.
    more : sequence of Message
        Further messages.

    Returns
    -------
    Path
        The recording: a file, or a folder for ``ros2-*``.
    """
    messages = [
        Message(
            cloud_topic,
            stamp,
            "sensor_msgs/msg/PointCloud2",
            cloud_message(kind, stamp if stamped else 0, points, cloud_frame),
        )
        for stamp, points in clouds
    ]
    messages += [
        Message(
            pose_topic,
            stamp,
            pose_type,
            pose_message(kind, pose_type, stamp if stamped else 0, *pose, world_frame, body_frame),
        )
        for stamp, *pose in poses
    ]
    first = min((entry.log_ns for entry in messages), default=START_NS)
    return write_messages(path, kind, [*messages, *static_tf(kind, first, tf_static), *more])


def static_tf(
    kind: str, log_ns: int, transforms: Sequence[tuple[str, str, ArrayLike, ArrayLike]]
) -> list[Message]:
    """Make one ``/tf_static`` message, or none when there are no transforms."""
    if not transforms:
        return []
    parts = [
        pose_message(kind, "geometry_msgs/msg/TransformStamped", log_ns, *pose, parent, child)
        for parent, child, *pose in transforms
    ]
    content = message(kind, "tf2_msgs/msg/TFMessage", transforms=parts)
    return [Message("/tf_static", log_ns, "tf2_msgs/msg/TFMessage", content)]


def write_messages(
    path: Path,
    kind: str,
    messages: Iterable[Message],
    topics: Sequence[tuple[str, str]] = (),
    compression: str = "",
) -> Path:
    """Write messages in order of log time.

    Parameters
    ----------
    path : Path
        Folder in which the recording is written, made when missing.
    kind : str
        One of `KINDS`.
    messages : iterable of Message
    topics : sequence of (topic, msgtype)
        Further topics, which stay without messages.
    compression : str
        Of MCAP files that are none of a folder ``none``, ``lz4`` or ``zstd``; of other files
        of ROS 2 ``file`` or ``message``, in both cases zstd.

    Returns
    -------
    Path
        The recording.
    """
    ordered = sorted(messages, key=lambda entry: entry.log_ns)
    keys = list(dict.fromkeys([*((m.topic, m.msgtype) for m in ordered), *topics]))
    path.mkdir(parents=True, exist_ok=True)
    target = path / filename_of(kind)
    if kind.startswith("bag"):
        _write_bag1(target, kind, ordered, keys)
    elif kind in ("mcap-ros1", "mcap-cdr") or (kind == "mcap" and compression):
        _write_mcap(target, kind, ordered, keys, compression or "zstd")
    elif kind.startswith("ros2-"):
        _write_bag2(target, "mcap" in kind, ordered, keys, compression)
    else:
        _write_bag2(path / "folder", kind == "mcap", ordered, keys, compression)
        (written,) = (path / "folder").glob(f"folder.{kind}*")
        target = written.rename(target.with_suffix("".join(written.suffixes)))
        shutil.rmtree(path / "folder")
    return target


def _serialized(kind: str, entry: Message) -> bytes | memoryview:
    """Bytes of a message, which may have been made before."""
    if isinstance(entry.content, bytes):
        return entry.content
    store = STORES[encoding_of(kind)]
    if encoding_of(kind) == ROS1:
        return store.serialize_ros1(entry.content, entry.msgtype)
    return store.serialize_cdr(entry.content, entry.msgtype)


def serialized(kind: str, entry: Message) -> Message:
    """Make the bytes of a message once, for several recordings of one encoding."""
    return entry._replace(content=bytes(_serialized(kind, entry)))


def _write_bag1(
    path: Path, kind: str, messages: list[Message], keys: list[tuple[str, str]]
) -> None:
    store = STORES[ROS1]
    writer = Bag1Writer(path)
    if "-" in kind:
        writer.set_compression(Bag1Writer.CompressionFormat[kind.partition("-")[2].upper()])
    with writer:
        connections = {key: writer.add_connection(*key, typestore=store) for key in keys}
        for entry in messages:
            raw = _serialized(kind, entry)
            writer.write(connections[entry.topic, entry.msgtype], entry.log_ns, raw)


def _write_bag2(
    path: Path,
    mcap: bool,
    messages: list[Message],
    keys: list[tuple[str, str]],
    compression: str,
) -> None:
    store = STORES[CDR]
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    writer = Bag2Writer(path, version=9, storage_plugin=plugin)
    if compression:
        writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with writer:
        connections = {key: writer.add_connection(*key, typestore=store) for key in keys}
        for entry in messages:
            raw = _serialized("ros2", entry)
            writer.write(connections[entry.topic, entry.msgtype], entry.log_ns, raw)


def _write_mcap(
    path: Path,
    kind: str,
    messages: list[Message],
    keys: list[tuple[str, str]],
    compression: str,
) -> None:
    encoding = encoding_of(kind)
    store, version = STORES[encoding], 1 if encoding == ROS1 else 2
    with path.open("wb") as stream:
        writer = McapWriter(stream, compression=CompressionType[compression.upper()])
        writer.start(profile={"mcap-ros1": "ros1", "mcap": "ros2"}.get(kind, ""))
        channels = {}
        for topic, msgtype in keys:
            text = store.generate_msgdef(msgtype, ros_version=version)[0].encode()
            name = msgtype.replace("/msg/", "/") if encoding == ROS1 else msgtype
            schema = writer.register_schema(name, f"ros{version}msg", text)
            channels[topic, msgtype] = writer.register_channel(topic, encoding, schema)
        for entry in messages:
            raw = bytes(_serialized(kind, entry))
            channel = channels[entry.topic, entry.msgtype]
            writer.add_message(channel, entry.log_ns, raw, entry.log_ns)
        writer.finish()
