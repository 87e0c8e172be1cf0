"""Kernels that count the votes of one direction: a bound in float32, or exactly.

A direction's votes are counted in a small grid of its own, which stays in the L1 cache.
A *key* packs (votes, flat index) into one integer whose order is the order in which the
published program prefers lines: most votes first, then lowest flat index
``(x * num_x + y) * num_directions + direction``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.accelerate import kernel
from beamseg_batch.geometry import FloatArray

__all__ = [
    "Plane",
    "exact_key",
    "flat_index",
    "grid_coordinates",
    "pack_key",
    "vote_bound",
    "votes_of_key",
]

_FLAT_BITS = 39  # a flat index up to 4000 * 4000 * 20481 below, votes up to 2**24 above
_FLAT_MASK = (1 << _FLAT_BITS) - 1

_CELLS_PER_VOTE = 16  # a grid with more cells than this is not looked at as a whole


class Plane(NamedTuple):
    """The voting plane of a cloud, the same for every direction.

    Attributes
    ----------
    reach, dx : float, metres
        Half the side of the plane, and the width of a cell.
    num_x : int
        Cells along one side.
    centre : float
        ``reach / dx``: the cloud's centre, in cells.
    half_x, half_y, half_z : float
        Half the cloud's extents, in cells.
    margin : float
        Reach of rounding errors in a float32 coordinate, in cells.
    """

    reach: float
    dx: float
    num_x: int
    centre: float
    half_x: float
    half_y: float
    half_z: float
    margin: float


@kernel
def pack_key(votes: int, flat: int) -> int:
    """Key of a cell with so many votes."""
    return (votes << _FLAT_BITS) | (_FLAT_MASK - flat)


@kernel
def votes_of_key(key: int) -> int:
    """Votes of a key."""
    return key >> _FLAT_BITS


@kernel
def flat_index(key: int) -> int:
    """Flat index of a key."""
    return _FLAT_MASK - (key & _FLAT_MASK)


@kernel
def grid_coordinates(
    bx: float, by: float, bz: float, px: float, py: float, pz: float
) -> tuple[float, float]:
    """Foot of a point on the plane normal to a direction, in that plane's coordinates.

    Parameters
    ----------
    bx, by, bz : float
        Direction, a unit vector with z >= 0.
    px, py, pz : float, metres

    Returns
    -------
    x, y : float, metres

    Notes
    -----
    Dalitz et al., IPOL 2017, equation (2), in the order of operations of the published
    program: a vote at the edge of a cell depends on the last bit.
    """
    beta = 1.0 / (1.0 + bz)
    x = ((1.0 - (beta * (bx * bx))) * px) - ((beta * (bx * by)) * py) - (bx * pz)
    y = ((-beta * (bx * by)) * px) + ((1.0 - (beta * (by * by))) * py) - (by * pz)
    return x, y


@kernel
def _cells_reached(row: NDArray[np.float32], plane: Plane, size: int) -> tuple[int, int]:
    """First cell, and cell past the last, of the rows of the grid that the cloud can reach.

    The box around the cloud casts a shadow on the axis x of the plane. Rounding moves a
    vote by less than a row, and the published program's y = num_x is one row further.
    """
    half = abs(row[0]) * plane.half_x + abs(row[1]) * plane.half_y + abs(row[2]) * plane.half_z
    first = max(int(plane.centre - half) - 1, 0) * plane.num_x
    return first, min((int(plane.centre + half) + 4) * plane.num_x, size)


@kernel
def exact_key(
    index: int,
    directions: FloatArray,
    row: NDArray[np.float32],
    left: FloatArray,
    count: int,
    plane: Plane,
    cells: NDArray[np.uint32],
    grid: NDArray[np.uint32],
) -> int:
    """Key of a direction, each vote placed in float64 as the published program does.

    Parameters
    ----------
    index : int
        The direction.
    directions : (D, 3) float64, unit vectors
    row : (5,) float32
        The direction's coefficients, to know which part of the grid to look at.
    left : (3, N) float64, metres
        The points that are left; the first `count` count.
    count : int
    plane : Plane
    cells, grid : uint32
        Scratch; the grid is zero before and after.

    Returns
    -------
    int

    Notes
    -----
    A cell index ``y = num_x`` is not out of bounds in the published program: only the
    flat index is checked, so such a vote falls into the first cell of the next row. The
    grid is flat for that reason. ``x = num_x`` lies past its end and does not count.
    """
    bx, by, bz = directions[index]
    xs, ys, zs = left[0], left[1], left[2]
    reach, dx, width = plane.reach, plane.dx, float(plane.num_x)
    for k in range(count):
        x, y = grid_coordinates(bx, by, bz, xs[k], ys[k], zs[k])
        cell_x, cell_y = np.floor((x + reach) / dx + 0.5), np.floor((y + reach) / dx + 0.5)
        cells[k] = np.uint32(np.int32(cell_x * width + cell_y))
    for k in range(count):
        grid[cells[k]] += np.uint32(1)
    first, last = _cells_reached(row, plane, plane.num_x * plane.num_x)
    most, best = grid[first], first
    for cell in range(np.uint64(first), np.uint64(last)):
        most = max(most, grid[cell])
    while grid[best] != most:
        best += 1
    best = best if most > 0 else 0
    for k in range(count):
        grid[cells[k]] = 0
    return pack_key(int(most), best * len(directions) + index)


@kernel(contract=True)
def _place_votes(
    row: NDArray[np.float32],
    scaled: NDArray[np.float32],
    count: int,
    plane: Plane,
    cells: NDArray[np.uint32],
) -> int:
    """Write the cell of each vote, placed in float32; count those too near an edge.

    The loop is made to become vector code of eight points at a time: no grid, no call,
    32-bit counts, and whole eights, since the few points after them would take as long
    again: what lies past the last point is placed too, and never counted. A fused product
    and sum rounds once instead of twice, which the margin allows for.
    """
    xs, ys, zs = scaled[0], scaled[1], scaled[2]
    xx, xy, xz, yy, yz = row[0], row[1], row[2], row[3], row[4]
    offset, width = np.float32(plane.centre), np.float32(plane.num_x)
    certain = np.float32(0.5 - plane.margin)
    uncertain = np.int32(0)
    for k in range((count + 7) & ~7):
        x = xx * xs[k] + (xy * ys[k] + (xz * zs[k] + offset))
        y = xy * xs[k] + (yy * ys[k] + (yz * zs[k] + offset))
        cell_x, cell_y = np.rint(x), np.rint(y)
        off = max(abs(x - cell_x), abs(y - cell_y))
        uncertain = np.int32(uncertain + np.int32(off > certain))
        cells[k] = np.uint32(np.int32(cell_x * width + cell_y))
    return int(uncertain)


@kernel
def _most_and_clear(grid: NDArray[np.uint32], first: int, last: int) -> int:
    """Largest count of a part of the grid, which is zero afterwards."""
    most = np.uint32(0)
    # Unsigned numbers: one that may be negative counts from the end, which costs a test.
    for cell in range(np.uint64(first), np.uint64(last)):
        votes = grid[cell]
        grid[cell] = 0
        most = max(most, votes)
    return int(most)


@kernel
def vote_bound(
    row: NDArray[np.float32],
    scaled: NDArray[np.float32],
    count: int,
    plane: Plane,
    cells: NDArray[np.uint32],
    grid: NDArray[np.uint32],
) -> int:
    """Upper bound of a direction's votes, from votes placed in float32.

    Parameters
    ----------
    row : (5,) float32
        The direction's coefficients.
    scaled : (3, N) float32
        The points that are left, in cells; the first `count` count. N is a multiple of
        eight.
    count : int
    plane : Plane
    cells, grid : uint32
        Scratch, one as long as `scaled`; the grid is zero before and after.

    Returns
    -------
    int

    Notes
    -----
    A vote nearer than the margin to the edge of its cell may belong to the next one.
    With ``u`` such votes no cell holds more than the fullest one and ``u``.
    """
    uncertain = _place_votes(row, scaled, count, plane, cells)
    first, last = _cells_reached(row, plane, len(grid))
    # 32-bit counts: processors read a word that was just written faster than a half-word.
    if last - first <= _CELLS_PER_VOTE * count:
        for k in range(count):
            grid[cells[k]] += np.uint32(1)
        return _most_and_clear(grid, first, last) + uncertain
    # Few votes on a large grid: look at the cells that were voted for.
    most = np.uint32(0)
    for k in range(count):
        votes = grid[cells[k]] + np.uint32(1)
        grid[cells[k]] = votes
        most = max(most, votes)
    for k in range(count):
        grid[cells[k]] = 0
    return int(most) + uncertain
