"""Many rotations at once, as quaternions x, y, z, w."""

from __future__ import annotations

import numpy as np

from beamseg_batch.geometry import FloatArray

__all__ = ["multiplied", "quaternions_from_rpy", "quaternions_from_vectors"]


def multiplied(first: FloatArray, second: FloatArray) -> FloatArray:
    """Products of quaternions: the second rotation, then the first.

    Parameters
    ----------
    first, second : (N, 4) float64

    Returns
    -------
    (N, 4) float64
    """
    vector = (
        first[:, 3:] * second[:, :3]
        + second[:, 3:] * first[:, :3]
        + np.cross(first[:, :3], second[:, :3])
    )
    scalar = first[:, 3] * second[:, 3] - np.einsum("ni,ni->n", first[:, :3], second[:, :3])
    return np.column_stack([vector, scalar])


def quaternions_from_vectors(vectors: FloatArray) -> FloatArray:
    """Quaternions of rotation vectors: the axis, as long as the angle in radians.

    Parameters
    ----------
    vectors : (N, 3) float64, radians

    Returns
    -------
    (N, 4) float64, unit quaternions
    """
    halves = np.linalg.norm(vectors, axis=1) / 2.0
    # sinc(x / pi) is sin(x) / x, and 1 at zero.
    return np.column_stack([vectors / 2.0 * np.sinc(halves / np.pi)[:, None], np.cos(halves)])


def quaternions_from_rpy(rpy: FloatArray) -> FloatArray:
    """Quaternions of roll, pitch and yaw about the fixed x, y and z axes.

    Parameters
    ----------
    rpy : (N, 3) float64, radians

    Returns
    -------
    (N, 4) float64, unit quaternions
        ``Rz(yaw) @ Ry(pitch) @ Rx(roll)``, as `matrix_from_rpy`.
    """
    roll, pitch, yaw = (
        quaternions_from_vectors(rpy[:, [axis]] * np.eye(3)[axis]) for axis in range(3)
    )
    return multiplied(yaw, multiplied(pitch, roll))
