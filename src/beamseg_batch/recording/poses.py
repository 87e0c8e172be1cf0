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
from beamseg_batch.recording.clocks import clock_groups, clock_notes
from beamseg_batch.recording.clouds import read_header, stamp_ns_of
from beamseg_batch.recording.codec import UndecodableMessageError
from beamseg_batch.recording.containers import RawMessage
from beamseg_batch.recording.epochs import PoseEpoch, joined
from beamseg_batch.recording.matching import within_int64
from beamseg_batch.recording.px4 import ATTITUDE, LOCAL_POSITION, ODOMETRY, px4_values, sample_ns
from beamseg_batch.recording.source import Recording, TopicInfo
from beamseg_batch.recording.templates import PoseTemplate, pose_values_at

__all__ = [
    "Edge",
    "EdgeKind",
    "PoseRecord",
    "PoseTrack",
    "pose_parser",
    "read_edges",
    "read_tracks",
    "usable_poses",
    "xyz",
    "xyzw",
]

_SHORTEST_QUATERNION = 1e-9
_FARTHEST_M = 1e8
"""Farther from the origin of any frame on earth no drone is; less than the numbers can hold."""

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


class EdgeKind(NamedTuple):
    """The first pose of an edge, and whether another one differs from it."""

    first: tuple[float, float, float, float, float, float, float]
    moves: bool = False


PoseParser: TypeAlias = Callable[[RawMessage], Collection[PoseRecord]]


def xyz(vector: Any) -> tuple[float, float, float]:
    """Coordinates of a point or vector message."""
    return vector.x, vector.y, vector.z


def xyzw(quaternion: Any) -> tuple[float, float, float, float]:
    """Coordinates of a quaternion message."""
    return quaternion.x, quaternion.y, quaternion.z, quaternion.w


def _record(message: Any, child: str, position: Any, rotation: Any) -> PoseRecord:
    # tf of ROS 1 wrote frame names with a leading slash, tf2 without.
    frame, stamp_ns = read_header(message)
    return PoseRecord(stamp_ns, (frame, child.lstrip("/")), (*xyz(position), *xyzw(rotation)))


def _from_pose(message: Any) -> tuple[PoseRecord]:
    pose = message.pose
    return (_record(message, "", pose.position, pose.orientation),)


def _from_poses(message: Any) -> list[PoseRecord]:
    """Poses of one moment: with several of them, the child frames tell which is which."""
    several = len(message.poses) > 1
    return [
        _record(message, f"pose {k}" if several else "", pose.position, pose.orientation)
        for k, pose in enumerate(message.poses)
    ]


def _from_pose_with_covariance(message: Any) -> tuple[PoseRecord]:
    pose = message.pose.pose
    return (_record(message, "", pose.position, pose.orientation),)


def _from_odometry(message: Any) -> tuple[PoseRecord]:
    pose = message.pose.pose
    return (_record(message, message.child_frame_id, pose.position, pose.orientation),)


def _from_transform(message: Any) -> tuple[PoseRecord]:
    transform = message.transform
    child = message.child_frame_id
    return (_record(message, child, transform.translation, transform.rotation),)


def _from_transforms(message: Any) -> list[PoseRecord]:
    return [record for transform in message.transforms for record in _from_transform(transform)]


def _from_frame_transform(message: Any) -> tuple[PoseRecord]:
    edge = message.parent_frame_id.lstrip("/"), message.child_frame_id.lstrip("/")
    values = (*xyz(message.translation), *xyzw(message.rotation))
    return (PoseRecord(stamp_ns_of(message.timestamp), edge, values),)


def _from_frame_transforms(message: Any) -> list[PoseRecord]:
    return [record for each in message.transforms for record in _from_frame_transform(each)]


def _from_px4(message: Any) -> tuple[PoseRecord]:
    return (PoseRecord(sample_ns(message), ("", ""), px4_values(message)),)


