"""Which beams lie near one another, so that not every pair need be compared."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.geometry import FloatArray
from beamseg_batch.structure.hypothesis import Beam

__all__ = ["Neighbours"]

_MARGIN_M = 0.1  # an axis that is bent may leave the box of its ends by so much


class Neighbours:
    """Beams by the boxes that hold them.

    Parameters
    ----------
    beams : iterable of Beam, optional
        The first ones.
    reach : float, optional, metres
        Beams are near when their boxes are no further apart than that.

    Attributes
    ----------
    beams : list of Beam
    """

    def __init__(self, beams: Iterable[Beam] = (), *, reach: float = 0.1) -> None:
        self.beams: list[Beam] = []
        self._reach = reach + 2.0 * _MARGIN_M
        self._lows, self._highs = np.empty((2, 16, 3))
        for beam in beams:
            self.append(beam)

    def append(self, beam: Beam) -> None:
        """Add a beam."""
        if len(self.beams) == len(self._lows):
            self._lows, self._highs = (
                np.concatenate([box, np.empty_like(box)]) for box in (self._lows, self._highs)
            )
        self.beams.append(beam)
        self.replace(len(self.beams) - 1, beam)

    def replace(self, index: int, beam: Beam) -> None:
        """Put a beam in place of another."""
        self.beams[index] = beam
        self._lows[index], self._highs[index] = _box(beam)

    def near(self, beam: Beam) -> NDArray[np.int64]:
        """Indices of the beams that may come near to one, ascending; of itself, too."""
        low, high = _box(beam)
        count, reach = len(self.beams), self._reach
        within = (self._lows[:count] <= high + reach) & (self._highs[:count] >= low - reach)
        return np.flatnonzero(within.all(axis=1))


def _box(beam: Beam) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest coordinates of a straight beam's surface."""
    start, end = beam.ends
    return np.minimum(start, end) - beam.radius, np.maximum(start, end) + beam.radius
