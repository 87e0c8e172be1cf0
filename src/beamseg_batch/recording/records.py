"""Chains of records, and how to take one up again where it is broken.

ROS 1 bags and MCAP files are records, one after another, each with its length. A file is
followed by these lengths from its first byte, wherever its own index says that things
are: an index may be missing or wrong. Where the chain breaks, the next record that fits
the format, and is followed by another, takes it up.
"""

from __future__ import annotations

from collections.abc import Iterator
from os import SEEK_END
from typing import BinaryIO, NamedTuple, Protocol

__all__ = [
    "Break",
    "BufferSource",
    "FileSource",
    "Record",
    "RecordFormat",
    "Source",
    "follow",
    "search",
]

_SEARCH_BYTES = 1 << 20
_OVERLAP_BYTES = 4096
_MOST_CANDIDATES = 100_000


class Source(Protocol):
    """Bytes to take records from."""

    size: int

    def at(self, offset: int, count: int) -> bytes:
        """Bytes from an offset on; fewer where they end."""


class FileSource:
    """The bytes of an open file."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.size = stream.seek(0, SEEK_END)

    def at(self, offset: int, count: int) -> bytes:
        """Bytes from an offset on; fewer where the file ends."""
        self._stream.seek(offset)
        return self._stream.read(count)


class BufferSource:
    """Bytes in memory."""

    def __init__(self, buffer: bytes) -> None:
        self._buffer = buffer
        self.size = len(buffer)

    def at(self, offset: int, count: int) -> bytes:
        """Bytes from an offset on; fewer where they end."""
        return self._buffer[offset : offset + count]


class Record(NamedTuple):
    """One record: what it is, and where it lies.

    Attributes
    ----------
    op : int
        Its kind, as the format numbers them.
    offset, body, end : int
        Where it begins, where its content begins, and the byte after it.
    fields : dict of bytes to bytes
        Header fields by name, in formats that have them.
    """

    op: int
    offset: int
    body: int
    end: int
    fields: dict[bytes, bytes]


class Break(NamedTuple):
    """A place where the chain is broken.

    Attributes
    ----------
    offset : int
        Where no whole record begins.
    following : int or None
        Where the chain goes on, which may lie before the offset: in a record whose
        length was wrong. None when it does not.
    """

    offset: int
    following: int | None


class RecordFormat(Protocol):
    """What must be known of a format to follow its records."""

    chunk_op: int

    def record(self, source: Source, offset: int) -> Record | None:
        """Record at an offset, which may claim to end behind the source; None if it is none."""

    def candidates(self, buffer: bytes) -> Iterator[int]:
        """Positions in a buffer where a record may begin."""


def follow(format_: RecordFormat, source: Source, offset: int) -> Iterator[Record | Break]:
    """Follow a chain of records.

    Parameters
    ----------
    format_ : RecordFormat
    source : Source
    offset : int
        Where the first record begins.

    Yields
    ------
    Record or Break
        Whole records in order. A chunk that is not whole comes right before its break.
    """
    known = offset  # behind the head of the last record: its length may be what is wrong
    while offset < source.size:
        record = format_.record(source, offset)
        if record is not None:
            known = record.body
            if record.end <= source.size:
                yield record
                offset = record.end
                continue
            if record.op == format_.chunk_op:
                yield record
        following = search(format_, source, known)
        yield Break(offset, following)
        if following is None:
            return
        known, offset = following + 1, following


def search(format_: RecordFormat, source: Source, offset: int) -> int | None:
    """Find the next record that another one follows.

    Parameters
    ----------
    format_ : RecordFormat
    source : Source
    offset : int
        Where to begin.

    Returns
    -------
    int or None
    """
    tried = 0
    while offset < source.size:
        window = source.at(offset, _SEARCH_BYTES + _OVERLAP_BYTES)
        for position in format_.candidates(window):
            if position >= _SEARCH_BYTES:
                break
            if _is_followed(format_, source, offset + position):
                return offset + position
            tried += 1
            if tried > _MOST_CANDIDATES:
                return None
        offset += _SEARCH_BYTES
    return None


def _is_followed(format_: RecordFormat, source: Source, offset: int) -> bool:
    record = format_.record(source, offset)
    if record is None:
        return False
    if record.end >= source.size:
        return record.end == source.size or record.op == format_.chunk_op
    return format_.record(source, record.end) is not None
