"""Pose messages of every type -> a trajectory."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import Trajectory
from beamseg_batch.recording.codec import UndecodableMessageError
from beamseg_batch.recording.containers import RawMessage
from beamseg_batch.recording.matching import within_int64
from beamseg_batch.recording.source import Recording, TopicInfo
from beamseg_batch.recording.templates import PoseTemplate, pose_values_at

__all__ = [
    "Edge",
    "PoseRecord",
    "PoseTrack",
    "pose_parser",
    "read_edges",
    "read_tracks",
    "usable_poses",
]

_SHORTEST_QUATERNION = 1e-9

_BATCH = 4096  # messages whose bytes are in memory at once

Edge: TypeAlias = tuple[str, str]
"""Parent frame and child frame; the child is empty when the message names none."""


class PoseRecord(NamedTuple):
    """One pose as a message states it: where the child frame is in the parent frame.

    Attributes
    ----------
    stamp_ns : int
        Header stamp; 0 when it was not set.
    edge : Edge
    values : tuple of 7 float
        Position x, y, z in metres, then quaternion x, y, z, w.
    """

    stamp_ns: int
    edge: Edge
    values: tuple[float, float, float, float, float, float, float]


PoseParser: TypeAlias = Callable[[RawMessage], Collection[PoseRecord]]


def _record(header: Any, child: str, position: Any, rotation: Any) -> PoseRecord:
    stamp = header.stamp
    return PoseRecord(
        stamp.sec * 1_000_000_000 + stamp.nanosec,
        # tf of ROS 1 wrote frame names with a leading slash, tf2 without.
        (header.frame_id.lstrip("/"), child.lstrip("/")),
        (
            position.x, position.y, position.z,
            rotation.x, rotation.y, rotation.z, rotation.w,
        ),
    )  # fmt: skip


def _from_pose(message: Any) -> tuple[PoseRecord]:
    pose = message.pose
    return (_record(message.header, "", pose.position, pose.orientation),)


def _from_pose_with_covariance(message: Any) -> tuple[PoseRecord]:
    pose = message.pose.pose
    return (_record(message.header, "", pose.position, pose.orientation),)


def _from_odometry(message: Any) -> tuple[PoseRecord]:
    pose = message.pose.pose
    return (_record(message.header, message.child_frame_id, pose.position, pose.orientation),)


def _from_transform(message: Any) -> tuple[PoseRecord]:
    transform = message.transform
    return (
        _record(message.header, message.child_frame_id, transform.translation, transform.rotation),
    )


def _from_transforms(message: Any) -> list[PoseRecord]:
    return [record for transform in message.transforms for record in _from_transform(transform)]


_EXTRACTORS: Mapping[str, Callable[[Any], Collection[PoseRecord]]] = {
    "geometry_msgs/msg/PoseStamped": _from_pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _from_pose_with_covariance,
    "geometry_msgs/msg/TransformStamped": _from_transform,
    "nav_msgs/msg/Odometry": _from_odometry,
    "tf2_msgs/msg/TFMessage": _from_transforms,
    "tf/msg/tfMessage": _from_transforms,
}


def pose_parser(recording: Recording, msgtype: str) -> PoseParser:
    """Function from a message to the poses in it.

    Parameters
    ----------
    recording : Recording
        Whose definition of the type is used.
    msgtype : str
        One of the pose types, named as ROS 2 does.

    Returns
    -------
    callable
        Raises `UndecodableMessageError` on bytes that do not fit the type.
    """
    extract = _EXTRACTORS[msgtype]

    def parse(raw: RawMessage) -> Collection[PoseRecord]:
        return recording.read(raw, extract)

    return parse


@dataclass
class PoseTrack:
    """The poses of one child frame in one parent frame, as read.

    Attributes
    ----------
    edge : Edge
    stamps_ns : array of int64
        In order of the file.
    values : array of float64
        Seven per pose, as in `PoseRecord`.
    n_log_times : int
        Poses whose header stamp was zero, so that the log time stands in for it.
    """

    edge: Edge
    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))
    n_log_times: int = 0

    def add(self, record: PoseRecord, log_time_ns: int) -> None:
        """Append a pose."""
        if record.stamp_ns == 0:
            self.n_log_times += 1
        self.stamps_ns.append(within_int64(record.stamp_ns or log_time_ns))
        self.values.extend(record.values)

    def add_many(
        self, stamps_ns: NDArray[np.int64], values: FloatArray, log_times_ns: Sequence[int]
    ) -> None:
        """Append poses in order of the file."""
        unset = stamps_ns == 0
        if unset.any():
            self.n_log_times += int(unset.sum())
            stamps_ns = np.where(unset, np.array(log_times_ns, np.int64), stamps_ns)
        self.stamps_ns.frombytes(stamps_ns.tobytes())
        self.values.frombytes(values.tobytes())

    def trajectory(self) -> tuple[Trajectory, list[str]]:
        """Poses that can be used, in order of their stamps.

        Returns
        -------
        Trajectory
            Quaternions made unit; of poses with the same stamp the first in the file.
        list of str
            Notes on what was refused, dropped or replaced.
        """
        stamps = np.array(self.stamps_ns, dtype=np.int64)
        values = np.array(self.values, dtype=np.float64).reshape(-1, 7)
        usable = usable_poses(values)
        stamps, values = stamps[usable], values[usable]
        # np.unique gives the first of equal stamps, since it sorts stably for this.
        unique, first = np.unique(stamps, return_index=True)
        values = values[first]
        lengths = np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
        trajectory = Trajectory(unique, values[:, :3].copy(), values[:, 3:] / lengths)
        return trajectory, self._notes(len(usable), len(stamps), len(unique))

    def _notes(self, n_read: int, n_usable: int, n_unique: int) -> list[str]:
        notes = []
        if n_usable < n_read:
            notes.append(
                f"{n_read - n_usable} of {n_read} poses refused: a value that is not finite, "
                "or a quaternion of length zero"
            )
        if n_unique < n_usable:
            notes.append(
                f"{n_usable - n_unique} of {n_read} poses dropped: their stamps repeat another's"
            )
        if self.n_log_times:
            notes.append(
                f"{self.n_log_times} of {n_read} poses have no stamp: their log time is used"
            )
        return notes


def usable_poses(values: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which poses are finite and have a quaternion with a length.

    Parameters
    ----------
    values : (N, 7) float64
        Position, then quaternion.

    Returns
    -------
    (N,) bool
    """
    # A length that overflows is infinite, hence refused; so is one that is NaN.
    with np.errstate(over="ignore", invalid="ignore"):
        lengths = np.linalg.norm(values[:, 3:], axis=1)
    finite = np.asarray(np.isfinite(values).all(axis=1))
    usable: NDArray[np.bool_] = finite & np.isfinite(lengths) & (lengths > _SHORTEST_QUATERNION)
    return usable


