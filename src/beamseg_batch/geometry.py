"""Lines, segments and rigid transforms: pure functions on arrays.

All arrays are float64 and metres unless said otherwise. A line is an anchor and a
unit direction, so the parameter ``t`` along it is metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.errors import ShapeError

__all__ = [
    "FloatArray",
    "RigidTransform",
    "angle_between_deg",
    "clusters",
    "connected",
    "covariance_along",
    "distances_to_line",
    "interpolate_quaternion",
    "line_parameters",
    "matrix_from_quaternion",
    "matrix_from_rpy",
    "normalised",
    "parabola",
    "project_onto_line",
    "section_frame",
    "unknown",
]

FloatArray = NDArray[np.float64]


@cache
def unknown(shape: int | tuple[int, ...]) -> FloatArray:
    """Array of NaN: numbers that nobody knows yet, or not at all.

    Parameters
    ----------
    shape : int or tuple of int

    Returns
    -------
    float64 array
        Read only, and one and the same for everyone who asks.
    """
    array = np.full(shape, np.nan)
    array.flags.writeable = False
    return array


def _points_3d(points: FloatArray) -> FloatArray:
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ShapeError(f"points must have shape (N, 3), not {points.shape}")
    return points


def normalised(vector: FloatArray) -> FloatArray:
    """Vector of length one in the direction of `vector`.

    Parameters
    ----------
    vector : (3,) float64

    Returns
    -------
    (3,) float64

    Raises
    ------
    ShapeError
        If the vector has no length, hence no direction.
    """
    length = float(np.linalg.norm(vector))
    if not length > 0.0:
        raise ShapeError("a vector of length zero has no direction")
    return np.asarray(vector, dtype=np.float64) / length


def covariance_along(covariance: FloatArray, t: float) -> FloatArray:
    """Covariance of a point of a line.

    Parameters
    ----------
    covariance : (6, 6) float64
        Of the line's anchor and direction.
    t : float
        The point is ``anchor + t * direction``.

    Returns
    -------
    (3, 3) float64
    """
    both = covariance[:3, 3:]
    found: FloatArray = covariance[:3, :3] + t * (both + both.T) + t * t * covariance[3:, 3:]
    return found


def line_parameters(points: FloatArray, anchor: FloatArray, direction: FloatArray) -> FloatArray:
    """Parameter ``t`` of the foot of each point on a line.

    Parameters
    ----------
    points : (N, 3) float64, metres
    anchor : (3,) float64, metres
    direction : (3,) float64, unit vector

    Returns
    -------
    (N,) float64, metres

    Raises
    ------
    ShapeError
        If `points` is not (N, 3).
    """
    return (_points_3d(points) - anchor) @ direction


def parabola(t: Any, first: float, last: float) -> tuple[Any, Any]:
    """How far an axis of unit bow is from its chord, and how steeply it leaves it.

    Parameters
    ----------
    t : float or array, metres
        Where, along the chord.
    first, last : float, metres
        Its ends.

    Returns
    -------
    off, slope : float or array
        1 and 0 halfway, 0 and 4 over the length at the first end.
    """
    share = (2.0 * t - first - last) / (last - first)
    return 1.0 - share * share, -4.0 * share / (last - first)


def section_frame(direction: FloatArray, roll: float = 0.0) -> FloatArray:
    """The u and v of a cross-section, and the axis that it stands across.

    Parameters
    ----------
    direction : (3,) float64, unit vector
        Of the axis.
    roll : float, radians
        Turn of the section about it.

    Returns
    -------
    (3, 3) float64
        The three, as the columns of a rotation to the world. Without roll u is horizontal and
        v points upwards; on a vertical axis u is the world's x.
    """
    x, y, z = direction
    level = np.array([-y, x, 0.0])
    across = float(np.linalg.norm(level))
    u = np.array([1.0, 0.0, 0.0]) if across < 1e-9 else level / across
    v = np.array([-z * u[1], z * u[0], x * u[1] - y * u[0]])
    cos, sin = np.cos(roll), np.sin(roll)
    return np.column_stack([cos * u + sin * v, cos * v - sin * u, direction])


def project_onto_line(points: FloatArray, anchor: FloatArray, direction: FloatArray) -> FloatArray:
    """Foot of each point on a line.

    Parameters
    ----------
    points : (N, 3) float64, metres
    anchor : (3,) float64, metres
    direction : (3,) float64, unit vector

    Returns
    -------
    (N, 3) float64, metres

    Raises
    ------
    ShapeError
        If `points` is not (N, 3).

    Notes
    -----
    The operation ``proj_seg(v)`` of the report, section 3.2.6.
    """
    return np.outer(line_parameters(points, anchor, direction), direction) + anchor


def distances_to_line(points: FloatArray, anchor: FloatArray, direction: FloatArray) -> FloatArray:
    """Distance of each point to a line.

    Parameters
    ----------
    points : (N, 3) float64, metres
    anchor : (3,) float64, metres
    direction : (3,) float64, unit vector

    Returns
    -------
    (N,) float64, metres

    Raises
    ------
    ShapeError
        If `points` is not (N, 3).

    Notes
    -----
    Dalitz et al., IPOL 2017, equation (7).
    """
    points = _points_3d(points)
    distances: FloatArray = np.linalg.norm(
        points - project_onto_line(points, anchor, direction), axis=1
    )
    return distances


def angle_between_deg(direction_1: FloatArray, direction_2: FloatArray) -> float:
    """Angle between two undirected lines.

    Parameters
    ----------
    direction_1, direction_2 : (3,) float64, unit vectors

    Returns
    -------
    float, degrees, 0 to 90
    """
    sine = float(np.linalg.norm(np.cross(direction_1, direction_2)))
    cosine = abs(float(np.dot(direction_1, direction_2)))
    return float(np.degrees(np.arctan2(sine, cosine)))


def matrix_from_quaternion(quaternion_xyzw: FloatArray) -> FloatArray:
    """Rotation matrix of a unit quaternion.

    Parameters
    ----------
    quaternion_xyzw : (4,) float64
        Components x, y, z, w. Normalised here.

    Returns
    -------
    (3, 3) float64

    Raises
    ------
    ShapeError
        If the quaternion has length zero.

    Notes
    -----
    The matrix R of the report, section 3.2.5.
    """
    x, y, z, w = normalised(quaternion_xyzw)
    return np.array(
        [
            [1 - 2 * y * y - 2 * z * z, 2 * x * y - 2 * z * w, 2 * x * z + 2 * y * w],
            [2 * x * y + 2 * z * w, 1 - 2 * x * x - 2 * z * z, 2 * y * z - 2 * x * w],
            [2 * x * z - 2 * y * w, 2 * y * z + 2 * x * w, 1 - 2 * x * x - 2 * y * y],
        ]
    )


def matrix_from_rpy(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Rotation matrix of roll, pitch and yaw about the fixed x, y and z axes.

    Parameters
    ----------
    roll, pitch, yaw : float, radians

    Returns
    -------
    (3, 3) float64
        ``Rz(yaw) @ Ry(pitch) @ Rx(roll)``, the convention of ROS (REP 103).
    """
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def interpolate_quaternion(
    first_xyzw: FloatArray, second_xyzw: FloatArray, share: float
) -> FloatArray:
    """Rotation between two rotations, along the shorter arc.

    Parameters
    ----------
    first_xyzw, second_xyzw : (4,) float64, unit quaternions
    share : float
        0 gives the first, 1 the second.

    Returns
    -------
    (4,) float64, unit quaternion

    Notes
    -----
    Spherical linear interpolation (Shoemake 1985). Below 1e-3 rad the chord replaces
    the arc: it differs by less than 1e-10 rad there and has no division by zero.
    """
    cosine = float(np.dot(first_xyzw, second_xyzw))
    if cosine < 0.0:
        second_xyzw, cosine = -second_xyzw, -cosine
    angle = float(np.arccos(min(cosine, 1.0)))
    if angle < 1e-3:
        return normalised((1.0 - share) * first_xyzw + share * second_xyzw)
    weights = np.sin([(1.0 - share) * angle, share * angle]) / np.sin(angle)
    return normalised(weights[0] * first_xyzw + weights[1] * second_xyzw)


