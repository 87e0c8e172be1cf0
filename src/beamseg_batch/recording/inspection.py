"""What a recording holds and how it would be used, without processing it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.config import RunConfig
from beamseg_batch.errors import BeamsegError
from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import Trajectory
from beamseg_batch.recording.clocks import clock_notes
from beamseg_batch.recording.cloud_reader import CloudReader
from beamseg_batch.recording.cloud_stamps import CloudStamps, read_cloud_stamps
from beamseg_batch.recording.clouds import FIELD_TYPES, Cloud, read_header
from beamseg_batch.recording.codec import UndecodableMessageError
from beamseg_batch.recording.epochs import PoseClocks
from beamseg_batch.recording.flight import (
    Flight,
    choose_poses,
    open_flight,
    read_poses,
)
from beamseg_batch.recording.frames import read_static_tree
from beamseg_batch.recording.matching import nearest_gaps, seconds_to_ns
from beamseg_batch.recording.other_clouds import packed_cloud
from beamseg_batch.recording.source import Recording, TopicInfo
from beamseg_batch.recording.topics import CLOUDS, TopicChoice, choose_topic

__all__ = [
    "CloudLayout",
    "ExtrinsicSummary",
    "FieldLayout",
    "FrameSummary",
    "MatchSummary",
    "RecordingSummary",
    "StampSummary",
    "TopicChoiceSummary",
    "TopicSummary",
    "inspect_recording",
]

T = TypeVar("T")

_NO_POSE_NS = 2**63 - 1


@dataclass(frozen=True)
class TopicSummary:
    """One topic.

    Attributes
    ----------
    name, msgtype : str
    count : int
        Messages.
    rate_hz : float or None
        Messages per second of the whole recording; None when it has no duration.
    """

    name: str
    msgtype: str
    count: int
    rate_hz: float | None


@dataclass(frozen=True)
class TopicChoiceSummary:
    """Which topic would be used.

    Attributes
    ----------
    topic : str or None
        None when none can be chosen.
    reason : str
        Why this one, or why none.
    """

    topic: str | None
    reason: str


@dataclass(frozen=True)
class FrameSummary:
    """The frame that plays a role, and why; names may be empty in a recording."""

    name: str
    reason: str


@dataclass(frozen=True)
class ExtrinsicSummary:
    """``T_body_sensor`` as people write it.

    Attributes
    ----------
    source : str
        ``configuration``, ``tf_static`` or ``identity``.
    translation : tuple of 3 float, metres
    rotation_rpy_deg : tuple of 3 float, degrees
    """

    source: str
    translation: tuple[float, float, float]
    rotation_rpy_deg: tuple[float, float, float]


@dataclass(frozen=True)
class StampSummary:
    """The stamps of a stream of messages.

    Attributes
    ----------
    count : int
    rate_hz : float or None
        From the median time between two stamps.
    largest_gap_s : float or None
        Longest time between two consecutive stamps.
    largest_gap_at_s : float or None
        Where it begins, in seconds since the first stamp.
    """

    count: int
    rate_hz: float | None
    largest_gap_s: float | None
    largest_gap_at_s: float | None


@dataclass(frozen=True)
class MatchSummary:
    """How well the poses cover the clouds.

    Attributes
    ----------
    share_within_gap : float
        Clouds with a pose within the largest gap allowed, 0 to 1.
    max_gap_s : float
        That gap, ``matching.max_gap_s``.
    median_dt_s, max_dt_s : float
        Time from a cloud to its nearest pose.
    """

    share_within_gap: float
    max_gap_s: float
    median_dt_s: float
    max_dt_s: float


@dataclass(frozen=True)
class FieldLayout:
    """One field of a cloud: its name, type such as ``float32``, and first byte."""

    name: str
    datatype: str
    offset: int


@dataclass(frozen=True)
class CloudLayout:
    """The first cloud of the recording.

    Attributes
    ----------
    frame_id : str
    width, height : int
        Pixels.
    point_step, row_step : int
        Bytes.
    big_endian : bool
    fields : tuple of FieldLayout
    n_returns : int or None
        Points with finite coordinates; None when they cannot be read.
    problem : str
        Why they cannot be read, else empty.
    """

    frame_id: str
    width: int
    height: int
    point_step: int
    row_step: int
    big_endian: bool
    fields: tuple[FieldLayout, ...]
    n_returns: int | None
    problem: str = ""


@dataclass(frozen=True)
class RecordingSummary:
    """What a recording holds and how it would be used.

    Attributes
    ----------
    paths : tuple of str
    container : str
    size_bytes : int
    start_ns, end_ns : int
        Log times of the first and the last message.
    duration_s : float
    topics : tuple of TopicSummary
    cloud_topic, pose_topic : TopicChoiceSummary
    frames : dict of str to FrameSummary
        By role, ``sensor``, ``body`` and ``world``; empty when they cannot be told.
    extrinsic : ExtrinsicSummary or None
    clouds, poses : StampSummary or None
    match : MatchSummary or None
    first_cloud : CloudLayout or None
    notes : tuple of str
        Choices worth telling.
    problems : tuple of str
        What would stop a run.
    recovered : bool
        Whether the recording is damaged.
    damage : tuple of str
        Every damaged place that was found, with its file and what was lost.
    """

    paths: tuple[str, ...]
    container: str
    size_bytes: int
    start_ns: int
    end_ns: int
    duration_s: float
    topics: tuple[TopicSummary, ...]
    cloud_topic: TopicChoiceSummary
    pose_topic: TopicChoiceSummary
    frames: dict[str, FrameSummary]
    extrinsic: ExtrinsicSummary | None
    clouds: StampSummary | None
    poses: StampSummary | None
    match: MatchSummary | None
    first_cloud: CloudLayout | None
    notes: tuple[str, ...]
    problems: tuple[str, ...]
    recovered: bool = False
    damage: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the same as dictionaries, lists, numbers and strings."""
        return asdict(self)


