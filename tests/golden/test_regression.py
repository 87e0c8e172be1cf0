"""The regression notices what moved: a regression that never fails is worth nothing."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pandas as pd
import pytest
from click.testing import CliRunner

from tests.golden import regression
from tests.golden.regression import Case, changed, process, regress, renew

PLACE = Path("arena", "report")


@pytest.fixture(scope="module")
def output(tmp_path_factory):
    """Process one case; it is read only from then on, but for its JUnit files."""
    case = Case("arena", "report", Path(), tmp_path_factory.mktemp("output"))
    process(case)
    return case.output


@pytest.fixture
def case(output, tmp_path):
    """Give that case, with a copy of its golden that holds on this machine."""
    golden = tmp_path / "golden"
    shutil.copytree(regression.HERE / PLACE, golden)
    case = Case("arena", "report", golden, output)
    renew(case)
    return case


def edit_segments(case, column, change):
    table = pd.read_csv(case.golden / "segments.csv")
    table[column] += change
    table.to_csv(case.golden / "segments.csv", index=False)


def test_regress__nothing_moved(case):
    assert regress(case) == ""


@pytest.mark.parametrize("column", ["a_x", "a_y", "a_z", "radius"])
def test_regress__segments_moved(case, column):
    edit_segments(case, column, 1e-5)
    text = regress(case)
    assert "7 moved" in text
    assert "beamseg: failed: segments.moved == 0: is 7" in text


def test_regress__rounding_is_no_move(case):
    edit_segments(case, "a_x", 1e-9)
    assert regress(case) == ""


def test_regress__segment_vanished(case):
    table = pd.read_csv(case.golden / "segments.csv")
    more = table.iloc[:1].assign(segment=7, a_z=table["a_z"].iloc[0] + 5.0)
    pd.concat([table, more]).to_csv(case.golden / "segments.csv", index=False)
    assert "1 vanished" in regress(case)


def test_regress__figure_changed(case):
    """The run is the same, so it is the measure that has another meaning."""
    file = case.golden / "evaluation.json"
    figures = json.loads(file.read_text())
    file.write_text(json.dumps(figures | {"recall": 0.5}))
    assert regress(case) == "recall: 0.5 became 1.0"


@pytest.mark.parametrize(
    ("command", "gate"), [("evaluate", "axis_offset.max <= 0.001"), ("compare", "segments.b <= 6")]
)
def test_regress__gate_failed(case, command, gate):
    (case.golden / f"{command}.yaml").write_text(f"- {gate}\n")
    assert f"failed: {gate}" in regress(case)


def test_renew__says_what_changed_and_heals(case):
    edit_segments(case, "a_x", 1e-5)
    gates = (case.golden / "evaluate.yaml").read_bytes()
    assert "7 moved" in renew(case)
    assert regress(case) == ""
    assert (case.golden / "evaluate.yaml").read_bytes() == gates


def test_renew__new_case(case):
    for name in ("segments.csv", "intersections.csv", "joints.csv", "evaluation.json"):
        (case.golden / name).unlink()
    assert renew(case) == "new"
    assert regress(case) == ""


def test_changed__figures():
    before = {"a": 1.0, "b": None, "gone": 1, "angle_deg.max": 0.2}
    after = {"a": 1.0 + 1e-7, "b": 0.5, "angle_deg.max": 0.20005, "new": None}
    assert changed(before, after) == ["b: None became 0.5", "gone: 1 became None"]
    assert changed({"angle_deg.max": 0.2}, {"angle_deg.max": 0.2002}) != []


def test_main__exit_code(case, monkeypatch):
    monkeypatch.setattr(regression, "cases", lambda: [case])
    assert CliRunner().invoke(regression.main).exit_code == 0
    edit_segments(case, "a_x", 1e-5)
    result = CliRunner().invoke(regression.main)
    assert result.exit_code == 3
    assert "arena, report: failed" in result.output
    result = CliRunner().invoke(regression.main, ["--renew"])
    assert result.exit_code == 0
    assert "arena, report: changed" in result.output
    assert CliRunner().invoke(regression.main).exit_code == 0
