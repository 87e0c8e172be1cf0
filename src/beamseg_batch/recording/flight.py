"""A recording with its topics and frames chosen: clouds paired with poses."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain, islice
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.bearings import PixelGrid, find_grid, in_order
from beamseg_batch.config import RunConfig
from beamseg_batch.errors import BeamsegError, NoScansError, RecordingError
from beamseg_batch.geometry import RigidTransform
from beamseg_batch.model import PoseJitter, RecordingInfo, Scan, SkippedScan, Trajectory
from beamseg_batch.recording.axes import (
    T_OPTICAL_SENSOR,
    AheadAxis,
    AheadCounts,
    choose_axis,
)
from beamseg_batch.recording.chains import Chain, find_chain
from beamseg_batch.recording.clocks import StampWatch, duration_text
from beamseg_batch.recording.cloud_reader import CloudReader
from beamseg_batch.recording.cloud_stamps import cloud_stamp_ns, read_cloud_stamps
from beamseg_batch.recording.clouds import Cloud, CloudHeader
from beamseg_batch.recording.codec import UndecodableMessageError
from beamseg_batch.recording.containers import RawMessage
from beamseg_batch.recording.depth import IMAGE
from beamseg_batch.recording.epochs import PoseClocks, PoseEpoch, joined, nearest_epoch
from beamseg_batch.recording.frames import (
    Extrinsic,
    FrameRoles,
    TransformTree,
    choose_track_edge,
    find_extrinsic,
    find_roles,
    read_static_tree,
    tree_of,
)
from beamseg_batch.recording.jitter import without_jitter
from beamseg_batch.recording.kept_scans import KeptScans
from beamseg_batch.recording.matching import PoseMatch, match_pose, nearest_gaps
from beamseg_batch.recording.pose_arrays import resampled
from beamseg_batch.recording.pose_files import read_pose_file
from beamseg_batch.recording.poses import Edge, EdgeKind, read_edges, read_tracks
from beamseg_batch.recording.px4 import ATTITUDE, LOCAL_POSITION
from beamseg_batch.recording.selection import Selection
from beamseg_batch.recording.source import Recording, TopicInfo
from beamseg_batch.recording.topics import CLOUDS, POSES, TF_TYPES, TopicChoice, choose_topic

__all__ = [
    "Flight",
    "FlightPoses",
    "choose_poses",
    "open_flight",
    "read_poses",
]

_SAMPLED_CLOUDS = 64
"""Most clouds looked at to tell which axis looks ahead."""
_POSE_MARGIN_NS, _NEAR_POSE_NS = 10_000_000_000, 1_000_000_000
"""Log time around the selected clouds in which their poses are looked for, and the farthest that
the first cloud may be from its pose for them to be there."""
_FAR_APART_S = 60.0
"""How much longer than the recording the time from clouds to poses is when clocks differ."""


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
        All poses of the recording, smoothed where they jitter.
    epochs : tuple of PoseEpoch
        The same by the state of their clock.
    jitter : PoseJitter
    roles : FrameRoles
    extrinsic : Extrinsic
    axis : AheadAxis
        Which axis of the clouds looks ahead.
    notes : tuple of str
        Choices worth telling.
    are_ordered : bool
        Whether the points of clouds without rows are put in an order of their own.
    grid : PixelGrid or None
        Pixels into which they are put back, where these are known.
    """

    recording: Recording
    config: RunConfig
    clouds: TopicChoice
    poses: TopicChoice
    trajectory: Trajectory
    epochs: tuple[PoseEpoch, ...]
    jitter: PoseJitter
    roles: FrameRoles
    extrinsic: Extrinsic
    axis: AheadAxis
    notes: tuple[str, ...]
    are_ordered: bool = False
    grid: PixelGrid | None = None

    @cached_property
    def selection(self) -> Selection:
        """Which of the clouds are used."""
        return Selection.of(self.config.recording, self.recording)

    @cached_property
    def n_clouds(self) -> int:
        """Number of clouds that `scans` goes through, usable or not."""
        return self.selection.count(self.recording, self.clouds.topic)

    @cached_property
    def _kept(self) -> KeptScans:
        return KeptScans()

    @cached_property
    def _matches(self) -> dict[int, tuple[Trajectory, PoseMatch]]:
        return {}

    @cached_property
    def _clocks(self) -> PoseClocks:
        read_clouds = partial(read_cloud_stamps, self.recording, self.clouds.topic, self.config)
        return PoseClocks(self.epochs, read_clouds)

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
            damage=recording.damage_places,
            damage_notes=recording.damage_notes,
            T_cloud_sensor=T_OPTICAL_SENSOR if self.axis.is_z else RigidTransform.identity(),
        )

    def thinned(self, every: int) -> Flight:
        """Return the same flight with only every so manieth of its clouds.

        Parameters
        ----------
        every : int

        Returns
        -------
        Flight
        """
        recording = self.config.recording
        fewer = recording.model_copy(update={"every": recording.every * max(every, 1)})
        return replace(self, config=self.config.model_copy(update={"recording": fewer}))

    def usable(self) -> Iterator[Scan]:
        """Scans up to where the recording ends or is damaged, without those that are skipped.

        Yields
        ------
        Scan
        """
        with suppress(BeamsegError):
            for scan in self.scans():
                if isinstance(scan, Scan):
                    yield scan

    def organised(self) -> Flight:
        """Return the same flight with clouds in rows and columns, where they came without.

        Returns
        -------
        Flight
            The same where clouds are images already. Where the points are on no grid, they are
            put in order.
        """
        first = next(self.usable(), None)
        if first is None or first.height > 1:
            return self
        sample = self.thinned(-(-self.n_clouds // _SAMPLED_CLOUDS))
        grid = find_grid(scan.points for scan in sample.usable())
        note = (
            "the clouds have no rows and columns, and their points are on no grid: pixels without "
            "return say nothing"
            if grid is None
            else "the clouds have no rows and columns: their points are put back into an image of "
            f"{grid.width} x {grid.height} pixels"
        )
        return replace(self, are_ordered=True, grid=grid, notes=(*self.notes, note))

    def scans(self) -> Iterator[Scan | SkippedScan]:
        """Pair every selected cloud with its pose, in order of log time.

        Yields
        ------
        Scan or SkippedScan
            Skipped with the reason ``undecodable_message``, ``bad_cloud``,
            ``empty_cloud``, ``clock_reset`` or ``no_pose_within_gap``.

        Raises
        ------
        RecordingError
            If the file cannot be read any further.
        """
        yield from self._kept.reading(self._read_scans())

    def _read_scans(self) -> Iterator[Scan | SkippedScan]:
        start = perf_counter()
        topic = self.clouds.topic
        reader = CloudReader(self.recording, topic, self.config.sensor, self.axis.is_z)
        watch = StampWatch()
        for index, raw in self.selection.messages(self.recording, topic):
            # The clock stands while the caller works on a scan.
            yield self._scan(index, raw, reader, watch, start)
            start = perf_counter()

    def _scan(
        self, index: int, raw: RawMessage, reader: CloudReader, watch: StampWatch, start: float
    ) -> Scan | SkippedScan:
        try:
            cloud = reader.read(raw)
        except UndecodableMessageError as error:
            return self._skipped(index, raw, raw.log_time_ns, "undecodable_message", str(error))
        stamp_ns = cloud_stamp_ns(cloud.header.stamp_ns, raw.log_time_ns, self.config)
        if cloud.problem:
            return self._skipped(index, raw, stamp_ns, "bad_cloud", cloud.problem)
        if len(cloud.points) == 0:
            return self._skipped(index, raw, stamp_ns, "empty_cloud", "it has no points")
        jumped = watch.sees_jump(stamp_ns, raw.log_time_ns)
        poses = self._clocks.poses_of(index, jumped)
        if poses is None:
            detail = "a clock was reset, and stood as that of no pose; see --time-source log"
            return self._skipped(index, raw, stamp_ns, "clock_reset", detail)
        match = self._match(poses, index, stamp_ns)
        if match.T_world_body is None:
            detail = self._gap_detail(match.gap_ns)
            return self._skipped(index, raw, stamp_ns, "no_pose_within_gap", detail)
        points, width, height = _as_one_kind(cloud.points), cloud.width, cloud.height
        if self.grid is not None and height == 1:
            points = self.grid.image_of(points)
            width, height = self.grid.width, self.grid.height
        elif self.are_ordered and height == 1:
            points = in_order(points)
        return Scan(
            index=index,
            stamp_ns=stamp_ns,
            pose_stamp_ns=match.stamp_ns,
            T_world_body=match.T_world_body,
            T_body_sensor=self.extrinsic.T_body_sensor,
            points=points,
            width=width,
            height=height,
            read_us=(perf_counter() - start) * 1e6,
            log_ns=raw.log_time_ns,
        )

    def _match(self, poses: Trajectory, index: int, stamp_ns: int) -> PoseMatch:
        """Pose of a cloud: looked for once, though the flight is read a dozen times."""
        known = self._matches.get(index)
        if known is None or known[0] is not poses:
            known = poses, match_pose(poses, stamp_ns, self.config.matching)
            self._matches[index] = known
        return known[1]

    def _gap_detail(self, gap_ns: int) -> str:
        limit_s = self.config.matching.max_gap_s
        detail = f"nearest pose {gap_ns * 1e-9:.3f} s away, limit {limit_s:.3f} s; see "
        if gap_ns > self.recording.end_ns - self.recording.start_ns:
            way_out = _clock_way_out(self.config)
            return detail + f"{way_out}: the stamps seem to be of two clocks"
        return detail + "matching.max_gap_s"

    def _skipped(
        self, index: int, raw: RawMessage, stamp_ns: int, reason: str, detail: str
    ) -> SkippedScan:
        # Log time: header stamps may come from another clock than the recording's span.
        where = f"cloud at {self.recording.seconds(raw.log_time_ns):.3f} s"
        return SkippedScan(index, stamp_ns, reason, f"{where}: {detail}")


def _as_one_kind(points: NDArray[np.floating]) -> NDArray[np.floating]:
    """Points in one piece that cannot be written, since kernels are compiled for each kind."""
    points = np.ascontiguousarray(points)
    points.flags.writeable = False
    return points


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
    PoseFileError
        If the file of poses that is named cannot be read.
    NoScansError
        If no cloud lies in the range of time that is asked for.
    RecordingError
        If it holds no usable pose, if the frames cannot be told, or if it cannot be read.
    """
    clouds = choose_topic(recording, CLOUDS, config.recording.cloud_topic)
    choice = choose_poses(recording, config)
    recording.hold([clouds.topic.name, choice.topic.name])
    reader = CloudReader(recording, clouds.topic, config.sensor)
    sample = _Sample(recording, clouds.topic, reader)
    tree = read_static_tree(recording)
    poses = _read_poses_nearby(recording, choice, clouds.topic, tree, sample, config)
    poses, jitter = _steadied(poses, config)
    roles = find_roles(poses.edge, sample.header.frame, poses.tree, config.recording)
    extrinsic = find_extrinsic(config.sensor, poses.tree, roles)
    axis = _ahead(sample, config, roles, poses)
    notes = [clouds.note, choice.note, *_cloud_notes(sample, config), *poses.notes]
    notes += [reader.camera.note if reader.camera else "", axis.note]
    notes += [*_frame_notes(poses.edge, roles), *extrinsic.notes]
    notes += _clock_notes(sample, poses.trajectory, recording, config)
    if axis.is_z and _is_of_cloud_axes(extrinsic, poses.edge, roles):
        extrinsic = replace(extrinsic, T_body_sensor=extrinsic.T_body_sensor @ T_OPTICAL_SENSOR)
    flight = Flight(
        recording,
        config,
        clouds,
        choice,
        poses.trajectory,
        poses.epochs,
        jitter,
        roles,
        extrinsic,
        axis,
        tuple(note for note in notes if note),
    )
    if flight.selection.is_timed and clouds.topic.count and not flight.n_clouds:
        raise NoScansError(
            f"{recording.name}: {clouds.topic.name}: none of {clouds.topic.count} clouds lies in "
            f"the range of time asked for, {_range_text(config)} of "
            f"{recording.seconds(recording.end_ns):.3f} s; see --start and --duration"
        )
    return flight


class _Sample:
    """The first clouds of a topic, read as far as they are asked for."""

    def __init__(self, recording: Recording, topic: TopicInfo, reader: CloudReader) -> None:
        self.topic = topic
        self.header = CloudHeader("", 0)
        self.log_time_ns: int | None = None
        self._clouds = self._read(recording, topic, reader)
        self._first = next(self._clouds, None)

    def _read(self, recording: Recording, topic: TopicInfo, reader: CloudReader) -> Iterator[Cloud]:
        for raw in recording.topic_messages(topic):
            with suppress(UndecodableMessageError):
                cloud = reader.read(raw)
                if self.log_time_ns is None:
                    self.header, self.log_time_ns = cloud.header, raw.log_time_ns
                yield cloud

    def counts(self) -> AheadCounts:
        """Count the returns ahead along either axis in the first clouds."""
        clouds = chain([self._first] if self._first else [], self._clouds)
        return AheadCounts.of(cloud.points for cloud in islice(clouds, _SAMPLED_CLOUDS))


def _ahead(sample: _Sample, config: RunConfig, roles: FrameRoles, poses: FlightPoses) -> AheadAxis:
    if sample.topic.msgtype == IMAGE:
        return AheadAxis(True, "depths are along the optical axis")
    linked = poses.tree.transform(roles.body, roles.sensor)
    rotation = None if linked is None else linked.rotation
    return choose_axis(config.sensor, roles.sensor, sample.counts(), rotation)


def _is_of_cloud_axes(extrinsic: Extrinsic, edge: Edge, roles: FrameRoles) -> bool:
    """Whether ``T_body_sensor`` is of the clouds' own axes, be they optical.

    One that is configured, or taken for the identity, is of a camera with x forward; one of
    the transform tree is of the frame, and so is a pose of the very frame of the clouds.
    """
    if extrinsic.source == "identity":
        return bool(edge[1]) and edge[1] == roles.sensor
    return extrinsic.source == "tf_static"


def choose_poses(recording: Recording, config: RunConfig) -> TopicChoice:
    """Choose where the poses come from: the file that is named, else a topic.

    Parameters
    ----------
    recording : Recording
    config : RunConfig

    Returns
    -------
    TopicChoice
        A file stands as a topic of its path, without a type.

    Raises
    ------
    TopicError
        As `choose_topic` does.
    """
    path = config.recording.pose_file
    if path is None:
        return choose_topic(recording, POSES, config.recording.pose_topic)
    return TopicChoice(TopicInfo(path, "", 0), "named by recording.pose_file")


@dataclass(frozen=True, eq=False)
class FlightPoses:
    """The drone's poses, as read.

    Attributes
    ----------
    edge : Edge
        Frame and child frame of the poses; empty where nothing names them.
    epochs : tuple of PoseEpoch
        By the state of their clock, at least one.
    tree : TransformTree
        Static transforms, those included that a moving topic repeats without change.
    notes : list of str
    """

    edge: Edge
    epochs: tuple[PoseEpoch, ...]
    tree: TransformTree
    notes: list[str]

    @cached_property
    def trajectory(self) -> Trajectory:
        """All poses in order of their stamps."""
        return joined(self.epochs)


def _read_poses_nearby(
    recording: Recording,
    choice: TopicChoice,
    clouds: TopicInfo,
    tree: TransformTree,
    sample: _Sample,
    config: RunConfig,
) -> FlightPoses:
    """Read the poses around the selected clouds, or all where these do not reach the clouds.

    Of a transform tree all are needed: what does not move may have been told once.
    """
    frame, selection = sample.header.frame, Selection.of(config.recording, recording)
    if selection.is_timed and choice.topic.msgtype not in TF_TYPES:
        first = config.model_copy(
            update={"recording": config.recording.model_copy(update={"max_scans": 1})}
        )
        stamps = read_cloud_stamps(recording, clouds, first).used_ns
        with suppress(RecordingError):
            near = recording.within(selection.span(_POSE_MARGIN_NS))
            poses = read_poses(near, choice, tree, frame, config)
            if len(stamps) and nearest_gaps(poses.trajectory.stamps_ns, stamps)[0] < _NEAR_POSE_NS:
                return poses
    return read_poses(recording, choice, tree, frame, config)


def _steadied(poses: FlightPoses, config: RunConfig) -> tuple[FlightPoses, PoseJitter]:
    """Take the jitter out of poses, as far as the configuration asks for it."""
    recorded = [epoch.trajectory for epoch in poses.epochs]
    steady, jitter = without_jitter(recorded, config.sensor, config.matching.smooth)
    epochs = zip(poses.epochs, steady, strict=True)
    return replace(poses, epochs=tuple(replace(e, trajectory=t) for e, t in epochs)), jitter


def read_poses(
    recording: Recording, choice: TopicChoice, tree: TransformTree, sensor: str, config: RunConfig
) -> FlightPoses:
    """Read the poses of the drone.

    Parameters
    ----------
    recording : Recording
    choice : TopicChoice
        Topic of one of the pose types, or file.
    tree : TransformTree
        Static transforms, which tell whose pose is the drone's in a transform topic.
    sensor : str
        Header frame of the clouds.
    config : RunConfig

    Returns
    -------
    FlightPoses

    Raises
    ------
    RecordingError
        If there is no usable pose, or if it is not clear whose poses to use.
    """
    topic = choice.topic
    where = f"{recording.name}: {topic.name}"
    if config.recording.pose_file is not None:
        track = read_pose_file(Path(config.recording.pose_file))
        trajectory, notes = track.trajectory()
        poses = FlightPoses(track.edge, (PoseEpoch(trajectory, None),), tree, notes)
    elif topic.msgtype in TF_TYPES:
        poses = _poses_of_tree(recording, topic, tree, sensor, config)
    else:
        poses = _poses_of_topic(recording, topic, tree, config)
    usable = tuple(epoch for epoch in poses.epochs if len(epoch.trajectory))
    if not usable:
        raise RecordingError(f"{where}: no usable pose; {' '.join(poses.notes)}")
    return replace(poses, epochs=usable)


def _poses_of_topic(
    recording: Recording, topic: TopicInfo, tree: TransformTree, config: RunConfig
) -> FlightPoses:
    where = f"{recording.name}: {topic.name}"
    from_log = config.recording.time_source == "log"
    tracks, notes = read_tracks(recording, topic, from_log=from_log)
    if not tracks:
        raise RecordingError(f"{where}: no pose could be read; {' '.join(notes)}")
    edge = choose_track_edge(tracks.keys(), config.recording, where)
    epochs, track_notes = tracks[edge].epochs()
    if topic.msgtype == LOCAL_POSITION:
        epochs, attitude_notes = _with_attitude(recording, topic, epochs, from_log)
        track_notes += attitude_notes
    return FlightPoses(edge, tuple(epochs), tree, notes + track_notes)


def _with_attitude(
    recording: Recording, topic: TopicInfo, epochs: list[PoseEpoch], from_log: bool
) -> tuple[list[PoseEpoch], list[str]]:
    """Give positions that know their heading alone the attitudes of another topic."""
    there = [other for other in recording.topics if other.msgtype == ATTITUDE and other.count]
    tracks = read_tracks(recording, there[0], from_log=from_log)[0] if there else {}
    for track in tracks.values():
        attitudes, _ = track.epochs()
        if len(joined(attitudes)):
            note = f"the attitudes are those of {there[0].name}"
            return [_turned(e, nearest_epoch(attitudes, e.ahead_s)) for e in epochs], [note]
    return epochs, [
        f"{topic.name} holds the heading alone: the drone is taken to be level, which displaces "
        "beams when it tilts; record px4_msgs/VehicleOdometry or VehicleAttitude with it"
    ]


def _turned(epoch: PoseEpoch, attitudes: PoseEpoch) -> PoseEpoch:
    """Give positions other attitudes, as far as these are known at their stamps."""
    trajectory = epoch.trajectory
    turned = resampled(attitudes.trajectory, trajectory.stamps_ns)
    kept = np.isin(trajectory.stamps_ns, turned.stamps_ns)
    return replace(epoch, trajectory=replace(turned, positions=trajectory.positions[kept]))


def _poses_of_tree(
    recording: Recording, topic: TopicInfo, tree: TransformTree, sensor: str, config: RunConfig
) -> FlightPoses:
    where = f"{recording.name}: {topic.name}"
    moving = _moving_edges(recording, topic)
    found = find_chain(moving, tree, sensor, config.recording, where)
    fixed = {e: kind.first for e, kind in moving.items() if not kind.moves}
    fixed = {e: values for e, values in fixed.items() if e not in found.moving}
    grown = tree_of(fixed).grown(tree)
    from_log = config.recording.time_source == "log"
    tracks, notes = read_tracks(recording, topic, found.moving, from_log=from_log)
    by_edge: dict[Edge, list[PoseEpoch]] = {}
    for edge, track in tracks.items():
        by_edge[edge], track_notes = track.epochs()
        if len(joined(by_edge[edge])) == 0:
            raise RecordingError(
                f"{where}: no usable pose of {edge[1]!r} in {edge[0]!r}; {' '.join(track_notes)}"
            )
        notes += track_notes
    if len(found.edges) > 1:
        path = " -> ".join(dict.fromkeys(frame for edge in found.edges for frame in edge))
        notes.append(f"the poses are the product of the transforms {path}")
    epochs = _followed(found, by_edge, grown)
    return FlightPoses((found.world, found.body), epochs, grown, notes)


def _followed(
    found: Chain, by_edge: dict[Edge, list[PoseEpoch]], tree: TransformTree
) -> tuple[PoseEpoch, ...]:
    """Multiply the transforms along a chain, in every state that their clock was in."""
    states = [epoch.ahead_s for epoch in max(by_edge.values(), key=len)]
    tracks = [
        {edge: nearest_epoch(epochs, state).trajectory for edge, epochs in by_edge.items()}
        for state in states
    ]
    return tuple(
        PoseEpoch(found.follow(track, tree), state)
        for track, state in zip(tracks, states, strict=True)
    )


def _moving_edges(recording: Recording, topic: TopicInfo) -> dict[Edge, EdgeKind]:
    edges = read_edges(recording, topic)
    if not edges:
        raise RecordingError(f"{recording.name}: {topic.name}: no transform could be read")
    return edges


def _cloud_notes(sample: _Sample, config: RunConfig) -> list[str]:
    if sample.header.stamp_ns == 0 and config.recording.time_source == "header":
        return ["the clouds have no stamps: their log time is used"]
    return []


def _clock_notes(
    sample: _Sample, trajectory: Trajectory, recording: Recording, config: RunConfig
) -> list[str]:
    """Say when the clocks of clouds and poses are so far apart that they never meet."""
    if sample.log_time_ns is None:
        return []
    stamp_ns = cloud_stamp_ns(sample.header.stamp_ns, sample.log_time_ns, config)
    first, last = int(trajectory.stamps_ns[0]), int(trajectory.stamps_ns[-1])
    apart_s = max(first - stamp_ns, stamp_ns - last) * 1e-9
    if apart_s < recording.seconds(recording.end_ns) + _FAR_APART_S:
        return []
    return [
        f"the clocks of clouds and poses never meet: they are {duration_text(apart_s)} apart; "
        f"see {_clock_way_out(config)}; --time-offset {(first - stamp_ns) * 1e-9:.3f} would let "
        "both begin at the same time"
    ]


def _clock_way_out(config: RunConfig) -> str:
    """Options that bring the clocks together: the log's clock, unless it is the one in use."""
    if config.recording.time_source == "log" or config.recording.pose_file is not None:
        return "--time-offset (recording.time_offset_s)"
    return "--time-source log or --time-offset (recording.time_source, recording.time_offset_s)"


def _range_text(config: RunConfig) -> str:
    start_s, duration_s = config.recording.start_s, config.recording.duration_s
    end = "the end" if duration_s is None else f"{start_s + duration_s:g} s"
    return f"{start_s:g} s to {end}"


def _frame_notes(edge: Edge, roles: FrameRoles) -> list[str]:
    """Say when the configuration gives a frame another name than the poses do."""
    return [
        f"the poses call the {role} frame {there!r}, the configuration {name!r}; it is only a name"
        for role, there, name in (("world", edge[0], roles.world), ("body", edge[1], roles.body))
        if there and there != name
    ]
