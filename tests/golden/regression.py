"""The samples, held against what came out of them before: has anything moved?

    make regress    # exit code 3 if it has
    make golden     # make the goldens anew, on purpose

`README.md` says what lies in this folder, and what may differ.
"""

from __future__ import annotations

import json
import math
import shutil
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TypeAlias

import click
from click.testing import CliRunner, Result

from beamseg_batch.cli.main import beamseg
from beamseg_batch.tables import SEGMENTS, TABLES

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
DATA = ROOT / "data" / "samples"
OUTPUT = ROOT / "build" / "regress"

FROM_TF = ("--set", "sensor.extrinsic_from_tf=true")
SAMPLES = {
    "arena": ("--extrinsic", "0.071,0.011,0.04"),  # the recording does not say
    "tower_panel": FROM_TF,
    "empty": FROM_TF,
}
"""Samples, and how `run` learns where the camera sits."""
PROFILES = {"report": ("--profile", "report"), "default": ()}

TOLERANCE = 1e-6
"""Of lengths, in metres, and of figures that are shares, radians or counts."""
TOLERANCE_DEG = 1e-4
TOLERANCES = (
    *(f"--tol-{name}={TOLERANCE}" for name in ("offset", "end", "radius", "joint")),
    f"--tol-angle-deg={TOLERANCE_DEG}",
)
FIGURES = "evaluation.json"
MOVED = 3

Figures: TypeAlias = dict[str, float | None]


@dataclass(frozen=True)
class Case:
    """A sample, processed by a profile; `golden` and `output` are folders of its own."""

    sample: str
    profile: str
    golden: Path
    output: Path

    def __str__(self) -> str:
        return f"{self.sample}, {self.profile}"

    @property
    def run(self) -> Path:
        """Folder of the run."""
        return self.output / "run"

    def gates(self, command: str) -> tuple[str, ...]:
        """Give the gates that `evaluate` or `compare` must hold, as options."""
        file = self.golden / f"{command}.yaml"
        return ("--require", f"@{file}") if file.exists() else ()


def cases(golden: Path = HERE, output: Path = OUTPUT) -> Iterator[Case]:
    """Every sample with every profile."""
    for sample, profile in product(SAMPLES, PROFILES):
        place = Path(sample, profile)
        yield Case(sample, profile, golden / place, output / place)


def process(case: Case) -> None:
    """Process the sample."""
    recording = DATA / f"{case.sample}.mcap"
    options = (*SAMPLES[case.sample], *PROFILES[case.profile], "--set", "outputs.report=false")
    call("run", recording, "-o", case.run, "--overwrite", "--quiet", *options)


def compare(case: Case) -> Result:
    """Hold the run against the golden tables; exit code 3 if it moved or fails a gate."""
    junit = ("--junit", case.output / "compare.xml")
    return call("compare", case.golden, case.run, *TOLERANCES, *case.gates("compare"), *junit)


def evaluate(case: Case) -> tuple[Figures, str]:
    """Measure the run: its figures, and what is said of gates that fail.

    There are none where there are no gates: a truth without a member measures nothing.
    """
    gates = case.gates("evaluate")
    if not gates:
        return {}, ""
    truth = ("--truth", DATA / f"{case.sample}_truth.csv")
    junit = ("--junit", case.output / "evaluate.xml")
    result = call("evaluate", case.run, *truth, *gates, *junit, "--json")
    figures: Figures = json.loads(result.stdout)["metrics"]
    return figures, result.stderr if result.exit_code else ""


def call(*arguments: str | Path) -> Result:
    """Call `beamseg`; leave with its message if it can do nothing at all."""
    texts = [str(argument) for argument in arguments]
    result = CliRunner().invoke(beamseg, texts, catch_exceptions=False)
    if result.exit_code not in {0, MOVED}:
        raise SystemExit(f"beamseg {' '.join(texts)}\n{result.output}")
    return result


def changed(before: Mapping[str, float | None], after: Figures) -> list[str]:
    """Name the figures that differ by more than a tolerance."""
    names = {**before, **after}
    return [
        f"{name}: {before.get(name)} became {after.get(name)}"
        for name in names
        if not _same(name, before.get(name), after.get(name))
    ]


def _same(name: str, before: float | None, after: float | None) -> bool:
    if before is None or after is None:
        return before is after
    tolerance = TOLERANCE_DEG if name.startswith("angle_deg") else TOLERANCE
    return math.isclose(before, after, rel_tol=0.0, abs_tol=tolerance)


def regress(case: Case) -> str:
    """Say what of a run differs from the goldens or fails a gate; nothing if all is well."""
    comparison = compare(case)
    figures, failed = evaluate(case)
    return _joined(
        comparison.output if comparison.exit_code else "",
        *changed(_golden_figures(case), figures),
        failed,
    )


def renew(case: Case) -> str:
    """Make a golden out of a run, and say what changed; the gates stay as they are."""
    is_new = not (case.golden / SEGMENTS.file_name).exists()
    difference = "new" if is_new else regress(case)
    case.golden.mkdir(parents=True, exist_ok=True)
    for table in TABLES:
        (case.golden / table.file_name).unlink(missing_ok=True)
        if table.deterministic and (case.run / table.file_name).exists():
            shutil.copyfile(case.run / table.file_name, case.golden / table.file_name)
    if figures := evaluate(case)[0]:
        text = json.dumps(figures, indent=1) + "\n"
        (case.golden / FIGURES).write_text(text, encoding="utf-8")
    return difference


def _joined(*texts: str) -> str:
    return "\n".join(text.rstrip() for text in texts if text)


def _golden_figures(case: Case) -> Figures:
    file = case.golden / FIGURES
    figures: Figures = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    return figures


@click.command()
@click.option("--renew", "renewing", is_flag=True, help="Make the goldens anew.")
def main(renewing: bool) -> None:
    """Process all samples, and hold them against the goldens."""
    failed = False
    for case in cases():
        process(case)
        text = renew(case) if renewing else regress(case)
        verdict = "changed" if renewing else "failed"
        click.echo(f"{case}: {verdict if text else 'as before'}")
        if text:
            click.echo("".join(f"    {line}".rstrip() + "\n" for line in text.splitlines()))
        failed |= bool(text) and not renewing
    if failed:
        click.echo("What is meant to change: make golden, and commit what it wrote.", err=True)
        sys.exit(MOVED)


if __name__ == "__main__":
    main()
