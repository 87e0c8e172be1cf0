"""Which claimed line is which true one: pure functions on arrays.

A *member* is a line that is known, a *segment* one that is claimed. Lengths are metres.
The rules are those of the goals: see ``docs/evaluation.md``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.geometry import FloatArray, connected

__all__ = [
    "MAX_ANGLE_DEG",
    "MAX_OFFSET_M",
    "MIN_SHARE",
    "NEARER_M",
    "Lines",
    "PairMeasures",
    "assign",
    "assignment_cost",
    "candidates",
    "pair_measures",
]

MAX_OFFSET_M = 0.15
"""Largest mean distance over the overlap at which a segment may be a member."""
MAX_ANGLE_DEG = 15.0
"""Largest angle between the two."""
MIN_SHARE = 0.3
"""Least overlap, as a share of the shorter of the two."""
NEARER_M = 0.05
"""By this much nearer, another member rules out this one."""

_POINT_M = 1e-7  # a stretch so short that its middle stands for all of it


@dataclass(frozen=True, eq=False)
class Lines:
    """Straight axes with two ends.

    Attributes
    ----------
    starts : (N, 3) float64, metres
    directions : (N, 3) float64, unit vectors
    lengths : (N,) float64, metres
        The other end is ``start + length * direction``.
    """

    starts: FloatArray
    directions: FloatArray
    lengths: FloatArray

    @classmethod
    def between(cls, starts: FloatArray, ends: FloatArray) -> Lines:
        """Build the lines from their ends, (N, 3) each, which must differ."""
        spans = ends - starts
        lengths = np.linalg.norm(spans, axis=1)
        return cls(starts, spans / lengths[:, None], lengths)

    def __len__(self) -> int:
        return len(self.starts)

    @property
    def ends(self) -> FloatArray:
        """(N, 3) float64, metres: the other ends."""
        return self.at(self.lengths)

    @property
    def whole(self) -> FloatArray:
        """(N, 2) float64, metres: where each line begins and ends along itself."""
        return np.stack([np.zeros_like(self.lengths), self.lengths], axis=1)

    def at(self, t: FloatArray) -> FloatArray:
        """Points of the lines, (N, 3), at one parameter each, (N,) metres."""
        points: FloatArray = self.starts + t[:, None] * self.directions
        return points


@dataclass(frozen=True, eq=False)
class PairMeasures:
    """How every segment lies to every member, each (M, S) float64.

    Attributes
    ----------
    offset : metres
        Mean distance of the segment from the member's axis over the overlap; infinite
        where they do not overlap.
    mid_offset : metres
        That distance in the middle of the overlap.
    angle_deg : degrees, 0 to 90
    overlap : metres
        Length, along the member, of the part of its span beside which the segment lies.
    share : 0 to 1
        The overlap relative to the shorter of span and segment.
    coverage : 0 to 1
        The overlap relative to the span.
    """

    offset: FloatArray
    mid_offset: FloatArray
    angle_deg: FloatArray
    overlap: FloatArray
    share: FloatArray
    coverage: FloatArray


def pair_measures(members: Lines, spans: FloatArray, segments: Lines) -> PairMeasures:
    """Measure every segment against every member.

    Parameters
    ----------
    members : Lines
        M of them.
    spans : (M, 2) float64, metres
        The part of each member that counts, from and to, along the member.
    segments : Lines
        S of them.

    Returns
    -------
    PairMeasures
    """
    rows = [
        _measure_row(members.starts[i], members.directions[i], spans[i], segments)
        for i in range(len(members))
    ]
    stacked = np.array(rows, dtype=np.float64).reshape(len(members), 6, len(segments))
    return PairMeasures(*(stacked[:, k] for k in range(6)))


def _measure_row(
    start: FloatArray, direction: FloatArray, span: FloatArray, segments: Lines
) -> tuple[FloatArray, ...]:
    """Measure all segments against one member: the attributes of `PairMeasures`, (S,) each."""
    cosine = segments.directions @ direction
    t_start = (segments.starts - start) @ direction
    t_end = t_start + segments.lengths * cosine
    low = np.maximum(np.minimum(t_start, t_end), span[0])
    high = np.minimum(np.maximum(t_start, t_end), span[1])
    beside = high >= low

    first, middle, last = (
        _across(start, direction, t, t_start, cosine, segments)
        for t in (low, (low + high) / 2, high)
    )
    sine = np.linalg.norm(np.cross(segments.directions, direction), axis=1)
    overlap = np.where(beside, high - low, 0.0)
    width = span[1] - span[0]
    return (
        np.where(beside, _mean_distance(first, last), np.inf),
        np.where(beside, np.linalg.norm(middle, axis=1), np.inf),
        np.degrees(np.arctan2(sine, np.abs(cosine))),
        overlap,
        _ratio(overlap, np.minimum(width, segments.lengths), beside),
        _ratio(overlap, np.full_like(overlap, width), beside),
    )


def _across(
    start: FloatArray,
    direction: FloatArray,
    t: FloatArray,
    t_start: FloatArray,
    cosine: FloatArray,
    segments: Lines,
) -> FloatArray:
    """Vectors, (S, 3), from the member's axis at `t` to the segments, square to the axis."""
    # A segment square to the member has no overlap to speak of: its start stands for it.
    level = np.abs(cosine) < 1e-9
    along = np.where(level, 0.0, (t - t_start) / np.where(level, 1.0, cosine))
    points = segments.at(np.clip(along, 0.0, segments.lengths)) - start
    return points - np.outer(points @ direction, direction)


