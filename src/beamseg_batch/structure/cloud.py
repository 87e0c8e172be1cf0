"""The cloud of a whole flight, thinned so that it stays bounded."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["ThinnedCloud"]

_AXIS_BITS = 21
_AXIS_OFFSET = 1 << (_AXIS_BITS - 1)


class ThinnedCloud:
    """At most `limit` points, the first seen in each cell of a world-aligned grid.

    Parameters
    ----------
    limit : int
        Most points to keep; 0 keeps none.
    cell_size : float, metres
        Edge of a cell. It doubles whenever the limit is passed, so the cloud is thinned
        evenly however long the flight is.

    Notes
    -----
    What is kept depends on the points and their order alone, so that two runs of a
    flight keep the same.
    """

    def __init__(self, limit: int, cell_size: float) -> None:
        self.limit = limit
        self.cell_size = cell_size
        self._seen: set[int] = set()
        self._kept: list[NDArray[np.float32]] = []

    def add(self, points: NDArray[np.float32]) -> None:
        """Take in the points of a scan.

        Parameters
        ----------
        points : (N, 3) float32, metres, world frame
        """
        if self.limit == 0 or len(points) == 0:
            return
        self._keep_new(points)
        while len(self._seen) > self.limit:
            points = self.points()
            # The eight cells around the origin never become one.
            if self.limit < 8:
                points = points[: self.limit]
            self.cell_size *= 2.0
            self._seen, self._kept = set(), []
            self._keep_new(points)

    def points(self) -> NDArray[np.float32]:
        """(N, 3) float32, metres, world frame: the points kept so far."""
        return np.concatenate([np.empty((0, 3), np.float32), *self._kept])

    def _keep_new(self, points: NDArray[np.float32]) -> None:
        fresh = []
        for index, key in enumerate(self._keys(points).tolist()):
            if key not in self._seen:
                self._seen.add(key)
                fresh.append(index)
        if fresh:
            self._kept.append(points[fresh])

    def _keys(self, points: NDArray[np.float32]) -> NDArray[np.int64]:
        """Pack the cell of each point into one integer; cells 2e6 apart may collide."""
        cells = np.floor(points / np.float32(self.cell_size)).astype(np.int64) + _AXIS_OFFSET
        cells &= (1 << _AXIS_BITS) - 1
        keys: NDArray[np.int64] = (
            (cells[:, 2] << (2 * _AXIS_BITS)) | (cells[:, 1] << _AXIS_BITS) | cells[:, 0]
        )
        return keys
