"""The scene: members and clutter as they truly stand, in the world frame, metres."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from beamseg_batch.geometry import FloatArray, section_frame
from beamseg_batch.section import Section, Shape
from beamseg_batch.world.joints import Joint, find_joints

__all__ = ["Box", "Member", "Mesh", "Rectangle", "Scene", "Section", "Shape", "Sphere"]

_CHORD_ERROR = 1e-5
"""Most that the straight pieces of a bent member may lie off its axis, metres."""


@dataclass(frozen=True, eq=False)
class Member:
    """A member of the structure.

    Attributes
    ----------
    name : str
    start, end : (3,) float64, metres, world frame
        Ends of the axis, which runs through the section's centre of area.
    section : Section
    roll : float, radians
        Turn of the section about the axis, from start to end; see `rotation`.
    bow : float, metres
        Largest deviation of the axis from its chord, at mid-length, towards the section's
        v; the axis is a parabola.
    """

    name: str
    start: FloatArray
    end: FloatArray
    section: Section
    roll: float = 0.0
    bow: float = 0.0

    @cached_property
    def length(self) -> float:
        """Length of the chord, metres."""
        return float(np.linalg.norm(self.end - self.start))

    @cached_property
    def rotation(self) -> FloatArray:
        """The section's u, v and the axis, as the columns of a rotation to the world.

        Returns
        -------
        (3, 3) float64
            As `section_frame` gives it.
        """
        return section_frame((self.end - self.start) / self.length, self.roll)

    @cached_property
    def nodes(self) -> FloatArray:
        """The axis as a chain of straight pieces, within 0.01 mm of it.

        Returns
        -------
        (N, 3) float64, metres, world frame
            From start to end; two nodes if the member is not bent.

        Notes
        -----
        A chord of the parabola with sagitta `bow`, cut in n, has the sagitta ``bow / n**2``.
        """
        n_pieces = max(1, math.ceil(math.sqrt(abs(self.bow) / _CHORD_ERROR)))
        share = np.linspace(0.0, 1.0, n_pieces + 1)[:, None]
        bowed = 4.0 * self.bow * share * (1.0 - share) * self.rotation[:, 1]
        nodes: FloatArray = self.start + share * (self.end - self.start) + bowed
        return nodes


@dataclass(frozen=True, eq=False)
class Box:
    """A box. `centre` (3,), `size` (3,) metres; `rotation` (3, 3) of its axes to the world."""

    centre: FloatArray
    size: FloatArray
    rotation: FloatArray = field(default_factory=lambda: np.eye(3))


@dataclass(frozen=True, eq=False)
class Sphere:
    """A sphere. `centre` (3,), `radius`, metres."""

    centre: FloatArray
    radius: float


@dataclass(frozen=True, eq=False)
class Rectangle:
    """A flat rectangle, seen from both sides.

    `centre` (3,), `size` (2,) metres; `rotation` (3, 3): its sides along x and y, its
    normal along z, to the world.
    """

    centre: FloatArray
    size: FloatArray
    rotation: FloatArray = field(default_factory=lambda: np.eye(3))


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of a file (STL, OBJ, PLY).

    A vertex ``p`` of the file stands at ``rotation @ (scale * p) + translation``.
    """

    path: Path
    translation: FloatArray
    rotation: FloatArray = field(default_factory=lambda: np.eye(3))
    scale: FloatArray = field(default_factory=lambda: np.ones(3))


@dataclass(frozen=True, eq=False)
class Scene:
    """All that stands in a world.

    Attributes
    ----------
    name : str
    members : tuple of Member
        Those with a known axis: the truth.
    boxes, spheres, rectangles, meshes : tuples
        Clutter, floor and ceiling included.
    notes : tuple of str
        What the file holds that the scene does not, for people.
    """

    name: str
    members: tuple[Member, ...] = ()
    boxes: tuple[Box, ...] = ()
    spheres: tuple[Sphere, ...] = ()
    rectangles: tuple[Rectangle, ...] = ()
    meshes: tuple[Mesh, ...] = ()
    notes: tuple[str, ...] = ()

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """Where the members meet."""
        radii = np.array([member.section.radius for member in self.members], dtype=np.float64)
        return find_joints([member.nodes for member in self.members], radii)
