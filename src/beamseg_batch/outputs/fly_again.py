"""What to fly again: places to look from, and a way there, for what is still in doubt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import FlightResult, Segment
from beamseg_batch.outputs.quality import doubts_of
from beamseg_batch.tables import ColumnArrays

__all__ = ["MAX_LOOKS", "FlightPlan", "Look", "fly_again_columns", "plan_flight"]

MAX_LOOKS = 200
"""Looks of one plan: half an hour of flight."""

_YAWS = np.arange(24) * (np.pi / 12)
_SHARES = (0.65, 0.5, 0.85)  # of the window's depth, that seen best first
_MAX_DISTANCE_M = 1.5
_RISES = (0.0, 0.25, -0.25)  # of the camera over what it looks at, in distances
_LOWEST_M = 0.3
_MOST_ALONG = 0.8  # cosine between view and beam
_ALONG_COSTS_M = 3.0  # of distance from the flown path, for a view along the beam
_STEP_M = 0.2
_FURTHEST_M = 100.0  # of a way that is looked at closely
_PATH_STEP_M = 0.25
_LEAST_S = 2.0
_MOST_TRIED = 24  # places a target, of those that keep their distance
_MOST_JOINED = 2  # points of the path that was flown, from which a place is reached


@dataclass(frozen=True, eq=False)
class Look:
    """Something to look at again, and from where.

    Attributes
    ----------
    beam : int
        Index into the structure's segments.
    reasons : tuple of str
        What is in doubt, for people.
    target : (3,) float64, metres, world frame
        What to look at.
    place : (3,) float64, metres, world frame, or None
        Where the drone should be; None if no place nearby is free.
    yaw : float
        Where the drone should point, radians.
    """

    beam: int
    reasons: tuple[str, ...]
    target: FloatArray
    place: FloatArray | None = None
    yaw: float = 0.0


@dataclass(frozen=True, eq=False)
class FlightPlan:
    """What to fly again.

    Attributes
    ----------
    looks : tuple of Look
        In the order of the flight, those without a place at the end.
    waypoints : (N, 5) float64
        x, y, z in metres, world frame, yaw in radians, seconds from the one before.
    total : int
        Looks that are wanted, of which at most `MAX_LOOKS` are planned, by number of beam.
    """

    looks: tuple[Look, ...]
    waypoints: FloatArray
    total: int

    @property
    def duration_s(self) -> float:
        """Seconds that it takes."""
        return float(self.waypoints[:, 4].sum())


def plan_flight(result: FlightResult) -> FlightPlan:
    """Plan a flight that settles what is in doubt.

    Parameters
    ----------
    result : FlightResult

    Returns
    -------
    FlightPlan
        Each place shows its target ahead, across the beam as far as possible, inside the
        window of the camera; it keeps its distance from every beam, has a clear view, and is
        reached from the path that was flown along a clear line. The way from one place to
        the next is straight where that is clear, else along the path that was flown.

    Notes
    -----
    What is no beam, such as a wall, is not known here; hence the nearness to the flown path.
    """
    space = _Space(result)
    wanted = [
        look for number, beam in enumerate(result.segments) for look in _looks(number, beam, result)
    ]
    placed = [space.with_place(look) for look in wanted[:MAX_LOOKS]]
    free = _in_order([look for look in placed if look.place is not None], space.start)
    blocked = [look for look in placed if look.place is None]
    return FlightPlan((*free, *blocked), space.waypoints(free), len(wanted))


def fly_again_columns(plan: FlightPlan) -> ColumnArrays:
    """Columns of `fly_again.csv`.

    Parameters
    ----------
    plan : FlightPlan

    Returns
    -------
    mapping of str to (N,) array
    """
    names = ("x", "y", "z", "yaw", "duration")
    return {name: plan.waypoints[:, k] for k, name in enumerate(names)}


def _looks(number: int, beam: Segment, result: FlightResult) -> list[Look]:
    """What to look at: an end in doubt; for an axis in doubt both ends and the middle."""
    doubts = [doubt for doubt in doubts_of(beam, result.config) if not doubt.cut]
    axis = tuple(doubt.text for doubt in doubts if doubt.kind == "axis")
    targets = {"end 1": beam.end_1, "end 2": beam.end_2}
    looks = []
    for kind, target in targets.items():
        reasons = tuple(doubt.text for doubt in doubts if doubt.kind == kind) or axis
        if reasons:
            looks.append(Look(number, reasons, target))
    return [*looks, *([Look(number, axis, beam.midpoint)] if axis else [])]


class _Space:
    """Where beams stand, where the drone has been, and how its camera looks."""

    def __init__(self, result: FlightResult) -> None:
        self._config = result.config.outputs.fly_again
        self._camera = result.recording.T_body_sensor
        self._window = result.config.filtering.window
        self._ends = np.array([(s.end_1, s.end_2) for s in result.segments]).reshape(-1, 2, 3)
        self._radii = np.array([segment.radius for segment in result.segments])
        self._middles = self._ends.mean(axis=1)
        self._reaches = np.array([segment.length / 2 for segment in result.segments]) + self._radii
        self._directions = np.array([s.direction for s in result.segments]).reshape(-1, 3)
        self._path = _spaced(result.trajectory.positions)

    @property
    def start(self) -> FloatArray:
        """Where the first flight began."""
        first: FloatArray = self._path[0]
        return first

    def with_place(self, look: Look) -> Look:
        """Find the best place to look from, if there is one."""
        places, yaws, views = self._candidates(look.target)
        along = np.abs(views @ self._directions[look.beam])
        free = (along <= _MOST_ALONG) & (places[:, 2] >= _LOWEST_M) & self._are_free(places)
        away = np.linalg.norm(places[:, None] - self._path, axis=2).min(axis=1, initial=np.inf)
        costs = away + _ALONG_COSTS_M * along**2
        best = np.argsort(np.where(free, costs, np.inf), kind="stable")
        for row in best[: min(int(free.sum()), _MOST_TRIED)]:
            if self._sees(places[row], look) and self._joins_path(places[row]):
                yaw = float((yaws[row] + np.pi) % (2 * np.pi) - np.pi)
                return Look(look.beam, look.reasons, look.target, places[row], yaw)
        return look

    def waypoints(self, looks: Sequence[Look]) -> FloatArray:
        """Fly to each place, and stay there: (N, 5)."""
        rows: list[tuple[float, ...]] = []
        here = self.start
        for look in looks:
            assert look.place is not None
            for place in self._way(here, look.place):
                travel_s = float(np.linalg.norm(place - here)) / self._config.speed
                rows.append((*place, look.yaw, max(travel_s, _LEAST_S)))
                here = place
            rows.append((*look.place, look.yaw, self._config.stay_s))
        return np.array(rows, dtype=np.float64).reshape(-1, 5)

    def _way(self, start: FloatArray, goal: FloatArray) -> list[FloatArray]:
        """Places from one to the other, the start left out."""
        if self._is_clear(start, goal):
            return [goal]
        first, last = self._nearest_on_path(start), self._nearest_on_path(goal)
        step = 1 if first <= last else -1
        nodes = [start, *self._path[np.arange(first, last + step, step)], goal]
        way, here = [], 0
        while here < len(nodes) - 1:
            ahead = len(nodes) - 1
            # The flown path itself may be closer to a beam than is asked for; it was flown.
            while ahead > here + 1 and not self._is_clear(nodes[here], nodes[ahead]):
                ahead = here + max(1, (ahead - here) // 2)
            way.append(nodes[ahead])
            here = ahead
        return way

    def _candidates(self, target: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Places of the drone that show a target, their yaws, and the views from them."""
        high = max(self._window.x[1], 0.0)
        low = min(max(self._window.x[0], 0.0), high, _MAX_DISTANCE_M)
        depth = min(high, low + _MAX_DISTANCE_M) - low
        rows = [(yaw, low + s * depth, rise) for s in _SHARES for rise in _RISES for yaw in _YAWS]
        yaws, distances, rises = np.array(rows).T
        views = _turned(yaws, self._camera.rotation[:, 0])
        cameras = target - distances[:, None] * views
        cameras[:, 2] += rises * distances
        return cameras - _turned(yaws, self._camera.translation), yaws, views

    def _are_free(self, places: FloatArray) -> NDArray[np.bool_]:
        """Whether places keep their distance from every beam, (N,) bool."""
        beams = self._beams_near(places)
        gaps = self._distances(places, beams) - self._radii[beams]
        free: NDArray[np.bool_] = gaps.min(axis=1, initial=np.inf) >= self._config.clearance
        return free

    def _is_clear(self, start: FloatArray, goal: FloatArray) -> bool:
        """Whether a straight way keeps its distance from every beam."""
        if np.linalg.norm(goal - start) > _FURTHEST_M:
            return False
        return bool(self._are_free(_between(start, goal, _STEP_M)).all())

    def _sees(self, place: FloatArray, look: Look) -> bool:
        """Whether no beam stands before the target, but those that end in it."""
        sight = _between(place, look.target, _STEP_M / 4)
        beams = self._beams_near(sight)
        distances, radii = self._distances(sight, beams), self._radii[beams]
        at_target = distances[-1] <= 3 * radii
        return not ((distances <= radii) & ~at_target).any()

    def _joins_path(self, place: FloatArray) -> bool:
        """Whether a clear line leads there from the path that was flown."""
        nearest = self._path[self._nearest_on_path(place)]
        return self._is_clear(place, nearest)

    def _nearest_on_path(self, place: FloatArray) -> int:
        """Row of the path from which a place is reached: the nearest with a clear line."""
        order = np.argsort(np.linalg.norm(self._path - place, axis=1), kind="stable")
        clear = (row for row in order[:_MOST_JOINED] if self._is_clear(place, self._path[row]))
        return int(next(clear, order[0]))

    def _beams_near(self, points: FloatArray) -> NDArray[np.int64]:
        """Beams that may be closer to one of the points than the drone may come."""
        middle = points.mean(axis=0)
        extent = float(np.linalg.norm(points - middle, axis=1).max())
        away = np.linalg.norm(self._middles - middle, axis=1)
        return np.flatnonzero(away <= extent + self._reaches + self._config.clearance)

    def _distances(self, points: FloatArray, beams: NDArray[np.int64]) -> FloatArray:
        """Distance of every point from the axes of some beams, (N, beams) metres."""
        starts = self._ends[beams, 0]
        spans = self._ends[beams, 1] - starts
        from_start = points[:, None] - starts
        squares = np.maximum((spans**2).sum(axis=1), 1e-12)
        share = np.clip(np.einsum("ijk,jk->ij", from_start, spans) / squares, 0.0, 1.0)
        across = from_start - share[..., None] * spans
        distances: FloatArray = np.sqrt(np.einsum("ijk,ijk->ij", across, across))
        return distances


