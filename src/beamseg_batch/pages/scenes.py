"""Scenes in three dimensions, described once and drawn twice: live and as still pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.geometry import FloatArray
from beamseg_batch.pages.drawing import Drawing, Figure, element, svg
from beamseg_batch.pages.figures import (
    VIEWS,
    View,
    bar_mesh,
    mesh_trace,
    octahedron_mesh,
    positions,
    scene_layout,
    thinned,
)
from beamseg_batch.prisms import Prism, outline

__all__ = ["Bars", "Marks", "Path", "Points", "Scene", "Shade"]

_WIDTH, _MAX_HEIGHT, _MARGIN = 600.0, 420.0, 24.0
_MAX_NAMED = 60  # bars with their number beside them in a picture
_MAX_OUTLINED = 300
_MAX_IN_ALL_VIEWS = 3_000
_MAX_PATH_POINTS = 400
_THINNEST, _OUTLINE = 1.4, 1.6
_MAX_BENDS, _SIDES = 16, 48  # of a bent bar in a picture, and of a round one


@dataclass(frozen=True)
class Shade:
    """A way to colour bodies: by the class that each is of.

    Attributes
    ----------
    names, colours : tuple of str
        Of the classes.
    of : tuple of int
        Class of every body.
    """

    names: tuple[str, ...]
    colours: tuple[str, ...]
    of: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Bars:
    """Bars of true cross-section.

    Attributes
    ----------
    name : str
    colour : str
    prisms : sequence of Prism
    labels : sequence of str
        One each, HTML.
    shades : mapping of str to Shade, optional
        Ways to colour them, by name; the first is that of the still pictures.
    opacity : float, optional
    hidden : bool, optional
        Whether it is drawn only when it is asked for.
    named : sequence of str, optional
        Short names in the still pictures.
    """

    name: str
    colour: str
    prisms: Sequence[Prism]
    labels: Sequence[str]
    shades: Mapping[str, Shade] = field(default_factory=dict)
    opacity: float = 1.0
    hidden: bool = False
    named: Sequence[str] = ()


@dataclass(frozen=True, eq=False)
class Marks:
    """Octahedra: a marker would be hidden inside of what it marks.

    Attributes
    ----------
    name, colour : str
    centres : (N, 3) float64, metres
    reach : (N,) float64, metres
    labels : sequence of str
        One each, HTML.
    """

    name: str
    colour: str
    centres: FloatArray
    reach: FloatArray
    labels: Sequence[str]


@dataclass(frozen=True, eq=False)
class Path:
    """A line through points, (N, 3) metres."""

    name: str
    colour: str
    points: FloatArray
    width: float = 3.0


@dataclass(frozen=True, eq=False)
class Points:
    """Small points, (N, 3) metres; not in the still pictures."""

    name: str
    colour: str
    points: NDArray[Any]


Part: TypeAlias = Bars | Marks | Path | Points


@dataclass(frozen=True, eq=False)
class Scene:
    """Things in space, with equal scales.

    Attributes
    ----------
    parts : tuple of Bars, Marks, Path or Points
        Those with nothing in them are left out.
    shown : (N, 3), metres
        Points that must be in view.
    description : str
        What it shows, for those who cannot see it.
    """

    parts: tuple[Part, ...]
    shown: NDArray[Any]
    description: str

    @property
    def drawing(self) -> Drawing:
        """The live figure, and a picture of every view; of the first alone if it holds much."""
        bodies = sum(_size(part) for part in self._solid if not isinstance(part, Path))
        views = VIEWS if bodies <= _MAX_IN_ALL_VIEWS else VIEWS[:1]
        return Drawing(self.figure(), tuple(self.picture(view) for view in views), self.description)

    def figure(self) -> Figure:
        """Draw it for plotly.

        Returns
        -------
        Figure
            The `meta` of a mesh holds a label per object, its number of vertices and the ways
            to colour it; the page makes a label and a colour per vertex of them.
        """
        traces = [_trace(part) for part in self.parts if _size(part)]
        return {"data": traces, "layout": scene_layout(self.shown)}

    def picture(self, view: View) -> str:
        """Draw it as SVG, seen from far away.

        Parameters
        ----------
        view : View

        Returns
        -------
        str
        """
        solid = self._solid
        plane = _Plane.around(_outline(solid), view)
        pieces: list[tuple[float, str]] = []
        for part in solid:
            if isinstance(part, Bars):
                pieces += [] if part.hidden else _paint_bars(part, plane)
            elif isinstance(part, Marks):
                pieces += _paint_marks(part, plane)
            else:
                pieces.append((-np.inf, _paint_path(part, plane)))
        elements = [text for _, text in sorted(pieces, key=lambda piece: piece[0])]
        elements += _names(solid, plane)
        name = f"{view.name} view: {self.description}"
        return svg(_WIDTH, plane.height, [*elements, *_ruler(plane, view)], name)

    @property
    def _solid(self) -> list[Bars | Marks | Path]:
        """Parts that the still pictures show."""
        return [part for part in self.parts if not isinstance(part, Points) and _size(part)]


@dataclass(frozen=True, eq=False)
class _Plane:
    """Where places lie in a picture."""

    axes: FloatArray
    left: float
    upper: float
    scale: float
    height: float

    @classmethod
    def around(cls, points: FloatArray, view: View) -> _Plane:
        """Fit a picture around points."""
        axes = view.axes
        seen = points @ axes[:2].T
        low, high = seen.min(axis=0) - 0.1, seen.max(axis=0) + 0.1
        room = np.array([_WIDTH, _MAX_HEIGHT]) - 2 * _MARGIN
        scale = float((room / (high - low)).min())
        height = float((high - low)[1] * scale + 2 * _MARGIN)
        left = float(low[0] - (_WIDTH / scale - (high - low)[0]) / 2)
        return cls(axes, left, float(high[1] + _MARGIN / scale), scale, height)

    def __call__(self, points: FloatArray) -> FloatArray:
        """Place in the picture, and nearness to the eye: (N, 3)."""
        right, up, near = self.axes @ points.reshape(-1, 3).T
        across, down = (right - self.left) * self.scale, (self.upper - up) * self.scale
        return np.stack([across, down, near], axis=1)


def _outline(solid: Sequence[Part]) -> FloatArray:
    """Points between which a picture lies."""
    bars = [part for part in solid if isinstance(part, Bars)]
    corners = [prism.nodes for part in bars for prism in part.prisms]
    corners += [part.points for part in solid if isinstance(part, Path)]
    corners += [part.centres for part in solid if isinstance(part, Marks)]
    points = np.concatenate([np.empty((0, 3)), *corners])
    points = points[np.isfinite(points).all(axis=1)]
    return points if len(points) else np.zeros((1, 3))


def _size(part: Part) -> int:
    if isinstance(part, Bars):
        return len(part.prisms)
    return len(part.centres) if isinstance(part, Marks) else len(part.points)


def _trace(part: Part) -> dict[str, Any]:
    if isinstance(part, Bars):
        mesh = bar_mesh(part.prisms)
        trace = mesh_trace(part.name, part.colour, mesh, part.labels)
        trace["opacity"] = part.opacity
        if part.shades:
            trace["meta"]["shades"] = {name: asdict(s) for name, s in part.shades.items()}
        return trace | ({"visible": "legendonly"} if part.hidden else {})
    if isinstance(part, Marks):
        mesh = octahedron_mesh(part.centres, part.reach)
        return mesh_trace(part.name, part.colour, mesh, part.labels) | {
            "flatshading": True,
            "lighting": {"ambient": 0.75, "diffuse": 0.5},
        }
    style: dict[str, Any]
    if isinstance(part, Path):
        style = {"mode": "lines", "line": {"width": part.width, "color": part.colour}}
    else:
        style = {"mode": "markers", "marker": {"size": 1.2, "color": part.colour}, "opacity": 0.5}
    common = {"type": "scatter3d", "name": part.name, "hoverinfo": "skip"}
    return common | style | positions(part.points)


def _paint_bars(part: Bars, plane: _Plane) -> list[tuple[float, str]]:
    """Thick lines, each with an edge of the page's colour that sets it off from what is behind."""
    shade = next(iter(part.shades.values()), Shade((), (part.colour,), (0,) * len(part.prisms)))
    pieces, few = [], len(part.prisms) <= _MAX_OUTLINED
    for prism, k in zip(part.prisms, shade.of, strict=True):
        places, width = _stroke(prism, plane)
        edge = _line(places, "$card", width + _OUTLINE)
        faint = {} if part.opacity == 1.0 else {"opacity": f"{part.opacity:g}"}
        body = _line(places, shade.colours[k], width, **faint)
        # What lets through shows what else is in its place, so it lies behind.
        depth = -np.inf if faint else float(places[:, 2].mean())
        pieces.append((depth, (edge if few else "") + body))
    return pieces


