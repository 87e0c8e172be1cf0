"""Kernel that finds the candidate that a sighting belongs to."""

from __future__ import annotations

import numpy as np

from beamseg_batch.accelerate import kernel
from beamseg_batch.geometry import FloatArray

__all__ = ["nearest_candidate"]


@kernel
def nearest_candidate(
    rows: FloatArray,
    end_1: FloatArray,
    end_2: FloatArray,
    radius: float,
    most_offset: float,
    least_cosine: float,
    bridge: float,
) -> int:
    """Find the candidate whose axis passes nearest to both ends of a sighting.

    Parameters
    ----------
    rows : (G, 9) float64
        Of each candidate: anchor, direction, both ends along it, radius.
    end_1, end_2 : (3,) float64, metres
    radius : float, metres
        Candidates of another are not asked.
    most_offset : float, metres
        How far either end may be from the axis.
    least_cosine : float
        Of the angle between them.
    bridge : float, metres
        Longest gap along the axis.

    Returns
    -------
    int
        -1 if none is near enough.
    """
    length = np.sqrt(np.sum((end_2 - end_1) ** 2))
    nearest, found = most_offset, -1
    for g in range(len(rows)):
        if rows[g, 8] != radius:
            continue
        furthest, low, high, cosine = 0.0, np.inf, -np.inf, 0.0
        for which in range(2):
            end = end_2 if which else end_1
            along, squared = 0.0, 0.0
            for axis in range(3):
                apart = end[axis] - rows[g, axis]
                along += apart * rows[g, 3 + axis]
                squared += apart * apart
            furthest = max(furthest, squared - along * along)
            low, high = min(low, along), max(high, along)
            cosine += (2 * which - 1) * along
        if (
            furthest < nearest * nearest
            and abs(cosine) > least_cosine * length
            and low < rows[g, 7] + bridge
            and high > rows[g, 6] - bridge
        ):
            nearest, found = np.sqrt(max(furthest, 0.0)), g
    return found
