"""MCAP files of any profile, with or without their summary.

https://mcap.dev/spec. A file is a data section of chunks, or of messages in no chunk,
then a summary of it, then a footer; a recorder that is killed writes neither.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from struct import Struct, iter_unpack
from zlib import crc32

from beamseg_batch.recording.blocks import Block, BlockFile, ChannelInfo, Found
from beamseg_batch.recording.codec import CDR, ROS1, Definition, ros2_name
from beamseg_batch.recording.container import ContainerIndex, ReadLimits
from beamseg_batch.recording.records import Break, FileSource, Record, Source, follow

__all__ = ["MCAP_MAGIC", "McapFile"]

MCAP_MAGIC = b"\x89MCAP0\r\n"
"""What an MCAP file begins and ends with."""

_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX = range(1, 8)
_STATISTICS, _DATA_END = 0x0B, 0x0F
_LAST_OP, _FIRST_PRIVATE_OP = 0x0F, 0x80
_LENGTHS = {_FOOTER: (20, 20), _DATA_END: (4, 4), _MESSAGE: (22, 2**63), _CHUNK: (40, 2**63)}
"""Least and largest length of records where the format fixes them."""
_RECORD_START = re.compile(rb"[\x03-\x07\x0F](?=.{4}\0{4})", re.DOTALL)
_LAST_NS = 2**63 - 1
"""Latest time that arrays of stamps hold; a damaged file may claim more."""
_HEAD_BYTES = 9
_CHUNK_HEAD_BYTES = 80
_LANGUAGES = {
    "ros1msg": "msg",
    "ros2msg": "msg",
    "ros2idl": "idl",
    "omgidl": "idl",
    "jsonschema": "jsonschema",
    "protobuf": "protobuf",
}
"""Language of a definition by the encoding that its schema names."""
_ENCODINGS = {"ros1msg": ROS1, "ros2msg": CDR, "ros2idl": CDR, "omgidl": CDR}
"""Encoding of the messages where the channel does not tell it."""
_U16 = Struct("<H")
_U32 = Struct("<I")
_U64 = Struct("<Q")
_MESSAGE_HEAD = Struct("<HIQQ")
_CHUNK_HEAD = Struct("<QQQII")


@dataclass
class _Definitions:
    """Schemas and channels, as they are found."""

    channels: dict[int, ChannelInfo] = field(default_factory=dict)
    schemas: dict[int, tuple[str, str, bytes]] = field(default_factory=dict)

    def add(self, op: int, content: bytes) -> None:
        """Add a record; one that makes no sense, or is known, is left out."""
        try:
            if op == _SCHEMA:
                self._add_schema(content)
            else:
                self._add_channel(content)
        except (IndexError, ValueError):
            return

    def _add_schema(self, content: bytes) -> None:
        key = _u16(content, 0)
        name, position = _text(content, 2)
        encoding, position = _text(content, position)
        self.schemas.setdefault(key, (name, encoding, _sized(content, position)[0]))

    def _add_channel(self, content: bytes) -> None:
        key, schema = _u16(content, 0), _u16(content, 2)
        topic, position = _text(content, 4)
        encoding, _ = _text(content, position)
        if key not in self.channels:
            self.channels[key] = _channel(topic, encoding, *self.schemas.get(schema, ("", "", b"")))


class McapFormat:
    """The records of an MCAP file: a byte for the kind, a length, content."""

    chunk_op = _CHUNK

    def __init__(self) -> None:
        self._schemas: dict[int, tuple[str, str, bytes]] = {}

    def record(self, source: Source, offset: int) -> Record | None:
        """Record at an offset, which may claim to end behind the source; None if it is none."""
        head = source.at(offset, _HEAD_BYTES)
        if len(head) < _HEAD_BYTES:
            return None
        op, length = head[0], _U64.unpack_from(head, 1)[0]
        if op == 0 or _LAST_OP < op < _FIRST_PRIVATE_OP:
            return None
        least, most = _LENGTHS.get(op, (0, 2**63))
        if not least <= length <= most:
            return None
        body = offset + _HEAD_BYTES
        if op == _CHUNK and _chunk_at(source, body, length) is None:
            return None
        return Record(op, offset, body, body + length, {})

    def candidates(self, buffer: bytes) -> Iterator[int]:
        """Positions in a buffer where a record may begin."""
        return (match.start() for match in _RECORD_START.finditer(buffer))

    def parse(self, buffer: bytes, position: int, found: Found) -> int:
        """Read records; stop at the first that is incomplete or none, and say where."""
        size, u64, head = len(buffer), _U64.unpack_from, _MESSAGE_HEAD.unpack_from
        definitions = _Definitions(found.channels, self._schemas)
        while position + _HEAD_BYTES <= size:
            op, body = buffer[position], position + _HEAD_BYTES
            end = body + u64(buffer, position + 1)[0]
            if end > size:
                break
            if op == _MESSAGE and end - body >= _MESSAGE_HEAD.size:
                key, _, log_time_ns, _ = head(buffer, body)
                log_time_ns = min(log_time_ns, _LAST_NS)
                found.saw(key, log_time_ns)
                if key in found.wanted:
                    found.messages.append((log_time_ns, key, buffer[body + 22 : end]))
            elif op in (_SCHEMA, _CHANNEL):
                definitions.add(op, buffer[body:end])
            elif op < _FIRST_PRIVATE_OP:
                break
            position = end
        return position


class McapFile(BlockFile):
    """An MCAP file."""

    def __init__(self, path: Path, limits: ReadLimits) -> None:
        super().__init__(path, limits)
        self._format = McapFormat()  # of its own: it knows the schemas of the file

    def label(self, index: ContainerIndex) -> str:
        """Kind of file, for people."""
        names = {ROS1: "ROS 1", CDR: "ROS 2"}
        encodings = sorted({channel.definition.encoding for channel in index.channels})
        told = ", ".join(names.get(name, name) for name in encodings)
        return f"MCAP ({told})" if told else "MCAP"

    def _walk(self, source: FileSource) -> None:
        data, summary = _Definitions(), _Definitions()
        statistics: Counter[int] | None = None
        footer: Record | None = None
        in_summary = broken = False
        for record in follow(self._format, source, len(MCAP_MAGIC)):
            if isinstance(record, Break):
                broken = True
                self._note_break(record, source.size)
            elif record.op == _CHUNK:
                self._map.blocks.append(_chunk(record, source))
            elif record.op == _MESSAGE:
                key, _, log_time_ns, _ = _MESSAGE_HEAD.unpack(source.at(record.body, 22))
                self._map.add_to_run(record, key, min(log_time_ns, _LAST_NS))
            elif record.op == _MESSAGE_INDEX:
                self._add_index(record, source)
            elif record.op in (_SCHEMA, _CHANNEL):
                content = source.at(record.body, record.end - record.body)
                (summary if in_summary else data).add(record.op, content)
            elif record.op == _STATISTICS:
                statistics = _statistics(source.at(record.body, record.end - record.body))
            elif record.op == _DATA_END:
                in_summary = True
            elif record.op == _FOOTER:
                footer = record
                break
        self._map.channels = data.channels
        if footer is None:
            problem = "the file ends without a footer: it was cut or was not closed"
            self._note(source.size, problem, None, None)
        elif self._summary_holds(source, footer):
            self._map.channels = {**summary.channels, **data.channels}
            self._check_counts(footer.offset, statistics, broken)

    def _add_index(self, record: Record, source: FileSource) -> None:
        """Take the counts of a chunk from the index that follows it."""
        block = self._map.blocks[-1] if self._map.blocks else None
        head = source.at(record.body, 6)
        if block is None or block.is_run or block.cut or len(head) < 6:
            return
        count = _U32.unpack_from(head, 2)[0] // 16
        if count:
            block.add(Counter({_u16(head, 0): count}), block.first_ns, block.last_ns)

    def _summary_holds(self, source: FileSource, footer: Record) -> bool:
        """Whether the summary is what was written, as far as its checksum tells."""
        tail = source.at(footer.body, 20 + len(MCAP_MAGIC))
        start, _, crc = Struct("<QQI").unpack_from(tail)
        if tail[20:] != MCAP_MAGIC:
            self._note(footer.end, "the file does not end behind its footer", 0, None)
        if not crc or not start or not self._map.blocks:
            return True
        end = footer.body + 16
        if start <= end and crc32(source.at(start, end - start)) == crc:
            return True
        self._note(footer.offset, "the checksum of the summary is wrong: it is not used", 0, None)
        return False

    def _check_counts(self, offset: int, statistics: Counter[int] | None, broken: bool) -> None:
        """Compare the statistics with the indexes of the chunks."""
        known = all(block.counts is not None for block in self._map.blocks)
        if statistics is None or not known or statistics == self._map.counts:
            return
        if broken:
            lost = statistics.total() - self._map.counts.total()
            self._note(
                offset, "the summary counts more messages than there are", max(lost, 0), None
            )
            return
        for block in self._map.blocks:
            block.forget_index()  # two indexes contradict one another: the chunks decide


def _chunk_at(source: Source, body: int, length: int) -> tuple[int, int, int, int, str, int] | None:
    """Start, end, full size, checksum, compression of a chunk, and where its data begin.

    None when its lengths contradict one another.
    """
    head = source.at(body, _CHUNK_HEAD_BYTES)
    if len(head) < 40:
        return None
    first_ns, last_ns, full_size, crc, name_size = _CHUNK_HEAD.unpack_from(head)
    if name_size > _CHUNK_HEAD_BYTES - 40 or len(head) < 40 + name_size:
        return None
    if _U64.unpack_from(head, 32 + name_size)[0] != length - 40 - name_size:
        return None
    compression = head[32 : 32 + name_size].decode(errors="replace")
    return first_ns, last_ns, full_size, crc, compression, body + 40 + name_size


def _chunk(record: Record, source: FileSource) -> Block:
    head = _chunk_at(source, record.body, record.end - record.body)
    assert head is not None, "the format has checked it"
    first_ns, last_ns, full_size, crc, compression, start = head
    size = record.end - start
    block = Block(record.offset, start, size, compression, full_size if compression else size, crc)
    block.first_ns, block.last_ns = first_ns, last_ns
    return block


def _channel(
    topic: str, encoding: str, name: str, schema_encoding: str, data: bytes
) -> ChannelInfo:
    language = _LANGUAGES.get(schema_encoding, "")
    encoding = encoding or _ENCODINGS.get(schema_encoding, "")
    if language == "protobuf":
        definition = Definition(encoding, language, descriptors=data)
    else:
        text = data.decode(errors="replace") if language else ""
        definition = Definition(encoding, language if text else "", text)
    return ChannelInfo(topic, ros2_name(name), definition)


def _statistics(content: bytes) -> Counter[int] | None:
    if len(content) < 46:
        return None
    entries = content[46 : 46 + _U32.unpack_from(content, 42)[0]]
    counts = Counter(dict(iter_unpack("<HQ", entries[: len(entries) // 10 * 10])))
    return +counts


def _u16(content: bytes, position: int) -> int:
    number: int = _U16.unpack_from(content, position)[0]
    return number


def _sized(content: bytes, position: int) -> tuple[bytes, int]:
    """Bytes that their size stands before, and the position after them."""
    end = position + 4 + int.from_bytes(content[position : position + 4], "little")
    if end > len(content):
        raise ValueError("a text is longer than its record")
    return content[position + 4 : end], end


def _text(content: bytes, position: int) -> tuple[str, int]:
    data, end = _sized(content, position)
    return data.decode(errors="replace"), end
