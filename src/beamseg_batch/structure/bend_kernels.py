"""Kernel that finds where two axes explain a stretch of a beam best."""

from __future__ import annotations

import numpy as np

from beamseg_batch.accelerate import kernel
from beamseg_batch.cylinder.ray_kernels import solve_4
from beamseg_batch.geometry import FloatArray

__all__ = ["best_bend"]


@kernel
def _gain(total: FloatArray) -> tuple[float, FloatArray]:
    """Half of what the best axis takes from the squared residuals, and its step."""
    uu, uv, vv, suu, suv, svv = total[0], total[1], total[2], total[3], total[4], total[5]
    ssuu, ssuv, ssvv = total[6], total[7], total[8]
    matrix = np.array(
        [[uu, uv, suu, suv], [uv, vv, suv, svv], [suu, suv, ssuu, ssuv], [suv, svv, ssuv, ssvv]]
    )
    right = total[9:13]
    step, _ = solve_4(matrix, right)
    gain = 0.0
    for k in range(4):
        gain += right[k] * step[k]
    return gain, step


@kernel
def best_bend(rows: FloatArray, least: int, angle: float) -> tuple[int, float]:
    """Find the bin before which an axis should end and another begin.

    Parameters
    ----------
    rows : (N, 13 or more) float64
        Normal equations of a stretch, by bin; see
        `beamseg_batch.cylinder.evidence_kernels.Evidence`.
    least : int
        Fewest bins on either side.
    angle : float, radians
        Two axes that are closer in direction are one.

    Returns
    -------
    place : int
        -1 if there is none.
    gain : float
        By how much the sum of squared residuals falls, against one axis.
    """
    total = np.zeros(rows.shape[1])
    for row in rows:
        total += row
    whole, _ = _gain(total)
    before = np.zeros(rows.shape[1])
    best, place = 0.0, -1
    for k in range(len(rows)):
        if least <= k <= len(rows) - least:
            left, left_step = _gain(before)
            right, right_step = _gain(total - before)
            turn = np.hypot(right_step[2] - left_step[2], right_step[3] - left_step[3])
            if left + right - whole > best and turn > angle:
                best, place = left + right - whole, k
        before += rows[k]
    return place, best
