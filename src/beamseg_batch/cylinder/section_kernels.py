"""Kernels that fit cross-sections to rays seen along the axis of a beam.

A section is a circle, or up to three rectangles. Its parameters, ``p``:

0, 1    left and right edge along the section's own u, metres
2, 3    bottom and top edge along its v, metres
4       its turn about the axis, radians
5, 6    thickness of the parts along v (web) and of those along u (flange), metres
7, 8    slope of its axis against the beam's, along the beam's normals

Edges, not sizes: each is shown by rays of its own, so that one can be found before another.
A circle has its centre between the edges, and the mean of both widths as its diameter.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.accelerate import kernel
from beamseg_batch.geometry import FloatArray

__all__ = [
    "PARAMETERS",
    "ROUND",
    "descend",
    "ended_costs",
    "enter_section",
    "normal_equations",
    "ray_costs",
]

Numbers: TypeAlias = tuple[float, ...]

PARAMETERS = 9
ROUND, TUBE, I_SHAPE, ANGLE, CHANNEL = 0, 1, 2, 3, 4
"""Numbers of the shapes, in the order of `beamseg_batch.section.SHAPES`."""

_LEAST_SIZE, _MOST_SIZE = 0.02, 0.45
_LEAST_PLATE, _MOST_PLATE = 0.003, 0.025
_MOST_SHARE = 0.3  # of a section that a plate's thickness may be
_MOST_SLOPE = 0.12
_GRAZING = 0.25  # sine of the angle below which a surface may send nothing back


@kernel
def _as_numbers(p: FloatArray) -> Numbers:
    """Parameters as numbers: holders of an array are counted wherever it is handed on."""
    return p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8]


@kernel
def _ray_of(rays: FloatArray, k: int) -> Numbers:
    """One ray as numbers."""
    return (
        rays[k, 0], rays[k, 1], rays[k, 2], rays[k, 3], rays[k, 4],
        rays[k, 5], rays[k, 6], rays[k, 7], rays[k, 8], rays[k, 9],
    )  # fmt: skip


@kernel
def _enter_box(
    x: float, y: float, dx: float, dy: float, begin: float,
    left: float, right: float, low: float, high: float,
) -> tuple[float, float]:  # fmt: skip
    """Where a line that begins somewhere enters a rectangle, infinite if not; how squarely."""
    enters, leaves, facing = begin, np.inf, 1.0
    if dx == 0.0:
        if x < left or x > right:
            return np.inf, 0.0
    else:
        one, other = (left - x) / dx, (right - x) / dx
        leaves = max(one, other)
        if min(one, other) > enters:
            enters, facing = min(one, other), abs(dx)
    if dy == 0.0:
        if y < low or y > high:
            return np.inf, 0.0
    else:
        one, other = (low - y) / dy, (high - y) / dy
        if min(one, other) > enters:
            enters, facing = min(one, other), abs(dy)
        leaves = min(leaves, max(one, other))
    return (enters, facing) if enters <= leaves else (np.inf, 0.0)


@kernel
def enter_section(
    shape: int, p: FloatArray | Numbers, x: float, y: float, dx: float, dy: float, begin: float
) -> tuple[float, float]:
    """Where a line in the section's own frame enters it, or is in it when it begins.

    Parameters
    ----------
    shape : int
    p : (9,) float64, or as many numbers
    x, y, dx, dy : float
        A point of the line, metres, and its unit direction.
    begin : float, metres
        Where the line begins, from that point.

    Returns
    -------
    along : float, metres
        From the point; infinite if the line passes the section.
    facing : float
        Sine of the angle between line and surface.
    """
    left, right, low, high, web, flange = p[0], p[1], p[2], p[3], p[5], p[6]
    if shape == ROUND:
        x, y = x - 0.5 * (left + right), y - 0.5 * (low + high)
        radius = 0.25 * (right - left + high - low)
        beside = dx * y - dy * x
        root = radius * radius - beside * beside
        if root <= 0.0:
            return np.inf, 0.0
        root = np.sqrt(root)
        middle = -(x * dx + y * dy)
        if begin <= middle - root:
            return middle - root, root / radius
        return (begin, 1.0) if begin <= middle + root else (np.inf, 0.0)
    if shape == TUBE:
        return _enter_box(x, y, dx, dy, begin, left, right, low, high)
    along, facing = _enter_box(x, y, dx, dy, begin, left, right, low, low + flange)
    inner = high
    if shape != ANGLE:
        inner = high - flange
        other, squarely = _enter_box(x, y, dx, dy, begin, left, right, inner, high)
        if other < along:
            along, facing = other, squarely
    inner_left = 0.5 * (left + right - web) if shape == I_SHAPE else left
    other, squarely = _enter_box(
        x, y, dx, dy, begin, inner_left, inner_left + web, low + flange, inner
    )
    return (other, squarely) if other < along else (along, facing)


@kernel
def _depth(
    shape: int, p: Numbers, cos: float, sin: float, ray: Numbers, aside: float,
    begin: float, stop: float,
) -> tuple[float, float]:  # fmt: skip
    """How far behind the point nearest to the beam's axis a ray enters the section."""
    du, dv, s, rise = ray[0], ray[1], ray[5], ray[9]
    beside = ray[2] + aside
    u, v = -beside * dv - s * p[7], beside * du - s * p[8]
    # Seen along an axis that leans, what a ray runs along the beam is a part of its way across.
    du, dv = du - rise * p[7], dv - rise * p[8]
    stretch = np.sqrt(du * du + dv * dv)
    du, dv = du / stretch, dv / stretch
    along, facing = enter_section(
        shape, p, cos * u + sin * v, cos * v - sin * u, cos * du + sin * dv, cos * dv - sin * du,
        begin * stretch,
    )  # fmt: skip
    along /= stretch
    return (along, facing) if along <= stop else (np.inf, 0.0)


