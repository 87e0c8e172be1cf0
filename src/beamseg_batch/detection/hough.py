"""The iterative 3-D Hough transform (Dalitz et al., IPOL 2017): points -> lines.

It gives the lines of the published program without doing its work. That program keeps
one dense accumulator over all cells and directions and scans it for each line. Here
each direction votes in a small grid of its own, and a heap of upper bounds says which
directions need to be looked at again after the points of a line were taken away.
`docs/search.md` tells why the result is the same.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.detection.hough_kernels import (
    Search,
    bounding_box,
    find_lines,
    start_search,
)
from beamseg_batch.detection.hough_space import HoughSpace, hough_space
from beamseg_batch.detection.voting_kernels import Plane
from beamseg_batch.errors import ConfigError, ShapeError
from beamseg_batch.geometry import FloatArray

__all__ = ["HoughLine", "iterative_hough"]

MAX_POINTS = 2**23
"""Most points of a cloud: a key has room for the votes and the uncertain votes of these."""

MAX_CELLS_PER_SIDE = 4000
"""Side of the largest voting plane: the most cells that float32 numbers exactly."""

_BATCH = 8  # lines a call: most scans need one or two calls

# Rounding of a float32 grid coordinate: about seven roundings of numbers up to the
# number of cells, each by at most 2**-24 of it; ten leaves a margin.
_FLOAT32_ROUNDINGS = 10 * 2.0**-24


@dataclass(frozen=True, eq=False)
class HoughLine:
    """A line of the iterative Hough transform.

    Attributes
    ----------
    anchor : (3,) float64, metres
        Mean of the line's points.
    direction : (3,) float64, unit vector
        On the same side as `cell_direction`.
    indices : (M,) int64
        The points of the line, as indices into the cloud, in its order.
    votes : int
        Votes of the winning cell, before the fit.
    cell_anchor, cell_direction : (3,) float64
        The line of the winning cell.
    """

    anchor: FloatArray
    direction: FloatArray
    indices: NDArray[np.int64]
    votes: int
    cell_anchor: FloatArray
    cell_direction: FloatArray


def iterative_hough(
    points: FloatArray,
    *,
    dx: float | None = None,
    granularity: int = 4,
    minvotes: int = 2,
    nlines: int = 0,
) -> Iterator[HoughLine]:
    """Find lines one after the other, each in the points that the earlier ones left.

    Parameters
    ----------
    points : (N, 3) float64, metres
        Finite.
    dx : float, optional
        Cell width and reach of a line, metres; by default 1/64 of the cloud's diagonal.
    granularity : int
        Subdivisions of the icosahedron, 0 to 6.
    minvotes : int
        The search ends at the first line with fewer points; at least 2.
    nlines : int
        The search ends after so many lines; 0 for no limit.

    Yields
    ------
    HoughLine
        Searched a few at a time, so a caller who stops early saves the rest. Errors come
        with the first line that is asked for.

    Raises
    ------
    ShapeError
        If `points` is not (N, 3), not finite, or holds more than 8 million points.
    ConfigError
        If `dx` is not positive, or the cloud spans more than 4000 cells.

    Notes
    -----
    Algorithms 1 and 2 of Dalitz, Schramke and Jeltsch, IPOL 7 (2017), 184-196. As in
    their program a cloud smaller than `dx` holds no line, and the search ends at a line
    whose points have no extent beyond rounding.
    """
    if points.ndim != 2 or points.shape[1] != 3:
        raise ShapeError(f"points must have shape (N, 3), not {points.shape}")
    if len(points) > MAX_POINTS:
        raise ShapeError(f"a cloud of {len(points)} points is too large, limit {MAX_POINTS}")
    if dx is not None and not dx > 0.0:
        raise ConfigError(f"dx must be above 0, not {dx}")
    if len(points) < 2:
        return
    points = np.ascontiguousarray(points, np.float64)  # the kernels are compiled for no others
    low, high, finite = bounding_box(points)
    if not finite:
        raise ShapeError("points must be finite")
    diagonal = float(np.sqrt(np.sum((high - low) ** 2)))
    dx = diagonal / 64.0 if dx is None else dx
    if diagonal == 0.0 or dx >= diagonal:
        return
    shift = (low + high) / 2.0
    space = hough_space(granularity)
    search = _new_search(points - shift, (low - shift, high - shift), dx, len(space.directions))
    start_search(space, search)
    left = nlines or len(points)
    while left > 0:
        batch = _next_lines(space, search, max(minvotes, 2), min(left, _BATCH), shift)
        yield from batch
        if len(batch) < _BATCH:
            return
        left -= len(batch)


def _next_lines(
    space: HoughSpace, search: Search, minvotes: int, limit: int, shift: FloatArray
) -> list[HoughLine]:
    """Find up to `limit` lines; a batch costs one call into compiled code."""
    votes, counts = np.empty((2, limit), np.int64)
    members = np.empty(search.progress[1], np.int64)
    cell_lines, lines = np.empty((2, limit, 6))
    found = find_lines(space, search, minvotes, votes, counts, members, cell_lines, lines)
    stops = np.cumsum(counts[:found])
    return [
        HoughLine(
            anchor=lines[k, :3] + shift,
            direction=lines[k, 3:],
            indices=members[stops[k] - counts[k] : stops[k]],
            votes=int(votes[k]),
            cell_anchor=cell_lines[k, :3] + shift,
            cell_direction=cell_lines[k, 3:],
        )
        for k in range(found)
    ]


def _new_search(
    points: FloatArray, corners: tuple[FloatArray, FloatArray], dx: float, num_directions: int
) -> Search:
    """Lay out a search over centred points; its arrays are filled by `start_search`."""
    plane, count = _voting_plane(corners, dx), len(points)
    eights = (count + 7) // 8 * 8
    return Search(
        points=points,
        plane=plane,
        progress=np.empty(2, np.int64),
        alive=np.empty(count, np.int64),
        left=np.empty((3, count)),
        shuffled=np.empty(count, np.int64),
        scaled=np.empty((3, eights), np.float32),
        heap=np.empty(num_directions, np.int64),
        keys=np.empty(num_directions, np.int64),
        rounds=np.empty(num_directions, np.int64),
        exact=np.empty(num_directions, np.bool_),
        cells=np.empty(eights, np.uint32),
        close=np.empty(count, np.int64),
        distances=np.empty(count),
        grid=np.zeros(plane.num_x * (plane.num_x + 2) + 1, np.uint32),
    )


def _voting_plane(corners: tuple[FloatArray, FloatArray], dx: float) -> Plane:
    low, high = corners[0].tolist(), corners[1].tolist()
    reach = max(math.sqrt(x * x + y * y + z * z) for x, y, z in (low, high))
    num_x = _cells_per_side(reach, dx)
    half_x, half_y, half_z = (
        (last - first) / (2.0 * dx) for first, last in zip(low, high, strict=True)
    )
    return Plane(
        reach=reach,
        dx=dx,
        num_x=num_x,
        centre=reach / dx,
        half_x=half_x,
        half_y=half_y,
        half_z=half_z,
        margin=_FLOAT32_ROUNDINGS * (num_x + 2),
    )


def _cells_per_side(reach: float, dx: float) -> int:
    cells = math.floor(2.0 * reach / dx + 0.5)
    if cells > MAX_CELLS_PER_SIDE:
        raise ConfigError(
            f"a cloud of {2.0 * reach:.4g} m has {cells:.4g} cells of {dx:.4g} m along one side, "
            f"limit {MAX_CELLS_PER_SIDE}; see detection.hough.dx and filtering.radii"
        )
    return int(cells)
