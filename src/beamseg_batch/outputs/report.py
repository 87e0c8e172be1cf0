"""`report.html`: what a run did, for people, in one file that needs no network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import resources
from typing import Any

import numpy as np

from beamseg_batch.config import config_yaml
from beamseg_batch.model import STAGES, FlightResult, Intersection, Joint, Segment
from beamseg_batch.outputs.columns import time_origin_ns
from beamseg_batch.outputs.figures import (
    MAX_BEAMS,
    MAX_CLOUD_POINTS,
    processing_figure,
    size_figure,
    structure_figure,
    times_by_lines_figure,
)
from beamseg_batch.outputs.summary import sensor_text, summarise
from beamseg_batch.pages.figures import Figure
from beamseg_batch.pages.rendering import render_page
from beamseg_batch.reasons import REASONS

__all__ = ["MAX_TABLE_ROWS", "render_report"]

MAX_TABLE_ROWS = 800
"""Rows of a table in the page; the CSV file has them all."""

_KINDS = {"lines": "lines", "leftover_lines": "lines in the rest", "candidates": "candidates"}
_TEMPLATE = "report.html.j2"


def render_report(result: FlightResult, summary: Mapping[str, Any] | None = None) -> str:
    """Render the report of a flight.

    Parameters
    ----------
    result : FlightResult
    summary : mapping, optional
        As `summarise` gives it for this result; made when it is not given.

    Returns
    -------
    str
        HTML with everything in it, plotly.js included. It requests nothing from anywhere,
        and a content security policy in it forbids to.
    """
    if summary is None:
        summary = summarise(result, (), "")
    figures = _figures(result, summary)
    return render_page(
        resources.files(__package__).joinpath("templates", _TEMPLATE).read_text("utf-8"),
        figures,
        filters={"ms": _ms, "megabytes": _megabytes},
        summary=summary,
        sensor_text=sensor_text(result.sensor),
        has_structure="structure" in figures,
        beams=[_beam_row(n, s, result) for n, s in enumerate(result.segments[:MAX_TABLE_ROWS])],
        intersections=[_intersection_row(i) for i in result.intersections[:MAX_TABLE_ROWS]],
        joints=[_joint_row(n, joint) for n, joint in enumerate(result.joints[:MAX_TABLE_ROWS])],
        stages=_stage_rows(summary),
        meanings={
            name: f"{_KINDS[reason.kind]} {reason.meaning}" for name, reason in REASONS.items()
        },
        beams_detail=_beams_detail(result.segments),
        max_beams=MAX_BEAMS,
        config_yaml=config_yaml(result.config),
        cloud_shown=min(len(result.cloud), MAX_CLOUD_POINTS),
        cloud_size=len(result.cloud),
    )


def _figures(result: FlightResult, summary: Mapping[str, Any]) -> dict[str, Figure]:
    figures: dict[str, Figure] = {}
    structure = structure_figure(result)
    if structure["data"]:
        figures["structure"] = structure
    if result.scans:
        interval_ms = summary["real_time"]["cloud_interval_ms"]
        figures["processing"] = processing_figure(result, interval_ms)
        figures["by-lines"] = times_by_lines_figure(result)
        figures["size"] = size_figure(result)
    return figures


def _beam_row(number: int, beam: Segment, result: FlightResult) -> dict[str, Any]:
    first_s = (beam.first_seen_ns - time_origin_ns(result)) / 1e9
    return {
        "number": number,
        "end_1": [_metres(value) for value in beam.end_1],
        "end_2": [_metres(value) for value in beam.end_2],
        "length": _metres(beam.length),
        "radius": f"{beam.radius * 1e3:.1f}",
        "n_points": beam.n_points,
        "n_scans": beam.n_scans,
        "pca_coeff": f"{beam.pca_coeff:.4f}",
        "first_seen": f"{first_s:.2f}",
    }


def _intersection_row(intersection: Intersection) -> dict[str, Any]:
    return {
        "segment_1": intersection.segment_1,
        "segment_2": intersection.segment_2,
        "position": [_metres(value) for value in intersection.position],
        "t_1": _metres(intersection.t_1),
        "t_2": _metres(intersection.t_2),
        "distance": f"{intersection.distance * 1e3:.1f}",
        "angle": f"{intersection.angle_deg:.1f}",
        "joint": "–" if intersection.joint is None else intersection.joint,
    }


def _joint_row(number: int, joint: Joint) -> dict[str, Any]:
    sigma = float(np.sqrt(np.trace(joint.covariance)))
    return {
        "number": number,
        "position": [_metres(value) for value in joint.position],
        "beams": ", ".join(map(str, joint.segments)),
        "residual": f"{joint.residual * 1e3:.1f}",
        "sigma": "–" if np.isnan(sigma) else f"{sigma * 1e3:.1f}",
    }


def _beams_detail(beams: Sequence[Segment]) -> str:
    """Say the radii of the beams in a few words, or their range."""
    if not beams:
        return "none found"
    radii = sorted({f"{beam.radius * 1e3:.0f}" for beam in beams}, key=int)
    shown = ", ".join(radii) if len(radii) <= 3 else f"{radii[0]} to {radii[-1]}"
    return f"radius {shown} mm"


def _stage_rows(summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Mean time of every stage, and its share of the time of a scan."""
    means = {stage: summary["processing"]["stages"][stage]["mean_ms"] or 0.0 for stage in STAGES}
    whole = max(sum(means.values()), 1e-12)
    return [
        {"name": stage, "mean_ms": mean, "share": round(100 * mean / whole, 1)}
        for stage, mean in means.items()
    ]


def _metres(value: float) -> str:
    return f"{value:.3f}" if round(value, 3) else "0.000"


def _ms(value: float | None) -> str:
    """Milliseconds with three significant digits, or a dash."""
    if value is None:
        return "–"
    return f"{value:.{0 if value >= 100 else 1 if value >= 10 else 2}f}"


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.1f} MB" if size >= 100_000 else f"{size / 1e3:.1f} kB"
