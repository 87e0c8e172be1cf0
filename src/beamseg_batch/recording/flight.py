"""A recording with its topics and frames chosen: clouds paired with poses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from time import perf_counter
from typing import Any, TypeVar

from beamseg_batch.config import RunConfig
from beamseg_batch.errors import RecordingError
from beamseg_batch.model import RecordingInfo, Scan, SkippedScan, Trajectory
from beamseg_batch.recording.clouds import (
    Cloud,
    CloudHeader,
    CloudMessage,
    read_cloud,
    read_header,
)
from beamseg_batch.recording.codec import UndecodableMessageError
from beamseg_batch.recording.containers import RawMessage
from beamseg_batch.recording.frames import (
    Extrinsic,
    FrameRoles,
    TransformTree,
    choose_tf_edge,
    choose_track_edge,
    find_extrinsic,
    find_roles,
    read_static_tree,
)
from beamseg_batch.recording.matching import match_pose, seconds_to_ns, within_int64
from beamseg_batch.recording.poses import Edge, read_edges, read_tracks
from beamseg_batch.recording.source import Recording, TopicInfo
from beamseg_batch.recording.templates import CloudTemplate, cloud_template
from beamseg_batch.recording.topics import CLOUDS, POSES, TF_TYPES, TopicChoice, choose_topic

__all__ = [
    "Flight",
    "cloud_stamp_ns",
    "open_flight",
    "read_first",
    "read_trajectory",
]

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Flight:
    """The scans of a recording, read as often as needed.

    Made by `open_flight`.

    Attributes
    ----------
    recording : Recording
    config : RunConfig
    clouds, poses : TopicChoice
    trajectory : Trajectory
        All poses of the recording.
    roles : FrameRoles
    extrinsic : Extrinsic
    notes : tuple of str
        Choices worth telling.
    """

    recording: Recording
    config: RunConfig
    clouds: TopicChoice
    poses: TopicChoice
    trajectory: Trajectory
    roles: FrameRoles
    extrinsic: Extrinsic
    notes: tuple[str, ...]

    @property
    def n_clouds(self) -> int:
        """Number of clouds in the recording, usable or not."""
        return self.clouds.topic.count

    @cached_property
    def info(self) -> RecordingInfo:
        """What was read and how; the hash is computed when this is first asked for."""
        recording = self.recording
        return RecordingInfo(
            paths=recording.paths,
            container=recording.container,
            sha256=recording.sha256,
            size_bytes=recording.size_bytes,
            start_ns=recording.start_ns,
            end_ns=recording.end_ns,
            cloud_topic=self.clouds.topic.name,
            pose_topic=self.poses.topic.name,
            sensor_frame=self.roles.sensor,
            body_frame=self.roles.body,
            world_frame=self.roles.world,
            T_body_sensor=self.extrinsic.T_body_sensor,
            extrinsic_source=self.extrinsic.source,
            notes=self.notes,
        )

    def scans(self) -> Iterator[Scan | SkippedScan]:
        """Pair every cloud with its pose, in order of log time.

        Yields
        ------
        Scan or SkippedScan
            Skipped with the reason ``undecodable_message``, ``bad_cloud``,
            ``empty_cloud`` or ``no_pose_within_gap``.

        Raises
        ------
        RecordingError
            If the file cannot be read any further.
        """
        start = perf_counter()
        reader = _CloudReader(self.recording)
        for index, raw in enumerate(self.recording.topic_messages(self.clouds.topic)):
            # The clock stands while the caller works on a scan.
            yield self._scan(index, raw, reader, start)
            start = perf_counter()

    def _scan(
        self, index: int, raw: RawMessage, reader: _CloudReader, start: float
    ) -> Scan | SkippedScan:
        try:
            cloud = reader.read(raw)
        except UndecodableMessageError as error:
            return self._skipped(index, raw, raw.log_time_ns, "undecodable_message", str(error))
        stamp_ns = cloud_stamp_ns(cloud.header, raw, self.config)
        if cloud.problem:
            return self._skipped(index, raw, stamp_ns, "bad_cloud", cloud.problem)
        if len(cloud.points) == 0:
            return self._skipped(index, raw, stamp_ns, "empty_cloud", "it has no points")
        match = match_pose(self.trajectory, stamp_ns, self.config.matching)
        if match.T_world_body is None:
            detail = self._gap_detail(match.gap_ns)
            return self._skipped(index, raw, stamp_ns, "no_pose_within_gap", detail)
        return Scan(
            index=index,
            stamp_ns=stamp_ns,
            pose_stamp_ns=match.stamp_ns,
            T_world_body=match.T_world_body,
            T_body_sensor=self.extrinsic.T_body_sensor,
            points=cloud.points,
            width=cloud.width,
            height=cloud.height,
            read_us=(perf_counter() - start) * 1e6,
        )

    def _gap_detail(self, gap_ns: int) -> str:
        limit_s = self.config.matching.max_gap_s
        detail = f"nearest pose {gap_ns * 1e-9:.3f} s away, limit {limit_s:.3f} s; see "
        if gap_ns > self.recording.end_ns - self.recording.start_ns:
            return detail + "recording.time_offset_s: the stamps seem to be of two clocks"
        return detail + "matching.max_gap_s"

    def _skipped(
        self, index: int, raw: RawMessage, stamp_ns: int, reason: str, detail: str
    ) -> SkippedScan:
        # Log time: header stamps may come from another clock than the recording's span.
        where = f"cloud at {self.recording.seconds(raw.log_time_ns):.3f} s"
        return SkippedScan(index, stamp_ns, reason, f"{where}: {detail}")


class _CloudReader:
    """Reads clouds; one laid out like an earlier one is not decoded again."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._template: CloudTemplate | None = None

    def read(self, raw: RawMessage) -> Cloud:
        cloud = self._template.read(raw.data) if self._template else None
        return cloud or self._recording.read(raw, partial(self._decoded, raw))

    def _decoded(self, raw: RawMessage, message: CloudMessage) -> Cloud:
        encoding = self._recording.encoding_of(raw.msgtype)
        self._template = cloud_template(raw.data, message, encoding)
        return read_cloud(message)


