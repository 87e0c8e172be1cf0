"""Ranges of time, every n-th cloud, and no more than so many."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from beamseg_batch.config import RunConfig
from beamseg_batch.errors import NoScansError
from beamseg_batch.model import Scan, SkippedScan
from beamseg_batch.recording import open_flight, open_recording
from beamseg_batch.recording.blocks import BlockFile
from beamseg_batch.recording.codec import UndecodableMessageError
from tests.recording.conftest import configured, some_clouds, some_poses
from tests.recordings import KINDS, START_NS, Message, pose_message, write_recording


@pytest.mark.parametrize(
    ("chosen", "indexes"),
    [
        ({}, range(10)),
        ({"start_s": 0.3}, range(3, 10)),
        ({"duration_s": 0.3}, range(3)),
        ({"start_s": 0.25, "duration_s": 0.5}, range(3, 8)),
        ({"every": 4}, (0, 4, 8)),
        ({"max_scans": 3}, range(3)),
        ({"max_scans": 30}, range(10)),
        ({"start_s": 0.1, "every": 3, "max_scans": 2}, (1, 4)),
    ],
)
@pytest.mark.parametrize("kind", ["bag", "mcap", "db3"])
def test_scans__of_the_selection(fly, kind, chosen, indexes):
    flight = fly(
        configured(recording=chosen), kind=kind, clouds=some_clouds(10), poses=some_poses(100)
    )
    assert [scan.index for scan in flight.scans()] == list(indexes)
    assert flight.n_clouds == len(indexes)
    assert len(flight.trajectory) == 100


LONG = {"clouds": some_clouds(50, 1000), "poses": some_poses(500, 100)}
"""Fifty seconds, with a cloud each second: longer than the margins around a selection."""


@pytest.fixture(scope="module", params=KINDS)
def long(request, tmp_path_factory):
    """Fifty seconds as a recording of every kind, and all its scans by their index."""
    path = write_recording(tmp_path_factory.mktemp("long"), request.param, **LONG)
    scans = open_flight(open_recording(path), RunConfig()).scans()
    return path, {scan.index: scan for scan in scans}


@pytest.fixture
def unheld(monkeypatch):
    """Nothing is held in memory, as of a long recording."""
    monkeypatch.setattr("beamseg_batch.recording.source._MOST_HELD_BYTES", 0)


@pytest.mark.parametrize(
    "chosen",
    [
        {"start_s": 30.0},
        {"start_s": 20.5, "duration_s": 6.0},
        {"duration_s": 4.0},
        {"start_s": 44.0, "every": 2, "max_scans": 2},
    ],
)
def test_scans__sought_are_those_of_the_stream(long, unheld, chosen):
    path, every = long
    found = list(open_flight(open_recording(path), configured(recording=chosen)).scans())
    start_s, step = chosen.get("start_s", 0.0), chosen.get("every", 1)
    stop_s = start_s + chosen.get("duration_s", 100.0)
    expected = [k for k in range(50) if start_s <= k < stop_s][::step]
    assert [scan.index for scan in found] == expected[: chosen.get("max_scans")]
    for scan in found:
        true = every[scan.index]
        assert (scan.stamp_ns, scan.pose_stamp_ns) == (true.stamp_ns, true.pose_stamp_ns)
        np.testing.assert_array_equal(scan.points, true.points)
        np.testing.assert_array_equal(scan.T_world_body.translation, true.T_world_body.translation)


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_scans__what_lies_before_the_start_is_not_read(tmp_path, unheld, monkeypatch, kind):
    """Five files of ten seconds stand for the chunks of one."""
    parts = [
        write_recording(
            tmp_path / str(k), kind, LONG["clouds"][10 * k :][:10], LONG["poses"][100 * k :][:100]
        )
        for k in range(5)
    ]
    recording = open_recording(parts)
    read = Counter()
    batches = BlockFile._batches
    monkeypatch.setattr(
        BlockFile, "_batches", lambda self, *args: read.update([self.path]) or batches(self, *args)
    )
    monkeypatch.setattr("beamseg_batch.recording.flight._SAMPLED_CLOUDS", 3)
    config = configured(recording={"start_s": 45.0})
    flight = open_flight(recording, config)
    assert [scan.index for scan in flight.scans()] == list(range(45, 50))
    assert {parts.index(path) for path in read} == {0, 3, 4}  # the first tells the frames
    assert int(flight.trajectory.stamps_ns[0] - START_NS) == 30 * 10**9


def test_scans__poses_of_another_clock_are_read_whole(fly, unheld):
    """The poses were logged half a minute before the clouds that belong to them."""
    early = [
        Message(m.topic, m.log_ns - 30 * 10**9, m.msgtype, m.content)
        for m in pose_messages(LONG["poses"])
    ]
    config = configured(recording={"start_s": 65.0})
    flight = fly(config, clouds=LONG["clouds"], poses=[], more=early)
    assert [scan.index for scan in flight.scans() if isinstance(scan, Scan)] == list(range(35, 50))
    assert len(flight.trajectory) == 500


def pose_messages(poses):
    msgtype = "geometry_msgs/msg/PoseStamped"
    return [
        Message("/p", stamp, msgtype, pose_message("mcap", msgtype, stamp, *pose))
        for stamp, *pose in poses
    ]


def test_scans__left_out_clouds_are_not_decoded(fly, monkeypatch):
    flight = fly(configured(recording={"start_s": 0.3}), clouds=some_clouds(4))
    first_ns = flight.recording.start_ns
    read = type(flight.recording).read

    def refuse_early(self, raw, extract):
        if raw.log_time_ns < first_ns + 300_000_000:
            raise UndecodableMessageError("too early")
        return read(self, raw, extract)

    monkeypatch.setattr(type(flight.recording), "read", refuse_early)
    assert not any(isinstance(scan, SkippedScan) for scan in flight.scans())


def test_open_flight__raise_when_no_cloud_is_left(fly):
    with pytest.raises(NoScansError, match=r"none of 4 clouds lies in .* 5 s to 6 s of 0\.390 s"):
        fly(configured(recording={"start_s": 5.0, "duration_s": 1.0}))


def test_thinned__multiplies(fly):
    flight = fly(configured(recording={"every": 2}), clouds=some_clouds(13)).thinned(3)
    assert [scan.index for scan in flight.scans()] == [0, 6, 12]
