"""A run held against another run."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.errors import RunError
from beamseg_batch.evaluation.gates import Check
from beamseg_batch.evaluation.matching import (
    assign,
    assignment_cost,
    candidates,
    pair_measures,
)
from beamseg_batch.evaluation.measures import Measure, Metrics, joint_pairs, spread
from beamseg_batch.evaluation.results import Result, Timing, load_result, read_timing
from beamseg_batch.geometry import FloatArray
from beamseg_batch.tables import TABLES

__all__ = [
    "COMPARED",
    "Comparison",
    "Move",
    "Tolerances",
    "compare",
]

TableState: TypeAlias = Literal["equal", "differs", "only in A", "only in B"]

COMPARED = (
    Measure("segments.a", "", "Segments of A"),
    Measure("segments.b", "", "Segments of B"),
    Measure("segments.vanished", "", "Segments of A that B lacks"),
    Measure("segments.appeared", "", "Segments of B that A lacks"),
    Measure("segments.moved", "", "Segments that differ by more than a tolerance"),
    Measure("offset", "m", "Mean distance between the axes of a segment over the overlap", True),
    Measure("angle_deg", "°", "Angle between them", True),
    Measure("end", "m", "Distance of an end, the further of the two", True),
    Measure("radius", "m", "Difference of the radii", True),
    Measure("intersections.a", "", "Intersections of A"),
    Measure("intersections.b", "", "Intersections of B"),
    Measure("intersections.vanished", "", "Pairs of segments that touch in A alone"),
    Measure("intersections.appeared", "", "Pairs of segments that touch in B alone"),
    Measure("joints.a", "", "Joints of A"),
    Measure("joints.b", "", "Joints of B"),
    Measure("joints.vanished", "", "Joints of A without one of B within 0.1 m"),
    Measure("joints.appeared", "", "Joints of B without one of A within 0.1 m"),
    Measure("joints.moved", "", "Joints that differ by more than the tolerance"),
    Measure("joint", "m", "Distance of a joint", True),
    Measure("tables.differing", "", "Deterministic tables that are not the same bytes"),
    Measure("time.median_ms.a", "ms", "Processing of a scan in A, median"),
    Measure("time.median_ms.b", "ms", "Processing of a scan in B, median"),
    Measure("time.median_ms.ratio", "", "B to A"),
    Measure("time.wall_s.a", "s", "The whole of A"),
    Measure("time.wall_s.b", "s", "The whole of B"),
    Measure("time.wall_s.ratio", "", "B to A"),
)
"""Every figure of a comparison, in the order in which it is told."""


@dataclass(frozen=True)
class Tolerances:
    """By how much a segment or a joint may differ: metres, degrees."""

    offset: float = 0.001
    angle_deg: float = 0.1
    end: float = 0.005
    radius: float = 0.001
    joint: float = 0.005


@dataclass(frozen=True)
class Move:
    """A segment of both runs.

    Attributes
    ----------
    a, b : int
        Indices into the segments of the runs.
    offset, end, radius : float, metres
        Mean distance of the axes, distance of the further end, difference of the radii.
    angle_deg : float, degrees
    shapes : tuple of str, or None
        Both cross-sections, if they differ.
    """

    a: int
    b: int
    offset: float
    angle_deg: float
    end: float
    radius: float
    shapes: tuple[str, str] | None

    def exceeds(self, tolerances: Tolerances) -> bool:
        """Whether any part of it is beyond its tolerance."""
        return self.shapes is not None or any(
            getattr(self, name) > getattr(tolerances, name)
            for name in ("offset", "angle_deg", "end", "radius")
        )


@dataclass(frozen=True, eq=False)
class Comparison:
    """Run A and run B.

    Attributes
    ----------
    a, b : Result
    moves : tuple of Move
        Segments of both runs, by their place in A; most of them have not moved.
    vanished, appeared : tuple of int
        Segments of A and of B.
    touching_vanished, touching_appeared : tuple of (int, int)
        Pairs of segments, as A and as B counts them.
    joints : (K, 2) int64
        Joints of both runs.
    joint_distances : (K,) float64, metres
    joints_vanished, joints_appeared : tuple of int
        Joints of A and of B.
    tables : dict of str to TableState
        The deterministic tables that one of them has.
    times : two Timing
    tolerances : Tolerances
    """

    a: Result
    b: Result
    moves: tuple[Move, ...]
    vanished: tuple[int, ...]
    appeared: tuple[int, ...]
    touching_vanished: tuple[tuple[int, int], ...]
    touching_appeared: tuple[tuple[int, int], ...]
    joints: NDArray[np.int64]
    joint_distances: FloatArray
    joints_vanished: tuple[int, ...]
    joints_appeared: tuple[int, ...]
    tables: dict[str, TableState]
    times: tuple[Timing, Timing]
    tolerances: Tolerances

    @property
    def moved(self) -> tuple[Move, ...]:
        """Segments that differ by more than a tolerance."""
        return tuple(move for move in self.moves if move.exceeds(self.tolerances))

    @cached_property
    def metrics(self) -> Metrics:
        """The figures of `COMPARED`."""
        a, b, time_a, time_b = self.a, self.b, *self.times
        return {
            "segments.a": len(a.axes),
            "segments.b": len(b.axes),
            "segments.vanished": len(self.vanished),
            "segments.appeared": len(self.appeared),
            "segments.moved": len(self.moved),
            **spread("offset", (move.offset for move in self.moves)),
            **spread("angle_deg", (move.angle_deg for move in self.moves)),
            **spread("end", (move.end for move in self.moves)),
            **spread("radius", (move.radius for move in self.moves)),
            "intersections.a": _number_of(a.touching),
            "intersections.b": _number_of(b.touching),
            "intersections.vanished": len(self.touching_vanished),
            "intersections.appeared": len(self.touching_appeared),
            "joints.a": _number_of(a.joints),
            "joints.b": _number_of(b.joints),
            "joints.vanished": len(self.joints_vanished),
            "joints.appeared": len(self.joints_appeared),
            "joints.moved": int((self.joint_distances > self.tolerances.joint).sum()),
            **spread("joint", self.joint_distances),
            "tables.differing": sum(state != "equal" for state in self.tables.values()),
            "time.median_ms.a": time_a.median_ms,
            "time.median_ms.b": time_b.median_ms,
            "time.median_ms.ratio": _times_as_long(time_a.median_ms, time_b.median_ms),
            "time.wall_s.a": time_a.wall_s,
            "time.wall_s.b": time_b.wall_s,
            "time.wall_s.ratio": _times_as_long(time_a.wall_s, time_b.wall_s),
        }

    def checks(self) -> tuple[Check, ...]:
        """Say what has to hold for two runs to be the same."""
        names = (
            "segments.vanished",
            "segments.appeared",
            "segments.moved",
            "intersections.vanished",
            "intersections.appeared",
            "joints.vanished",
            "joints.appeared",
            "joints.moved",
        )
        counts = ((name, self.metrics[name]) for name in names)
        return tuple(Check(f"{name} == 0", not count, f"is {count or 0}") for name, count in counts)


def compare(
    folder_a: Path, folder_b: Path, tolerances: Tolerances, radius: float | None = None
) -> Comparison:
    """Hold two runs against each other.

    Parameters
    ----------
    folder_a, folder_b : Path
        As `load_result` reads them.
    tolerances : Tolerances
    radius : float, optional
        Radius of all segments, metres, where a table has none.

    Returns
    -------
    Comparison

    Raises
    ------
    RunError, ConfigError
        As `load_result` does.
    """
    a, b = load_result(folder_a, radius), load_result(folder_b, radius)
    measures = pair_measures(a.axes, a.axes.whole, b.axes)
    pairs = assign(assignment_cost(measures), candidates(measures))
    moves = tuple(
        _move(a, b, int(i), int(j), float(measures.offset[i, j]), float(measures.angle_deg[i, j]))
        for i, j in pairs
    )
    vanished, appeared = _unpaired(pairs, len(a.axes), len(b.axes))
    touching_vanished, touching_appeared = _touching(a, b, pairs)
    joints_a, joints_b = _joints_of(a), _joints_of(b)
    joints, distances = joint_pairs(joints_a, joints_b)
    joints_vanished, joints_appeared = _unpaired(joints, len(joints_a), len(joints_b))
    return Comparison(
        a=a,
        b=b,
        moves=moves,
        vanished=vanished,
        appeared=appeared,
        touching_vanished=touching_vanished,
        touching_appeared=touching_appeared,
        joints=joints,
        joint_distances=distances,
        joints_vanished=joints_vanished,
        joints_appeared=joints_appeared,
        tables=_table_states(folder_a, folder_b),
        times=(read_timing(folder_a), read_timing(folder_b)),
        tolerances=tolerances,
    )


def _move(a: Result, b: Result, i: int, j: int, offset: float, angle_deg: float) -> Move:
    ends = np.array([[r.axes.starts[k], r.axes.ends[k]] for r, k in ((a, i), (b, j))])
    if a.axes.directions[i] @ b.axes.directions[j] < 0.0:
        ends[1] = ends[1, ::-1]
    shapes = None
    if a.shapes is not None and b.shapes is not None and a.shapes[i] != b.shapes[j]:
        shapes = (a.shapes[i], b.shapes[j])
    return Move(
        a=i,
        b=j,
        offset=offset,
        angle_deg=angle_deg,
        end=float(np.linalg.norm(ends[1] - ends[0], axis=1).max()),
        radius=abs(float(b.radii[j] - a.radii[i])),
        shapes=shapes,
    )


def _unpaired(
    pairs: NDArray[np.int64], n_a: int, n_b: int
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """What of A and of B is in no pair."""
    only_a = np.setdiff1d(np.arange(n_a), pairs[:, 0])
    only_b = np.setdiff1d(np.arange(n_b), pairs[:, 1])
    return tuple(only_a.tolist()), tuple(only_b.tolist())


def _touching(
    a: Result, b: Result, pairs: NDArray[np.int64]
) -> tuple[tuple[tuple[int, int], ...], tuple[tuple[int, int], ...]]:
    """Pairs of segments that touch in A alone, and in B alone."""
    in_a, in_b = _pairs_of(a), _pairs_of(b)
    b_of_a = {int(i): int(j) for i, j in pairs}
    a_of_b = {j: i for i, j in b_of_a.items()}
    gone = (pair for pair in in_a if _named_as(pair, b_of_a) not in in_b)
    new = (pair for pair in in_b if _named_as(pair, a_of_b) not in in_a)
    return tuple(sorted(gone)), tuple(sorted(new))


def _pairs_of(result: Result) -> set[tuple[int, int]]:
    if result.touching is None:
        return set()
    return {(int(one), int(other)) for one, other in result.touching}


def _named_as(pair: tuple[int, int], names: dict[int, int]) -> tuple[int, int] | None:
    """Give the same pair as the other run counts it; None if it lacks one of the two."""
    if not all(segment in names for segment in pair):
        return None
    low, high = sorted(names[segment] for segment in pair)
    return low, high


def _joints_of(result: Result) -> FloatArray:
    return np.empty((0, 3)) if result.joints is None else result.joints


def _number_of(found: NDArray[Any] | None) -> int | None:
    return None if found is None else len(found)


def _table_states(folder_a: Path, folder_b: Path) -> dict[str, TableState]:
    states: dict[str, TableState] = {}
    for table in TABLES:
        a, b = (_bytes(folder / table.file_name) for folder in (folder_a, folder_b))
        if not table.deterministic or (a is None and b is None):
            continue
        if a is None or b is None:
            states[table.file_name] = "only in B" if a is None else "only in A"
        else:
            states[table.file_name] = "equal" if a == b else "differs"
    return states


def _bytes(file: Path) -> bytes | None:
    try:
        return file.read_bytes() if file.is_file() else None
    except OSError as error:
        raise RunError(f"{file}: cannot be read: {error.strerror}") from error


def _times_as_long(a: float | None, b: float | None) -> float | None:
    return None if a is None or b is None or not a > 0.0 else b / a
