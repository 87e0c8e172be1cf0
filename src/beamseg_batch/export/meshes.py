"""Bars as closed triangle meshes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.export.bars import Bar
from beamseg_batch.geometry import FloatArray
from beamseg_batch.world.scene import Section

__all__ = ["Mesh", "mesh_of", "outline"]

_SIDES = 24
"""Of the prism that stands for a round bar; its edges lie on the cylinder."""

_CONVEX_PIECES = {
    "i": ((0, 1, 2, 3, 10, 11), (3, 4, 9, 10), (6, 7, 8, 9, 4, 5)),
    "l": ((0, 1, 2, 3, 4, 5),),
    "c": ((0, 1, 2, 3), (0, 3, 4, 7), (7, 4, 5, 6)),
}
"""Corners of the outline of a section that is not convex, by pieces to cut into fans."""


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


def outline(section: Section) -> FloatArray:
    """Corners of a cross-section.

    Parameters
    ----------
    section : Section

    Returns
    -------
    (K, 2) float64, metres
        In the section's u and v about its centre of area, anticlockwise.
    """
    if section.shape == "round":
        angles = np.arange(_SIDES) * (2.0 * np.pi / _SIDES)
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


def mesh_of(bar: Bar) -> Mesh:
    """Closed mesh of a bar.

    Parameters
    ----------
    bar : Bar

    Returns
    -------
    Mesh
        Its rings of corners stand across the chord, one at every node of the axis.
    """
    corners = outline(bar.section)
    n, n_rings = len(corners), len(bar.nodes)
    across = corners @ bar.rotation[:, :2].T
    vertices = (bar.nodes[:, None] + across[None]).reshape(-1, 3)
    cap = _cap(bar.section.shape, n)
    one, after = np.arange(n), np.roll(np.arange(n), -1)
    side = np.concatenate(
        [np.column_stack([one, after, after + n]), np.column_stack([one, after + n, one + n])]
    )
    rings = [side + n * ring for ring in range(n_rings - 1)]
    return Mesh(vertices, np.concatenate([cap[:, ::-1], *rings, cap + n * (n_rings - 1)]))


def _cap(shape: str, n_corners: int) -> NDArray[np.int64]:
    """Triangles of an outline, seen from the second end."""
    pieces = _CONVEX_PIECES.get(shape, (tuple(range(n_corners)),))
    return np.array(
        [(p[0], p[k], p[k + 1]) for p in pieces for k in range(1, len(p) - 1)], dtype=np.int64
    )
