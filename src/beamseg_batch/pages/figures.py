"""Parts of plotly figures: dicts of traces and layout.

Plain dicts instead of plotly's classes keep plotly out of the import, and let the numbers
travel as base64 of their bytes, which plotly.js reads and which is a third of their text.
A colour such as ``$beam`` is replaced by the page with that of its light or dark theme.
"""

from __future__ import annotations

import base64
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.geometry import FloatArray
from beamseg_batch.prisms import Prism, caps_of, outline
from beamseg_batch.section import Section

__all__ = [
    "ROUND_LIGHTING",
    "VIEWS",
    "Mesh",
    "View",
    "axes_layout",
    "bar_mesh",
    "mesh_trace",
    "octahedron_mesh",
    "positions",
    "scene_layout",
    "thinned",
    "typed",
]

ROUND_LIGHTING = {"ambient": 0.55, "diffuse": 0.8, "specular": 0.2, "roughness": 0.6}
"""Light that makes a cylinder look round."""
_LIGHT = {"x": 30_000, "y": -90_000, "z": 60_000}
"""From where it comes: beside the eye of the first view, so that no two faces look alike."""

_SIDES, _FEW_SIDES, _MANY_BARS = 12, 6, 1_000
_RING_SPACING_M = 0.4
_MAX_RINGS = 8
_MAX_VERTICES = 30_000

_HALF_VIEW = np.tan(np.pi / 8)  # plotly.js sees 45 degrees
_FILL_ACROSS, _FILL_UP = 0.8, 0.9  # of the view; the names of the axes need the rest
_LABELS_LEFT, _LABELS_BELOW = 0.07, 0.04  # of the view: where axes are named
_OCTAHEDRON = np.array(
    [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
)


@dataclass(frozen=True)
class View:
    """From where a scene is seen.

    Attributes
    ----------
    name : str
    towards : (float, float, float)
        From the middle of the scene towards the eye.
    up : (float, float, float)
        What is up in the picture.
    """

    name: str
    towards: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)

    @property
    def axes(self) -> FloatArray:
        """(3, 3) float64, unit rows: right and up in the picture, and towards the eye."""
        back = np.array(self.towards) / np.linalg.norm(self.towards)
        right = np.cross(self.up, back)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(back, right), back])


VIEWS = (
    View("iso", (0.66, -0.66, 0.36)),
    # Not quite from above: a turntable does not know which way to turn there.
    View("top", (0.0, -0.001, 1.0), (0.0, 1.0, 0.0)),
    View("front", (0.0, -1.0, 0.0)),
    View("side", (1.0, 0.0, 0.0)),
)
"""The first is the one that a scene begins with."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Many bodies in one triangle mesh.

    Attributes
    ----------
    vertices : (V, 3) float32, metres
    triangles : (T, 3) uint32
        Indices into `vertices`.
    counts : (N,) int64
        Vertices of each body; those of a body follow one another.
    """

    vertices: NDArray[np.float32]
    triangles: NDArray[np.uint32]
    counts: NDArray[np.int64]


def bar_mesh(prisms: Sequence[Prism]) -> Mesh:
    """Build closed bars of true cross-section, bent where they are.

    Parameters
    ----------
    prisms : sequence of Prism

    Returns
    -------
    Mesh
        Edges are sharp: faces that meet in one do not share its vertices.

    Notes
    -----
    A label shows at the vertex that lies nearest to the pointer, so a long bar has rings
    between its ends, as far as the number of vertices allows.
    """
    sides = _SIDES if len(prisms) <= _MANY_BARS else _FEW_SIDES
    walls = [_wall(prism.section, sides) for prism in prisms]
    max_rings = _MAX_VERTICES // max(sum(len(corners) for corners, _ in walls), 1)
    max_rings = min(max(max_rings, 2), _MAX_RINGS)
    vertices: list[FloatArray] = [np.empty((0, 3))]
    triangles: list[NDArray[np.int64]] = [np.empty((0, 3), dtype=np.int64)]
    offset = 0
    for prism, wall in zip(prisms, walls, strict=True):
        rings = int(np.clip(np.ceil(prism.length / _RING_SPACING_M) + 1, 2, max_rings))
        axis = _resampled(prism.nodes, max_rings if len(prism.nodes) > 2 else rings)
        body, faces = _closed(prism, axis, wall, sides)
        vertices.append(body)
        triangles.append(faces + offset)
        offset += len(body)
    return Mesh(
        np.concatenate(vertices).astype(np.float32),
        np.concatenate(triangles).astype(np.uint32),
        np.array([len(body) for body in vertices[1:]], dtype=np.int64),
    )


