"""Which lines are segments (report, section 3.2.4): four criteria, each with its name."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.config import ScreeningConfig
from beamseg_batch.detection.screening_kernels import longest_stretch, measure_line
from beamseg_batch.errors import ShapeError
from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import Segment

__all__ = [
    "REJECTION_REASONS",
    "Rejection",
    "longest_run",
    "min_number_of_points",
    "screen",
    "segment_from_points",
]

Reason = Literal["too_few_points", "wrong_radius", "gap", "low_pca_coeff", "below_floor"]

REJECTION_REASONS: tuple[Reason, ...] = ("too_few_points", "wrong_radius", "gap", "low_pca_coeff")
"""The criteria, in the order in which they are asked; the detector adds the floor."""


_HALF_ROUND = ((1.0, math.inf), (0.2, 0.4), (0.025, 0.2))
"""Variances of a visible half cylinder, in squared radii: along it, by its width, by its depth."""
_NO_LENGTH_M = 1e-9  # copies of one point have no direction


@dataclass(frozen=True)
class Rejection:
    """A line that is not a segment: falsy, so that ``if segment:`` reads as it should.

    Attributes
    ----------
    reason : str
        One of `REJECTION_REASONS`, or ``below_floor``.
    value, limit : float
        What was found and what was needed, in the unit of the reason.
    make_segment : callable or None
        Makes what the line would have been; None where its points have no direction.
    t : (N,) float64, metres, or None
        Where the points that were judged lie along it; None for all of its points.
    """

    reason: Reason
    value: float = field(default=math.nan, compare=False)
    limit: float = field(default=math.nan, compare=False)
    make_segment: Callable[[], Segment] | None = field(default=None, compare=False)
    t: FloatArray | None = field(default=None, compare=False)

    def __bool__(self) -> bool:
        return False

    @property
    def segment(self) -> Segment | None:
        """What the line would have been, or None."""
        return self.make_segment() if self.make_segment else None


class _Line(NamedTuple):
    """What `measure_line` finds of some points; see there."""

    anchor: FloatArray
    direction: FloatArray
    scatter: FloatArray
    t: FloatArray
    t_min: float
    t_max: float
    furthest: float

    def pca_coeff(self) -> float:
        total = float(self.scatter[0] + self.scatter[1] + self.scatter[2])
        return float(self.scatter[0]) / total if total > 0.0 else 0.0

    def segment(self, points: FloatArray, radius: float) -> Segment:
        return Segment(
            anchor=self.anchor,
            direction=self.direction,
            t_min=self.t_min,
            t_max=self.t_max,
            radius=radius,
            n_points=len(points),
            pca_coeff=self.pca_coeff(),
            pca_eig=self.scatter / (len(points) - 1),
            points=points,
        )


def screen(
    points: FloatArray,
    direction: FloatArray,
    radius: float,
    leaf_size: float,
    minvotes: int,
    config: ScreeningConfig,
) -> Segment | Rejection:
    """Make a segment of the points of a line, or say why they are none.

    Parameters
    ----------
    points : (N, 3) float64, metres
        The points that the search collected for the line.
    direction : (3,) float64, unit vector
        The line's direction; the segment's points the same way.
    radius : float, metres
        Expected radius.
    leaf_size : float, metres
        Edge of a voxel.
    minvotes : int
        Fewest points of a line; what is left of a line after a cut must still have them.
    config : ScreeningConfig

    Returns
    -------
    Segment or Rejection

    Notes
    -----
    With ``gap: longest_run`` the line is cut at its gaps first and the criteria judge
    what is kept: a line often runs on through the points of another beam.
    """
    diag_voxel = math.sqrt(3.0) * leaf_size
    max_gap = config.max_gap_factor * diag_voxel
    line = _fitted(points, direction)
    run = longest_run(line.t, max_gap)
    has_gap = len(run) < len(points)
    if has_gap and config.gap == "longest_run":
        whole, points, has_gap = partial(line.segment, points, radius), points[run], False
        if len(points) < minvotes:
            return Rejection("too_few_points", len(points), minvotes, whole, line.t[run])
        line = _fitted(points, direction)
    length = line.t_max - line.t_min
    if length < _NO_LENGTH_M:
        return Rejection("too_few_points", 1, minvotes)
    segment = partial(line.segment, points, radius)
    needed = config.min_points_factor * min_number_of_points(length, radius, leaf_size)
    if len(points) < needed:
        return Rejection("too_few_points", len(points), needed, segment)
    tolerance, off = config.radius_tolerance_factor * diag_voxel, abs(line.furthest - radius)
    if off >= tolerance:
        return Rejection("wrong_radius", off, tolerance, segment)
    if has_gap:
        return Rejection("gap", float(np.diff(np.sort(line.t)).max()), max_gap, segment)
    pca_coeff = line.pca_coeff()
    found = segment()
    if pca_coeff < config.min_pca_coeff and not (
        config.half_round != "none" and _is_half_round(found)
    ):
        return Rejection("low_pca_coeff", pca_coeff, config.min_pca_coeff, segment)
    return found


def _is_half_round(segment: Segment) -> bool:
    """Whether points spread as those on the visible half of a cylinder of the segment's radius.

    By its width that is a variance of ``r**2 / 3``, and by its depth of a few hundredths of
    ``r**2``: more than a flat face, less than a clump.
    """
    spread = segment.pca_eig / segment.radius**2
    return all(low <= part <= high for part, (low, high) in zip(spread, _HALF_ROUND, strict=True))


def segment_from_points(points: FloatArray, direction: FloatArray, radius: float) -> Segment:
    """Fit a segment to points by principal component analysis.

    Parameters
    ----------
    points : (N, 3) float64, metres
        At least two, not all the same.
    direction : (3,) float64
        Which of the two ways along the axis is forward.
    radius : float, metres

    Returns
    -------
    Segment
        Axis through the mean along the first principal component; the ends are the
        outermost points, projected onto it.

    Raises
    ------
    ShapeError
        If there are fewer than two points.

    Notes
    -----
    ``pca_coeff = eig[0] / (eig[0] + eig[1] + eig[2])``, report, section 3.2.4.
    """
    return _fitted(points, direction).segment(points, radius)


def _fitted(points: FloatArray, direction: FloatArray) -> _Line:
    """Line through the points."""
    if len(points) < 2:
        raise ShapeError(f"a segment needs at least 2 points, not {len(points)}")
    return _Line(*measure_line(points, direction))


def longest_run(t: FloatArray, max_gap: float) -> NDArray[np.int64]:
    """Find the longest stretch along an axis without a gap.

    Parameters
    ----------
    t : (N,) float64, metres
        Positions along the axis, in any order.
    max_gap : float, metres
        Neighbours further apart than this are a gap.

    Returns
    -------
    (M,) int64
        Indices into `t` of the run that spans the most metres, ascending. The first of
        equals.
    """
    order = np.argsort(t, kind="stable")
    start, stop = longest_stretch(t[order], max_gap)
    return np.sort(order[start:stop]) if stop - start < len(t) else np.arange(len(t))


def min_number_of_points(length: float, radius: float, leaf_size: float) -> float:
    """Smallest number of points of a segment.

    Parameters
    ----------
    length, radius, leaf_size : float, metres

    Returns
    -------
    float
        ``2 * r * |e2 - e1| / (rad_2_leaf_ratio * 2 diag_voxel * 2 diag_voxel)``

    Notes
    -----
    Report, section 3.2.4. ``r / rad_2_leaf_ratio`` is the leaf size, so only the length
    and the leaf size matter; the formula is kept in the report's terms.
    """
    rad_2_leaf_ratio = radius / leaf_size
    diag_voxel = math.sqrt(3.0) * leaf_size
    return 2.0 * radius * length / (rad_2_leaf_ratio * 2.0 * diag_voxel * 2.0 * diag_voxel)
