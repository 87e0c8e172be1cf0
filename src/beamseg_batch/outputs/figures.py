"""The figures of the report, as plain plotly figures: dicts of traces and layout.

Plain dicts instead of plotly's classes keep plotly out of the import, and let the numbers
travel as base64 of their bytes, which plotly.js reads and which is a third of their text.
"""

from __future__ import annotations

import base64
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import FlightResult, Intersection, ScanRecord, Segment, Trajectory
from beamseg_batch.outputs.columns import time_origin_ns

__all__ = [
    "MAX_BEAMS",
    "MAX_CLOUD_POINTS",
    "BeamMesh",
    "Figure",
    "beam_mesh",
    "processing_figure",
    "size_figure",
    "structure_figure",
    "thinned",
    "times_by_lines_figure",
]

Figure: TypeAlias = dict[str, Any]
"""A plotly figure: `data`, a list of traces, and `layout`."""

MAX_BEAMS = 2_000
"""Beams, and as many intersections, that are drawn."""
MAX_CLOUD_POINTS = 30_000
"""Points of the cloud that are drawn."""

_MAX_TRAJECTORY_POINTS = 4_000
_MAX_SCANS = 10_000
_SIDES, _FEW_SIDES, _MANY_BEAMS = 12, 6, 1_000
_RING_SPACING_M = 0.4
_MAX_RINGS = 8
_MAX_VERTICES = 30_000

