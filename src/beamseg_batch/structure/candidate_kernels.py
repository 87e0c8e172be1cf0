"""Kernels that find the candidate that a sighting belongs to, and take it in."""

from __future__ import annotations

import numpy as np

from beamseg_batch.accelerate import kernel
from beamseg_batch.geometry import FloatArray
from beamseg_batch.principal_kernels import principal_axis

__all__ = ["STATE_SIZE", "grow", "nearest_candidate"]

STATE_SIZE = 19
"""What a candidate knows: weight, sum of points, sum of products, direction, and both ends."""


@kernel
def nearest_candidate(
    rows: FloatArray,
    end_1: FloatArray,
    end_2: FloatArray,
    radius: float,
    most_offset: float,
    least_cosine: float,
    bridge: float,
) -> int:
    """Find the candidate whose axis passes nearest to both ends of a sighting.

    Parameters
    ----------
    rows : (G, 9) float64
        Of each candidate: anchor, direction, both ends along it, radius.
    end_1, end_2 : (3,) float64, metres
    radius : float, metres
        Candidates of another are not asked.
    most_offset : float, metres
        How far either end may be from the axis.
    least_cosine : float
        Of the angle between them.
    bridge : float, metres
        Longest gap along the axis.

    Returns
    -------
    int
        -1 if none is near enough.
    """
    length = np.sqrt(np.sum((end_2 - end_1) ** 2))
    nearest, found = most_offset, -1
    for g in range(len(rows)):
        if rows[g, 8] != radius:
            continue
        furthest, low, high, cosine = 0.0, np.inf, -np.inf, 0.0
        for which in range(2):
            end = end_2 if which else end_1
            along, squared = 0.0, 0.0
            for axis in range(3):
                apart = end[axis] - rows[g, axis]
                along += apart * rows[g, 3 + axis]
                squared += apart * apart
            furthest = max(furthest, squared - along * along)
            low, high = min(low, along), max(high, along)
            cosine += (2 * which - 1) * along
        if (
            furthest < nearest * nearest
            and abs(cosine) > least_cosine * length
            and low < rows[g, 7] + bridge
            and high > rows[g, 6] - bridge
        ):
            nearest, found = np.sqrt(max(furthest, 0.0)), g
    return found


@kernel
def grow(
    state: FloatArray,
    row: FloatArray,
    anchor: FloatArray,
    direction: FloatArray,
    t_min: float,
    t_max: float,
    weight: float,
) -> None:
    """Take a sighting into a candidate.

    Its axis is the first principal one of the ends and middles of all sightings.

    Parameters
    ----------
    state : (19,) float64
        Of the candidate; weight 0 before the first. Changed.
    row : (9,) float64
        As of `nearest_candidate`. Changed, but for the radius.
    anchor, direction : (3,) float64, metres and unit vector
        Axis of the sighting.
    t_min, t_max : float, metres
        Its ends along it.
    weight : float
        Of each of its three points.
    """
    is_first = state[0] == 0.0
    points = np.empty((5, 3))
    for axis in range(3):
        points[0, axis] = anchor[axis] + t_min * direction[axis]
        points[1, axis] = anchor[axis] + 0.5 * (t_min + t_max) * direction[axis]
        points[2, axis] = anchor[axis] + t_max * direction[axis]
        if is_first:
            state[10 + axis] = direction[axis]
            state[13 + axis], state[16 + axis] = points[0, axis], points[2, axis]
        points[3, axis], points[4, axis] = state[13 + axis], state[16 + axis]
    state[0] += 3.0 * weight
    place = 4
    scatter = np.empty((3, 3))
    for first in range(3):
        state[1 + first] += weight * (points[0, first] + points[1, first] + points[2, first])
        row[first] = state[1 + first] / state[0]
    for first in range(3):
        for second in range(first + 1):
            for k in range(3):
                state[place] += weight * points[k, first] * points[k, second]
            spread = state[place] / state[0] - row[first] * row[second]
            scatter[first, second], scatter[second, first] = spread, spread
            place += 1
    axis_now, _ = principal_axis(scatter)
    side = 0.0
    for axis in range(3):
        side += axis_now[axis] * state[10 + axis]
    for axis in range(3):
        state[10 + axis] = row[3 + axis] = axis_now[axis] if side > 0.0 else -axis_now[axis]
    row[6], row[7] = np.inf, -np.inf
    for k in range(5):
        along = 0.0
        for axis in range(3):
            along += (points[k, axis] - row[axis]) * row[3 + axis]
        row[6], row[7] = min(row[6], along), max(row[7], along)
    for axis in range(3):
        state[13 + axis] = row[axis] + row[6] * row[3 + axis]
        state[16 + axis] = row[axis] + row[7] * row[3 + axis]