def octahedron_mesh(centres: FloatArray, reach: FloatArray) -> Mesh:
    """Build octahedra: marks with a size in metres.

    Parameters
    ----------
    centres : (N, 3) float64, metres
    reach : (N,) float64, metres
        From the centre to a corner.

    Returns
    -------
    Mesh
    """
    corners = np.concatenate([np.eye(3), -np.eye(3)])
    vertices = (centres[:, None, :] + reach[:, None, None] * corners).reshape(-1, 3)
    offsets = np.arange(len(centres))[:, None, None] * len(corners)
    return Mesh(
        vertices.astype(np.float32),
        (_OCTAHEDRON + offsets).reshape(-1, 3).astype(np.uint32),
        np.full(len(centres), len(corners), dtype=np.int64),
    )


def mesh_trace(name: str, colour: str, mesh: Mesh, labels: Sequence[str]) -> dict[str, Any]:
    """Make the trace of a mesh.

    Parameters
    ----------
    name, colour : str
    mesh : Mesh
    labels : sequence of str
        One per body, HTML. The page makes one per vertex of them, by the counts in `meta`.

    Returns
    -------
    dict
        Lit as round bodies; set `flatshading` and `lighting` for others.
    """
    return {
        "type": "mesh3d",
        "name": name,
        "showlegend": True,
        "color": colour,
        "flatshading": False,
        "lighting": ROUND_LIGHTING,
        "lightposition": _LIGHT,
        "hoverinfo": "text",
        "meta": {"labels": list(labels), "counts": mesh.counts.tolist()},
        **positions(mesh.vertices),
        **{name: typed(mesh.triangles[:, k]) for k, name in enumerate("ijk")},
    }


def scene_layout(shown: FloatArray) -> dict[str, Any]:
    """Lay out a scene with equal scales, metres, seen so that it fills the view.

    Parameters
    ----------
    shown : (N, 3), metres
        Points that must be in view; those that are not finite do not count.

    Returns
    -------
    dict
        Of every view of `VIEWS` the camera too, in `meta`.
    """
    cameras = {view.name: _camera(shown, view) for view in VIEWS}
    axes = {f"{axis}axis": {"title": {"text": f"{axis} [m]"}} for axis in "xyz"}
    camera = cameras[VIEWS[0].name]
    scene = {"aspectmode": "data", "dragmode": "turntable", "camera": camera, **axes}
    legend = {"orientation": "h", "x": 0, "y": 1, "yanchor": "bottom", "itemsizing": "constant"}
    margin = {"l": 0, "r": 0, "t": 36, "b": 0}
    return {"scene": scene, "legend": legend, "margin": margin, "meta": {"cameras": cameras}}


def axes_layout(across: str, up: str) -> dict[str, Any]:
    """Lay out a figure with two named axes."""
    return {
        "xaxis": {"title": {"text": across}},
        "yaxis": {"title": {"text": up, "standoff": 10}, "automargin": True},
        "margin": {"l": 56, "r": 12, "t": 12, "b": 48},
        "showlegend": False,
    }


def positions(points: NDArray[Any]) -> dict[str, dict[str, str]]:
    """Give points, (N, 3), as the `x`, `y` and `z` of a trace."""
    points = points.astype(np.float32)
    return {axis: typed(points[:, number]) for number, axis in enumerate("xyz")}


def typed(values: NDArray[Any]) -> dict[str, str]:
    """Give numbers as plotly.js reads them fastest: little-endian bytes in base64."""
    kind = {"f": "<f4", "i": "<i4", "u": "<u4"}[values.dtype.kind]
    if kind == "<u4" and values.max(initial=0) < 2**16:
        kind = "<u2"
    data = np.ascontiguousarray(values, dtype=np.dtype(kind)).tobytes()
    return {"dtype": kind[1:], "bdata": base64.b64encode(data).decode("ascii")}


