"""Which topics are taken, and what is said when none can be."""

from __future__ import annotations

import pytest

from beamseg_batch.errors import AmbiguousTopicError, TopicError
from beamseg_batch.recording import open_recording
from beamseg_batch.recording.topics import CLOUDS, POSES, choose_topic
from tests.recording.conftest import UNPLACED_CAMERA, some_clouds, some_poses
from tests.recordings import (
    START_NS,
    Message,
    cloud_message,
    pose_message,
    write_messages,
    write_recording,
)

CLOUD = "sensor_msgs/msg/PointCloud2"
POSE = "geometry_msgs/msg/PoseStamped"
TF = "tf2_msgs/msg/TFMessage"


def cloud_on(topic: str) -> Message:
    return Message(topic, START_NS, CLOUD, cloud_message("mcap", START_NS, [[1, 2, 3]]))


def pose_on(topic: str, msgtype: str = POSE) -> Message:
    content = pose_message("mcap", msgtype, START_NS, (0, 0, 0), (0, 0, 0, 1))
    return Message(topic, START_NS, msgtype, content)


@pytest.fixture
def recorded(tmp_path):
    def write(*messages, topics=()):
        return open_recording(write_messages(tmp_path, "mcap", messages, topics))

    return write


def test_choose_topic__default_before_others(recorded):
    recording = recorded(cloud_on("/tof_pc"), cloud_on("/other"))
    choice = choose_topic(recording, CLOUDS, None)
    assert (choice.topic.name, choice.reason, choice.note) == ("/tof_pc", "the default topic", "")


def test_choose_topic__only_candidate_is_noted(recorded):
    choice = choose_topic(recorded(cloud_on("/lidar"), pose_on("/pose")), CLOUDS, None)
    assert choice.topic.name == "/lidar"
    assert choice.note.startswith("cloud topic /lidar: the only one of a fitting type")


def test_choose_topic__named(recorded):
    recording = recorded(cloud_on("/tof_pc"), cloud_on("/other"))
    choice = choose_topic(recording, CLOUDS, "/other")
    assert (choice.topic.name, choice.reason) == ("/other", "named by recording.cloud_topic")
    assert choose_topic(recording, CLOUDS, "other").topic.name == "/other"


def test_choose_topic__default_name_of_another_type_is_no_default(recorded):
    choice = choose_topic(recorded(pose_on("/tof_pc"), cloud_on("/lidar")), CLOUDS, None)
    assert choice.topic.name == "/lidar"


def test_choose_topic__empty_topic_is_no_candidate(recorded):
    recording = recorded(cloud_on("/lidar"), topics=[("/tof_pc", CLOUD)])
    assert choose_topic(recording, CLOUDS, None).topic.name == "/lidar"
    with pytest.raises(TopicError, match=r"'/tof_pc' holds no messages; topics that fit: /lidar"):
        choose_topic(recording, CLOUDS, "/tof_pc")


def test_choose_topic__several_candidates(recorded):
    recording = recorded(cloud_on("/a"), cloud_on("/b"), cloud_on("/b"))
    with pytest.raises(
        AmbiguousTopicError,
        match=(
            r"2 topics could hold the clouds: /a \(sensor_msgs/msg/PointCloud2, 1 message\), "
            r"/b \(sensor_msgs/msg/PointCloud2, 2 messages\); choose one with --cloud-topic"
        ),
    ):
        choose_topic(recording, CLOUDS, None)


def test_choose_topic__several_pose_candidates_name_their_option(recorded):
    recording = recorded(pose_on("/a"), pose_on("/b", "nav_msgs/msg/Odometry"))
    with pytest.raises(AmbiguousTopicError, match="--pose-topic"):
        choose_topic(recording, POSES, None)


def test_choose_topic__no_candidate_lists_what_is_there(recorded):
    with pytest.raises(TopicError, match=r"no cloud topic.*its topics: /pose \(geometry_msgs"):
        choose_topic(recorded(pose_on("/pose")), CLOUDS, None)


def test_choose_topic__named_missing_or_of_wrong_type(recorded):
    recording = recorded(cloud_on("/lidar"), pose_on("/pose"))
    with pytest.raises(TopicError, match=r"'/x' is not in the recording; topics that fit: /lidar"):
        choose_topic(recording, CLOUDS, "/x")
    with pytest.raises(TopicError, match=r"'/pose' is of type geometry_msgs/msg/PoseStamped"):
        choose_topic(recording, CLOUDS, "/pose")


def test_choose_topic__tf_only_as_a_last_resort(recorded):
    assert choose_topic(recorded(pose_on("/tf", TF)), POSES, None).topic.name == "/tf"


def test_choose_topic__pose_before_tf(recorded):
    recording = recorded(pose_on("/tf", TF), pose_on("/odom", "nav_msgs/msg/Odometry"))
    assert choose_topic(recording, POSES, None).topic.name == "/odom"
    assert choose_topic(recording, POSES, "/tf").topic.name == "/tf"


def test_choose_topic__static_tf_never(recorded):
    recording = recorded(pose_on("/tf_static", TF))
    with pytest.raises(TopicError, match="no pose topic"):
        choose_topic(recording, POSES, None)
    with pytest.raises(TopicError, match="holds static transforms"):
        choose_topic(recording, POSES, "/tf_static")


def test_open_flight__defaults(fly):
    info = fly().info
    assert (info.cloud_topic, info.pose_topic) == ("/tof_pc", "/mavros/local_position/pose")
    assert info.notes == (UNPLACED_CAMERA,)


def test_write_recording__names_of_topics(tmp_path):
    path = write_recording(
        tmp_path, "bag", some_clouds(), some_poses(), cloud_topic="/c", pose_topic="/p"
    )
    assert [topic.name for topic in open_recording(path).topics] == ["/c", "/p"]