_FOXGLOVE_EXTRACTORS: Mapping[str, Callable[[Any], Collection[PoseRecord]]] = {
    "PoseInFrame": _from_pose,
    "PosesInFrame": _from_poses,
    "FrameTransform": _from_frame_transform,
    "FrameTransforms": _from_frame_transforms,
}
_EXTRACTORS: Mapping[str, Callable[[Any], Collection[PoseRecord]]] = {
    "geometry_msgs/msg/PoseStamped": _from_pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _from_pose_with_covariance,
    "geometry_msgs/msg/TransformStamped": _from_transform,
    "nav_msgs/msg/Odometry": _from_odometry,
    "tf2_msgs/msg/TFMessage": _from_transforms,
    "tf/msg/tfMessage": _from_transforms,
    **{f"foxglove.{name}": extract for name, extract in _FOXGLOVE_EXTRACTORS.items()},
    **{f"foxglove_msgs/msg/{name}": extract for name, extract in _FOXGLOVE_EXTRACTORS.items()},
    **dict.fromkeys((ODOMETRY, LOCAL_POSITION, ATTITUDE), _from_px4),
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
    from_log : bool
        Whether the log times are taken whatever the headers say.
    stamps_ns, log_times_ns : array of int64
        In order of the file.
    values : array of float64
        Seven per pose, as in `PoseRecord`.
    n_log_times : int
        Poses whose header stamp was zero, so that the log time stands in for it.
    """

    edge: Edge
    from_log: bool = False
    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    log_times_ns: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))
    n_log_times: int = 0

    def add(self, record: PoseRecord, log_time_ns: int) -> None:
        """Append a pose."""
        if record.stamp_ns == 0 and not self.from_log:
            self.n_log_times += 1
        stamp_ns = log_time_ns if self.from_log else record.stamp_ns or log_time_ns
        self.stamps_ns.append(within_int64(stamp_ns))
        self.log_times_ns.append(within_int64(log_time_ns))
        self.values.extend(record.values)

    def add_many(
        self, stamps_ns: NDArray[np.int64], values: FloatArray, log_times_ns: Sequence[int]
    ) -> None:
        """Append poses in order of the file."""
        logged = np.array(log_times_ns, np.int64)
        unset = stamps_ns == 0
        if self.from_log:
            stamps_ns = logged
        elif unset.any():
            self.n_log_times += int(unset.sum())
            stamps_ns = np.where(unset, logged, stamps_ns)
        self.stamps_ns.frombytes(stamps_ns.tobytes())
        self.log_times_ns.frombytes(logged.tobytes())
        self.values.frombytes(values.tobytes())

    def epochs(self) -> tuple[list[PoseEpoch], list[str]]:
        """Poses that can be used, in order of their stamps, by the state of their clock.

        Returns
        -------
        list of PoseEpoch
            One, unless the clock was set anew. Quaternions made unit; of poses with the same
            stamp the first in the file.
        list of str
            Notes on what was refused, dropped or replaced.
        """
        stamps = np.array(self.stamps_ns, dtype=np.int64)
        values = np.array(self.values, dtype=np.float64).reshape(-1, 7)
        usable = usable_poses(values)
        groups = clock_groups(self.stamps_ns, self.log_times_ns)
        every = [usable] if len(groups) == 1 else [part[usable[part]] for _, part in groups]
        parts = [_trajectory(stamps[kept], values[kept]) for kept in every]
        notes = self._notes(len(usable), int(usable.sum()), sum(map(len, parts)))
        notes += clock_notes("poses", self.stamps_ns, self.log_times_ns)
        epochs = [
            PoseEpoch(p, state) for (state, _), p in zip(groups, parts, strict=True) if len(p)
        ]
        return epochs or [PoseEpoch(parts[0], None)], notes

    def trajectory(self) -> tuple[Trajectory, list[str]]:
        """Poses of all `epochs` in order of their stamps, and the same notes."""
        epochs, notes = self.epochs()
        return joined(epochs), notes

    def _notes(self, n_read: int, n_usable: int, n_unique: int) -> list[str]:
        notes = []
        if n_usable < n_read:
            notes.append(
                f"{n_read - n_usable} of {n_read} poses refused: a value that is not finite or "
                "beyond 100,000 km, or a quaternion of length zero"
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


def _trajectory(stamps_ns: NDArray[np.int64], values: FloatArray) -> Trajectory:
    # np.unique gives the first of equal stamps, since it sorts stably for this.
    unique, first = np.unique(stamps_ns, return_index=True)
    values = values[first]
    lengths = np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
    return Trajectory(unique, values[:, :3].copy(), values[:, 3:] / lengths)


def usable_poses(values: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which poses are finite, on earth, and have a quaternion with a length.

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
        near = np.asarray((np.abs(values[:, :3]) <= _FARTHEST_M).all(axis=1))
    finite = np.asarray(np.isfinite(values).all(axis=1)) & np.isfinite(lengths)
    usable: NDArray[np.bool_] = finite & near & (lengths > _SHORTEST_QUATERNION)
    return usable


def read_tracks(
    recording: Recording,
    topic: TopicInfo,
    wanted: Collection[Edge] | None = None,
    *,
    from_log: bool = False,
) -> tuple[dict[Edge, PoseTrack], list[str]]:
    """Read every pose of a topic.

    Parameters
    ----------
    recording : Recording
    topic : TopicInfo
        Of one of the pose types.
    wanted : collection of Edge, optional
        Keep only the poses of these child frames in these parent frames.
    from_log : bool, optional
        Take the log times for the stamps.

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
    tracks = _Tracks(wanted, from_log)
    undecodable: list[str] = []
    messages = recording.topic_messages(topic)
    template: PoseTemplate | None = None
    while batch := list(islice(messages, _BATCH)):
        template = template or _template(recording, batch[0])
        if template is None or not _add_batch(tracks, recording, template, batch):
            _add_each(tracks, recording, batch, undecodable)
    if not undecodable:
        return tracks.by_edge, []
    plural = "" if len(undecodable) == 1 else "s"
    return tracks.by_edge, [
        f"{len(undecodable)} message{plural} of {topic.name} left out: {undecodable[0]}"
    ]


class _Tracks:
    """Tracks by their edge, made when the first pose of one comes."""

    def __init__(self, wanted: Collection[Edge] | None, from_log: bool) -> None:
        self.by_edge: dict[Edge, PoseTrack] = {}
        self._wanted = wanted
        self._from_log = from_log

    def of(self, edge: Edge) -> PoseTrack | None:
        if self._wanted is not None and edge not in self._wanted:
            return None
        return self.by_edge.setdefault(edge, PoseTrack(edge, self._from_log))


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
    tracks: _Tracks,
    recording: Recording,
    template: PoseTemplate,
    batch: Sequence[RawMessage],
) -> bool:
    """Add messages that differ in stamp and numbers alone; False when they differ in more."""
    parsed = template.parse([raw.data for raw in batch])
    if parsed is None:
        return False
    (record,) = pose_parser(recording, batch[0].msgtype)(batch[0])
    track = tracks.of(record.edge)
    if track is not None:
        track.add_many(*parsed, [raw.log_time_ns for raw in batch])
    return True


