"""Files of records, read block by block: ROS 1 bags and MCAP files.

A block is a chunk, or a run of records that are in no chunk. It is the unit of reading:
whatever is wrong in one costs no other. Of a block no more than a piece is in memory.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_left
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import BinaryIO, Protocol, TypeAlias
from zlib import crc32

from beamseg_batch.recording.codec import Definition
from beamseg_batch.recording.container import (
    Channel,
    ContainerIndex,
    Damage,
    DamageLog,
    RawMessage,
    ReadLimits,
    Span,
    readable,
)
from beamseg_batch.recording.decompression import (
    PIECE_BYTES,
    CorruptChunkError,
    decompressed,
    read_range,
)
from beamseg_batch.recording.records import (
    Break,
    BufferSource,
    FileSource,
    Record,
    RecordFormat,
    search,
)

__all__ = ["Block", "BlockFile", "BlockFormat", "ChannelInfo", "FileMap", "Found"]

_CAREFUL_BYTES = 2048
_MOST_HEADER_BYTES = 4096
_MOST_HELD_BYTES = 64 << 20
_MESSAGE_OVERHEAD_BYTES = 200

Message: TypeAlias = tuple[int, int, bytes]
"""Log time, channel, data."""


@dataclass(slots=True)
class Block:
    """A chunk, or a run of records that are in no chunk.

    Attributes
    ----------
    offset : int
        Where it begins in the file.
    body, size : int
        Its stored bytes.
    compression : str
        Empty for none.
    full_size : int
        Bytes when decompressed.
    crc : int
        Of the decompressed bytes; 0 when not known.
    counts : Counter of int, or None
        Messages by channel; None when the file does not say.
    first_ns, last_ns : int
        Log times of its first and last message.
    cut : bool
        Whether its end is missing.
    """

    offset: int
    body: int
    size: int
    compression: str = ""
    full_size: int = 0
    crc: int = 0
    counts: Counter[int] | None = None
    first_ns: int = 2**63
    last_ns: int = 0
    cut: bool = False

    @property
    def is_run(self) -> bool:
        """Whether it is a run of records that are in no chunk."""
        return self.offset == self.body

    @property
    def end(self) -> int:
        """Byte after it."""
        return self.body + self.size

    def cut_at(self, offset: int) -> None:
        """Mark that the block has no bytes from an offset of the file on."""
        self.size, self.cut = max(offset - self.body, 0), True
        self.forget_index()
        if not self.compression:
            self.full_size = self.size

    def forget_index(self) -> None:
        """Make the block's own messages decide what it holds."""
        self.counts, self.first_ns, self.last_ns = None, 2**63, 0

    def add(self, counts: Counter[int], first_ns: int, last_ns: int) -> None:
        """Note messages that the block holds."""
        self.counts = (self.counts or Counter()) + counts
        self.first_ns, self.last_ns = min(self.first_ns, first_ns), max(self.last_ns, last_ns)


@dataclass(frozen=True)
class ChannelInfo:
    """What the messages of a channel are."""

    topic: str
    msgtype: str
    definition: Definition


@dataclass
class FileMap:
    """What a walk through a file finds.

    Attributes
    ----------
    blocks : list of Block
        In the order of the file.
    channels : dict of int to ChannelInfo
        Those that stand outside of chunks; more may be found inside.
    """

    blocks: list[Block] = field(default_factory=list)
    channels: dict[int, ChannelInfo] = field(default_factory=dict)

    def add_to_run(self, record: Record, channel: int, log_time_ns: int) -> None:
        """Add a message that is in no chunk to the run of such messages before it."""
        last = self.blocks[-1] if self.blocks else None
        if last is None or not last.is_run or last.end != record.offset or last.size > PIECE_BYTES:
            last = Block(record.offset, record.offset, 0)
            self.blocks.append(last)
        last.size = last.full_size = record.end - last.body
        last.add(Counter({channel: 1}), log_time_ns, log_time_ns)

    @property
    def counts(self) -> Counter[int]:
        """Messages by channel."""
        counts: Counter[int] = Counter()
        for block in self.blocks:
            counts.update(block.counts or {})
        return counts


@dataclass
class Found:
    """What is read from the records of a block.

    Attributes
    ----------
    wanted : collection of int
        Channels of which the messages are kept.
    messages : list of (log time, channel, data)
    counts : Counter of int
        All messages by channel.
    channels : dict of int to ChannelInfo
    first_ns, last_ns : int
        Log times of all messages.
    """

    wanted: Collection[int] = ()
    messages: list[Message] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)
    channels: dict[int, ChannelInfo] = field(default_factory=dict)
    first_ns: int = 2**63
    last_ns: int = 0

    def saw(self, channel: int, log_time_ns: int) -> None:
        """Note a message."""
        self.counts[channel] += 1
        self.first_ns = min(self.first_ns, log_time_ns)
        self.last_ns = max(self.last_ns, log_time_ns)

    def taken(self) -> list[Message]:
        """Hand over the messages kept so far, in order of log time."""
        messages, self.messages = self.messages, []
        messages.sort(key=itemgetter(0))
        return messages