def _stroke(prism: Prism, plane: _Plane) -> tuple[FloatArray, float]:
    """Line, (N, 3), and width that cover a bar in a picture."""
    start, end = plane(prism.nodes[[0, -1]])[:, :2]
    along = end - start
    length = float(np.linalg.norm(along))
    normal = np.array([-along[1], along[0]]) / length if length else np.array([1.0, 0.0])
    corners = outline(prism.section, _SIDES) @ prism.rotation[:, :2].T
    reach = (plane(corners) - plane(np.zeros(3)))[:, :2] @ normal
    middle = 0.5 * (reach.min() + reach.max())
    nodes = prism.nodes[thinned(len(prism.nodes) - 1, _MAX_BENDS)]
    places = plane(np.concatenate([nodes, prism.nodes[-1:]]))
    places[:, :2] += middle * normal
    return places, max(float(np.ptp(reach)), _THINNEST)


def _line(places: FloatArray, colour: str, width: float, **more: Any) -> str:
    """Line from place to place."""
    style: dict[str, Any] = {"stroke": colour, "stroke_width": width, **more}
    if len(places) == 2:
        (x1, y1, _), (x2, y2, _) = places
        return element("line", x1=x1, y1=y1, x2=x2, y2=y2, **style)
    return element("path", d=_route(places), fill="none", **style)


