"""The jitter of recorded poses: how large it is, and poses with less of it.

A pose estimator's white noise moves a whole scan. It is told from the drone's own motion by how
smooth that is: what six neighbours of a pose do not foretell is jitter. Poses are smoothed
only as far as leaving each out of its own smoothing shows that its neighbours foretell it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import radians
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.config import SensorConfig
from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import PoseJitter, Trajectory
from beamseg_batch.recording.pose_arrays import product, quaternions_of, rotation_vectors

__all__ = ["SmoothedPoses", "measured_jitter", "smoothed_locally", "without_jitter"]

_LEAST = np.array([3e-4, radians(0.02)])
"""Jitter in metres and radians up to which poses stay as they are: no result would tell it."""

_REACHES = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48)
"""How many poses to either side a window may take in."""
_AROUND = 48
"""Poses to either side over which the errors of windows are averaged, to choose one."""
_WIDEST_STEP = 2.5
"""Median steps between stamps from which on there is a gap."""
_OUTLIER = 1000.0
"""Squared misses in variances of the jitter that count no more: one pose gone astray."""
_FEWEST = 50
"""Poses with three neighbours on each side, from which jitter is measured."""
_NEIGHBOURS = (-3, -2, -1, 1, 2, 3)
_MUST_GAIN = 0.9
"""What smoothing must make of the errors at least, for a pose not to stay as it is."""


@dataclass(frozen=True, eq=False)
class SmoothedPoses:
    """Poses after smoothing.

    Attributes
    ----------
    trajectory : Trajectory
        With the same stamps.
    shares : (2,) float64
        Mean share of the variance of the jitter that is left, of the position and of the
        attitude; 1 where nothing was smoothed.
    """

    trajectory: Trajectory
    shares: FloatArray


def without_jitter(
    trajectories: Sequence[Trajectory], config: SensorConfig, smooth: Literal["auto", "off"]
) -> tuple[list[Trajectory], PoseJitter]:
    """Tell how much poses jitter, and smooth them where that matters.

    Parameters
    ----------
    trajectories : sequence of Trajectory
        One for each state of the clock; each is smoothed on its own.
    config : SensorConfig
        Its jitter is taken where it is given, else measured.
    smooth : {'auto', 'off'}

    Returns
    -------
    list of Trajectory
        With the same stamps; the same objects where nothing was smoothed.
    PoseJitter
    """
    measured, given = measured_jitter(trajectories), _configured(config)
    known = np.where(np.isnan(given), np.nan_to_num(measured), given)
    matters = bool((known > _LEAST).any())
    shares, poses = np.ones(2), list(trajectories)
    if smooth == "auto" and matters:
        smoothed = [smoothed_locally(trajectory, known) for trajectory in trajectories]
        poses = [each.trajectory for each in smoothed]
        counts = [len(trajectory) for trajectory in trajectories]
        shares = np.average([each.shares for each in smoothed], axis=0, weights=counts)
    left = known * np.sqrt(shares)
    sources = np.where(np.isnan(measured), "default", "measured")
    sources = np.where(np.isnan(given), sources, "configured")
    return poses, PoseJitter(
        position=float(known[0]),
        attitude=float(known[1]),
        left_position=float(left[0]),
        left_attitude=float(left[1]),
        # The error of one pose enters so many smoothed ones that they share it for that long.
        memory_s=float(_usual_step_s(trajectories) / shares.min()) if matters else 0.0,
        position_source=str(sources[0]),
        attitude_source=str(sources[1]),
    )


def _configured(config: SensorConfig) -> FloatArray:
    """(2,) float64: jitter in metres and radians, NaN where it is to be measured."""
    position, degrees = config.pose_jitter_m, config.pose_jitter_deg
    return np.array(
        [np.nan if position is None else position, np.nan if degrees is None else radians(degrees)]
    )


def _usual_step_s(trajectories: Sequence[Trajectory]) -> float:
    steps = np.concatenate([np.diff(trajectory.stamps_ns) for trajectory in trajectories])
    return float(np.median(steps)) * 1e-9 if len(steps) else 0.0


def measured_jitter(trajectories: Sequence[Trajectory]) -> FloatArray:
    """Standard deviation of the white noise of poses, about each axis.

    Parameters
    ----------
    trajectories : sequence of Trajectory
        One for each state of the clock.

    Returns
    -------
    (2,) float64
        Of the position, metres, and the attitude, radians; NaN with too few poses to tell.

    Notes
    -----
    The polynomial of degree five through three poses before and three after foretells a pose;
    white noise of deviation ``s`` makes that fail by ``s * sqrt(1 + sum(c**2))``, with the
    coefficients ``c`` of the polynomial. What was flown in between two poses is left out by
    the median.
    """
    found = [_unforetold(trajectory) for trajectory in trajectories if len(trajectory) > 6]
    errors = np.concatenate([np.zeros((0, 6)), *found])
    if len(errors) < _FEWEST:
        return np.full(2, np.nan)
    halves = errors.reshape(-1, 2, 3).transpose(1, 0, 2).reshape(2, -1)
    return np.array([_deviation(half) for half in halves])


def _deviation(values: FloatArray) -> float:
    return 1.4826 * float(np.median(np.abs(values)))


def _unforetold(trajectory: Trajectory) -> FloatArray:
    """(M, 6) float64: by how much neighbours miss poses, in deviations of one."""
    runs, times = _runs(trajectory.stamps_ns)
    middle = np.arange(3, len(times) - 3)
    middle = middle[runs[middle - 3] == runs[middle + 3]]
    offsets = np.stack([times[middle + k] - times[middle] for k in _NEIGHBOURS])
    missed, squares = np.zeros((len(middle), 6)), np.ones(len(middle))
    for one, k in enumerate(_NEIGHBOURS):
        others = np.delete(offsets, one, axis=0)
        share = np.prod(others / (others - offsets[one]), axis=0)  # Lagrange's, at the pose
        missed += share[:, None] * _differences(trajectory, middle, k)
        squares += share**2
    return missed / np.sqrt(squares)[:, None]


def _runs(stamps_ns: NDArray[np.int64]) -> tuple[NDArray[np.int64], FloatArray]:
    """Number the stretches without gaps, and give times in median steps."""
    steps = np.diff(stamps_ns)
    usual = float(np.median(steps)) if len(steps) else 1.0
    runs = np.concatenate([[0], np.cumsum(steps > _WIDEST_STEP * usual)]).astype(np.int64)
    return runs, (stamps_ns - stamps_ns[0]) / usual


def _differences(trajectory: Trajectory, at: NDArray[np.int64], k: int) -> FloatArray:
    """(N, 6) float64: from poses to the k-th after each, in metres and as rotation vectors."""
    positions, quaternions = trajectory.positions, trajectory.quaternions_xyzw
    turns = product(quaternions[at] * np.array([-1.0, -1.0, -1.0, 1.0]), quaternions[at + k])
    return np.hstack([positions[at + k] - positions[at], rotation_vectors(turns)])


def smoothed_locally(trajectory: Trajectory, jitter: FloatArray) -> SmoothedPoses:
    """Poses on local parabolas, over windows as wide as their motion allows.

    Parameters
    ----------
    trajectory : Trajectory
    jitter : (2,) float64
        Standard deviation of the position, metres, and of the attitude, radians; what is
        too small to matter is left as it is.

    Returns
    -------
    SmoothedPoses

    Notes
    -----
    Each pose is fitted with its neighbours by least squares, the attitude as rotation vectors
    from its own. The value of the fit is a mean with weights whose squares sum to ``h``, the
    weight of the pose itself; so the pose misses its neighbours' fit by ``(x - fit) / (1 - h)``,
    and the window is taken whose misses are least around it. No window reaches across a gap.
    """
    wanted = jitter > _LEAST
    count = len(trajectory)
    steps, shares = np.zeros((count, 6)), np.ones((count, 2))
    # A fit as wrong as the pose itself would miss it by twice the variance, along three axes.
    least = np.tile(_MUST_GAIN * 6.0 * jitter**2, (count, 1))
    for fit, weight in _windows(trajectory):
        # A pose that its fit follows closely gains nothing by it.
        gains = wanted & (weight < _MUST_GAIN)[:, None]
        misses = fit / np.maximum(1.0 - weight, 1e-9)[:, None]
        squares = (misses**2).reshape(-1, 2, 3).sum(axis=2)
        errors = _averaged(np.minimum(squares, _OUTLIER * jitter**2))
        better = (errors < least) & gains
        least = np.where(better, errors, least)
        steps = np.where(np.repeat(better, 3, axis=1), fit, steps)
        shares = np.where(better, weight[:, None], shares)
    turned = product(trajectory.quaternions_xyzw, quaternions_of(steps[:, 3:]))
    moved = replace(
        trajectory, positions=trajectory.positions + steps[:, :3], quaternions_xyzw=turned
    )
    return SmoothedPoses(moved, shares.mean(axis=0))


def _windows(trajectory: Trajectory) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Fit every pose with more and more neighbours.

    Yields
    ------
    fit : (N, 6) float64
        From each pose to the parabola at its stamp.
    weight : (N,) float64
        Share that the pose has in it.
    """
    runs, times = _runs(trajectory.stamps_ns)
    count = len(times)
    powers, moments = np.zeros((5, count)), np.zeros((3, count, 6))
    powers[0] = 1.0
    for reach in range(1, _REACHES[-1] + 1):
        for k in (-reach, reach):
            at = np.arange(max(-k, 0), count - max(k, 0))
            at = at[runs[at] == runs[at + k]]
            apart, values = times[at + k] - times[at], _differences(trajectory, at, k)
            for power in range(5):
                powers[power, at] += apart**power
            for power in range(3):
                moments[power, at] += apart[:, None] ** power * values
        if reach in _REACHES:
            first = _first_row(powers)
            yield np.einsum("pn,pnc->nc", first, moments), first[0]


def _first_row(powers: FloatArray) -> FloatArray:
    """(3, N) float64: first row of the inverse of each parabola's normal matrix."""
    s0, s1, s2, s3, s4 = powers
    minors = np.stack([s2 * s4 - s3 * s3, s2 * s3 - s1 * s4, s1 * s3 - s2 * s2])
    determinant = s0 * minors[0] + s1 * minors[1] + s2 * minors[2]
    # Fewer than three poses have no parabola; they stay where they are.
    known = determinant > 1e-9
    return np.where(known, minors, [[1.0], [0.0], [0.0]]) / np.where(known, determinant, 1.0)


def _averaged(values: FloatArray) -> FloatArray:
    """Means of the values around each, column by column."""
    sums = np.vstack([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    at = np.arange(len(values))
    low, high = np.maximum(at - _AROUND, 0), np.minimum(at + _AROUND + 1, len(values))
    means: FloatArray = (sums[high] - sums[low]) / (high - low)[:, None]
    return means