_INTERSECTION_REACH = 2.8  # in radii of the thicker beam, so 1.8 of them stand out
_EYE_DIRECTION = np.array([0.66, -0.66, 0.36])
_HALF_VIEW = np.tan(np.pi / 8)  # plotly.js sees 45 degrees
_FILL_ACROSS, _FILL_UP = 0.8, 0.9  # of the view; the names of the axes need the rest
_LABELS_LEFT, _LABELS_BELOW = 0.07, 0.04  # of the view: where axes are named
_OCTAHEDRON = np.array(
    [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
)

# The page replaces these names by the colours of its light or dark theme.
_BEAM, _JOINT, _PATH, _CLOUD = "$beam", "$joint", "$path", "$cloud"


@dataclass(frozen=True, eq=False)
class BeamMesh:
    """Cylinders of many beams in one triangle mesh.

    Attributes
    ----------
    vertices : (V, 3) float32, metres
    triangles : (T, 3) uint32
        Indices into `vertices`.
    counts : (N,) int64
        Vertices of each beam; those of a beam follow one another.
    """

    vertices: NDArray[np.float32]
    triangles: NDArray[np.uint32]
    counts: NDArray[np.int64]


def beam_mesh(segments: Sequence[Segment]) -> BeamMesh:
    """Build closed cylinders of true radius around the axes of beams.

    Parameters
    ----------
    segments : sequence of Segment

    Returns
    -------
    BeamMesh

    Notes
    -----
    A label shows at the vertex that lies nearest to the pointer, so a long beam has rings
    between its ends, as far as the number of vertices allows.
    """
    sides = _SIDES if len(segments) <= _MANY_BEAMS else _FEW_SIDES
    max_rings = _MAX_VERTICES // (sides * max(len(segments), 1))
    max_rings = min(max(max_rings, 2), _MAX_RINGS)
    vertices: list[FloatArray] = [np.empty((0, 3))]
    triangles: list[NDArray[np.int64]] = [np.empty((0, 3), dtype=np.int64)]
    offset = 0
    for segment in segments:
        rings = int(np.clip(np.ceil(segment.length / _RING_SPACING_M) + 1, 2, max_rings))
        vertices.append(_cylinder_vertices(segment, rings, sides))
        triangles.append(_cylinder_triangles(rings, sides) + offset)
        offset += len(vertices[-1])
    return BeamMesh(
        np.concatenate(vertices).astype(np.float32),
        np.concatenate(triangles).astype(np.uint32),
        np.array([len(beam) for beam in vertices[1:]], dtype=np.int64),
    )


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


def structure_figure(result: FlightResult) -> Figure:
    """Draw beams, intersections, trajectory and a thinned cloud in three dimensions.

    Parameters
    ----------
    result : FlightResult

    Returns
    -------
    Figure
        One scene with equal scales, metres, world frame. The `meta` of a mesh holds a label
        per object and its number of vertices; the page makes a label per vertex of them.
    """
    traces = [
        _cloud_trace(result.cloud),
        _trajectory_trace(result.trajectory),
        _beams_trace(result.segments[:MAX_BEAMS]),
        _intersections_trace(result),
    ]
    axes = {f"{axis}axis": {"title": {"text": f"{axis} [m]"}} for axis in "xyz"}
    scene = {
        "aspectmode": "data",
        "dragmode": "turntable",
        "camera": _camera(result),
        **axes,
    }
    legend = {"orientation": "h", "x": 0, "y": 1, "yanchor": "bottom", "itemsizing": "constant"}
    layout = {"scene": scene, "legend": legend, "margin": {"l": 0, "r": 0, "t": 36, "b": 0}}
    return {"data": [trace for trace in traces if trace is not None], "layout": layout}


def processing_figure(result: FlightResult, interval_ms: float | None) -> Figure:
    """Draw the processing time of every scan over the flight.

    Parameters
    ----------
    result : FlightResult
    interval_ms : float or None
        Time between two clouds, drawn as the limit of real time.

    Returns
    -------
    Figure
        Seconds across, milliseconds up.
    """
    times_s, scans = _timeline(result)
    trace = {
        "type": "scatter",
        "mode": "lines" if len(scans) > 1 else "markers",
        "name": "scan",
        "x": _typed(times_s),
        "y": _typed(_processing_ms(scans)),
        "line": {"width": 1, "color": _BEAM},
        "hovertemplate": "%{x:.2f} s: %{y:.2f} ms<extra></extra>",
    }
    layout = _axes("flight time [s]", "processing time [ms]")
    layout["yaxis"]["range"] = [0, _upper_limit(result.scans)]
    if interval_ms is not None and interval_ms <= 3 * _upper_limit(result.scans):
        layout["yaxis"]["range"][1] = max(_upper_limit(result.scans), 1.1 * interval_ms)
        layout["shapes"] = [_limit_line(interval_ms)]
    return {"data": [trace], "layout": layout}


def times_by_lines_figure(result: FlightResult) -> Figure:
    """Draw the distribution of the processing time, for all scans and by number of lines.

    Parameters
    ----------
    result : FlightResult

    Returns
    -------
    Figure
        A box per number of lines, milliseconds up.

    Notes
    -----
    Figures 14a and 14b of the report, which shows a tenth of the true seconds: its plots
    divide microseconds by 10⁷.
    """
    _, scans = _timeline(result)
    times_ms = _processing_ms(scans)
    lines = np.array([scan.n_lines for scan in scans], dtype=np.int64)
    traces = [_box("all", times_ms, _JOINT)]
    traces += [_box(str(n), times_ms[lines == n], _BEAM) for n in np.unique(lines)]
    layout = _axes("lines found in the scan", "processing time [ms]")
    layout["xaxis"]["type"] = "category"
    layout["yaxis"]["range"] = [0, _upper_limit(result.scans)]
    return {"data": traces, "layout": layout}


def size_figure(result: FlightResult) -> Figure:
    """Draw the number of beams in the structure over the flight.

    Parameters
    ----------
    result : FlightResult

    Returns
    -------
    Figure
        Seconds across.
    """
    times_s, scans = _timeline(result)
    trace = {
        "type": "scatter",
        "mode": "lines" if len(scans) > 1 else "markers",
        "name": "beams",
        "x": _typed(times_s),
        "y": _typed(np.array([scan.n_segments for scan in scans])),
        "line": {"shape": "hv", "width": 2, "color": _PATH},
        "hovertemplate": "%{x:.2f} s: %{y} beams<extra></extra>",
    }
    layout = _axes("flight time [s]", "beams in the structure")
    layout["yaxis"]["rangemode"] = "tozero"
    return {"data": [trace], "layout": layout}


def _typed(values: NDArray[Any]) -> dict[str, str]:
    """Numbers as plotly.js reads them fastest: little-endian bytes in base64."""
    kind = {"f": "<f4", "i": "<i4", "u": "<u4"}[values.dtype.kind]
    if kind == "<u4" and values.max(initial=0) < 2**16:
        kind = "<u2"
    data = np.ascontiguousarray(values, dtype=np.dtype(kind)).tobytes()
    return {"dtype": kind[1:], "bdata": base64.b64encode(data).decode("ascii")}


def _positions(points: NDArray[Any]) -> dict[str, dict[str, str]]:
    points = points.astype(np.float32)
    return {axis: _typed(points[:, number]) for number, axis in enumerate("xyz")}


def _cloud_trace(cloud: NDArray[np.float32]) -> dict[str, Any] | None:
    points = cloud[np.isfinite(cloud).all(axis=1)]
    if not len(points):
        return None
    return {
        "type": "scatter3d",
        "mode": "markers",
        "name": "cloud",
        "marker": {"size": 1.5, "color": _CLOUD},
        "hoverinfo": "skip",
        **_positions(points[thinned(len(points), MAX_CLOUD_POINTS)]),
    }


def _trajectory_trace(trajectory: Trajectory) -> dict[str, Any] | None:
    positions = trajectory.positions[thinned(len(trajectory), _MAX_TRAJECTORY_POINTS)]
    if not len(positions):
        return None
    return {
        "type": "scatter3d",
        "mode": "lines",
        "name": "trajectory",
        "line": {"width": 3, "color": _PATH},
        "hoverinfo": "skip",
        **_positions(positions),
    }


def _beams_trace(segments: Sequence[Segment]) -> dict[str, Any] | None:
    if not segments:
        return None
    mesh = beam_mesh(segments)
    return {
        "type": "mesh3d",
        "name": "beams",
        "showlegend": True,
        "color": _BEAM,
        "flatshading": False,
        "lighting": {"ambient": 0.55, "diffuse": 0.8, "specular": 0.2, "roughness": 0.6},
        "hoverinfo": "text",
        "meta": {
            "labels": [_beam_label(number, beam) for number, beam in enumerate(segments)],
            "counts": mesh.counts.tolist(),
        },
        **_positions(mesh.vertices),
        **{name: _typed(mesh.triangles[:, k]) for k, name in enumerate("ijk")},
    }


def _beam_label(number: int, beam: Segment) -> str:
    return (
        f"<b>beam {number}</b><br>{beam.length:.3f} m long, radius {beam.radius * 1e3:.1f} mm"
        f"<br>{beam.n_points} points in {beam.n_scans} scans"
    )


def _intersections_trace(result: FlightResult) -> dict[str, Any] | None:
    """Octahedra that stand out of the beams: a marker would be hidden inside of them."""
    intersections = result.intersections[:MAX_BEAMS]
    if not intersections:
        return None
    centres = np.array([i.position for i in intersections])
    radii = [
        max(result.segments[i.segment_1].radius, result.segments[i.segment_2].radius)
        for i in intersections
    ]
    corners = np.concatenate([np.eye(3), -np.eye(3)])
    reach = _INTERSECTION_REACH * np.array(radii)
    vertices = (centres[:, None, :] + reach[:, None, None] * corners).reshape(-1, 3)
    offsets = np.arange(len(centres))[:, None, None] * len(corners)
    triangles = (_OCTAHEDRON + offsets).reshape(-1, 3).astype(np.uint32)
    return {
        "type": "mesh3d",
        "name": "intersections",
        "showlegend": True,
        "color": _JOINT,
        "flatshading": True,
        "lighting": {"ambient": 0.75, "diffuse": 0.5},
        "hoverinfo": "text",
        "meta": {
            "labels": [_intersection_label(i) for i in intersections],
            "counts": [len(corners)] * len(intersections),
        },
        **_positions(vertices),
        **{name: _typed(triangles[:, k]) for k, name in enumerate("ijk")},
    }


def _intersection_label(intersection: Intersection) -> str:
    return (
        f"<b>beams {intersection.segment_1} and {intersection.segment_2}</b>"
        f"<br>{intersection.angle_deg:.1f}°, axes {intersection.distance * 1e3:.1f} mm apart"
    )


def _camera(result: FlightResult) -> dict[str, dict[str, float]]:
    """Where to look from, and at what, to fill the view, in the scene's own unit.

    With equal scales that unit is the geometric mean of the three extents of what is shown,
    and its origin the middle of it.
    """
    ends = [end for beam in result.segments for end in (beam.end_1, beam.end_2)]
    shown = np.concatenate(
        [np.array(ends).reshape(-1, 3), result.trajectory.positions, result.cloud]
    )
    shown = shown[np.isfinite(shown).all(axis=1)]
    extent = np.maximum(np.ptp(shown, axis=0), 0.1) if len(shown) else np.ones(3)
    aspect = extent / np.cbrt(extent.prod())
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * aspect
    back = _EYE_DIRECTION / np.linalg.norm(_EYE_DIRECTION)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    centre, distance = np.zeros(3), 2.0 * float(np.linalg.norm(aspect))
    for _ in range(30):  # nearer things look larger, so size and middle settle step by step
        seen = corners - centre
        depth = np.maximum(distance - seen @ back, 0.1 * distance) * _HALF_VIEW
        across, upward = seen @ right / depth, seen @ up / depth
        fill = max(np.ptp(across) / 2 / _FILL_ACROSS, np.ptp(upward) / 2 / _FILL_UP)
        aside = (across.max() + across.min()) / 2 - _LABELS_LEFT
        above = (upward.max() + upward.min()) / 2 - _LABELS_BELOW
        centre += right * (aside * distance * _HALF_VIEW)
        centre[2] += above * distance * _HALF_VIEW / up[2]
        distance *= fill
    return {"eye": _named(centre + distance * back), "center": _named(centre)}


def _named(position: FloatArray) -> dict[str, float]:
    return {axis: round(float(value), 3) for axis, value in zip("xyz", position, strict=True)}


def _box(name: str, times_ms: FloatArray, colour: str) -> dict[str, Any]:
    return {
        "type": "box",
        "name": name,
        "y": _typed(times_ms),
        "boxpoints": "outliers",
        "marker": {"size": 3, "color": colour},
        "line": {"width": 1.5},
        "hoverinfo": "y",
    }


def _axes(across: str, up: str) -> dict[str, Any]:
    return {
        "xaxis": {"title": {"text": across}},
        "yaxis": {"title": {"text": up}},
        "margin": {"l": 56, "r": 12, "t": 12, "b": 48},
        "showlegend": False,
    }


def _limit_line(interval_ms: float) -> dict[str, Any]:
    return {
        "type": "line",
        "xref": "paper",
        "x0": 0,
        "x1": 1,
        "y0": interval_ms,
        "y1": interval_ms,
        "line": {"dash": "dash", "width": 1.5, "color": _JOINT},
        "label": {"text": "time between two clouds", "textposition": "start"},
    }


def _timeline(result: FlightResult) -> tuple[FloatArray, list[ScanRecord]]:
    """Seconds of the flight and records of the scans that are drawn."""
    scans = [result.scans[i] for i in thinned(len(result.scans), _MAX_SCANS)]
    origin = time_origin_ns(result)
    return np.array([(scan.stamp_ns - origin) / 1e9 for scan in scans]), scans


def _processing_ms(scans: Sequence[ScanRecord]) -> FloatArray:
    return np.array([scan.processing_us for scan in scans], dtype=np.float64) * 1e-3


def _upper_limit(scans: Sequence[ScanRecord]) -> float:
    """Top of a time axis: a single slow scan, such as the first, must not flatten the rest."""
    times_ms = _processing_ms(scans)
    if not len(times_ms):
        return 1.0
    usual, largest = np.percentile(times_ms, (98, 100))
    return float(1.1 * largest if largest <= 4 * usual else 2 * usual)


def _cylinder_vertices(segment: Segment, rings: int, sides: int) -> FloatArray:
    """Rings from end to end, then the centres of the two caps: (rings * sides + 2, 3)."""
    helper = np.eye(3)[np.argmin(np.abs(segment.direction))]
    across = np.cross(segment.direction, helper)
    across /= np.linalg.norm(across)
    beside = np.cross(segment.direction, across)
    phase = np.arange(sides) * (2 * np.pi / sides)
    ring = segment.radius * (np.outer(np.cos(phase), across) + np.outer(np.sin(phase), beside))
    t = np.linspace(segment.t_min, segment.t_max, rings)
    centres = segment.anchor + np.outer(t, segment.direction)
    wall = (centres[:, None, :] + ring[None, :, :]).reshape(-1, 3)
    return np.concatenate([wall, centres[[0, -1]]])


def _cylinder_triangles(rings: int, sides: int) -> NDArray[np.int64]:
    """Triangles of `_cylinder_vertices`: two per side and step, one per side and cap."""
    here = np.arange(sides)
    following = (here + 1) % sides
    steps = (np.arange(rings - 1) * sides)[:, None]
    lower_1, lower_2 = steps + here, steps + following
    upper_1, upper_2 = lower_1 + sides, lower_2 + sides
    corners = ((lower_1, lower_2, upper_1), (lower_2, upper_2, upper_1))
    wall = [np.stack(triple, axis=-1).reshape(-1, 3) for triple in corners]
    last, centre = (rings - 1) * sides, rings * sides
    caps = [
        np.stack([following, here, np.full(sides, centre)], axis=1),
        np.stack([here + last, following + last, np.full(sides, centre + 1)], axis=1),
    ]
    return np.concatenate([*wall, *caps])
