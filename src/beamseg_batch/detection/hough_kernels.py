"""Kernels of the exact, lazy Hough search; `hough` explains how they fit together.

A direction's votes are counted in a small grid of its own, which stays in the L1
cache. A *key* packs (votes, flat index) into one integer whose order is the order in
which the published program prefers lines: most votes first, then lowest flat index
``(x * num_x + y) * num_directions + direction``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.accelerate import kernel
from beamseg_batch.detection.line_fit_kernels import fit_line
from beamseg_batch.geometry import FloatArray

__all__ = [
    "HoughSpace",
    "Search",
    "bounding_box",
    "find_lines",
    "grid_coordinates",
    "start_search",
]

_FLAT_BITS = 39  # a flat index up to 4000 * 4000 * 20481 below, votes up to 2**24 above
_FLAT_MASK = (1 << _FLAT_BITS) - 1

_ROUNDING = 1e-14  # points nearer to one another than this share of the cloud are copies


class HoughSpace(NamedTuple):
    """The directions, the same for every cloud.

    Attributes
    ----------
    directions : (D, 3) float64, unit vectors with z >= 0
    rows : (D, 5) float32
        Coefficients ``xx, xy, xz, yy, yz`` of a direction's grid coordinates.
    """

    directions: FloatArray
    rows: NDArray[np.float32]


class Search(NamedTuple):
    """One search: the cloud, its voting plane, what is left of it, and the heap.

    Attributes
    ----------
    points : (N, 3) float64, metres, centred
    reach, dx : float, metres
        Half the side of the voting plane, and the width of a cell.
    num_x : int
        Cells along one side.
    margin : float
        Reach of rounding errors in a float32 coordinate, in cells.
    progress : (2,) int64
        Number of the round, from 0, and how many points are left.
    alive : (N,) int64
        Indices of the points that are left, in order.
    shuffled : (N,) int64
        The same in an order in which neighbours are far apart.
    scaled : (3, N) float32
        Coordinates of `shuffled`, in cells.
    heap : (D,) int64
        Directions, in heap order of their keys.
    keys : (D,) int64
        Upper bound of each direction's key, or the key itself.
    rounds : (D,) int64
        The round in which the bound was computed.
    exact : (D,) bool
        Whether the key is exact for that round.
    cells, close : (N,) uint32 and (N,) int64
        Scratch: cell of each vote, and points close to a line.
    grid : (num_x * (num_x + 2) + 1,) uint32
        Votes of one direction; zero between calls. More than one row longer than the
        plane, since the largest coordinates reach past it.
    """

    points: FloatArray
    reach: float
    dx: float
    num_x: int
    margin: float
    progress: NDArray[np.int64]
    alive: NDArray[np.int64]
    shuffled: NDArray[np.int64]
    scaled: NDArray[np.float32]
    heap: NDArray[np.int64]
    keys: NDArray[np.int64]
    rounds: NDArray[np.int64]
    exact: NDArray[np.bool_]
    cells: NDArray[np.uint32]
    close: NDArray[np.int64]
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
def _pack(votes: int, flat: int) -> int:
    return (votes << _FLAT_BITS) | (_FLAT_MASK - flat)


@kernel
def grid_coordinates(direction: FloatArray, point: FloatArray) -> tuple[float, float]:
    """Foot of a point on the plane normal to a direction, in that plane's coordinates.

    Parameters
    ----------
    direction : (3,) float64, unit vector with z >= 0
    point : (3,) float64, metres

    Returns
    -------
    x, y : float, metres

    Notes
    -----
    Dalitz et al., IPOL 2017, equation (2), in the order of operations of the published
    program: a vote at the edge of a cell depends on the last bit.
    """
    bx, by, bz = direction[0], direction[1], direction[2]
    beta = 1.0 / (1.0 + bz)
    x = ((1.0 - (beta * (bx * bx))) * point[0]) - ((beta * (bx * by)) * point[1]) - (bx * point[2])
    y = ((-beta * (bx * by)) * point[0]) + ((1.0 - (beta * (by * by))) * point[1]) - (by * point[2])
    return x, y


@kernel
def _exact_key(
    index: int,
    directions: FloatArray,
    points: FloatArray,
    alive: NDArray[np.int64],
    num_alive: int,
    reach: float,
    dx: float,
    num_x: int,
    cells: NDArray[np.uint32],
    grid: NDArray[np.uint32],
) -> int:
    """Key of a direction, each vote placed in float64 as the published program does.

    A cell index ``y = num_x`` is not out of bounds there: only the flat index is
    checked, so such a vote falls into the first cell of the next row. The grid is flat
    for that reason. ``x = num_x`` lies past its end and does not count.
    """
    num_cells = num_x * num_x
    for k in range(num_alive):
        x, y = grid_coordinates(directions[index], points[alive[k]])
        cell_x = int(np.floor((x + reach) / dx + 0.5))
        cell_y = int(np.floor((y + reach) / dx + 0.5))
        cells[k] = cell_x * num_x + cell_y
        grid[cells[k]] += 1
    most, best = 0, 0
    for k in range(num_alive):
        cell, votes = int(cells[k]), int(grid[cells[k]])
        if cell < num_cells and (votes > most or (votes == most and cell < best)):
            most, best = votes, cell
    for k in range(num_alive):
        grid[cells[k]] = 0
    return _pack(most, best * len(directions) + index)


@kernel(contract=True)
def _place_votes(
    row: NDArray[np.float32],
    scaled: NDArray[np.float32],
    num_alive: int,
    centre: float,
    margin: float,
    num_x: int,
    cells: NDArray[np.uint32],
) -> int:
    """Write the cell of each vote, placed in float32; count those too near an edge.

    The loop is made to become vector code of eight points at a time: no grid, no call,
    32-bit counts, and rounding by adding and subtracting 1.5 * 2**23, whose last bit is
    one. A fused product and sum rounds once instead of twice, which `margin` allows for.
    """
    xs, ys, zs = scaled[0], scaled[1], scaled[2]
    xx, xy, xz, yy, yz = row[0], row[1], row[2], row[3], row[4]
    offset, width = np.float32(centre), np.float32(num_x)
    certain = np.float32(0.5 - margin)
    rounder = np.float32(12582912.0)
    uncertain = np.int32(0)
    for k in range(num_alive):
        x = (xx * xs[k] + xy * ys[k]) + (xz * zs[k] + offset)
        y = (xy * xs[k] + yy * ys[k]) + (yz * zs[k] + offset)
        cell_x, cell_y = (x + rounder) - rounder, (y + rounder) - rounder
        off = max(abs(x - cell_x), abs(y - cell_y))
        uncertain = np.int32(uncertain + np.int32(off > certain))
        cells[k] = np.uint32(np.int32(cell_x * width + cell_y))
    return int(uncertain)


@kernel
def _most_and_clear(grid: NDArray[np.uint32]) -> int:
    """Largest count of a grid, which is zero afterwards."""
    most = grid[0]
    for cell in range(len(grid)):
        votes = grid[cell]
        grid[cell] = 0
        most = max(most, votes)
    return int(most)


@kernel
def _vote_bound(
    row: NDArray[np.float32],
    scaled: NDArray[np.float32],
    num_alive: int,
    centre: float,
    margin: float,
    num_x: int,
    cells: NDArray[np.uint32],
    grid: NDArray[np.uint32],
) -> int:
    """Upper bound of a direction's votes, from votes placed in float32.

    A vote nearer than `margin` to the edge of its cell may belong to the next one. With
    ``u`` such votes no cell holds more than ``most + u``.
    """
    uncertain = _place_votes(row, scaled, num_alive, centre, margin, num_x, cells)
    # 32-bit counts: processors read a word that was just written faster than a half-word.
    if len(grid) <= 16 * num_alive:
        for k in range(num_alive):
            grid[cells[k]] += np.uint32(1)
        return _most_and_clear(grid) + uncertain
    # Few votes on a large grid: look at the cells that were voted for.
    most = np.uint32(0)
    for k in range(num_alive):
        votes = grid[cells[k]] + np.uint32(1)
        grid[cells[k]] = votes
        most = max(most, votes)
    for k in range(num_alive):
        grid[cells[k]] = 0
    return int(most) + uncertain


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
def _place_shuffled(search: Search) -> None:
    """Refresh the float32 coordinates of the points that are left."""
    points, shuffled, scaled = search.points, search.shuffled, search.scaled
    for k in range(search.progress[1]):
        for axis in range(3):
            scaled[axis, k] = points[shuffled[k], axis] / search.dx


@kernel
def _common_divisor(first: int, second: int) -> int:
    while second:
        first, second = second, first % second
    return first


@kernel
def _bound_all(space: HoughSpace, search: Search) -> None:
    """Bound every direction that was not bounded in this round, and order them all."""
    heap, keys, rounds, exact = search.heap, search.keys, search.rounds, search.exact
    rows, scaled, cells, grid = space.rows, search.scaled, search.cells, search.grid
    centre, margin, num_x = search.reach / search.dx, search.margin, search.num_x
    current, num_alive = search.progress[0], search.progress[1]
    for index in range(len(heap)):
        heap[index] = index
        if rounds[index] < current:
            bound = _vote_bound(rows[index], scaled, num_alive, centre, margin, num_x, cells, grid)
            keys[index] = min(keys[index], _pack(bound, 0))
            rounds[index], exact[index] = current, False
    for position in range(len(heap) // 2 - 1, -1, -1):
        _sift_down(heap, keys, position)


@kernel
def start_search(space: HoughSpace, search: Search) -> None:
    """Bound every direction and order them, the most promising on top.

    Parameters
    ----------
    space : HoughSpace
    search : Search
        With `points` and the voting plane set; the rest is filled here.
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
    search.progress[0], search.progress[1] = 0, num_points
    _place_shuffled(search)
    search.keys[:] = _pack(num_points, 0)
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
    heap, keys, rounds, exact = search.heap, search.keys, search.rounds, search.exact
    rows, scaled, cells, grid = space.rows, search.scaled, search.cells, search.grid
    centre, margin, num_x = search.reach / search.dx, search.margin, search.num_x
    current, num_alive = search.progress[0], search.progress[1]
    patience = len(heap) // 16
    while True:
        top = heap[0]
        if rounds[top] < current:
            if patience == 0:
                _bound_all(space, search)
                continue
            patience -= 1
            bound = _vote_bound(rows[top], scaled, num_alive, centre, margin, num_x, cells, grid)
            keys[top] = min(keys[top], _pack(bound, 0))
            rounds[top], exact[top] = current, False
        elif exact[top]:
            return int(keys[top])
        else:
            keys[top] = _exact_key(
                top, space.directions, search.points, search.alive, num_alive,
                search.reach, search.dx, num_x, cells, grid,
            )  # fmt: skip
            exact[top] = True
        _sift_down(heap, keys, 0)


