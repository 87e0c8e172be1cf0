"""Messages -> a recording, of any kind that this package reads."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.errors import ConfigError
from beamseg_batch.geometry import FloatArray
from beamseg_batch.recording.codec import CDR, ROS1, default_typestore

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

__all__ = [
    "FORMATS",
    "STATIC_TOPIC",
    "MessageWriter",
    "RecordingKind",
    "choose_kind",
    "open_writer",
]

STATIC_TOPIC = "/tf_static"
CLOUD = "sensor_msgs/msg/PointCloud2"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
_FLOAT32 = 7  # of sensor_msgs/PointField
_CHUNK_BYTES = 1 << 20
_FOREVER = "{sec: 9223372036, nsec: 854775807}"
_LATCHED = {
    "offered_qos_profiles": f"""\
- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline: {_FOREVER}
  lifespan: {_FOREVER}
  liveliness: 1
  liveliness_lease_duration: {_FOREVER}
  avoid_ros_namespace_conventions: false
"""
}
"""Tells a player of ROS 2 to keep the last message for late listeners (durability 1)."""


Sink: TypeAlias = Callable[[str, str, int, bytes], None]
"""Takes the messages of a recording: topic, type, log time in nanoseconds, bytes."""


@dataclass(frozen=True)
class _Format:
    encoding: str
    compressions: tuple[str, ...]
    """Those that can be asked for; the first one is taken if none is."""


FORMATS: Mapping[str, _Format] = {
    "bag": _Format(ROS1, ("none", "bz2", "lz4")),  # a ROS 1 bag
    "mcap": _Format(CDR, ("zstd", "lz4", "none")),  # an MCAP file of ROS 2
    "mcap-ros1": _Format(ROS1, ("zstd", "lz4", "none")),  # an MCAP file of ROS 1
    "ros2": _Format(CDR, ("none",)),  # the folder of a ROS 2 bag, with an SQLite file
    "ros2-mcap": _Format(CDR, ("zstd", "none")),  # the same with an MCAP file
    "db3": _Format(CDR, ("none",)),  # that SQLite file alone
}
"""Kinds of recordings that can be written, by name."""

_BY_SUFFIX = {".bag": "bag", ".mcap": "mcap", ".db3": "db3", "": "ros2"}


@dataclass(frozen=True)
class RecordingKind:
    """A kind of recording: the name of its format and of its compression."""

    format: str
    compression: str


def choose_kind(
    path: Path, format_: str | None = None, compression: str | None = None
) -> RecordingKind:
    """Choose how to write a recording.

    Parameters
    ----------
    path : Path
        Whose ending tells the format, if it is not named.
    format_, compression : str, optional
        Names, as in `FORMATS`.

    Returns
    -------
    RecordingKind

    Raises
    ------
    ConfigError
        If the ending is of no format, or the format has no such compression.
    """
    name = format_ or _BY_SUFFIX.get(path.suffix.lower())
    if name is None:
        raise ConfigError(
            f"{path}: the ending {path.suffix!r} tells no format; end the name in .mcap, .bag or "
            ".db3, give a folder for a ROS 2 bag, or name the format with --format"
        )
    if name not in FORMATS:
        raise ConfigError(f"unknown format {name!r}; there are: {', '.join(FORMATS)}")
    known = FORMATS[name].compressions
    if compression is not None and compression not in known:
        raise ConfigError(
            f"format {name} cannot be compressed by {compression!r}; it can by: {', '.join(known)}"
        )
    return RecordingKind(name, compression or known[0])


@dataclass(frozen=True, eq=False)
class MessageWriter:
    """Builds ROS messages and writes them; made by `open_writer`.

    Attributes
    ----------
    encoding : str
        `ROS1` or `CDR`.
    """

    encoding: str
    _sink: Sink
    _store: Typestore
    _counts: dict[str, int] = field(default_factory=dict)

    def register(self, msgtype: str, text: str) -> None:
        """Make known a type that ROS does not bring, by its definition."""
        from rosbags.typesys import get_types_from_msg

        self._store.register(get_types_from_msg(text, msgtype))

    def make(self, msgtype: str, *values: Any) -> Any:
        """Build a message of the type's fields, in their order."""
        return self._store.types[msgtype](*values)

    def fields(self, msgtype: str) -> tuple[str, ...]:
        """Names of the fields of a type, which ROS 1 and ROS 2 may define in their own ways."""
        return tuple(name for name, _ in self._store.get_msgdef(msgtype).fields)

    def header(self, topic: str, stamp_ns: int, frame: str) -> Any:
        """Build the header of the next message of a topic."""
        stamp = self.make("builtin_interfaces/msg/Time", *divmod(stamp_ns, 10**9))
        number = self._counts[topic] = self._counts.get(topic, -1) + 1
        counted = (number,) if self.encoding == ROS1 else ()
        return self.make("std_msgs/msg/Header", *counted, stamp, frame)

    def pose(self, position: FloatArray, quaternion: FloatArray) -> Any:
        """Build a pose: `position` (3,) metres, `quaternion` (4,) x, y, z, w."""
        return self.make(
            "geometry_msgs/msg/Pose",
            self.make("geometry_msgs/msg/Point", *position.tolist()),
            self.make("geometry_msgs/msg/Quaternion", *quaternion.tolist()),
        )

    def cloud(
        self, topic: str, log_ns: int, stamp_ns: int, frame: str, points: NDArray[np.float32]
    ) -> None:
        """Write a cloud.

        Parameters
        ----------
        topic : str
        log_ns, stamp_ns : int
            When it was received, and the stamp in its header.
        frame : str
        points : (H, W, 3) float32, metres
            Not finite without return.
        """
        height, width = points.shape[:2]
        fields = [
            self.make("sensor_msgs/msg/PointField", name, 4 * number, _FLOAT32, 1)
            for number, name in enumerate("xyz")
        ]
        data = np.ascontiguousarray(points, dtype="<f4").reshape(-1).view(np.uint8)
        header = self.header(topic, stamp_ns, frame)
        dense = bool(np.isfinite(points).all())
        layout = (False, 12, 12 * width)
        cloud = self.make(CLOUD, header, height, width, fields, *layout, data, dense)
        self.write(topic, CLOUD, log_ns, cloud)

    def transform(
        self,
        topic: str,
        log_ns: int,
        stamp_ns: int,
        frames: tuple[str, str],
        translation: FloatArray,
        quaternion: FloatArray,
    ) -> None:
        """Write the transform ``T_parent_child`` between two `frames`, the parent first."""
        header = self.header(topic, stamp_ns, frames[0])
        offset = self.make("geometry_msgs/msg/Vector3", *translation.tolist())
        attitude = self.make("geometry_msgs/msg/Quaternion", *quaternion.tolist())
        transform = self.make("geometry_msgs/msg/Transform", offset, attitude)
        stamped = self.make("geometry_msgs/msg/TransformStamped", header, frames[1], transform)
        self.write(topic, TRANSFORMS, log_ns, self.make(TRANSFORMS, [stamped]))

    def serialise(self, msgtype: str, message: Any) -> bytes:
        """Bytes of a message that `make` built."""
        store = self._store
        if self.encoding == ROS1:
            return bytes(store.serialize_ros1(message, msgtype))
        return bytes(store.serialize_cdr(message, msgtype))

    def write(self, topic: str, msgtype: str, log_ns: int, message: Any) -> None:
        """Write a message that `make` built, or its bytes."""
        raw = message if isinstance(message, bytes) else self.serialise(msgtype, message)
        self._sink(topic, msgtype, log_ns, raw)


