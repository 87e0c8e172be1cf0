"""Kernels of single rays against a cylinder, and of the axis that explains many.

Everything is in the sensor frame: rays leave the origin along unit vectors ``w``, the
axis is ``a + s b``. A cylinder of radius ``r`` is entered at depth ``t``, at ``s`` along
its axis, where its outward normal is ``n``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.accelerate import kernel
from beamseg_batch.geometry import FloatArray

__all__ = [
    "enter_cylinder",
    "finite_depth",
    "fit_axis",
    "near_line",
    "on_cylinders",
    "perpendiculars",
    "solve_4",
]

_MIN_INCIDENCE = 0.2
"""Rays that graze the surface more than this say little, and mostly about its edge."""


@kernel
def enter_cylinder(
    wx: float, wy: float, wz: float,
    ax: float, ay: float, az: float,
    bx: float, by: float, bz: float,
    radius: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Where a ray enters an endless cylinder.

    Parameters
    ----------
    wx, wy, wz : float
        Unit direction of the ray, from the origin.
    ax, ay, az : float, metres
        A point of the axis.
    bx, by, bz : float
        Unit direction of the axis.
    radius : float, metres

    Returns
    -------
    entry, leave : float, metres
        Depths along the ray; NaN if it misses.
    s : float, metres
        Where along the axis it enters.
    lateral : float, metres
        Distance of the ray's line from the axis.
    """
    wb = wx * bx + wy * by + wz * bz
    ab = ax * bx + ay * by + az * bz
    across = 1.0 - wb * wb
    # (w x b) . a is the distance between the two lines, times the sine between them.
    mixed = (wy * bz - wz * by) * ax + (wz * bx - wx * bz) * ay + (wx * by - wy * bx) * az
    if across < 1e-12 or mixed * mixed > radius * radius * across:
        return np.nan, np.nan, np.nan, np.inf
    middle = (wx * ax + wy * ay + wz * az - wb * ab) / across
    half = np.sqrt((radius * radius - mixed * mixed / across) / across)
    entry = middle - half
    return entry, middle + half, entry * wb - ab, abs(mixed) / np.sqrt(across)


@kernel
def finite_depth(
    entry: float, leave: float, s: float, wb: float, ab: float, first: float, last: float
) -> float:
    """Depth at which a ray meets a cylinder with flat caps, infinite if it passes by.

    Parameters
    ----------
    entry, leave, s : float, metres
        Of `enter_cylinder`.
    wb, ab : float
        Ray and axis point along the axis.
    first, last : float, metres
        Ends of the cylinder along its axis.

    Returns
    -------
    float, metres
    """
    if first <= s <= last:
        return entry
    if s < first and wb > 0.0:
        cap = (first + ab) / wb
    elif s > last and wb < 0.0:
        cap = (last + ab) / wb
    else:
        return np.inf
    return cap if cap < leave else np.inf


