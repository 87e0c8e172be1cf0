"""`report.html`: what a run did, for people, in one file that needs no network."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from html import escape
from importlib import resources
from typing import Any

import numpy as np

from beamseg_batch.config import config_yaml
from beamseg_batch.model import STAGES, FlightResult, Segment
from beamseg_batch.outputs.columns import (
    intersection_columns,
    joint_columns,
    member_columns,
    segment_columns,
    time_origin_ns,
)
from beamseg_batch.outputs.figures import MAX_BEAMS, MAX_CLOUD_POINTS, charts, structure_scene
from beamseg_batch.outputs.fly_again import FlightPlan, plan_flight
from beamseg_batch.outputs.listing import Heading, Listing, Row, listing
from beamseg_batch.outputs.quality import GRADES, Doubt, Grade, bent, doubts_of, grade
from beamseg_batch.outputs.summary import sensor_text, summarise
from beamseg_batch.pages.drawing import Drawing
from beamseg_batch.pages.rendering import Html, Section, chip, render_page
from beamseg_batch.pages.scenes import Shade
from beamseg_batch.reasons import REASONS
from beamseg_batch.tables import (
    FLY_AGAIN,
    INTERSECTIONS,
    JOINTS,
    MEMBERS,
    SEGMENTS,
    ColumnArrays,
    Table,
)

__all__ = ["MAX_TABLE_ROWS", "render_report"]

MAX_TABLE_ROWS = 800
"""Rows of a table in the page; the CSV file has them all."""

_KINDS = {"lines": "lines", "leftover_lines": "lines in the rest", "candidates": "candidates"}
_TEMPLATE = "report.html.j2"
_SIGMAS = ("sigma_offset", "sigma_angle_deg", "sigma_end_1", "sigma_end_2")
_SHOWN: Mapping[str, str] = {
    SEGMENTS.name: "segment length radius shape section section_confidence bow n_scans "
    "first_seen_s",
    JOINTS.name: "joint x y z segments residual sigma_x sigma_y sigma_z",
    MEMBERS.name: "member segment length joint_1 joint_2 radius",
    INTERSECTIONS.name: "seg1 seg2 x y z distance angle_deg joint",
}
_GRADE_COLOURS: Mapping[Grade, str] = {
    "good": "$good",
    "fair": "$fair",
    "poor": "$bad",
    "not judged": "$beam",
}
_SHAPE_COLOURS = ("$shade-1", "$shade-2", "$shade-3", "$shade-4", "$shade-5", "$shade-6")
_TIME_COLOURS = ("$time-1", "$time-2", "$time-3", "$time-4", "$time-5", "$time-6")
_BENT = "bent"


def render_report(
    result: FlightResult,
    summary: Mapping[str, Any] | None = None,
    plan: FlightPlan | None = None,
    sections: Sequence[Section] = (),
) -> str:
    """Render the report of a flight.

    Parameters
    ----------
    result : FlightResult
    summary : mapping, optional
        As `summarise` gives it for this result; made when it is not given.
    plan : FlightPlan, optional
        As `plan_flight` gives it for this result; made when it is not given.
    sections : sequence of Section
        More to be told of the run, such as how it compares with the truth.

    Returns
    -------
    str
        HTML with everything in it, plotly.js included. It requests nothing from anywhere,
        and a content security policy in it forbids to.
    """
    summary = summarise(result, (), "") if summary is None else summary
    plan = plan_flight(result) if plan is None else plan
    beams = _Beams(result)
    drawings, titles = _drawings(result, summary, plan, beams)
    return render_page(
        resources.files(__package__).joinpath("templates", _TEMPLATE).read_text("utf-8"),
        drawings | {name: d for section in sections for name, d in section.drawings.items()},
        filters={"ms": _ms, "megabytes": _megabytes},
        summary=summary,
        sensor_text=sensor_text(result.sensor),
        meanings={
            name: f"{_KINDS[reason.kind]} {reason.meaning}" for name, reason in REASONS.items()
        },
        beams=beams,
        listings=_listings(result, beams),
        again=_again_listing(plan),
        plan=plan,
        trimmed_ends=sum(doubt.cut for doubts in beams.doubts for doubt in doubts),
        fly_again_file=FLY_AGAIN.file_name,
        charts=titles,
        sections=sections,
        stages=_stage_rows(summary),
        grades=GRADES,
        max_beams=MAX_BEAMS,
        config_yaml=config_yaml(result.config),
        cloud_shown=min(len(result.cloud), MAX_CLOUD_POINTS),
        cloud_size=len(result.cloud),
    )


@dataclass(frozen=True, eq=False)
class _Beams:
    """The beams of a flight, and what is to be said of them."""

    result: FlightResult

    @cached_property
    def columns(self) -> ColumnArrays:
        return segment_columns(self.result.segments, time_origin_ns(self.result))

    @cached_property
    def doubts(self) -> list[tuple[Doubt, ...]]:
        return [doubts_of(beam, self.result.config) for beam in self.result.segments]

    @cached_property
    def grades(self) -> list[Grade]:
        pairs = zip(self.result.segments, self.doubts, strict=True)
        return [grade(beam, doubts) for beam, doubts in pairs]

    @cached_property
    def counts(self) -> Counter[Grade]:
        """Beams of every grade."""
        return Counter(self.grades)

    @cached_property
    def bent(self) -> list[bool]:
        return bent(self.columns)

    @property
    def n_bent(self) -> int:
        return sum(self.bent)

    @property
    def ends_seen(self) -> tuple[int, int] | None:
        """How many ends were seen, and of how many that is known."""
        known = [seen for beam in self.result.segments for seen in beam.ends_seen or ()]
        return (sum(known), len(known)) if known else None

    @property
    def sizes(self) -> str:
        """Radii in a few words, or their range."""
        radii = sorted({f"{beam.radius * 1e3:.0f}" for beam in self.result.segments}, key=int)
        if not radii:
            return "none found"
        shown = ", ".join(radii) if len(radii) <= 3 else f"{radii[0]} to {radii[-1]}"
        return f"radius {shown} mm"

    @property
    def sigma_mm(self) -> float | None:
        """Median of the deviations of the axes."""
        known = self.columns["sigma_offset"][np.isfinite(self.columns["sigma_offset"])]
        return float(1e3 * np.median(known)) if len(known) else None

    def labels(self) -> list[str]:
        """What is shown of every beam that is drawn, HTML."""
        return [self._label(number) for number in range(min(len(self.grades), MAX_BEAMS))]

    def _label(self, number: int) -> str:
        beam: Segment = self.result.segments[number]
        shape = self.columns["shape"][number]
        lines = [
            f"<b>beam {number}</b>: {escape(str(shape))}{', bent' if self.bent[number] else ''}",
            f"{beam.length:.3f} m long, {_extent(beam)} mm",
            f"{beam.n_points} points in {beam.n_scans} scans",
            *([f"axis ± {2e3 * beam.sigma_offset:.1f} mm"] if beam.sigma_offset > 0.0 else []),
            *(doubt.text for doubt in self.doubts[number]),
        ]
        return "<br>".join(lines)

    def shades(self) -> dict[str, Shade]:
        """Ways to colour the beams that are drawn."""
        if not self.grades:
            return {}
        return {
            "quality": _classes(self.grades[:MAX_BEAMS], _GRADE_COLOURS),
            "shape": self._shapes(),
            "first seen": _periods(self.columns["first_seen_s"][:MAX_BEAMS].tolist()),
        }

    def _shapes(self) -> Shade:
        shapes = [str(shape) for shape in self.columns["shape"][:MAX_BEAMS]]
        kinds = [
            _BENT if bends else shape
            for shape, bends in zip(shapes, self.bent[:MAX_BEAMS], strict=True)
        ]
        straight = sorted(set(kinds) - {_BENT})
        colours = {
            kind: _SHAPE_COLOURS[number % len(_SHAPE_COLOURS)]
            for number, kind in enumerate(straight)
        }
        return _classes(kinds, colours | {_BENT: "$bad"})

    def listing(self) -> Listing:
        """List them, with their grade and what is in doubt."""
        shown = set(_SHOWN[SEGMENTS.name].split())
        sigmas_known = any(np.isfinite(self.columns[name]).any() for name in _SIGMAS)
        shown |= set(_SIGMAS) if sigmas_known else {"n_points", "pca_coeff"}
        made = listing(SEGMENTS, self.columns, shown, "segment", MAX_TABLE_ROWS)
        quality = Heading("quality", "", "How well the beam is known", is_text=True)
        remarks = Heading("remarks", "", "What is in doubt, or stands out", is_text=True)
        return replace(
            made,
            headings=(made.headings[0], quality, remarks, *made.headings[1:]),
            rows=tuple(
                Row((row.cells[0], self._quality(n), self._remarks(n), *row.cells[1:]), n)
                for n, row in enumerate(made.rows)
            ),
        )

    def _quality(self, number: int) -> str:
        return chip(self.grades[number], _GRADE_COLOURS[self.grades[number]])

    def _remarks(self, number: int) -> str:
        doubts = ", ".join(doubt.text for doubt in self.doubts[number])
        return Html(f"{chip(_BENT, '$bad')} {escape(doubts)}") if self.bent[number] else doubts


def _extent(beam: Segment) -> str:
    """Size of a beam's cross-section, millimetres."""
    size = beam.cross_section.size
    if size is None:
        return f"radius {beam.radius * 1e3:.1f}"
    return f"{size.width * 1e3:.0f} × {size.height * 1e3:.0f}"


