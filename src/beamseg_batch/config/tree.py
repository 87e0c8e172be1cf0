"""The configuration tree: one frozen pydantic model.

Every value has a unit, a range and a meaning here, and `beamseg config schema` prints them.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Field,
    PlainSerializer,
    WithJsonSchema,
    model_validator,
)

from beamseg_batch.schema import (
    Finite,
    Interval,
    Node,
    NonNegative,
    Positive,
    Seconds,
    Share,
    Vector3,
)

__all__ = [
    "DEFAULT_PROFILE",
    "DetectionConfig",
    "ExtrinsicConfig",
    "FilteringConfig",
    "FlyAgainConfig",
    "HoughConfig",
    "IntersectionConfig",
    "MatchingConfig",
    "OutputConfig",
    "RecordingConfig",
    "RefinementConfig",
    "RunConfig",
    "ScreeningConfig",
    "SensorConfig",
    "ShapeConfig",
    "StructureConfig",
    "ThresholdConfig",
    "WindowConfig",
]

DEFAULT_PROFILE = "precise"


class RecordingConfig(Node):
    """Which topics and frames of the recording are used."""

    cloud_topic: str | None = None
    """Topic of the clouds; null takes /tof_pc, else the only candidate."""
    pose_topic: str | None = None
    """Topic of the drone poses; null takes /mavros/local_position/pose, else the only candidate."""
    pose_file: str | None = None
    """File of poses beside the recording, .tum or .csv, that takes the pose topic's place."""
    world_frame: str | None = None
    """Name of the fixed frame; null takes the pose's header frame, or in tf the frame above the
    topmost moving transform."""
    body_frame: str | None = None
    """Name of the drone's frame; null takes the pose's child frame, or in tf the frame below the
    last moving transform on the way to the sensor."""
    time_source: Literal["header", "log"] = "header"
    """header: stamps of the messages' headers; log: when the recorder received them."""
    time_offset_s: Seconds = 0.0
    """Seconds added to the stamps of the clouds before matching."""
    start_s: NonNegative = 0.0
    """Clouds logged earlier are left out, seconds from the start of the recording."""
    duration_s: Positive | None = None
    """Clouds logged this long after the start, or later, are left out, seconds; null: none."""
    every: Annotated[int, Field(ge=1, le=2**31)] = 1
    """Of the clouds that remain, only every so manieth is used, from the first on."""
    max_scans: Annotated[int, Field(ge=1, le=2**31)] | None = None
    """Most clouds used; null: all."""
    strict: bool = False
    """Whether damage of the recording is an error; else what is whole is used."""
    max_chunk_mb: Annotated[int, Field(ge=1, le=2**20)] = 1024
    """Largest chunk of a bag or MCAP file that is decompressed, MB."""


class MatchingConfig(Node):
    """How a scan gets its pose (report, sections 3.2.1 and 6.2)."""

    method: Literal["nearest", "interpolate"] = "interpolate"
    """nearest: the pose message nearest in time as it is; interpolate: between its neighbours."""
    max_gap_s: NonNegative = 0.05
    """Largest time from a cloud to its nearest pose message, seconds."""
    smooth: Literal["auto", "off"] = "auto"
    """auto: poses that jitter by more than 0.3 mm or 0.02 degrees are smoothed, as far as their
    own motion allows; off: they are used as recorded."""


class ExtrinsicConfig(Node):
    """``T_body_sensor``: where the camera sits on the drone."""

    translation: Vector3 = (0.0, 0.0, 0.0)
    """Camera centre in the body frame, metres."""
    rotation_rpy_deg: Vector3 = (0.0, 0.0, 0.0)
    """Roll, pitch and yaw of the sensor's axes about the fixed body axes, degrees."""


