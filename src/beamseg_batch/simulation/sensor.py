"""The camera on the drone and the source of its poses: what is set, and where from."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError, model_validator

from beamseg_batch.config import ExtrinsicConfig, config_folder, sensor_names
from beamseg_batch.errors import ConfigError, WorldError
from beamseg_batch.geometry import FloatArray, RigidTransform, matrix_from_rpy
from beamseg_batch.schema import (
    Finite,
    Interval,
    Node,
    NonNegative,
    Positive,
    Seconds,
    Share,
    Vector3,
    nearest,
    parse_setting,
    problems,
)
from beamseg_batch.simulation.casting import RayGrid
from beamseg_batch.world.document import load_document, requirement, validate

__all__ = ["DEFAULT_SENSOR", "Camera", "PoseSource", "Sensor", "load_sensor", "sensor_names"]

DEFAULT_SENSOR = "webots_range_finder"
"""Shipped sensor that is flown where none is named."""


class Camera(Node):
    """A time-of-flight camera: a pinhole that measures depth, the distance from its plane."""

    width: Annotated[int, Field(ge=2, le=4096)]
    """Pixels in a row."""
    height: Annotated[int, Field(ge=2, le=4096)]
    """Rows."""
    horizontal_fov: Annotated[float, Field(gt=0, lt=3.1)]
    """Field of view across the width, radians: focal = width / 2 / tan(fov / 2) pixels."""
    pixel_offset: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Where in a pixel its ray lies: 0 is its left upper corner, as the original's clouds
    have it, 0.5 its middle. Ray (u, v): y/x = (width/2 - u - offset) / focal, z/x alike."""
    range: Interval = (0.1, 4.0)
    """Least and largest depth that gives a return, metres."""
    noise: NonNegative = 0.0
    """Standard deviation of the depth, metres. (The field `noise` of a Webots RangeFinder
    is a share of the maximum range: 0.01 at 4 m is 0.04 here.)"""
    noise_relative: NonNegative = 0.0
    """Standard deviation that grows with the depth: a share of it, added in squares."""
    footprint: Annotated[int, Field(ge=1, le=15)] = 1
    """Sub-rays along each side of a pixel, whose mean depth it measures: at an edge, that of
    the front and the back (mixed pixels)."""
    grazing_deg: Annotated[float, Field(ge=0, lt=90)] = 0.0
    """Rays that meet a surface at a smaller angle do not return, degrees."""
    dropout: Share = 0.0
    """Share of the returns that is lost by chance."""
    organised: bool = True
    """Whether clouds have rows and columns; else pixels without return are left out of them."""
    rate_hz: Positive = 5.0
    """Clouds a second."""
    stamp_jitter_s: NonNegative = 0.001
    """Standard deviation of the time from one cloud to the next, seconds."""

    @model_validator(mode="after")
    def _ordered(self) -> Camera:
        low, high = self.range
        if not 0.0 <= low < high:
            raise ValueError(f"range: must be two rising depths from 0, not {low:g}, {high:g}")
        return self

    @property
    def focal_px(self) -> float:
        """Focal length, pixels."""
        return self.width / 2.0 / math.tan(self.horizontal_fov / 2.0)

    @cached_property
    def grid(self) -> RayGrid:
        """The ray of each pixel, through its middle if it has a footprint."""
        return self._grid(1)

    @cached_property
    def sub_grid(self) -> RayGrid:
        """All rays of each pixel, `footprint` along each of its sides."""
        return self._grid(self.footprint)

    def _grid(self, n: int) -> RayGrid:
        inside = self.pixel_offset + (np.arange(n) - (n - 1) / 2.0) / n

        def slopes(pixels: int) -> FloatArray:
            places = (np.arange(pixels)[:, None] + inside).ravel()
            return (places - pixels / 2.0) / self.focal_px

        return RayGrid(slopes(self.width), slopes(self.height))

    def noise_at(self, depths: FloatArray) -> FloatArray:
        """Standard deviation of some depths, metres."""
        deviations: FloatArray = np.hypot(self.noise, self.noise_relative * depths)
        return deviations


