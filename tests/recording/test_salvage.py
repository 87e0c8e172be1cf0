"""Damaged recordings: what is whole is read, and what is lost is told once."""

from __future__ import annotations

import json
import shutil
import sqlite3
import struct
import zlib
from contextlib import closing, suppress

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Bag1Writer

from beamseg_batch.cli.main import beamseg
from beamseg_batch.config import RecordingConfig, RunConfig
from beamseg_batch.errors import RecordingError
from beamseg_batch.recording import inspect_recording, open_recording
from beamseg_batch.recording.codec import CDR, ROS1
from tests.fuzz import sample
from tests.recording.conftest import some_clouds, some_poses
from tests.recordings import START_NS, STORES, message, pose_message, write_recording

STRICT = RecordingConfig(strict=True)
STRING = "std_msgs/msg/String"
PAYLOAD = 400


def strings(path, kind, n_chunks=5, per_chunk=10):
    """Write a recording of chunks of numbered strings; give its path."""
    store = STORES[ROS1 if kind.startswith("bag") else CDR]
    generator = np.random.default_rng(1)
    path.mkdir(exist_ok=True)
    texts = [
        f"{k:06d}" + generator.integers(33, 127, PAYLOAD, dtype=np.uint8).tobytes().decode()
        for k in range(n_chunks * per_chunk)
    ]
    if kind.startswith("bag"):
        target, writer = path / "flight.bag", Bag1Writer(path / "flight.bag")
        writer.chunk_threshold = per_chunk * (PAYLOAD + 40) - 1
        if "-" in kind:
            writer.set_compression(Bag1Writer.CompressionFormat[kind.partition("-")[2].upper()])
        with writer:
            connection = writer.add_connection("/text", STRING, typestore=store)
            for k, text in enumerate(texts):
                raw = store.serialize_ros1(message("bag", STRING, data=text), STRING)
                writer.write(connection, START_NS + k, raw)
        return target
    target = path / "flight.mcap"
    options = {
        "mcap": {"compression": CompressionType.NONE},
        "mcap-zstd": {"compression": CompressionType.ZSTD},
        "mcap-lz4": {"compression": CompressionType.LZ4},
        "mcap-unchunked": {"use_chunking": False},
    }[kind]
    with target.open("wb") as stream:
        writer = McapWriter(stream, chunk_size=per_chunk * (PAYLOAD + 44), **options)
        writer.start(profile="")
        text = store.generate_msgdef(STRING, ros_version=2)[0].encode()
        schema = writer.register_schema(STRING, "ros2msg", text)
        channel = writer.register_channel("/text", CDR, schema)
        for k, text in enumerate(texts):
            raw = bytes(store.serialize_cdr(message("mcap", STRING, data=text), STRING))
            writer.add_message(channel, START_NS + k, raw, START_NS + k)
        writer.finish()
    return target


def numbers(recording) -> list[int]:
    """Numbers of the strings that are read, each checked to be whole."""
    found = []
    for raw in recording.messages(["/text"]):
        text = recording.read(raw, lambda content: content.data)
        assert len(text) == 6 + PAYLOAD
        assert raw.log_time_ns == START_NS + int(text[:6])
        found.append(int(text[:6]))
    return found


def blocks(path):
    """Blocks of an undamaged file."""
    container = open_recording(path)._containers[0]
    return container._map.blocks


BAGS = ["bag", "bag-bz2", "bag-lz4"]
MCAPS = ["mcap", "mcap-zstd", "mcap-lz4", "mcap-unchunked"]


@pytest.mark.parametrize("kind", [*BAGS, *MCAPS])
def test_open_recording__undamaged(tmp_path, kind):
    path = strings(tmp_path, kind)
    recording = open_recording(path, STRICT)
    assert numbers(recording) == list(range(50))
    assert recording.damage == recording.damage_notes == ()
    assert len(blocks(path)) > 3 or kind == "mcap-unchunked"


@pytest.mark.parametrize("kind", [*BAGS, *MCAPS])
def test_open_recording__cut_at_every_percent(tmp_path, kind):
    path = strings(tmp_path, kind)
    content, whole = path.read_bytes(), blocks(path)
    for percent in range(101):
        size = len(content) * percent // 100
        path.write_bytes(content[:size])
        ends = [block.end for block in whole if block.end <= size]
        least = sum(b.counts.total() for b in whole if b.end <= size) if ends else 0
        if not least:
            with suppress(RecordingError):
                open_recording(path)
            continue
        recording = open_recording(path)
        found = numbers(recording)
        assert found == list(range(len(found)))
        assert len(found) >= least
        assert len(recording.damage_notes) == (percent < 100)