@kernel
def perpendiculars(b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors normal to a direction and to one another.

    Parameters
    ----------
    b : (3,) float64, unit vector

    Returns
    -------
    u, v : (3,) float64, unit vectors
    """
    u = np.zeros(3)
    smallest = 0
    for axis in range(1, 3):
        if abs(b[axis]) < abs(b[smallest]):
            smallest = axis
    u[smallest] = 1.0
    along = b[smallest]
    for axis in range(3):
        u[axis] -= along * b[axis]
    length = np.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    for axis in range(3):
        u[axis] /= length
    v = np.array([b[1] * u[2] - b[2] * u[1], b[2] * u[0] - b[0] * u[2], b[0] * u[1] - b[1] * u[0]])
    return u, v


@kernel
def solve_4(matrix: FloatArray, right: FloatArray) -> tuple[FloatArray, bool]:
    """Solve four normal equations by Cholesky decomposition.

    Parameters
    ----------
    matrix : (4, 4) float64, symmetric
        Its lower triangle is read.
    right : (4,) float64

    Returns
    -------
    solution : (4,) float64
    regular : bool
        Whether the matrix is positive definite; the solution is zero if not.
    """
    lower, solution = np.zeros((4, 4)), np.zeros(4)
    for row in range(4):
        for column in range(row + 1):
            rest = matrix[row, column]
            for k in range(column):
                rest -= lower[row, k] * lower[column, k]
            if row == column:
                if rest <= 1e-12 * matrix[row, row] or not np.isfinite(rest):
                    return np.zeros(4), False
                lower[row, row] = np.sqrt(rest)
            else:
                lower[row, column] = rest / lower[column, column]
    for row in range(4):
        rest = right[row]
        for k in range(row):
            rest -= lower[row, k] * solution[k]
        solution[row] = rest / lower[row, row]
    for row in range(3, -1, -1):
        rest = solution[row]
        for k in range(row + 1, 4):
            rest -= lower[k, row] * solution[k]
        solution[row] = rest / lower[row, row]
    return solution, True


@kernel
def fit_axis(
    rays: FloatArray,
    depths: FloatArray,
    scales: FloatArray,
    anchor: FloatArray,
    direction: FloatArray,
    first: float,
    last: float,
    radius: float,
    gates: FloatArray,
) -> tuple[FloatArray, FloatArray, int, float]:
    """Fit a cylinder's axis to depths, along the rays (design, section 7.4).

    Parameters
    ----------
    rays : (N, 3) float64, unit vectors
    depths : (N,) float64, metres
        Infinite or NaN where nothing returned.
    scales : (N,) float64
        What a residual along a ray is worth: one over the noise of its depth, times the
        smallest of all.
    anchor, direction : (3,) float64
        The axis to start from.
    first, last : float, metres
        The stretch along it that rays may lie on.
    radius : float, metres
    gates : (G,) float64, metres
        Reach of Tukey's weight in each iteration.

    Returns
    -------
    anchor, direction : (3,) float64
    count : int
        Rays with a weight in the last iteration; 0 if no axis could be fitted.
    rms : float, metres
        Weighted root mean square of their residuals.

    Notes
    -----
    A residual is the measured depth minus that at which the ray enters. Where the axis
    moves by ``p``, the entry moves by ``(n . p) / (n . w)``, so with ``u`` and ``v`` normal
    to the axis the derivative is ``(n.u, n.v, s n.u, s n.v) / (n.w)``.
    """
    a, b = anchor.copy(), direction.copy()
    count, rms = 0, 0.0
    matrix, right = np.empty((4, 4)), np.empty(4)
    for gate in gates:
        u, v = perpendiculars(b)
        ax, ay, az, bx, by, bz = a[0], a[1], a[2], b[0], b[1], b[2]
        ux, uy, uz, vx, vy, vz = u[0], u[1], u[2], v[0], v[1], v[2]
        pp, pq, qq, spp, spq, sqq, sspp, sspq, ssqq = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        pe, qe, spe, sqe = 0.0, 0.0, 0.0, 0.0
        count, weights, squares = 0, 0.0, 0.0
        for k in range(len(rays)):
            depth = depths[k]
            if not np.isfinite(depth):
                continue
            wx, wy, wz = rays[k, 0], rays[k, 1], rays[k, 2]
            entry, _, s, _ = enter_cylinder(wx, wy, wz, ax, ay, az, bx, by, bz, radius)
            if not (first <= s <= last):
                continue
            residual = (depth - entry) * scales[k]
            if abs(residual) >= gate:
                continue
            nx = (entry * wx - ax - s * bx) / radius
            ny = (entry * wy - ay - s * by) / radius
            nz = (entry * wz - az - s * bz) / radius
            incidence = nx * wx + ny * wy + nz * wz
            if abs(incidence) < _MIN_INCIDENCE:
                continue
            share = residual / gate
            weight = (1.0 - share * share) ** 2
            p = (nx * ux + ny * uy + nz * uz) / incidence * scales[k]
            q = (nx * vx + ny * vy + nz * vz) / incidence * scales[k]
            wp, wq, wr = weight * p, weight * q, weight * residual
            pp, pq, qq = pp + wp * p, pq + wp * q, qq + wq * q
            spp, spq, sqq = spp + s * wp * p, spq + s * wp * q, sqq + s * wq * q
            sspp, sspq, ssqq = (
                sspp + s * s * wp * p,
                sspq + s * s * wp * q,
                ssqq + s * s * wq * q,
            )
            pe, qe, spe, sqe = pe + p * wr, qe + q * wr, spe + s * p * wr, sqe + s * q * wr
            count += 1
            weights += weight
            squares += wr * residual
        if count < 8:
            return a, b, 0, 0.0
        matrix[0, 0], matrix[1, 0], matrix[1, 1] = pp, pq, qq
        matrix[2, 0], matrix[2, 1], matrix[2, 2] = spp, spq, sspp
        matrix[3, 0], matrix[3, 1], matrix[3, 2], matrix[3, 3] = spq, sqq, sspq, ssqq
        right[0], right[1], right[2], right[3] = pe, qe, spe, sqe
        step, regular = solve_4(matrix, right)
        if not regular:
            return a, b, 0, 0.0
        for axis in range(3):
            a[axis] += step[0] * u[axis] + step[1] * v[axis]
            b[axis] += step[2] * u[axis] + step[3] * v[axis]
        length = np.sqrt(b[0] * b[0] + b[1] * b[1] + b[2] * b[2])
        for axis in range(3):
            b[axis] /= length
        rms = np.sqrt(squares / weights)
    return a, b, count, rms


@kernel
def near_line(
    points: FloatArray, a: FloatArray, b: FloatArray, first: float, last: float, reach: float
) -> NDArray[np.int64]:
    """Points near a stretch of a line.

    Parameters
    ----------
    points : (N, 3) float64, metres
    a, b : (3,) float64
        A point of the line and its unit direction.
    first, last : float, metres
        The stretch, from `a` on.
    reach : float, metres
        How far from the line still counts.

    Returns
    -------
    (K,) int64
        Their indices, in order.
    """
    found = np.empty(len(points), np.int64)
    count = 0
    for k in range(len(points)):
        x, y, z = points[k, 0] - a[0], points[k, 1] - a[1], points[k, 2] - a[2]
        s = x * b[0] + y * b[1] + z * b[2]
        if first < s < last and x * x + y * y + z * z - s * s < reach * reach:
            found[count] = k
            count += 1
    return found[:count]


@kernel
def on_cylinders(
    points: FloatArray,
    anchors: FloatArray,
    directions: FloatArray,
    firsts: FloatArray,
    lasts: FloatArray,
    bows: FloatArray,
    radii: FloatArray,
    reach: float,
) -> NDArray[np.bool_]:
    """Which points lie on, in or near one of several finite cylinders.

    Parameters
    ----------
    points : (N, 3) float64, metres
    anchors, directions : (M, 3) float64, in the same frame
    firsts, lasts : (M,) float64, metres
    bows : (M, 3) float64, metres
        By how much each axis leaves its chord midway between its ends, as a parabola.
    radii : (M,) float64, metres
    reach : float, metres
        How far from a surface, or beyond an end, still counts.

    Returns
    -------
    (N,) bool
    """
    near = np.zeros(len(points), np.bool_)
    for j in range(len(anchors)):
        a, b, bow = anchors[j], directions[j], bows[j]
        most = (radii[j] + reach) ** 2
        for k in range(len(points)):
            x, y, z = points[k, 0] - a[0], points[k, 1] - a[1], points[k, 2] - a[2]
            s = x * b[0] + y * b[1] + z * b[2]
            if firsts[j] - reach <= s <= lasts[j] + reach:
                share = (2.0 * s - firsts[j] - lasts[j]) / (lasts[j] - firsts[j])
                off = 1.0 - share * share
                x, y, z = x - off * bow[0], y - off * bow[1], z - off * bow[2]
                near[k] |= x * x + y * y + z * z - s * s < most
    return near