@kernel
def _line_of_key(space: HoughSpace, search: Search, key: int, line: FloatArray) -> int:
    """Write anchor and direction of a key's cell into `line`; return its votes."""
    flat = _FLAT_MASK - (key & _FLAT_MASK)
    cell, index = flat // len(space.directions), flat % len(space.directions)
    x = (cell // search.num_x) * search.dx - search.reach
    y = (cell % search.num_x) * search.dx - search.reach
    b = space.directions[index]
    # IPOL 2017, equation (3).
    line[0] = x * (1 - ((b[0] * b[0]) / (1 + b[2]))) - y * ((b[0] * b[1]) / (1 + b[2]))
    line[1] = x * (-((b[0] * b[1]) / (1 + b[2]))) + y * (1 - ((b[1] * b[1]) / (1 + b[2])))
    line[2] = -x * b[0] - y * b[1]
    for axis in range(3):
        line[3 + axis] = b[axis]
    return key >> _FLAT_BITS


@kernel
def _collect(
    points: FloatArray,
    alive: NDArray[np.int64],
    num_alive: int,
    line: FloatArray,
    reach: float,
    close: NDArray[np.int64],
) -> int:
    """List the points within reach of a line in `close`, in order (IPOL 2017, equation (7))."""
    count = 0
    for k in range(num_alive):
        p = points[alive[k]]
        t = line[3] * (p[0] - line[0]) + line[4] * (p[1] - line[1]) + line[5] * (p[2] - line[2])
        x = p[0] - (line[0] + t * line[3])
        y = p[1] - (line[1] + t * line[4])
        z = p[2] - (line[2] + t * line[5])
        if np.sqrt((x * x) + (y * y) + (z * z)) <= reach:
            close[count] = alive[k]
            count += 1
    return count


@kernel
def _fit_cell(search: Search, minvotes: int, cell_line: FloatArray, line: FloatArray) -> int:
    """Collect, fit, collect, fit: the line of a cell, and how many points it has, or 0."""
    for part in range(6):
        line[part] = cell_line[part]
    count = 0
    for attempt in range(2):
        count = _collect(
            search.points, search.alive, search.progress[1], line, search.dx, search.close
        )
        if count == 0 or (attempt == 1 and count < minvotes):
            return 0
        anchor, direction, eigenvalues = fit_line(search.points, search.close, count)
        if eigenvalues[0] <= count * (_ROUNDING * search.reach) ** 2:
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
def _without(indices: NDArray[np.int64], count: int, taken: NDArray[np.bool_]) -> int:
    """Move the indices that are not taken to the front; return how many they are."""
    left = 0
    for k in range(count):
        if not taken[indices[k]]:
            indices[left] = indices[k]
            left += 1
    return left


@kernel
def _remove_close(search: Search, count: int) -> None:
    """Take the first points in `close` out of what is left, and begin a new round."""
    taken = np.zeros(len(search.points), np.bool_)
    for k in range(count):
        taken[search.close[k]] = True
    num_alive = search.progress[1]
    _without(search.shuffled, num_alive, taken)
    search.progress[1] = _without(search.alive, num_alive, taken)
    search.progress[0] += 1
    _place_shuffled(search)


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
        if search.progress[1] < 2:
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
