"""Kernel that takes the returns out of a scan, as rays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.accelerate import kernel
from beamseg_batch.geometry import FloatArray

__all__ = ["returns_of"]


@kernel
def returns_of(
    points: NDArray[np.floating], noise: float, noise_relative: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Returns ahead of the camera, as rays.

    Parameters
    ----------
    points : (N, 3) float32 or float64, metres, x forward
        Not finite where nothing returned.
    noise, noise_relative : float
        Standard deviation of the forward depth: metres, and share of the depth.

    Returns
    -------
    points, rays : (M, 3) float64, metres and unit vectors
    depths, sigmas : (M,) float64, metres
        Along the rays, and their standard deviations.
    """
    found, rays = np.empty((len(points), 3)), np.empty((len(points), 3))
    depths, sigmas = np.empty(len(points)), np.empty(len(points))
    count = 0
    for k in range(len(points)):
        x, y, z = np.float64(points[k, 0]), np.float64(points[k, 1]), np.float64(points[k, 2])
        depth = np.sqrt(x * x + y * y + z * z)
        if not (np.isfinite(depth) and x > 0.0):
            continue
        found[count, 0], found[count, 1], found[count, 2] = x, y, z
        rays[count, 0], rays[count, 1], rays[count, 2] = x / depth, y / depth, z / depth
        relative = noise_relative * x
        depths[count] = depth
        sigmas[count] = np.sqrt(noise * noise + relative * relative) * depth / x
        count += 1
    return found[:count], rays[:count], depths[:count], sigmas[:count]
