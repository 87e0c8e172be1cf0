"""A scene as convex solids: boxes, capped cylinders and balls, side by side in arrays."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.geometry import FloatArray, normalised
from beamseg_batch.world.scene import Member, Scene

__all__ = [
    "BALL",
    "BOX",
    "CLUTTER",
    "CYLINDER",
    "Solids",
    "distances_to_solids",
    "solids_of",
]

BOX, CYLINDER, BALL = 0, 1, 2
"""Kinds of solids."""
CLUTTER = -1
"""Owner of a solid that is no member's."""


@dataclass(frozen=True, eq=False)
class Solids:
    """Convex solids; arrays of one row a solid.

    Attributes
    ----------
    kinds : (N,) int64
        `BOX`, `CYLINDER` along its z, or `BALL`.
    centres : (N, 3) float64, metres, world frame
    rotations : (N, 3, 3) float64
        The solid's axes, as columns, in the world frame.
    halves : (N, 3) float64, metres
        Half its extent along its axes: of a box, or of the box around it. A side may be
        zero: a rectangle is a box without thickness.
    owners : (N,) int64
        Number of the member that the solid is a part of, or `CLUTTER`.
    """

    kinds: NDArray[np.int64]
    centres: FloatArray
    rotations: FloatArray
    halves: FloatArray
    owners: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.kinds)

    def keep(self, mask: NDArray[np.bool_]) -> Solids:
        """Solids of a selection, (N,) bool."""
        return Solids(
            self.kinds[mask],
            self.centres[mask],
            self.rotations[mask],
            self.halves[mask],
            self.owners[mask],
        )


class _Solid(NamedTuple):
    kind: int
    centre: FloatArray
    rotation: FloatArray
    half: FloatArray
    owner: int


def solids_of(scene: Scene) -> Solids:
    """Build the solids of a scene; its meshes are left out.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    Solids
        Those of the members first, in order. A bent member is a chain of straight ones
        that lies within 0.01 mm of its axis.
    """
    solids = [
        *(solid for owner, member in enumerate(scene.members) for solid in _parts(member, owner)),
        *(_Solid(BOX, b.centre, b.rotation, b.size / 2.0, CLUTTER) for b in scene.boxes),
        *(_Solid(BALL, s.centre, np.eye(3), np.full(3, s.radius), CLUTTER) for s in scene.spheres),
        *(
            _Solid(BOX, r.centre, r.rotation, np.append(r.size / 2.0, 0.0), CLUTTER)
            for r in scene.rectangles
        ),
    ]
    return _stacked(solids)


def _stacked(solids: Iterable[_Solid]) -> Solids:
    columns: tuple[Sequence[Any], ...] = tuple(zip(*solids, strict=True)) or ((),) * 5
    kinds, centres, rotations, halves, owners = columns
    return Solids(
        np.array(kinds, dtype=np.int64),
        np.array(centres, dtype=np.float64).reshape(-1, 3),
        np.array(rotations, dtype=np.float64).reshape(-1, 3, 3),
        np.array(halves, dtype=np.float64).reshape(-1, 3),
        np.array(owners, dtype=np.int64),
    )


def _parts(member: Member, owner: int) -> Iterator[_Solid]:
    """Solids of a member: a cylinder, or a box for each plate, for each straight piece."""
    section = member.section
    plates = section.plates()
    reach = max((abs(v) + height / 2.0 for _, v, _, height in plates), default=section.radius)
    for centre, rotation, half_length in _pieces(member, reach):
        if not plates:
            half = np.array([section.radius, section.radius, half_length])
            yield _Solid(CYLINDER, centre, rotation, half, owner)
        for u, v, width, height in plates:
            offset = rotation @ np.array([u, v, 0.0])
            half = np.array([width / 2.0, height / 2.0, half_length])
            yield _Solid(BOX, centre + offset, rotation, half, owner)


def _pieces(member: Member, reach: float) -> Iterator[tuple[FloatArray, FloatArray, float]]:
    """Straight pieces of a member's axis: centre, rotation and half the length of each.

    Where two pieces meet at an angle, both are made longer so that no wedge opens on the
    outside of the bend, at `reach` from the axis.
    """
    nodes = member.nodes
    steps = np.diff(nodes, axis=0)
    directions = [normalised(step) for step in steps]
    bends = [math.acos(min(float(a @ b), 1.0)) for a, b in pairwise(directions)]
    extras = [0.0, *(reach * math.tan(bend / 2.0) for bend in bends), 0.0]
    across = member.rotation[:, 0]
    for number, (step, direction) in enumerate(zip(steps, directions, strict=True)):
        before, after = extras[number], extras[number + 1]
        rotation = np.column_stack([across, np.cross(direction, across), direction])
        centre = nodes[number] + step / 2.0 + direction * (after - before) / 2.0
        yield centre, rotation, (float(np.linalg.norm(step)) + before + after) / 2.0


def distances_to_solids(solids: Solids, points: FloatArray) -> FloatArray:
    """Distance of each point to each solid.

    Parameters
    ----------
    solids : Solids
    points : (M, 3) float64, metres, world frame

    Returns
    -------
    (M, N) float64, metres
        Zero inside a solid.
    """
    local = np.einsum("mni,nij->mnj", points[:, None] - solids.centres, solids.rotations)
    beyond = np.abs(local) - solids.halves
    to_box = np.linalg.norm(np.maximum(beyond, 0.0), axis=2)
    around = np.maximum(np.linalg.norm(local[..., :2], axis=2) - solids.halves[:, 0], 0.0)
    to_cylinder = np.hypot(around, np.maximum(beyond[..., 2], 0.0))
    to_ball = np.maximum(np.linalg.norm(local, axis=2) - solids.halves[:, 0], 0.0)
    distances: FloatArray = np.choose(solids.kinds, [to_box, to_cylinder, to_ball])
    return distances
