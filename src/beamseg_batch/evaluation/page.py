"""An evaluation for people: truth and result in one view, distance against angle."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from importlib import resources
from typing import Any

import numpy as np

from beamseg_batch.evaluation.gates import Check
from beamseg_batch.evaluation.measures import MEASURES, Evaluation, Verdict
from beamseg_batch.evaluation.wording import number, percent, spread_rows
from beamseg_batch.geometry import FloatArray
from beamseg_batch.pages.charts import Chart, Series
from beamseg_batch.pages.drawing import Drawing
from beamseg_batch.pages.rendering import Section, render_page, render_part
from beamseg_batch.pages.scenes import Bars, Marks, Scene
from beamseg_batch.prisms import round_prism

__all__ = ["errors_chart", "evaluation_section", "overlay_scene", "render_evaluation"]

MAX_DRAWN = 2_000
"""Members, and as many segments and joints of each kind, that are drawn."""

_TRUE, _FOUND, _DOUBLE, _WRONG, _ASIDE = "$path", "$beam", "$chosen", "$bad", "$cloud"
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
_TEMPLATE, _PART = "evaluation.html.j2", "evaluation_part.html.j2"


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
    section = evaluation_section(evaluation)
    return render_page(
        _template(_TEMPLATE),
        section.drawings,
        evaluation=evaluation,
        checks=checks,
        section=section,
    )


def evaluation_section(evaluation: Evaluation) -> Section:
    """Render an evaluation as a part of a page, such as the report of its run.

    Parameters
    ----------
    evaluation : Evaluation

    Returns
    -------
    Section
    """
    drawings: dict[str, Drawing] = {}
    if evaluation.truth.names or evaluation.verdicts:
        drawings["overlay"] = overlay_scene(evaluation).drawing
    if evaluation.matches:
        drawings["errors"] = errors_chart(evaluation).drawing
    html = render_part(
        _template(_PART),
        drawings,
        filters={"number": number, "percent": percent},
        evaluation=evaluation,
        metrics=evaluation.metrics,
        spreads=spread_rows(MEASURES, evaluation.metrics),
        members=_member_rows(evaluation),
        others=_other_rows(evaluation),
        max_drawn=MAX_DRAWN,
        all_drawn=max(len(evaluation.truth.names), len(evaluation.verdicts)) <= MAX_DRAWN,
    )
    return Section("truth", "Against the truth", html, drawings)


def overlay_scene(evaluation: Evaluation) -> Scene:
    """Draw truth and result over one another: figure 12 of the report.

    Parameters
    ----------
    evaluation : Evaluation

    Returns
    -------
    Scene
        Members are drawn whole, segments by their verdict.
    """
    truth, result = evaluation.truth, evaluation.result
    true_ends = np.stack([truth.axes.starts, truth.axes.ends], axis=1)
    ends = np.stack([result.axes.starts, result.axes.ends], axis=1)
    parts: list[Bars | Marks] = []
    for name, colour, opacity, rows in _members_by_fate(evaluation):
        labels = [f"<b>member {escape(truth.names[m])}</b><br>{_size(truth, m)}" for m in rows]
        radii = _TRUE_SHARE * truth.radii
        parts.append(_bars(name, colour, true_ends, radii, rows, labels, opacity))
    for verdict, colour in _COLOURS.items():
        rows = [s for s, found in enumerate(evaluation.verdicts) if found == verdict]
        labels = [_segment_label(evaluation, s) for s in rows]
        parts.append(_bars(verdict, colour, ends, result.radii, rows, labels))
    shown = np.concatenate([true_ends.reshape(-1, 3), ends.reshape(-1, 3)])
    return Scene((*parts, *_joints(evaluation)), shown, "truth and result over one another")


def errors_chart(evaluation: Evaluation) -> Chart:
    """Draw the distance of the mid-points against the angle: figure 13 of the report.

    Parameters
    ----------
    evaluation : Evaluation
        With at least one match.

    Returns
    -------
    Chart
        A point per match: metres across, radians up.
    """
    matches = evaluation.matches
    series = Series(
        "points",
        "members",
        _FOUND,
        np.array([match.midpoint_distance for match in matches]),
        np.radians([match.angle_deg for match in matches]),
        tuple(evaluation.truth.names[match.member] for match in matches),
    )
    return Chart(
        "distance of the mid-points [m]",
        "angle [rad]",
        (series,),
        "distance of the mid-points and angle of every match",
    )


def _template(name: str) -> str:
    return resources.files(__package__).joinpath("templates", name).read_text("utf-8")


def _members_by_fate(evaluation: Evaluation) -> list[tuple[str, str, float, list[int]]]:
    """Name, colour, opacity and members of each kind of true member."""
    counts, missed = evaluation.truth.counts, set(evaluation.missed)
    seen = np.flatnonzero(counts).tolist()
    return [
        ("truth", _TRUE, 0.45, [member for member in seen if member not in missed]),
        ("truth, missed", _TRUE, 0.9, sorted(missed)),
        ("truth, not seen", _ASIDE, 0.3, np.flatnonzero(~counts).tolist()),
    ]


def _bars(
    name: str,
    colour: str,
    ends: FloatArray,
    radii: FloatArray,
    rows: list[int],
    labels: list[str],
    opacity: float = 1.0,
) -> Bars:
    prisms = [round_prism(ends[row, 0], ends[row, 1], radii[row]) for row in rows[:MAX_DRAWN]]
    return Bars(name, colour, prisms, labels[:MAX_DRAWN], opacity=opacity)


def _joints(evaluation: Evaluation) -> list[Marks]:
    joints, claimed = evaluation.joints, evaluation.result.joints
    if joints is None or claimed is None:
        return []
    true = np.array([joint.position for joint in evaluation.truth.joints]).reshape(-1, 3)
    kinds = (
        ("joints found", _MET, claimed[joints.pairs[:MAX_DRAWN, 1]]),
        ("joints missed", _TRUE, true[list(joints.missed[:MAX_DRAWN])]),
        ("joints invented", _WRONG, claimed[list(joints.invented[:MAX_DRAWN])]),
    )
    marks = []
    for name, colour, places in kinds:
        labels = [f"{name}: {x:.3f}, {y:.3f}, {z:.3f}" for x, y, z in places]
        marks.append(Marks(name, colour, places, np.full(len(places), _JOINT_REACH_M), labels))
    return marks


def _size(truth: Any, member: int) -> str:
    return f"{truth.axes.lengths[member]:.3f} m long, radius {1e3 * truth.radii[member]:.1f} mm"


def _segment_label(evaluation: Evaluation, segment: int) -> str:
    result, member = evaluation.result, evaluation.nearest[segment]
    about = "" if member is None else f", member {escape(evaluation.truth.names[member])}"
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
