"""Compressed bytes -> bytes, in pieces of bounded size."""

from __future__ import annotations

import bz2
import sys
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from typing import Any, BinaryIO

__all__ = ["PIECE_BYTES", "CorruptChunkError", "decompressed", "read_range"]

PIECE_BYTES = 16 << 20
"""Most bytes of a chunk that are in memory at a time."""


class CorruptChunkError(Exception):
    """The bytes of a chunk contradict their format, their checksum or the limits."""


def decompressed(pieces: Iterator[bytes], compression: str, limit: int) -> Iterator[bytes]:
    """Decompress a stream.

    Parameters
    ----------
    pieces : iterator of bytes
        The compressed stream, which may end too early.
    compression : str
        ``none`` or empty, ``bz2``, ``lz4`` or ``zstd``.
    limit : int
        Bytes that it holds at most.

    Yields
    ------
    bytes
        At most `PIECE_BYTES` long. They end where the stream ends, or where it is cut.

    Raises
    ------
    CorruptChunkError
        If the compression is not known, or the stream is corrupt or holds more. What
        came before, as fine as the pieces are, has been handed out.
    """
    if compression in ("", "none"):
        yield from _limited(pieces, limit)
        return
    make = _DECOMPRESSORS.get(compression)
    if make is None:
        raise CorruptChunkError(f"the compression {compression!r} of a chunk is not known")
    # One byte more than there should be: only behind the last one a stream is checked.
    decompressor, left = make(), limit + 1
    while not decompressor.eof:
        piece = next(pieces, b"") if decompressor.needs_input else b""
        if decompressor.needs_input and not piece:
            return
        try:
            data = decompressor.decompress(piece, min(left, PIECE_BYTES))
        except Exception as error:  # each library has errors of its own
            reason = " ".join(str(error).split())
            raise CorruptChunkError(f"a chunk does not decompress: {reason}") from error
        left -= len(data)
        if data:
            yield data if left else data[:-1]
        if not left:
            raise CorruptChunkError("a chunk is larger than it claims")


def read_range(stream: BinaryIO, start: int, size: int, step: int = PIECE_BYTES) -> Iterator[bytes]:
    """Read a range of a file in pieces; they end at its end.

    Parameters
    ----------
    stream : binary file
        May be used by others between two pieces.
    start, size : int
    step : int
        Size of a piece.

    Yields
    ------
    bytes
    """
    end = start + size
    while start < end:
        stream.seek(start)
        piece = stream.read(min(step, end - start))
        if not piece:
            return
        start += len(piece)
        yield piece


def _limited(pieces: Iterator[bytes], limit: int) -> Iterator[bytes]:
    for piece in pieces:
        yield piece[:limit]
        limit -= len(piece)
        if limit <= 0:
            return


def _lz4() -> Any:
    from lz4.frame import LZ4FrameDecompressor

    return LZ4FrameDecompressor()


def _zstd() -> Any:
    # Part of Python since 3.14.
    name = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
    return import_module(name).ZstdDecompressor()


_DECOMPRESSORS: Mapping[str, Callable[[], Any]] = {
    "bz2": bz2.BZ2Decompressor,
    "lz4": _lz4,
    "zstd": _zstd,
}