def inspect_recording(recording: Recording, config: RunConfig) -> RecordingSummary:
    """Summarise a recording and the choices that a run would make.

    Parameters
    ----------
    recording : Recording
    config : RunConfig

    Returns
    -------
    RecordingSummary
        Whatever would stop a run is told in `problems`, not raised.

    Raises
    ------
    RecordingError
        If the file itself cannot be read.
    """
    problems: list[str] = []
    clouds = _attempt(problems, choose_topic, recording, CLOUDS, config.recording.cloud_topic)
    poses = _attempt(problems, choose_poses, recording, config)
    flight = _attempt(problems, open_flight, recording, config) if clouds and poses else None
    cloud_stamps = read_cloud_stamps(recording, clouds.topic, config) if clouds else None
    trajectory = flight.trajectory if flight else None
    if poses and not clouds:
        trajectory = _attempt(problems, _trajectory, recording, poses, config)
    used_ns = None if cloud_stamps is None else cloud_stamps.used_ns
    match = _match_summary(cloud_stamps, flight, config)
    if match is not None and match.share_within_gap == 0.0:
        problems.append(
            f"{recording.name}: no cloud has a pose within {match.max_gap_s:.3f} s; the median "
            f"distance is {match.median_dt_s:.3f} s; see matching.max_gap_s, --time-source "
            "and --time-offset"
        )
    first_cloud = (
        _attempt(problems, _first_cloud, recording, clouds.topic, config) if clouds else None
    )
    notes = flight.notes if flight else tuple(c.note for c in (clouds, poses) if c and c.note)
    if cloud_stamps is not None and config.recording.time_source == "header":
        notes += tuple(clock_notes("clouds", cloud_stamps.headers_ns, cloud_stamps.log_times_ns))
    return RecordingSummary(
        paths=tuple(map(str, recording.paths)),
        container=recording.container,
        size_bytes=recording.size_bytes,
        start_ns=recording.start_ns,
        end_ns=recording.end_ns,
        duration_s=recording.seconds(recording.end_ns),
        topics=tuple(_topic_summary(topic, recording) for topic in recording.topics),
        cloud_topic=_choice_summary(clouds, problems[0] if problems else ""),
        pose_topic=_choice_summary(poses, problems[-1] if problems else ""),
        frames=_frames(flight),
        extrinsic=_extrinsic(flight),
        clouds=None if used_ns is None else _stamp_summary(np.sort(used_ns)),
        poses=None if trajectory is None else _stamp_summary(trajectory.stamps_ns),
        match=match,
        first_cloud=first_cloud,
        notes=notes,
        problems=tuple(problems),
        recovered=bool(recording.damage),
        damage=recording.damage_places,
    )


def _attempt(problems: list[str], function: Callable[..., T], *arguments: Any) -> T | None:
    """Call a function; what it complains about becomes a problem to tell."""
    try:
        return function(*arguments)
    except BeamsegError as error:
        problems.append(str(error))
        return None


def _trajectory(recording: Recording, choice: TopicChoice, config: RunConfig) -> Trajectory:
    return read_poses(recording, choice, read_static_tree(recording), "", config).trajectory


def _choice_summary(choice: TopicChoice | None, problem: str) -> TopicChoiceSummary:
    if choice is None:
        return TopicChoiceSummary(None, problem)
    return TopicChoiceSummary(choice.topic.name, choice.reason)