def _add_each(
    tracks: _Tracks,
    recording: Recording,
    batch: Sequence[RawMessage],
    undecodable: list[str],
) -> None:
    for log_time_ns, records in _parsed(recording, batch, undecodable):
        for record in records:
            track = tracks.of(record.edge)
            if track is not None:
                track.add(record, log_time_ns)


def read_edges(recording: Recording, topic: TopicInfo) -> dict[Edge, EdgeKind]:
    """List whose poses a topic holds, without keeping them.

    Parameters
    ----------
    recording : Recording
    topic : TopicInfo
        Of one of the pose types.

    Returns
    -------
    dict of Edge to EdgeKind
        In order of first appearance.

    Raises
    ------
    RecordingError
        If the file cannot be read to its end.
    """
    kinds: dict[Edge, EdgeKind] = {}
    for _, records in _parsed(recording, recording.topic_messages(topic), []):
        for _, edge, values in records:
            kind = kinds.setdefault(edge, EdgeKind(values))
            if not kind.moves and kind.first != values:
                kinds[edge] = kind._replace(moves=True)
    return kinds


def _parsed(
    recording: Recording, messages: Iterable[RawMessage], undecodable: list[str]
) -> Iterator[tuple[int, Collection[PoseRecord]]]:
    for raw in messages:
        try:
            yield raw.log_time_ns, pose_parser(recording, raw.msgtype)(raw)
        except UndecodableMessageError as error:
            undecodable.append(str(error))
