"""Kernels that hold one segment against all known ones.

A known segment is a row of `arrays.SegmentArrays`: anchor, direction, the two ends,
`t_min`, `t_max`, radius.
"""

from __future__ import annotations

import numpy as np

from beamseg_batch.accelerate import kernel
from beamseg_batch.geometry import FloatArray

__all__ = ["axes_to_ends", "blend_axes", "closest_approaches", "end_to_axis", "ends_to_axes"]

_NO_LENGTH_M = 1e-9


@kernel
def _squared_distance(
    x: float, y: float, z: float, anchor: FloatArray, direction: FloatArray
) -> float:
    """Squared distance of a point from a line."""
    x, y, z = x - anchor[0], y - anchor[1], z - anchor[2]
    t = x * direction[0] + y * direction[1] + z * direction[2]
    x, y, z = x - t * direction[0], y - t * direction[1], z - t * direction[2]
    return x * x + y * y + z * z


@kernel
def ends_to_axes(rows: FloatArray, end_1: FloatArray, end_2: FloatArray) -> FloatArray:
    """Distance of the further of two ends from each known axis.

    Parameters
    ----------
    rows : (N, 15) float64, metres
    end_1, end_2 : (3,) float64, metres

    Returns
    -------
    (N,) float64, metres
    """
    furthest = np.empty(len(rows))
    for k in range(len(rows)):
        anchor, direction = rows[k, 0:3], rows[k, 3:6]
        first = _squared_distance(end_1[0], end_1[1], end_1[2], anchor, direction)
        second = _squared_distance(end_2[0], end_2[1], end_2[2], anchor, direction)
        furthest[k] = np.sqrt(max(first, second))
    return furthest


@kernel
def axes_to_ends(rows: FloatArray, anchor: FloatArray, direction: FloatArray) -> FloatArray:
    """Distance of the further end of each known segment from one axis.

    Parameters
    ----------
    rows : (N, 15) float64, metres
    anchor : (3,) float64, metres
    direction : (3,) float64, unit vector

    Returns
    -------
    (N,) float64, metres
    """
    furthest = np.empty(len(rows))
    for k in range(len(rows)):
        first = _squared_distance(rows[k, 6], rows[k, 7], rows[k, 8], anchor, direction)
        second = _squared_distance(rows[k, 9], rows[k, 10], rows[k, 11], anchor, direction)
        furthest[k] = np.sqrt(max(first, second))
    return furthest


@kernel
def closest_approaches(
    rows: FloatArray, anchor: FloatArray, direction: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Closest approach of one line to each known axis.

    Parameters
    ----------
    rows : (N, 15) float64, metres
    anchor : (3,) float64, metres
    direction : (3,) float64, unit vector

    Returns
    -------
    t_1, t_2 : (N,) float64, metres
        Where on the one line and on each known axis; NaN for parallel lines.
    distance : (N,) float64, metres
        Between the lines; NaN for parallel lines.
    sine : (N,) float64
        Length of the cross product of the directions.

    Notes
    -----
    Solves ``[b1, -b2, n/|n|] (t1, t2, d) = a2 - a1`` with ``n = b1 x b2`` by its inverse:
    ``t1 = ((a2 - a1) x b2) . n / |n|^2``, and likewise ``t2`` and ``d`` (report,
    section 3.2.7).
    """
    count = len(rows)
    t_1, t_2 = np.full(count, np.nan), np.full(count, np.nan)
    distance, sine = np.full(count, np.nan), np.zeros(count)
    bx, by, bz = direction[0], direction[1], direction[2]
    for k in range(count):
        cx, cy, cz = rows[k, 3], rows[k, 4], rows[k, 5]
        nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
        squared = nx * nx + ny * ny + nz * nz
        sine[k] = np.sqrt(squared)
        if squared == 0.0:
            continue
        dx, dy, dz = rows[k, 0] - anchor[0], rows[k, 1] - anchor[1], rows[k, 2] - anchor[2]
        t_1[k] = (
            (dy * cz - dz * cy) * nx + (dz * cx - dx * cz) * ny + (dx * cy - dy * cx) * nz
        ) / squared
        t_2[k] = (
            (dy * bz - dz * by) * nx + (dz * bx - dx * bz) * ny + (dx * by - dy * bx) * nz
        ) / squared
        distance[k] = abs(dx * nx + dy * ny + dz * nz) / sine[k]
    return t_1, t_2, distance, sine


@kernel
def end_to_axis(
    end_1: FloatArray, end_2: FloatArray, anchor: FloatArray, direction: FloatArray
) -> float:
    """Distance of the further of two ends from one axis.

    Parameters
    ----------
    end_1, end_2, anchor : (3,) float64, metres
    direction : (3,) float64, unit vector

    Returns
    -------
    float, metres
    """
    first = _squared_distance(end_1[0], end_1[1], end_1[2], anchor, direction)
    second = _squared_distance(end_2[0], end_2[1], end_2[2], anchor, direction)
    return float(np.sqrt(max(first, second)))


@kernel
def _along(point: FloatArray, anchor: FloatArray, direction: FloatArray) -> float:
    """Parameter of the foot of a point on a line."""
    x, y, z = point[0] - anchor[0], point[1] - anchor[1], point[2] - anchor[2]
    return float(x * direction[0] + y * direction[1] + z * direction[2])


@kernel
def blend_axes(
    anchor: FloatArray,
    direction: FloatArray,
    known_1: FloatArray,
    known_2: FloatArray,
    new_1: FloatArray,
    new_2: FloatArray,
    share: float,
) -> tuple[bool, FloatArray, FloatArray, float, float]:
    """Axis between a known and a new segment, and the extent of both along it.

    Parameters
    ----------
    anchor : (3,) float64, metres
    direction : (3,) float64, unit vector
        Axis of the known segment.
    known_1, known_2, new_1, new_2 : (3,) float64, metres
        The ends of both.
    share : float
        0 keeps the known axis, 1 takes the line through the new ends.

    Returns
    -------
    overlaps : bool
        Whether the two overlap along the new axis.
    anchor, direction : (3,) float64, metres and unit vector
        On the same side as the known direction.
    t_min, t_max : float, metres
        Outermost of the four ends along the new axis.

    Notes
    -----
    The formulas of the report's fusion, see `fusion.fuse`.
    """
    foot_1, foot_2 = _along(new_1, anchor, direction), _along(new_2, anchor, direction)
    blended, chord = np.empty(3), np.empty(3)
    for axis in range(3):
        start = anchor[axis] + foot_1 * direction[axis]
        stop = anchor[axis] + foot_2 * direction[axis]
        blended[axis] = start + share * (new_1[axis] - start)
        chord[axis] = stop + share * (new_2[axis] - stop) - blended[axis]
    length = np.sqrt(chord[0] ** 2 + chord[1] ** 2 + chord[2] ** 2)
    side = chord[0] * direction[0] + chord[1] * direction[1] + chord[2] * direction[2]
    for axis in range(3):
        # A new segment across the known axis has one foot only, and no say in the direction.
        if length <= _NO_LENGTH_M:
            chord[axis] = direction[axis]
        else:
            chord[axis] /= length if side >= 0.0 else -length
    known_a, known_b = _along(known_1, blended, chord), _along(known_2, blended, chord)
    new_a, new_b = _along(new_1, blended, chord), _along(new_2, blended, chord)
    known_low, known_high = min(known_a, known_b), max(known_a, known_b)
    new_low, new_high = min(new_a, new_b), max(new_a, new_b)
    overlaps = max(known_low, new_low) <= min(known_high, new_high)
    return overlaps, blended, chord, min(known_low, new_low), max(known_high, new_high)
