"""Kernel that puts points into the pixels that they were seen by."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.accelerate import kernel
from beamseg_batch.geometry import FloatArray

__all__ = ["lay_out"]


@kernel
def lay_out(
    points: NDArray[np.floating],
    columns: FloatArray,
    rows: FloatArray,
    width: int,
    image: NDArray[np.floating],
) -> None:
    """Put each point into the pixel whose ray it lies on.

    Parameters
    ----------
    points : (N, 3) float32 or float64, metres, x forward
        In any order; what is not finite or not ahead is left out.
    columns, rows : (2,) float64
        ``y / x`` of the first column and its step to the next, ``z / x`` of the first row and
        its step.
    width : int
        Pixels of a row.
    image : (P, 3) float32 or float64, metres
        Out: the points by pixel, the nearer of two; where there is none it is left as it is,
        which must be NaN.
    """
    height = len(image) // width
    for k in range(len(points)):
        x, y, z = np.float64(points[k, 0]), np.float64(points[k, 1]), np.float64(points[k, 2])
        if not (np.isfinite(x + y + z) and x > 0.0):
            continue
        column = np.rint((y / x - columns[0]) / columns[1])
        row = np.rint((z / x - rows[0]) / rows[1])
        if not (0.0 <= column < width and 0.0 <= row < height):
            continue
        pixel = int(row) * width + int(column)
        if not image[pixel, 0] <= x:
            image[pixel, 0], image[pixel, 1], image[pixel, 2] = x, y, z
