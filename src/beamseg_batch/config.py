"""The configuration tree: one frozen pydantic model, YAML in and out.

A profile (`configs/NAME.yaml`) is the base; a user's file overlays the profile it
names, the command line overlays both. Every value has a unit, a range and a meaning
here, and `beamseg config schema` prints them.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    Field,
    PlainSerializer,
    ValidationError,
    WithJsonSchema,
    model_validator,
)

from beamseg_batch.errors import ConfigError
from beamseg_batch.schema import (
    Finite,
    Interval,
    Node,
    NonNegative,
    Positive,
    Seconds,
    Share,
    Vector3,
    YamlError,
    message_of,
    nearest,
    parse_setting,
    problems,
    read_yaml,
    shortened,
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
    "RunConfig",
    "ScreeningConfig",
    "SensorConfig",
    "ShapeConfig",
    "StructureConfig",
    "ThresholdConfig",
    "WindowConfig",
    "config_yaml",
    "load_config",
    "profile_names",
    "sensor_names",
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


ALIASES: Mapping[str, str] = {
    "radius_sizes": "filtering.radii",
    "radius_size": "filtering.radii",
    "floor_trim_height": "filtering.floor_trim_height",
    "rad_2_leaf_ratio": "filtering.rad_2_leaf_ratio",
    "min_pca_coeff": "detection.screening.min_pca_coeff",
    "min_pca_coef": "detection.screening.min_pca_coeff",
    "opt_minvotes": "detection.hough.minvotes",
    "opt_nlines": "detection.hough.nlines",
    "opt_dx": "detection.hough.dx",
    "granularity": "detection.hough.granularity",
    "min_weight": "structure.min_weight",
    "path_to_output": "outputs.path",
    "verbose_level": "outputs.verbosity",
    "vebose_level": "outputs.verbosity",
}
"""Keys of the original node's configuration file, and where they live here."""


_OF_MODEL: Mapping[str, str] = {
    "noise_m": "camera.noise",
    "noise_relative": "camera.noise_relative",
    "mixed_pixels": "camera.footprint",
    "pose_jitter_m": "poses.jitter_position",
    "pose_jitter_deg": "poses.jitter_attitude_deg",
    "extrinsic": "extrinsic",
}
"""Keys of the `sensor` branch that a sensor's file tells, and their places there."""


def config_folder() -> Path:
    """Folder of the shipped configuration files.

    Returns
    -------
    Path
        Inside the installed package; in an editable install, ``configs/`` of the checkout.
    """
    package = Path(__file__).parent
    installed = package / "configs"
    return installed if installed.is_dir() else package.parents[1] / "configs"


def profile_names() -> tuple[str, ...]:
    """Names of the shipped profiles, sorted."""
    return tuple(sorted(path.stem for path in config_folder().glob("*.yaml")))


def sensor_names() -> tuple[str, ...]:
    """Names of the shipped sensors, sorted."""
    return tuple(sorted(path.stem for path in (config_folder() / "sensors").glob("*.yaml")))


def load_config(
    profile: str | None = None,
    file: Path | None = None,
    overrides: Sequence[str] = (),
) -> RunConfig:
    """Load a configuration: profile, then file, then single values.

    Parameters
    ----------
    profile : str, optional
        Name of a shipped profile. Without it the file's own, or ``report`` when the
        file is one of the original node, or ``precise``.
    file : Path, optional
        YAML file that overlays the profile.
    overrides : sequence of str
        ``key.path=value`` settings, the value in YAML.

    Returns
    -------
    RunConfig

    Raises
    ------
    ConfigError
        If a file is missing or not YAML, a profile or key unknown, or a value out of range.
    """
    overlay = _read_mapping(file) if file else {}
    where = str(file) if file else "configuration"
    original = _is_original(overlay)
    overlay = _resolve_aliases(overlay, where)
    for override in overrides:
        overlay = _merged(overlay, _parse_override(override))
    named = overlay.get("profile")
    if named is not None and not isinstance(named, str):
        raise ConfigError(f"{where}: profile must be a name, not {named!r}")
    name = profile or named or ("report" if original else DEFAULT_PROFILE)
    tree = _merged(_read_profile(name), overlay)
    tree["profile"] = name
    tree = _with_sensor_model(tree)
    return _validated(tree, where)


def config_yaml(config: RunConfig) -> str:
    """Write a configuration as YAML that `load_config` reads back to the same tree."""
    from ruamel.yaml import YAML

    buffer = io.StringIO()
    writer = YAML(typ="safe", pure=True)
    writer.default_flow_style = None
    writer.width = 100
    writer.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    writer.dump(config.model_dump(mode="json"), buffer)
    return buffer.getvalue()


def _read_profile(name: str) -> dict[str, Any]:
    if name not in profile_names():
        raise ConfigError(
            f"unknown profile {name!r}{nearest(name, profile_names())}; "
            f"there are: {', '.join(profile_names())}"
        )
    return _read_mapping(config_folder() / f"{name}.yaml")


