"""A file of a recording that is compressed as a whole, as ``ros2 bag`` can do."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from weakref import finalize

from beamseg_batch.errors import RecordingError
from beamseg_batch.recording.container import (
    Container,
    ContainerIndex,
    Damage,
    DamageLog,
    RawMessage,
    ReadLimits,
    Span,
    readable,
)
from beamseg_batch.recording.decompression import CorruptChunkError, decompressed, read_range

__all__ = ["ZSTD_MAGIC", "ZstdFile", "uncompressed"]

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""What a zstd stream begins with."""

_FREE_BYTES = 256 << 20


class ZstdFile:
    """A compressed file, read from a copy that lasts as long as this object.

    Parameters
    ----------
    path : Path
    limits : ReadLimits
    open_file : callable
        Opens what is inside.
    """

    def __init__(
        self, path: Path, limits: ReadLimits, open_file: Callable[[Path, ReadLimits], Container]
    ) -> None:
        self.path = path
        self._limits = limits
        self._open_file = open_file
        self._damage = DamageLog(limits.strict)
        self._inside: Container | None = None
        self._copy = path

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What has been found to be damaged so far; places are of the file when decompressed."""
        inside = self._inside.damage if self._inside else ()
        return (*self._damage.places, *(replace(place, path=self.path) for place in inside))

    def files(self) -> tuple[Path, ...]:
        """The file, as it is."""
        return (self.path,)

    def label(self, index: ContainerIndex) -> str:
        """Kind of file, for people."""
        return f"{self._inside.label(index) if self._inside else 'file'}, compressed"

    def index(self) -> ContainerIndex:
        """List the topics and the time span, as the file inside does."""
        with self._as_this_file() as inside:
            return inside.index()

    def messages(self, topics: Collection[str], span: Span) -> Iterator[RawMessage]:
        """Stream the messages of some topics, as the file inside does."""
        with self._as_this_file() as inside:
            yield from inside.messages(topics, span)

    def n_left_out(self, topic: str, msgtype: str, span: Span) -> int:
        """Count the messages that are left out before a span, as the file inside does."""
        with self._as_this_file() as inside:
            return inside.n_left_out(topic, msgtype, span)

    @contextmanager
    def _as_this_file(self) -> Iterator[Container]:
        """Give what is inside; what it complains about is said of the file that people know."""
        if self._inside is None:
            folder = Path(tempfile.mkdtemp(prefix="beamseg-"))
            finalize(self, shutil.rmtree, folder, ignore_errors=True)
            with readable(self.path):
                self._copy = self._unpacked(folder)
        try:
            self._inside = self._inside or self._open_file(self._copy, self._limits)
            yield self._inside
        except RecordingError as error:
            text = str(error).replace(str(self._copy), str(self.path))
            raise RecordingError(text) from error

    def _unpacked(self, folder: Path) -> Path:
        target = folder / self.path.stem
        size = self.path.stat().st_size
        room = shutil.disk_usage(folder).free - _FREE_BYTES
        written = 0
        with self.path.open("rb") as source, target.open("wb") as stream:
            try:
                for piece in decompressed(read_range(source, 0, size), "zstd", room):
                    written += stream.write(piece)
            except CorruptChunkError as error:
                if written >= room:
                    raise RecordingError(
                        f"{self.path}: needs more than the {room >> 20} MB that are free in "
                        f"{folder.parent} when decompressed; name another place in TMPDIR"
                    ) from error
                if not written:
                    raise RecordingError(
                        f"{self.path}: a zstd file of which nothing can be decompressed: {error}"
                    ) from error
                self._damage.add(Damage(self.path, None, str(error)))
        return target


def uncompressed(data: bytes, limit: int) -> bytes:
    """Decompress a message that ``ros2 bag`` compressed on its own.

    Parameters
    ----------
    data : bytes
        Serialised as CDR, which never begins as a zstd stream does.
    limit : int
        Largest size.

    Returns
    -------
    bytes
        The same when it is not compressed, or not soundly.
    """
    if not data.startswith(ZSTD_MAGIC):
        return data
    try:
        return b"".join(decompressed(iter([data]), "zstd", limit))
    except CorruptChunkError:
        return data