@kernel
def _ray_cost(
    shape: int, p: Numbers, cos: float, sin: float, ray: Numbers, reach: float, worst: float,
    begin: float, stop: float,
) -> float:  # fmt: skip
    """Cost of a ray: half its squared residual, at most that of what is not explained."""
    measured, sigma, aside = ray[3], ray[4], ray[6]
    missed = worst if measured < reach else 0.0
    depth, facing = _depth(shape, p, cos, sin, ray, 0.0, begin, stop)
    hits = 1 if depth < np.inf else 0
    if aside > 0.0:
        total = depth if hits else 0.0
        for side in (-1.0, 1.0):
            other, _ = _depth(shape, p, cos, sin, ray, side * aside, begin, stop)
            if other < np.inf:
                total += other
                hits += 1
        if 0 < hits < 3:
            # At its outline a pixel holds something else, too.
            residual = (measured - total / hits) / sigma
            return float(min(0.5 * residual * residual, missed, 0.5 * worst))
        depth = total / 3.0
    if hits == 0:
        return missed
    if measured == np.inf and facing < _GRAZING:
        return 0.5 * worst
    residual = (measured - depth) / sigma
    return float(min(0.5 * residual * residual, worst))


@kernel
def ray_costs(
    shape: int, p: FloatArray, rays: FloatArray, reach: float, worst: float, costs: FloatArray
) -> float:
    """How badly a section explains each ray.

    Parameters
    ----------
    shape : int
    p : (9,) float64
    rays : (N, 10) float64
        As `beamseg_batch.cylinder.near_kernels.gather_near` gives them.
    reach : float, metres
        A return nearer behind the axis than this is of something near it.
    worst : float
        Cost of a ray that is not explained.
    costs : (N,) float64
        Filled.

    Returns
    -------
    float
        The sum.
    """
    cos, sin, total = np.cos(p[4]), np.sin(p[4]), 0.0
    numbers = _as_numbers(p)
    for k in range(len(rays)):
        ray = _ray_of(rays, k)
        costs[k] = _ray_cost(shape, numbers, cos, sin, ray, reach, worst, -np.inf, np.inf)
        total += costs[k]
    return total


@kernel
def _between(ray: Numbers, first: float, last: float) -> tuple[float, float]:
    """How far behind the point nearest to the axis a ray is on a stretch of it: from, to."""
    s, rise = ray[5], ray[9]
    if rise == 0.0:
        return (-np.inf, np.inf) if first <= s <= last else (np.inf, -np.inf)
    one, other = (first - s) / rise, (last - s) / rise
    return min(one, other), max(one, other)


@kernel
def ended_costs(
    shape: int,
    p: FloatArray,
    rays: FloatArray,
    reach: float,
    worst: float,
    first: float,
    last: float,
    costs: FloatArray,
) -> None:
    """How badly a section explains each ray, if it ends, and shows its ends.

    Parameters
    ----------
    shape : int
    p : (9,) float64
    rays : (N, 10) float64
    reach, worst : float
        As of `ray_costs`.
    first, last : float, metres
        Ends of the stretch along the beam on which the section is.
    costs : (N,) float64
        Filled.
    """
    cos, sin = np.cos(p[4]), np.sin(p[4])
    numbers = _as_numbers(p)
    for k in range(len(rays)):
        ray = _ray_of(rays, k)
        begin, stop = _between(ray, first, last)
        costs[k] = _ray_cost(shape, numbers, cos, sin, ray, reach, worst, begin, stop)


