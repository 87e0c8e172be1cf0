"""A recording: one or several containers read as one stream of messages."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from functools import cached_property, partial
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from beamseg_batch.config import RecordingConfig
from beamseg_batch.errors import DuplicateRecordingError, RecordingError
from beamseg_batch.recording.codec import CDR, Definition, MessageCodec
from beamseg_batch.recording.container import (
    Channel,
    Container,
    Damage,
    DamageLog,
    RawMessage,
    ReadLimits,
    Span,
    told,
)
from beamseg_batch.recording.container_zstd import uncompressed
from beamseg_batch.recording.containers import open_containers
from beamseg_batch.recording.merging import Part, in_time_order, readable_parts

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
        parts: Sequence[Part],
        damage: DamageLog,
        limits: ReadLimits,
    ) -> None:
        self.paths = tuple(paths)
        self._containers = tuple(container for container, _ in parts)
        self._indexes = tuple(index for _, index in parts)
        self._damage = damage
        self._limits = limits
        self._codec = MessageCodec(_definitions(self._channels()))
        self._held_topics: frozenset[str] = frozenset()
        self._held: list[RawMessage] = []
        self._span = Span()

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

    @property
    def damage(self) -> tuple[Damage, ...]:
        """Damage found so far; what lies inside of chunks is found when it is read."""
        inside = (place for container in self._containers for place in container.damage)
        return (*self._damage.places, *inside)

    @property
    def damage_places(self) -> tuple[str, ...]:
        """The damage for people, one sentence per place."""
        return tuple(f"{place.path}: {place}" for place in self.damage)

    @property
    def damage_notes(self) -> tuple[str, ...]:
        """The damage for people, one sentence per file."""
        return tuple(told(self.damage))

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
        if sum(index.content_bytes for index in self._indexes) > _MOST_HELD_BYTES:
            return
        names, held, size = frozenset(topics), [], 0
        with suppress(RecordingError):  # whoever reads that far is told
            for raw in self._stream(names):
                size += len(raw.data)
                if size > _MOST_HELD_BYTES:  # messages may be compressed one by one
                    return
                held.append(raw)
            self._held_topics, self._held = names, held

    def within(self, span: Span) -> Recording:
        """Return the same recording, of which other messages need not be read.

        Parameters
        ----------
        span : Span

        Returns
        -------
        Recording
            Its topics, counts and times are those of the whole.
        """
        part = copy(self)
        part._span = span
        return part

    def n_left_out(self, topic: TopicInfo) -> int:
        """Count the messages of a topic that lie before `within` and are not read."""
        if topic.name in self._held_topics:
            return 0
        containers = self._containers
        return sum(c.n_left_out(topic.name, topic.msgtype, self._span) for c in containers)

    def _stream(self, names: frozenset[str]) -> Iterator[RawMessage]:
        opens = [partial(c.messages, names, self._span) for c in self._containers]
        starts = [index.start_ns for index in self._indexes]
        parts = list(zip(starts, opens, strict=True))
        stream = opens[0]() if len(opens) == 1 else in_time_order(parts)
        if any(channel.definition.encoding == CDR for channel in self._channels()):
            return map(self._uncompressed, stream)
        return stream

    def _uncompressed(self, raw: RawMessage) -> RawMessage:
        data = uncompressed(raw.data, self._limits.max_chunk_bytes)
        return raw if data is raw.data else raw._replace(data=data)

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


def open_recording(
    path_or_paths: AnyPath | Sequence[AnyPath], config: RecordingConfig | None = None
) -> Recording:
    """Open a recorded flight.

    Parameters
    ----------
    path_or_paths : path, or sequence of paths
        ROS 1 bag, ROS 2 bag folder or storage file, or MCAP, or a folder of these;
        several paths are read as one recording, in order of log time.
    config : RecordingConfig, optional
        Whether damage is tolerated, and how large a chunk may be.

    Returns
    -------
    Recording

    Raises
    ------
    RecordingNotFoundError
        If a path does not exist.
    DuplicateRecordingError
        If a file is given twice.
    RecordingError
        If no file can be read or holds a message, or if one is damaged and
        ``recording.strict`` is set.
    """
    config = config or RecordingConfig()
    limits = ReadLimits(config.strict, config.max_chunk_mb << 20)
    damage = DamageLog(limits.strict)
    given = [path_or_paths] if isinstance(path_or_paths, str | PathLike) else path_or_paths
    paths = [Path(path) for path in given]
    if not paths:
        raise RecordingError("no path of a recording was given")
    containers = [c for path in paths for c in open_containers(path, limits, damage)]
    _refuse_twice(containers)
    parts = readable_parts(containers, damage)
    recording = Recording(paths, parts, damage, limits)
    if not any(index.count for _, index in parts):
        raise RecordingError(_why_empty(recording))
    return recording


def _why_empty(recording: Recording) -> str:
    if not recording.damage:
        return f"{recording.name}: the recording holds no messages"
    return (
        f"{recording.name}: not one message can be read; it seems to be a damaged "
        f"{recording.container} of {recording.size_bytes} bytes: {recording.damage[0]}"
    )


def _refuse_twice(containers: Sequence[Container]) -> None:
    """A file read twice would count every scan twice."""
    seen: set[str] = set()
    for file in (file for container in containers for file in container.files()):
        real = os.path.realpath(file)
        if real in seen:
            raise DuplicateRecordingError(
                f"{file}: is given twice; name each part of a flight once"
            )
        seen.add(real)


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
