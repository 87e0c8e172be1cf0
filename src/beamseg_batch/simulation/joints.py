"""Where members meet."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from beamseg_batch.geometry import FloatArray, normalised
from beamseg_batch.simulation.solids import axis_nodes
from beamseg_batch.world.scene import Member

__all__ = ["Joint", "find_joints"]

_PARALLEL = 1e-3
"""Sine of an angle below which members that lie beside one another have no one joint."""


@dataclass(frozen=True, eq=False)
class Joint:
    """A place where members meet: `position` (3,) metres, `members` by number, rising."""

    position: FloatArray
    members: tuple[int, ...]


def find_joints(members: Sequence[Member]) -> list[Joint]:
    """Find all places where members meet.

    Parameters
    ----------
    members : sequence of Member

    Returns
    -------
    list of Joint
        Two members meet where their axes come within the sum of their radii; places
        closer than that are one joint, at the point that lies nearest to all its axes.
        Members that run along one another have no one such place and are left out.
    """
    meetings = list(_meetings(members))
    groups: list[list[_Meeting]] = []
    for meeting in meetings:
        near = [group for group in groups if any(meeting.is_at(other) for other in group)]
        groups = [group for group in groups if group not in near]
        groups.append([meeting, *(other for group in near for other in group)])
    joints = [_joint(members, group) for group in groups]
    return sorted(joints, key=lambda joint: joint.members)


@dataclass(frozen=True, eq=False)
class _Meeting:
    """Two members that meet, the place, and how near to it others are at the same one."""

    pair: tuple[int, int]
    place: FloatArray
    reach: float

    def is_at(self, other: _Meeting) -> bool:
        apart = float(np.linalg.norm(self.place - other.place))
        return apart < max(self.reach, other.reach)


def _meetings(members: Sequence[Member]) -> Iterator[_Meeting]:
    axes = [axis_nodes(member) for member in members]
    radii = np.array([member.section.radius for member in members])
    low = np.array([axis.min(axis=0) for axis in axes]).reshape(-1, 3) - radii[:, None]
    high = np.array([axis.max(axis=0) for axis in axes]).reshape(-1, 3) + radii[:, None]
    for i, axis in enumerate(axes):
        near = ((low[i] <= high[i + 1 :]) & (low[i + 1 :] <= high[i])).all(axis=1)
        for j in (np.flatnonzero(near) + i + 1).tolist():
            reach = float(radii[i] + radii[j])
            first, second = _closest(axis, axes[j])
            if np.linalg.norm(first - second) <= reach and not _run_along(
                members[i], members[j], reach
            ):
                yield _Meeting((i, j), (first + second) / 2.0, reach)


def _closest(first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points of two chains of nodes, (N, 3) and (M, 3), that lie nearest to one another."""
    pairs = [
        _closest_of_segments(a, b, c, d) for a, b in pairwise(first) for c, d in pairwise(second)
    ]
    return min(pairs, key=lambda pair: float(np.linalg.norm(pair[0] - pair[1])))


def _closest_of_segments(
    a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Points of the segments ab and cd that lie nearest to one another.

    The nearest points are inside both, where the gradient vanishes, or one of them is an
    end: all such pairs are tried.
    """
    u, v, w = b - a, d - c, a - c
    uu, uv, vv = float(u @ u), float(u @ v), float(v @ v)
    shares = [(s, float(np.clip((w + s * u) @ v / vv, 0.0, 1.0))) for s in (0.0, 1.0)]
    shares += [(float(np.clip((t * v - w) @ u / uu, 0.0, 1.0)), t) for t in (0.0, 1.0)]
    determinant = uu * vv - uv * uv
    if determinant > 1e-12 * uu * vv:
        s = float(uv * (w @ v) - vv * (w @ u)) / determinant
        t = float(uu * (w @ v) - uv * (w @ u)) / determinant
        if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
            shares.append((s, t))
    candidates = [(a + s * u, c + t * v) for s, t in shares]
    return min(candidates, key=lambda pair: float(np.linalg.norm(pair[0] - pair[1])))


def _run_along(first: Member, second: Member, reach: float) -> bool:
    axis, other = first.rotation[:, 2], second.rotation[:, 2]
    if float(np.linalg.norm(np.cross(axis, other))) > _PARALLEL:
        return False
    low, high = np.sort((np.array([second.start, second.end]) - first.start) @ axis)
    return bool(min(high, first.length) - max(low, 0.0) > reach)


def _joint(members: Sequence[Member], group: Sequence[_Meeting]) -> Joint:
    numbers = sorted({number for meeting in group for number in meeting.pair})
    middle = np.mean([meeting.place for meeting in group], axis=0)
    return Joint(_nearest_point([axis_nodes(members[n]) for n in numbers], middle), tuple(numbers))


def _nearest_point(axes: Sequence[FloatArray], guess: FloatArray) -> FloatArray:
    """Point nearest, in least squares, to the lines through the pieces of axes at a guess.

    Where they leave it open, as members do that continue one another, it stays near the
    guess.
    """
    lhs, rhs = np.zeros((3, 3)), np.zeros(3)
    for nodes in axes:
        pieces = [_foot(start, end, guess) for start, end in pairwise(nodes)]
        foot, direction = min(pieces, key=lambda piece: float(np.linalg.norm(piece[0] - guess)))
        across = np.eye(3) - np.outer(direction, direction)
        lhs += across
        rhs += across @ (foot - guess)
    return guess + np.asarray(np.linalg.lstsq(lhs, rhs, rcond=1e-6)[0], dtype=np.float64)


def _foot(start: FloatArray, end: FloatArray, point: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Point of a segment nearest to another, and the direction of the segment."""
    span = end - start
    share = np.clip((point - start) @ span / (span @ span), 0.0, 1.0)
    return start + share * span, normalised(span)
