"""Every kind of file gives the same messages; bad files give one clear error."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode
from rosbags.rosbag2 import Writer as Bag2Writer

from beamseg_batch.config import RunConfig
from beamseg_batch.errors import DuplicateRecordingError, RecordingError, RecordingNotFoundError
from beamseg_batch.model import Scan
from beamseg_batch.recording import open_flight, open_recording
from beamseg_batch.recording.codec import CDR
from tests.recording.conftest import some_clouds, some_poses
from tests.recording.test_codec import foxglove_descriptors
from tests.recordings import (
    KINDS,
    START_NS,
    STORES,
    cloud_message,
    encoding_of,
    write_messages,
    write_recording,
)

LABELS = {
    "bag": "ROS 1 bag",
    "bag-bz2": "ROS 1 bag",
    "bag-lz4": "ROS 1 bag",
    "ros2-sqlite3": "ROS 2 bag folder (sqlite3)",
    "ros2-mcap": "ROS 2 bag folder (mcap)",
    "db3": "ROS 2 bag file (sqlite3)",
    "mcap": "MCAP (ROS 2)",
    "mcap-ros1": "MCAP (ROS 1)",
    "mcap-cdr": "MCAP (ROS 2)",
}


def zstd_compress(data: bytes) -> bytes:
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    return zstd.compress(data)


def scans_of(path) -> list[Scan]:
    return list(open_flight(open_recording(path), RunConfig()).scans())


def assert_same_scans(scans, others) -> None:
    assert len(scans) == len(others)
    for scan, other in zip(scans, others, strict=True):
        assert (scan.stamp_ns, scan.pose_stamp_ns) == (other.stamp_ns, other.pose_stamp_ns)
        assert (scan.width, scan.height) == (other.width, other.height)
        np.testing.assert_array_equal(scan.points, other.points)
        np.testing.assert_array_equal(scan.T_world_body.rotation, other.T_world_body.rotation)
        np.testing.assert_array_equal(scan.T_world_body.translation, other.T_world_body.translation)


@pytest.mark.parametrize("kind", KINDS)
def test_open_recording__every_kind_gives_the_same_scans(tmp_path, kind):
    clouds, poses = some_clouds(), some_poses()
    recording = open_recording(write_recording(tmp_path, kind, clouds, poses))
    assert recording.container == LABELS[kind]
    assert (recording.start_ns, recording.end_ns) == (START_NS, START_NS + 390_000_000)
    assert [(topic.name, topic.msgtype, topic.count) for topic in recording.topics] == [
        ("/mavros/local_position/pose", "geometry_msgs/msg/PoseStamped", 40),
        ("/tof_pc", "sensor_msgs/msg/PointCloud2", 4),
    ]
    scans = list(open_flight(recording, RunConfig()).scans())
    for scan, (stamp, cloud) in zip(scans, clouds, strict=True):
        assert scan.stamp_ns == scan.pose_stamp_ns == stamp
        assert (scan.height, scan.width) == (3, 5)
        np.testing.assert_array_equal(scan.points, cloud.reshape(-1, 3))


@pytest.mark.parametrize("kind", KINDS)
def test_messages__are_raw_and_in_order_of_log_time(tmp_path, kind):
    recording = open_recording(write_recording(tmp_path, kind, some_clouds(), some_poses()))
    messages = list(recording.messages(["/tof_pc", "/mavros/local_position/pose"]))
    times = [message.log_time_ns for message in messages]
    assert times == sorted(times)
    cloud = next(message for message in messages if message.topic == "/tof_pc")
    assert isinstance(cloud.data, bytes)
    assert recording.read(cloud, lambda message: message.header.frame_id) == "tof"
    assert list(recording.messages(["/nothing"])) == []


@pytest.mark.parametrize("kind", KINDS)
def test_open_recording__no_file_stays_open(tmp_path, kind):
    if not Path("/proc/self/fd").exists():
        pytest.skip("open files cannot be listed here")
    path = write_recording(tmp_path, kind, some_clouds(), some_poses())
    flight = open_flight(open_recording(path), RunConfig())
    list(flight.scans())
    half_read = flight.scans()
    next(half_read)
    half_read.close()
    opened = [os.path.realpath(fd) for fd in Path("/proc/self/fd").iterdir()]
    assert not [name for name in opened if name.startswith(str(tmp_path))]


def test_open_recording__kind_is_told_by_content_not_by_name(tmp_path):
    for kind in ("bag", "mcap", "db3"):
        path = write_recording(tmp_path / kind, kind, some_clouds(), some_poses())
        renamed = path.rename(path.with_name("log.dat"))
        assert len(scans_of(renamed)) == 4


def test_open_recording__several_paths_are_one_recording(tmp_path):
    clouds, poses = some_clouds(), some_poses()
    whole = write_recording(tmp_path / "whole", "mcap", clouds, poses)
    parts = [
        write_recording(tmp_path / "b", "mcap", clouds[2:], poses[20:]),
        write_recording(tmp_path / "a", "db3", clouds[:2], poses[:20]),
    ]
    recording = open_recording(parts)
    assert recording.container == "MCAP (ROS 2) + ROS 2 bag file (sqlite3)"
    assert recording.size_bytes == sum(part.stat().st_size for part in parts)
    assert_same_scans(list(open_flight(recording, RunConfig()).scans()), scans_of(whole))


def test_open_recording__two_encodings_of_one_type_are_refused(tmp_path):
    parts = [write_recording(tmp_path / kind, kind, some_clouds()) for kind in ("bag", "mcap")]
    with pytest.raises(RecordingError, match=r"PointCloud2 in two encodings, ros1 and cdr"):
        open_recording(parts)


def test_open_recording__folder_without_metadata_is_read_file_by_file(tmp_path):
    path = write_recording(tmp_path, "ros2-mcap", some_clouds(), some_poses())
    whole = scans_of(path)
    (path / "metadata.yaml").unlink()
    assert_same_scans(scans_of(path), whole)


@pytest.mark.parametrize("mode", ["FILE", "MESSAGE"])
def test_open_recording__compressed_ros2_folder(tmp_path, mode):
    store = STORES[CDR]
    writer = Bag2Writer(tmp_path / "bag", version=9)
    writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        msgtype = "sensor_msgs/msg/PointCloud2"
        connection = writer.add_connection("/tof_pc", msgtype, typestore=store)
        raw = store.serialize_cdr(cloud_message("mcap", START_NS, [[1, 2, 3]]), msgtype)
        writer.write(connection, START_NS, raw)
    recording = open_recording(tmp_path / "bag")
    assert len(list(recording.messages(["/tof_pc"]))) == 1
    assert recording.size_bytes > 0


def test_open_recording__mcap_with_schemas_of_other_kinds(tmp_path):
    """rosbags refuses such a file; the ROS topics in it are read all the same."""
    store, msgtype = STORES[CDR], "sensor_msgs/msg/PointCloud2"
    path = tmp_path / "mixed.mcap"
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema("status", "jsonschema", b"{}")
        writer.add_message(writer.register_channel("/status", "json", schema), 1, b"{}", 1)
        text = store.generate_msgdef(msgtype, ros_version=2)[0].encode()
        schema = writer.register_schema(msgtype, "ros2msg", text)
        raw = bytes(store.serialize_cdr(cloud_message("mcap", 2, [[1, 2, 3]]), msgtype))
        writer.add_message(writer.register_channel("/tof_pc", "cdr", schema), 2, raw, 2)
        writer.finish()
    recording = open_recording(path)
    assert recording.container == "MCAP (ROS 2, json)"
    assert [topic.msgtype for topic in recording.topics] == ["status", msgtype]
    (cloud,) = recording.messages(["/tof_pc"])
    assert recording.read(cloud, lambda message: message.width) == 1
    (status,) = recording.messages(["/status"])
    assert recording.read(status, vars) == {}


@pytest.mark.parametrize("kind", ["mcap", "mcap-ros1"])
@pytest.mark.parametrize(
    "options",
    [
        {"use_chunking": False},
        {"use_statistics": False},
        {"index_types": 0, "use_statistics": False, "use_summary_offsets": False},
        {"repeat_channels": False, "repeat_schemas": False},
        {"compression": CompressionType.LZ4},
    ],
    ids=["unchunked", "no-statistics", "no-index", "no-channels", "lz4"],
)
def test_open_recording__mcap_with_parts_left_out(tmp_path, kind, options):
    encoding = encoding_of(kind)
    store, msgtype = STORES[encoding], "sensor_msgs/msg/PointCloud2"
    serialize = store.serialize_cdr if encoding == CDR else store.serialize_ros1
    version = 2 if encoding == CDR else 1
    with (tmp_path / "flight.mcap").open("wb") as stream:
        options = dict(options)
        if "index_types" in options:
            from mcap.writer import IndexType

            options["index_types"] = IndexType.NONE
        writer = McapWriter(stream, **options)
        writer.start(profile=f"ros{version}")
        text = store.generate_msgdef(msgtype, ros_version=version)[0].encode()
        schema = writer.register_schema(msgtype, f"ros{version}msg", text)
        channel = writer.register_channel("/tof_pc", encoding, schema)
        for k in range(3):
            raw = bytes(serialize(cloud_message(kind, START_NS + k, [[k, 2, 3]]), msgtype))
            writer.add_message(channel, START_NS + k, raw, START_NS + k)
        writer.finish()
    recording = open_recording(tmp_path / "flight.mcap")
    (topic,) = recording.topics
    assert (topic.count, recording.start_ns, recording.end_ns) == (3, START_NS, START_NS + 2)
    assert len(list(recording.messages(["/tof_pc"]))) == 3


def test_sha256__is_that_of_the_bytes(tmp_path):
    import hashlib

    path = write_recording(tmp_path, "bag", some_clouds())
    assert open_recording(path).sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_open_recording__raise_on_the_same_file_twice(tmp_path):
    path = write_recording(tmp_path, "bag", some_clouds())
    (tmp_path / "link.bag").symlink_to(path)
    with pytest.raises(DuplicateRecordingError, match=r"link\.bag: is given twice"):
        open_recording([path, tmp_path / "link.bag"])


def test_open_recording__missing_path():
    with pytest.raises(RecordingNotFoundError, match=r"nowhere\.bag: no such file or folder"):
        open_recording("nowhere.bag")


def test_open_recording__no_path():
    with pytest.raises(RecordingError, match="no path"):
        open_recording([])


def test_open_recording__empty_file(tmp_path):
    path = tmp_path / "empty.bag"
    path.touch()
    with pytest.raises(RecordingError, match=r"empty\.bag: the file is empty \(0 bytes\)"):
        open_recording(path)


def test_open_recording__text_file(tmp_path):
    path = tmp_path / "notes.bag"
    path.write_text("not a bag at all")
    with pytest.raises(
        RecordingError,
        match="not a ROS 1 bag, ROS 2 bag or MCAP file: it starts with b'not a bag at all'",
    ):
        open_recording(path)


def test_open_recording__folder_of_other_files(tmp_path):
    (tmp_path / "readme.txt").write_text("hello")
    with pytest.raises(RecordingError, match=r"without metadata\.yaml, \.db3, \.mcap or "):
        open_recording(tmp_path)


def test_open_recording__not_a_regular_file(tmp_path):
    if not hasattr(os, "mkfifo"):
        pytest.skip("no named pipes here")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(RecordingError, match="not a regular file"):
        open_recording(tmp_path / "pipe")


def test_open_recording__unreadable_file(tmp_path, monkeypatch):
    path = write_recording(tmp_path, "bag", some_clouds())

    def refuse(*_args, **_kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(RecordingError, match=r"flight\.bag: cannot be read: Permission denied"):
        open_recording(path)


@pytest.mark.parametrize("kind", KINDS)
def test_open_recording__no_messages(tmp_path, kind):
    topics = [("/tof_pc", "sensor_msgs/msg/PointCloud2")]
    path = write_messages(tmp_path, kind, [], topics)
    with pytest.raises(RecordingError, match="the recording holds no messages"):
        open_recording(path)


@pytest.mark.parametrize("kind", ["bag", "bag-bz2", "bag-lz4", "mcap", "mcap-ros1", "db3"])
def test_open_recording__flipped_bytes_raise_only_our_errors(tmp_path, kind):
    path = write_recording(tmp_path, kind, some_clouds(10), some_poses())
    content = path.read_bytes()
    generator = np.random.default_rng(11)
    for _ in range(30):
        damaged = bytearray(content)
        for position in generator.integers(len(content), size=4):
            damaged[position] ^= int(generator.integers(1, 256))
        path.write_bytes(damaged)
        with suppress(RecordingError):
            scans_of(path)


def test_open_recording__path_of_the_metadata(tmp_path):
    path = write_recording(tmp_path, "ros2-mcap", some_clouds(), some_poses())
    assert_same_scans(scans_of(path / "metadata.yaml"), scans_of(path))


@pytest.mark.parametrize("kind", ["bag", "bag-lz4", "mcap-ros1"])
def test_open_recording__folder_of_files_joins_them_in_time(tmp_path, kind):
    clouds, poses = some_clouds(), some_poses()
    whole = scans_of(write_recording(tmp_path / "whole", kind, clouds, poses))
    folder = tmp_path / "split"
    folder.mkdir()
    for name, part in (("z", slice(0, 2)), ("a", slice(2, None))):  # names in no order of time
        poses_of_part = poses[part.start * 10 : part.stop and part.stop * 10]
        file = write_recording(tmp_path / name, kind, clouds[part], poses_of_part)
        file.rename(folder / f"{name}{file.suffix}")
    assert_same_scans(scans_of(folder), whole)


def test_open_recording__file_inside_of_a_folder_that_is_given_too(tmp_path):
    path = write_recording(tmp_path, "ros2-mcap", some_clouds(), some_poses())
    with pytest.raises(DuplicateRecordingError, match=r"flight\.mcap: is given twice"):
        open_recording([path, path / "flight.mcap"])


@pytest.mark.parametrize("kind", ["db3", "mcap"])
def test_open_recording__compressed_file_without_its_folder(tmp_path, kind):
    path = write_recording(tmp_path, kind, some_clouds(), some_poses())
    whole = scans_of(path)
    packed = path.with_name(path.name + ".zstd")
    packed.write_bytes(zstd_compress(path.read_bytes()))
    assert_same_scans(scans_of(packed), whole)


def test_open_recording__broken_metadata_is_done_without(tmp_path):
    path = write_recording(tmp_path, "ros2-sqlite3", some_clouds(), some_poses())
    whole = scans_of(path)
    (path / "metadata.yaml").write_text("rosbag2_bagfile_information: 3")
    recording = open_recording(path)
    assert_same_scans(list(open_flight(recording, RunConfig()).scans()), whole)
    (note,) = recording.damage_notes
    assert note.endswith(
        "metadata.yaml: is damaged, what is whole is used: cannot be read: all "
        "storage files are used"
    )


def test_open_recording__one_of_several_storage_files_is_missing(tmp_path):
    path = write_recording(tmp_path, "ros2-sqlite3", some_clouds(), some_poses())
    metadata = path / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("- flight.db3", "- flight.db3\n  - more.db3"))
    recording = open_recording(path)
    assert len(list(recording.messages(["/tof_pc"]))) == 4
    assert "more.db3: is listed in metadata.yaml, but is missing" in recording.damage_places[0]


def test_open_recording__missing_storage_file(tmp_path):
    path = write_recording(tmp_path, "ros2-sqlite3", some_clouds())
    shutil.move(path / "flight.db3", tmp_path)
    with pytest.raises(RecordingError, match=r"missing.*flight\.db3"):
        open_recording(path)


def test_import__does_not_load_the_file_libraries():
    code = (
        "import sys, beamseg_batch.recording\n"
        "print([m for m in ('rosbags', 'mcap', 'apsw') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert done.stdout.strip() == "[]"


def test_open_recording__foxglove_messages_in_protobuf_and_json(tmp_path):
    descriptors = foxglove_descriptors().SerializeToString()
    schema = b'{"properties": {"data": {"type": "string", "contentEncoding": "base64"}}}'
    path = tmp_path / "foxglove.mcap"
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        binary = writer.register_schema("foxglove.PointCloud", "protobuf", descriptors)
        text = writer.register_schema("foxglove.PoseInFrame", "jsonschema", schema)
        raw = b"\x12\x03tof"  # field 2, frame_id
        writer.add_message(writer.register_channel("/cloud", "protobuf", binary), 1, raw, 1)
        raw = b'{"frame_id": "map", "data": "AQI="}'
        writer.add_message(writer.register_channel("/pose", "json", text), 2, raw, 2)
        writer.finish()
    recording = open_recording(path)
    assert recording.container == "MCAP (json, protobuf)"
    assert [topic.msgtype for topic in recording.topics] == [
        "foxglove.PointCloud",
        "foxglove.PoseInFrame",
    ]
    cloud, pose = recording.messages(["/cloud", "/pose"])
    assert recording.read(cloud, lambda message: (message.frame_id, message.data)) == ("tof", b"")
    assert recording.read(pose, lambda message: message.data) == b"\x01\x02"
