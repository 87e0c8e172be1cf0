"""What `beamseg info` has to say."""

from __future__ import annotations

import json

import pytest

from beamseg_batch.config import RunConfig
from beamseg_batch.recording import inspect_recording, open_recording
from tests.recording.conftest import some_clouds, some_poses
from tests.recordings import START_NS, Message, cloud_message, write_recording

PITCH_90 = (0.0, 0.5**0.5, 0.0, 0.5**0.5)


@pytest.fixture
def inspected(tmp_path):
    def write(config=None, **content):
        content.setdefault("clouds", some_clouds())
        content.setdefault("poses", some_poses())
        path = write_recording(tmp_path / f"r{len(list(tmp_path.iterdir()))}", **content)
        return inspect_recording(open_recording(path), config or RunConfig())

    return write


@pytest.mark.parametrize("kind", ["bag", "mcap", "ros2-sqlite3"])
def test_inspect_recording__whole_flight(inspected, kind):
    summary = inspected(
        kind=kind, tf_static=[("base_link", "tof", (0.1, 0.2, 0.3), (0, 0.043619, 0, 0.999048))]
    )
    assert summary.problems == summary.notes == ()
    assert summary.duration_s == pytest.approx(0.39)
    assert {topic.name: topic.count for topic in summary.topics} == {
        "/mavros/local_position/pose": 40,
        "/tf_static": 1,
        "/tof_pc": 4,
    }
    assert summary.topics[2].rate_hz == pytest.approx(4 / 0.39)
    assert (summary.cloud_topic.topic, summary.cloud_topic.reason) == (
        "/tof_pc",
        "the default topic",
    )
    assert {role: frame.name for role, frame in summary.frames.items()} == {
        "sensor": "tof",
        "body": "base_link",
        "world": "map",
    }
    assert summary.extrinsic.source == "tf_static"
    assert summary.extrinsic.translation == pytest.approx((0.1, 0.2, 0.3))
    assert summary.extrinsic.rotation_rpy_deg == pytest.approx((0, 5.0, 0), abs=1e-3)
    assert summary.clouds.rate_hz == pytest.approx(10.0)
    assert summary.poses.rate_hz == pytest.approx(100.0)
    assert summary.match.share_within_gap == 1.0
    assert summary.match.max_dt_s == 0.0
    layout = summary.first_cloud
    assert (layout.width, layout.height, layout.frame_id, layout.n_returns) == (5, 3, "tof", 13)
    assert [(f.name, f.datatype, f.offset) for f in layout.fields] == [
        ("x", "float32", 0),
        ("y", "float32", 4),
        ("z", "float32", 8),
    ]


def test_inspect_recording__is_json(inspected):
    tree = json.loads(json.dumps(inspected().to_json(), allow_nan=False))
    assert tree["cloud_topic"]["topic"] == "/tof_pc"
    assert tree["frames"]["world"]["name"] == "map"
    assert tree["first_cloud"]["fields"][0]["name"] == "x"


def test_inspect_recording__largest_gaps(inspected):
    poses = [pose for k, pose in enumerate(some_poses()) if not 10 < k < 20]
    summary = inspected(poses=poses, clouds=[some_clouds()[k] for k in (0, 1, 3)])
    assert summary.poses.largest_gap_s == pytest.approx(0.1)
    assert summary.poses.largest_gap_at_s == pytest.approx(0.1)
    assert summary.clouds.largest_gap_s == pytest.approx(0.2)
    assert summary.clouds.largest_gap_at_s == pytest.approx(0.1)


def test_inspect_recording__share_of_clouds_with_a_pose(inspected):
    summary = inspected(poses=some_poses(11))
    assert summary.match.share_within_gap == 0.5
    assert summary.match.max_dt_s == pytest.approx(0.2)
    assert summary.match.median_dt_s == pytest.approx(0.05)
    assert summary.problems == ()


def test_inspect_recording__no_cloud_has_a_pose(inspected):
    clouds = [(START_NS + 10 * 10**9, [[1, 2, 3]])]
    (problem,) = inspected(clouds=clouds).problems
    assert "no cloud has a pose within 0.050 s; the median distance is 9.610 s" in problem


def test_inspect_recording__no_cloud_topic(inspected):
    summary = inspected(clouds=[])
    (problem,) = summary.problems
    assert "no cloud topic" in problem
    assert summary.cloud_topic.topic is None
    assert summary.cloud_topic.reason == problem
    assert summary.pose_topic.topic == "/mavros/local_position/pose"
    assert summary.poses.count == 40
    assert summary.clouds is summary.match is summary.first_cloud is summary.extrinsic is None


def test_inspect_recording__no_pose_topic(inspected):
    summary = inspected(poses=[])
    assert "no pose topic" in summary.pose_topic.reason
    assert summary.clouds.count == 4
    assert summary.first_cloud.width == 5


def test_inspect_recording__neither_topic(inspected):
    content = cloud_message("mcap", START_NS, [[1, 2, 3]]).header
    more = [Message("/header", START_NS, "std_msgs/msg/Header", content)]
    summary = inspected(clouds=[], poses=[], more=more)
    assert len(summary.problems) == 2
    assert "no cloud topic" in summary.cloud_topic.reason
    assert "no pose topic" in summary.pose_topic.reason


def test_inspect_recording__two_cloud_topics(inspected):
    more = [
        Message(
            "/second",
            START_NS,
            "sensor_msgs/msg/PointCloud2",
            cloud_message("mcap", START_NS, [[1, 2, 3]]),
        )
    ]
    (problem,) = inspected(cloud_topic="/first", more=more).problems
    assert "--cloud-topic" in problem


def test_inspect_recording__unclear_frames_are_a_problem(inspected):
    from tests.recording.test_frames import TF, moving

    summary = inspected(pose_type=TF, pose_topic="/tf", more=[moving("map", "rover")])
    assert "recording.body_frame" in summary.problems[0]
    assert summary.frames == {}
    assert summary.clouds.count == 4


def test_inspect_recording__cloud_that_cannot_be_read(inspected):
    content = cloud_message("mcap", START_NS, [[1, 2, 3]], fields=[])
    more = [Message("/tof_pc", START_NS, "sensor_msgs/msg/PointCloud2", content)]
    layout = inspected(clouds=[], more=more).first_cloud
    assert layout.n_returns is None
    assert "no field 'x'" in layout.problem


def test_inspect_recording__gimbal_lock_keeps_the_rotation(inspected):
    summary = inspected(tf_static=[("base_link", "tof", (0, 0, 0), PITCH_90)])
    assert summary.extrinsic.rotation_rpy_deg[1] == pytest.approx(90.0)