class SensorConfig(Node):
    """The camera."""

    model: str | None = None
    """What the camera and its poses are known to be: a name out of configs/sensors, such as
    voxl_tof, or a file like those. What is null here is taken from it: noise, mixed pixels, jitter,
    and the extrinsic if its extrinsic_in does not say that the recording holds it."""
    extrinsic: ExtrinsicConfig | None = None
    """Camera pose on the drone; null takes it from tf when allowed, else identity."""
    extrinsic_from_tf: bool = True
    """Whether /tf_static may give the extrinsic."""
    noise_m: Positive | None = None
    """Standard deviation of the depth, metres; null measures it in the flight."""
    noise_relative: NonNegative | None = None
    """What is added to it in proportion to the depth; null measures it, or is 0 beside noise_m."""
    mixed_pixels: bool | None = None
    """Whether a pixel at an edge returns a depth between those of both sides, so that the outlines
    of beams do not count for their axes; null measures it."""
    pose_jitter_m: NonNegative | None = None
    """Standard deviation of the noise of each pose's position along each axis, metres; null
    measures it in the flight."""
    pose_jitter_deg: NonNegative | None = None
    """The same of its attitude about each axis, degrees."""
    organise: bool = True
    """Whether clouds without rows and columns get them back, where their points lie on the rays of
    a pinhole camera; so what did not return is known, and neighbours are."""
    axes: Literal["auto", "x_forward", "z_forward"] = "auto"
    """Which axis of the clouds looks ahead: x as on bodies, z as in optical frames, whose points
    are turned to x forward; auto: as the data, the frame's name or the transform tree says."""
    min_confidence: Finite | None = None
    """Points with less in their confidence field are taken as no return; null: all are used."""
    confidence_fields: Annotated[tuple[str, ...], Field(min_length=1)] = ("confidence", "intensity")
    """Names of that field; the first one that a cloud has counts."""


class WindowConfig(Node):
    """Pass-through window in the sensor's axes, x forward (report, section 3.2.2)."""

    x: Interval = (0.0, 1.5)
    """Metres."""
    y: Interval = (-1.5, 1.5)
    """Metres."""
    z: Interval = (-1.5, 1.5)
    """Metres."""

    @model_validator(mode="after")
    def _ordered(self) -> WindowConfig:
        for axis in ("x", "y", "z"):
            low, high = getattr(self, axis)
            if not low < high:
                raise ValueError(f"{axis}: the lower bound {low:g} must be below {high:g}")
        return self


def _radii(value: Any) -> Any:
    """Write ``auto`` and null as no radius at all, which nobody can ask for."""
    if value is None or value == "auto":
        return ()
    if isinstance(value, str) or value in ([], ()):
        raise ValueError("must be a list of radii, or auto")
    return value


Radii = Annotated[
    tuple[Positive, ...],
    BeforeValidator(_radii),
    PlainSerializer(lambda radii: list(radii) or "auto"),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "array", "items": {"type": "number", "exclusiveMinimum": 0}},
                {"enum": ["auto"]},
                {"type": "null"},
            ]
        }
    ),
]
"""Radii in metres; empty where they are measured in the flight."""


class FilteringConfig(Node):
    """Pre-processing of a cloud (report, section 3.2.2)."""

    window: WindowConfig = WindowConfig()
    floor_trim_height: Finite = 0.3
    """Height in the world frame below which nothing is a beam, metres."""
    floor_trim: Literal["points", "segment", "none"] = "points"
    """points: drop points below the height before the search (section 4.1);
    segment: drop segments with an end below it (section 3.2.5); none: keep all."""
    foreground: Literal["thin", "all"] = "thin"
    """thin: search only returns on both sides of which the view goes on further back within the
    width of a beam, in clouds with rows and columns: no floor, no wall; all: every return."""
    outliers: Literal["none", "statistical", "plane", "dbscan"] = "none"
    """Filter by Open3D of the points that are searched in a scan (section 2.1). statistical: drops
    what is far from its neighbours; plane: what lies on large planes, by RANSAC; dbscan: what
    belongs to no cluster."""
    radii: Radii = (0.05,)
    """Radii of the beams to look for, metres; searched from the largest to the smallest. auto, or
    null: those that beams are found to have in a part of the flight."""
    rad_2_leaf_ratio: Positive = 1.5
    """Radius divided by the leaf size of the voxel grid."""

    def leaf_size(self, radius: float) -> float:
        """Edge of a voxel for beams of a radius, metres (report, section 3.2.2)."""
        return radius / self.rad_2_leaf_ratio

    def diag_voxel(self, radius: float) -> float:
        """Diagonal of that voxel, metres (report, section 3.2.4)."""
        return math.sqrt(3.0) * self.leaf_size(radius)