class BlockFormat(RecordFormat, Protocol):
    """What must be known of a format to read its blocks."""

    def parse(self, buffer: bytes, position: int, found: Found) -> int:
        """Read records; stop at the first that is incomplete or none, and say where."""


class BlockFile(ABC):
    """A file of records, read block by block.

    Parameters
    ----------
    path : Path
    limits : ReadLimits
    """

    _format: BlockFormat

    def __init__(self, path: Path, limits: ReadLimits) -> None:
        self.path = path
        self._damage = DamageLog(limits.strict)
        self._limits = limits
        self._map = FileMap()

    @abstractmethod
    def label(self, index: ContainerIndex) -> str:
        """Kind of file, for people."""

    @abstractmethod
    def _walk(self, source: FileSource) -> None:
        """Fill the map of the file, without reading its messages."""

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What has been found to be damaged so far."""
        return self._damage.places

    def files(self) -> tuple[Path, ...]:
        """The file."""
        return (self.path,)

    def index(self) -> ContainerIndex:
        """List the topics and the time span; messages are read only where they are not told.

        Returns
        -------
        ContainerIndex

        Raises
        ------
        RecordingError
            If the file cannot be read, or is damaged and that is not tolerated.
        """
        with readable(self.path), self.path.open("rb") as stream:
            self._map = FileMap()
            self._walk(FileSource(stream))
            for block in self._map.blocks:
                if block.counts is None:
                    found = self._explore(stream, block)
                    block.add(found.counts, found.first_ns, found.last_ns)
            self._find_channels(stream)
        counts = self._map.counts
        told = [block for block in self._map.blocks if block.counts]
        return ContainerIndex(
            tuple(
                Channel(info.topic, info.msgtype, info.definition, counts[key])
                for key, info in self._map.channels.items()
            ),
            min((block.first_ns for block in told), default=0),
            max((block.last_ns for block in told), default=0),
            sum(block.full_size for block in self._map.blocks),
        )

    def messages(self, topics: Collection[str], span: Span) -> Iterator[RawMessage]:
        """Stream the messages of some topics in order of log time.

        Where blocks overlap by more than 64 MB of messages, those are in file order.

        Parameters
        ----------
        topics : collection of str
        span : Span
            Blocks outside of it are not read.

        Yields
        ------
        RawMessage

        Raises
        ------
        RecordingError
            If the file cannot be read, or is damaged and that is not tolerated.
        """
        wanted = {key: info for key, info in self._map.channels.items() if info.topic in topics}
        with readable(self.path), self.path.open("rb") as stream:
            for log_time_ns, key, data in self._in_time_order(stream, frozenset(wanted), span):
                info = wanted[key]
                yield RawMessage(info.topic, log_time_ns, info.msgtype, data)

    def n_left_out(self, topic: str, msgtype: str, span: Span) -> int:
        """Count the messages of a topic and type in the blocks before a span."""
        channels = self._map.channels.items()
        keys = [key for key, info in channels if (info.topic, info.msgtype) == (topic, msgtype)]
        before = [b.counts for b in self._map.blocks if b.counts and b.last_ns < span.first_ns]
        return sum(counts[key] for counts in before for key in keys)

    def _note(self, offset: int, problem: str, messages: int | None, size: int | None) -> None:
        self._damage.add(Damage(self.path, offset, problem, messages, size))

    def _note_break(self, place: Break, size: int) -> None:
        """Take note of a broken chain of records, and cut the block that reaches over it."""
        end = size if place.following is None else place.following
        last = self._map.blocks[-1] if self._map.blocks else None
        if last is not None and last.end >= end:
            last.cut_at(end)  # what it loses is told when it is read
        elif place.following is None:
            self._note(place.offset, "from here on no record is whole", None, size - place.offset)
        else:
            lost = max(end - place.offset, 0)
            self._note(place.offset, "no valid record begins here", None, lost)

    def _explore(self, stream: BinaryIO, block: Block) -> Found:
        """Read a block for the channels in it and their numbers of messages."""
        found = Found()
        for _ in self._batches(stream, block, found):
            pass
        for key, info in found.channels.items():
            self._map.channels.setdefault(key, info)
        return found

    def _find_channels(self, stream: BinaryIO) -> None:
        """Look inside of the blocks for channels that have messages and are not yet known."""
        channels = self._map.channels
        for block in self._map.blocks:
            if block.counts and not block.counts.keys() <= channels.keys():
                self._explore(stream, block)
        lost = sum(n for key, n in self._map.counts.items() if key not in channels)
        if lost:
            self._note(0, "the record that tells the topic of some messages is lost", lost, None)

    def _in_time_order(
        self, stream: BinaryIO, wanted: frozenset[int], span: Span
    ) -> Iterator[Message]:
        """Merge the messages of all blocks; few blocks overlap, so few messages are held."""
        blocks = [
            block
            for block in self._map.blocks
            if not wanted.isdisjoint(block.counts or ())
            and block.last_ns >= span.first_ns
            and block.first_ns <= span.last_ns
        ]
        blocks.sort(key=lambda block: block.first_ns)
        held: list[Message] = []
        size = 0
        for number, block in enumerate(blocks, 1):
            following = blocks[number] if number < len(blocks) else None
            for batch in self._batches(stream, block, Found(wanted)):
                size += _size_of(batch)
                held += batch
                held.sort(key=itemgetter(0))
                end = len(held)
                if following is not None and size < _MOST_HELD_BYTES:
                    end = bisect_left(held, following.first_ns, key=itemgetter(0))
                ready, held = held[:end], held[end:]
                size -= _size_of(ready)
                yield from ready
        yield from held

    def _batches(self, stream: BinaryIO, block: Block, found: Found) -> Iterator[list[Message]]:
        """Read a block, a piece at a time, and take note of what is lost of it."""
        reader = _PieceReader(self._format, block, found)
        problem = ""
        try:
            for piece in self._pieces(stream, block):
                reader.feed(piece)
                yield found.taken()
        except CorruptChunkError as error:
            problem = str(error)
        reader.finish()
        yield found.taken()
        problem = problem or reader.problem
        expected, read = block.counts, found.counts
        if problem:
            lost = None if expected is None else max(expected.total() - read.total(), 0)
            self._note(block.offset, problem, lost, reader.lost_bytes)
        elif expected is not None and expected != read:
            problem = f"the index lists {expected.total()} messages, the chunk holds {read.total()}"
            self._note(block.offset, problem, 0, None)

    def _pieces(self, stream: BinaryIO, block: Block) -> Iterator[bytes]:
        """Content of a block: whole when it is small, else in pieces; checked beforehand."""
        limit = self._limits.max_chunk_bytes
        if block.compression and not block.cut and block.full_size > limit:
            raise CorruptChunkError(
                f"a chunk claims {block.full_size / 2**20:.0f} MB, more than the limit of "
                f"{limit / 2**20:.0f} MB; see recording.max_chunk_mb"
            )
        if block.full_size > PIECE_BYTES:
            if block.crc and not block.cut:
                _check(self._raw_pieces(stream, block), block.crc)
                block.crc = 0  # is right, and need not be asked again in the next reading
            yield from self._raw_pieces(stream, block)
            return
        try:
            content = b"".join(self._raw_pieces(stream, block))
        except CorruptChunkError:
            if block.crc and not block.cut:
                raise  # no telling which of its bytes are right
            yield from self._raw_pieces(stream, block, _CAREFUL_BYTES)
            return
        if block.crc and not block.cut:
            _check([content], block.crc)
            block.crc = 0
        yield content

    def _raw_pieces(
        self, stream: BinaryIO, block: Block, step: int = PIECE_BYTES
    ) -> Iterator[bytes]:
        stored = read_range(stream, block.body, block.size, step)
        most = min(block.full_size, self._limits.max_chunk_bytes)
        return decompressed(stored, block.compression, most if block.compression else block.size)


def _check(pieces: Iterator[bytes] | list[bytes], crc: int) -> None:
    actual = 0
    for piece in pieces:
        actual = crc32(piece, actual)
    if actual != crc:
        raise CorruptChunkError("the checksum of a chunk is wrong")


def _size_of(batch: list[Message]) -> int:
    return sum(len(data) + _MESSAGE_OVERHEAD_BYTES for _, _, data in batch)


class _PieceReader:
    """Reads the records of one block out of its pieces.

    Attributes
    ----------
    lost_bytes : int
        Of the content so far, what is in no record.
    """

    def __init__(self, format_: BlockFormat, block: Block, found: Found) -> None:
        self._format = format_
        self._found = found
        self._block = block
        self._left = block.full_size
        self._rest = b""
        self.lost_bytes = 0

    @property
    def problem(self) -> str:
        """What is wrong with the block; empty when it was read whole."""
        kind = "run of records" if self._block.is_run else "chunk"
        if self._block.cut:
            return f"the end of a {kind} is missing"
        if self._left:
            return f"a {kind} ends too early"
        return f"a {kind} holds records that are not valid" if self.lost_bytes else ""

    def feed(self, piece: bytes) -> None:
        """Read the records that a piece completes."""
        self._left -= len(piece)
        self._read(self._rest + piece if self._rest else piece, self._left)

    def finish(self) -> None:
        """Read what is behind a record that never came to its end."""
        if self._rest:
            self._read(self._rest, 0)
        self.lost_bytes += len(self._rest) + (0 if self._block.cut else self._left)

    def _read(self, buffer: bytes, left: int) -> None:
        position = 0
        while True:
            position = self._format.parse(buffer, position, self._found)
            if position >= len(buffer) or self._goes_on(buffer, position, left):
                break
            following = search(self._format, BufferSource(buffer), position + 1)
            following = len(buffer) if following is None else following
            self.lost_bytes += following - position
            position = following
        self._rest = buffer[position:]

    def _goes_on(self, buffer: bytes, position: int, left: int) -> bool:
        """Whether the record at a position may end in the next piece."""
        if not left:
            return False
        record = self._format.record(BufferSource(buffer), position)
        if record is None:
            return len(buffer) - position < _MOST_HEADER_BYTES
        return record.end <= len(buffer) + left
