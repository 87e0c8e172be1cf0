"""Where members meet."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from beamseg_batch.geometry import FloatArray, clusters

__all__ = ["Joint", "find_joints"]

_PARALLEL = 1e-3
"""Sine of an angle below which members that lie beside one another have no one joint."""


@dataclass(frozen=True, eq=False)
class Joint:
    """A place where members meet: `position` (3,) metres, `members` by number, rising."""

    position: FloatArray
    members: tuple[int, ...]


def find_joints(axes: Sequence[FloatArray], radii: FloatArray) -> tuple[Joint, ...]:
    """Find all places where members meet.

    Parameters
    ----------
    axes : sequence of (N, 3) float64, metres
        Nodes of each member's axis, straight between them: two of a straight member.
    radii : (M,) float64, metres

    Returns
    -------
    tuple of Joint
        By their members. Two members meet where their axes come within the sum of their
        radii; places closer than that are one joint, at the point that lies nearest to all
        its axes. Members that run along one another have no one such place and are left out.
    """
    met = list(_meetings(axes, radii))
    places = np.array([meeting.place for meeting in met]).reshape(-1, 3)
    reaches = np.array([meeting.reach for meeting in met])
    joints = []
    for group in clusters(places, reaches):
        members = sorted({number for k in group for number in met[k].pair})
        position = _nearest_point([axes[number] for number in members], places[group].mean(axis=0))
        joints.append(Joint(position, tuple(members)))
    return tuple(sorted(joints, key=lambda joint: joint.members))


@dataclass(frozen=True, eq=False)
class _Meeting:
    """Two members that meet, the place, and how near to it others are at the same one."""

    pair: tuple[int, int]
    place: FloatArray
    reach: float


def _meetings(axes: Sequence[FloatArray], radii: FloatArray) -> Iterator[_Meeting]:
    low = np.array([axis.min(axis=0) for axis in axes]).reshape(-1, 3) - radii[:, None]
    high = np.array([axis.max(axis=0) for axis in axes]).reshape(-1, 3) + radii[:, None]
    for i, axis in enumerate(axes):
        near = ((low[i] <= high[i + 1 :]) & (low[i + 1 :] <= high[i])).all(axis=1)
        for j in (np.flatnonzero(near) + i + 1).tolist():
            reach = float(radii[i] + radii[j])
            first, second = _closest(axis, axes[j])
            if np.linalg.norm(first - second) <= reach and not _run_along(axis, axes[j], reach):
                yield _Meeting((i, j), (first + second) / 2.0, reach)


def _closest(first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points of two chains of nodes, (N, 3) and (M, 3), that lie nearest to one another.

    Of two straight pieces the nearest points are inside both, where the gradient vanishes,
    or one of them is an end: all such pairs are tried, (5, N - 1, M - 1) of them.
    """
    a, u = first[:-1, None], np.diff(first, axis=0)[:, None]
    c, v = second[None, :-1], np.diff(second, axis=0)[None]
    w = a - c
    uu, uv, vv = _dot(u, u), _dot(u, v), _dot(v, v)
    uw, vw = _dot(u, w), _dot(v, w)
    determinant = uu * vv - uv * uv
    inside = np.where(determinant > 1e-12 * uu * vv, determinant, np.inf)  # else parallel
    pairs = [
        (np.zeros_like(uv), vw / vv),
        (np.ones_like(uv), (vw + uv) / vv),
        (-uw / uu, np.zeros_like(uv)),
        ((uv - uw) / uu, np.ones_like(uv)),
        ((uv * vw - vv * uw) / inside, (uu * vw - uv * uw) / inside),
    ]
    # Whatever is cut to the pieces are points of them, so nothing nearer than there is wins.
    s, t = (np.clip(np.array(shares), 0.0, 1.0)[..., None] for shares in zip(*pairs, strict=True))
    on_first, on_second = a + s * u, c + t * v
    distances = np.linalg.norm(on_first - on_second, axis=-1)
    best = np.unravel_index(int(distances.argmin()), distances.shape)
    return on_first[best], on_second[best]


def _dot(one: FloatArray, other: FloatArray) -> FloatArray:
    products: FloatArray = (one * other).sum(axis=-1)
    return products


def _run_along(first: FloatArray, second: FloatArray, reach: float) -> bool:
    """Whether the chords of two axes are parallel and lie beside one another."""
    (start, direction, length), (_, other, _) = _chord(first), _chord(second)
    if float(np.linalg.norm(np.cross(direction, other))) > _PARALLEL:
        return False
    low, high = np.sort((second[[0, -1]] - start) @ direction)
    return bool(min(high, length) - max(low, 0.0) > reach)


def _chord(axis: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Start, direction and length of the straight line between the ends of an axis."""
    span = axis[-1] - axis[0]
    length = float(np.linalg.norm(span))
    return axis[0], span / length, length


def _nearest_point(axes: Sequence[FloatArray], guess: FloatArray) -> FloatArray:
    """Point nearest, in least squares, to the lines through the pieces of axes at a guess.

    Where they leave it open, as members do that continue one another, it stays near the
    guess.
    """
    lhs, rhs = np.zeros((3, 3)), np.zeros(3)
    for axis in axes:
        foot, direction = _foot(axis, guess)
        across = np.eye(3) - np.outer(direction, direction)
        lhs += across
        rhs += across @ (foot - guess)
    return guess + np.asarray(np.linalg.lstsq(lhs, rhs, rcond=1e-6)[0], dtype=np.float64)


def _foot(axis: FloatArray, point: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Point of an axis nearest to another, and the direction of the piece it lies on."""
    starts, spans = axis[:-1], np.diff(axis, axis=0)
    shares = np.clip(_dot(point - starts, spans) / _dot(spans, spans), 0.0, 1.0)
    feet = starts + shares[:, None] * spans
    nearest = int(np.linalg.norm(feet - point, axis=1).argmin())
    return feet[nearest], spans[nearest] / np.linalg.norm(spans[nearest])