def open_flight(recording: Recording, config: RunConfig) -> Flight:
    """Choose topics and frames of a recording, and read its poses.

    Parameters
    ----------
    recording : Recording
    config : RunConfig

    Returns
    -------
    Flight

    Raises
    ------
    TopicError
        If no topic, or more than one, could hold the clouds or the poses.
    RecordingError
        If it holds no usable pose, if the frames cannot be told, or if it cannot be read.
    """
    clouds = choose_topic(recording, CLOUDS, config.recording.cloud_topic)
    poses = choose_topic(recording, POSES, config.recording.pose_topic)
    recording.hold([clouds.topic.name, poses.topic.name])
    header = read_first(recording, clouds.topic, read_header) or CloudHeader("", 0)
    tree = read_static_tree(recording)
    edge, trajectory, pose_notes = read_trajectory(
        recording, poses.topic, tree, header.frame, config
    )
    roles = find_roles(edge, header.frame, tree, config.recording)
    extrinsic = find_extrinsic(config.sensor, tree, roles)
    notes = [clouds.note, poses.note, *_cloud_notes(header), *pose_notes]
    notes += [*_frame_notes(edge, roles), *extrinsic.notes]
    return Flight(
        recording,
        config,
        clouds,
        poses,
        trajectory,
        roles,
        extrinsic,
        tuple(note for note in notes if note),
    )


def read_trajectory(
    recording: Recording, topic: TopicInfo, tree: TransformTree, sensor: str, config: RunConfig
) -> tuple[Edge, Trajectory, list[str]]:
    """Read the poses of the drone.

    Parameters
    ----------
    recording : Recording
    topic : TopicInfo
        Of one of the pose types.
    tree : TransformTree
        Static transforms, which tell whose pose is the drone's in a transform topic.
    sensor : str
        Header frame of the clouds.
    config : RunConfig

    Returns
    -------
    Edge
        Header frame and child frame of the poses.
    Trajectory
    list of str
        Notes.

    Raises
    ------
    RecordingError
        If there is no usable pose, or if it is not clear whose poses to use.
    """
    where = f"{recording.name}: {topic.name}"
    wanted: Edge | None = None
    if topic.msgtype in TF_TYPES:
        wanted = choose_tf_edge(
            _moving_edges(recording, topic), tree, sensor, config.recording, where
        )
    tracks, notes = read_tracks(recording, topic, wanted)
    if not tracks:
        raise RecordingError(f"{where}: no pose could be read; {' '.join(notes)}")
    edge = wanted or choose_track_edge(tracks.keys(), config.recording, where)
    trajectory, track_notes = tracks[edge].trajectory()
    notes += track_notes
    if len(trajectory) == 0:
        raise RecordingError(f"{where}: no usable pose; {' '.join(notes)}")
    return edge, trajectory, notes


def _moving_edges(recording: Recording, topic: TopicInfo) -> list[Edge]:
    edges = read_edges(recording, topic)
    if not edges:
        raise RecordingError(f"{recording.name}: {topic.name}: no transform could be read")
    return edges


def read_first(recording: Recording, topic: TopicInfo, extract: Callable[[Any], T]) -> T | None:
    """Read the first message of a topic that can be decoded.

    Parameters
    ----------
    recording : Recording
    topic : TopicInfo
    extract : callable
        From the message object to the result.

    Returns
    -------
    object or None
        What `extract` returns; None when no message can be decoded.

    Raises
    ------
    RecordingError
        If the file cannot be read.
    """
    for raw in recording.topic_messages(topic):
        with suppress(UndecodableMessageError):
            return recording.read(raw, extract)
    return None


def cloud_stamp_ns(header: CloudHeader, raw: RawMessage, config: RunConfig) -> int:
    """Stamp of a cloud: of its header, or the log time when that is zero, plus the offset.

    Parameters
    ----------
    header : CloudHeader
    raw : RawMessage
    config : RunConfig
        Whose ``recording.time_offset_s`` is added.

    Returns
    -------
    int, nanoseconds
    """
    stamp_ns = header.stamp_ns or raw.log_time_ns
    return within_int64(stamp_ns + seconds_to_ns(config.recording.time_offset_s))


def _cloud_notes(header: CloudHeader) -> list[str]:
    if header.stamp_ns == 0:
        return ["the clouds have no stamps: their log time is used"]
    return []


def _frame_notes(edge: Edge, roles: FrameRoles) -> list[str]:
    """Say when the configuration gives a frame another name than the poses do."""
    return [
        f"the poses call the {role} frame {there!r}, the configuration {name!r}; it is only a name"
        for role, there, name in (("world", edge[0], roles.world), ("body", edge[1], roles.body))
        if there and there != name
    ]