def read_tracks(
    recording: Recording, topic: TopicInfo, wanted: Edge | None = None
) -> tuple[dict[Edge, PoseTrack], list[str]]:
    """Read every pose of a topic.

    Parameters
    ----------
    recording : Recording
    topic : TopicInfo
        Of one of the pose types.
    wanted : Edge, optional
        Keep only the poses of this child frame in this parent frame.

    Returns
    -------
    dict of Edge to PoseTrack
    list of str
        A note when messages could not be decoded.

    Raises
    ------
    RecordingError
        If the file cannot be read to its end.
    """
    tracks: dict[Edge, PoseTrack] = {}
    undecodable: list[str] = []
    messages = recording.topic_messages(topic)
    template: PoseTemplate | None = None
    while batch := list(islice(messages, _BATCH)):
        template = template or _template(recording, batch[0])
        if template is None or not _add_batch(tracks, recording, template, batch):
            _add_each(tracks, recording, batch, wanted, undecodable)
    if not undecodable:
        return tracks, []
    plural = "" if len(undecodable) == 1 else "s"
    return tracks, [
        f"{len(undecodable)} message{plural} of {topic.name} left out: {undecodable[0]}"
    ]


def _template(recording: Recording, raw: RawMessage) -> PoseTemplate | None:
    """Make a template of a message, if its numbers lie where they are looked for."""
    encoding = recording.encoding_of(raw.msgtype)
    values_at = pose_values_at(raw.data, raw.msgtype, encoding)
    if values_at is None:
        return None
    template = PoseTemplate(raw.data, values_at)
    try:
        (record,) = pose_parser(recording, raw.msgtype)(raw)
    except UndecodableMessageError:
        return None
    parsed = template.parse([raw.data])
    # A recording may define a type in its own way.
    is_true = parsed and parsed[0][0] == record.stamp_ns and tuple(parsed[1][0]) == record.values
    return template if is_true else None


def _add_batch(
    tracks: dict[Edge, PoseTrack],
    recording: Recording,
    template: PoseTemplate,
    batch: Sequence[RawMessage],
) -> bool:
    """Add messages that differ in stamp and numbers alone; False when they differ in more."""
    parsed = template.parse([raw.data for raw in batch])
    if parsed is None:
        return False
    (record,) = pose_parser(recording, batch[0].msgtype)(batch[0])
    track = tracks.setdefault(record.edge, PoseTrack(record.edge))
    track.add_many(*parsed, [raw.log_time_ns for raw in batch])
    return True


def _add_each(
    tracks: dict[Edge, PoseTrack],
    recording: Recording,
    batch: Sequence[RawMessage],
    wanted: Edge | None,
    undecodable: list[str],
) -> None:
    for log_time_ns, records in _parsed(recording, batch, undecodable):
        for record in records:
            if wanted is None or record.edge == wanted:
                track = tracks.setdefault(record.edge, PoseTrack(record.edge))
                track.add(record, log_time_ns)


def read_edges(recording: Recording, topic: TopicInfo) -> list[Edge]:
    """List whose poses a topic holds, without keeping them.

    Parameters
    ----------
    recording : Recording
    topic : TopicInfo
        Of one of the pose types.

    Returns
    -------
    list of Edge
        In order of first appearance.

    Raises
    ------
    RecordingError
        If the file cannot be read to its end.
    """
    parsed = _parsed(recording, recording.topic_messages(topic), [])
    return list(dict.fromkeys(record.edge for _, records in parsed for record in records))


def _parsed(
    recording: Recording, messages: Iterable[RawMessage], undecodable: list[str]
) -> Iterator[tuple[int, Collection[PoseRecord]]]:
    for raw in messages:
        try:
            yield raw.log_time_ns, pose_parser(recording, raw.msgtype)(raw)
        except UndecodableMessageError as error:
            undecodable.append(str(error))