def _in_order(looks: list[Look], start: FloatArray) -> list[Look]:
    """Order places so that the next is always the nearest."""
    order, here, left = [], start, list(looks)
    while left:
        places = np.array([look.place for look in left])
        nearest = left.pop(int(np.argmin(np.linalg.norm(places - here, axis=1))))
        assert nearest.place is not None
        order.append(nearest)
        here = nearest.place
    return order


def _spaced(path: FloatArray) -> FloatArray:
    """Points of a path that are about equally far apart; the origin where there is no path."""
    if not len(path):
        return np.zeros((1, 3))
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    marks = np.floor(np.concatenate([[0.0], np.cumsum(steps)]) / _PATH_STEP_M)
    spaced: FloatArray = path[np.concatenate([[True], np.diff(marks) > 0])]
    return spaced


def _between(start: FloatArray, goal: FloatArray, step: float) -> FloatArray:
    """Points from start to goal, both with it, at most a step apart."""
    count = int(np.ceil(np.linalg.norm(goal - start) / step)) + 1
    points: FloatArray = start + np.linspace(0.0, 1.0, max(count, 2))[:, None] * (goal - start)
    return points


def _turned(yaws: FloatArray, vector: FloatArray) -> FloatArray:
    """Give a vector of the level drone in the world, for each yaw: (N, 3)."""
    x, y, z = vector
    cos, sin = np.cos(yaws), np.sin(yaws)
    return np.stack([cos * x - sin * y, sin * x + cos * y, np.full_like(cos, z)], axis=1)
