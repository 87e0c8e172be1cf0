"""Where things stand: turning, taking apart and moving."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from beamseg_batch.geometry import FloatArray, RigidTransform, matrix_from_quaternion, normalised
from beamseg_batch.world.scene import Member, Section

__all__ = ["matrix_from_axis_angle", "placed", "roll_of", "rotation_and_scale"]


def matrix_from_axis_angle(axis: FloatArray, angle: float) -> FloatArray:
    """Rotation matrix of a turn about an axis.

    Parameters
    ----------
    axis : (3,) float64
        Need not be normalised.
    angle : float, radians

    Returns
    -------
    (3, 3) float64

    Raises
    ------
    ShapeError
        If the axis has length zero.
    """
    sine, cosine = np.sin(angle / 2.0), np.cos(angle / 2.0)
    return matrix_from_quaternion(np.append(sine * normalised(axis), cosine))


def rotation_and_scale(linear: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Take a linear map apart into a scale along its source's axes and a rotation.

    Parameters
    ----------
    linear : (3, 3) float64

    Returns
    -------
    rotation : (3, 3) float64
    scale : (3,) float64
        ``linear = rotation @ diag(scale)``; the first is negative if the map mirrors.
    None
        If the map shears or flattens, so that it has no such parts.
    """
    scale = np.linalg.norm(linear, axis=0).round(12)  # a mere rotation has the scale 1
    if not scale.min() > 1e-9 * scale.max():
        return None
    rotation = linear / scale
    if np.abs(rotation.T @ rotation - np.eye(3)).max() > 1e-6:
        return None
    mirror = np.array([np.sign(np.linalg.det(rotation)), 1.0, 1.0])
    return rotation * mirror, scale * mirror


def roll_of(start: FloatArray, end: FloatArray, u: FloatArray) -> float:
    """Roll at which a member's section has its u axis along a direction.

    Parameters
    ----------
    start, end : (3,) float64, metres
        Ends of the member.
    u : (3,) float64
        Unit vector square to the axis.

    Returns
    -------
    float, radians
    """
    level = Member("", start, end, Section("round", 0.0, 0.0)).rotation
    return float(np.arctan2(u @ level[:, 1], u @ level[:, 0]))


def placed(
    members: Iterable[Member], T_world_structure: RigidTransform, prefix: str = ""
) -> list[Member]:
    """Move members into the world, their sections turned with them.

    Parameters
    ----------
    members : iterable of Member, structure frame
    T_world_structure : RigidTransform
    prefix : str
        Set before each name.

    Returns
    -------
    list of Member, world frame
    """
    return [_moved(member, T_world_structure, prefix) for member in members]


def _moved(member: Member, T: RigidTransform, prefix: str) -> Member:
    start, end = T.apply(member.start), T.apply(member.end)
    roll = roll_of(start, end, T.rotate(member.rotation[:, 0]))
    return Member(prefix + member.name, start, end, member.section, roll, member.bow)
