"""What every kind of recording file has in common: messages, channels, damage, limits."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

from beamseg_batch.errors import BeamsegError, RecordingError
from beamseg_batch.recording.codec import Definition

__all__ = [
    "Channel",
    "Container",
    "ContainerIndex",
    "Damage",
    "DamageLog",
    "RawMessage",
    "ReadLimits",
    "Span",
    "readable",
    "told",
]


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


class Span(NamedTuple):
    """A range of log times; what lies outside of it need not be read.

    Attributes
    ----------
    first_ns, last_ns : int
        Both belong to it.
    """

    first_ns: int = -(2**63)
    last_ns: int = 2**63 - 1


@dataclass(frozen=True)
class Channel:
    """One topic with one message type in one container.

    Attributes
    ----------
    topic, msgtype : str
    definition : Definition
    count : int
        Number of messages, those included that turn out to be lost.
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
    content_bytes : int
        Size of the messages when decompressed, or somewhat more.
    """

    channels: tuple[Channel, ...]
    start_ns: int
    end_ns: int
    content_bytes: int

    @property
    def count(self) -> int:
        """Number of messages."""
        return sum(channel.count for channel in self.channels)


@dataclass(frozen=True)
class Damage:
    """One damaged place of a file.

    Attributes
    ----------
    path : Path
    offset : int or None
        Byte of the file where it begins; None where a place has no meaning.
    problem : str
        What is wrong there.
    lost_messages : int or None
        None when not known.
    lost_bytes : int or None
        Bytes of the file that could not be used; None when not known.
    """

    path: Path
    offset: int | None
    problem: str
    lost_messages: int | None = None
    lost_bytes: int | None = None

    def __str__(self) -> str:
        place = "" if self.offset is None else f"byte {self.offset}: "
        return f"{place}{self.problem}{_loss(self.lost_messages, self.lost_bytes)}"


def _loss(messages: int | None, size: int | None) -> str:
    """Say what was lost, as the tail of a sentence."""
    if messages == 0:
        return "; no message is lost"
    if messages is not None:
        return f"; {_number(messages, 'message')} lost"
    return f"; {_number(size, 'byte')} lost" if size else ""


def _number(count: int, word: str) -> str:
    return f"{count} {word}{'' if count == 1 else 's'}"


@dataclass(frozen=True)
class ReadLimits:
    """How far a file is trusted.

    Attributes
    ----------
    strict : bool
        Whether damage is an error.
    max_chunk_bytes : int
        Largest chunk to decompress.
    """

    strict: bool = False
    max_chunk_bytes: int = 1024 << 20


class DamageLog:
    """The damage of one container, each place once, however often it is read.

    Parameters
    ----------
    strict : bool
        Whether damage is an error.
    """

    def __init__(self, strict: bool) -> None:
        self._strict = strict
        self._places: dict[tuple[Path, int | None], Damage] = {}

    def add(self, damage: Damage) -> None:
        """Take note of a damaged place.

        Parameters
        ----------
        damage : Damage
            Ignored when its place is known: what is behind the first problem follows
            from it.

        Raises
        ------
        RecordingError
            If damage is not to be tolerated.
        """
        if self._strict:
            raise RecordingError(f"{damage.path}: {damage}; see recording.strict")
        self._places.setdefault((damage.path, damage.offset), damage)

    @property
    def places(self) -> tuple[Damage, ...]:
        """All of it, in the order in which it was found."""
        return tuple(self._places.values())


def told(places: Collection[Damage]) -> Iterator[str]:
    """One sentence per damaged file, for people.

    Parameters
    ----------
    places : collection of Damage

    Yields
    ------
    str
    """
    for path in dict.fromkeys(place.path for place in places):
        first, *others = (place for place in places if place.path == path)
        text = f"{path}: is damaged, what is whole is used: {first}"
        if others:
            text += f"; and {_number(len(others), 'further place')}"
            messages = sum(place.lost_messages or 0 for place in (first, *others))
            if messages:
                unknown = any(place.lost_messages is None for place in (first, *others))
                least = "at least " if unknown else ""
                text += f"; {least}{_number(messages, 'message')} lost in all"
        yield text


class Container(Protocol):
    """One file or folder of messages; none of its files stays open between two calls."""

    path: Path

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What has been found to be damaged so far, each place once."""

    def files(self) -> tuple[Path, ...]:
        """Files that hold the messages, sorted by name."""

    def label(self, index: ContainerIndex) -> str:
        """Kind of container, for people."""

    def index(self) -> ContainerIndex:
        """List the topics and the time span."""

    def messages(self, topics: Collection[str], span: Span) -> Iterator[RawMessage]:
        """Stream the messages of some topics in order of log time.

        Those outside of the span are left out where that saves reading them.
        """

    def n_left_out(self, topic: str, msgtype: str, span: Span) -> int:
        """Count the messages of a topic and type that `messages` leaves out before a span."""


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Turn whatever a library raises on a bad file into a RecordingError.

    Parameters
    ----------
    path : Path
        The file, for the message.

    Raises
    ------
    RecordingError
    """
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
