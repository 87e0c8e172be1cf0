"""The directions that vote, laid out for the kernels."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.detection.directions import hemisphere_directions
from beamseg_batch.geometry import FloatArray

__all__ = ["HoughSpace", "hough_space"]


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


@cache
def hough_space(granularity: int) -> HoughSpace:
    """Return the directions of a granularity, 0 to 6, made once."""
    directions = hemisphere_directions(granularity)
    x, y, z = directions.T
    beta = 1.0 / (1.0 + z)
    rows = np.array([1.0 - beta * x * x, -beta * x * y, -x, 1.0 - beta * y * y, -y]).T
    return HoughSpace(directions, np.ascontiguousarray(rows, np.float32))
