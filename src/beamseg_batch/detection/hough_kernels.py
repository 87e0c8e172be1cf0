"""Kernels of the exact, lazy Hough search; `hough` explains how they fit together."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.accelerate import kernel
from beamseg_batch.detection.hough_space import HoughSpace
from beamseg_batch.detection.line_fit_kernels import fit_line
from beamseg_batch.detection.voting_kernels import (
    Plane,
    exact_key,
    flat_index,
    pack_key,
    vote_bound,
    votes_of_key,
)
from beamseg_batch.geometry import FloatArray

__all__ = ["Search", "bounding_box", "find_lines", "start_search"]

_ROUNDING = 1e-14  # points nearer to one another than this share of the cloud are copies


class Search(NamedTuple):
    """One search: the cloud, its voting plane, what is left of it, and the heap.

    Attributes
    ----------
    points : (N, 3) float64, metres, centred
    plane : Plane
    progress : (2,) int64
        Number of the round, from 0, and how many points are left.
    alive : (N,) int64
        Indices of the points that are left, in order.
    left : (3, N) float64, metres
        Their coordinates, in that order.
    shuffled : (N,) int64
        Indices of the points that are left, in an order in which neighbours are far apart.
    scaled : (3, N8) float32
        Coordinates of `shuffled`, in cells; N8 is N or the next multiple of eight.
    heap : (D,) int64
        Directions, in heap order of their keys.
    keys : (D,) int64
        Upper bound of each direction's key, or the key itself.
    rounds : (D,) int64
        The round in which the bound was computed.
    exact : (D,) bool
        Whether the key is exact for that round.
    cells : (N8,) uint32
        Scratch: cell of each vote.
    close, distances : (N,) int64 and float64
        Scratch: points close to a line, and all distances to it.
    grid : (G,) uint32
        Votes of one direction; zero between calls. A few rows larger than the plane.
    """

    points: FloatArray
    plane: Plane
    progress: NDArray[np.int64]
    alive: NDArray[np.int64]
    left: FloatArray
    shuffled: NDArray[np.int64]
    scaled: NDArray[np.float32]
    heap: NDArray[np.int64]
    keys: NDArray[np.int64]
    rounds: NDArray[np.int64]
    exact: NDArray[np.bool_]
    cells: NDArray[np.uint32]
    close: NDArray[np.int64]
    distances: FloatArray
    grid: NDArray[np.uint32]


@kernel
def bounding_box(points: FloatArray) -> tuple[FloatArray, FloatArray, bool]:
    """Corners of the box around points.

    Parameters
    ----------
    points : (N, 3) float64, metres
        At least one.

    Returns
    -------
    low, high : (3,) float64, metres
    finite : bool
        Whether all coordinates are finite; the corners mean nothing if not.
    """
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    finite = True
    for k in range(len(points)):
        for axis in range(3):
            value = points[k, axis]
            finite &= np.isfinite(value)
            low[axis] = min(low[axis], value)
            high[axis] = max(high[axis], value)
    return low, high, finite


@kernel
def _sift_down(heap: NDArray[np.int64], keys: NDArray[np.int64], start: int) -> None:
    """Restore the heap after the key of the direction at `start` fell."""
    size = len(heap)
    item = heap[start]
    key = keys[item]
    hole = start
    while True:
        child = 2 * hole + 1
        if child >= size:
            break
        if child + 1 < size and keys[heap[child + 1]] > keys[heap[child]]:
            child += 1
        if keys[heap[child]] <= key:
            break
        heap[hole] = heap[child]
        hole = child
    heap[hole] = item


@kernel
def _common_divisor(first: int, second: int) -> int:
    while second:
        first, second = second, first % second
    return first


@kernel
def _bound_all(space: HoughSpace, search: Search) -> None:
    """Bound every direction that was not bounded in this round, and order them all."""
    rows, heap, keys = space.rows, search.heap, search.keys
    rounds, exact = search.rounds, search.exact
    scaled, plane, cells, grid = search.scaled, search.plane, search.cells, search.grid
    current, count = search.progress[0], search.progress[1]
    for index in range(len(heap)):
        heap[index] = index
        if rounds[index] < current:
            bound = pack_key(vote_bound(rows[index], scaled, count, plane, cells, grid), 0)
            keys[index], rounds[index], exact[index] = min(keys[index], bound), current, False
    for position in range(len(heap) // 2 - 1, -1, -1):
        _sift_down(heap, keys, position)


@kernel
def start_search(space: HoughSpace, search: Search) -> None:
    """Bound every direction and order them, the most promising on top.

    Parameters
    ----------
    space : HoughSpace
    search : Search
        With `points` and `plane` set; the rest is filled here.
    """
    num_points = len(search.points)
    # Points come sorted in space. A stride without common divisor visits all of them and
    # keeps neighbours, which vote for the same cell, apart: a count that was just
    # written is slow to read again.
    stride = int(0.382 * num_points) | 1
    while _common_divisor(stride, num_points) != 1:
        stride += 2
    for k in range(num_points):
        search.alive[k] = k
        search.shuffled[k] = (k * stride) % num_points
        for axis in range(3):
            search.left[axis, k] = search.points[k, axis]
            search.scaled[axis, k] = search.points[search.shuffled[k], axis] / search.plane.dx
    search.scaled[:, num_points:] = 0.0
    search.progress[0], search.progress[1] = 0, num_points
    search.keys[:] = pack_key(num_points, 0)
    search.rounds[:] = -1
    _bound_all(space, search)


@kernel
def _best_key(space: HoughSpace, search: Search) -> int:
    """Key of the most voted line among the points that are left.

    Removing points only takes votes away, and the cells that keep the old maximum are a
    subset of those that had it. So an old key is an upper bound of the new one, votes
    and tie-break both, and stays in its place of the heap until it comes to the top.
    There it is bounded anew if points were removed since, and counted exactly if not.
    Whatever is on top and exact for the present points beats all others.

    Among the last few points hardly any bound is still useful. Once many were renewed in
    a round it is quicker to renew the rest together than to move each down the heap.
    """
    rows, heap, keys = space.rows, search.heap, search.keys
    rounds, exact, left = search.rounds, search.exact, search.left
    scaled, plane, cells, grid = search.scaled, search.plane, search.cells, search.grid
    current, count = search.progress[0], search.progress[1]
    patience = len(heap) // 16
    while True:
        top = heap[0]
        if rounds[top] < current:
            if patience == 0:
                _bound_all(space, search)
                continue
            patience -= 1
            bound = pack_key(vote_bound(rows[top], scaled, count, plane, cells, grid), 0)
            keys[top], rounds[top], exact[top] = min(keys[top], bound), current, False
        elif exact[top]:
            return int(keys[top])
        else:
            keys[top] = exact_key(top, space.directions, rows[top], left, count, plane, cells, grid)
            exact[top] = True
        _sift_down(heap, keys, 0)


@kernel
def _line_of_key(space: HoughSpace, search: Search, key: int, line: FloatArray) -> int:
    """Write anchor and direction of a key's cell into `line`; return its votes."""
    plane, flat = search.plane, flat_index(key)
    cell, index = flat // len(space.directions), flat % len(space.directions)
    x = (cell // plane.num_x) * plane.dx - plane.reach
    y = (cell % plane.num_x) * plane.dx - plane.reach
    b = space.directions[index]
    # IPOL 2017, equation (3).
    line[0] = x * (1 - ((b[0] * b[0]) / (1 + b[2]))) - y * ((b[0] * b[1]) / (1 + b[2]))
    line[1] = x * (-((b[0] * b[1]) / (1 + b[2]))) + y * (1 - ((b[1] * b[1]) / (1 + b[2])))
    line[2] = -x * b[0] - y * b[1]
    for axis in range(3):
        line[3 + axis] = b[axis]
    return votes_of_key(key)


@kernel
def _collect(search: Search, line: FloatArray) -> int:
    """List the points within a cell's width of a line in `close`, in order.

    IPOL 2017, equation (7).
    """
    xs, ys, zs, alive = search.left[0], search.left[1], search.left[2], search.alive
    close, distances, reach = search.close, search.distances, search.plane.dx
    ax, ay, az, bx, by, bz = line[0], line[1], line[2], line[3], line[4], line[5]
    num_alive, count = search.progress[1], 0
    for k in range(num_alive):
        t = bx * (xs[k] - ax) + by * (ys[k] - ay) + bz * (zs[k] - az)
        x = xs[k] - (ax + t * bx)
        y = ys[k] - (ay + t * by)
        z = zs[k] - (az + t * bz)
        distances[k] = np.sqrt((x * x) + (y * y) + (z * z))
    for k in range(num_alive):
        close[count] = alive[k]
        count += distances[k] <= reach
    return count


@kernel
def _fit_cell(search: Search, minvotes: int, cell_line: FloatArray, line: FloatArray) -> int:
    """Collect, fit, collect, fit: the line of a cell, and how many points it has, or 0."""
    for part in range(6):
        line[part] = cell_line[part]
    count = 0
    for attempt in range(2):
        count = _collect(search, line)
        if count == 0 or (attempt == 1 and count < minvotes):
            return 0
        anchor, direction, eigenvalues = fit_line(search.points, search.close, count)
        if eigenvalues[0] <= count * (_ROUNDING * search.plane.reach) ** 2:
            return 0
        side = (
            direction[0] * cell_line[3] + direction[1] * cell_line[4] + direction[2] * cell_line[5]
        )
        # Element by element: numba compiles the assignment of a slice for seconds.
        for axis in range(3):
            line[axis] = anchor[axis]
            line[3 + axis] = direction[axis] if side >= 0.0 else -direction[axis]
    return count


@kernel
def _remove_close(search: Search, count: int) -> None:
    """Take the first points in `close` out of what is left, and begin a new round."""
    alive, left, shuffled, scaled = search.alive, search.left, search.shuffled, search.scaled
    taken = np.zeros(len(search.points), np.bool_)
    for k in range(count):
        taken[search.close[k]] = True
    first, second = 0, 0
    for k in range(search.progress[1]):
        alive[first], shuffled[second] = alive[k], shuffled[k]
        for axis in range(3):
            left[axis, first], scaled[axis, second] = left[axis, k], scaled[axis, k]
        first += not taken[alive[first]]
        second += not taken[shuffled[second]]
    search.progress[0] += 1
    search.progress[1] = first


@kernel
def find_lines(
    space: HoughSpace,
    search: Search,
    minvotes: int,
    votes: NDArray[np.int64],
    counts: NDArray[np.int64],
    members: NDArray[np.int64],
    cell_lines: FloatArray,
    lines: FloatArray,
) -> int:
    """Find the next lines, taking the points of each away.

    Parameters
    ----------
    space : HoughSpace
    search : Search
        As `start_search` left it, or an earlier call of this function.
    minvotes : int
        The search ends at the first line with fewer points.
    votes, counts : (L,) int64
        Filled with the votes of each winning cell and the number of points of its line.
    members : (N,) int64
        Filled with the points of the lines, one line after the other.
    cell_lines, lines : (L, 6) float64, metres
        Filled with anchor and direction of each winning cell, and of its fitted line.

    Returns
    -------
    int
        How many lines were found; fewer than L when there are no more.

    Notes
    -----
    Dalitz et al., IPOL 2017, algorithm 1.
    """
    filled = 0
    for found in range(len(votes)):
        if search.progress[1] < minvotes:
            return found
        votes[found] = _line_of_key(space, search, _best_key(space, search), cell_lines[found])
        count = _fit_cell(search, minvotes, cell_lines[found], lines[found])
        if count == 0:
            return found
        counts[found] = count
        for k in range(count):
            members[filled + k] = search.close[k]
        filled += count
        _remove_close(search, count)
    return len(votes)
