"""Many segments as arrays, so that one can be held against all of them at once."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import Segment

__all__ = ["SegmentArrays"]

_COLUMNS = 15


class SegmentArrays:
    """The geometry of a list of segments, one row each, kept beside the list.

    Parameters
    ----------
    segments : iterable of Segment
        World frame.

    Notes
    -----
    One matrix holds all columns and grows by doubling, so that a change costs one row
    however many segments there are.
    """

    def __init__(self, segments: Iterable[Segment] = ()) -> None:
        self._rows = np.empty((16, _COLUMNS))
        self._count = 0
        for segment in segments:
            self.append(segment)

    def __len__(self) -> int:
        return self._count

    def append(self, segment: Segment) -> None:
        """Add a segment at the end."""
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        self._count += 1
        self.replace(self._count - 1, segment)

    def replace(self, index: int, segment: Segment) -> None:
        """Put a segment in the place of another."""
        row = self._rows[index]
        row[0:3], row[3:6] = segment.anchor, segment.direction
        row[6:9], row[9:12] = segment.end_1, segment.end_2
        row[12:15] = segment.t_min, segment.t_max, segment.radius

    def delete(self, index: int) -> None:
        """Remove a segment; later ones move down by one."""
        self._rows[index : self._count - 1] = self._rows[index + 1 : self._count]
        self._count -= 1

    @property
    def rows(self) -> FloatArray:
        """(N, 15) float64: all of it, as the kernels take it."""
        return self._rows[: self._count]

    @property
    def anchors(self) -> FloatArray:
        """(N, 3) float64, metres."""
        return self._rows[: self._count, 0:3]

    @property
    def directions(self) -> FloatArray:
        """(N, 3) float64, unit vectors."""
        return self._rows[: self._count, 3:6]

    @property
    def midpoints(self) -> FloatArray:
        """(N, 3) float64, metres: halfway between the ends."""
        rows = self._rows[: self._count]
        return 0.5 * (rows[:, 6:9] + rows[:, 9:12])

    @property
    def t_min(self) -> FloatArray:
        """(N,) float64, metres."""
        return self._rows[: self._count, 12]

    @property
    def t_max(self) -> FloatArray:
        """(N,) float64, metres."""
        return self._rows[: self._count, 13]

    @property
    def radii(self) -> FloatArray:
        """(N,) float64, metres."""
        return self._rows[: self._count, 14]
