"""Kernel that finds the pixels of what is thin and stands free."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.accelerate import kernel
from beamseg_batch.geometry import FloatArray

__all__ = ["free_pixels"]

_WAYS = np.array([[0, 1], [1, 0], [1, 1], [1, -1]])


@kernel
def _opens(
    depths: FloatArray, row: int, column: int, down: int, right: int, most: int, jump: float
) -> bool:
    """Whether something deeper, or nothing, follows within so many pixels."""
    here = depths[row, column]
    missing = 0
    for _ in range(most):
        row += down
        column += right
        if not (0 <= row < depths.shape[0] and 0 <= column < depths.shape[1]):
            return False
        depth = depths[row, column]
        if not np.isfinite(depth):
            # One pixel without return may have failed; two in a row saw nothing.
            missing += 1
            if missing == 2:
                return True
            continue
        missing = 0
        if depth > here + jump:
            return True
        if depth < here - jump:
            return False
    return False


@kernel
def free_pixels(
    depths: FloatArray, wanted: NDArray[np.bool_], pitch: float, width: float, jump: FloatArray
) -> NDArray[np.bool_]:
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
                if _opens(depths, row, column, down, right, most, step) and _opens(
                    depths, row, column, -down, -right, most, step
                ):
                    free[row, column] = True
                    break
    return free