@pytest.mark.parametrize("kind", ["bag", "mcap", "mcap-unchunked"])
def test_open_recording__cut_in_a_chunk_that_is_not_compressed_keeps_its_beginning(tmp_path, kind):
    path = strings(tmp_path, kind, n_chunks=1)
    content = path.read_bytes()
    third = content.index(b"000003")
    path.write_bytes(content[:third])
    assert numbers(open_recording(path)) == [0, 1, 2]


@pytest.mark.parametrize("kind", [*BAGS, *MCAPS])
def test_open_recording__strict_refuses_a_cut_file(tmp_path, kind):
    path = strings(tmp_path, kind)
    path.write_bytes(path.read_bytes()[:-700])
    with pytest.raises(RecordingError, match=r"flight\.\w+: byte \d+: .*; see recording\.strict"):
        numbers(open_recording(path, STRICT))


def damage_chunk(path, number, position=0.5):
    """Change bytes inside of a chunk; give its number of messages."""
    block = blocks(path)[number]
    data = bytearray(path.read_bytes())
    place = block.body + int(position * block.size)
    data[place : place + 8] = b"\xff" * 8
    path.write_bytes(data)
    return block.counts.total()


@pytest.mark.parametrize("kind", ["mcap", "mcap-zstd", "mcap-lz4"])
def test_messages__corrupt_chunk_costs_no_other(tmp_path, kind):
    path = strings(tmp_path, kind)
    block = blocks(path)[1]
    first = sum(b.counts.total() for b in blocks(path)[:1])
    lost = damage_chunk(path, 1)
    recording = open_recording(path)
    assert numbers(recording) == [k for k in range(50) if not first <= k < first + lost]
    numbers(recording)
    (place,) = recording.damage
    assert (place.offset, place.lost_messages) == (block.offset, lost)
    (note,) = recording.damage_notes
    assert note.endswith(f"; {lost} messages lost")
    with pytest.raises(RecordingError, match="a chunk"):
        numbers(open_recording(path, STRICT))


def test_messages__corrupt_bz2_chunk_costs_no_other(tmp_path):
    path = strings(tmp_path, "bag-bz2")
    first = blocks(path)[0].counts.total()
    lost = damage_chunk(path, 1)
    recording = open_recording(path)
    assert numbers(recording) == [k for k in range(50) if not first <= k < first + lost]
    assert recording.damage[0].lost_messages == lost


def test_messages__broken_record_costs_no_other_of_its_chunk(tmp_path):
    path = strings(tmp_path, "bag")
    data = bytearray(path.read_bytes())
    header = data.index(b"000012") - 4 - 4  # the length of the message's data
    data[header : header + 4] = struct.pack("<I", 1 << 30)
    path.write_bytes(data)
    recording = open_recording(path)
    assert numbers(recording) == [k for k in range(50) if k != 12]
    assert recording.damage[0].lost_messages == 1


def test_open_recording__bag_of_a_recorder_that_was_killed(tmp_path):
    """No index, and the last chunk has no length."""
    path = strings(tmp_path, "bag")
    last, data = blocks(path)[-1], bytearray(path.read_bytes())
    del data[last.end :]
    data[last.body - 4 : last.body] = bytes(4)
    index_pos = data.index(b"index_pos=") + len(b"index_pos=")
    data[index_pos : index_pos + 8] = bytes(8)
    path.write_bytes(data)
    recording = open_recording(path)
    assert numbers(recording) == list(range(50))
    assert "the recorder did not finish the bag, it has no index" in recording.damage_notes[0]


def test_open_recording__bag_whose_index_lies(tmp_path):
    path = strings(tmp_path, "bag")
    data = bytearray(path.read_bytes())
    index_pos = data.index(b"index_pos=") + len(b"index_pos=")
    data[index_pos] ^= 1
    end = data.rindex(b"chunk_pos=") + len(b"chunk_pos=")
    data[end : end + 8] = struct.pack("<Q", 77)
    path.write_bytes(data)
    assert numbers(open_recording(path)) == list(range(50))


