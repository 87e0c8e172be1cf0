"""Pre-processing of a cloud (report, section 3.2.2): window, floor trim, voxel grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beamseg_batch.config import FilteringConfig
from beamseg_batch.detection.filtering_kernels import crop, largest_extent, voxel_means
from beamseg_batch.errors import ConfigError
from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import Scan

__all__ = ["CroppedCloud", "crop_scan", "voxel_grid"]

_MAX_VOXELS_PER_AXIS = 2**20


@dataclass(frozen=True, eq=False)
class CroppedCloud:
    """The returns of a scan inside the window and above the floor.

    Attributes
    ----------
    points : (N, 3) float64, metres, sensor frame
    num_returns : int
        Pixels of the scan with a return.
    num_window : int
        Those of them inside the window, above the floor or not.
    """

    points: FloatArray
    num_returns: int
    num_window: int


def crop_scan(scan: Scan, config: FilteringConfig) -> CroppedCloud:
    """Keep the returns inside the pass-through window and above the floor.

    Parameters
    ----------
    scan : Scan
    config : FilteringConfig
        With ``floor_trim: points`` the floor is trimmed here (report, section 4.1), so
        that a leg which stands on the floor survives.

    Returns
    -------
    CroppedCloud
    """
    window = config.window
    low, high = np.array([window.x, window.y, window.z]).T.copy()
    T_world_sensor = scan.T_world_sensor
    floor = config.floor_trim_height if config.floor_trim == "points" else -np.inf
    points, num_returns, num_window = crop(
        scan.points,
        low,
        high,
        T_world_sensor.rotation[2].copy(),
        float(T_world_sensor.translation[2]),
        floor,
    )
    return CroppedCloud(points, num_returns, num_window)


def voxel_grid(points: FloatArray, leaf_size: float) -> FloatArray:
    """Thin a cloud to the mean of the points in each voxel.

    Parameters
    ----------
    points : (N, 3) float64, metres
        Finite.
    leaf_size : float, metres

    Returns
    -------
    (M, 3) float64, metres
        Ordered by z, then y, then x of the voxel, as PCL orders them.

    Raises
    ------
    ConfigError
        If the leaf size is absurdly small for the extent of the cloud.

    Notes
    -----
    PCL's VoxelGrid: the grid is aligned at ``floor(x * (1 / leaf_size))``, whatever the
    cloud.
    """
    if len(points) == 0:
        return np.empty((0, 3))
    extent = largest_extent(points)
    if extent >= leaf_size * _MAX_VOXELS_PER_AXIS:
        raise ConfigError(
            f"a leaf size of {leaf_size:.3g} m cuts a cloud of {extent:.3g} m into more than "
            f"{_MAX_VOXELS_PER_AXIS} voxels along one axis; see filtering.radii and "
            "filtering.rad_2_leaf_ratio"
        )
    means, keys = voxel_means(points, leaf_size)
    return means[np.argsort(keys)]