@kernel
def _is_possible(shape: int, p: FloatArray) -> bool:
    width, height = p[1] - p[0], p[3] - p[2]
    if not (min(width, height) >= _LEAST_SIZE and max(width, height) <= _MOST_SIZE):
        return False
    if max(abs(p[7]), abs(p[8])) > _MOST_SLOPE:
        return False
    thick = min(_MOST_PLATE, _MOST_SHARE * min(width, height))
    possible: bool = shape <= TUBE or (min(p[5], p[6]) >= _LEAST_PLATE and max(p[5], p[6]) <= thick)
    return possible


@kernel
def descend(
    shape: int,
    p: FloatArray,
    moves: FloatArray,
    step: float,
    least: float,
    rays: FloatArray,
    reach: float,
    worst: float,
) -> float:
    """Improve a section, one move at a time, until none helps.

    Parameters
    ----------
    shape : int
    p : (9,) float64
        Changed.
    moves : (K, 9) float64
        What may be moved, for a step of 1 m.
    step, least : float, metres
        The first step, and the smallest; it is halved when no move helps.
    rays : (N, 10) float64
    reach, worst : float
        As of `ray_costs`.

    Returns
    -------
    float
        The sum of the costs.
    """
    costs, trial = np.empty(len(rays)), np.empty(len(p))
    best = ray_costs(shape, p, rays, reach, worst, costs)
    while step >= least:
        helped = False
        for k in range(len(moves)):
            for sign in (1.0, -1.0):
                moved = False
                for _ in range(8):
                    for i in range(len(p)):
                        trial[i] = p[i] + sign * step * moves[k, i]
                    if not _is_possible(shape, trial):
                        break
                    cost = ray_costs(shape, trial, rays, reach, worst, costs)
                    if cost >= best:
                        break
                    best, moved, helped = cost, True, True
                    p[:] = trial
                if moved:
                    break
        if not helped:
            step *= 0.5
    return best


@kernel
def normal_equations(
    shape: int,
    p: FloatArray,
    moves: FloatArray,
    rays: FloatArray,
    gate: float,
    matrix: FloatArray,
    scores: FloatArray,
    numbers: NDArray[np.int64],
) -> None:
    """Normal equations of the moves, and their right-hand sides by group of rays.

    Parameters
    ----------
    shape : int
    p : (9,) float64
    moves : (K, 9) float64
    rays : (N, 10) float64
    gate : float
        Rays with a larger residual, sigmas, are left out.
    matrix : (K, K) float64
        Added to.
    scores : (G, K) float64
        Added to.
    numbers : (N,) int64
        Group of each ray.
    """
    small = 2e-4
    cos, sin = np.cos(p[4]), np.sin(p[4])
    count = len(moves)
    slopes, trial = np.empty(count), np.empty(len(p))
    given = _as_numbers(p)
    for k in range(len(rays)):
        ray = _ray_of(rays, k)
        depth, _ = _depth(shape, given, cos, sin, ray, 0.0, -np.inf, np.inf)
        if depth == np.inf or abs(ray[3] - depth) >= gate * ray[4]:
            continue
        residual = (ray[3] - depth) / ray[4]
        for i in range(count):
            ahead, behind = np.inf, np.inf
            for sign in (1.0, -1.0):
                for n in range(len(p)):
                    trial[n] = p[n] + sign * small * moves[i, n]
                turned = np.cos(trial[4]), np.sin(trial[4])
                moved, _ = _depth(
                    shape, _as_numbers(trial), turned[0], turned[1], ray, 0.0, -np.inf, np.inf
                )
                ahead, behind = (moved, behind) if sign > 0.0 else (ahead, moved)
            # An edge that moves past a ray changes its depth at a stroke.
            smooth = max(ahead, behind) < np.inf and abs(ahead - behind) < 8.0 * small
            slopes[i] = (ahead - behind) / (2.0 * small * ray[4]) if smooth else 0.0
        for i in range(count):
            scores[numbers[k], i] += slopes[i] * residual
            for n in range(count):
                matrix[i, n] += slopes[i] * slopes[n]
