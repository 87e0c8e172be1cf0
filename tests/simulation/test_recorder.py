"""Recordings of every kind, read back."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from rosbags.rosbag1 import Reader

from beamseg_batch.config import load_config
from beamseg_batch.errors import ConfigError
from beamseg_batch.recording import open_flight, open_recording
from beamseg_batch.simulation.recorder import FORMATS, RecordingKind, choose_kind, open_recorder

KINDS = [
    (name, compression) for name, format_ in FORMATS.items() for compression in format_.compressions
]
START = 1_700_000_000_000_000_000
ONE = np.array([0.0, 0.0, 0.0, 1.0])
POINTS = np.arange(5 * 4 * 3, dtype=np.float32).reshape(5, 4, 3)
POINTS[0, 0] = np.inf


def write(path, kind):
    with open_recorder(path, kind) as recorder:
        turned = np.array([0.0, 0.6, 0.0, 0.8])
        recorder.static_transform(START, "base_link", "tof", np.array([0.1, 0.2, 0.3]), turned)
        for k in range(60):
            stamp = START + k * 100_000_000
            recorder.pose(stamp + 1, stamp, "map", np.array([k, 0.5, 1.0]), ONE)
            recorder.cloud(stamp + 2, stamp + 7, "tof", POINTS + np.float32(k))
    return path


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
def test_recorder__every_kind_reads_back(tmp_path, kind):
    path = write(tmp_path / "flight", RecordingKind(*kind))
    assert [entry.name for entry in tmp_path.iterdir()] == ["flight"]
    recording = open_recording(path)
    flight = open_flight(recording, load_config())
    assert (flight.roles.sensor, flight.roles.body, flight.roles.world) == (
        "tof",
        "base_link",
        "map",
    )
    np.testing.assert_allclose(flight.extrinsic.T_body_sensor.translation, [0.1, 0.2, 0.3])
    assert flight.extrinsic.source == "tf_static"
    np.testing.assert_array_equal(flight.trajectory.positions[:, 0], np.arange(60))
    scans = list(flight.scans())
    assert [scan.stamp_ns for scan in scans] == [START + 7 + k * 100_000_000 for k in range(60)]
    assert (scans[3].width, scans[3].height) == (4, 5)
    np.testing.assert_array_equal(scans[3].points, (POINTS + 3).reshape(-1, 3))


@pytest.mark.parametrize("kind", [("bag", "lz4"), ("mcap", "zstd"), ("ros2-mcap", "zstd")])
def test_recorder__same_messages_same_bytes(tmp_path, kind):
    def digest(path):
        file = next(path.glob("*.mcap")) if path.is_dir() else path
        return hashlib.sha256(file.read_bytes()).hexdigest()

    (tmp_path / "other").mkdir()
    first = write(tmp_path / "flight", RecordingKind(*kind))
    second = write(tmp_path / "other" / "flight", RecordingKind(*kind))
    assert digest(first) == digest(second)


def test_recorder__ros1_numbers_headers_and_latches_transforms(tmp_path):
    path = write(tmp_path / "flight.bag", RecordingKind("bag", "none"))
    with Reader(path) as reader:
        latched = {c.topic: c.ext.latching for c in reader.connections}
        counts = [
            int.from_bytes(raw[:4], "little")
            for connection, _, raw in reader.messages()
            if connection.topic == "/tof_pc"
        ]
    assert latched["/tf_static"] == 1
    assert counts == list(range(60))


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("flight.bag", ("bag", "none")),
        ("flight.MCAP", ("mcap", "zstd")),
        ("flight.db3", ("db3", "none")),
        ("flight", ("ros2", "none")),
    ],
)
def test_choose_kind__by_name(tmp_path, name, kind):
    assert choose_kind(tmp_path / name) == RecordingKind(*kind)


def test_choose_kind__by_flag(tmp_path):
    assert choose_kind(tmp_path / "flight", "bag", "bz2") == RecordingKind("bag", "bz2")


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("flight.txt",), r"the ending '\.txt' tells no format; end the name in \.mcap"),
        (("flight", "rosbag"), "unknown format 'rosbag'; there are: bag, mcap,"),
        (("flight.bag", None, "zstd"), "bag cannot be compressed by 'zstd'; it can by: none, bz2"),
    ],
)
def test_choose_kind__errors(tmp_path, arguments, complaint):
    name, *flags = arguments
    with pytest.raises(ConfigError, match=complaint):
        choose_kind(tmp_path / name, *flags)
