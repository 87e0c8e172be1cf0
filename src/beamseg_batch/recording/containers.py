"""The files of a recording: which kind each is, and the raw messages in it.

A container is one file, or one ROS 2 folder. It keeps no file open: each of its two
methods opens the file, so that a recording can be read any number of times and from
any process. Kinds are told by the first bytes, never by the name's ending; a new kind
is one more entry in `_KINDS` and one more class with the methods of `Container`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from os import SEEK_END
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from beamseg_batch.errors import BeamsegError, RecordingError, RecordingNotFoundError
from beamseg_batch.recording.codec import CDR, ROS1, Definition, ros2_name

if TYPE_CHECKING:
    from mcap.reader import McapReader
    from mcap.records import Channel as McapChannel
    from mcap.records import Schema as McapSchema

__all__ = [
    "Channel",
    "Container",
    "ContainerIndex",
    "RawMessage",
    "open_containers",
]

_ROSBAG1_MAGIC = b"#ROSBAG V"
_MCAP_MAGIC = b"\x89MCAP0\r\n"
_SMALLEST_MCAP_BYTES = 2 * len(_MCAP_MAGIC) + 1
_SQLITE_MAGIC = b"SQLite format 3\0"
_STORAGE_SUFFIXES = (".db3", ".mcap")
_ROSBAGS_SCHEMAS = ("ros2msg", "ros2idl", "omgidl", "")
_SCHEMA_LANGUAGES = {"ros1msg": "msg", "ros2msg": "msg", "ros2idl": "idl", "omgidl": "idl"}


class RawMessage(NamedTuple):
    """One message as it stands in the file.

    Attributes
    ----------
    topic : str
    log_time_ns : int
        When the recorder received it.
    msgtype : str
        Named as ROS 2 does, such as ``sensor_msgs/msg/PointCloud2``.
    data : bytes
    """

    topic: str
    log_time_ns: int
    msgtype: str
    data: bytes


@dataclass(frozen=True)
class Channel:
    """One topic with one message type in one container.

    Attributes
    ----------
    topic, msgtype : str
    definition : Definition
    count : int
        Number of messages.
    """

    topic: str
    msgtype: str
    definition: Definition
    count: int


@dataclass(frozen=True)
class ContainerIndex:
    """What a container holds.

    Attributes
    ----------
    channels : tuple of Channel
    start_ns, end_ns : int
        Log times of the first and the last message; both 0 when there is none.
    """

    channels: tuple[Channel, ...]
    start_ns: int
    end_ns: int

    @property
    def count(self) -> int:
        """Number of messages."""
        return sum(channel.count for channel in self.channels)


class Container(Protocol):
    """One file or folder of messages, opened afresh by each call."""

    path: Path

    def files(self) -> tuple[Path, ...]:
        """Files that hold the messages, sorted by name."""

    def label(self, index: ContainerIndex) -> str:
        """Kind of container, for people."""

    def index(self) -> ContainerIndex:
        """List the topics and the time span, without reading the messages."""

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Stream the messages of some topics in order of log time."""


def open_containers(path: Path) -> list[Container]:
    """Find the containers behind a path.

    Parameters
    ----------
    path : Path
        A ROS 1 bag, a ROS 2 folder or storage file, or an MCAP file. A folder of
        storage files without ``metadata.yaml`` gives one container per file.

    Returns
    -------
    list of Container

    Raises
    ------
    RecordingNotFoundError
        If there is nothing at the path.
    RecordingError
        If it cannot be read, is empty, or is none of these kinds.
    """
    if not path.exists():
        raise RecordingNotFoundError(f"{path}: no such file or folder")
    with _readable(path):
        return _open_folder(path) if path.is_dir() else [_open_file(path)]


def _open_folder(path: Path) -> list[Container]:
    if (path / "metadata.yaml").exists():
        return [_RosbagsContainer(path, "dir")]
    files = _storage_files(path)
    if not files:
        raise RecordingError(
            f"{path}: a folder without metadata.yaml, .db3 or .mcap files is not a ROS 2 bag; "
            "name the recording's own file"
        )
    return [_open_file(file) for file in files]


