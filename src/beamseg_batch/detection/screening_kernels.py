"""Kernels of the screening: what one pass over the points of a line can measure."""

from __future__ import annotations

import numpy as np

from beamseg_batch.accelerate import kernel
from beamseg_batch.detection.line_fit_kernels import fit_line
from beamseg_batch.geometry import FloatArray

__all__ = ["longest_stretch", "measure_line"]


@kernel
def measure_line(
    points: FloatArray, direction: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float, float, float]:
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
    t_min, t_max : float, metres
        The first and the last of them.
    furthest : float, metres
        Distance of the furthest point from the axis.
    """
    anchor, axis, eigenvalues = fit_line(points, np.arange(len(points)), len(points))
    side = axis[0] * direction[0] + axis[1] * direction[1] + axis[2] * direction[2]
    if side < 0.0:
        for part in range(3):
            axis[part] = -axis[part]
    t = np.empty(len(points))
    t_min, t_max, furthest = np.inf, -np.inf, 0.0
    for k in range(len(points)):
        x = points[k, 0] - anchor[0]
        y = points[k, 1] - anchor[1]
        z = points[k, 2] - anchor[2]
        along = x * axis[0] + y * axis[1] + z * axis[2]
        t[k], t_min, t_max = along, min(t_min, along), max(t_max, along)
        x, y, z = x - along * axis[0], y - along * axis[1], z - along * axis[2]
        furthest = max(furthest, x * x + y * y + z * z)
    return anchor, axis, eigenvalues, t, t_min, t_max, np.sqrt(furthest)


@kernel
def longest_stretch(ordered: FloatArray, max_gap: float) -> tuple[int, int]:
    """Find the stretch without a gap that spans the most metres.

    Parameters
    ----------
    ordered : (N,) float64, metres
        Ascending; at least one.
    max_gap : float, metres
        Neighbours further apart than this are a gap.

    Returns
    -------
    start, stop : int
        First index of the stretch, and one past its last. The first of equals.
    """
    best_start, best_stop, start = 0, 0, 0
    best_length = -1.0
    for k in range(1, len(ordered) + 1):
        if k == len(ordered) or ordered[k] - ordered[k - 1] > max_gap:
            length = ordered[k - 1] - ordered[start]
            if length > best_length:
                best_start, best_stop, best_length = start, k, length
            start = k
    return best_start, best_stop