class PoseSource(Node):
    """The motion capture or estimator that tells where the drone is, and its errors."""

    rate_hz: Positive = 125.0
    """Poses a second."""
    jitter_position: NonNegative = 0.0
    """Standard deviation of each pose's position along each axis, metres."""
    jitter_attitude_deg: NonNegative = 0.0
    """Standard deviation of each pose's attitude about each axis, degrees."""
    walk_position: NonNegative = 0.0
    """Drift as a random walk: standard deviation of its step from pose to pose, metres."""
    walk_attitude: NonNegative = 0.0
    """The same about each axis, radians."""
    drift_velocity: Vector3 = (0.0, 0.0, 0.0)
    """Steady drift, metres per second in the world frame."""
    drift_yaw_rate_deg: Finite = 0.0
    """Steady drift of the yaw, degrees per second."""
    gaps: tuple[tuple[NonNegative, Positive], ...] = ()
    """When no poses come: start in seconds from the beginning, and duration in seconds."""
    clock_offset_s: Seconds = 0.0
    """How far the clock of the clouds runs ahead of that of the poses, seconds."""


class Sensor(Node):
    """What the drone carries and is tracked by."""

    camera: Camera
    poses: PoseSource = PoseSource()
    extrinsic: ExtrinsicConfig = ExtrinsicConfig()
    """Where the camera sits on the drone."""
    extrinsic_in: Literal["tf", "cloud", "none"] = "tf"
    """tf: written to /tf_static; cloud: applied to the points, which are then in the drone's
    axes; none: neither, so that a run must be told."""

    @property
    def T_body_sensor(self) -> RigidTransform:
        """Where the camera sits on the drone."""
        rotation = matrix_from_rpy(*np.radians(self.extrinsic.rotation_rpy_deg))
        return RigidTransform(rotation, np.array(self.extrinsic.translation, dtype=np.float64))

    @property
    def T_cloud_sensor(self) -> RigidTransform:
        """From the camera's axes to those that the points are written in."""
        return self.T_body_sensor if self.extrinsic_in == "cloud" else RigidTransform.identity()


def load_sensor(name_or_path: str | Path, settings: Sequence[str] = ()) -> Sensor:
    """Load a sensor.

    Parameters
    ----------
    name_or_path : str or Path
        Name of a shipped sensor, or a YAML file.
    settings : sequence of str
        Values to change, as ``camera.noise=0.02``, the value in YAML.

    Returns
    -------
    Sensor

    Raises
    ------
    WorldError
        If there is no such sensor, or something in its file is not valid.
    ConfigError
        If a setting is not valid.
    """
    sensor = validate(Sensor, load_document(_find(str(name_or_path))))
    for setting in settings:
        sensor = _changed(sensor, setting)
    return sensor


def _find(name_or_path: str) -> Path:
    if name_or_path in sensor_names():
        return config_folder() / "sensors" / f"{name_or_path}.yaml"
    path = Path(name_or_path)
    if path.suffix or path.exists():
        return path
    suggestion = nearest(name_or_path, sensor_names())
    raise WorldError(
        f"unknown sensor {name_or_path!r}{suggestion}; there are: {', '.join(sensor_names())}; "
        "a sensor of your own is a YAML file"
    )


def _changed(sensor: Sensor, setting: str) -> Sensor:
    key, value = parse_setting(setting, "camera.noise=0.02")
    tree = sensor.model_dump()
    *above, name = key.split(".")
    branch: Any = tree
    for part in above:
        branch = branch.get(part) if isinstance(branch, dict) else None
    if not isinstance(branch, dict) or name not in branch:
        raise ConfigError(f"unknown setting {key!r}{nearest(key, _keys(tree))}")
    branch[name] = value
    try:
        return Sensor.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(f"{setting}: {requirement(problems(error)[0])}") from None


def _keys(tree: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    for name, value in tree.items():
        if isinstance(value, Mapping):
            yield from _keys(value, f"{prefix}{name}.")
        else:
            yield prefix + name
