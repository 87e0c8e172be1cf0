"""Where the drone flies: the kinds of flight, and the true pose at any time."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from pydantic import ValidationError, model_validator

from beamseg_batch.errors import WorldError
from beamseg_batch.geometry import FloatArray, RigidTransform
from beamseg_batch.schema import (
    Finite,
    Node,
    NonNegative,
    Positive,
    Vector3,
    nearest,
    problems,
)
from beamseg_batch.simulation.rotations import quaternions_from_rpy
from beamseg_batch.world.document import Document, Key, load_document, requirement, validate

__all__ = [
    "FigureEight",
    "Flight",
    "Lawnmower",
    "Orbit",
    "Spiral",
    "TruePath",
    "Waypoint",
    "Waypoints",
    "Wobble",
    "load_flight",
    "read_flight",
    "read_waypoints",
]

_STANDING_HEIGHT = 0.037
"""Height of the drone's body above the floor that it stands on, metres."""
_RAMP = 0.1
"""Share of a flight at each of its ends in which it gathers or loses speed."""
_WAVES = 3
_WAVE_HZ = (0.15, 0.8)
_COLUMNS = ("x", "y", "z", "yaw", "duration")


class Wobble(Node):
    """How a hovering drone sways about its path: slow waves of random frequency and phase."""

    position: NonNegative = 0.01
    """Standard deviation along each axis, metres."""
    attitude_deg: NonNegative = 1.2
    """Standard deviation of roll, of pitch and of yaw, degrees."""


