"""Kernel that collects the rays of a scan that pass near a beam, seen along its axis.

Across the axis a ray is a line in a plane: that of a direction, at a distance from the
axis. What cross-section the beam has is a question about such lines alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.accelerate import kernel
from beamseg_batch.cylinder.meeting_kernels import (
    Cylinders,
    View,
    counts_at,
    in_reach,
    pixel_box,
    ray_noise,
    room_of,
    sight,
)
from beamseg_batch.geometry import FloatArray

__all__ = ["RAY_COLUMNS", "BesideBeams", "gather_near"]

RAY_COLUMNS = 10
"""Direction across the axis (2), distance of the ray from the axis, how far behind the point
nearest to the axis it returned, noise of that, place along the axis, distance to its pixel's
outer thirds, number of the scan, a number as if drawn from 0 to 1, and how far the ray runs
along the axis for each metre across it."""

_FAR = 9.0
_NEIGHBOUR = 2.0  # radii of another beam within which a ray says nothing of this one
_BESIDE_END = 0.05


class BesideBeams(NamedTuple):
    """Which beams run near each.

    Attributes
    ----------
    at : (M + 1,) int64
        First entry of each beam.
    who : (K,) int64
    """

    at: NDArray[np.int64]
    who: NDArray[np.int64]


@kernel
def _drawn(scan: int, pixel: int) -> float:
    """Number from 0 to 1 that looks drawn at random, and is the same every time."""
    mixed = (scan * 2654435761 + pixel * 40503 + 12345) & 0xFFFFFFFF
    mixed = ((mixed ^ (mixed >> 15)) * 2246822519) & 0xFFFFFFFF
    mixed = ((mixed ^ (mixed >> 13)) * 3266489917) & 0xFFFFFFFF
    return float((mixed ^ (mixed >> 16)) >> 8) / 16777216.0


@kernel
def _is_near_another(
    wx: float, wy: float, wz: float, foot: float, reach: float,
    anchors: FloatArray, directions: FloatArray, radii: FloatArray, firsts: FloatArray,
    lasts: FloatArray, others: NDArray[np.int64],
) -> bool:  # fmt: skip
    """Whether a ray passes another beam closely, about where it passes this one."""
    for o in others:
        a, b = anchors[o], directions[o]
        near = _NEIGHBOUR * radii[o]
        ab = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
        wa = wx * a[0] + wy * a[1] + wz * a[2]
        wb = wx * b[0] + wy * b[1] + wz * b[2]
        across = max(1.0 - wb * wb, 1e-9)
        there = (wa - wb * ab) / across
        s = min(max(there * wb - ab, firsts[o] - _BESIDE_END), lasts[o] + _BESIDE_END)
        x, y, z = a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]
        there = wx * x + wy * y + wz * z
        apart = (x - there * wx) ** 2 + (y - there * wy) ** 2 + (z - there * wz) ** 2
        if apart < near * near and abs(there - foot) < reach + near:
            return True
    return False


@kernel
def gather_near(
    view: View,
    beams: Cylinders,
    reach: float,
    neighbours: BesideBeams,
    scan: int,
    most: int,
    rays: FloatArray,
    counts: NDArray[np.int64],
) -> int:
    """Collect the rays that pass near each beam, evenly along it.

    Parameters
    ----------
    view : View
    beams : Cylinders
        Asked about on the stretch that they are on.
    reach : float, metres
        How far from the axis a ray may pass.
    neighbours : BesideBeams
        Beams beside which nothing is said.
    scan : int
        Its number.
    most : int
        Rays of one beam, of which some may turn out to be of no use.
    rays : (M * most, 10) float64
        Filled, beam after beam; see `RAY_COLUMNS`. A ray without return has returned from
        infinitely far. Rays that returned before the beam are left out.
    counts : (M,) int64
        Filled: rays of each beam.

    Returns
    -------
    int
        Rays of all beams.
    """
    low, high = view.low, view.high
    window = 0.0
    for axis in range(3):
        window += max(low[axis] * low[axis], high[axis] * high[axis])
    window = np.sqrt(window)
    num_rays, width = len(view.points), view.width
    points, view_rays, room = view.points, view.rays, room_of(view)
    anchors, directions, radii = beams.anchors, beams.directions, beams.radii
    firsts, lasts = beams.firsts, beams.lasts
    total = 0
    for j in range(len(beams.anchors)):
        counts[j] = 0
        a, b, u, v = anchors[j], directions[j], beams.us[j], beams.vs[j]
        begin, end = beams.starts[j], beams.stops[j]
        if end <= begin or not in_reach(a, b, begin, end, reach, window):
            continue
        others = neighbours.who[neighbours.at[j] : neighbours.at[j + 1]]
        ab = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
        au = a[0] * u[0] + a[1] * u[1] + a[2] * u[2]
        av = a[0] * v[0] + a[1] * v[1] + a[2] * v[2]
        row_first, row_last, column_first, column_last = 0, 1, 0, num_rays
        if width > 0:
            row_first, row_last, column_first, column_last = pixel_box(
                a, b, begin, end, reach, width, num_rays // width, view.image
            )
        pixels = (row_last - row_first) * (column_last - column_first)
        step = (pixels + most - 1) // most
        first = total
        for number in range(scan % max(step, 1), pixels, max(step, 1)):
            row, column = divmod(number, column_last - column_first)
            k = (row_first + row) * width + column_first + column
            wx, wy, wz, depth = sight(points, view_rays, k)
            wu = wx * u[0] + wy * u[1] + wz * u[2]
            wv = wx * v[0] + wy * v[1] + wz * v[2]
            across = np.sqrt(wu * wu + wv * wv)
            if across < 0.1:
                continue
            du, dv = wu / across, wv / across
            beside = dv * au - du * av
            foot = (du * au + dv * av) / across
            if abs(beside) > reach or foot <= reach:
                continue
            wb = wx * b[0] + wy * b[1] + wz * b[2]
            s = foot * wb - ab
            x, y, z = foot * wx, foot * wy, foot * wz
            behind = (depth - foot) * across
            if not (begin <= s <= end and behind >= -reach and counts_at(room, x, y, z)):
                continue
            if _is_near_another(
                wx, wy, wz, foot, reach, anchors, directions, radii, firsts, lasts, others
            ):
                continue
            ray = rays[total]
            ray[0], ray[1], ray[2] = du, dv, beside
            ray[3] = min(behind, _FAR) if np.isfinite(depth) else np.inf
            ray[4] = ray_noise(room, x, wx) * across
            ray[5], ray[6] = s, 4.0 / 9.0 * view.blur * foot
            ray[7], ray[8], ray[9] = scan, _drawn(scan, k), wb / across
            total += 1
        counts[j] = total - first
    return total