def test_open_recording__lost_connection_record(tmp_path):
    """It stands in the chunk and in the index; the other one is used. Without both, it is told."""
    path = strings(tmp_path, "bag")
    content = path.read_bytes()
    path.write_bytes(content.replace(b"topic=/text", b"topix=/text", 1))
    assert len(numbers(open_recording(path))) == 50
    path.write_bytes(content.replace(b"topic=/text", b"topix=/text"))
    with pytest.raises(RecordingError, match="not one message can be read"):
        open_recording(path)


@pytest.mark.parametrize("kind", ["mcap", "mcap-zstd"])
def test_open_recording__length_of_a_chunk_is_wrong(tmp_path, kind):
    path = strings(tmp_path, kind)
    block, data = blocks(path)[1], bytearray(path.read_bytes())
    data[block.offset + 1 : block.offset + 9] = struct.pack("<Q", 10 << 30)
    path.write_bytes(data)
    recording = open_recording(path)
    least = [k for k in range(50) if not 10 <= k < 22]
    assert set(numbers(recording)) >= set(least)
    assert recording.damage


def zstd_chunk(content: bytes, claimed: int) -> bytes:
    """Chunk record of an MCAP file, of content that claims another size."""
    from tests.recording.test_containers import zstd_compress

    packed = zstd_compress(content)
    head = struct.pack("<QQQI", START_NS, START_NS, claimed, zlib.crc32(content))
    body = head + struct.pack("<I", 4) + b"zstd" + struct.pack("<Q", len(packed)) + packed
    return struct.pack("<BQ", 6, len(body)) + body


@pytest.mark.parametrize(
    ("claimed", "problem"),
    [
        (10 << 30, "a chunk claims 10240 MB, more than the limit of 1024 MB; see "),
        (1 << 29, "a chunk"),
        (1000, "a chunk is larger than it claims"),
    ],
)
def test_open_recording__decompression_bomb(tmp_path, claimed, problem):
    path = strings(tmp_path, "mcap-zstd")
    block, content = blocks(path)[0], path.read_bytes()
    bomb = zstd_chunk(bytes(64 << 20), claimed)
    path.write_bytes(content[: block.offset] + bomb + content[block.offset :])
    recording = open_recording(path)
    assert numbers(recording) == list(range(50))
    assert any(place.problem.startswith(problem) for place in recording.damage)


def test_messages__large_chunk_is_read_in_pieces(tmp_path, monkeypatch):
    from beamseg_batch.recording import blocks as blocks_module
    from beamseg_batch.recording import decompression

    for kind in ("bag-lz4", "mcap-zstd", "mcap"):
        path = strings(tmp_path / kind, kind)
        for module in (blocks_module, decompression):
            monkeypatch.setattr(module, "PIECE_BYTES", 700)
        recording = open_recording(path, STRICT)
        assert numbers(recording) == list(range(50))
        monkeypatch.undo()


def test_open_recording__chunk_above_the_limit_is_refused_with_the_option(tmp_path):
    path = strings(tmp_path, "bag-lz4")
    block, data = blocks(path)[0], bytearray(path.read_bytes())
    size = data.index(b"size=", block.offset) + len(b"size=")
    data[size : size + 4] = struct.pack("<I", 2 << 20)
    path.write_bytes(data)
    recording = open_recording(path, RecordingConfig(max_chunk_mb=1))
    assert len(numbers(recording)) == 50 - block.counts.total()
    assert "see recording.max_chunk_mb" in recording.damage_notes[0]


@pytest.mark.parametrize("share", [0.5, 0.7, 0.9])
def test_open_recording__truncated_database(tmp_path, share):
    path = write_recording(tmp_path, "db3", some_clouds(100), some_poses())
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    recording = open_recording(path)
    found = list(recording.messages([topic.name for topic in recording.topics]))
    assert len(found) == sum(topic.count for topic in recording.topics)
    assert len(found) > (share - 0.3) * 140
    assert "some messages cannot be read" in recording.damage_notes[0]
    with pytest.raises(RecordingError, match=r"see recording\.strict"):
        open_recording(path, STRICT)