def _classes(kinds: Sequence[str], colours: Mapping[Any, str]) -> Shade:
    """Colour by kinds, in the order of the colours."""
    names = tuple(str(kind) for kind in colours if kind in kinds)
    rows = {name: row for row, name in enumerate(names)}
    return Shade(names, tuple(colours[name] for name in names), tuple(rows[kind] for kind in kinds))


def _periods(seconds: Sequence[float]) -> Shade:
    """Colour by time, in periods of equal length."""
    low, high = min(seconds), max(seconds)
    number = len(_TIME_COLOURS)
    step = (high - low) / number or 1.0
    names = tuple(f"{low + k * step:.0f}–{low + (k + 1) * step:.0f} s" for k in range(number))
    of = tuple(min(int((second - low) / step), number - 1) for second in seconds)
    return Shade(names, _TIME_COLOURS, of)


def _drawings(
    result: FlightResult, summary: Mapping[str, Any], plan: FlightPlan, beams: _Beams
) -> tuple[dict[str, Drawing], dict[str, str]]:
    """Figures of the page, and the titles of its charts."""
    drawings, titles = {}, {}
    structure = structure_scene(result, plan, beams.labels(), beams.shades()).drawing
    if structure.figure["data"]:
        drawings["structure"] = structure
    for name, (title, chart) in charts(result, summary["real_time"]["cloud_interval_ms"]).items():
        drawings[name], titles[name] = chart.drawing, title
    return drawings, titles