def connected(n: int, links: NDArray[np.int64]) -> NDArray[np.int64]:
    """Label what hangs together.

    Parameters
    ----------
    n : int
        Number of things.
    links : (K, 2) int64
        Pairs of things that belong together.

    Returns
    -------
    (n,) int64
        The lowest number among the things that hang together with each.
    """
    parent = list(range(n))

    def root(thing: int) -> int:
        while parent[thing] != thing:
            parent[thing] = parent[parent[thing]]
            thing = parent[thing]
        return thing

    for one, other in links.tolist():
        low, high = sorted((root(one), root(other)))
        parent[high] = low
    return np.array([root(thing) for thing in range(n)], dtype=np.int64)


def clusters(positions: FloatArray, reaches: FloatArray) -> list[NDArray[np.int64]]:
    """Group positions that lie within reach of one another.

    Parameters
    ----------
    positions : (N, 3) float64, metres
    reaches : (N,) float64, metres
        Two positions belong together within the larger of their reaches.

    Returns
    -------
    list of (K,) int64
        Indices of each group, ascending, in order of their first.
    """
    links = [np.empty((0, 2), dtype=np.int64)]
    for i in range(len(positions) - 1):
        distances = np.linalg.norm(positions[i + 1 :] - positions[i], axis=1)
        near = np.flatnonzero(distances <= np.maximum(reaches[i + 1 :], reaches[i])) + i + 1
        links.append(np.stack([np.full_like(near, i), near], axis=1))
    labels = connected(len(positions), np.concatenate(links))
    return [np.flatnonzero(labels == label) for label in np.unique(labels)]