def _mean_distance(first: FloatArray, last: FloatArray) -> FloatArray:
    """Mean distance from the origin of the points between `first` and `last`, (S, 3) each.

    Notes
    -----
    With `h` the distance of the straight line and `x` along it from its foot, the integral
    of ``sqrt(h² + x²)`` is ``(x sqrt(h² + x²) + h² asinh(x / h)) / 2``.
    """
    span = last - first
    length = np.linalg.norm(span, axis=1)
    short = length < _POINT_M
    unit = span / np.where(short, 1.0, length)[:, None]
    x_1, x_2 = np.sum(first * unit, axis=1), np.sum(last * unit, axis=1)
    h = np.linalg.norm(first - x_1[:, None] * unit, axis=1)
    h_or_one = np.where(h > 0.0, h, 1.0)

    def integral(x: FloatArray) -> FloatArray:
        result: FloatArray = (x * np.hypot(h, x) + h**2 * np.arcsinh(x / h_or_one)) / 2.0
        return result

    mean = (integral(x_2) - integral(x_1)) / np.where(short, 1.0, length)
    result: FloatArray = np.where(short, np.linalg.norm((first + last) / 2.0, axis=1), mean)
    return result


def _ratio(part: FloatArray, whole: FloatArray, beside: NDArray[np.bool_]) -> FloatArray:
    """Share of the whole, at most 1; a whole without length is all there or not at all."""
    point = whole < _POINT_M
    share = np.minimum(part / np.where(point, 1.0, whole), 1.0)
    return np.where(point, beside.astype(np.float64), share)


def candidates(measures: PairMeasures) -> NDArray[np.bool_]:
    """Which segments may be which members.

    Parameters
    ----------
    measures : PairMeasures

    Returns
    -------
    (M, S) bool
        Near, parallel and side by side enough, and no other member for which that holds
        more than `NEARER_M` nearer.
    """
    near = (
        (measures.offset <= MAX_OFFSET_M)
        & (measures.angle_deg <= MAX_ANGLE_DEG)
        & (measures.share >= MIN_SHARE)
    )
    offsets = np.where(near, measures.offset, np.inf)
    nearest = offsets.min(axis=0, initial=np.inf)
    allowed: NDArray[np.bool_] = near & (measures.offset <= nearest + NEARER_M)
    return allowed


def assignment_cost(measures: PairMeasures) -> FloatArray:
    """What a pair costs in the assignment, (M, S) metres.

    Notes
    -----
    The offset, and `NEARER_M` for a member that is not covered at all: of two pieces of a
    member the long one is the match, unless the short one is nearer by centimetres.
    """
    cost: FloatArray = measures.offset + NEARER_M * (1.0 - measures.coverage)
    return cost


def assign(cost: FloatArray, allowed: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Pair rows with columns one to one: as many as possible, then at the least cost.

    Parameters
    ----------
    cost : (M, N) float64
        Not negative, and finite where a pair is allowed.
    allowed : (M, N) bool

    Returns
    -------
    (K, 2) int64
        Rows and columns of the pairs, by row.
    """
    n_rows, n_columns = cost.shape
    rows_allowed, columns_allowed = np.nonzero(allowed)
    links = np.stack([rows_allowed, columns_allowed + n_rows], axis=1)
    labels = connected(n_rows + n_columns, links)
    pairs = [np.empty((0, 2), dtype=np.int64)]
    for label in np.unique(labels[links[:, 0]]):
        rows = np.flatnonzero(labels[:n_rows] == label)
        columns = np.flatnonzero(labels[n_rows:] == label)
        part = np.ix_(rows, columns)
        pairs.append(_assign_part(cost[part], allowed[part], rows, columns))
    found = np.concatenate(pairs)
    return found[np.argsort(found[:, 0])]


def _assign_part(
    cost: FloatArray,
    allowed: NDArray[np.bool_],
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Assign one connected part; a pair that is not allowed costs more than all others do."""
    barred = 1.0 + 2.0 * min(cost.shape) * cost[allowed].max(initial=0.0)
    full = np.where(allowed, cost, barred)
    if len(rows) <= len(columns):
        row, column = np.arange(len(rows)), _columns_of_rows(full)
    else:
        row, column = _columns_of_rows(full.T), np.arange(len(columns))
    kept = allowed[row, column]
    return np.stack([rows[row[kept]], columns[column[kept]]], axis=1)


def _columns_of_rows(cost: FloatArray) -> NDArray[np.int64]:
    """Column of each row at the least total cost; no more rows than columns.

    Notes
    -----
    Shortest augmenting paths with potentials: Jonker and Volgenant, Computing 38 (1987),
    325-340, without their initialisation. A row at a time looks for the path, over reduced
    costs, that ends in a free column; the potentials keep those costs non-negative.
    """
    n_rows, n_columns = cost.shape
    row_potential, column_potential = np.zeros(n_rows), np.zeros(n_columns)
    row_of = np.full(n_columns, -1, dtype=np.int64)
    for start in range(n_rows):
        distance = np.full(n_columns, np.inf)
        previous = np.full(n_columns, -1, dtype=np.int64)
        done = np.zeros(n_columns, dtype=bool)
        row, column, reached = start, -1, 0.0
        while row >= 0:
            through = reached + cost[row] - row_potential[row] - column_potential
            better = ~done & (through < distance)
            distance[better], previous[better] = through[better], column
            column = int(np.argmin(np.where(done, np.inf, distance)))
            done[column], reached = True, distance[column]
            row = row_of[column]
        passed = done & (row_of >= 0)
        row_potential[start] += reached
        row_potential[row_of[passed]] += reached - distance[passed]
        column_potential[done] -= reached - distance[done]
        while column >= 0:
            before = previous[column]
            row_of[column] = start if before < 0 else row_of[before]
            column = before
    columns = np.empty(n_rows, dtype=np.int64)
    used = row_of >= 0
    columns[row_of[used]] = np.flatnonzero(used)
    return columns
