"""The cloud of a whole flight, thinned so that it stays bounded."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.structure.cloud_kernels import claim_cells

__all__ = ["ThinnedCloud"]


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
        self._forget(0)

    def _forget(self, n_expected: int) -> None:
        self._count = 0
        self._kept: list[NDArray[np.float32]] = []
        # At most half full, so that a free slot is found soon.
        self._slots = np.full(1 << max(int(4 * n_expected).bit_length(), 12), -1, np.int64)

    def add(self, points: NDArray[np.float32]) -> None:
        """Take in the points of a scan.

        Parameters
        ----------
        points : (N, 3) float32, metres, world frame
        """
        if self.limit == 0 or len(points) == 0:
            return
        self._keep_new(points)
        while self._count > self.limit:
            points = self.points()
            # The eight cells around the origin never become one.
            if self.limit < 8:
                points = points[: self.limit]
            self.cell_size *= 2.0
            self._forget(len(points))
            self._keep_new(points)

    def points(self) -> NDArray[np.float32]:
        """(N, 3) float32, metres, world frame: the points kept so far."""
        return np.concatenate([np.empty((0, 3), np.float32), *self._kept])

    def _keep_new(self, points: NDArray[np.float32]) -> None:
        if 2 * (self._count + len(points)) > len(self._slots):
            kept = self.points()
            self._forget(len(kept) + len(points))
            self._keep_new(kept)
        fresh = points[claim_cells(points, self.cell_size, self._slots)]
        if len(fresh):
            self._count += len(fresh)
            self._kept.append(fresh)
