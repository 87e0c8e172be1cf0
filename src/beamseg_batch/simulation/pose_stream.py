"""The poses that are recorded: the true ones, with the errors of their source."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.errors import ConfigError
from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import Trajectory
from beamseg_batch.simulation.rotations import multiplied, quaternions_from_vectors
from beamseg_batch.simulation.sensor import PoseSource
from beamseg_batch.simulation.trajectory import TruePath

__all__ = ["START_NS", "pose_times", "recorded_poses", "stamps_ns", "true_poses"]

START_NS = 1_700_000_000_000_000_000
"""Stamp of the start of every simulated flight."""
_BATCH = 4096


def stamps_ns(times: FloatArray) -> NDArray[np.int64]:
    """Stamps of some times, (N,) int64; `times` (N,) in seconds from the start."""
    return START_NS + np.rint(times * 1e9).astype(np.int64)


def pose_times(source: PoseSource, duration_s: float) -> FloatArray:
    """When a pose comes, gaps left out.

    Parameters
    ----------
    source : PoseSource
    duration_s : float

    Returns
    -------
    (N,) float64, seconds from the start

    Raises
    ------
    ConfigError
        If none is left.
    """
    times = np.arange(math.floor(duration_s * source.rate_hz + 1e-6) + 1) / source.rate_hz
    kept = np.ones(len(times), dtype=bool)
    for start, duration in source.gaps:
        kept &= (times < start) | (times >= start + duration)
    if not kept.any():
        raise ConfigError(f"poses.gaps leave no pose of a flight of {duration_s:g} s")
    return times[kept]


def true_poses(path: TruePath, times: FloatArray) -> Trajectory:
    """Poses as they truly are, at some times (N,) in seconds from the start."""
    batches = [path.poses(times[i : i + _BATCH]) for i in range(0, len(times), _BATCH)]
    positions, quaternions = (np.concatenate(parts) for parts in zip(*batches, strict=True))
    return Trajectory(stamps_ns(times), positions, quaternions)


def recorded_poses(truth: Trajectory, source: PoseSource, rng: np.random.Generator) -> Trajectory:
    """Add the errors of their source to true poses.

    Parameters
    ----------
    truth : Trajectory
    source : PoseSource
    rng : numpy.random.Generator

    Returns
    -------
    Trajectory
        With the same stamps. Errors of the attitude are small rotations about the axes
        of the world; those of drift add up from pose to pose.
    """
    n = len(truth)
    seconds = (truth.stamps_ns - START_NS)[:, None] * 1e-9
    jitter, walk = rng.standard_normal((2, 6, n)).transpose(0, 2, 1)
    walked = np.cumsum(walk, axis=0) - walk[:1]  # the first pose has not drifted yet
    shift = (
        source.jitter_position * jitter[:, :3]
        + source.walk_position * walked[:, :3]
        + seconds * np.array(source.drift_velocity)
    )
    turn = (
        math.radians(source.jitter_attitude_deg) * jitter[:, 3:]
        + source.walk_attitude * walked[:, 3:]
        + seconds * np.array([0.0, 0.0, math.radians(source.drift_yaw_rate_deg)])
    )
    attitudes = multiplied(quaternions_from_vectors(turn), truth.quaternions_xyzw)
    return Trajectory(truth.stamps_ns, truth.positions + shift, attitudes)