def _read_mapping(path: Path) -> dict[str, Any]:
    try:
        content, _ = read_yaml(path)
    except YamlError as error:
        raise ConfigError(f"{path}: {error}") from error
    if content is None:
        return {}
    if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
        raise ConfigError(f"{path}: must be a mapping of keys to values")
    return content


def _with_sensor_model(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Fill in what the sensor's model tells and the configuration leaves open."""
    sensor = tree.get("sensor")
    if not isinstance(sensor, Mapping) or not isinstance(sensor.get("model"), str):
        return dict(tree)
    told = _told_by_model(sensor["model"])
    return _merged(tree, {"sensor": {k: v for k, v in told.items() if sensor.get(k) is None}})


def _told_by_model(name: str) -> dict[str, Any]:
    """Values of the `sensor` branch that a file of a sensor tells."""
    path = _sensor_path(name)
    content = _read_mapping(path)
    found: dict[str, Any] = {}
    for key, where in _OF_MODEL.items():
        branch: Any = content
        for part in where.split("."):
            branch = branch.get(part) if isinstance(branch, Mapping) else None
        if branch is None or (key == "extrinsic" and content.get("extrinsic_in", "none") != "none"):
            continue
        # A footprint of one sub-ray is a point, and noise of zero is not known.
        value = branch > 1 if key == "mixed_pixels" and isinstance(branch, int) else branch
        found[key] = None if key == "noise_m" and value == 0 else value
        try:
            SensorConfig.model_validate({key: found[key]})
        except ValidationError as error:
            reason = message_of(problems(error)[0])
            raise ConfigError(f"{path}: {where} is {shortened(branch)}: {reason}") from None
    if not found:
        raise ConfigError(
            f"{path}: tells nothing of a sensor; keys are {', '.join(_OF_MODEL.values())}"
        )
    return found


def _sensor_path(name: str) -> Path:
    if name in sensor_names():
        return config_folder() / "sensors" / f"{name}.yaml"
    if Path(name).suffix:
        return Path(name)
    raise ConfigError(
        f"sensor.model: unknown sensor {name!r}{nearest(name, sensor_names())}; there are: "
        f"{', '.join(sensor_names())}; a sensor of your own is a YAML file"
    )


def _is_original(tree: Mapping[str, Any]) -> bool:
    """Whether every key is one of the original node's flat keys."""
    return bool(tree) and all(key in ALIASES for key in tree)


def _resolve_aliases(tree: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Move the original node's flat keys to their places in the tree."""
    resolved: dict[str, Any] = {key: value for key, value in tree.items() if key not in ALIASES}
    given: dict[str, str] = {}
    for key in tree:
        if (path := ALIASES.get(key)) is not None and given.setdefault(path, key) != key:
            raise ConfigError(f"{where}: {given[path]!r} and {key!r} both set {path}; keep one")
    for key in tree:
        if key in ALIASES:
            resolved = _merged(resolved, _nested(ALIASES[key], _translated(key, tree[key])))
    return resolved


def _translated(alias: str, value: Any) -> Any:
    """Say a value of the original node as this tree says it."""
    if ALIASES[alias] == "filtering.radii" and not isinstance(value, list):
        return [value]
    if ALIASES[alias] == "detection.hough.dx" and value == 0:
        return None
    return value


def _nested(path: str, value: Any) -> dict[str, Any]:
    tree: Any = value
    for key in reversed(path.split(".")):
        tree = {key: tree}
    assert isinstance(tree, dict)
    return tree


def _parse_override(text: str) -> dict[str, Any]:
    key, value = parse_setting(text, "detection.hough.granularity=5")
    return _resolve_aliases({key: value}, key) if key in ALIASES else _nested(key, value)


def _merged(base: Mapping[str, Any], overlay: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in overlay.items():
        if isinstance(value, Mapping) and isinstance(merged.get(key), Mapping):
            merged[key] = _merged(merged[key], value)
        else:
            merged[key] = value
    return merged


def _validated(tree: Mapping[str, Any], where: str) -> RunConfig:
    try:
        return RunConfig.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(f"{where}: " + "; ".join(map(_explain, problems(error)))) from None


def _explain(problem: Mapping[str, Any]) -> str:
    """Say one pydantic problem in a sentence, with the way out."""
    path = ".".join(str(part) for part in problem["loc"])
    if problem["type"] == "extra_forbidden":
        return f"unknown key {path!r}{nearest(path, [*ALIASES, *_key_paths(RunConfig)])}"
    value = problem.get("input")
    shown = "" if isinstance(value, Mapping) else f" is {shortened(value)}"
    return f"{path}{shown}: {message_of(problem)}"


def _key_paths(node: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Paths of all values of the tree, branches left out."""
    for name, entry in node.model_fields.items():
        candidates = (entry.annotation, *getattr(entry.annotation, "__args__", ()))
        branches = [c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel)]
        for branch in branches:
            yield from _key_paths(branch, f"{prefix}{name}.")
        if not branches:
            yield prefix + name
