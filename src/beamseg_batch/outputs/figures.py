"""The figures of the report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import FlightResult, Joint, ScanRecord, Segment, Trajectory
from beamseg_batch.outputs.columns import time_origin_ns
from beamseg_batch.pages.figures import (
    Figure,
    Mesh,
    axes_layout,
    cylinder_mesh,
    mesh_trace,
    octahedron_mesh,
    positions,
    scene_layout,
    thinned,
    typed,
)

__all__ = [
    "MAX_BEAMS",
    "MAX_CLOUD_POINTS",
    "beam_mesh",
    "processing_figure",
    "size_figure",
    "structure_figure",
    "times_by_lines_figure",
]

MAX_BEAMS = 2_000
"""Beams, and as many joints, that are drawn."""
MAX_CLOUD_POINTS = 30_000
"""Points of the cloud that are drawn."""

_MAX_TRAJECTORY_POINTS = 4_000
_MAX_SCANS = 10_000
_JOINT_REACH = 2.8  # in radii of the thickest beam, so 1.8 of them stand out

# The page replaces these names by the colours of its light or dark theme.
_BEAM, _JOINT, _PATH, _CLOUD = "$beam", "$joint", "$path", "$cloud"


def beam_mesh(segments: Sequence[Segment]) -> Mesh:
    """Build closed cylinders of true radius around the axes of beams.

    Parameters
    ----------
    segments : sequence of Segment

    Returns
    -------
    Mesh
    """
    radii = np.array([segment.radius for segment in segments], dtype=np.float64)
    return cylinder_mesh(_ends(segments), radii)


def structure_figure(result: FlightResult) -> Figure:
    """Draw beams, joints, trajectory and a thinned cloud in three dimensions.

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
        _joints_trace(result),
    ]
    shown = np.concatenate(
        [_ends(result.segments).reshape(-1, 3), result.trajectory.positions, result.cloud]
    )
    return {
        "data": [trace for trace in traces if trace is not None],
        "layout": scene_layout(shown),
    }


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
        "x": typed(times_s),
        "y": typed(_processing_ms(scans)),
        "line": {"width": 1, "color": _BEAM},
        "hovertemplate": "%{x:.2f} s: %{y:.2f} ms<extra></extra>",
    }
    layout = axes_layout("flight time [s]", "processing time [ms]")
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
    layout = axes_layout("lines found in the scan", "processing time [ms]")
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
        "x": typed(times_s),
        "y": typed(np.array([scan.n_segments for scan in scans])),
        "line": {"shape": "hv", "width": 2, "color": _PATH},
        "hovertemplate": "%{x:.2f} s: %{y} beams<extra></extra>",
    }
    layout = axes_layout("flight time [s]", "beams in the structure")
    layout["yaxis"]["rangemode"] = "tozero"
    return {"data": [trace], "layout": layout}


def _ends(segments: Sequence[Segment]) -> FloatArray:
    """Ends of beams, (N, 2, 3)."""
    ends = [(segment.end_1, segment.end_2) for segment in segments]
    return np.array(ends, dtype=np.float64).reshape(-1, 2, 3)


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
        **positions(points[thinned(len(points), MAX_CLOUD_POINTS)]),
    }


def _trajectory_trace(trajectory: Trajectory) -> dict[str, Any] | None:
    places = trajectory.positions[thinned(len(trajectory), _MAX_TRAJECTORY_POINTS)]
    if not len(places):
        return None
    return {
        "type": "scatter3d",
        "mode": "lines",
        "name": "trajectory",
        "line": {"width": 3, "color": _PATH},
        "hoverinfo": "skip",
        **positions(places),
    }


def _beams_trace(segments: Sequence[Segment]) -> dict[str, Any] | None:
    if not segments:
        return None
    labels = [_beam_label(number, beam) for number, beam in enumerate(segments)]
    return mesh_trace("beams", _BEAM, beam_mesh(segments), labels)


def _beam_label(number: int, beam: Segment) -> str:
    return (
        f"<b>beam {number}</b><br>{beam.length:.3f} m long, radius {beam.radius * 1e3:.1f} mm"
        f"<br>{beam.n_points} points in {beam.n_scans} scans"
    )


def _joints_trace(result: FlightResult) -> dict[str, Any] | None:
    """Octahedra that stand out of the beams: a marker would be hidden inside of them."""
    joints = result.joints[:MAX_BEAMS]
    if not joints:
        return None
    centres = np.array([joint.position for joint in joints])
    radii = [max(result.segments[k].radius for k in joint.segments) for joint in joints]
    mesh = octahedron_mesh(centres, _JOINT_REACH * np.array(radii))
    labels = [_joint_label(number, joint) for number, joint in enumerate(joints)]
    return mesh_trace("joints", _JOINT, mesh, labels) | {
        "flatshading": True,
        "lighting": {"ambient": 0.75, "diffuse": 0.5},
    }


def _joint_label(number: int, joint: Joint) -> str:
    return (
        f"<b>joint {number}</b><br>beams {', '.join(map(str, joint.segments))}"
        f"<br>axes within {joint.residual * 1e3:.1f} mm"
    )


def _box(name: str, times_ms: FloatArray, colour: str) -> dict[str, Any]:
    return {
        "type": "box",
        "name": name,
        "y": typed(times_ms),
        "boxpoints": "outliers",
        "marker": {"size": 3, "color": colour},
        "line": {"width": 1.5},
        "hoverinfo": "y",
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
