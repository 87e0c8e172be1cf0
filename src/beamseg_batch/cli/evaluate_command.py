"""`beamseg evaluate`: a run measured against the truth."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from beamseg_batch.cli.console import note, say
from beamseg_batch.cli.measuring import (
    check_options,
    end_with,
    listed,
    run_path,
    spread_table,
    write_junit,
)

if TYPE_CHECKING:
    from beamseg_batch.evaluation import Evaluation

__all__ = ["command"]


_DEVIATIONS = ("offset", "angle", "radius", "ends", "member_ends")


@click.command("evaluate")
@click.argument("run", type=run_path)
@click.option(
    "--truth",
    metavar="PATH",
    required=True,
    type=click.Path(exists=True, path_type=Path),
    help="truth.csv, its folder, or a world: .yaml or .wbt.",
)
@check_options
@click.option(
    "--html",
    metavar="FILE",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write a page with truth and result in one view.",
)
def command(
    run: Path,
    truth: Path,
    radius: float | None,
    requirements: tuple[str, ...],
    junit: Path | None,
    as_json: bool,
    html: Path | None,
) -> None:
    """Measure a run against the truth.

    RUN is a folder that `beamseg run` wrote, or any folder with a segments.csv that has
    the columns of the original node. What was not seen counts neither as missed nor as
    false; docs/evaluation.md explains every measure.

    \b
    Examples:
      beamseg evaluate out --truth sim/truth
      beamseg evaluate out --truth my.wbt --html evaluation.html
      beamseg evaluate out --truth truth.csv --require 'axis_offset.median<=0.005'
      beamseg evaluate out --truth truth.csv --require @gates.yaml --junit g.xml

    Exit code 3: a gate failed.
    """  # noqa: D301 (click reads the backspace)
    from beamseg_batch.evaluation import (
        MEASURES,
        check_gates,
        evaluate,
        load_gates,
        load_result,
        load_truth,
        metric_names,
    )
    from beamseg_batch.evaluation.documents import evaluation_json

    gates = load_gates(requirements, metric_names(MEASURES))
    evaluation = evaluate(load_truth(truth), load_result(run, radius))
    checks = check_gates(gates, evaluation.metrics)
    if as_json:
        say(evaluation_json(evaluation, checks))
    else:
        say("\n".join(_lines(evaluation)))
    for text in evaluation.notes:
        note(text)
    write_junit(junit, f"evaluate {run}", checks, evaluation.metrics)
    if html is not None:
        from beamseg_batch.evaluation.files import write_text
        from beamseg_batch.evaluation.page import render_evaluation

        write_text(html, render_evaluation(evaluation, checks))
    if checks and all(check.passed for check in checks):
        note(f"{len(checks)} of {len(checks)} gates hold")
    end_with(checks)


def _lines(evaluation: Evaluation) -> Iterator[str]:
    """Write an evaluation for people."""
    from beamseg_batch.evaluation import MEASURES
    from beamseg_batch.evaluation.wording import percent

    m, joints = evaluation.metrics, evaluation.joints
    yield (
        f"members   {m['matched']} of {m['members']} found, {m['missed']} missed: "
        f"recall {percent(m['recall'])}"
    )
    yield (
        f"segments  {m['segments']}: {m['matched']} matched, {m['duplicates']} duplicates, "
        f"{m['fragments']} fragments, {m['false']} false: precision {percent(m['precision'])}"
    )
    if joints is None:
        yield f"joints    {m['joints.truth']} in the truth; the run says nothing of joints"
    else:
        yield (
            f"joints    {m['joints.found']} of {m['joints.truth']} found, "
            f"{m['joints.missed']} missed, {m['joints.invented']} invented"
        )
    yield from _shares(evaluation)
    yield from spread_table(MEASURES, m)
    yield from _names(evaluation)


def _shares(evaluation: Evaluation) -> Iterator[str]:
    """Radius, shape and honesty, as far as they are known."""
    from beamseg_batch.evaluation.wording import percent

    lines = {
        "right": ("radius_class.right", "shape.right"),
        "in 2σ": tuple(f"honesty.{name}" for name in _DEVIATIONS),
    }
    for label, names in lines.items():
        known = [
            f"{name.removesuffix('.right').removeprefix('honesty.')} {percent(value)}"
            for name in names
            if (value := evaluation.metrics[name]) is not None
        ]
        if known:
            yield f"{label:10}{', '.join(known)}"


def _names(evaluation: Evaluation) -> Iterator[str]:
    """Name what went wrong, a line per kind."""
    truth, result = evaluation.truth, evaluation.result
    kinds = {"missed": [truth.names[member] for member in evaluation.missed]}
    for verdict, number in zip(evaluation.verdicts, result.numbers, strict=True):
        if verdict != "matched":
            kinds.setdefault(verdict, []).append(str(number))
    named = {kind: names for kind, names in kinds.items() if names}
    if named:
        yield ""
    for kind, names in named.items():
        what = "members" if kind == "missed" else "segments"
        yield f"{kind}: {what} {listed(names)}"