def thinned(size: int, limit: int) -> NDArray[np.int64]:
    """Choose indices that leave at most `limit` of `size` rows, evenly spread.

    Parameters
    ----------
    size, limit : int

    Returns
    -------
    (min(size, limit),) int64
        Ascending, the same for the same arguments.
    """
    if size <= limit:
        return np.arange(size, dtype=np.int64)
    return np.arange(limit, dtype=np.int64) * size // max(limit, 1)


def _camera(shown: FloatArray, view: View) -> dict[str, dict[str, float]]:
    """Where to look from, and at what, to fill the view, in the scene's own unit.

    With equal scales that unit is the geometric mean of the three extents of what is shown,
    and its origin the middle of it.
    """
    shown = shown[np.isfinite(shown).all(axis=1)]
    extent = np.maximum(np.ptp(shown, axis=0), 0.1) if len(shown) else np.ones(3)
    aspect = extent / np.cbrt(extent.prod())
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * aspect
    right, up, back = view.axes
    centre, distance = np.zeros(3), 2.0 * float(np.linalg.norm(aspect))
    for _ in range(30):  # nearer things look larger, so size and middle settle step by step
        seen = corners - centre
        depth = np.maximum(distance - seen @ back, 0.1 * distance) * _HALF_VIEW
        across, upward = seen @ right / depth, seen @ up / depth
        fill = max(np.ptp(across) / 2 / _FILL_ACROSS, np.ptp(upward) / 2 / _FILL_UP)
        aside = (across.max() + across.min()) / 2 - _LABELS_LEFT
        above = (upward.max() + upward.min()) / 2 - _LABELS_BELOW
        centre += (aside * right + above * up) * (distance * _HALF_VIEW)
        distance *= fill
    return {
        "eye": _named(centre + distance * back),
        "center": _named(centre),
        "up": _named(np.array(view.up)),
    }


def _named(position: FloatArray) -> dict[str, float]:
    return {axis: round(float(value), 3) for axis, value in zip("xyz", position, strict=True)}


def _wall(section: Section, sides: int) -> tuple[FloatArray, NDArray[np.int64]]:
    """Corners of a ring of a bar, (K, 2), and pairs of them between which its faces stand."""
    corners = outline(section, sides)
    if section.shape == "round":
        one = np.arange(len(corners))
        return corners, np.column_stack([one, np.roll(one, -1)])
    twice = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1).reshape(-1, 2)
    return twice, np.arange(len(twice)).reshape(-1, 2)


def _resampled(nodes: FloatArray, count: int) -> FloatArray:
    """As many points, evenly along a chain of even pieces: (count, 3)."""
    places = np.linspace(0.0, len(nodes) - 1.0, count)
    before = np.minimum(places.astype(np.int64), len(nodes) - 2)
    share = (places - before)[:, None]
    points: FloatArray = (1.0 - share) * nodes[before] + share * nodes[before + 1]
    return points


def _closed(
    prism: Prism, axis: FloatArray, wall: tuple[FloatArray, NDArray[np.int64]], sides: int
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Vertices and triangles of a bar: rings along its axis, then its two caps."""
    ring, faces = wall
    across, corners = prism.rotation[:, :2].T, outline(prism.section, sides)
    rings = (axis[:, None] + ring @ across).reshape(-1, 3)
    caps = (axis[[0, -1], None] + corners @ across).reshape(-1, 3)
    size, n_corners, n_wall = len(ring), len(corners), len(rings)
    one, other = faces.T
    step = np.concatenate(
        [
            np.column_stack([one, other, other + size]),
            np.column_stack([one, other + size, one + size]),
        ]
    )
    first, last = caps_of(prism.section, n_corners)
    triangles = [step + size * k for k in range(len(axis) - 1)]
    triangles += [first + n_wall, last + n_wall + n_corners]
    return np.concatenate([rings, caps]), np.concatenate(triangles)
