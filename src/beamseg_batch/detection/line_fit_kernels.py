"""Kernel that fits a line to points; the search and the screening both use it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.accelerate import kernel
from beamseg_batch.geometry import FloatArray
from beamseg_batch.principal_kernels import principal_axis

__all__ = ["fit_line"]


@kernel
def fit_line(
    points: FloatArray, indices: NDArray[np.int64], count: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fit a line by orthogonal least squares.

    Parameters
    ----------
    points : (N, 3) float64, metres
    indices : (M,) int64
        The points to fit; the first `count` count.
    count : int
        At least 1.

    Returns
    -------
    anchor : (3,) float64, metres
        Mean of the points.
    direction : (3,) float64, unit vector
        Eigenvector of the scatter matrix to its largest eigenvalue.
    eigenvalues : (3,) float64, square metres
        Of the scatter matrix (not divided by the number of points), largest first.

    Notes
    -----
    Sums run in the order of the points.
    """
    x, y, z = 0.0, 0.0, 0.0
    for k in range(count):
        point = indices[k]
        x, y, z = x + points[point, 0], y + points[point, 1], z + points[point, 2]
    x, y, z = x / count, y / count, z / count
    xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        point = indices[k]
        px, py, pz = points[point, 0] - x, points[point, 1] - y, points[point, 2] - z
        xx, xy, xz = xx + px * px, xy + px * py, xz + px * pz
        yy, yz, zz = yy + py * py, yz + py * pz, zz + pz * pz
    anchor = np.array([x, y, z])
    scatter = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    direction, eigenvalues = principal_axis(scatter)
    return anchor, direction, eigenvalues
