"""Which topic holds the clouds and which the drone's poses."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from beamseg_batch.errors import AmbiguousTopicError, TopicError
from beamseg_batch.recording.depth import IMAGE, is_depth_topic
from beamseg_batch.recording.other_clouds import FOXGLOVE_CLOUDS
from beamseg_batch.recording.px4 import LOCAL_POSITION, ODOMETRY
from beamseg_batch.recording.source import Recording, TopicInfo

__all__ = [
    "CLOUDS",
    "POSES",
    "TF_TYPES",
    "TopicChoice",
    "TopicRole",
    "choose_topic",
    "is_static_tf",
]

TF_TYPES = (
    "tf2_msgs/msg/TFMessage",
    "tf/msg/tfMessage",
    "foxglove.FrameTransform",
    "foxglove.FrameTransforms",
    "foxglove_msgs/msg/FrameTransform",
    "foxglove_msgs/msg/FrameTransforms",
)
"""Message types of a transform tree."""


@dataclass(frozen=True)
class TopicRole:
    """What a topic is needed for.

    Attributes
    ----------
    word : str
        ``cloud`` or ``pose``; names the option and the configuration key.
    default : str
        Topic that is taken when it is there.
    tiers : tuple of tuple of str
        Types that fit; those of a later tier when no topic of an earlier one is there.
    """

    word: str
    default: str
    tiers: tuple[tuple[str, ...], ...]

    @property
    def msgtypes(self) -> tuple[str, ...]:
        """All types that fit."""
        return tuple(msgtype for tier in self.tiers for msgtype in tier)

    def fits(self, topic: TopicInfo) -> bool:
        """Whether a topic's type can play the role."""
        return topic.msgtype in self.msgtypes and not is_static_tf(topic)


CLOUDS = TopicRole(
    "cloud",
    "/tof_pc",
    (
        ("sensor_msgs/msg/PointCloud2", *FOXGLOVE_CLOUDS),
        ("sensor_msgs/msg/PointCloud",),
        (IMAGE,),
    ),
)
POSES = TopicRole(
    "pose",
    "/mavros/local_position/pose",
    (
        (
            "geometry_msgs/msg/PoseStamped",
            "geometry_msgs/msg/PoseWithCovarianceStamped",
            "geometry_msgs/msg/TransformStamped",
            "nav_msgs/msg/Odometry",
            "foxglove.PoseInFrame",
            "foxglove.PosesInFrame",
            "foxglove_msgs/msg/PoseInFrame",
            "foxglove_msgs/msg/PosesInFrame",
        ),
        (ODOMETRY,),
        (LOCAL_POSITION,),
        TF_TYPES,
    ),
)


@dataclass(frozen=True)
class TopicChoice:
    """A chosen topic and why it was chosen.

    Attributes
    ----------
    topic : TopicInfo
    reason : str
        For people, such as ``the default topic``.
    note : str
        A sentence when the choice is worth telling, else empty.
    """

    topic: TopicInfo
    reason: str
    note: str = ""


def is_static_tf(topic: TopicInfo) -> bool:
    """Whether a topic holds static transforms, such as ``/tf_static``."""
    return topic.msgtype in TF_TYPES and topic.name.rpartition("/")[2] == "tf_static"


def choose_topic(recording: Recording, role: TopicRole, named: str | None) -> TopicChoice:
    """Choose the topic for a role.

    Parameters
    ----------
    recording : Recording
    role : TopicRole
    named : str or None
        Topic that the configuration names.

    Returns
    -------
    TopicChoice
        The named one; else the role's default when present; else the only one that fits.

    Raises
    ------
    AmbiguousTopicError
        If none is named and several fit.
    TopicError
        If none fits, or the named one is missing, empty or of another type.
    """
    candidates = _candidates(recording, role)
    if named is not None:
        return TopicChoice(
            _named_topic(recording, role, named), f"named by recording.{role.word}_topic"
        )
    for topic in candidates:
        if _same_name(topic.name, role.default):
            return TopicChoice(topic, "the default topic")
    if not candidates:
        raise TopicError(
            f"{recording.name}: no {role.word} topic, that is, none of type "
            f"{_either(_for_people(role.msgtypes))}; "
            f"its topics: {_listed(recording.topics)}"
        )
    if len(candidates) > 1:
        raise AmbiguousTopicError(
            f"{recording.name}: {len(candidates)} topics could hold the {role.word}s: "
            f"{_listed(candidates)}; choose one with --{role.word}-topic"
        )
    (topic,) = candidates
    note = f"{role.word} topic {topic.name}: the only one of a fitting type ({topic.msgtype})"
    return TopicChoice(topic, "the only topic of a fitting type", note)


def _candidates(recording: Recording, role: TopicRole) -> list[TopicInfo]:
    """Topics of the first tier that is there; of images only those of depths."""
    fitting = [topic for topic in recording.topics if role.fits(topic) and topic.count]
    for tier in role.tiers:
        there = [
            topic
            for topic in fitting
            if topic.msgtype in tier
            and (topic.msgtype != IMAGE or is_depth_topic(recording, topic))
        ]
        if there:
            return there
    return []


def _named_topic(recording: Recording, role: TopicRole, named: str) -> TopicInfo:
    there = [topic for topic in recording.topics if _same_name(topic.name, named)]
    fitting = [topic for topic in there if role.fits(topic)]
    used = [topic for topic in fitting if topic.count]
    if used:
        return used[0]
    if not there:
        problem = "is not in the recording"
    elif fitting:
        problem = "holds no messages"
    elif is_static_tf(there[0]):
        problem = "holds static transforms, which do not move"
    else:
        problem = f"is of type {there[0].msgtype}, which holds no {role.word}s"
    candidates = _listed(_candidates(recording, role)) or "none"
    raise TopicError(
        f"{recording.name}: {role.word} topic {named!r} {problem}; topics that fit: {candidates}"
    )


def _same_name(name: str, other: str) -> bool:
    """ROS 1 logs may leave out the leading slash."""
    return name.lstrip("/") == other.lstrip("/")


def _for_people(msgtypes: tuple[str, ...]) -> tuple[str, ...]:
    """Leave out the names under which ROS carries types of Foxglove's."""
    return tuple(name for name in msgtypes if not name.startswith("foxglove_msgs/"))


def _either(words: tuple[str, ...]) -> str:
    *others, last = words
    return f"{', '.join(others)} or {last}" if others else last


def _listed(topics: Iterable[TopicInfo]) -> str:
    return ", ".join(
        f"{topic.name} ({topic.msgtype or 'no type'}, {topic.count} "
        f"message{'' if topic.count == 1 else 's'})"
        for topic in topics
    )
