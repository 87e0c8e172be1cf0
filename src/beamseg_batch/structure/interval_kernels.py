"""Kernels that find where along an axis the evidence says that a beam is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.accelerate import kernel
from beamseg_batch.geometry import FloatArray

__all__ = ["best_intervals", "densest_part"]


@kernel
def best_intervals(likelihood: FloatArray, cost: float) -> NDArray[np.int64]:
    """Stretches of bins with the largest sum in all, each at a cost.

    Parameters
    ----------
    likelihood : (N,) float64
        Log-likelihood ratio of each bin: beam against no beam.
    cost : float
        Of a stretch.

    Returns
    -------
    (K, 2) int64
        First bin of each stretch, and the bin after its last.

    Notes
    -----
    A Viterbi path through two states.
    """
    size = len(likelihood)
    entered = np.zeros(size + 1, np.bool_)  # being inside at this bin is best begun here
    left = np.zeros(size + 1, np.bool_)  # being outside here is best from inside
    outside, inside = 0.0, -np.inf
    for k in range(size):
        entered[k] = outside - cost > inside
        inside = max(inside, outside - cost) + likelihood[k]
        left[k] = inside > outside
        outside = max(outside, inside)
    stretches = np.empty((size + 1, 2), np.int64)
    count = 0
    k = size - 1
    while k >= 0:
        if not left[k]:
            k -= 1
            continue
        last = k
        while not entered[k]:
            k -= 1
        stretches[count, 0], stretches[count, 1] = k, last + 1
        count += 1
        k -= 1
    return stretches[:count][::-1].copy()


@kernel
def densest_part(values: FloatArray) -> tuple[int, int]:
    """Contiguous bins with the largest sum.

    Parameters
    ----------
    values : (N,) float64

    Returns
    -------
    first, last : int
        First bin, and the bin after the last one; equal if no sum is above 0.
    """
    best, first, last = 0.0, 0, 0
    total, begin = 0.0, 0
    for k in range(len(values)):
        if total <= 0.0:
            total, begin = 0.0, k
        total += values[k]
        if total > best:
            best, first, last = total, begin, k + 1
    return first, last
