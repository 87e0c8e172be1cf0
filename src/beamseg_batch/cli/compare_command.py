"""`beamseg compare`: a run held against another run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from beamseg_batch.cli.console import say
from beamseg_batch.cli.measuring import (
    MAX_NAMED,
    FiniteRange,
    check_options,
    end_with,
    listed,
    run_path,
    spread_table,
    write_junit,
)

if TYPE_CHECKING:
    from beamseg_batch.evaluation import Comparison

__all__ = ["command"]

F = TypeVar("F", bound=Callable[..., Any])


def _tolerance(name: str, unit: str, default: float, meaning: str) -> Callable[[F], F]:
    return click.option(
        name,
        metavar=unit,
        type=FiniteRange(min=0.0),
        default=default,
        show_default=True,
        help=meaning,
    )


@click.command("compare")
@click.argument("run_a", type=run_path)
@click.argument("run_b", type=run_path)
@_tolerance("--tol-offset", "METRES", 0.001, "Mean distance of the axes that is no move.")
@_tolerance("--tol-angle-deg", "DEGREES", 0.1, "Angle between the axes that is no move.")
@_tolerance("--tol-end", "METRES", 0.005, "Distance of an end that is no move.")
@_tolerance("--tol-radius", "METRES", 0.001, "Difference of the radii that is no move.")
@_tolerance("--tol-joint", "METRES", 0.005, "Distance of a joint that is no move.")
@check_options
def command(
    run_a: Path,
    run_b: Path,
    tol_offset: float,
    tol_angle_deg: float,
    tol_end: float,
    tol_radius: float,
    tol_joint: float,
    radius: float | None,
    requirements: tuple[str, ...],
    junit: Path | None,
    as_json: bool,
) -> None:
    """Hold run B against run A: what appeared, vanished, moved.

    The runs are folders that `beamseg run` wrote, or any folders with a segments.csv that
    has the columns of the original node. A segment has moved when its axis, an end or its
    radius differs by more than the tolerance, or its cross-section is another.

    \b
    Examples:
      beamseg compare golden out
      beamseg compare golden out --tol-offset 0.0001 --junit compare.xml
      beamseg compare before after --require 'time.median_ms.ratio<=1.2'

    Exit code 3: the runs differ by more than the tolerances, or a gate failed.
    """  # noqa: D301 (click reads the backspace)
    from beamseg_batch.evaluation import (
        COMPARED,
        Tolerances,
        check_gates,
        compare,
        load_gates,
        metric_names,
    )
    from beamseg_batch.evaluation.documents import comparison_json

    gates = load_gates(requirements, metric_names(COMPARED))
    tolerances = Tolerances(tol_offset, tol_angle_deg, tol_end, tol_radius, tol_joint)
    comparison = compare(run_a, run_b, tolerances, radius)
    checks = (*comparison.checks(), *check_gates(gates, comparison.metrics))
    say(comparison_json(comparison, checks) if as_json else "\n".join(_lines(comparison)))
    write_junit(junit, f"compare {run_a} {run_b}", checks, comparison.metrics)
    end_with(checks)


def _lines(comparison: Comparison) -> Iterator[str]:
    """Write a comparison for people."""
    from beamseg_batch.evaluation import COMPARED
    from beamseg_batch.evaluation.wording import number

    m = comparison.metrics
    for name in ("segments", "intersections", "joints"):
        moved = f", {m[f'{name}.moved']} moved" if f"{name}.moved" in m else ""
        yield (
            f"{name:15}{_count(m[f'{name}.a'])} in A, {_count(m[f'{name}.b'])} in B: "
            f"{m[f'{name}.vanished']} vanished, {m[f'{name}.appeared']} appeared{moved}"
        )
    for label, name, unit in (("a scan", "median_ms", "ms"), ("the run", "wall_s", "s")):
        a, b, ratio = (number(m[f"time.{name}.{part}"]) for part in ("a", "b", "ratio"))
        yield f"{label:15}{a} and {b} {unit}, ratio {ratio}"
    states = (f"{name} {state}" for name, state in comparison.tables.items())
    yield f"{'bytes':15}{', '.join(states)}"
    yield from spread_table(COMPARED, m)
    yield from _names(comparison)


def _count(number: float | None) -> str:
    return "unknown" if number is None else str(number)


def _names(comparison: Comparison) -> Iterator[str]:
    """Name what differs, a line per kind and one per segment that moved."""
    a, b = comparison.a.numbers, comparison.b.numbers
    kinds = {
        "vanished: segments of A": [str(a[segment]) for segment in comparison.vanished],
        "appeared: segments of B": [str(b[segment]) for segment in comparison.appeared],
    }
    moved = [
        f"moved: segment {a[move.a]} of A, {b[move.b]} of B: axis {1e3 * move.offset:.2f} mm, "
        f"{move.angle_deg:.3f}°, end {1e3 * move.end:.2f} mm, radius {1e3 * move.radius:.2f} mm"
        + (f", {move.shapes[0]} became {move.shapes[1]}" if move.shapes else "")
        for move in comparison.moved
    ]
    if moved or any(kinds.values()):
        yield ""
    for kind, names in kinds.items():
        if names:
            yield f"{kind} {listed(names)}"
    yield from moved[:MAX_NAMED]
    if len(moved) > MAX_NAMED:
        yield f"and {len(moved) - MAX_NAMED} more moved; --json has them all"
