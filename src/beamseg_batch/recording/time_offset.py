"""How far the clock of the clouds is from that of the poses, measured from the data.

A wrong offset smears what the drone saw while it turned or flew past. So the offset
sought is the one at which surfaces that several scans saw are thinnest. A coarse search
counts how few cells the accumulated cloud fills; from there, planes are fitted to the
points of each cell, and a step of least squares moves the offset so that the points come
nearest to their planes, until it moves no more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.errors import RecordingError
from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import Scan, Trajectory
from beamseg_batch.recording.clocks import duration_text
from beamseg_batch.recording.flight import Flight
from beamseg_batch.recording.matching import seconds_to_ns
from beamseg_batch.recording.pose_arrays import resampled, rotated, smoothed

__all__ = ["TimeOffset", "estimate_time_offset"]

_MOST_SCANS, _MOST_POINTS = 240, 400
_FEWEST_SCANS = 20
_FARTHEST_M = 10.0
_SMOOTHED_S = 0.4
_SEARCHED_S, _COARSE_STEP_S = 1.0, 0.05
_COARSE_CELL_M, _CELL_M = 0.1, 0.3
_SLOPE_STEP_S = 0.005
_FEWEST_IN_CELL = 12
_FLAT = 0.1
"""Largest share of a plane's variance that may lie across it, of that along its shorter side."""
_MOST_STEPS, _SMALLEST_STEP_S = 20, 1e-4
_TUKEY, _FLATTEST_M = 4.0, 1e-6
_LEAST_RISE = 1e-3
"""Metres per second that a wrong offset must move points off their planes to be seen."""
_N_PARTS = 4
_LONGEST_S = 86_400.0
_LARGEST_SIGMA_S = 0.02


@dataclass(frozen=True)
class TimeOffset:
    """What to add to the stamps of the clouds.

    Attributes
    ----------
    offset_s : float
        Goes into ``recording.time_offset_s``: that of the configuration is included.
    sigma_s : float
        Its standard deviation, from parts of the flight apart.
    n_scans : int
        Scans that it rests on.
    """

    offset_s: float
    sigma_s: float
    n_scans: int


def estimate_time_offset(flight: Flight) -> TimeOffset:
    """Measure the time offset that makes the accumulated cloud sharpest.

    Parameters
    ----------
    flight : Flight
        Its selection of scans is thinned further.

    Returns
    -------
    TimeOffset

    Raises
    ------
    RecordingError
        If the flight does not tell: too few scans between poses, or no turns.
    """
    where = f"{flight.recording.name}: the time offset cannot be told"
    first, last = flight.trajectory.stamps_ns[[0, -1]].tolist()
    if (last - first) * 1e-9 > _LONGEST_S:
        raise RecordingError(
            f"{where}: the stamps of the poses span {duration_text((last - first) * 1e-9)}; "
            "their clock was set anew: see --time-source"
        )
    scans = _some_scans(flight)
    # A jittering pose would draw the offset to where interpolation averages two of them.
    trajectory = smoothed(flight.trajectory, _SMOOTHED_S)
    if len(scans) < _FEWEST_SCANS:
        raise RecordingError(
            f"{where}: only {len(scans)} scans with returns within {_SEARCHED_S:g} s of the "
            f"poses, {_FEWEST_SCANS} are needed; see --time-source and --time-offset"
        )
    steps = np.arange(-_SEARCHED_S, _SEARCHED_S + 1e-9, _COARSE_STEP_S)
    filled = [_sharpness(_world(trajectory, scans, step)) for step in steps]
    start_s = float(steps[int(np.argmax(filled))])
    found = [_refined(trajectory, scans[part::_N_PARTS], start_s) for part in range(_N_PARTS)]
    sigma_s = float(np.std(found, ddof=1)) / _N_PARTS**0.5
    offset_s = _refined(trajectory, scans, start_s)
    if not sigma_s < _LARGEST_SIGMA_S or abs(offset_s) > _SEARCHED_S:
        raise RecordingError(
            f"{where}: parts of the flight give offsets that differ by {1e3 * sigma_s:.0f} ms or "
            f"lie beyond {_SEARCHED_S:g} s; it takes scans from turns and from several sides"
        )
    configured_s = flight.config.recording.time_offset_s
    return TimeOffset(configured_s + offset_s, sigma_s, len(scans))


@dataclass(frozen=True, eq=False)
class _BodyScan:
    """Stamp and some returns of a scan, (N, 3), metres, body frame."""

    stamp_ns: int
    points: FloatArray


