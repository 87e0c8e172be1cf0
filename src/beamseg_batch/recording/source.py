"""A recording: one or several containers read as one stream of messages."""

from __future__ import annotations

import hashlib
import heapq
import os
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from beamseg_batch.errors import DuplicateRecordingError, RecordingError
from beamseg_batch.recording.codec import Definition, MessageCodec
from beamseg_batch.recording.containers import (
    Channel,
    Container,
    ContainerIndex,
    RawMessage,
    open_containers,
)

__all__ = ["AnyPath", "Recording", "TopicInfo", "open_recording"]

AnyPath: TypeAlias = str | PathLike[str]

T = TypeVar("T")

_HASH_BLOCK_BYTES = 1 << 20
_MOST_HELD_BYTES = 64 << 20


@dataclass(frozen=True)
class TopicInfo:
    """One topic of a recording.

    Attributes
    ----------
    name : str
    msgtype : str
        Named as ROS 2 does, such as ``sensor_msgs/msg/PointCloud2``.
    count : int
        Number of messages.
    """

    name: str
    msgtype: str
    count: int


class Recording:
    """The messages of one flight, read as often as needed.

    Made by `open_recording`. No file stays open between calls, and memory does not
    grow with the size of the files, apart from their own indexes and what `hold` keeps.

    Attributes
    ----------
    paths : tuple of Path
        As they were given.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        containers: Sequence[Container],
        indexes: Sequence[ContainerIndex],
    ) -> None:
        self.paths = tuple(paths)
        self._containers = tuple(containers)
        self._indexes = tuple(indexes)
        self._codec = MessageCodec(_definitions(self._channels()))
        self._held_topics: frozenset[str] = frozenset()
        self._held: list[RawMessage] = []

    def _channels(self) -> list[Channel]:
        return [channel for index in self._indexes for channel in index.channels]

    @property
    def name(self) -> str:
        """The paths, as messages for people begin with."""
        return ", ".join(map(str, self.paths))

    @property
    def container(self) -> str:
        """Kind of the files, for people, such as ``ROS 1 bag``."""
        pairs = zip(self._containers, self._indexes, strict=True)
        labels = dict.fromkeys(container.label(index) for container, index in pairs)
        return " + ".join(labels)

    @cached_property
    def topics(self) -> tuple[TopicInfo, ...]:
        """Topics sorted by name, with the number of messages of each."""
        counts: dict[tuple[str, str], int] = {}
        for channel in self._channels():
            key = (channel.topic, channel.msgtype)
            counts[key] = counts.get(key, 0) + channel.count
        return tuple(TopicInfo(*key, count) for key, count in sorted(counts.items()))

    @property
    def start_ns(self) -> int:
        """Log time of the first message, in nanoseconds."""
        return min(index.start_ns for index in self._indexes if index.count)

    @property
    def end_ns(self) -> int:
        """Log time of the last message, in nanoseconds."""
        return max(index.end_ns for index in self._indexes if index.count)

    def seconds(self, stamp_ns: int) -> float:
        """Time of a stamp as people read it: seconds since the start of the recording."""
        return (stamp_ns - self.start_ns) * 1e-9

    @property
    def files(self) -> tuple[Path, ...]:
        """Files that hold the messages."""
        return tuple(file for container in self._containers for file in container.files())

    @property
    def size_bytes(self) -> int:
        """Size of all files together."""
        return sum(file.stat().st_size for file in self.files)

    @cached_property
    def sha256(self) -> str:
        """Hash over the bytes of all files, in order; computed when first asked for."""
        digest = hashlib.sha256()
        for file in self.files:
            try:
                with file.open("rb") as stream:
                    while block := stream.read(_HASH_BLOCK_BYTES):
                        digest.update(block)
            except OSError as error:
                raise RecordingError(f"{file}: cannot be read: {error.strerror}") from error
        return digest.hexdigest()

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Stream the messages of some topics in order of log time.

        Parameters
        ----------
        topics : collection of str

        Yields
        ------
        RawMessage
            ``(topic, log_time_ns, msgtype, data)``.

        Raises
        ------
        RecordingError
            If a file cannot be read any further.
        """
        names = frozenset(topics)
        if names <= self._held_topics:
            return (raw for raw in self._held if raw.topic in names)
        return self._stream(names)

    def hold(self, topics: Collection[str]) -> None:
        """Keep the messages of some topics in memory, if they are few, for all later passes.

        Poses and clouds lie in the same compressed chunks: read together, each chunk is
        read and decompressed once.

        Parameters
        ----------
        topics : collection of str
        """
        if self.size_bytes > _MOST_HELD_BYTES:
            return
        names, held, size = frozenset(topics), [], 0
        with suppress(RecordingError):  # whoever reads that far is told
            for raw in self._stream(names):
                size += len(raw.data)
                if size > _MOST_HELD_BYTES:
                    return
                held.append(raw)
            self._held_topics, self._held = names, held

    def _stream(self, names: frozenset[str]) -> Iterator[RawMessage]:
        streams = [container.messages(names) for container in self._containers]
        if len(streams) == 1:
            return streams[0]
        return heapq.merge(*streams, key=lambda message: message.log_time_ns)

    def topic_messages(self, topic: TopicInfo) -> Iterator[RawMessage]:
        """Stream the messages of one topic that have its type: a name may stand for several.

        Parameters
        ----------
        topic : TopicInfo

        Yields
        ------
        RawMessage

        Raises
        ------
        RecordingError
            If a file cannot be read any further.
        """
        return (raw for raw in self.messages([topic.name]) if raw.msgtype == topic.msgtype)

    def encoding_of(self, msgtype: str) -> str:
        """Encoding of the messages of a type, such as ``cdr``."""
        return self._codec.encoding_of(msgtype)

    def read(self, raw: RawMessage, extract: Callable[[Any], T]) -> T:
        """Decode a message and take from it what is needed.

        Parameters
        ----------
        raw : RawMessage
        extract : callable
            From the message object to the result.

        Returns
        -------
        object
            What `extract` returns.

        Raises
        ------
        UndecodableMessageError
            If the bytes do not fit the type, or the type lacks a field that is needed.
        """
        return self._codec.read(raw.data, raw.msgtype, extract)


