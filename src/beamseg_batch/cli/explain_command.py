"""`beamseg explain`: why there is, or is not, a beam at a place."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from beamseg_batch.cli.console import say
from beamseg_batch.cli.measuring import MAX_NAMED, FiniteRange, run_path

if TYPE_CHECKING:
    from beamseg_batch.outputs.explanation import Explanation, NearCandidate, NearSegment

__all__ = ["command"]

_MOST_M = 1e6


def _place(
    _context: click.Context, _parameter: click.Parameter, text: str
) -> tuple[float, float, float]:
    """Read three numbers between commas, or say what is wrong with them."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not all(abs(number) <= _MOST_M for number in (x, y, z)):
        raise click.BadParameter(
            f"{text!r}: write x,y,z in metres, world frame, for example 1.20,0.35,1.10"
        )
    return x, y, z


@click.command("explain")
@click.argument("run", type=run_path)
@click.option(
    "--at",
    metavar="X,Y,Z",
    callback=_place,
    required=True,
    help="The place: metres, world frame, as in the tables and the report.",
)
@click.option(
    "--within",
    metavar="METRES",
    type=FiniteRange(min=0.0, max=_MOST_M),
    default=0.2,
    show_default=True,
    help="What lies no further off counts as there.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON for machines.")
def command(run: Path, at: tuple[float, float, float], within: float, as_json: bool) -> None:
    """Say why there is, or is not, a beam at a place.

    RUN is a folder that `beamseg run` wrote. Told are, in time order, the scans that looked
    there, the segments that lie there, and everything that might have been a beam but is
    none, with the number that decided, its limit and the configuration value to change. The
    last needs a run with --keep-candidates. Distances are to surfaces.

    \b
    Example: the report shows points at 1.20, 0.35, 1.10, but no beam. Why?
      beamseg run flight.mcap -o out --keep-candidates
      beamseg explain out --at 1.20,0.35,1.10
      beamseg explain out --at=-0.5,0,2 --within 0.5 --json

    Write --at=-0.5,0,2 where the first number is negative.
    """  # noqa: D301 (click reads the backspace)
    from beamseg_batch.outputs import read_run
    from beamseg_batch.outputs.explanation import explain, explanation_document

    explanation = explain(read_run(run), at, within)
    if as_json:
        say(json.dumps(explanation_document(explanation), indent=2, allow_nan=False))
    else:
        say("\n".join(_lines(explanation)))


def _lines(told: Explanation) -> Iterator[str]:
    """Write an explanation for people."""
    x, y, z = told.at
    yield f"place         {x:.3f}, {y:.3f}, {z:.3f} m, and {told.within:.2f} m around it"
    yield f"looks         {_looks(told)}"
    yield f"cloud         {told.n_cloud_points} points of the thinned cloud are here"
    for segment in told.segments[:MAX_NAMED]:
        yield f"segment {segment.segment:<6}{_segment(segment)}"
    if len(told.segments) > MAX_NAMED:
        yield f"and {len(told.segments) - MAX_NAMED} segments further off; --json has them all"
    if not told.segments:
        yield "segments      none"
    yield from _candidates(told.candidates)
    yield ""
    yield told.conclusion


def _looks(told: Explanation) -> str:
    if told.n_scans_aimed is None:
        return "not known: the run does not tell where the camera was"
    text = f"{told.n_scans_aimed} of {told.n_scans} scans had the place in their window"
    if told.aimed_s is None:
        return text
    return f"{text}, {told.aimed_s[0]:.1f} to {told.aimed_s[1]:.1f} s"


def _segment(segment: NearSegment) -> str:
    sigma = segment.sigma_offset
    sure = "" if sigma is None else f", axis known to {sigma * 1e3:.2f} mm"
    return (
        f"{segment.distance:.2f} m away, {segment.length:.2f} m long, "
        f"radius {segment.radius:.3f} m, "
        f"{segment.n_points} rays or points of {segment.n_scans} scans{sure}, "
        f"seen {segment.first_seen_s:.1f} to {segment.last_seen_s:.1f} s"
    )


def _candidates(candidates: Sequence[NearCandidate] | None) -> Iterator[str]:
    """List the candidates in time order; of many those that are told first."""
    if candidates is None:
        return
    yield ""
    yield (
        "what was seen here, in time order" if candidates else "no line was found here in any scan"
    )
    rows = list(_grouped(candidates))
    first = sorted(range(len(rows)), key=lambda k: _importance(rows[k]))[:MAX_NAMED]
    for k in sorted(first):
        yield f"  {_when(rows[k]):16}{_text(rows[k])}"
    if len(rows) > MAX_NAMED:
        yield f"  and {len(rows) - MAX_NAMED} more; --json has them all"


def _grouped(candidates: Sequence[NearCandidate]) -> Iterator[Sequence[NearCandidate]]:
    """Put together the lines that were refused for one reason, in the order of the first."""
    groups: dict[tuple[str, str, int], list[NearCandidate]] = {}
    for k, one in enumerate(candidates):
        groups.setdefault((one.stage, one.reason, -1 if one.is_line else k), []).append(one)
    yield from groups.values()


def _text(group: Sequence[NearCandidate]) -> str:
    if len(group) == 1:
        return group[0].text
    best = min(group, key=lambda one: one.shortfall)
    lines = sum(one.n_lines or 0 for one in group)
    return f"{lines} lines at {len(group)} places, all refused; nearest to a beam: {best.text}"


def _importance(group: Sequence[NearCandidate]) -> tuple[bool, float]:
    """What is told first of much: lines, and the nearest candidates that are no beam."""
    return group[0].fate == "kept", 0.0 if group[0].is_line else group[0].distance


def _when(group: Sequence[NearCandidate]) -> str:
    if group[0].stage == "pass":
        return f"pass {group[0].in_pass}"
    if group[0].stage == "end":
        return "in the end"
    first = f"{min(one.first_seen_s for one in group):.1f}"
    last = f"{max(one.last_seen_s for one in group):.1f}"
    return f"{first} s" if first == last else f"{first} to {last} s"
