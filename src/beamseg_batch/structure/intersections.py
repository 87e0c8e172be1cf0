"""Where segments touch: algorithm 2 of the report (section 3.2.7)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beamseg_batch.config import IntersectionConfig
from beamseg_batch.geometry import angle_between_deg
from beamseg_batch.model import Intersection, Segment
from beamseg_batch.structure.arrays import SegmentArrays
from beamseg_batch.structure.axis_kernels import closest_approaches

__all__ = ["intersections_of"]

_TANGENTS = 4


def intersections_of(
    segments: Sequence[Segment], config: IntersectionConfig
) -> tuple[Intersection, ...]:
    """Find all pairs of segments that touch.

    Parameters
    ----------
    segments : sequence of Segment
        World frame.
    config : IntersectionConfig

    Returns
    -------
    tuple of Intersection
        Ordered by the first segment, then by the second.

    Notes
    -----
    Two segments touch when they are not parallel (``|b1 x b2|`` above `parallel_norm`),
    their axes pass within ``epsilon``, and the point lies within both their ends. The
    report leaves this epsilon open; by default it is ``r1 + r2``, at which two round
    beams begin to touch.
    """
    arrays = SegmentArrays(segments)
    bent = np.array([segment.is_bent for segment in segments], dtype=np.bool_)
    slack = config.end_slack
    found: list[Intersection] = []
    for index, segment in enumerate(segments):
        t_1, t_2, distance, sine = closest_approaches(
            arrays.rows, segment.anchor, segment.direction
        )
        for other in map(int, np.flatnonzero(bent | bent[index])):
            found_at = _where_bent(segment, segments[other], slack)
            t_1[other], t_2[other], distance[other], sine[other] = found_at
        epsilon = config.epsilon or segment.radius + arrays.radii
        # Comparisons with the NaN of parallel lines are false, as they should be.
        touches = (
            (sine > config.parallel_norm)
            & (distance <= epsilon)
            & (t_1 >= segment.t_min - slack)
            & (t_1 <= segment.t_max + slack)
            & (t_2 >= arrays.t_min - slack)
            & (t_2 <= arrays.t_max + slack)
        )
        found.extend(
            _intersection(index, other, segments, float(t_1[other]), float(t_2[other]))
            for other in map(int, np.flatnonzero(touches))
            if other > index
        )
    return tuple(found)


def _where_bent(one: Segment, two: Segment, slack: float) -> tuple[float, float, float, float]:
    """Closest approach of two axes that are bent, along the lines that touch them there."""
    t_1, t_2 = 0.5 * (one.t_min + one.t_max), 0.5 * (two.t_min + two.t_max)
    for _ in range(_TANGENTS):
        line, rows = one.tangent(t_1), SegmentArrays([two.tangent(t_2)]).rows
        approach = closest_approaches(rows, line.anchor, line.direction)
        at_1, at_2, distance, sine = (float(values[0]) for values in approach)
        if np.isnan(distance):
            break
        t_1 = min(max(at_1, one.t_min - slack), one.t_max + slack)
        t_2 = min(max(at_2, two.t_min - slack), two.t_max + slack)
    return at_1, at_2, distance, sine


def _intersection(
    first: int, second: int, segments: Sequence[Segment], t_1: float, t_2: float
) -> Intersection:
    one, two = segments[first].tangent(t_1), segments[second].tangent(t_2)
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
