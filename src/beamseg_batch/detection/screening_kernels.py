"""Kernel of the screening: everything that one pass over a line's points can measure."""

from __future__ import annotations

import numpy as np

from beamseg_batch.accelerate import kernel
from beamseg_batch.detection.hough_kernels import fit_line
from beamseg_batch.geometry import FloatArray

__all__ = ["measure_line"]


@kernel
def measure_line(
    points: FloatArray, direction: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float]:
    """Fit a line to points and place them along it.

    Parameters
    ----------
    points : (N, 3) float64, metres
        At least one.
    direction : (3,) float64
        Which of the two ways along the axis is forward.

    Returns
    -------
    anchor, axis : (3,) float64, metres and unit vector
    eigenvalues : (3,) float64, square metres
        Of the scatter matrix, largest first.
    t : (N,) float64, metres
        Position of each point along the axis.
    furthest : float, metres
        Distance of the furthest point from the axis.
    """
    anchor, axis, eigenvalues = fit_line(points, np.arange(len(points)), len(points))
    side = axis[0] * direction[0] + axis[1] * direction[1] + axis[2] * direction[2]
    if side < 0.0:
        for part in range(3):
            axis[part] = -axis[part]
    t = np.empty(len(points))
    furthest = 0.0
    for k in range(len(points)):
        x = points[k, 0] - anchor[0]
        y = points[k, 1] - anchor[1]
        z = points[k, 2] - anchor[2]
        along = x * axis[0] + y * axis[1] + z * axis[2]
        t[k] = along
        x, y, z = x - along * axis[0], y - along * axis[1], z - along * axis[2]
        furthest = max(furthest, x * x + y * y + z * z)
    return anchor, axis, eigenvalues, t, np.sqrt(furthest)
