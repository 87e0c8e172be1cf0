"""An evaluation for people: truth and result in one view, distance against angle."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import resources
from typing import Any

import numpy as np

from beamseg_batch.evaluation.gates import Check
from beamseg_batch.evaluation.measures import MEASURES, Evaluation, Verdict
from beamseg_batch.evaluation.wording import number, percent, spread_rows
from beamseg_batch.geometry import FloatArray
from beamseg_batch.pages.figures import (
    Figure,
    axes_layout,
    cylinder_mesh,
    mesh_trace,
    octahedron_mesh,
    scene_layout,
    typed,
)
from beamseg_batch.pages.rendering import render_page

__all__ = ["errors_figure", "overlay_figure", "render_evaluation"]

MAX_DRAWN = 2_000
"""Members, and as many segments and joints of each kind, that are drawn."""

_TRUE, _FOUND, _DOUBLE, _WRONG, _ASIDE = "$path", "$beam", "$chosen", "$joint", "$cloud"
_MET = "$ink"
_COLOURS: dict[Verdict, str] = {
    "matched": _FOUND,
    "duplicate": _DOUBLE,
    "fragment": _DOUBLE,
    "false": _WRONG,
    "set aside": _ASIDE,
}
_TRUE_SHARE = 0.96  # of its radius: a perfect result hides the truth instead of mingling with it
_JOINT_REACH_M = 0.12
_MAX_NAMED = 30  # points with their name beside them
_TEMPLATE = "evaluation.html.j2"


def render_evaluation(evaluation: Evaluation, checks: Sequence[Check] = ()) -> str:
    """Render the page of an evaluation.

    Parameters
    ----------
    evaluation : Evaluation
    checks : sequence of Check
        Outcomes of its gates.

    Returns
    -------
    str
        HTML with everything in it; it opens offline.
    """
    template = resources.files(__package__).joinpath("templates", _TEMPLATE)
    figures = {"structure": overlay_figure(evaluation)}
    if evaluation.matches:
        figures["errors"] = errors_figure(evaluation)
    return render_page(
        template.read_text("utf-8"),
        figures,
        filters={"number": number, "percent": percent},
        evaluation=evaluation,
        metrics=evaluation.metrics,
        spreads=spread_rows(MEASURES, evaluation.metrics),
        members=_member_rows(evaluation),
        others=_other_rows(evaluation),
        checks=checks,
        max_drawn=MAX_DRAWN,
        all_drawn=max(len(evaluation.truth.names), len(evaluation.verdicts)) <= MAX_DRAWN,
    )


def overlay_figure(evaluation: Evaluation) -> Figure:
    """Draw truth and result over one another: figure 12 of the report.

    Parameters
    ----------
    evaluation : Evaluation

    Returns
    -------
    Figure
        One scene. Members are drawn whole, segments by their verdict.
    """
    truth, result = evaluation.truth, evaluation.result
    true_ends = np.stack([truth.axes.starts, truth.axes.ends], axis=1)
    ends = np.stack([result.axes.starts, result.axes.ends], axis=1)
    traces = []
    for name, colour, opacity, rows in _members_by_fate(evaluation):
        labels = [f"<b>member {truth.names[m]}</b><br>{_size(truth, m)}" for m in rows]
        trace = _cylinders(name, colour, true_ends, _TRUE_SHARE * truth.radii, rows, labels)
        traces += [trace | {"opacity": opacity}] if trace else []
    for verdict, colour in _COLOURS.items():
        rows = [s for s, found in enumerate(evaluation.verdicts) if found == verdict]
        labels = [_segment_label(evaluation, s) for s in rows]
        trace = _cylinders(verdict, colour, ends, result.radii, rows, labels)
        traces += [trace] if trace else []
    traces += _joint_traces(evaluation)
    shown = np.concatenate([true_ends.reshape(-1, 3), ends.reshape(-1, 3)])
    return {"data": traces, "layout": scene_layout(shown)}


def errors_figure(evaluation: Evaluation) -> Figure:
    """Draw the distance of the mid-points against the angle: figure 13 of the report.

    Parameters
    ----------
    evaluation : Evaluation

    Returns
    -------
    Figure
        A point per match: metres across, radians up.
    """
    matches = evaluation.matches
    values = {
        "x": np.array([match.midpoint_distance for match in matches]),
        "y": np.radians([match.angle_deg for match in matches]),
    }
    trace = {
        "type": "scatter",
        "mode": "markers+text" if len(matches) <= _MAX_NAMED else "markers",
        **{axis: typed(numbers) for axis, numbers in values.items()},
        "text": [evaluation.truth.names[match.member] for match in matches],
        "textposition": "top center",
        "marker": {"size": 9, "color": _FOUND},
        "hovertemplate": "member %{text}: %{x:.4f} m, %{y:.5f} rad<extra></extra>",
    }
    layout = axes_layout("distance of the mid-points [m]", "angle [rad]")
    for axis, numbers in values.items():
        layout[f"{axis}axis"]["range"] = [0.0, 1.15 * float(numbers.max(initial=1e-6))]
    return {"data": [trace], "layout": layout}


def _members_by_fate(evaluation: Evaluation) -> list[tuple[str, str, float, list[int]]]:
    """Name, colour, opacity and members of each kind of true member."""
    counts, missed = evaluation.truth.counts, set(evaluation.missed)
    seen = np.flatnonzero(counts).tolist()
    return [
        ("truth", _TRUE, 0.45, [member for member in seen if member not in missed]),
        ("truth, missed", _TRUE, 0.9, sorted(missed)),
        ("truth, not seen", _ASIDE, 0.3, np.flatnonzero(~counts).tolist()),
    ]


def _cylinders(
    name: str,
    colour: str,
    ends: FloatArray,
    radii: FloatArray,
    rows: list[int],
    labels: list[str],
) -> dict[str, Any] | None:
    rows, labels = rows[:MAX_DRAWN], labels[:MAX_DRAWN]
    return (
        mesh_trace(name, colour, cylinder_mesh(ends[rows], radii[rows]), labels) if rows else None
    )


def _joint_traces(evaluation: Evaluation) -> list[dict[str, Any]]:
    joints, claimed = evaluation.joints, evaluation.result.joints
    if joints is None or claimed is None:
        return []
    true = np.array([joint.position for joint in evaluation.truth.joints]).reshape(-1, 3)
    kinds = (
        ("joints found", _MET, claimed[joints.pairs[:MAX_DRAWN, 1]]),
        ("joints missed", _TRUE, true[list(joints.missed[:MAX_DRAWN])]),
        ("joints invented", _WRONG, claimed[list(joints.invented[:MAX_DRAWN])]),
    )
    traces = []
    for name, colour, places in kinds:
        if len(places):
            mesh = octahedron_mesh(places, np.full(len(places), _JOINT_REACH_M))
            labels = [f"{name}: {x:.3f}, {y:.3f}, {z:.3f}" for x, y, z in places]
            traces.append(mesh_trace(name, colour, mesh, labels) | {"flatshading": True})
    return traces


def _size(truth: Any, member: int) -> str:
    return f"{truth.axes.lengths[member]:.3f} m long, radius {1e3 * truth.radii[member]:.1f} mm"


def _segment_label(evaluation: Evaluation, segment: int) -> str:
    result, member = evaluation.result, evaluation.nearest[segment]
    about = "" if member is None else f", member {evaluation.truth.names[member]}"
    return (
        f"<b>segment {result.numbers[segment]}</b>: {evaluation.verdicts[segment]}{about}"
        f"<br>{_size(result, segment)}"
    )


def _member_rows(evaluation: Evaluation) -> list[dict[str, Any]]:
    """One row per member that counts, with its match."""
    truth, match_of = evaluation.truth, {match.member: match for match in evaluation.matches}
    return [
        {
            "name": truth.names[member],
            "seen": float(np.diff(truth.spans[member])[0]),
            "length": float(truth.axes.lengths[member]),
            "match": match_of.get(member),
            "segment": (
                int(evaluation.result.numbers[match_of[member].segment])
                if member in match_of
                else None
            ),
        }
        for member in np.flatnonzero(truth.counts).tolist()
    ]


def _other_rows(evaluation: Evaluation) -> list[dict[str, Any]]:
    """One row per segment that is not a match."""
    truth, result = evaluation.truth, evaluation.result
    return [
        {
            "number": int(result.numbers[segment]),
            "verdict": verdict,
            "length": float(result.axes.lengths[segment]),
            "member": None if (m := evaluation.nearest[segment]) is None else truth.names[m],
        }
        for segment, verdict in enumerate(evaluation.verdicts)
        if verdict != "matched"
    ]
