"""Kernels of the exact, lazy Hough search; `hough` explains how they fit together.

A direction's votes are counted in a small grid of its own, which stays in the L1
cache. A *key* packs (votes, flat index) into one integer whose order is the order in
which the published program prefers lines: most votes first, then lowest flat index
``(x * num_x + y) * num_directions + direction``.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.accelerate import kernel
from beamseg_batch.geometry import FloatArray

__all__ = ["HoughSpace", "Search", "fit_line", "grid_coordinates", "next_line", "start_search"]

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
    margin : float32
        Reach of rounding errors in a float32 coordinate, in cells.
    alive : (N,) int64
        Indices of the points that are left, in order.
    shuffled : (N,) int64
        The same in an order in which neighbours are far apart.
    xs, ys, zs : (N,) float32
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
    grid : (num_x * (num_x + 2) + 1,) uint16 or uint32
        Votes of one direction; zero between calls. One row longer than the plane, since
        the largest coordinates reach past it.
    """

    points: FloatArray
    reach: float
    dx: float
    num_x: int
    margin: np.float32
    alive: NDArray[np.int64]
    shuffled: NDArray[np.int64]
    xs: NDArray[np.float32]
    ys: NDArray[np.float32]
    zs: NDArray[np.float32]
    heap: NDArray[np.int64]
    keys: NDArray[np.int64]
    rounds: NDArray[np.int64]
    exact: NDArray[np.bool_]
    cells: NDArray[np.uint32]
    close: NDArray[np.int64]
    grid: NDArray[Any]


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
def _exact_key(space: HoughSpace, search: Search, index: int, num_alive: int) -> int:
    """Key of a direction, each vote placed in float64 as the published program does.

    A cell index ``y = num_x`` is not out of bounds there: only the flat index is
    checked, so such a vote falls into the first cell of the next row. The grid is flat
    for that reason. ``x = num_x`` lies past its end and does not count.
    """
    direction, cells, grid = space.directions[index], search.cells, search.grid
    num_cells = search.num_x * search.num_x
    for k in range(num_alive):
        x, y = grid_coordinates(direction, search.points[search.alive[k]])
        cell_x = int(np.floor((x + search.reach) / search.dx + 0.5))
        cell_y = int(np.floor((y + search.reach) / search.dx + 0.5))
        cells[k] = cell_x * search.num_x + cell_y
        grid[cells[k]] += 1
    most, best = np.int64(0), np.int64(0)
    for k in range(num_alive):
        cell, votes = np.int64(cells[k]), np.int64(grid[cells[k]])
        if cell < num_cells and (votes > most or (votes == most and cell < best)):
            most, best = votes, cell
    for k in range(num_alive):
        grid[cells[k]] = 0
    return _pack(int(most), int(best) * len(space.directions) + index)


@kernel
def _place_votes(
    row: NDArray[np.float32],
    search: Search,
    num_alive: int,
) -> int:
    """Write the cell of each vote, placed in float32; count those too near an edge.

    The loop is made to become vector code of eight points at a time: no grid, no call,
    32-bit counts, and rounding by adding and subtracting 1.5 * 2**23, whose last bit is
    one.
    """
    xs, ys, zs, cells = search.xs, search.ys, search.zs, search.cells
    xx, xy, xz, yy, yz = row[0], row[1], row[2], row[3], row[4]
    centre = np.float32(search.reach / search.dx)
    width = np.float32(search.num_x)
    certain = np.float32(0.5) - search.margin
    rounder = np.float32(12582912.0)
    uncertain = np.int32(0)
    for k in range(num_alive):
        x = (xx * xs[k] + xy * ys[k]) + (xz * zs[k] + centre)
        y = (xy * xs[k] + yy * ys[k]) + (yz * zs[k] + centre)
        cell_x, cell_y = (x + rounder) - rounder, (y + rounder) - rounder
        off = max(abs(x - cell_x), abs(y - cell_y))
        uncertain = np.int32(uncertain + np.int32(off > certain))
        cells[k] = np.uint32(np.int32(cell_x * width + cell_y))
    return int(uncertain)


@kernel
def _most_and_clear(grid: NDArray[Any]) -> int:
    """Largest count of a grid, which is zero afterwards."""
    most = grid[0]
    for cell in range(len(grid)):
        votes = grid[cell]
        grid[cell] = 0
        most = max(most, votes)
    return int(most)