def _open_file(path: Path) -> Container:
    if not path.is_file():
        raise RecordingError(f"{path}: not a regular file")
    with path.open("rb") as stream:
        start = stream.read(16)
    if not start:
        raise RecordingError(f"{path}: the file is empty (0 bytes)")
    for magic, kind in _KINDS.items():
        if start.startswith(magic):
            return kind(path)
    raise RecordingError(
        f"{path}: not a ROS 1 bag, ROS 2 bag or MCAP file: it starts with {start!r}"
    )


def _storage_files(folder: Path) -> tuple[Path, ...]:
    """Storage files of a ROS 2 folder, compressed ones included."""
    return tuple(
        sorted(
            file
            for file in folder.iterdir()
            if file.name.removesuffix(".zstd").endswith(_STORAGE_SUFFIXES)
        )
    )


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Turn whatever a library raises on a bad file into a RecordingError."""
    try:
        yield
    except BeamsegError:
        raise
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # damaged bytes surface as anything, from zstd to AssertionError
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RecordingError(
            f"{path}: cannot be read, the file is damaged or was not closed: {reason}"
        ) from error


class _RosbagsContainer:
    """What rosbags reads: ROS 1 bags, ROS 2 folders, SQLite files and ROS 2 MCAP files."""

    def __init__(self, path: Path, storage: str) -> None:
        self.path = path
        self._storage = storage

    def files(self) -> tuple[Path, ...]:
        return _storage_files(self.path) if self._storage == "dir" else (self.path,)

    def label(self, index: ContainerIndex) -> str:
        if self._storage == "dir":
            mcap = any(".mcap" in file.name for file in self.files())
            return f"ROS 2 bag folder ({'mcap' if mcap else 'sqlite3'})"
        return {
            "bag": "ROS 1 bag",
            ".db3": "ROS 2 bag file (sqlite3)",
            ".mcap": "MCAP (ROS 2)",
        }[self._storage]

    def index(self) -> ContainerIndex:
        with _readable(self.path), self._opened() as reader:
            channels = tuple(_rosbags_channel(connection) for connection in reader.connections)
            # rosbags gives the time after the last message; an empty bag has a nonsense span.
            span = reader if self._storage == "bag" else reader.metadata
            holds = any(channel.count for channel in channels)
            start, end = (span.start_time, span.end_time - 1) if holds else (0, 0)
        return ContainerIndex(channels, start, end)

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        with _readable(self.path), self._opened() as reader:
            wanted = [c for c in reader.connections if c.topic in topics and c.msgcount]
            if not wanted:
                return
            names = {connection.msgtype: ros2_name(connection.msgtype) for connection in wanted}
            for connection, log_time_ns, data in reader.messages(wanted):
                yield RawMessage(connection.topic, log_time_ns, names[connection.msgtype], data)

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        # The readers of rosbags share their members but no type, hence Any.
        reader: Any
        if self._storage == "bag":
            from rosbags.rosbag1 import Reader as Reader1

            reader = Reader1(self.path)
        else:
            from rosbags.rosbag2 import Reader as Reader2

            # The plugin itself: Reader2 would choose it by the name's ending.
            reader = Reader2.STORAGE_PLUGINS[self._storage](self.path)
        reader.open()
        with closing(reader):
            yield reader


def _rosbags_channel(connection: Any) -> Channel:
    encoding = getattr(connection.ext, "serialization_format", ROS1)
    definition = Definition(encoding, connection.msgdef.format.name.lower(), connection.msgdef.data)
    if definition.language == "none":
        definition = Definition(encoding)
    return Channel(connection.topic, ros2_name(connection.msgtype), definition, connection.msgcount)


class _McapContainer:
    """MCAP files that rosbags refuses: another profile than ``ros2``, or schemas not of ROS 2."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def files(self) -> tuple[Path, ...]:
        return (self.path,)

    def label(self, index: ContainerIndex) -> str:
        names = {ROS1: "ROS 1", CDR: "ROS 2"}
        encodings = sorted({channel.definition.encoding for channel in index.channels})
        return f"MCAP ({', '.join(names.get(name, name) for name in encodings)})"

    def index(self) -> ContainerIndex:
        with _readable(self.path), self._opened() as reader:
            summary = reader.get_summary()
            if summary is None or summary.statistics is None or not summary.channels:
                return self._scanned_index()
            counts = summary.statistics.channel_message_counts
            channels = tuple(
                _mcap_channel(channel, summary.schemas.get(channel.schema_id), counts.get(key, 0))
                for key, channel in summary.channels.items()
            )
            statistics = summary.statistics
            return ContainerIndex(
                channels, statistics.message_start_time, statistics.message_end_time
            )

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        with _readable(self.path), self._opened() as reader:
            summary = reader.get_summary()
            indexed = summary is not None and summary.channels and summary.chunk_indexes
            stream = reader.iter_messages(topics) if indexed else self._scan(topics)
            for schema, channel, message in stream:
                msgtype = ros2_name(schema.name) if schema else ""
                yield RawMessage(channel.topic, message.log_time, msgtype, message.data)

    @contextmanager
    def _opened(self) -> Iterator[McapReader]:
        from mcap.reader import make_reader

        with self.path.open("rb") as stream:
            yield make_reader(stream, validate_crcs=True)

    def _scan(self, topics: Collection[str] | None) -> Iterator[tuple[Any, Any, Any]]:
        """Stream a file without an index in file order; sorting would need all of it."""
        from mcap.reader import NonSeekingReader

        with self.path.open("rb") as stream:
            yield from NonSeekingReader(stream, validate_crcs=True).iter_messages(
                topics, log_time_order=False
            )

    def _scanned_index(self) -> ContainerIndex:
        counts: defaultdict[int, int] = defaultdict(int)
        found: dict[int, tuple[McapChannel, McapSchema | None]] = {}
        start, end = 2**63, 0
        for schema, channel, message in self._scan(None):
            counts[channel.id] += 1
            found[channel.id] = (channel, schema)
            start, end = min(start, message.log_time), max(end, message.log_time)
        channels = tuple(_mcap_channel(*found[key], counts[key]) for key in found)
        return ContainerIndex(channels, start if found else 0, end)