def test_open_recording__database_of_a_recorder_that_was_killed(tmp_path):
    """What it had written last stands in a file beside the database."""
    path = write_recording(tmp_path, "db3", some_clouds(), some_poses())
    database = sqlite3.connect(path)
    database.execute("PRAGMA journal_mode=WAL")
    database.execute(
        "INSERT INTO messages SELECT id + 1000, topic_id, timestamp, data FROM messages"
    )
    database.commit()
    (tmp_path / "killed").mkdir()
    for file in tmp_path.glob("flight.db3*"):
        shutil.copy(file, tmp_path / "killed")
    database.close()
    before = {file: file.read_bytes() for file in (tmp_path / "killed").iterdir()}
    recording = open_recording(tmp_path / "killed" / "flight.db3")
    assert sum(topic.count for topic in recording.topics) == 2 * 44
    assert before == {file: file.read_bytes() for file in (tmp_path / "killed").iterdir()}


def test_open_recording__unreadable_part_of_several_costs_no_other(tmp_path):
    path = strings(tmp_path, "mcap")
    (tmp_path / "empty.mcap").touch()
    recording = open_recording(tmp_path)
    assert numbers(recording) == list(range(50))
    assert recording.damage_notes == (
        f"{tmp_path / 'empty.mcap'}: is damaged, what is whole is used: "
        "the file is empty (0 bytes)",
    )
    assert path.exists()


def test_open_recording__views_in_place_of_tables_are_refused(tmp_path):
    """This one would give rows without end."""
    path = tmp_path / "flight.db3"
    with closing(sqlite3.connect(path)) as database:
        database.executescript(
            "CREATE TABLE topics(id, name, type, serialization_format);"
            "CREATE VIEW messages AS WITH RECURSIVE r(id) AS (SELECT 1 UNION ALL SELECT id + 1 "
            "FROM r) SELECT id, 1 AS topic_id, id AS timestamp, x'00' AS data FROM r;"
        )
    with pytest.raises(RecordingError, match="no such table: messages"):
        open_recording(path)


def test_open_recording__zstd_file_of_which_nothing_is_left(tmp_path):
    path = tmp_path / "flight.db3.zstd"
    path.write_bytes(b"\x28\xb5\x2f\xfd" + bytes(range(256)))
    with pytest.raises(RecordingError, match=r"flight\.db3\.zstd: a zstd file of which nothing"):
        open_recording(path)


@pytest.mark.parametrize("chunked", [True, False])
def test_open_flight__log_times_beyond_all_clocks(tmp_path, chunked):
    """MCAP has room for times that arrays of signed numbers have not."""
    store, msgtype = STORES[CDR], "geometry_msgs/msg/PoseStamped"
    path = tmp_path / "flight.mcap"
    with path.open("wb") as stream:
        writer = McapWriter(stream, use_chunking=chunked)
        writer.start(profile="ros2")
        text = store.generate_msgdef(msgtype, ros_version=2)[0].encode()
        schema = writer.register_schema(msgtype, "ros2msg", text)
        channel = writer.register_channel("/p", CDR, schema)
        for stamp in (START_NS, 2**64 - 1):
            content = pose_message("mcap", msgtype, START_NS, (1, 2, 3), (0, 0, 0, 1))
            writer.add_message(channel, stamp, bytes(store.serialize_cdr(content, msgtype)), stamp)
        writer.finish()
    summary = inspect_recording(open_recording(path), RunConfig())
    assert summary.poses.count == 1


# --- what the commands make of it ---------------------------------------------------------


def cut_flight(folder):
    path = sample(folder, "bag", n_clouds=30)
    path.write_bytes(path.read_bytes()[:-20_000])
    return path


def test_run__damage_is_one_warning_and_stands_in_the_summary(tmp_path):
    path = cut_flight(tmp_path)
    result = CliRunner().invoke(beamseg, ["run", str(path), "-o", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    assert result.output.count("is damaged, what is whole is used") == 1
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["recording"]["recovered"] is True
    assert "flight.bag: byte " in summary["recording"]["damage"][0]
    assert 10 < summary["counts"]["processed"] < 30


def test_info__damage_is_told(tmp_path):
    path = cut_flight(tmp_path)
    result = CliRunner().invoke(beamseg, ["info", str(path), "--json"])
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["recovered"] is True
    assert len(summary["damage"]) >= 1
    assert "damage        " in CliRunner().invoke(beamseg, ["info", str(path)]).stdout


@pytest.mark.parametrize("command", ["run", "info"])
def test_strict__damage_is_an_error(tmp_path, command):
    arguments = [command, str(cut_flight(tmp_path)), "--strict"]
    if command == "run":
        arguments += ["-o", str(tmp_path / "out")]
    result = CliRunner().invoke(beamseg, arguments)
    assert result.exit_code == 1
    assert "see recording.strict" in result.output
