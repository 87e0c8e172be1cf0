"""Points on the beams: PCD and PLY by Open3D, LAS and LAZ by laspy."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from beamseg_batch.errors import OutputError
from beamseg_batch.export.content import Content
from beamseg_batch.extras import load_extra, load_open3d

__all__ = ["write_las", "write_open3d"]

_LAS_SCALE = 1e-6
"""Metres of a unit in a LAS file: 32 bits then reach 2147 m either way."""


def write_open3d(content: Content, path: Path) -> int:
    """Write points with the number of their beam, as PCD or PLY."""
    open3d = load_open3d(f"a {path.suffix} file of points")
    points = content.points
    content.refuse_none(len(points.positions), path)
    cloud = open3d.t.geometry.PointCloud(open3d.core.Tensor(points.positions))
    cloud.point["beam"] = open3d.core.Tensor(points.beams[:, None])
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        written = open3d.t.io.write_point_cloud(str(path), cloud)
    if not written:
        raise OutputError(f"{path.name}: Open3D cannot write it")
    return len(points.positions)


def write_las(content: Content, path: Path) -> int:
    """Write points with the number of their beam, as LAS, or compressed as LAZ."""
    purpose = f"a {path.suffix} file"
    laspy = load_extra("laspy", purpose)
    if path.suffix.lower() == ".laz":
        load_extra("lazrs", purpose)
    points = content.points
    where = points.positions.astype(np.float64)
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.add_extra_dim(laspy.ExtraBytesParams("beam", "int32", "number of the beam"))
    header.scales = np.full(3, _LAS_SCALE)
    header.offsets = np.floor(where.mean(axis=0)) if len(where) else np.zeros(3)
    las = laspy.LasData(header)
    las.x, las.y, las.z = where.T
    las["beam"] = points.beams
    las.write(str(path))
    return len(where)
