"""Rows and columns for clouds that came without, by the bearings of their points.

A driver that leaves out the pixels without return writes a cloud of one row. Its points
still lie on the rays of the camera's pixels, and these on a grid: ``y / x`` is the same for all
returns of a column, ``z / x`` for those of a row. Where they are on no grid, an image of coarser
cells still tells neighbours.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.bearing_kernels import lay_out
from beamseg_batch.geometry import FloatArray

__all__ = ["BearingImage", "PixelGrid", "bearing_image", "find_grid", "in_order"]

_MOST_POINTS = 400_000
_FEWEST_LINES = 8
_MOST_LINES = 4096
_LEAST_GAP = 1e-6  # what rounding makes of equal slopes
_MOST_OFF, _SHARE_ON = 0.2, 0.99  # steps from the middle of a line, and share of points within
_LEAST_FILLED = 0.1  # share of the pixels that returned at least once
_MOST_DOUBLE = 0.02  # share of the points that share their pixel with another
_MOST_HOLES = 0.25  # share of the pixels amid a surface that did not return
_SAME_SURFACE = 0.05  # share by which depths on either side of such a pixel differ
_SEEDS, _NEIGHBOURS = 64, 8
_CELL = np.sqrt(3.0 * np.pi / 8.0)  # of the distance of the eighth neighbour: three points a cell
_MOST_CELLS = 4_000_000


@dataclass(frozen=True, eq=False)
class PixelGrid:
    """The pixels of a pinhole camera.

    Attributes
    ----------
    columns, rows : (2,) float64
        ``y / x`` of the first column and its step to the next, ``z / x`` of the first row and
        its step.
    width, height : int
        Pixels.
    """

    columns: FloatArray
    rows: FloatArray
    width: int
    height: int

    def image_of(self, points: NDArray[np.floating]) -> NDArray[np.floating]:
        """Points by pixel.

        Parameters
        ----------
        points : (N, 3) float32 or float64, metres, x forward
            Returns of one cloud, in any order.

        Returns
        -------
        (height * width, 3), of the same type
            Row by row; NaN where nothing returned. A point beyond the grid is left out.
        """
        image = np.full((self.width * self.height, 3), np.nan, points.dtype)
        lay_out(points, self.columns, self.rows, self.width, image)
        image.flags.writeable = False
        return image


def find_grid(clouds: Iterable[NDArray[np.floating]]) -> PixelGrid | None:
    """Find the grid on which the rays of some clouds lie.

    Parameters
    ----------
    clouds : iterable of (N, 3) float32 or float64, metres, x forward
        Of the same camera; spread over a flight, so that every row and column returned once.

    Returns
    -------
    PixelGrid or None
        None where the rays are on no grid, as those of a lidar, or of a lens whose distortion
        was not taken out.
    """
    ahead = [_ahead(points) for points in clouds]
    ahead = [points for points in ahead if len(points)]
    if not ahead:
        return None
    pooled = np.concatenate(ahead)
    # Rounded coordinates move the bearing of what is near by more.
    far = pooled[pooled[:, 0] >= np.median(pooled[:, 0])]
    far = far[:: max(len(far) // _MOST_POINTS, 1)]
    columns, rows = (_lines(far[:, axis] / far[:, 0]) for axis in (1, 2))
    if columns is None or rows is None:
        return None
    (columns, width), (rows, height) = (
        _bounded(line, pooled[:, axis] / pooled[:, 0]) for line, axis in ((columns, 1), (rows, 2))
    )
    if width > _MOST_LINES or height > _MOST_LINES:
        return None
    grid = PixelGrid(columns, rows, width, height)
    return grid if _fits(grid, ahead) else None


def _ahead(points: NDArray[np.floating]) -> FloatArray:
    exact = np.asarray(points, np.float64)
    ahead: FloatArray = exact[np.isfinite(exact).all(axis=1) & (exact[:, 0] > 0.0)]
    return ahead


def _lines(slopes: FloatArray) -> FloatArray | None:
    """First place and step of evenly spaced places that slopes have; None if there are none.

    Slopes of one line are far nearer to one another than to those of the next: of the gaps
    between all slopes in order, those between lines stand out by the largest ratio.
    """
    slopes = np.sort(slopes)
    gaps = np.diff(slopes)
    largest = np.sort(gaps)[::-1][:_MOST_LINES]
    if len(largest) <= _FEWEST_LINES:
        return None
    largest = np.maximum(largest, _LEAST_GAP)
    ratios = largest[_FEWEST_LINES - 2 : -1] / largest[_FEWEST_LINES - 1 :]
    between = _FEWEST_LINES - 1 + int(np.argmax(ratios))
    step = float(np.median(largest[:between]))
    numbers = np.concatenate([[0.0], np.cumsum(np.rint(gaps / step))])
    if numbers[-1] < _FEWEST_LINES - 1:
        return None
    step, first = np.polyfit(numbers, slopes, 1)
    near = np.abs(slopes - first - step * numbers) < _MOST_OFF * step
    return np.array([first, step]) if near.mean() >= _SHARE_ON else None


def _bounded(line: FloatArray, slopes: FloatArray) -> tuple[FloatArray, int]:
    """Begin at the largest slope seen, the left or upper border, and count to the least."""
    first, step = line
    numbers = np.rint((slopes - first) / step)
    return np.array([first + step * numbers.max(), -step]), int(np.ptp(numbers)) + 1


def _fits(grid: PixelGrid, clouds: list[FloatArray]) -> bool:
    """Whether pixels are used, each by one point of a cloud, and few of a surface are missing.

    Of a cloud that was thinned, or of a lidar that looks elsewhere in every scan, a missing
    pixel must not be taken for one that saw nothing.
    """
    seen = np.zeros(grid.width * grid.height, np.bool_)
    double = total = missing = amid = 0
    for points in clouds:
        depths = grid.image_of(points)[:, 0]
        returned = np.isfinite(depths)
        double += len(points) - int(returned.sum())
        total += len(points)
        seen |= returned
        rows = depths.reshape(grid.height, grid.width)
        surface = np.abs(rows[:, 2:] - rows[:, :-2]) < _SAME_SURFACE * rows[:, 2:]
        amid += int(surface.sum())
        missing += int(np.isnan(rows[:, 1:-1][surface]).sum())
    used = bool(seen.mean() >= _LEAST_FILLED) and double <= _MOST_DOUBLE * total
    return used and missing <= _MOST_HOLES * amid


def in_order(points: NDArray[np.floating]) -> NDArray[np.floating]:
    """The same points in an order that does not depend on the one they came in.

    Parameters
    ----------
    points : (N, 3) float32 or float64

    Returns
    -------
    (N, 3), of the same type
    """
    ordered = np.ascontiguousarray(points[np.lexsort(points.T)])
    ordered.flags.writeable = False
    return ordered


@dataclass(frozen=True, eq=False)
class BearingImage:
    """One point of a cloud in each cell of azimuth and elevation.

    Attributes
    ----------
    points : (height * width, 3) float64, metres
        Row by row; NaN in empty cells.
    cells : (N,) int64
        Cell of each point of the cloud; -1 of those that are not finite.
    width, height : int
        Cells.
    """

    points: FloatArray
    cells: NDArray[np.int64]
    width: int
    height: int


def bearing_image(
    cloud: NDArray[np.floating], keep: Literal["nearest", "middle"] = "nearest"
) -> BearingImage:
    """Make an image of a cloud whose points are on no grid.

    Parameters
    ----------
    cloud : (N, 3) float32 or float64, metres, x forward
    keep : {'nearest', 'middle'}
        Which of several points a cell keeps: the one nearest to the camera, or to the middle of the
        cell, which favours no error of the depth.

    Returns
    -------
    BearingImage
        Its cells hold three points each, where the cloud is as dense as it mostly is, so that few
        amid a surface are empty.
    """
    cells = np.full(len(cloud), -1, np.int64)
    depths = np.linalg.norm(np.asarray(cloud, np.float64), axis=1)
    good = np.flatnonzero(np.isfinite(depths) & (depths > 0.0))
    points, depths = np.asarray(cloud[good], np.float64), depths[good]
    if len(points) <= _NEIGHBOURS:
        return BearingImage(np.empty((0, 3)), cells, 0, 0)
    rays = points / depths[:, None]
    angles = -np.stack([np.arctan2(rays[:, 1], rays[:, 0]), np.arcsin(rays[:, 2])], axis=1)
    extent = np.ptp(angles, axis=0)
    size = max(_cell_size(rays), np.sqrt(extent.prod() / _MOST_CELLS), extent.max() / _MOST_CELLS)
    places = (angles - angles.min(axis=0)) / size
    column, row = places.astype(np.int64).T
    width, height = int(column.max()) + 1, int(row.max()) + 1
    cells[good] = row * width + column
    off = depths if keep == "nearest" else np.abs(places % 1.0 - 0.5).max(axis=1)
    image = np.full((width * height, 3), np.nan)
    best_last = np.argsort(-off, kind="stable")
    image[cells[good][best_last]] = points[best_last]
    return BearingImage(image, cells, width, height)


def _cell_size(rays: FloatArray) -> float:
    """Side of a cell that holds three rays, radians."""
    seeds = rays[:: max(len(rays) // _SEEDS, 1)]
    apart = 2.0 - 2.0 * seeds @ rays.T
    squared = np.partition(apart, _NEIGHBOURS, axis=1)[:, _NEIGHBOURS]
    return float(_CELL * np.sqrt(np.median(np.maximum(squared, 1e-12))))
