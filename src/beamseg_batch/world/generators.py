"""Parametric structures: members of towers, bridges, bends, joints and parallels.

Each function places a structure in its own frame, z upwards, metres; `placement.placed` moves it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from beamseg_batch.geometry import FloatArray
from beamseg_batch.world.scene import Member, Section

__all__ = [
    "angle_pairs",
    "bridge_truss",
    "lattice_tower",
    "parallel_pairs",
    "star_joint",
]

_GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


def lattice_tower(
    height: float,
    base: float,
    top: float,
    panels: int,
    legs: Section,
    horizontals: Section,
    diagonals: Section,
) -> list[Member]:
    """Tower on a square: four legs, a square of horizontals atop each panel, crossed diagonals.

    Parameters
    ----------
    height : float, metres
    base, top : float, metres
        Side of the square at the foot and at the top.
    panels : int
        Storeys of equal height.
    legs, horizontals, diagonals : Section

    Returns
    -------
    list of Member
        ``4 + 12 * panels`` of them: the legs stand on the origin's plane.
    """
    corners = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]) / 2.0
    levels = np.linspace(0.0, 1.0, panels + 1)
    nodes = [
        np.column_stack([corners * (base + share * (top - base)), np.full(4, share * height)])
        for share in levels
    ]
    sides = [(corner, (corner + 1) % 4) for corner in range(4)]
    members = [Member(f"leg {i + 1}", nodes[0][i], nodes[-1][i], legs) for i in range(4)]
    members += [
        Member(f"horizontal {level}.{side}", nodes[level][i], nodes[level][j], horizontals)
        for level in range(1, panels + 1)
        for side, (i, j) in enumerate(sides, 1)
    ]
    return members + [
        Member(f"diagonal {level}.{side}{turn}", lower[i], upper[j], diagonals)
        for level, (lower, upper) in enumerate(pairwise(nodes), 1)
        for side, corners_of_side in enumerate(sides, 1)
        for turn, (i, j) in (("a", corners_of_side), ("b", corners_of_side[::-1]))
    ]


def bridge_truss(
    length: float,
    width: float,
    height: float,
    panels: int,
    chords: Section,
    posts: Section,
    diagonals: Section,
    crossbeams: Section,
) -> list[Member]:
    """Bridge of two trusses along x, tied below and above by crossbeams and crossed diagonals.

    Parameters
    ----------
    length, width, height : float, metres
        Between the axes of the outer members.
    panels : int
    chords, posts, diagonals, crossbeams : Section

    Returns
    -------
    list of Member
        ``8 + 10 * panels`` of them, centred on x and y, the lower chords at z = 0.
        Diagonals of the trusses rise towards mid-span.
    """
    x = np.linspace(-length / 2.0, length / 2.0, panels + 1)
    sides = {"left": width / 2.0, "right": -width / 2.0}
    levels = {"lower": 0.0, "upper": height}

    def node(i: int, side: str, level: str) -> FloatArray:
        return np.array([x[i], sides[side], levels[level]])

    def member(
        name: str, a: tuple[int, str, str], b: tuple[int, str, str], section: Section
    ) -> Member:
        return Member(name, node(*a), node(*b), section)

    members = [
        member(f"{level} chord {side}", (0, side, level), (panels, side, level), chords)
        for level in levels
        for side in sides
    ]
    for i in range(panels + 1):
        members += [
            member(f"post {side} {i}", (i, side, "lower"), (i, side, "upper"), posts)
            for side in sides
        ]
        members += [
            member(f"{level} crossbeam {i}", (i, "left", level), (i, "right", level), crossbeams)
            for level in levels
        ]
    for i in range(panels):
        foot, head = (i, i + 1) if i < panels / 2 else (i + 1, i)
        members += [
            member(
                f"diagonal {side} {i + 1}", (foot, side, "lower"), (head, side, "upper"), diagonals
            )
            for side in sides
        ]
        members += [
            member(f"{level} diagonal {i + 1}{turn}", (i, a, level), (i + 1, b, level), diagonals)
            for level in levels
            for turn, a, b in (("a", "left", "right"), ("b", "right", "left"))
        ]
    return members


def angle_pairs(
    angles: Sequence[float], length: float, spacing: float, section: Section
) -> list[Member]:
    """Pairs of members that meet end to end and bend by a flat angle.

    Parameters
    ----------
    angles : sequence of float, radians
        Between the directions of the two members of each pair; 0 would be one straight bar.
    length, spacing : float, metres
        Of each member, and from pair to pair along y.
    section : Section

    Returns
    -------
    list of Member
        They run along z and meet at z = 0, each pair in a plane of constant y, its ends
        bent towards negative x.
    """
    members = []
    for number, (angle, y) in enumerate(zip(angles, _row(len(angles), spacing), strict=True), 1):
        joint = np.array([0.0, y, 0.0])
        for name, sign in (("lower", -1.0), ("upper", 1.0)):
            reach = length * np.array([-np.sin(angle / 2.0), 0.0, sign * np.cos(angle / 2.0)])
            members.append(Member(f"pair {number} {name}", joint, joint + reach, section))
    return members


def star_joint(count: int, length: float, section: Section) -> list[Member]:
    """Members that meet in one joint and rise from it, spread evenly over the upper half.

    Parameters
    ----------
    count : int
    length : float, metres
    section : Section

    Returns
    -------
    list of Member
        From the origin outwards, along the points of a Fibonacci half-sphere. Up to twelve
        are at least 36 and at most 155 degrees apart: none continues another.
    """
    steps = np.arange(count)
    z = 1.0 - (steps + 0.5) / count
    across = np.sqrt(1.0 - z * z)
    azimuth = steps * _GOLDEN_ANGLE
    tips = length * np.column_stack([across * np.cos(azimuth), across * np.sin(azimuth), z])
    return [Member(f"arm {i + 1}", np.zeros(3), tip, section) for i, tip in enumerate(tips)]


def parallel_pairs(
    distances: Sequence[float], length: float, spacing: float, section: Section
) -> list[Member]:
    """Pairs of parallel members.

    Parameters
    ----------
    distances : sequence of float, metres
        Between the axes of each pair.
    length, spacing : float, metres
        Of each member, and from pair to pair along y.
    section : Section

    Returns
    -------
    list of Member
        Along z, centred on the origin, the two of a pair side by side along y.
    """
    half = np.array([0.0, 0.0, length / 2.0])
    members = []
    pairs = zip(distances, _row(len(distances), spacing), strict=True)
    for number, (distance, y) in enumerate(pairs, 1):
        for name, sign in (("left", 1.0), ("right", -1.0)):
            centre = np.array([0.0, y + sign * distance / 2.0, 0.0])
            members.append(Member(f"pair {number} {name}", centre - half, centre + half, section))
    return members


def _row(count: int, spacing: float) -> list[float]:
    """Places in a row, centred on 0."""
    return [(number - (count - 1) / 2.0) * spacing for number in range(count)]
