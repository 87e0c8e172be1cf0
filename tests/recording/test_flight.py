"""Clouds paired with poses."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.config import RunConfig
from beamseg_batch.errors import TopicError
from beamseg_batch.model import Scan, SkippedScan
from beamseg_batch.recording import open_flight, open_recording
from tests.recording.conftest import MS, configured, some_clouds, some_poses
from tests.recording.test_containers import assert_same_scans
from tests.recordings import START_NS, Message, cloud_message, write_recording

CLOUD = "sensor_msgs/msg/PointCloud2"


def test_scans__are_the_same_every_time(fly):
    flight = fly()
    first = list(flight.scans())
    assert_same_scans(first, list(flight.scans()))
    assert [scan.index for scan in first] == [0, 1, 2, 3]


def test_scans__two_iterations_at_once(fly):
    flight = fly()
    pairs = list(zip(flight.scans(), flight.scans(), strict=True))
    assert_same_scans([a for a, _ in pairs], [b for _, b in pairs])


def test_scans__carry_extrinsic_and_time(fly):
    scan = next(fly(tf_static=[("base_link", "tof", (0.5, 0, 0), (0, 0, 0, 1))]).scans())
    np.testing.assert_array_equal(scan.T_body_sensor.translation, [0.5, 0, 0])
    assert 0.0 < scan.read_us < 1e6


def test_scans__reading_time_excludes_the_caller(fly, monkeypatch):
    from beamseg_batch.recording import flight as module

    clock = iter(range(1000))
    monkeypatch.setattr(module, "perf_counter", lambda: next(clock) * 1e-6)
    for scan in fly().scans():
        for _ in range(50):
            next(clock)
        assert scan.read_us == pytest.approx(1.0)


def test_scans__no_pose_within_gap(fly):
    skipped = [scan for scan in fly(poses=some_poses(16)).scans() if isinstance(scan, SkippedScan)]
    # The last pose is at 150 ms, so the cloud at 200 ms is just near enough.
    assert [(scan.index, scan.reason) for scan in skipped] == [(3, "no_pose_within_gap")]
    assert skipped[-1].detail == (
        "cloud at 0.300 s: nearest pose 0.150 s away, limit 0.050 s; see matching.max_gap_s"
    )
    assert skipped[-1].stamp_ns == START_NS + 300 * MS


def test_scans__clouds_and_poses_of_two_clocks(fly):
    clouds = [(stamp - 10**18, cloud) for stamp, cloud in some_clouds(1)]
    more = [Message("/tof_pc", START_NS, CLOUD, cloud_message("mcap", *clouds[0]))]
    (scan,) = fly(clouds=[], more=more).scans()
    assert scan.reason == "no_pose_within_gap"
    assert "see --time-source log or --time-offset" in scan.detail
    assert "the stamps seem to be of two clocks" in scan.detail


@pytest.mark.parametrize("offset_s", [0.02, -0.5])
def test_scans__time_offset_is_added_to_clouds(fly, offset_s):
    config = configured(recording={"time_offset_s": offset_s}, matching={"max_gap_s": 1.0})
    for scan, (stamp, _) in zip(fly(config).scans(), some_clouds(), strict=True):
        assert scan.stamp_ns == stamp + round(offset_s * 1e9)


def test_scans__method_changes_the_pose_not_the_match(fly):
    clouds = [(START_NS + 13 * MS, [[1, 2, 3]])]
    results = {}
    for method in ("nearest", "interpolate"):
        (scan,) = fly(configured(matching={"method": method}), clouds=clouds).scans()
        assert scan.pose_stamp_ns == START_NS + 10 * MS
        assert scan.pose_gap_s == pytest.approx(0.003)
        results[method] = scan.T_world_body.translation[0]
    assert results == pytest.approx({"nearest": 0.010, "interpolate": 0.013})


def test_scans__bad_empty_and_undecodable_clouds_are_skipped(fly, monkeypatch):
    stamps = [START_NS + k * 10 * MS for k in range(4)]
    contents = [
        cloud_message("mcap", stamps[0], [[1, 2, 3]]),
        cloud_message("mcap", stamps[1], [[1, 2, 3]], row_step=13),
        cloud_message("mcap", stamps[2], np.empty((0, 3))),
        cloud_message("mcap", stamps[3], [[1, 2, 3]]),
    ]
    more = [
        Message("/tof_pc", stamp, CLOUD, content)
        for stamp, content in zip(stamps, contents, strict=True)
    ]
    flight = fly(clouds=[], more=more)
    streamed = flight.recording.messages

    def spoiled(topics):
        for k, message in enumerate(streamed(topics)):
            yield message._replace(data=message.data[:50]) if k == 3 else message

    monkeypatch.setattr(flight.recording, "messages", spoiled)
    good, *skipped = flight.scans()
    assert isinstance(good, Scan)
    assert [(scan.index, scan.reason) for scan in skipped] == [
        (1, "bad_cloud"),
        (2, "empty_cloud"),
        (3, "undecodable_message"),
    ]
    assert skipped[0].detail.startswith("cloud at 0.010 s: the data has 12 bytes")
    assert [scan.stamp_ns for scan in skipped] == stamps[1:]


def test_scans__clouds_out_of_order_are_matched_by_stamp(fly):
    stamps = [START_NS + 200 * MS, START_NS + 100 * MS]
    more = [
        Message("/tof_pc", START_NS + k, CLOUD, cloud_message("mcap", stamp, [[1, 2, 3]]))
        for k, stamp in enumerate(stamps)
    ]
    scans = list(fly(clouds=[], more=more).scans())
    assert [scan.stamp_ns for scan in scans] == [scan.pose_stamp_ns for scan in scans] == stamps


def test_scans__float64_clouds_stay_float64(fly):
    from tests.recordings import message

    fields = [
        message("mcap", "sensor_msgs/msg/PointField", name=n, offset=8 * k, datatype=8, count=1)
        for k, n in enumerate("xyz")
    ]
    points = np.array([[0.1, 0.2, 0.3]])
    content = cloud_message(
        "mcap",
        START_NS,
        points,
        fields=fields,
        point_step=24,
        row_step=24,
        data=points.view(np.uint8).ravel(),
    )
    (scan,) = fly(clouds=[], more=[Message("/tof_pc", START_NS, CLOUD, content)]).scans()
    assert scan.points.dtype == np.float64
    np.testing.assert_array_equal(scan.points, points)


def test_info__describes_the_recording(tmp_path):
    path = write_recording(tmp_path, "bag", some_clouds(), some_poses())
    info = open_flight(open_recording(path), RunConfig()).info
    assert info.paths == (path,)
    assert info.container == "ROS 1 bag"
    assert info.size_bytes == path.stat().st_size
    assert len(info.sha256) == 64
    assert info.duration_s == pytest.approx(0.39)


def test_open_flight__raise_without_clouds_or_poses(fly):
    with pytest.raises(TopicError, match="no cloud topic"):
        fly(clouds=[])
    with pytest.raises(TopicError, match="no pose topic"):
        fly(poses=[])
