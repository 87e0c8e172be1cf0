"""What `evaluate` and `compare` share: options, tables for people, and how they end."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from beamseg_batch.cli.console import GATE_FAILED, note

if TYPE_CHECKING:
    from beamseg_batch.evaluation import Check, Measure, Metrics

__all__ = [
    "MAX_NAMED",
    "FiniteRange",
    "check_options",
    "end_with",
    "listed",
    "run_path",
    "spread_table",
    "write_junit",
]

MAX_NAMED = 20
"""Things that are named one by one; how many more there are is told."""

F = TypeVar("F", bound=Callable[..., Any])

run_path = click.Path(exists=True, file_okay=False, path_type=Path)
"""Type of an argument that is the folder of a run."""


class FiniteRange(click.FloatRange):
    """A number in a range; NaN is in no range, though no limit tells."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Read the number, or say what is wrong with it."""
        number: float = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return number


_CHECK_OPTIONS = (
    click.option(
        "--radius",
        metavar="METRES",
        type=FiniteRange(min=0.0, min_open=True, max=1e4),
        help="Radius of all segments, where segments.csv has none.",
    ),
    click.option(
        "--require",
        "requirements",
        metavar="GATE",
        multiple=True,
        help="Exit 3 unless this holds, METRIC SIGN NUMBER as in the examples; @FILE for a "
        "YAML list of gates. Repeatable.",
    ),
    click.option(
        "--junit",
        metavar="FILE",
        type=click.Path(dir_okay=False, path_type=Path),
        help="Write what had to hold as JUnit XML.",
    ),
    click.option("--json", "as_json", is_flag=True, help="Print JSON for machines."),
)


def check_options(function: F) -> F:
    """Give a command ``--radius``, ``--require``, ``--junit`` and ``--json``."""
    for option in reversed(_CHECK_OPTIONS):
        function = option(function)
    return function


def spread_table(measures: Iterable[Measure], metrics: Metrics) -> Iterator[str]:
    """Write the spreads that have a value as a table for people, below an empty line."""
    from rich.console import Console
    from rich.table import Table

    from beamseg_batch.evaluation.wording import spread_rows

    rows = spread_rows(measures, metrics)
    if not rows:
        return
    table = Table("", "median", "95 %", "max", "", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for column in table.columns[1:4]:
        column.justify = "right"
    for row in rows:
        table.add_row(row.name, *row.figures, row.unit)
    text = io.StringIO()
    Console(file=text, width=100, color_system=None).print(table)
    yield ""
    yield from (line.rstrip() for line in text.getvalue().splitlines())


def listed(names: Sequence[str]) -> str:
    """Name things in a row, and say how many more there are."""
    more = f" and {len(names) - MAX_NAMED} more" if len(names) > MAX_NAMED else ""
    return f"{', '.join(names[:MAX_NAMED])}{more}"


def write_junit(file: Path | None, suite: str, checks: Sequence[Check], metrics: Metrics) -> None:
    """Write the checks as JUnit XML, if that was asked for."""
    from beamseg_batch.evaluation.files import write_text
    from beamseg_batch.evaluation.junit import junit_xml

    if file is not None:
        write_text(file, junit_xml(suite, checks, metrics))


def end_with(checks: Sequence[Check]) -> None:
    """Name what failed, on stderr, and leave with exit code 3 if anything did."""
    failed = [check for check in checks if not check.passed]
    for check in failed:
        note(f"failed: {check.name}: {check.found}")
    if failed:
        click.get_current_context().exit(GATE_FAILED)