def _listings(result: FlightResult, beams: _Beams) -> dict[str, Listing]:
    """Tables of the page, by name."""
    tables: dict[Table, tuple[ColumnArrays, str | None]] = {
        JOINTS: (joint_columns(result.joints), None),
        MEMBERS: (member_columns(result.members, result.segments), "segment"),
        INTERSECTIONS: (intersection_columns(result.intersections), None),
    }
    return {"segments": beams.listing()} | {
        table.name: listing(table, columns, _SHOWN[table.name].split(), beam, MAX_TABLE_ROWS)
        for table, (columns, beam) in tables.items()
    }


def _again_listing(plan: FlightPlan) -> Listing:
    """List what to fly again."""
    headings = (
        Heading("beam", "", "Number of the beam"),
        Heading("why", "", "What is in doubt", is_text=True),
        *(Heading(f"look at {axis}", "m", "What to look at") for axis in "xyz"),
        *(Heading(f"from {axis}", "m", "Where the drone should be") for axis in "xyz"),
        Heading("yaw", "°", "Where the drone should point"),
    )
    rows = tuple(
        Row(
            (
                str(look.beam),
                ", ".join(look.reasons),
                *(f"{value:.2f}" for value in look.target),
                *(("–",) * 4 if look.place is None else [f"{value:.2f}" for value in look.place]),
                *(() if look.place is None else [f"{np.degrees(look.yaw):.0f}"]),
            ),
            look.beam,
        )
        for look in plan.looks
    )
    caption = "What to look at again, and from where, in the order of the flight."
    return Listing("fly-again", caption, headings, rows, len(rows), FLY_AGAIN.file_name)


def _stage_rows(summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Mean time of every stage, and its share of the time of a scan."""
    means = {stage: summary["processing"]["stages"][stage]["mean_ms"] or 0.0 for stage in STAGES}
    whole = max(sum(means.values()), 1e-12)
    return [
        {"name": stage, "mean_ms": mean, "share": round(100 * mean / whole, 1)}
        for stage, mean in means.items()
    ]


def _ms(value: float | None) -> str:
    """Milliseconds with three significant digits, or a dash."""
    if value is None:
        return "–"
    return f"{value:.{0 if value >= 100 else 1 if value >= 10 else 2}f}"


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.1f} MB" if size >= 100_000 else f"{size / 1e3:.1f} kB"
