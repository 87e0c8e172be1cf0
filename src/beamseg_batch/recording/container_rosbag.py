"""ROS 1 bags, format 2.0, with or without their index.

http://wiki.ros.org/Bags/Format/2.0. The recorder writes the index when it closes the
bag; until then the header says that there is none, and the last chunk has no length.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from struct import Struct, iter_unpack

from beamseg_batch.errors import RecordingError
from beamseg_batch.recording.blocks import Block, BlockFile, ChannelInfo, Found
from beamseg_batch.recording.codec import ROS1, Definition, ros2_name
from beamseg_batch.recording.container import ContainerIndex
from beamseg_batch.recording.records import Break, FileSource, Record, Source, follow

__all__ = ["ROSBAG_MAGIC", "RosbagFile"]

ROSBAG_MAGIC = b"#ROSBAG V"
"""What a bag of any version begins with."""

_VERSION_LINE = b"#ROSBAG V2.0\n"
_MESSAGE, _BAG_HEADER, _INDEX_DATA, _CHUNK, _CHUNK_INFO, _CONNECTION = range(2, 8)
_REQUIRED: dict[int, dict[bytes, int]] = {
    _MESSAGE: {b"conn": 4, b"time": 8},
    _BAG_HEADER: {b"index_pos": 8},
    _INDEX_DATA: {b"conn": 4, b"count": 4},
    _CHUNK: {b"compression": 0, b"size": 4},
    _CHUNK_INFO: {b"chunk_pos": 8, b"count": 4},
    _CONNECTION: {b"conn": 4, b"topic": 0},
}
"""Header fields of each kind of record, with their size; 0 for text."""
_OP = re.compile(rb"\x04\0\0\0op=[\x02\x05\x07]")
_MOST_BEFORE_OP = 300  # a connection's header holds its topic, maybe first
_HEADER_BYTES = 256
_MOST_HEADER_BYTES = 1 << 16
_U32 = Struct("<I")
_U64 = Struct("<Q")
_TIME = Struct("<II")


class RosbagFormat:
    """The records of a bag: a header of named fields, then data, each with its length."""

    chunk_op = _CHUNK

    def record(self, source: Source, offset: int) -> Record | None:
        """Record at an offset, which may claim to end behind the source; None if it is none."""
        head = source.at(offset, _HEADER_BYTES)
        if len(head) < 8:
            return None
        size = _U32.unpack_from(head)[0]
        if size > _MOST_HEADER_BYTES:
            return None
        if size + 8 > len(head):
            head = source.at(offset, size + 8)
            if size + 8 > len(head):
                return None
        fields = _fields(head, 4, 4 + size)
        if fields is None or len(fields.get(b"op", b"")) != 1:
            return None
        op = fields[b"op"][0]
        if not _has_required(fields, op):
            return None
        body = offset + size + 8
        return Record(op, offset, body, body + _U32.unpack_from(head, 4 + size)[0], fields)

    def candidates(self, buffer: bytes) -> Iterator[int]:
        """Positions in a buffer where a record may begin."""
        for match in _OP.finditer(buffer):
            op = match.start()
            for start in range(op - 4, max(op - _MOST_BEFORE_OP, 0) - 1, -1):
                end = start + 4 + _U32.unpack_from(buffer, start)[0]
                if op + 8 <= end <= min(op + _MOST_BEFORE_OP, len(buffer)) and _fields(
                    buffer, start + 4, end
                ):
                    yield start
                    break

    def parse(self, buffer: bytes, position: int, found: Found) -> int:
        """Read records; stop at the first that is incomplete or none, and say where."""
        size, u32 = len(buffer), _U32.unpack_from
        while position + 8 <= size:
            body = position + 8 + u32(buffer, position)[0]
            end = body + u32(buffer, body - 4)[0] if body <= size else body
            fields = _fields(buffer, position + 4, body - 4) if end <= size else None
            if fields is None:
                break
            op = fields.get(b"op")
            if op == b"\x02" and _has_required(fields, _MESSAGE):
                key, log_time_ns = u32(fields[b"conn"])[0], _nanoseconds(fields[b"time"])
                found.saw(key, log_time_ns)
                if key in found.wanted:
                    found.messages.append((log_time_ns, key, buffer[body:end]))
            elif op == b"\x07" and _has_required(fields, _CONNECTION):
                _add_connection(found.channels, fields, buffer[body:end])
            else:
                break
            position = end
        return position


class RosbagFile(BlockFile):
    """A ROS 1 bag."""

    _format = RosbagFormat()

    def label(self, index: ContainerIndex) -> str:
        """Kind of file, for people."""
        return "ROS 1 bag"

    def _walk(self, source: FileSource) -> None:
        _refuse_other_versions(source, self.path)
        infos: dict[int, Counter[int]] = {}
        index_pos, index_at = -1, 0
        for record in follow(self._format, source, len(_VERSION_LINE)):
            if isinstance(record, Break):
                self._note_break(record, source.size)
            elif record.op == _CHUNK:
                self._map.blocks.append(_chunk(record, source))
            elif record.op == _INDEX_DATA:
                self._add_index(record, source)
            elif record.op == _MESSAGE:
                key = _U32.unpack(record.fields[b"conn"])[0]
                self._map.add_to_run(record, key, _nanoseconds(record.fields[b"time"]))
            elif record.op == _CONNECTION:
                index_at = index_at or record.offset
                data = source.at(record.body, record.end - record.body)
                _add_connection(self._map.channels, record.fields, data)
            elif record.op == _CHUNK_INFO:
                infos[_U64.unpack(record.fields[b"chunk_pos"])[0]] = _info_counts(record, source)
            elif record.op == _BAG_HEADER:
                _refuse_encrypted(record, self.path)
                index_pos = _U64.unpack(record.fields[b"index_pos"])[0]
        self._check_index(source.size, index_pos, index_at, infos)

    def _add_index(self, record: Record, source: FileSource) -> None:
        """Take the counts and times of a chunk from the index that follows it."""
        block = self._map.blocks[-1] if self._map.blocks else None
        count = _U32.unpack(record.fields[b"count"])[0]
        if block is None or block.is_run or block.cut or record.end - record.body != 12 * count:
            return
        key = _U32.unpack(record.fields[b"conn"])[0]
        times = [
            sec * 1_000_000_000 + nsec
            for sec, nsec, _ in iter_unpack("<III", source.at(record.body, 12 * count))
        ]
        if times:
            block.add(Counter({key: count}), min(times), max(times))

    def _check_index(
        self, size: int, index_pos: int, index_at: int, infos: dict[int, Counter[int]]
    ) -> None:
        """Compare what the bag's index says with what is there."""
        if index_pos == 0:
            self._note(0, "the recorder did not finish the bag, it has no index", None, None)
        elif index_pos >= size:
            self._note(size, "the bag is cut: its index is missing", None, index_pos - size)
        elif index_pos != index_at and self._map.blocks:
            self._note(0, "the bag's header is wrong about where the index is", 0, None)
        blocks = {block.offset: block for block in self._map.blocks}
        for offset, counts in infos.items():
            block = blocks.get(offset)
            if block is None:
                self._note(offset, "a chunk is missing", counts.total(), None)
            elif block.counts != counts:
                block.forget_index()  # two indexes contradict one another: the chunk decides