@dataclass(frozen=True, eq=False)
class RigidTransform:
    """A rotation followed by a translation, named ``T_target_source``.

    Attributes
    ----------
    rotation : (3, 3) float64
    translation : (3,) float64, metres, target frame
    """

    rotation: FloatArray
    translation: FloatArray

    @classmethod
    def identity(cls) -> RigidTransform:
        """Return the transform that moves nothing."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_quaternion(cls, position: FloatArray, quaternion_xyzw: FloatArray) -> RigidTransform:
        """Build the transform of a pose message.

        Parameters
        ----------
        position : (3,) float64, metres
        quaternion_xyzw : (4,) float64
            Need not be normalised.

        Returns
        -------
        RigidTransform

        Raises
        ------
        ShapeError
            If the quaternion has length zero.
        """
        return cls(matrix_from_quaternion(quaternion_xyzw), np.asarray(position, dtype=np.float64))

    def __matmul__(self, other: RigidTransform) -> RigidTransform:
        """Chain two transforms: ``T_a_c = T_a_b @ T_b_c``."""
        return RigidTransform(self.rotation @ other.rotation, self.apply(other.translation))

    def inverse(self) -> RigidTransform:
        """Return the transform from target to source."""
        return RigidTransform(self.rotation.T, -self.rotation.T @ self.translation)

    def apply(self, points: FloatArray) -> FloatArray:
        """Move points from the source frame to the target frame.

        Parameters
        ----------
        points : (3,) or (N, 3) float64, metres, source frame

        Returns
        -------
        the same shape, metres, target frame

        Notes
        -----
        ``a_world = R a_drone + P_world``, the report, section 3.2.5.
        """
        moved: FloatArray = points @ self.rotation.T + self.translation
        return moved

    def rotate(self, vectors: FloatArray) -> FloatArray:
        """Turn directions from the source frame to the target frame.

        Parameters
        ----------
        vectors : (3,) or (N, 3) float64, source frame

        Returns
        -------
        the same shape, target frame

        Notes
        -----
        ``b_world = R b_drone``, the report, section 3.2.5.
        """
        turned: FloatArray = vectors @ self.rotation.T
        return turned