class _Flight(Node):
    """A path that the drone follows at smooth speed, from rest to rest."""

    wobble: Wobble = Wobble()
    """How the drone sways about the path."""

    @property
    def duration_s(self) -> float:
        """Seconds from the start to the end."""
        return self._duration()

    def along(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Place and yaw on the path.

        Parameters
        ----------
        times : (N,) float64, seconds from the start

        Returns
        -------
        positions : (N, 3) float64, metres, world frame
        yaws : (N,) float64, radians
        """
        return self._along(times)

    @abstractmethod
    def _duration(self) -> float: ...

    @abstractmethod
    def _along(self, times: FloatArray) -> tuple[FloatArray, FloatArray]: ...


class Waypoint(Node):
    """Where to fly to, and how long that takes."""

    x: Finite
    """Metres, world frame."""
    y: Finite
    """Metres, world frame."""
    z: Finite
    """Metres, world frame."""
    yaw: Finite
    """Where the drone looks when it arrives, radians."""
    duration: Positive
    """Time that it takes from the waypoint before, seconds."""


class Waypoints(_Flight):
    """From waypoint to waypoint on straight lines, at rest in each."""

    kind: Literal["waypoints"] = "waypoints"
    points: tuple[Waypoint, ...] = ()
    """In the order in which they are flown to."""
    file: str | None = None
    """Table that holds them instead, relative to the file that names it."""
    start: Vector3 | None = None
    """Where the flight begins, metres; null is the floor, z = 0, below the first waypoint."""

    @model_validator(mode="after")
    def _has_points(self) -> Waypoints:
        if bool(self.points) == (self.file is not None):
            raise ValueError("needs either points or file")
        return self

    def _duration(self) -> float:
        return sum(point.duration for point in self.points)

    def _along(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        arrivals = np.cumsum([0.0, *(point.duration for point in self.points)])
        leg = np.clip(np.searchsorted(arrivals, times, side="right") - 1, 0, len(self.points) - 1)
        share = _eased((times - arrivals[leg]) / np.diff(arrivals)[leg])
        places = np.array([self._start(), *((p.x, p.y, p.z) for p in self.points)])
        # Unwrapped, so that the drone turns the shorter way.
        yaws = np.unwrap([self.points[0].yaw, *(point.yaw for point in self.points)])
        positions = places[leg] + share[:, None] * (places[leg + 1] - places[leg])
        return positions, yaws[leg] + share * (yaws[leg + 1] - yaws[leg])

    def _start(self) -> Vector3:
        first = self.points[0]
        return self.start or (first.x, first.y, min(first.z, _STANDING_HEIGHT))


class _Curve(_Flight):
    """A curve, flown at a steady speed except near its ends."""

    speed: Positive = 0.3
    """Mean speed, metres per second."""

    @abstractmethod
    def _points_at(self, share: FloatArray) -> FloatArray:
        """Points of the curve, (N, 3) metres; `share` (N,) of its parameter, 0 to 1."""

    @abstractmethod
    def _yaws_at(self, share: FloatArray) -> FloatArray:
        """Yaw at each of these points, (N,) radians."""

    @cached_property
    def length(self) -> float:
        """Length of the curve, metres."""
        points = self._points_at(np.linspace(0.0, 1.0, 10_001))
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())

    def _duration(self) -> float:
        return self.length / self.speed

    def _along(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        share = _ramped(times / self.duration_s)
        return self._points_at(share), self._yaws_at(share)


class _Circling(_Curve):
    """Round and round, the camera towards the middle."""

    radius: Positive
    """Distance of the drone from the centre, metres."""
    turns: Positive = 1.0
    """Number of rounds."""
    start_angle_deg: Finite = 0.0
    """Where the flight begins, degrees from the world's x as seen from the centre."""

    def _angles(self, share: FloatArray) -> FloatArray:
        angles: FloatArray = math.radians(self.start_angle_deg) + 2.0 * np.pi * self.turns * share
        return angles

    def _yaws_at(self, share: FloatArray) -> FloatArray:
        return self._angles(share) + np.pi

    def _circle(self, x: float, y: float, heights: FloatArray, share: FloatArray) -> FloatArray:
        angles = self._angles(share)
        across, along = self.radius * np.cos(angles), self.radius * np.sin(angles)
        return np.column_stack([x + across, y + along, heights])


class Orbit(_Circling):
    """Round a centre at one height."""

    kind: Literal["orbit"] = "orbit"
    centre: Vector3
    """Centre of the circle, metres, world frame."""

    def _points_at(self, share: FloatArray) -> FloatArray:
        x, y, z = self.centre
        return self._circle(x, y, np.full(len(share), z), share)


class Spiral(_Circling):
    """Round a vertical axis, up or down."""

    kind: Literal["spiral"] = "spiral"
    centre: tuple[Finite, Finite]
    """The axis, x and y in metres."""
    heights: tuple[Finite, Finite]
    """Height at the start and at the end, metres."""

    def _points_at(self, share: FloatArray) -> FloatArray:
        low, high = self.heights
        return self._circle(*self.centre, low + share * (high - low), share)


class _Facing(Node):
    """In an upright plane, the camera square to it."""

    yaw_deg: Finite
    """Where the camera looks, degrees."""

    def _plane(self) -> tuple[FloatArray, FloatArray]:
        """Unit vectors to the camera's right and up."""
        yaw = math.radians(self.yaw_deg)
        return np.array([math.sin(yaw), -math.cos(yaw), 0.0]), np.array([0.0, 0.0, 1.0])


class Lawnmower(_Facing, _Flight):
    """Along a facade in rows, each above the last."""

    kind: Literal["lawnmower"] = "lawnmower"
    start: Vector3
    """First corner: the left end of the first row as the camera sees it, metres."""
    width: Positive
    """Length of a row, metres."""
    height: Finite
    """From the first row to the last, metres; downwards if negative."""
    spacing: Positive = 0.5
    """Most that two rows may lie apart, metres."""
    speed: Positive = 0.3
    """Mean speed, metres per second."""

    @cached_property
    def _route(self) -> Waypoints:
        right, up = self._plane()
        n_steps = math.ceil(abs(self.height) / self.spacing)
        rows = np.linspace(0.0, self.height, n_steps + 1)
        corners = [
            np.array(self.start) + side * self.width * right + row * up
            for number, row in enumerate(rows)
            for side in ((0, 1) if number % 2 == 0 else (1, 0))
        ]
        legs = np.linalg.norm(np.diff(corners, axis=0), axis=1)
        yaw = math.radians(self.yaw_deg)
        points = [
            Waypoint(x=x, y=y, z=z, yaw=yaw, duration=leg / self.speed)
            for (x, y, z), leg in zip(np.array(corners[1:]).tolist(), legs.tolist(), strict=True)
        ]
        return Waypoints(points=tuple(points), start=self.start)

    def _duration(self) -> float:
        return self._route.duration_s

    def _along(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self._route.along(times)


class FigureEight(_Facing, _Curve):
    """An eight that lies on its side, before a facade."""

    kind: Literal["figure_eight"] = "figure_eight"
    centre: Vector3
    """Where the eight crosses itself, metres, world frame."""
    width: Positive
    """Extent to the sides, metres."""
    height: Positive
    """Extent upwards, metres."""
    loops: Positive = 1.0
    """How often it is flown."""

    def _points_at(self, share: FloatArray) -> FloatArray:
        right, up = self._plane()
        phase = 2.0 * np.pi * self.loops * share[:, None]
        # Gerono's lemniscate: the sine of the double angle is 1 at its highest point.
        points: FloatArray = (
            np.array(self.centre)
            + self.width / 2.0 * np.sin(phase) * right
            + self.height / 2.0 * np.sin(2.0 * phase) * up
        )
        return points

    def _yaws_at(self, share: FloatArray) -> FloatArray:
        return np.full(len(share), math.radians(self.yaw_deg))


Flight: TypeAlias = Waypoints | Orbit | Spiral | Lawnmower | FigureEight
"""Any kind of flight."""

_KINDS: Mapping[str, type[Waypoints | Orbit | Spiral | Lawnmower | FigureEight]] = {
    "waypoints": Waypoints,
    "orbit": Orbit,
    "spiral": Spiral,
    "lawnmower": Lawnmower,
    "figure_eight": FigureEight,
}


def _eased(share: FloatArray) -> FloatArray:
    """Progress from rest to rest with the least jerk: speed and acceleration end at zero."""
    u = np.clip(share, 0.0, 1.0)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u * u)


def _ramped(share: FloatArray) -> FloatArray:
    """Progress at a steady speed that is gathered and lost smoothly at the ends."""
    u = np.clip(share, 0.0, 1.0)

    def gathered(v: FloatArray) -> FloatArray:
        """Way made when the speed has risen as 3w² - 2w³ since the start."""
        w = np.minimum(v / _RAMP, 1.0)
        return _RAMP * (w**3 - w**4 / 2.0) + np.maximum(v - _RAMP, 0.0)

    progress: FloatArray = np.where(u < 0.5, gathered(u), 1.0 - _RAMP - gathered(1.0 - u))
    return progress / (1.0 - _RAMP)


@dataclass(frozen=True, eq=False)
class TruePath:
    """True poses of the drone: a flight, and its wobble.

    Parameters
    ----------
    flight : Flight
    seed : int
        The same seed gives the same wobble.
    """

    flight: Flight
    seed: int

    @cached_property
    def _waves(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Frequencies (Hz) and phases (radians), (6, waves), and amplitudes (6,)."""
        rng = np.random.default_rng([self.seed, 0])
        wobble, shape = self.flight.wobble, (6, _WAVES)
        deviations = [wobble.position] * 3 + [math.radians(wobble.attitude_deg)] * 3
        # A wave has the variance a²/2, and those of different frequency add.
        amplitudes = np.array(deviations) * math.sqrt(2.0 / _WAVES)
        return rng.uniform(*_WAVE_HZ, shape), rng.uniform(0.0, 2.0 * np.pi, shape), amplitudes

    def poses(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Poses at some times.

        Parameters
        ----------
        times : (N,) float64, seconds from the start

        Returns
        -------
        positions : (N, 3) float64, metres, world frame
        quaternions_xyzw : (N, 4) float64, ``T_world_body``
        """
        frequencies, phases, amplitudes = self._waves
        waves = np.sin(2.0 * np.pi * times[:, None, None] * frequencies + phases).sum(axis=2)
        sway = waves * amplitudes
        positions, yaws = self.flight.along(times)
        rpy = sway[:, 3:] + np.column_stack([np.zeros_like(yaws), np.zeros_like(yaws), yaws])
        return positions + sway[:, :3], quaternions_from_rpy(rpy)

    def pose(self, time_s: float) -> RigidTransform:
        """``T_world_body`` at one time, seconds from the start."""
        positions, quaternions = self.poses(np.array([time_s]))
        return RigidTransform.from_quaternion(positions[0], quaternions[0])


def load_flight(path: Path) -> Flight:
    """Read a flight from a YAML file of its own; raises WorldError as `read_flight` does."""
    return read_flight(load_document(path))


def read_flight(document: Document, key: Key = ()) -> Flight:
    """Read a flight from a part of a YAML file.

    Parameters
    ----------
    document : Document
    key : tuple of str and int
        Where the part stands; the whole document without.

    Returns
    -------
    Flight

    Raises
    ------
    WorldError
        If something of it, or of the waypoint file that it names, is not valid; with
        file and line.
    """
    part = document.value(key)
    if not isinstance(part, Mapping):
        raise document.error(key, "must be a mapping of keys to values")
    kind = part.get("kind")
    if not isinstance(kind, str) or kind not in _KINDS:
        suggestion = nearest(str(kind), _KINDS) if kind is not None else ""
        raise document.error((*key, "kind"), f"must be one of {', '.join(_KINDS)}{suggestion}")
    flight = validate(_KINDS[kind], document, key)
    if isinstance(flight, Waypoints) and flight.file is not None:
        points = read_waypoints(document.path.parent / flight.file)
        flight = flight.model_copy(update={"points": points, "file": None})
    return flight


def read_waypoints(path: Path) -> tuple[Waypoint, ...]:
    """Read waypoints from a table with the columns ``x,y,z,yaw,duration``.

    Parameters
    ----------
    path : Path
        Metres, radians and seconds; the columns in any order, others are passed over, as
        are empty lines and blanks around the values.

    Returns
    -------
    tuple of Waypoint

    Raises
    ------
    WorldError
        If the file cannot be read, a column is missing, or a value is not valid; with
        file and line.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise WorldError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise WorldError(f"{path}: is not UTF-8 text") from error
    rows = [
        (number, [text.strip() for text in line.split(",")])
        for number, line in enumerate(lines, start=1)
        if line.strip()
    ]
    if not rows:
        raise WorldError(f"{path}: is empty; the first line must be {','.join(_COLUMNS)}")
    (number, header), *rest = rows
    missing = [name for name in _COLUMNS if name not in header]
    if missing:
        raise WorldError(
            f"{path}:{number}: has no column {', '.join(missing)}; "
            f"the first line must be {','.join(_COLUMNS)}"
        )
    if not rest:
        raise WorldError(f"{path}:{number}: no waypoint follows the names of the columns")
    return tuple(_waypoint(f"{path}:{number}", header, row) for number, row in rest)


def _waypoint(where: str, header: Sequence[str], row: Sequence[str]) -> Waypoint:
    if len(row) != len(header):
        raise WorldError(f"{where}: has {len(row)} values, the first line {len(header)}")
    texts = dict(zip(header, row, strict=True))
    try:
        return Waypoint.model_validate({name: texts[name] for name in _COLUMNS})
    except ValidationError as error:
        found = problems(error)[0]
        name = found["loc"][0]
        raise WorldError(f"{where}: {name}: {requirement(found)}, not {texts[name]!r}") from None