def _fields(buffer: bytes, position: int, end: int) -> dict[bytes, bytes] | None:
    """Fields of a record's header; None when they do not fill it."""
    fields = {}
    while position + 4 <= end:
        stop = position + 4 + _U32.unpack_from(buffer, position)[0]
        if stop > end:
            return None
        name, equals, value = buffer[position + 4 : stop].partition(b"=")
        if not equals:
            return None
        fields[name] = value
        position = stop
    return fields if position == end else None


def _has_required(fields: dict[bytes, bytes], op: int) -> bool:
    required = _REQUIRED.get(op)
    if required is None:
        return False
    for name, size in required.items():
        value = fields.get(name)
        if value is None or (size and len(value) != size):
            return False
    return True


def _nanoseconds(time: bytes) -> int:
    sec, nsec = _TIME.unpack(time)
    stamp: int = sec * 1_000_000_000 + nsec
    return stamp


def _chunk(record: Record, source: FileSource) -> Block:
    compression = record.fields[b"compression"].decode(errors="replace")
    size = record.end - record.body
    if compression == "none":
        return Block(record.offset, record.body, size, "", size)
    if size == 0:  # a recorder that is killed has not yet filled in the sizes
        size = source.size - record.body
        return Block(record.offset, record.body, size, compression, 2**31, cut=True)
    full_size = _U32.unpack(record.fields[b"size"])[0]
    return Block(record.offset, record.body, size, compression, full_size)


def _info_counts(record: Record, source: FileSource) -> Counter[int]:
    data = source.at(record.body, record.end - record.body)
    return Counter(dict(iter_unpack("<II", data[: len(data) // 8 * 8])))


def _add_connection(
    channels: dict[int, ChannelInfo], fields: dict[bytes, bytes], data: bytes
) -> None:
    about = _fields(data, 0, len(data))
    key = _U32.unpack(fields[b"conn"])[0]
    if about is None or b"type" not in about or key in channels:
        return
    text = about.get(b"message_definition", b"").decode(errors="replace")
    topic = _normal(fields[b"topic"].decode(errors="replace"))
    msgtype = ros2_name(about[b"type"].decode(errors="replace"))
    channels[key] = ChannelInfo(topic, msgtype, Definition(ROS1, "msg", text))


def _normal(topic: str) -> str:
    """ROS 1 allowed doubled slashes, and one at the end."""
    return "/" * topic.startswith("/") + "/".join(part for part in topic.split("/") if part)


def _refuse_other_versions(source: FileSource, path: Path) -> None:
    line = source.at(0, len(_VERSION_LINE))
    if line != _VERSION_LINE:
        raise RecordingError(
            f"{path}: a ROS 1 bag that begins with {line!r}; only version 2.0 is read"
        )


def _refuse_encrypted(record: Record, path: Path) -> None:
    if encryptor := record.fields.get(b"encryptor"):
        raise RecordingError(
            f"{path}: an encrypted bag ({encryptor.decode(errors='replace')}); decrypt it first"
        )
