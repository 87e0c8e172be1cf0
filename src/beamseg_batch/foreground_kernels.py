"""Kernel that finds the pixels of what is thin and stands free."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.accelerate import kernel
from beamseg_batch.geometry import FloatArray

__all__ = ["free_pixels", "row_pitch", "surveyed", "without_others"]

_WAYS = np.array([[0, 1], [1, 0], [1, 1], [1, -1]])
_CLOSED, _BORDER, _OPEN = 0, 1, 2


@kernel
def _opens(
    depths: FloatArray, row: int, column: int, down: int, right: int, most: int, jump: float
) -> int:
    """What follows within so many pixels: something deeper or nothing, the border, or neither."""
    here = depths[row, column]
    missing = 0
    for _ in range(most):
        row += down
        column += right
        if not (0 <= row < depths.shape[0] and 0 <= column < depths.shape[1]):
            return _BORDER
        depth = depths[row, column]
        if not np.isfinite(depth):
            # One pixel without return may have failed; two in a row saw nothing.
            missing += 1
            if missing == 2:
                return _OPEN
            continue
        missing = 0
        if depth > here + jump:
            return _OPEN
        if depth < here - jump:
            return _CLOSED
    return _CLOSED


@kernel
def free_pixels(
    depths: FloatArray, wanted: NDArray[np.bool_], pitch: float, width: float, jump: FloatArray,
    beyond: bool,
) -> NDArray[np.bool_]:  # fmt: skip
    """Pixels on both sides of which the view goes on further back, in some direction.

    Parameters
    ----------
    depths : (H, W) float64, metres
        Along the rays; not finite where nothing returned.
    wanted : (H, W) bool
        Pixels that are asked.
    pitch : float, radians
        From a pixel to the next.
    width : float, metres
        What is wider is not thin.
    jump : (H, W) float64, metres
        How much deeper is further back.
    beyond : bool
        Whether the view is taken to go on further back beyond the border of the image,
        where the other side is seen to.

    Returns
    -------
    (H, W) bool
    """
    height, columns = depths.shape
    free = np.zeros((height, columns), np.bool_)
    for row in range(height):
        for column in range(columns):
            if not wanted[row, column]:
                continue
            most = int(width / (depths[row, column] * pitch) + 1.5)
            for way in range(4):
                down, right = _WAYS[way, 0], _WAYS[way, 1]
                step = jump[row, column]
                ahead = _opens(depths, row, column, down, right, most, step)
                if ahead == _CLOSED or (ahead == _BORDER and not beyond):
                    continue
                behind = _opens(depths, row, column, -down, -right, most, step)
                # In a corner of the image both sides may lie beyond; one must be seen.
                if behind == _OPEN or (behind == _BORDER and beyond and ahead == _OPEN):
                    free[row, column] = True
                    break
    return free


@kernel
def row_pitch(points: NDArray[np.floating], every: int) -> float:
    """Angle from a pixel to the next along a row, the median of some rows.

    Parameters
    ----------
    points : (H, W, 3) float32 or float64, metres
        Not finite where nothing returned.
    every : int
        Every so manieth row is asked.

    Returns
    -------
    float, radians
        NaN if no two neighbours returned.
    """
    squares = np.empty(points.shape[0] * points.shape[1])
    count = 0
    for row in range(0, points.shape[0], every):
        before = np.full(3, np.nan)
        for column in range(points.shape[1]):
            x = np.float64(points[row, column, 0])
            y = np.float64(points[row, column, 1])
            z = np.float64(points[row, column, 2])
            length = np.sqrt(x * x + y * y + z * z)
            x, y, z = x / length, y / length, z / length
            squared = (x - before[0]) ** 2 + (y - before[1]) ** 2 + (z - before[2]) ** 2
            if np.isfinite(squared):
                squares[count] = squared
                count += 1
            before[0], before[1], before[2] = x, y, z
    return float(np.sqrt(np.median(squares[:count]))) if count else np.nan


@kernel
def surveyed(
    points: NDArray[np.floating], reach: float, up: FloatArray, floor: float,
    least: float, constant: float, relative: float,
) -> tuple[FloatArray, NDArray[np.bool_], FloatArray]:  # fmt: skip
    """What `free_pixels` is to be told of an image.

    Parameters
    ----------
    points : (H, W, 3) float32 or float64, metres, x forward
        Not finite where nothing returned.
    reach : float, metres
        What is further ahead is not asked.
    up : (3,) float64
        Direction of the world's z axis.
    floor : float, metres
        What is lower along it, from the camera, is not asked.
    least, constant : float, metres
    relative : float
        A jump is the least one, and at least the root of the sum of the squares of the
        constant part and of that share of the forward depth.

    Returns
    -------
    depths : (H, W) float64, metres
    wanted : (H, W) bool
    jump : (H, W) float64, metres
        Where it is wanted; else 0.
    """
    height, width = points.shape[:2]
    depths, jump = np.empty((height, width)), np.zeros((height, width))
    wanted = np.zeros((height, width), np.bool_)
    for row in range(height):
        for column in range(width):
            x = np.float64(points[row, column, 0])
            y = np.float64(points[row, column, 1])
            z = np.float64(points[row, column, 2])
            depth = np.sqrt(x * x + y * y + z * z)
            depths[row, column] = depth
            if not (0.0 < depth < np.inf and x <= reach):
                continue
            if up[0] * x + up[1] * y + up[2] * z >= floor:
                wanted[row, column] = True
                noise = np.sqrt(constant * constant + relative * relative * x * x)
                jump[row, column] = max(least, noise)
    return depths, wanted, jump


@kernel
def without_others(points: NDArray[np.floating], kept: NDArray[np.bool_]) -> NDArray[np.floating]:
    """Copy points, those that are not kept as NaN.

    Parameters
    ----------
    points : (N, 3) float32 or float64
    kept : (N,) bool

    Returns
    -------
    (N, 3) of the same kind
    """
    copied = np.full_like(points, np.nan)
    for k in range(len(points)):
        if kept[k]:
            copied[k, 0], copied[k, 1], copied[k, 2] = points[k, 0], points[k, 1], points[k, 2]
    return copied