def _route(places: FloatArray) -> str:
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y, _ in places)


def _paint_marks(part: Marks, plane: _Plane) -> list[tuple[float, str]]:
    reach = np.maximum(part.reach * plane.scale * 0.7, 2.5)
    return [
        (float(near) + 0.1, element("circle", cx=x, cy=y, r=float(r), fill=part.colour))
        for (x, y, near), r in zip(plane(part.centres), reach, strict=True)
    ]


def _paint_path(part: Path, plane: _Plane) -> str:
    places = plane(part.points[thinned(len(part.points), _MAX_PATH_POINTS)])
    return element("path", d=_route(places), fill="none", stroke=part.colour, stroke_width="1")


def _names(parts: Sequence[Part], plane: _Plane) -> list[str]:
    """Short names of bars, in their middle."""
    elements = []
    for part in parts:
        if isinstance(part, Bars) and 0 < len(part.named) <= _MAX_NAMED:
            middles = plane(np.array([prism.nodes.mean(axis=0) for prism in part.prisms]))
            elements += [
                element("text", name, x=x + 5, y=y - 5, class_="name")
                for name, (x, y, _) in zip(part.named, middles, strict=True)
            ]
    return elements


def _ruler(plane: _Plane, view: View) -> list[str]:
    """Scale of a picture, in the corner below left."""
    length = next((n for n in (50.0, 20.0, 10.0, 5.0, 2.0) if n * plane.scale <= 180), 1.0)
    y, x = plane.height - 10, 10.0
    line = element("path", d=f"M{x:g} {y - 4:g}v4h{length * plane.scale:.1f}v-4", fill="none",
                   stroke="$muted", stroke_width="1.2")  # fmt: skip
    return [line, element("text", f"{length:g} m · {view.name}", x=x + 4, y=y - 6)]
