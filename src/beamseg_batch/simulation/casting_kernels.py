"""Rays of a pinhole camera against convex solids."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.accelerate import kernel
from beamseg_batch.geometry import FloatArray

__all__ = ["average_pixels", "cast_rays", "enter_ball", "enter_box", "enter_cylinder"]

_CLOSEST = 1e-3
"""What lies nearer to the plane of the camera, metres, is not projected."""


@kernel
def enter_box(
    o: FloatArray, dx: float, dy: float, dz: float, half: FloatArray
) -> tuple[float, float]:
    """Where a ray enters a box about the origin.

    Parameters
    ----------
    o : (3,) float64, metres
        Start of the ray, in the axes of the box.
    dx, dy, dz : float
        Its direction, of any length.
    half : (3,) float64, metres

    Returns
    -------
    t, facing : float
        The point ``o + t * d``, and ``|n . d|`` with the unit normal there; t is infinite
        if the ray misses the box or starts behind its front.
    """
    enters, leaves, facing = -math.inf, math.inf, 0.0
    for axis in range(3):
        d = dx if axis == 0 else dy if axis == 1 else dz
        if d == 0.0:
            if abs(o[axis]) > half[axis]:
                return math.inf, 0.0
            continue
        reach = half[axis] / abs(d)
        middle = -o[axis] / d
        if middle - reach > enters:
            enters, facing = middle - reach, abs(d)
        leaves = min(leaves, middle + reach)
    if enters > leaves or enters <= 0.0:
        return math.inf, 0.0
    return enters, facing


@kernel
def enter_cylinder(
    o: FloatArray, dx: float, dy: float, dz: float, half: FloatArray
) -> tuple[float, float]:
    """Where a ray enters a capped cylinder about the origin, along z; see `enter_box`."""
    radius = half[0]
    a = dx * dx + dy * dy
    b = o[0] * dx + o[1] * dy
    c = o[0] * o[0] + o[1] * o[1] - radius * radius
    enters, leaves, facing = -math.inf, math.inf, 0.0
    if a == 0.0:
        if c > 0.0:
            return math.inf, 0.0
    else:
        root = b * b - a * c
        if root < 0.0:
            return math.inf, 0.0
        root = math.sqrt(root)
        enters, leaves, facing = (-b - root) / a, (-b + root) / a, root / radius
    if dz == 0.0:
        if abs(o[2]) > half[2]:
            return math.inf, 0.0
    else:
        reach = half[2] / abs(dz)
        middle = -o[2] / dz
        if middle - reach > enters:
            enters, facing = middle - reach, abs(dz)
        leaves = min(leaves, middle + reach)
    if enters > leaves or enters <= 0.0:
        return math.inf, 0.0
    return enters, facing


@kernel
def enter_ball(
    o: FloatArray, dx: float, dy: float, dz: float, half: FloatArray
) -> tuple[float, float]:
    """Where a ray enters a ball about the origin; see `enter_box`."""
    radius = half[0]
    a = dx * dx + dy * dy + dz * dz
    b = o[0] * dx + o[1] * dy + o[2] * dz
    root = b * b - a * (o[0] * o[0] + o[1] * o[1] + o[2] * o[2] - radius * radius)
    if root < 0.0:
        return math.inf, 0.0
    root = math.sqrt(root)
    enters = (-b - root) / a
    return (enters, root / radius) if enters > 0.0 else (math.inf, 0.0)


@kernel
def _bounds(
    origin: FloatArray, axes: FloatArray, half: FloatArray
) -> tuple[float, float, float, float, float]:
    """Bounds of a box in the camera's image.

    Parameters
    ----------
    origin : (3,) float64, metres
        Centre of the box, sensor frame.
    axes : (3, 3) float64
        Axes of the box, as columns, sensor frame.
    half : (3,) float64, metres

    Returns
    -------
    depth, left, right, top, bottom : float
        Depth of its nearest corner, and bounds of ``-y/x`` and of ``-z/x``. An edge that
        reaches behind the camera is cut just before it. Without any part before the
        camera, the depth is infinite.
    """
    corners = np.empty((8, 3))
    for number in range(8):
        for k in range(3):
            corners[number, k] = origin[k]
            for axis in range(3):
                side = half[axis] if number >> axis & 1 else -half[axis]
                corners[number, k] += axes[k, axis] * side
    depth = math.inf
    left, right, top, bottom = math.inf, -math.inf, math.inf, -math.inf
    for first in range(8):
        for axis in range(3):
            last = first ^ (1 << axis)
            x, y, z = corners[first, 0], corners[first, 1], corners[first, 2]
            if x < _CLOSEST:
                if corners[last, 0] < _CLOSEST:
                    continue
                share = (_CLOSEST - x) / (corners[last, 0] - x)
                y += share * (corners[last, 1] - y)
                z += share * (corners[last, 2] - z)
                x = _CLOSEST
            depth = min(depth, x)
            left, right = min(left, -y / x), max(right, -y / x)
            top, bottom = min(top, -z / x), max(bottom, -z / x)
    return depth, left, right, top, bottom


@kernel
def cast_rays(
    kinds: NDArray[np.int64],
    centres: FloatArray,
    axes: FloatArray,
    halves: FloatArray,
    right: FloatArray,
    down: FloatArray,
    farthest: float,
    depths: FloatArray,
    hits: NDArray[np.int64],
    facings: FloatArray,
) -> None:
    """Find what each ray of a camera hits first.

    Parameters
    ----------
    kinds : (N,) int64
    centres : (N, 3) float64, metres, sensor frame
    axes : (N, 3, 3) float64
        Axes of the solids, as columns, sensor frame.
    halves : (N, 3) float64, metres
        As in `Solids`.
    right : (W,) float64
    down : (H,) float64
        Ray (v, u) has the direction ``(1, -right[u], -down[v])`` in the sensor frame, so
        its parameter is the depth; both increase.
    farthest : float, metres
        Solids that begin at a greater depth are passed over.
    depths : (H, W) float64, metres
        In: depth of what was hit before, or infinite. Out: that of the first hit.
    hits : (H, W) int64
        Out: number of the solid, where one was hit.
    facings : (H, W) float64
        Out: sine of the angle between ray and surface, where a solid was hit.

    Notes
    -----
    A solid is only tried against the rays within its bounds in the image, so the cost
    is that of what is in view, not of the whole scene.
    """
    start = np.empty(3)
    for solid in range(len(kinds)):
        m, centre, kind, half = axes[solid], centres[solid], kinds[solid], halves[solid]
        depth, left, rightmost, top, bottom = _bounds(centre, m, half)
        if depth > farthest:
            continue
        first_u, last_u = np.searchsorted(right, left), np.searchsorted(right, rightmost, "right")
        first_v, last_v = np.searchsorted(down, top), np.searchsorted(down, bottom, "right")
        for k in range(3):
            start[k] = -(m[0, k] * centre[0] + m[1, k] * centre[1] + m[2, k] * centre[2])
        for v in range(first_v, last_v):
            for u in range(first_u, last_u):
                a, b = right[u], down[v]
                dx = m[0, 0] - a * m[1, 0] - b * m[2, 0]
                dy = m[0, 1] - a * m[1, 1] - b * m[2, 1]
                dz = m[0, 2] - a * m[1, 2] - b * m[2, 2]
                if kind == 0:
                    t, facing = enter_box(start, dx, dy, dz, half)
                elif kind == 1:
                    t, facing = enter_cylinder(start, dx, dy, dz, half)
                else:
                    t, facing = enter_ball(start, dx, dy, dz, half)
                if t < depths[v, u]:
                    depths[v, u] = t
                    hits[v, u] = solid
                    facings[v, u] = facing / math.sqrt(1.0 + a * a + b * b)


@kernel
def average_pixels(
    depths: FloatArray, facings: FloatArray, footprint: int, least_facing: float
) -> FloatArray:
    """Depth that each pixel measures: the mean over its sub-rays that return.

    Parameters
    ----------
    depths : (H * n, W * n) float64, metres
        Of the sub-rays; infinite without a hit.
    facings : (H * n, W * n) float64
        Sines of the angles between rays and surfaces.
    footprint : int
        n.
    least_facing : float
        A sub-ray that meets a surface at a smaller sine is lost.

    Returns
    -------
    (H, W) float64, metres
        Infinite where fewer than half of the sub-rays return.
    """
    height, width = depths.shape[0] // footprint, depths.shape[1] // footprint
    pixels = np.empty((height, width))
    for v in range(height):
        for u in range(width):
            total, count = 0.0, 0
            for j in range(v * footprint, (v + 1) * footprint):
                for i in range(u * footprint, (u + 1) * footprint):
                    if depths[j, i] < math.inf and facings[j, i] >= least_facing:
                        total += depths[j, i]
                        count += 1
            pixels[v, u] = total / count if 2 * count >= footprint * footprint else math.inf
    return pixels