def open_recording(path_or_paths: AnyPath | Sequence[AnyPath]) -> Recording:
    """Open a recorded flight.

    Parameters
    ----------
    path_or_paths : path, or sequence of paths
        ROS 1 bag, ROS 2 bag folder or storage file, or MCAP; several paths are read
        as one recording, in order of log time.

    Returns
    -------
    Recording

    Raises
    ------
    RecordingNotFoundError
        If a path does not exist.
    DuplicateRecordingError
        If a path is given twice.
    RecordingError
        If a file is not a recording, cannot be read, or if no file holds a message.
    """
    given = [path_or_paths] if isinstance(path_or_paths, str | PathLike) else path_or_paths
    paths = [Path(path) for path in given]
    if not paths:
        raise RecordingError("no path of a recording was given")
    _refuse_twice(paths)
    containers = [container for path in paths for container in open_containers(path)]
    indexes = [container.index() for container in containers]
    if not any(index.count for index in indexes):
        raise RecordingError(f"{', '.join(map(str, paths))}: the recording holds no messages")
    return Recording(paths, containers, indexes)


def _refuse_twice(paths: Sequence[Path]) -> None:
    """A file read twice would count every scan twice."""
    seen: dict[str, Path] = {}
    for path in paths:
        first = seen.setdefault(os.path.realpath(path), path)
        if first is not path:
            raise DuplicateRecordingError(
                f"{path}: is given twice; name each part of a flight once"
            )


def _definitions(channels: Sequence[Channel]) -> dict[str, Definition]:
    """Pick one definition per message type, one with a text before one without."""
    definitions: dict[str, Definition] = {}
    for channel in channels:
        known = definitions.setdefault(channel.msgtype, channel.definition)
        if known.encoding != channel.definition.encoding:
            raise RecordingError(
                f"the recording holds {channel.msgtype} in two encodings, {known.encoding} and "
                f"{channel.definition.encoding}; give files of one kind"
            )
        if not known.text:
            definitions[channel.msgtype] = channel.definition
    return definitions