def _topic_summary(topic: TopicInfo, recording: Recording) -> TopicSummary:
    duration_s = recording.seconds(recording.end_ns)
    rate_hz = topic.count / duration_s if duration_s > 0 else None
    return TopicSummary(topic.name, topic.msgtype, topic.count, rate_hz)


def _frames(flight: Flight | None) -> dict[str, FrameSummary]:
    if flight is None:
        return {}
    roles = flight.roles
    return {
        role: FrameSummary(getattr(roles, role), roles.reasons[role])
        for role in ("sensor", "body", "world")
    }


def _extrinsic(flight: Flight | None) -> ExtrinsicSummary | None:
    if flight is None:
        return None
    x, y, z = flight.extrinsic.T_body_sensor.translation.tolist()
    rpy_deg = _rpy_deg(flight.extrinsic.T_body_sensor.rotation)
    return ExtrinsicSummary(flight.extrinsic.source, (x, y, z), rpy_deg)


def _rpy_deg(rotation: FloatArray) -> tuple[float, float, float]:
    """Roll, pitch and yaw of a rotation: the inverse of `geometry.matrix_from_rpy`."""
    roll = np.arctan2(rotation[2, 1], rotation[2, 2])
    pitch = np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0]))
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    # Adding zero turns -0.0 into 0.0, which is what people expect to read.
    degrees = [float(np.degrees(angle)) + 0.0 for angle in (roll, pitch, yaw)]
    return degrees[0], degrees[1], degrees[2]


def _stamp_summary(stamps_ns: NDArray[np.int64]) -> StampSummary:
    steps = np.diff(stamps_ns)
    if len(steps) == 0:
        return StampSummary(len(stamps_ns), None, None, None)
    median_s, largest = float(np.median(steps)) * 1e-9, int(np.argmax(steps))
    return StampSummary(
        count=len(stamps_ns),
        rate_hz=1.0 / median_s if median_s > 0 else None,
        largest_gap_s=float(steps[largest]) * 1e-9,
        largest_gap_at_s=float(stamps_ns[largest] - stamps_ns[0]) * 1e-9,
    )


def _match_summary(
    clouds: CloudStamps | None, flight: Flight | None, config: RunConfig
) -> MatchSummary | None:
    if clouds is None or flight is None or len(clouds.used_ns) == 0:
        return None
    gaps_ns = _pose_gaps(clouds, flight)
    matched = gaps_ns[gaps_ns < _NO_POSE_NS]
    if len(matched) == 0:
        matched = nearest_gaps(flight.trajectory.stamps_ns, clouds.used_ns)
    max_gap_s = config.matching.max_gap_s
    return MatchSummary(
        share_within_gap=float(np.mean(gaps_ns <= seconds_to_ns(max_gap_s))),
        max_gap_s=max_gap_s,
        median_dt_s=float(np.median(matched)) * 1e-9,
        max_dt_s=float(np.max(matched)) * 1e-9,
    )


def _pose_gaps(clouds: CloudStamps, flight: Flight) -> NDArray[np.int64]:
    """Time from each cloud to the nearest pose that it may be matched with."""
    clocks = PoseClocks(flight.epochs, lambda: clouds)
    chosen = [clocks.poses_of(index, True) for index in clouds.indices.tolist()]
    gaps_ns = np.full(len(chosen), _NO_POSE_NS)
    for epoch in flight.epochs:
        own = np.array([poses is epoch.trajectory for poses in chosen])
        gaps_ns[own] = nearest_gaps(epoch.trajectory.stamps_ns, clouds.used_ns[own])
    return gaps_ns


def _first_cloud(recording: Recording, topic: TopicInfo, config: RunConfig) -> CloudLayout | None:
    reader = CloudReader(recording, topic, config.sensor)
    for raw in recording.topic_messages(topic):
        with suppress(UndecodableMessageError):
            cloud = reader.read(raw)
            return recording.read(raw, partial(_layout, cloud=cloud))
    return None


def _layout(message: Any, cloud: Cloud) -> CloudLayout:
    if hasattr(message, "point_stride"):
        message = packed_cloud(message)
    n_returns = int(np.isfinite(cloud.points).all(axis=1).sum())
    return CloudLayout(
        frame_id=read_header(message).frame,
        width=cloud.width,
        height=cloud.height,
        point_step=int(getattr(message, "point_step", 0)),
        row_step=int(getattr(message, "row_step", 0)),
        big_endian=bool(getattr(message, "is_bigendian", False)),
        fields=tuple(
            FieldLayout(field.name, _field_type(field.datatype), int(field.offset))
            for field in getattr(message, "fields", ())
        ),
        n_returns=None if cloud.problem else n_returns,
        problem=cloud.problem,
    )


def _field_type(code: int) -> str:
    return FIELD_TYPES.get(code, f"type {code}")
