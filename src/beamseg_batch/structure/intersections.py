"""Where segments touch: algorithm 2 of the report (section 3.2.7)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beamseg_batch.config import IntersectionConfig
from beamseg_batch.geometry import FloatArray, angle_between_deg
from beamseg_batch.model import Intersection, Segment
from beamseg_batch.structure.arrays import SegmentArrays

__all__ = ["closest_approach", "intersections_of"]


def closest_approach(
    anchor: FloatArray, direction: FloatArray, anchors: FloatArray, directions: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Closest approach of one line to each of many.

    Parameters
    ----------
    anchor : (3,) float64, metres
    direction : (3,) float64, unit vector
    anchors : (N, 3) float64, metres
    directions : (N, 3) float64, unit vectors

    Returns
    -------
    t_1, t_2 : (N,) float64, metres
        Where on the one line and on each other; NaN for parallel lines.
    distance : (N,) float64, metres
        Between the lines; NaN for parallel lines.

    Notes
    -----
    Solves ``[b1, -b2, n/|n|] (t1, t2, d) = a2 - a1`` with ``n = b1 x b2`` by its inverse:
    ``t1 = (a2 - a1) x b2 . n / |n|^2``, and likewise ``t2`` and ``d``.
    """
    normal = np.cross(direction, directions)
    squared = np.sum(normal * normal, axis=1)
    squared = np.where(squared > 0.0, squared, np.nan)
    between = anchors - anchor
    t_1: FloatArray = np.sum(np.cross(between, directions) * normal, axis=1) / squared
    t_2: FloatArray = np.sum(np.cross(between, direction) * normal, axis=1) / squared
    distance: FloatArray = np.abs(np.sum(between * normal, axis=1)) / np.sqrt(squared)
    return t_1, t_2, distance


def intersections_of(
    index: int,
    segments: Sequence[Segment],
    arrays: SegmentArrays,
    config: IntersectionConfig,
) -> list[Intersection]:
    """Find all segments that one segment touches.

    Parameters
    ----------
    index : int
        Of the segment, in `segments`.
    segments : sequence of Segment
        World frame.
    arrays : SegmentArrays
        The same segments, stacked.
    config : IntersectionConfig

    Returns
    -------
    list of Intersection
        By the index of the other segment.

    Notes
    -----
    Two segments touch when they are not parallel (``|b1 x b2|`` above `parallel_norm`),
    their axes pass within ``epsilon``, and the point lies within both their ends. The
    report leaves this epsilon open; by default it is ``r1 + r2``, at which two round
    beams begin to touch.
    """
    segment = segments[index]
    t_1, t_2, distance = closest_approach(
        segment.anchor, segment.direction, arrays.anchors, arrays.directions
    )
    sine = np.linalg.norm(np.cross(segment.direction, arrays.directions), axis=1)
    epsilon = config.epsilon or segment.radius + arrays.radii
    slack = config.end_slack
    # Comparisons with the NaN of parallel lines are false, as they should be.
    touches = (
        (sine > config.parallel_norm)
        & (distance <= epsilon)
        & (t_1 >= segment.t_min - slack)
        & (t_1 <= segment.t_max + slack)
        & (t_2 >= arrays.t_min - slack)
        & (t_2 <= arrays.t_max + slack)
    )
    touches[index] = False
    return [
        _intersection(index, other, segments, float(t_1[other]), float(t_2[other]))
        for other in map(int, np.flatnonzero(touches))
    ]


def _intersection(
    index: int, other: int, segments: Sequence[Segment], t_index: float, t_other: float
) -> Intersection:
    (first, t_1), (second, t_2) = sorted([(index, t_index), (other, t_other)])
    one, two = segments[first], segments[second]
    point_1, point_2 = one.anchor + t_1 * one.direction, two.anchor + t_2 * two.direction
    return Intersection(
        segment_1=first,
        segment_2=second,
        t_1=t_1,
        t_2=t_2,
        position=0.5 * (point_1 + point_2),
        distance=float(np.linalg.norm(point_1 - point_2)),
        angle_deg=angle_between_deg(one.direction, two.direction),
    )
