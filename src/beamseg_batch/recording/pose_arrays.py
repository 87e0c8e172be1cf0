"""Poses as arrays: chained, turned round and taken at other times, all at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.geometry import FloatArray, RigidTransform
from beamseg_batch.model import Trajectory

__all__ = [
    "chained",
    "constant",
    "product",
    "quaternions_of",
    "resampled",
    "reversed_poses",
    "rotated",
    "rotation_vectors",
    "smoothed",
]

_EVEN_STEP_NS = 10_000_000
_STRAIGHT = 0.9995
"""Cosine of half the angle from which on spherical interpolation is linear."""


def constant(pose: RigidTransform, stamps_ns: NDArray[np.int64]) -> Trajectory:
    """Trajectory of a frame that does not move.

    Parameters
    ----------
    pose : RigidTransform
    stamps_ns : (N,) int64

    Returns
    -------
    Trajectory
    """
    count = len(stamps_ns)
    quaternion = quaternion_from_matrix(pose.rotation)
    return Trajectory(
        stamps_ns, np.tile(pose.translation, (count, 1)), np.tile(quaternion, (count, 1))
    )


def quaternion_from_matrix(matrix: FloatArray) -> FloatArray:
    """Quaternion of a rotation: the eigenvector of largest eigenvalue, which is exact and stable.

    Parameters
    ----------
    matrix : (3, 3) float64

    Returns
    -------
    (4,) float64, unit, x y z w

    Notes
    -----
    Bar-Itzhack, "New method for extracting the quaternion from a rotation matrix", 2000.
    """
    r = matrix
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], 0.0, 0.0, 0.0],
            [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], 0.0, 0.0],
            [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], 0.0],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], np.trace(r)],
        ]
    )
    quaternion: FloatArray = np.linalg.eigh(k)[1][:, -1]  # reads the lower triangle
    return quaternion


def chained(first: Trajectory, second: Trajectory) -> Trajectory:
    """Poses of a frame in another's, that moves itself: ``T_a_b @ T_b_c``.

    Parameters
    ----------
    first, second : Trajectory
        With the same stamps.

    Returns
    -------
    Trajectory
    """
    turned = rotated(first.quaternions_xyzw, second.positions)
    quaternions = product(first.quaternions_xyzw, second.quaternions_xyzw)
    return Trajectory(first.stamps_ns, first.positions + turned, quaternions)


def reversed_poses(trajectory: Trajectory) -> Trajectory:
    """Inverse of every pose: ``T_b_a`` from ``T_a_b``.

    Parameters
    ----------
    trajectory : Trajectory

    Returns
    -------
    Trajectory
    """
    conjugates = trajectory.quaternions_xyzw * np.array([-1.0, -1.0, -1.0, 1.0])
    positions = -rotated(conjugates, trajectory.positions)
    return Trajectory(trajectory.stamps_ns, positions, conjugates)


def resampled(trajectory: Trajectory, stamps_ns: NDArray[np.int64]) -> Trajectory:
    """Poses at other stamps, position linear and rotation spherical in between.

    Parameters
    ----------
    trajectory : Trajectory
        At least one pose.
    stamps_ns : (N,) int64
        Increasing; those outside the trajectory are left out.

    Returns
    -------
    Trajectory
    """
    own = trajectory.stamps_ns
    inside = stamps_ns[(stamps_ns >= own[0]) & (stamps_ns <= own[-1])]
    before = np.clip(np.searchsorted(own, inside, side="right") - 1, 0, max(len(own) - 2, 0))
    after = np.minimum(before + 1, len(own) - 1)
    span = np.maximum(own[after] - own[before], 1)
    share = ((inside - own[before]) / span)[:, None]
    positions = trajectory.positions
    quaternions = trajectory.quaternions_xyzw
    return Trajectory(
        inside,
        (1.0 - share) * positions[before] + share * positions[after],
        _slerp(quaternions[before], quaternions[after], share),
    )


def _slerp(first: FloatArray, second: FloatArray, share: FloatArray) -> FloatArray:
    cosine = np.sum(first * second, axis=1, keepdims=True)
    second, cosine = np.where(cosine < 0.0, -second, second), np.abs(cosine)
    angle = np.arccos(np.minimum(cosine, 1.0))
    straight = cosine > _STRAIGHT
    sine = np.where(straight, 1.0, np.sin(angle))
    from_first = np.where(straight, 1.0 - share, np.sin((1.0 - share) * angle) / sine)
    from_second = np.where(straight, share, np.sin(share * angle) / sine)
    mixed = from_first * first + from_second * second
    unit: FloatArray = mixed / np.linalg.norm(mixed, axis=1, keepdims=True)
    return unit


def product(first: FloatArray, second: FloatArray) -> FloatArray:
    """Products of quaternions, row by row: the second rotation, then the first.

    Parameters
    ----------
    first, second : (N, 4) float64, x y z w

    Returns
    -------
    (N, 4) float64
    """
    u, a = first[:, :3], first[:, 3:]
    v, b = second[:, :3], second[:, 3:]
    real = a * b - np.sum(u * v, axis=1, keepdims=True)
    return np.hstack([a * v + b * u + np.cross(u, v), real])


def rotation_vectors(quaternions: FloatArray) -> FloatArray:
    """Rotation vectors of unit quaternions: the axis, as long as the angle in radians.

    Parameters
    ----------
    quaternions : (N, 4) float64, x y z w

    Returns
    -------
    (N, 3) float64, radians, no longer than pi
    """
    nearer = np.where(quaternions[:, 3:] < 0.0, -quaternions, quaternions)
    sines = np.linalg.norm(nearer[:, :3], axis=1, keepdims=True)
    halves = np.arctan2(sines, nearer[:, 3:])
    with np.errstate(invalid="ignore", divide="ignore"):
        longer = np.where(sines > 0.0, 2.0 * halves / sines, 2.0)
    vectors: FloatArray = nearer[:, :3] * longer
    return vectors


def quaternions_of(vectors: FloatArray) -> FloatArray:
    """Unit quaternions of rotation vectors.

    Parameters
    ----------
    vectors : (N, 3) float64, radians

    Returns
    -------
    (N, 4) float64, x y z w
    """
    halves = 0.5 * np.linalg.norm(vectors, axis=1, keepdims=True)
    # sinc(x / pi) is sin(x) / x, and 1 at zero.
    return np.hstack([0.5 * vectors * np.sinc(halves / np.pi), np.cos(halves)])


def smoothed(trajectory: Trajectory, width_s: float) -> Trajectory:
    """Poses without their jitter: a mean over a window in time that shifts nothing in time.

    Parameters
    ----------
    trajectory : Trajectory
        At least one pose.
    width_s : float
        Width of the window, a Hann window.

    Returns
    -------
    Trajectory
        100 poses a second.
    """
    first, last = trajectory.stamps_ns[[0, -1]].tolist()
    even = resampled(trajectory, np.arange(first, last + 1, _EVEN_STEP_NS, dtype=np.int64))
    quaternions = even.quaternions_xyzw
    along = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0.0
    signs = np.where(np.cumsum(np.r_[False, along]) % 2, -1.0, 1.0)  # q and -q are one rotation
    reach = round(0.5e9 * width_s / _EVEN_STEP_NS)
    window = np.hanning(2 * reach + 3)[1:-1]
    values = np.hstack([even.positions, quaternions * signs[:, None]])
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="edge")
    means = [np.convolve(column, window / window.sum(), "valid") for column in padded.T]
    smooth = np.stack(means, axis=1)
    lengths = np.linalg.norm(smooth[:, 3:], axis=1, keepdims=True)
    return Trajectory(even.stamps_ns, smooth[:, :3], smooth[:, 3:] / lengths)


def rotated(quaternions: FloatArray, vectors: FloatArray) -> FloatArray:
    """Vectors turned by unit quaternions, row by row.

    Parameters
    ----------
    quaternions : (N, 4) float64, x y z w
    vectors : (N, 3) float64

    Returns
    -------
    (N, 3) float64
    """
    u, w = quaternions[:, :3], quaternions[:, 3:]
    doubled = 2.0 * np.cross(u, vectors)
    turned: FloatArray = vectors + w * doubled + np.cross(u, doubled)
    return turned