class HoughConfig(Node):
    """The iterative Hough transform (report, section 3.2.3)."""

    granularity: Annotated[int, Field(ge=0, le=6)] = 4
    """Subdivisions of the icosahedron that gives the directions: 4 has 1281, 6 has 20481."""
    dx: Positive | None = None
    """Cell width of the voting plane and reach of a line, metres; null is sqrt(3) * leaf size."""
    minvotes: Annotated[int, Field(ge=2, le=2**23)] = 12
    """Fewest points of a line; the search ends at the first line with fewer."""
    nlines: Annotated[int, Field(ge=0, le=2**23)] = 10
    """Most segments kept of one scan; 0 for no limit. Refused lines do not count."""


class ScreeningConfig(Node):
    """Which lines are segments (report, section 3.2.4)."""

    min_pca_coeff: Share = 0.99
    """Smallest share of a segment's variance that must lie along its axis."""
    half_round: Literal["thicker", "all", "none"] = "thicker"
    """Lines of which radii pass with less, where their points spread across as on the visible half
    of a beam, however short. thicker: of several radii all but the smallest, so that points of
    short thick beams are not taken for thin ones; all, or none of them."""
    gap: Literal["longest_run", "reject"] = "longest_run"
    """longest_run: cut a line at its gaps and keep the longest run;
    reject: refuse a line that has a gap, as the report is written."""
    max_gap_factor: Positive = 2.0
    """Largest gap between neighbours along the axis, in voxel diagonals."""
    radius_tolerance_factor: Positive = 1.0
    """Largest difference between measured and expected radius, in voxel diagonals."""
    min_points_factor: NonNegative = 1.0
    """Factor on the report's smallest number of points."""


class DetectionConfig(Node):
    """From a scan to its segments."""

    hough: HoughConfig = HoughConfig()
    screening: ScreeningConfig = ScreeningConfig()
    axis: Literal["cylinder", "centroid"] = "cylinder"
    """cylinder: fit a cylinder to the returns near the line, along their rays;
    centroid: the line runs through the visible surface, as in the report."""


class ThresholdConfig(Node):
    """Thresholds of the similarity solutions (report, section 3.2.6)."""

    T_a: Positive = 0.1
    """Solution 1: largest distance between anchors, metres."""
    T_b: Positive = 0.1
    """Solution 1: largest distance between the tips of the unit directions."""
    T_p: Positive = 0.2
    """Solutions 1 and 2: largest distance between midpoints, metres."""
    T_d: Share = 0.99
    """Solution 2: smallest cosine between directions."""
    epsilon: Positive | None = None
    """Solution 3: largest distance of an end from the other axis, metres;
    null is 2 * diag_voxel + r1 + r2."""


class IntersectionConfig(Node):
    """When two segments touch (report, section 3.2.7)."""

    epsilon: Positive | None = None
    """Largest distance between the axes, metres; null is r1 + r2."""
    parallel_norm: Positive = 1e-3
    """Segments whose directions have a smaller cross product are parallel."""
    end_slack: NonNegative = 0.0
    """How far beyond an end a crossing still counts, metres."""


class ShapeConfig(Node):
    """Cross-sections other than round, with structure.fusion: evidence."""

    enabled: bool = True
    """Whether every beam is asked for its cross-section, when all else has settled."""
    catalogue: str | None = None
    """CSV file of standard sizes, millimetres; null: the shipped one, of European sections."""


