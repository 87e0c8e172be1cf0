"""Kernels of the pre-processing: one pass over the raw cloud, one over what is left."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.accelerate import kernel
from beamseg_batch.geometry import FloatArray

__all__ = ["crop", "largest_extent", "voxel_means"]

_EMPTY = np.int64(-1)


@kernel
def crop(
    points: NDArray[np.floating],
    low: FloatArray,
    high: FloatArray,
    up: FloatArray,
    height: float,
    floor: float,
) -> tuple[FloatArray, int, int]:
    """Keep the returns inside a box and above the floor.

    Parameters
    ----------
    points : (N, 3) float32 or float64, metres, sensor frame
        A row with NaN or infinity is a pixel without return.
    low, high : (3,) float64, metres, sensor frame
        Bounds of the box, both included.
    up : (3,) float64
        The world's z axis in the sensor frame.
    height : float, metres
        World z of the sensor.
    floor : float, metres
        World z below which points are dropped; -inf keeps all.

    Returns
    -------
    kept : (M, 3) float64, metres, sensor frame
    num_returns, num_window : int
        Finite points, and those of them inside the box.
    """
    kept = np.empty((len(points), 3))
    num_returns = num_window = count = 0
    for k in range(len(points)):
        x, y, z = float(points[k, 0]), float(points[k, 1]), float(points[k, 2])
        if not np.isfinite(x + y + z):
            continue
        num_returns += 1
        inside = low[0] <= x <= high[0] and low[1] <= y <= high[1] and low[2] <= z <= high[2]
        if not inside:
            continue
        num_window += 1
        if up[0] * x + up[1] * y + up[2] * z + height < floor:
            continue
        kept[count, 0], kept[count, 1], kept[count, 2] = x, y, z
        count += 1
    return kept[:count].copy(), num_returns, num_window


@kernel
def largest_extent(points: FloatArray) -> float:
    """Largest extent of points along an axis.

    Parameters
    ----------
    points : (N, 3) float64, metres
        Finite, at least one.

    Returns
    -------
    float, metres
    """
    largest = 0.0
    for axis in range(3):
        low = high = points[0, axis]
        for k in range(len(points)):
            low, high = min(low, points[k, axis]), max(high, points[k, axis])
        largest = max(largest, high - low)
    return largest


@kernel
def voxel_means(points: FloatArray, leaf: float) -> tuple[FloatArray, NDArray[np.int64]]:
    """Mean of the points in each voxel.

    Parameters
    ----------
    points : (N, 3) float64, metres
        Finite; at most 2**20 voxels along an axis.
    leaf : float, metres
        Edge of a voxel; the grid is aligned at ``floor(x * (1 / leaf))``.

    Returns
    -------
    means : (M, 3) float64, metres
        In order of each voxel's first point.
    keys : (M,) int64
        Ascending by z, then y, then x of the voxel.

    Notes
    -----
    A hash table with open addressing gives each occupied voxel a number, so the work
    grows with the points and not with the volume. Means are sums in the order of the
    points.
    """
    num_points = len(points)
    inverse = 1.0 / leaf
    low = np.full(3, np.inf)
    for k in range(num_points):
        for axis in range(3):
            low[axis] = min(low[axis], points[k, axis])
    base_x, base_y, base_z = np.floor(low * inverse)
    size = 4
    while size < 2 * num_points:
        size *= 2
    slots = np.full(size, _EMPTY)
    keys = np.empty(num_points, np.int64)
    sums = np.zeros((num_points, 3))
    counts = np.zeros(num_points, np.int64)
    used = 0
    for k in range(num_points):
        x = np.int64(np.floor(points[k, 0] * inverse) - base_x)
        y = np.int64(np.floor(points[k, 1] * inverse) - base_y)
        z = np.int64(np.floor(points[k, 2] * inverse) - base_z)
        key = (z << 42) | (y << 21) | x
        # Fibonacci hashing spreads neighbouring voxels over the table.
        slot = ((key * np.int64(-7046029254386353131)) >> 20) & (size - 1)
        while slots[slot] != _EMPTY and keys[slots[slot]] != key:
            slot = (slot + 1) & (size - 1)
        if slots[slot] == _EMPTY:
            slots[slot] = used
            keys[used] = key
            used += 1
        voxel = slots[slot]
        counts[voxel] += 1
        for axis in range(3):
            sums[voxel, axis] += points[k, axis]
    for voxel in range(used):
        for axis in range(3):
            sums[voxel, axis] /= counts[voxel]
    return sums[:used], keys[:used]
