"""Kernel of the thinned cloud: which points fall into a cell that nobody holds yet."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.accelerate import kernel

__all__ = ["claim_cells"]

_AXIS_BITS = 21
_AXIS_MASK = (1 << _AXIS_BITS) - 1
_AXIS_OFFSET = 1 << (_AXIS_BITS - 1)
_FREE = -1


@kernel
def claim_cells(
    points: NDArray[np.float32], cell_size: float, slots: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Claim the cell of each point; the first to come keeps it.

    Parameters
    ----------
    points : (N, 3) float32, metres
        Finite.
    cell_size : float, metres
    slots : (2**k,) int64
        Hash table of the cells that are held, -1 where free; changed here. It must have
        a free slot for each point.

    Returns
    -------
    (N,) bool
        Which points were the first in their cell.

    Notes
    -----
    Cells two million apart along an axis share a key, far beyond any flight.
    """
    fresh = np.zeros(len(points), np.bool_)
    mask = len(slots) - 1
    for k in range(len(points)):
        key = 0
        for axis in range(3):
            cell = int(np.floor(points[k, axis] / cell_size)) + _AXIS_OFFSET
            key = (key << _AXIS_BITS) | (cell & _AXIS_MASK)
        # Fibonacci hashing spreads neighbouring cells over the table.
        slot = ((key * -7046029254386353131) >> 20) & mask
        while slots[slot] != _FREE and slots[slot] != key:
            slot = (slot + 1) & mask
        if slots[slot] == _FREE:
            slots[slot] = key
            fresh[k] = True
    return fresh
