"""Bars as solids: a cross-section that is carried along an axis, and its triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.geometry import FloatArray, section_frame
from beamseg_batch.section import Section

__all__ = ["Mesh", "Prism", "caps_of", "mesh_of", "outline", "round_prism"]

_SIDES = 24
"""Of the prism that stands for a round bar; its edges lie on the cylinder."""

_CONVEX_PIECES = {
    "i": ((0, 1, 2, 3, 10, 11), (3, 4, 9, 10), (6, 7, 8, 9, 4, 5)),
    "l": ((0, 1, 2, 3, 4, 5),),
    "c": ((0, 1, 2, 3), (0, 3, 4, 7), (7, 4, 5, 6)),
}
"""Corners of the outline of a section that is not convex, by pieces to cut into fans."""


@dataclass(frozen=True, eq=False)
class Prism:
    """A cross-section carried along an axis.

    Attributes
    ----------
    section : Section
    nodes : (N, 3) float64, metres, world frame
        The axis, from end to end: two nodes, more if it is bent.
    rotation : (3, 3) float64
        The section's u, v and the direction of the axis, as columns.
    """

    section: Section
    nodes: FloatArray
    rotation: FloatArray

    @property
    def start(self) -> FloatArray:
        """(3,) float64, metres: the first end of the axis."""
        first: FloatArray = self.nodes[0]
        return first

    @property
    def end(self) -> FloatArray:
        """(3,) float64, metres: the second end of the axis."""
        last: FloatArray = self.nodes[-1]
        return last

    @property
    def length(self) -> float:
        """Distance between the ends, metres."""
        return float(np.linalg.norm(self.end - self.start))


@dataclass(frozen=True, eq=False)
class Mesh:
    """A closed surface.

    Attributes
    ----------
    vertices : (V, 3) float64, metres, world frame
    triangles : (F, 3) int64
        Corners of each, anticlockwise seen from outside.
    """

    vertices: FloatArray
    triangles: NDArray[np.int64]


def round_prism(start: FloatArray, end: FloatArray, radius: float) -> Prism:
    """Prism of a straight round bar; a disc if its ends are one.

    Parameters
    ----------
    start, end : (3,) float64, metres
    radius : float, metres

    Returns
    -------
    Prism
    """
    length = float(np.linalg.norm(end - start))
    rotation = section_frame((end - start) / length) if length > 0.0 else np.eye(3)
    section = Section("round", 2.0 * radius, 2.0 * radius)
    return Prism(section, np.array([start, end]), rotation)


def outline(section: Section, sides: int = _SIDES) -> FloatArray:
    """Corners of a cross-section.

    Parameters
    ----------
    section : Section
    sides : int
        How many a round one gets.

    Returns
    -------
    (K, 2) float64, metres
        In the section's u and v about its centre of area, anticlockwise.
    """
    if section.shape == "round":
        angles = np.arange(sides) * (2.0 * np.pi / sides)
        ring: FloatArray = section.radius * np.column_stack([np.cos(angles), np.sin(angles)])
        return ring
    plates = np.array(section.plates())
    low = (plates[:, :2] - plates[:, 2:] / 2.0).min(axis=0)
    w, h, web, flange = section.width, section.height, section.web, section.flange
    left, right = (w - web) / 2.0, (w + web) / 2.0
    corners = {
        "square": [(0, 0), (w, 0), (w, h), (0, h)],
        "l": [(0, 0), (w, 0), (w, flange), (web, flange), (web, h), (0, h)],
        "c": [
            (0, 0), (w, 0), (w, flange), (web, flange),
            (web, h - flange), (w, h - flange), (w, h), (0, h),
        ],
        "i": [
            (0, 0), (w, 0), (w, flange), (right, flange), (right, h - flange), (w, h - flange),
            (w, h), (0, h), (0, h - flange), (left, h - flange), (left, flange), (0, flange),
        ],
    }[section.shape]  # fmt: skip
    placed: FloatArray = low + np.array(corners, dtype=np.float64)
    return placed


def mesh_of(prism: Prism) -> Mesh:
    """Closed mesh of a prism.

    Parameters
    ----------
    prism : Prism

    Returns
    -------
    Mesh
        Its rings of corners stand across the chord, one at every node of the axis.
    """
    corners = outline(prism.section)
    n, n_rings = len(corners), len(prism.nodes)
    across = corners @ prism.rotation[:, :2].T
    vertices = (prism.nodes[:, None] + across[None]).reshape(-1, 3)
    first, last = caps_of(prism.section, n)
    one, after = np.arange(n), np.roll(np.arange(n), -1)
    side = np.concatenate(
        [np.column_stack([one, after, after + n]), np.column_stack([one, after + n, one + n])]
    )
    rings = [side + n * ring for ring in range(n_rings - 1)]
    return Mesh(vertices, np.concatenate([first, *rings, last + n * (n_rings - 1)]))


def caps_of(section: Section, n_corners: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Triangles of both ends of a prism, as rows of its outline.

    Parameters
    ----------
    section : Section
    n_corners : int
        Of its outline.

    Returns
    -------
    first, last : (F, 3) int64
        Anticlockwise seen from outside.
    """
    pieces = _CONVEX_PIECES.get(section.shape, (tuple(range(n_corners)),))
    last = np.array(
        [(p[0], p[k], p[k + 1]) for p in pieces for k in range(1, len(p) - 1)], dtype=np.int64
    )
    return last[:, ::-1], last
