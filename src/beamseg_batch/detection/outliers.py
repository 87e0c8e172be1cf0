"""Optional filters by Open3D: statistical outliers, planes by RANSAC, clusters by DBSCAN.

The methods that the report compares in its section 2.1, in front of the search.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.config import FilteringConfig
from beamseg_batch.extras import load_open3d
from beamseg_batch.geometry import FloatArray

__all__ = ["check_outlier_filter", "without_outliers"]

_NEIGHBOURS, _DEVIATIONS = 20, 2.0
_FEWEST = 50
_PLANE_REACH_M, _PLANE_TRIALS, _MOST_PLANES = 0.03, 300, 5
_EVERY_TRIAL = 1.0  # probability asked for; below it threads decide which trial is the last
_PLANE_SHARE = 0.15  # of the points, for a plane to be large
_PLANE_WIDTH_M = 0.4  # least extent of a large plane across its longest side
_CLUSTER_REACH_M, _CLUSTER_CORE = 0.08, 6
_CLUSTER_FEWEST = 30


def check_outlier_filter(config: FilteringConfig) -> None:
    """Make sure that the configured filter can be used.

    Parameters
    ----------
    config : FilteringConfig

    Raises
    ------
    Open3DMissingError
        If it needs Open3D, and that cannot be loaded.
    """
    if config.outliers != "none":
        _open3d(config)


def without_outliers(points: FloatArray, config: FilteringConfig) -> FloatArray:
    """Filter the points of a scan before they are searched.

    Parameters
    ----------
    points : (N, 3) float64, metres
    config : FilteringConfig

    Returns
    -------
    (M, 3) float64, metres
        Those that are kept, in the same order; all with ``outliers: none``, and of fewer than 50.

    Raises
    ------
    Open3DMissingError
        If Open3D is needed and cannot be loaded.

    Notes
    -----
    `statistical` drops points whose mean distance from their 20 nearest neighbours is two standard
    deviations above the mean of all. `plane` removes up to five planes, each with 15 % of the
    points within 3 cm of it, at least 0.4 m wide. `dbscan` drops what has fewer than 6 points
    within 8 cm and belongs to no cluster of 30 points. The same points give the same result.
    """
    if config.outliers == "none" or len(points) < _FEWEST:
        return points
    open3d = _open3d(config)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    open3d.utility.random.seed(0)
    return points[_FILTERS[config.outliers](cloud)]


def _open3d(config: FilteringConfig) -> Any:
    return load_open3d(f"filtering.outliers: {config.outliers}")


def _statistical(cloud: Any) -> NDArray[np.int64]:
    """Points that are about as near to their neighbours as most."""
    return np.array(cloud.remove_statistical_outlier(_NEIGHBOURS, _DEVIATIONS)[1], np.int64)


def _off_planes(cloud: Any) -> NDArray[np.int64]:
    """Points on no large plane."""
    points = np.asarray(cloud.points)
    left = np.arange(len(points))
    for _ in range(_MOST_PLANES):
        if len(left) < _FEWEST:
            break
        rest = cloud.select_by_index(left)
        plane = rest.segment_plane(_PLANE_REACH_M, 3, _PLANE_TRIALS, _EVERY_TRIAL)[1]
        if len(plane) < _PLANE_SHARE * len(points) or not _is_wide(points[left[plane]]):
            break
        left = np.delete(left, plane)
    return left


def _is_wide(points: FloatArray) -> bool:
    """Whether points extend in two directions; those of a beam do in one."""
    variances = np.linalg.eigvalsh(np.cov(points.T))
    return bool(np.sqrt(12.0 * variances[1]) >= _PLANE_WIDTH_M)


def _in_clusters(cloud: Any) -> NDArray[np.int64]:
    """Points of clusters that are large enough to be a beam."""
    labels = np.asarray(cloud.cluster_dbscan(_CLUSTER_REACH_M, _CLUSTER_CORE))
    sizes = np.bincount(labels[labels >= 0], minlength=1)
    return np.flatnonzero((labels >= 0) & (sizes[labels] >= _CLUSTER_FEWEST))


_FILTERS: Mapping[str, Callable[[Any], NDArray[np.int64]]] = {
    "statistical": _statistical,
    "plane": _off_planes,
    "dbscan": _in_clusters,
}