def _mcap_channel(channel: McapChannel, schema: McapSchema | None, count: int) -> Channel:
    language = _SCHEMA_LANGUAGES.get(schema.encoding, "") if schema else ""
    text = schema.data.decode(errors="replace") if schema and language else ""
    definition = Definition(channel.message_encoding, language, text)
    return Channel(channel.topic, ros2_name(schema.name) if schema else "", definition, count)


def _open_mcap(path: Path) -> Container:
    """Take rosbags where it can read the file, which it does faster, else the mcap library."""
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        stream.seek(-min(len(_MCAP_MAGIC), path.stat().st_size), SEEK_END)
        if stream.read() != _MCAP_MAGIC or path.stat().st_size < _SMALLEST_MCAP_BYTES:
            raise RecordingError(
                f"{path}: cannot be read, the end of the MCAP file is missing: it was cut or "
                "was not closed"
            )
        stream.seek(0)
        reader = make_reader(stream)
        profile, summary = reader.get_header().profile, reader.get_summary()
    schemas = summary.schemas.values() if summary else ()
    foreign = [schema for schema in schemas if schema.encoding not in _ROSBAGS_SCHEMAS]
    if profile == "ros2" and not foreign:
        return _RosbagsContainer(path, ".mcap")
    return _McapContainer(path)


_KINDS: Mapping[bytes, Callable[[Path], Container]] = {
    _ROSBAG1_MAGIC: lambda path: _RosbagsContainer(path, "bag"),
    _MCAP_MAGIC: _open_mcap,
    _SQLITE_MAGIC: lambda path: _RosbagsContainer(path, ".db3"),
}
"""Kinds of files by the bytes they start with."""
