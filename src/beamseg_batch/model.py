"""What flows between the stages: scans, segments, joints and a flight's result.

All are frozen: a stage returns new objects and never changes what it was given.
Positions are metres, stamps integer nanoseconds, directions unit vectors.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.config import RunConfig
from beamseg_batch.geometry import (
    FloatArray,
    RigidTransform,
    covariance_along,
    parabola,
    section_frame,
    unknown,
)
from beamseg_batch.section import Section

__all__ = [
    "BENT_M",
    "BENT_SIGMAS",
    "STAGES",
    "Candidate",
    "CrossSection",
    "DepthNoise",
    "Detections",
    "FlightResult",
    "Intersection",
    "Joint",
    "Member",
    "PoseJitter",
    "RecordingInfo",
    "RefusedLine",
    "Scan",
    "ScanRecord",
    "Segment",
    "SensorModel",
    "SkippedScan",
    "Trajectory",
    "across_of",
]

STAGES = ("read", "filter", "search", "screen", "fuse")
"""Names of the timed stages of a scan, in the order in which they run."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Body poses in the world frame, in order of their stamps.

    Attributes
    ----------
    stamps_ns : (N,) int64
        Strictly increasing.
    positions : (N, 3) float64, metres, world frame
    quaternions_xyzw : (N, 4) float64, unit quaternions, ``T_world_body``
    """

    stamps_ns: NDArray[np.int64]
    positions: FloatArray
    quaternions_xyzw: FloatArray

    def __len__(self) -> int:
        return len(self.stamps_ns)


@dataclass(frozen=True)
class DepthNoise:
    """Standard deviation of a pixel's depth along the camera's forward axis.

    Attributes
    ----------
    constant : float, metres
    relative : float
        Share of the depth, added as the square.
    mixed : bool
        Whether a pixel at an edge returns a depth between those of both sides.
    source : str
        ``measured``, ``configured`` or ``default``: where the deviation is from.
    mixed_source : str
        The same of `mixed`.
    """

    constant: float
    relative: float = 0.0
    mixed: bool = False
    source: str = field(default="configured", compare=False)
    mixed_source: str = field(default="default", compare=False)

    def at(self, depth: float) -> float:
        """Standard deviation at a forward depth, metres."""
        return float(np.hypot(self.constant, self.relative * depth))


@dataclass(frozen=True)
class PoseJitter:
    """White noise of the recorded poses, and what is left of it in those that are used.

    Attributes
    ----------
    position, attitude : float, metres and radians
        Standard deviation along and about each axis, as recorded.
    left_position, left_attitude : float, metres and radians
        The same of the poses that scans are matched with.
    memory_s : float, seconds
        How long an error of these stays about the same; 0 where there is none to speak of.
    position_source, attitude_source : str
        ``measured``, ``configured`` or ``default``, which is none.
    """

    position: float = 0.0
    attitude: float = 0.0
    left_position: float = 0.0
    left_attitude: float = 0.0
    memory_s: float = 0.0
    position_source: str = "default"
    attitude_source: str = "default"

    @property
    def smoothed(self) -> bool:
        """Whether the poses that are used jitter less than those recorded."""
        return self.left_position < self.position or self.left_attitude < self.attitude


@dataclass(frozen=True)
class SensorModel:
    """What a run took the camera and its poses for.

    Attributes
    ----------
    noise : DepthNoise
    jitter : PoseJitter
    pitch_rad : float or None
        Angle between neighbouring pixels ahead, which is the footprint of one; None where the
        clouds are not an image, or nobody asked.
    """

    noise: DepthNoise
    jitter: PoseJitter = PoseJitter()
    pitch_rad: float | None = None


@dataclass(frozen=True, eq=False)
class Scan:
    """One ToF cloud, its stamp, and the pose matched to it.

    Attributes
    ----------
    index : int
        Position of the cloud among all clouds of the recording, from 0.
    stamp_ns : int
        Stamp of the cloud.
    pose_stamp_ns : int
        Stamp of the pose message that lies nearest in time.
    T_world_body, T_body_sensor : RigidTransform
        The matched pose, and where the camera sits on the drone.
    points : (N, 3) float32 or float64, metres, sensor frame
        All pixels in message order, contiguous and read-only; a pixel without return is NaN
        or infinite.
    width, height : int
        Pixels; ``height`` is 1 for a cloud that is not organised.
    read_us : float
        Microseconds spent on reading and decoding this scan.
    log_ns : int or None
        When the cloud was recorded, by the recorder's clock; None where that is not known.
    """

    index: int
    stamp_ns: int
    pose_stamp_ns: int
    T_world_body: RigidTransform
    T_body_sensor: RigidTransform
    points: NDArray[np.floating]
    width: int
    height: int
    read_us: float = 0.0
    log_ns: int | None = None

    def with_points(self, points: NDArray[np.floating]) -> Scan:
        """Return the same scan with other returns."""
        return replace(self, points=points)

    @property
    def pose_gap_s(self) -> float:
        """Time from the nearest pose message to the cloud, in seconds, never negative."""
        return abs(self.stamp_ns - self.pose_stamp_ns) * 1e-9

    @cached_property
    def T_world_sensor(self) -> RigidTransform:
        """Transform from the sensor frame to the world frame."""
        return self.T_world_body @ self.T_body_sensor


@dataclass(frozen=True)
class SkippedScan:
    """A cloud that could not be used, with the reason it is counted under.

    Attributes
    ----------
    index : int
        Position of the cloud among all clouds of the recording, from 0.
    stamp_ns : int
    reason : str
        A short, stable name, such as ``no_pose_within_gap``.
    detail : str
        A sentence with the values, for people.
    """

    index: int
    stamp_ns: int
    reason: str
    detail: str = ""


BENT_M, BENT_SIGMAS = 0.002, 5.0
"""Bow, metres, and share of its deviation, above which a beam is not taken for straight."""


@dataclass(frozen=True, eq=False)
class CrossSection:
    """Cross-section of a beam, as far as its rays decide.

    Attributes
    ----------
    shape : str
        One of `beamseg_batch.section.SHAPES`, or ``unknown``.
    size : Section or None
        None where the shape is round or unknown.
    across : (3,) float64, unit vector
        Along the section's width; NaN without a size.
    name : str
        Of the standard size that it has; empty if none.
    confidence : float, 0 to 1
        That no other shape is the likelier one; NaN where none had to be tried.
    """

    shape: str = "round"
    size: Section | None = None
    across: FloatArray = field(default_factory=lambda: unknown(3))
    name: str = ""
    confidence: float = np.nan

    def roll_deg(self, direction: FloatArray) -> float:
        """Turn of the section about an axis, degrees from 0 to 360.

        Parameters
        ----------
        direction : (3,) float64, unit vector

        Returns
        -------
        float
            From the horizontal, or on a vertical axis from the world's x; NaN without a size.
        """
        u, v, _ = section_frame(direction).T
        return float(np.degrees(np.arctan2(self.across @ v, self.across @ u)) % 360.0)


def across_of(roll_deg: float, direction: FloatArray) -> FloatArray:
    """Direction of a section's width, from its turn about the axis; see `CrossSection`.

    Parameters
    ----------
    roll_deg : float, degrees
    direction : (3,) float64, unit vector

    Returns
    -------
    (3,) float64, unit vector
    """
    across: FloatArray = section_frame(direction, np.radians(roll_deg))[:, 0]
    return across


@dataclass(frozen=True, eq=False)
class Segment:
    """A beam as the report models it (section 3.1).

    Attributes
    ----------
    anchor : (3,) float64, metres
        A point of the axis, ``a`` in the report.
    direction : (3,) float64, unit vector
        ``b`` in the report.
    t_min, t_max : float, metres
        The ends are ``anchor + t * direction``.
    radius : float, metres
    n_points : int
        Points that support the segment, over all scans.
    pca_coeff : float
        Largest share of the points' variance along one axis, 0 to 1.
    pca_eig : (3,) float64, square metres
        Eigenvalues of the points' covariance, largest first.
    points : (N, 3) float64, metres
        The points it was found from, in the same frame; empty once fused.
    n_scans : int
        Scans in which the segment was seen.
    first_seen_ns, last_seen_ns : int
        Stamps of the first and the last of them.
    covariance : (6, 6) float64, metres and radians, in the same frame
        Of the anchor and the direction, which is only across the axis; NaN where it is not
        known.
    measured_radius, sigma_radius : float, metres
        The radius that fits best, whatever `radius` is, and its standard deviation; NaN where
        they are not known.
    sigma_ends : (2,) float64, metres
        Standard deviations of both ends along the axis; NaN where they are not known.
    ends_seen : (bool, bool) or None
        Whether the camera saw past each end, or what the beam ends in; None where it was not
        asked.
    bow_vector : (3,) float64, metres
        By how much the axis leaves its chord, which is the line between the ends, where it
        does so most: halfway; NaN where it is not known.
    sigma_bow : float, metres
        Standard deviation of its length; NaN where it is not known.
    cross_section : CrossSection
        If it is not round, the axis runs through its centre of area, and the radius is that of
        the cylinder by which the beam was found.
    """

    anchor: FloatArray
    direction: FloatArray
    t_min: float
    t_max: float
    radius: float
    n_points: int
    pca_coeff: float
    pca_eig: FloatArray
    points: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    n_scans: int = 1
    first_seen_ns: int = 0
    last_seen_ns: int = 0
    covariance: FloatArray = field(default_factory=lambda: unknown((6, 6)))
    measured_radius: float = np.nan
    sigma_radius: float = np.nan
    sigma_ends: FloatArray = field(default_factory=lambda: unknown(2))
    ends_seen: tuple[bool, bool] | None = None
    bow_vector: FloatArray = field(default_factory=lambda: unknown(3))
    sigma_bow: float = np.nan
    cross_section: CrossSection = field(default_factory=CrossSection)

    @property
    def bow(self) -> float:
        """Largest deviation of the axis from its chord, metres; NaN where it is not known."""
        return float(np.linalg.norm(self.bow_vector))

    @property
    def is_bent(self) -> bool:
        """Whether the bow is too large, and too well known, for a straight beam."""
        return self.bow > BENT_M and self.bow > BENT_SIGMAS * self.sigma_bow

    def tangent(self, t: float) -> Segment:
        """Return the straight segment that touches the axis at `t`; this one if it is straight."""
        if not self.is_bent:
            return self
        off, slope = parabola(t, self.t_min, self.t_max)
        direction = self.direction + slope * self.bow_vector
        direction /= np.linalg.norm(direction)
        anchor = self.anchor + t * (self.direction - direction) + off * self.bow_vector
        return replace(self, anchor=anchor, direction=direction, bow_vector=np.full(3, np.nan))

    def covariance_at(self, t: float) -> FloatArray:
        """(3, 3) float64, square metres: of the point of the axis at `t`; NaN if not known."""
        return covariance_along(self.covariance, t)

    @property
    def sigma_offset(self) -> float:
        """Standard deviation of the axis across its direction, halfway between the ends, metres."""
        middle = self.covariance_at(0.5 * (self.t_min + self.t_max))
        return float(np.sqrt(np.trace(middle)))

    @property
    def sigma_angle_deg(self) -> float:
        """Standard deviation of the direction, degrees."""
        return float(np.degrees(np.sqrt(np.trace(self.covariance[3:, 3:]))))

    @property
    def end_1(self) -> FloatArray:
        """(3,) float64, metres: the end at `t_min`."""
        return self.anchor + self.t_min * self.direction

    @property
    def end_2(self) -> FloatArray:
        """(3,) float64, metres: the end at `t_max`."""
        return self.anchor + self.t_max * self.direction

    def points_at(self, t: FloatArray) -> FloatArray:
        """Return points of the axis, (N, 3); `t` is (N,), metres along the chord of a bent one."""
        chord: FloatArray = self.anchor + t[:, None] * self.direction
        if not self.is_bent:
            return chord
        off, _ = parabola(t[:, None], self.t_min, self.t_max)
        bent: FloatArray = chord + off * self.bow_vector
        return bent

    @property
    def midpoint(self) -> FloatArray:
        """(3,) float64, metres: halfway between the ends."""
        return self.anchor + 0.5 * (self.t_min + self.t_max) * self.direction

    @property
    def length(self) -> float:
        """Distance between the ends, in metres."""
        return self.t_max - self.t_min


@dataclass(frozen=True, eq=False)
class Intersection:
    """Two segments that touch (report, section 3.2.7).

    Attributes
    ----------
    segment_1, segment_2 : int
        Indices into the structure's segments, the smaller first.
    t_1, t_2 : float, metres
        Where on each axis, in the parameter of that segment as it now is.
    position : (3,) float64, metres, world frame
        Halfway between the two axes.
    distance : float, metres
        Between the two axes.
    angle_deg : float, degrees, 0 to 90
    joint : int or None
        Index of the joint that it is part of; None before joints are known.
    """

    segment_1: int
    segment_2: int
    t_1: float
    t_2: float
    position: FloatArray
    distance: float
    angle_deg: float
    joint: int | None = None


@dataclass(frozen=True, eq=False)
class Joint:
    """One place where two or more segments meet.

    Attributes
    ----------
    position : (3,) float64, metres, world frame
        The point closest to all its axes.
    covariance : (3, 3) float64, square metres, world frame
        Of the position; NaN where that of an axis is not known.
    residual : float, metres
        Root mean square of the distances of the axes from the position.
    segments : tuple of int
        Indices into the structure's segments, rising.
    t : tuple of float, metres
        Where on each of them.
    """

    position: FloatArray
    covariance: FloatArray
    residual: float
    segments: tuple[int, ...]
    t: tuple[float, ...]


@dataclass(frozen=True)
class Member:
    """The part of a segment between two consecutive joints or ends.

    Attributes
    ----------
    segment : int
        Index into the structure's segments.
    t_1, t_2 : float, metres
        Where on its axis the part begins and ends.
    joint_1, joint_2 : int or None
        Index of the joint there; None at a free end.
    """

    segment: int
    t_1: float
    t_2: float
    joint_1: int | None
    joint_2: int | None

    @property
    def length(self) -> float:
        """Distance between its ends, in metres."""
        return self.t_2 - self.t_1


@dataclass(frozen=True, eq=False)
class RefusedLine:
    """A line that screening refused.

    Attributes
    ----------
    segment : Segment
        What it would have been, on the surface.
    reason : str
        A name out of `beamseg_batch.reasons.REASONS`.
    value, limit : float
        What was found and what was needed, in the unit of the reason.
    """

    segment: Segment
    reason: str
    value: float
    limit: float


@dataclass(frozen=True, eq=False)
class Candidate:
    """Something that was or might have been a beam, and what became of it.

    Attributes
    ----------
    stage : str
        Where its fate was decided: ``scan`` (lines of single scans, those at one place
        together), ``leftovers`` (lines in what no beam explains, likewise), ``gathering``,
        ``pass`` or ``end``.
    number : int or None
        Its name among the candidates; None for lines.
    in_pass : int or None
        The pass over the rays that decided, from 1.
    origin : str
        ``scans``, ``leftovers``, ``split``, or ``refused`` as a round beam.
    parent : int or None
        The candidate that it was split from.
    end_1, end_2 : (3,) float64, metres, world frame
    radius : float, metres
    n_lines : int or None
        Lines that were found of it; None where they were not counted.
    n_scans : int
        Scans that saw it.
    n_points : int
        Points of its lines, or rays that it alone explains.
    score : float
        Log-likelihood ratio of the evidence, as of the pass that decided; NaN without any.
    seen_through : float
        Rays that saw through it, estimated; NaN where none were asked.
    flanks : (float, float)
        Share of the rays beside it that found something at its depth, left and right; NaN
        where too few passed.
    reduced_chi2 : float
    first_seen_ns, last_seen_ns : int
    fate : str
        ``kept``, ``merged`` or ``refused``.
    reason : str
        A name out of `beamseg_batch.reasons.REASONS`; empty if it was kept.
    value, limit : float
        What was found and what was needed, in the unit of the reason.
    into : int or None
        The candidate that it gave way to.
    segment : int or None
        Index of the segment that it is, or gave way to.
    """

    stage: str
    end_1: FloatArray
    end_2: FloatArray
    radius: float
    fate: str
    first_seen_ns: int
    last_seen_ns: int
    number: int | None = None
    in_pass: int | None = None
    origin: str = "scans"
    parent: int | None = None
    n_lines: int | None = None
    n_scans: int = 0
    n_points: int = 0
    score: float = np.nan
    seen_through: float = np.nan
    flanks: tuple[float, float] = (np.nan, np.nan)
    reduced_chi2: float = np.nan
    reason: str = ""
    value: float = np.nan
    limit: float = np.nan
    into: int | None = None
    segment: int | None = None


@dataclass(frozen=True, eq=False)
class Detections:
    """What one scan gave.

    Attributes
    ----------
    scan : Scan
        The scan, without a promise that its points are kept.
    segments : tuple of Segment
        World frame, in order of detection.
    n_points_raw : int
        Returns of the cloud, before any filter.
    n_points_window : int
        Those of them inside the pass-through window.
    n_points_filtered : int
        Points given to the search, after floor trim and voxel grid.
    n_lines : int
        Lines that the search emitted, before screening.
    rejections : mapping of str to int
        Lines that screening refused, by criterion.
    cloud : (N, 3) float32, metres, world frame
        The filtered points.
    stage_us : mapping of str to float
        Microseconds by stage, keys out of `STAGES`.
    refused : tuple of RefusedLine
        World frame; empty unless candidates are kept (``outputs.candidates``).
    """

    scan: Scan
    segments: tuple[Segment, ...]
    n_points_raw: int
    n_points_window: int
    n_points_filtered: int
    n_lines: int
    rejections: Mapping[str, int]
    cloud: NDArray[np.float32]
    stage_us: Mapping[str, float]
    refused: tuple[RefusedLine, ...] = ()


@dataclass(frozen=True)
class ScanRecord:
    """One row of `processing_time.csv`.

    Attributes
    ----------
    stamp_ns, pose_stamp_ns : int
    pose_gap_s : float, seconds
    n_points_raw, n_points_filtered, n_lines : int
    n_segments : int
        Size of the structure after this scan.
    wall_us : float
        Microseconds from the start of processing to the end of this scan.
    processing_us : float
        Microseconds spent on this scan, reading included.
    stage_us : mapping of str to float
    """

    stamp_ns: int
    pose_stamp_ns: int
    pose_gap_s: float
    n_points_raw: int
    n_points_filtered: int
    n_lines: int
    n_segments: int
    wall_us: float
    processing_us: float
    stage_us: Mapping[str, float]


@dataclass(frozen=True)
class RecordingInfo:
    """Which recording was read, and how its topics and frames were used.

    Attributes
    ----------
    paths : tuple of Path
    container : str
        For people, such as ``ROS 2 MCAP``.
    sha256 : str
        Hash over the bytes of all files, in order.
    size_bytes : int
    start_ns, end_ns : int
        Log times of the first and the last message.
    cloud_topic, pose_topic : str
    sensor_frame, body_frame, world_frame : str
        Frame names as they stand in the recording; empty when it names none.
    T_body_sensor : RigidTransform
    extrinsic_source : str
        ``configuration``, ``tf_static`` or ``identity``.
    notes : tuple of str
        Choices worth telling, such as a topic taken because it was the only one.
    damage : tuple of str
        Every damaged place, with its file and what was lost.
    damage_notes : tuple of str
        The same summed up, one sentence per damaged file.
    T_cloud_sensor : RigidTransform
        From the axes of the scans, x forward, to those of the clouds as they were recorded.
    """

    paths: tuple[Path, ...]
    container: str
    sha256: str
    size_bytes: int
    start_ns: int
    end_ns: int
    cloud_topic: str
    pose_topic: str
    sensor_frame: str
    body_frame: str
    world_frame: str
    T_body_sensor: RigidTransform
    extrinsic_source: str
    notes: tuple[str, ...] = ()
    damage: tuple[str, ...] = ()
    damage_notes: tuple[str, ...] = ()
    T_cloud_sensor: RigidTransform = field(default_factory=RigidTransform.identity)

    @property
    def recovered(self) -> bool:
        """Whether only a part of the recording could be read."""
        return bool(self.damage)

    @property
    def duration_s(self) -> float:
        """Log time from the first to the last message, in seconds."""
        return (self.end_ns - self.start_ns) * 1e-9


@dataclass(frozen=True, eq=False)
class FlightResult:
    """A flight turned into a structure.

    Attributes
    ----------
    segments : tuple of Segment
        World frame, in order of first detection.
    intersections : tuple of Intersection
    joints : tuple of Joint
        By their segments.
    members : tuple of Member
        By their segment, then along it.
    scans : tuple of ScanRecord
        One per processed scan, in time order.
    skipped : Counter of str
        Clouds that were not processed, by reason.
    rejections : Counter of str
        Lines and candidates that were refused, by reason out of `beamseg_batch.reasons`.
    trajectory : Trajectory
    cloud : (N, 3) float32, metres, world frame
        A thinned cloud of the whole flight.
    recording : RecordingInfo
    config : RunConfig
    wall_s : float
        Seconds that processing took.
    sensor : SensorModel
        How well the camera and the poses measure.
    warnings : tuple of str
    interrupted : bool
        True when the flight was not read to its end.
    candidates : tuple of Candidate or None
        None unless they are kept (``outputs.candidates``).
    """

    segments: tuple[Segment, ...]
    intersections: tuple[Intersection, ...]
    joints: tuple[Joint, ...]
    members: tuple[Member, ...]
    scans: tuple[ScanRecord, ...]
    skipped: Counter[str]
    rejections: Counter[str]
    trajectory: Trajectory
    cloud: NDArray[np.float32]
    recording: RecordingInfo
    config: RunConfig
    wall_s: float
    sensor: SensorModel = SensorModel(DepthNoise(0.01, source="default"))
    warnings: tuple[str, ...] = ()
    interrupted: bool = False
    candidates: tuple[Candidate, ...] | None = None
