"""The published search in numpy: one dense accumulator, all directions at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.detection.directions import hemisphere_directions

__all__ = ["dense_numpy"]


def dense_numpy(
    points: NDArray[np.float64],
    *,
    dx: float,
    granularity: int = 4,
    minvotes: int = 2,
    nlines: int = 0,
) -> list[NDArray[np.int64]]:
    """Find lines as a person would who knows numpy well.

    Parameters
    ----------
    points : (N, 3) float64, metres
    dx : float, metres
    granularity, minvotes, nlines : int
        As in `beamseg_batch.detection.iterative_hough`.

    Returns
    -------
    list of (M,) int64
        The points of each line.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    points = points - (low + high) / 2.0
    directions = hemisphere_directions(granularity)
    reach = max(np.linalg.norm(points.max(axis=0)), np.linalg.norm(points.min(axis=0)))
    num_x = int(np.floor(2.0 * reach / dx + 0.5))
    votes = np.zeros(num_x * num_x * len(directions), np.int32)
    cells = _cells(points, directions, reach, dx, num_x)
    _add(votes, cells, 1)
    left, lines = np.arange(len(points)), []
    while len(left) > 1 and (nlines == 0 or len(lines) < nlines):
        cell, index = divmod(int(np.argmax(votes)), len(directions))
        x, y = (i * dx - reach for i in divmod(cell, num_x))
        anchor, direction = _anchor(x, y, directions[index]), directions[index]
        for _ in range(2):
            close = left[_distances(points[left], anchor, direction) <= dx]
            if len(close) == 0:
                return lines
            anchor = points[close].mean(axis=0)
            offsets = points[close] - anchor
            direction = np.linalg.eigh(offsets.T @ offsets)[1][:, 2]
        if len(close) < minvotes:
            return lines
        lines.append(close)
        _add(votes, cells[close], -1)
        left = np.setdiff1d(left, close, assume_unique=True)
    return lines


def _cells(
    points: NDArray[np.float64],
    directions: NDArray[np.float64],
    reach: float,
    dx: float,
    num_x: int,
) -> NDArray[np.int64]:
    """(N, D) int64: flat cell of each point in each direction."""
    bx, by, bz = directions.T
    beta = 1.0 / (1.0 + bz)
    px, py, pz = (column[:, None] for column in points.T)
    x = (1.0 - beta * bx * bx) * px - beta * bx * by * py - bx * pz
    y = -beta * bx * by * px + (1.0 - beta * by * by) * py - by * pz
    cell_x = np.floor((x + reach) / dx + 0.5).astype(np.int64)
    cell_y = np.floor((y + reach) / dx + 0.5).astype(np.int64)
    return (cell_x * num_x + cell_y) * len(directions) + np.arange(len(directions))


def _add(votes: NDArray[np.int32], cells: NDArray[np.int64], weight: int) -> None:
    for row in cells:  # one point at a time: within a row no cell comes twice
        inside = row[row < len(votes)]
        votes[inside] += weight


def _anchor(x: float, y: float, b: NDArray[np.float64]) -> NDArray[np.float64]:
    beta = 1.0 / (1.0 + b[2])
    return np.array(
        [
            x * (1 - beta * b[0] * b[0]) - y * beta * b[0] * b[1],
            -x * beta * b[0] * b[1] + y * (1 - beta * b[1] * b[1]),
            -x * b[0] - y * b[1],
        ]
    )


def _distances(
    points: NDArray[np.float64], anchor: NDArray[np.float64], direction: NDArray[np.float64]
) -> NDArray[np.float64]:
    offsets = points - anchor
    distances: NDArray[np.float64] = np.linalg.norm(
        offsets - np.outer(offsets @ direction, direction), axis=1
    )
    return distances