@kernel
def _vote_bound(space: HoughSpace, search: Search, index: int, num_alive: int) -> int:
    """Upper bound of a direction's votes, from votes placed in float32.

    A vote nearer than `margin` to the edge of its cell may belong to the next one. With
    ``u`` such votes no cell holds more than ``most + u``.
    """
    cells, grid = search.cells, search.grid
    uncertain = _place_votes(space.rows[index], search, num_alive)
    if len(grid) <= 32 * num_alive:
        for k in range(num_alive):
            grid[cells[k]] += 1
        return _most_and_clear(grid) + uncertain
    # Few votes on a large grid: look at the cells that were voted for.
    most = 0
    for k in range(num_alive):
        grid[cells[k]] += 1
        most = max(most, int(grid[cells[k]]))
    for k in range(num_alive):
        grid[cells[k]] = 0
    return most + uncertain


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
def _place_shuffled(search: Search, num_alive: int) -> None:
    """Refresh the float32 coordinates of the points that are left."""
    for k in range(num_alive):
        p = search.points[search.shuffled[k]]
        search.xs[k] = p[0] / search.dx
        search.ys[k] = p[1] / search.dx
        search.zs[k] = p[2] / search.dx


@kernel
def _common_divisor(first: int, second: int) -> int:
    while second:
        first, second = second, first % second
    return first


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
    stride = num_points // 2 | 1
    while _common_divisor(stride, num_points) != 1:
        stride += 2
    for k in range(num_points):
        search.alive[k] = k
        search.shuffled[k] = (k * stride) % num_points
    _place_shuffled(search, num_points)
    search.rounds[:] = 0
    search.exact[:] = False
    for index in range(len(search.heap)):
        search.keys[index] = _pack(_vote_bound(space, search, index, num_points), 0)
        search.heap[index] = index
    for position in range(len(search.heap) // 2 - 1, -1, -1):
        _sift_down(search.heap, search.keys, position)


@kernel
def _best_key(space: HoughSpace, search: Search, current: int, num_alive: int) -> int:
    """Key of the most voted line among the points that are left.

    Removing points only takes votes away, and the cells that keep the old maximum are a
    subset of those that had it. So an old key is an upper bound of the new one, votes
    and tie-break both, and stays in its place of the heap until it comes to the top.
    There it is bounded anew if points were removed since, and counted exactly if not.
    Whatever is on top and exact for the present points beats all others.
    """
    heap, keys, rounds, exact = search.heap, search.keys, search.rounds, search.exact
    while True:
        top = heap[0]
        if rounds[top] < current:
            bound = _pack(_vote_bound(space, search, top, num_alive), 0)
            keys[top] = min(keys[top], bound)
            rounds[top], exact[top] = current, False
        elif exact[top]:
            return int(keys[top])
        else:
            keys[top] = _exact_key(space, search, top, num_alive)
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
def _collect(search: Search, num_alive: int, anchor: FloatArray, direction: FloatArray) -> int:
    """List the points within `dx` of a line in `close`, in order (IPOL 2017, equation (7))."""
    count = 0
    for k in range(num_alive):
        p = search.points[search.alive[k]]
        t = (
            direction[0] * (p[0] - anchor[0])
            + direction[1] * (p[1] - anchor[1])
            + direction[2] * (p[2] - anchor[2])
        )
        x = p[0] - (anchor[0] + t * direction[0])
        y = p[1] - (anchor[1] + t * direction[1])
        z = p[2] - (anchor[2] + t * direction[2])
        if np.sqrt((x * x) + (y * y) + (z * z)) <= search.dx:
            search.close[count] = search.alive[k]
            count += 1
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
def _rotate(matrix: FloatArray, vectors: FloatArray, p: int, q: int) -> None:
    """Zero one off-diagonal element of a symmetric 3x3 matrix by a plane rotation."""
    if matrix[p, q] == 0.0:
        return
    theta = (matrix[q, q] - matrix[p, p]) / (2.0 * matrix[p, q])
    tangent = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
    if theta < 0.0:
        tangent = -tangent
    cosine = 1.0 / np.sqrt(tangent * tangent + 1.0)
    sine = tangent * cosine
    for k in range(3):
        matrix[k, p], matrix[k, q] = (
            cosine * matrix[k, p] - sine * matrix[k, q],
            sine * matrix[k, p] + cosine * matrix[k, q],
        )
    for k in range(3):
        matrix[p, k], matrix[q, k] = (
            cosine * matrix[p, k] - sine * matrix[q, k],
            sine * matrix[p, k] + cosine * matrix[q, k],
        )
        vectors[k, p], vectors[k, q] = (
            cosine * vectors[k, p] - sine * vectors[k, q],
            sine * vectors[k, p] + cosine * vectors[k, q],
        )


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
    Sums run in the order of the points. The eigenvalues come from cyclic Jacobi
    rotations (Golub and Van Loan, section 8.5), which for 3x3 need at most six sweeps
    and give the same bits on every machine, which a LAPACK does not.
    """
    anchor, scatter, vectors = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
    for axis in range(3):
        for k in range(count):
            anchor[axis] += points[indices[k], axis]
        anchor[axis] /= count
        vectors[axis, axis] = 1.0
    for k in range(count):
        for row in range(3):
            for column in range(3):
                scatter[row, column] += (points[indices[k], row] - anchor[row]) * (
                    points[indices[k], column] - anchor[column]
                )
    for _ in range(12):
        if scatter[0, 1] == 0.0 and scatter[0, 2] == 0.0 and scatter[1, 2] == 0.0:
            break
        _rotate(scatter, vectors, 0, 1)
        _rotate(scatter, vectors, 0, 2)
        _rotate(scatter, vectors, 1, 2)
    first, second, third = 0, 1, 2
    if scatter[second, second] > scatter[first, first]:
        first, second = second, first
    if scatter[third, third] > scatter[second, second]:
        second, third = third, second
    if scatter[second, second] > scatter[first, first]:
        first, second = second, first
    direction, eigenvalues = np.empty(3), np.empty(3)
    length = np.sqrt(vectors[0, first] ** 2 + vectors[1, first] ** 2 + vectors[2, first] ** 2)
    for axis in range(3):
        direction[axis] = vectors[axis, first] / length
    eigenvalues[0], eigenvalues[1] = scatter[first, first], scatter[second, second]
    eigenvalues[2] = scatter[third, third]
    return anchor, direction, eigenvalues


@kernel
def next_line(
    space: HoughSpace,
    search: Search,
    current: int,
    num_alive: int,
    minvotes: int,
    cell_line: FloatArray,
    line: FloatArray,
) -> tuple[int, int, int]:
    """Find the next line and take its points away.

    Parameters
    ----------
    space : HoughSpace
    search : Search
        As `start_search` left it, or this function in the round before.
    current : int
        Number of this round, from 0.
    num_alive : int
        How many points are left.
    minvotes : int
        Fewest points of a line.
    cell_line, line : (6,) float64, metres
        Filled with anchor and direction of the winning cell, and of the fitted line.

    Returns
    -------
    votes : int
        Votes of the winning cell.
    count : int
        Points of the line, whose indices are the first in `search.close`; 0 when there
        is no line any more.
    num_alive : int
        How many points are left now.

    Notes
    -----
    Dalitz et al., IPOL 2017, algorithm 1: vote, collect, fit, collect, fit.
    """
    votes = _line_of_key(space, search, _best_key(space, search, current, num_alive), cell_line)
    for part in range(6):
        line[part] = cell_line[part]
    count = 0
    for attempt in range(2):
        count = _collect(search, num_alive, line[:3], line[3:])
        if count == 0 or (attempt == 1 and count < minvotes):
            return votes, 0, num_alive
        anchor, direction, eigenvalues = fit_line(search.points, search.close, count)
        if eigenvalues[0] <= count * (_ROUNDING * search.reach) ** 2:
            return votes, 0, num_alive
        side = (
            direction[0] * cell_line[3] + direction[1] * cell_line[4] + direction[2] * cell_line[5]
        )
        # Element by element: numba compiles the assignment of a slice for seconds.
        for axis in range(3):
            line[axis] = anchor[axis]
            line[3 + axis] = direction[axis] if side >= 0.0 else -direction[axis]
    taken = np.zeros(len(search.points), np.bool_)
    for k in range(count):
        taken[search.close[k]] = True
    _without(search.shuffled, num_alive, taken)
    left = _without(search.alive, num_alive, taken)
    _place_shuffled(search, left)
    return votes, count, left