def _some_scans(flight: Flight) -> list[_BodyScan]:
    """Take scans evenly from the flight, and points evenly from each."""
    every = -(-flight.n_clouds // _MOST_SCANS)
    margin_ns = seconds_to_ns(_SEARCHED_S)
    first, last = flight.trajectory.stamps_ns[[0, -1]].tolist()
    scans = []
    for scan in flight.thinned(every).scans():
        if not isinstance(scan, Scan):
            continue
        near = np.linalg.norm(scan.points, axis=1) < _FARTHEST_M  # NaN is not
        points = scan.points[near][:: 1 + int(near.sum()) // _MOST_POINTS].astype(np.float64)
        inside = first + margin_ns <= scan.stamp_ns <= last - margin_ns
        if len(points) and inside:
            scans.append(_BodyScan(scan.stamp_ns, scan.T_body_sensor.apply(points)))
    return scans


def _world(trajectory: Trajectory, scans: Sequence[_BodyScan], offset_s: float) -> FloatArray:
    """Points of all scans in the world frame, were the clouds' stamps later by an offset."""
    stamps = np.array([scan.stamp_ns for scan in scans]) + seconds_to_ns(offset_s)
    order = np.argsort(stamps, kind="stable")
    poses = resampled(trajectory, np.clip(stamps[order], *trajectory.stamps_ns[[0, -1]]))
    counts = [len(scans[k].points) for k in order.tolist()]
    points = np.concatenate([scans[k].points for k in order.tolist()])
    turned = rotated(np.repeat(poses.quaternions_xyzw, counts, axis=0), points)
    return turned + np.repeat(poses.positions, counts, axis=0)


def _cells(points: FloatArray, size_m: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Number of each point's cell, and how many points each cell holds."""
    places = np.floor(points / size_m).astype(np.int64)
    places -= places.min(axis=0)
    spans = places.max(axis=0) + 1
    keys = (places[:, 0] * spans[1] + places[:, 1]) * spans[2] + places[:, 2]
    _, cells, counts = np.unique(keys, return_inverse=True, return_counts=True)
    return cells, counts


def _sharpness(points: FloatArray) -> float:
    """Pairs of points that share a cell: the more, the sharper the cloud."""
    counts = _cells(points, _COARSE_CELL_M)[1]
    return float(np.sum(counts.astype(np.float64) ** 2))


def _refined(trajectory: Trajectory, scans: Sequence[_BodyScan], offset_s: float) -> float:
    """Step to where the points are nearest to the planes of their cells; NaN if there are none."""
    for _ in range(_MOST_STEPS):
        points = _world(trajectory, scans, offset_s)
        later = _world(trajectory, scans, offset_s + _SLOPE_STEP_S)
        earlier = _world(trajectory, scans, offset_s - _SLOPE_STEP_S)
        step_s = _step(points, (later - earlier) / (2.0 * _SLOPE_STEP_S))
        offset_s += step_s
        if not _SMALLEST_STEP_S < abs(step_s) < _SEARCHED_S:
            break
    return offset_s


def _step(points: FloatArray, slopes: FloatArray) -> float:
    """Change of the offset that brings points nearest to their planes, by least squares.

    Parameters
    ----------
    points : (N, 3) float64, metres, world frame
    slopes : (N, 3) float64
        How fast each point moves with the offset, metres per second.

    Returns
    -------
    float, seconds
        NaN when no plane is found, or none that the offset would move points off.
    """
    cells, counts = _cells(points, _CELL_M)
    spread = points - _means(points, cells, counts)[cells]
    relative = slopes - _means(slopes, cells, counts)[cells]
    products = np.einsum("ni,nj->nij", spread, spread).reshape(-1, 9)
    covariances = _means(products, cells, counts).reshape(-1, 3, 3)
    variances, axes = np.linalg.eigh(covariances)
    flat = (counts >= _FEWEST_IN_CELL) & (variances[:, 0] < _FLAT * variances[:, 1])
    used = flat[cells]
    if not used.any():
        return float("nan")
    normals = axes[:, :, 0][cells[used]]
    heights = np.sum(spread[used] * normals, axis=1)
    rises = np.sum(relative[used] * normals, axis=1)
    scale = 1.4826 * float(np.median(np.abs(heights))) * _TUKEY
    weights = np.maximum(1.0 - (heights / max(scale, _FLATTEST_M)) ** 2, 0.0) ** 2
    squares = float(np.sum(weights * rises**2))
    if squares <= _LEAST_RISE**2 * float(np.sum(weights)):
        return float("nan")
    return -float(np.sum(weights * rises * heights)) / squares


def _means(values: FloatArray, cells: NDArray[np.intp], counts: NDArray[np.intp]) -> FloatArray:
    """Mean of the rows of each cell."""
    sums = [np.bincount(cells, column, len(counts)) for column in values.T]
    return np.stack(sums, axis=1) / counts[:, None]