@contextmanager
def open_writer(path: Path, kind: RecordingKind) -> Iterator[MessageWriter]:
    """Open a recording to write.

    Parameters
    ----------
    path : Path
        Where nothing is yet.
    kind : RecordingKind

    Yields
    ------
    MessageWriter
    """
    encoding = FORMATS[kind.format].encoding
    store = default_typestore(encoding)
    with _OPENERS[kind.format](path, kind.compression, store) as sink:
        yield MessageWriter(encoding, sink, store)


@contextmanager
def _open_bag(path: Path, compression: str, store: Typestore) -> Iterator[Sink]:
    from rosbags.rosbag1 import Writer

    writer = Writer(path)
    if compression != "none":
        writer.set_compression(Writer.CompressionFormat[compression.upper()])
    connections: dict[str, Any] = {}

    def sink(topic: str, msgtype: str, log_ns: int, raw: bytes) -> None:
        if topic not in connections:
            latching = int(topic == STATIC_TOPIC)
            connections[topic] = writer.add_connection(
                topic, msgtype, typestore=store, latching=latching
            )
        writer.write(connections[topic], log_ns, raw)

    with writer:
        yield sink


@contextmanager
def _open_folder(path: Path, compression: str, store: Typestore, storage: str) -> Iterator[Sink]:
    import sqlite3

    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage])
    if compression != "none":
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    connections: dict[str, Any] = {}

    def sink(topic: str, msgtype: str, log_ns: int, raw: bytes) -> None:
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, msgtype, typestore=store)
        writer.write(connections[topic], log_ns, raw)

    try:
        with writer:
            yield sink
    except sqlite3.Error as error:  # a full disk, for example
        raise OSError(f"SQLite: {error}") from error


@contextmanager
def _open_db3(path: Path, compression: str, store: Typestore) -> Iterator[Sink]:
    folder = path.with_name(f"{path.name}.folder")
    with _open_folder(folder, compression, store, "SQLITE3") as sink:
        yield sink
    (folder / f"{folder.name}.db3").rename(path)
    (folder / "metadata.yaml").unlink()
    folder.rmdir()


@contextmanager
def _open_mcap(path: Path, compression: str, store: Typestore, version: int) -> Iterator[Sink]:
    from mcap.writer import CompressionType, Writer

    encoding = ROS1 if version == 1 else CDR
    channels: dict[str, int] = {}
    with path.open("xb") as stream:
        writer = Writer(
            stream, chunk_size=_CHUNK_BYTES, compression=CompressionType[compression.upper()]
        )
        writer.start(profile=f"ros{version}", library="beamseg")

        def sink(topic: str, msgtype: str, log_ns: int, raw: bytes) -> None:
            if topic not in channels:
                text = store.generate_msgdef(msgtype, ros_version=version)[0].encode()
                name = msgtype.replace("/msg/", "/") if version == 1 else msgtype
                schema = writer.register_schema(name, f"ros{version}msg", text)
                quality = _LATCHED if version == 2 and topic == STATIC_TOPIC else {}
                channels[topic] = writer.register_channel(topic, encoding, schema, quality)
            writer.add_message(channels[topic], log_ns, raw, log_ns)

        yield sink
        if version == 2:
            writer.add_metadata("rosbag2", {})  # without it, numbers in `_LATCHED` are refused
        writer.finish()  # type: ignore[no-untyped-call]


_OPENERS: Mapping[str, Callable[[Path, str, Typestore], AbstractContextManager[Sink]]] = {
    "bag": _open_bag,
    "mcap": partial(_open_mcap, version=2),
    "mcap-ros1": partial(_open_mcap, version=1),
    "ros2": partial(_open_folder, storage="SQLITE3"),
    "ros2-mcap": partial(_open_folder, storage="MCAP"),
    "db3": _open_db3,
}