class StructureConfig(Node):
    """From segments to the structure of the flight."""

    similarity: Literal["parameters", "midpoint", "projection"] = "projection"
    """When two segments are the same beam: solution 1, 2 or 3 of the report's section 3.2.6."""
    fusion: Literal["mean", "weighted", "evidence"] = "evidence"
    """How they become one: solution 1 or 2 of the report, or as hypotheses that all rays of the
    flight are asked about in further passes (refinement); similarity and thresholds are the
    report's and not used then."""
    min_weight: Share = 0.01
    """w_min: smallest weight of the new segment in a weighted fusion."""
    thresholds: ThresholdConfig = ThresholdConfig()
    min_scans: Annotated[int, Field(ge=1, le=2**31)] = 3
    """Segments seen in fewer scans are left out of the result."""
    min_length: NonNegative = 0.3
    """Shorter segments are left out of the result, metres."""
    intersections: IntersectionConfig = IntersectionConfig()
    shapes: ShapeConfig = ShapeConfig()


class RefinementConfig(Node):
    """Further passes over the recording, with structure.fusion: evidence."""

    passes: Annotated[int, Field(ge=0, le=100)] = 20
    """How often, at most, the recording is read again to ask all rays about the beams found so
    far; it ends when nothing moves."""
    competition: bool = True
    """Whether beams compete for the rays that several explain; without, each has all of them."""
    split: bool = True
    """Whether a beam is split in two where it bends."""
    drop: bool = True
    """Whether a beam goes that the rays deny, or that has a surface on either side."""
    merge: bool = True
    """Whether two beams on one axis become one."""
    cut: bool = True
    """Whether a beam is cut into several where rays see through it."""
    snap: bool = True
    """Whether ends are drawn to the axes that pass by them."""
    bow: bool = True
    """Whether a beam may be bent, where the rays show clearly that it is."""
    leftovers: bool = True
    """Whether the returns that no beam explains are searched for further beams."""
    radii: bool = True
    """Whether every beam is tried with each of several radii, when all else has settled."""
    ends: bool = True
    """Whether a last pass measures where the ends are."""


class FlyAgainConfig(Node):
    """Which beams should be flown again, and from where."""

    max_sigma_offset: Positive = 0.002
    """Largest standard deviation of an axis across its direction that is good enough, metres."""
    max_sigma_angle_deg: Positive = 0.2
    """Likewise of its direction, degrees."""
    max_sigma_end: Positive = 0.01
    """Likewise of an end along the axis, metres."""
    clearance: Positive = 0.5
    """Smallest distance of the drone from the surface of a beam, metres."""
    stay_s: Positive = 5.0
    """Time to stay at each place, seconds."""
    speed: Positive = 0.3
    """Speed on the way from place to place, metres per second."""


class OutputConfig(Node):
    """What is written, and where."""

    path: str | None = None
    """Output folder; null is a folder named after the flight."""
    verbosity: Annotated[int, Field(ge=0, le=2)] = 1
    """0 errors only, 1 progress and information, 2 details of every scan."""
    report: bool = True
    """Whether report.html is written."""
    candidates: bool = False
    """Whether candidates.parquet is written: everything that might have been a beam, and why it
    is one or not, for beamseg explain. Needs the extra parquet."""
    cloud_points: Annotated[int, Field(ge=0, le=20_000_000)] = 200_000
    """Most points of the thinned cloud of the flight."""
    fly_again: FlyAgainConfig = FlyAgainConfig()


class RunConfig(Node):
    """The whole configuration of a run."""

    profile: str = DEFAULT_PROFILE
    """The base that a file overlays."""
    recording: RecordingConfig = RecordingConfig()
    matching: MatchingConfig = MatchingConfig()
    sensor: SensorConfig = SensorConfig()
    filtering: FilteringConfig = FilteringConfig()
    detection: DetectionConfig = DetectionConfig()
    structure: StructureConfig = StructureConfig()
    refinement: RefinementConfig = RefinementConfig()
    outputs: OutputConfig = OutputConfig()
