"""`beamseg evaluate`: a run measured against the truth."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from beamseg_batch.evaluation import MEASURES, metric_names
from tests.evaluation.structures import scattered, truth_of, write_run, write_truth

SAMPLES = Path(__file__).parents[2] / "data" / "samples"
ENDS = scattered(4, seed=5)
HEADER = "id,x1,y1,z1,x2,y2,z2,radius"
FAILED, USAGE, GATE_FAILED = 1, 2, 3


@pytest.fixture
def truth(here):
    """Write a truth of four members, which meet nowhere."""
    return write_truth(here / "truth" / "truth.csv", truth_of(ENDS))


@pytest.fixture
def run(here):
    """Write a run that has three of them, each 4 mm too high, and a false one."""
    found = np.concatenate([np.add(ENDS[:3], [0.0, 0.0, 0.004]), np.add(ENDS[:1], [0.0, 0.0, 0.5])])
    return write_run(here / "run", found)


def metrics_of(result):
    return json.loads(result.stdout)["metrics"]


def test_evaluate__tells_people(ok, run, truth):
    out = ok("evaluate", run, "--truth", truth).stdout
    assert "members   3 of 4 found, 1 missed: recall 75.0 %" in out
    assert "segments  4: 3 matched, 0 duplicates, 0 fragments, 1 false: precision 75.0 %" in out
    assert "joints    0 of 0 found" in out
    assert "axis_offset" in out
    assert "missed: members 4" in out
    assert "false: segments 3" in out


def test_evaluate__json_for_machines(ok, run, truth):
    result = ok("evaluate", run, "--truth", truth, "--json")
    document = json.loads(result.stdout)
    assert document["schema_version"] == 1
    assert tuple(document["metrics"]) == metric_names(MEASURES)
    assert document["missed"] == ["4"]
    assert [s["verdict"] for s in document["segments"]] == ["matched"] * 3 + ["false"]
    assert [m["member"] for m in document["matches"]] == ["1", "2", "3"]
    assert max(m["axis_offset"] for m in document["matches"]) <= 0.004
    assert document["metrics"]["midpoint_distance.max"] == pytest.approx(0.004)
    assert document["metrics"]["joints.error.max"] is None
    assert "nothing" not in result.stderr


def test_evaluate__the_truths_folder(ok, run, truth):
    one, other = (ok("evaluate", run, "--truth", path, "--json") for path in (truth, truth.parent))
    assert metrics_of(one) == metrics_of(other)


def test_evaluate__a_run_of_the_original_node(ok, call, here, truth):
    folder = write_run(here / "old", ENDS, original=True)
    given = ok("evaluate", folder, "--truth", truth, "--radius", 0.05, "--json")
    assert metrics_of(given)["recall"] == 1.0
    result = call("evaluate", folder, "--truth", truth)
    assert result.exit_code == USAGE
    assert "--radius 0.05" in result.stderr


def test_evaluate__a_real_run(ok, here):
    """The sample flight, as the `report` profile sees it."""
    ok(
        *("run", SAMPLES / "arena.mcap", "-o", "out", "--profile", "report"),
        *("--extrinsic", "0.071,0.011,0.04", "--set", "outputs.report=false", "-q"),
    )
    result = ok("evaluate", "out", "--truth", SAMPLES / "arena_truth.csv", "--json")
    metrics = metrics_of(result)
    assert (metrics["matched"], metrics["members"], metrics["segments"]) == (7, 7, 7)
    assert (metrics["joints.found"], metrics["joints.invented"]) == (2, 0)
    assert 0.03 < metrics["axis_offset.median"] < 0.05
    assert result.stderr == ""


# Worlds


def test_evaluate__a_webots_world(ok, here):
    world = Path(__file__).parents[1] / "data" / "webots_tests.wbt"
    table = np.loadtxt(
        Path(__file__).parents[1] / "data" / "truths" / "webots_tests.csv",
        delimiter=",", skiprows=1, usecols=range(1, 7),
    )  # fmt: skip
    folder = write_run(here / "run", table.reshape(-1, 2, 3))
    metrics = metrics_of(ok("evaluate", folder, "--truth", world, "--json"))
    assert metrics["matched"] == metrics["members"] == 7
    assert metrics["axis_offset.max"] < 1e-3
    assert metrics["own_end_error.max"] < 1e-3


def test_evaluate__a_yaml_world(ok, here):
    world = here / "world.yaml"
    world.write_text(
        "name: one\nmembers:\n"
        "- {name: only, ends: [[0, 0, 1], [2, 0, 1]], shape: round, radius: 0.05}\n"
    )
    folder = write_run(here / "run", [[[0, 0, 1], [2, 0, 1]]])
    assert metrics_of(ok("evaluate", folder, "--truth", world, "--json"))["recall"] == 1.0


# Gates


def test_evaluate__gates_that_hold(ok, run, truth):
    result = ok(
        *("evaluate", run, "--truth", truth),
        *("--require", "recall>=0.75", "--require", "axis_offset.max<0.005"),
    )
    assert "2 of 2 gates hold" in result.stderr


def test_evaluate__gates_that_fail_are_named(call, run, truth):
    result = call(
        *("evaluate", run, "--truth", truth, "--require", "recall==1"),
        *("--require", "false==1", "--require", "joints.error.max<=0.1"),
    )
    assert result.exit_code == GATE_FAILED
    assert result.stderr.splitlines() == [
        "beamseg: failed: recall == 1: is 0.75",
        "beamseg: failed: joints.error.max <= 0.1: has no value: there was nothing to measure",
    ]
    assert "recall 75.0 %" in result.stdout


def test_evaluate__gates_of_a_file(call, here, run, truth):
    (here / "gates.yaml").write_text("- recall >= 0.5\n- precision >= 0.99\n")
    result = call("evaluate", run, "--truth", truth, "--require", "@gates.yaml", "--json")
    assert result.exit_code == GATE_FAILED
    assert [gate["passed"] for gate in json.loads(result.stdout)["gates"]] == [True, False]


@pytest.mark.parametrize(
    ("gate", "reason"),
    [
        ("recal>=1", "--require: there is no metric 'recal'; did you mean 'recall'?"),
        ("recall", "--require: 'recall' is not a gate"),
        ("@none.yaml", "none.yaml: cannot be read"),
    ],
)
def test_evaluate__wrong_gates(refused, run, truth, gate, reason):
    assert reason in refused(USAGE, "evaluate", run, "--truth", truth, "--require", gate)


# Files


def test_evaluate__junit_and_page(call, here, run, truth):
    result = call(
        *("evaluate", run, "--truth", truth, "--require", "recall==1", "--require", "missed==1"),
        *("--junit", "out/gates.xml", "--html", "out/page.html"),
    )
    assert result.exit_code == GATE_FAILED
    suite = ElementTree.parse(here / "out" / "gates.xml").getroot().find("testsuite")
    assert (suite.get("tests"), suite.get("failures")) == ("2", "1")
    assert "recall == 1" in (here / "out" / "page.html").read_text(encoding="utf-8")
    assert sorted(file.name for file in (here / "out").iterdir()) == ["gates.xml", "page.html"]


def test_evaluate__replaces_a_page(ok, here, run, truth):
    (here / "page.html").write_text("old")
    ok("evaluate", run, "--truth", truth, "--html", "page.html")
    assert "<!DOCTYPE html>" in (here / "page.html").read_text(encoding="utf-8")


def test_evaluate__a_page_that_cannot_be_written(call, here, run, truth):
    (here / "file").write_text("")
    result = call("evaluate", run, "--truth", truth, "--html", "file/page.html")
    assert result.exit_code == USAGE
    assert "page.html: cannot be written" in result.stderr
    assert result.stderr.count("\n") == 1


# Bad input


def test_evaluate__nothing_found(ok, here, truth):
    metrics = metrics_of(ok("evaluate", write_run(here / "run", []), "--truth", truth, "--json"))
    assert metrics["recall"] == 0.0
    assert metrics["precision"] is None


def test_evaluate__no_run(refused, here, truth):
    (here / "empty").mkdir()
    reason = refused(FAILED, "evaluate", "empty", "--truth", truth)
    assert reason == "empty has no segments.csv"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "run/segments.csv: is empty, not even a header"),
        ("a,b\n1,2\n", "run/segments.csv: has no column segment, a_x"),
    ],
)
def test_evaluate__broken_run(refused, here, truth, text, reason):
    (here / "run").mkdir()
    (here / "run" / "segments.csv").write_text(text)
    assert refused(FAILED, "evaluate", "run", "--truth", truth).startswith(reason)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("id,x1\n1,2\n", "t.csv: has no column y1, z1, x2, y2, z2, radius"),
        (f"{HEADER}\n1,0,0,0,0,0,0,1\n", "t.csv: row 1: member '1' has no length"),
        (f"{HEADER}\n1,0,0,nan,0,0,0,1\n", "t.csv: row 1: z1 is nan"),
    ],
)
def test_evaluate__broken_truth(refused, here, run, text, reason):
    (here / "t.csv").write_text(text)
    assert refused(FAILED, "evaluate", run, "--truth", "t.csv").startswith(reason)


def test_evaluate__broken_world(refused, here, run):
    (here / "w.yaml").write_text("members: 7\n")
    assert refused(USAGE, "evaluate", run, "--truth", "w.yaml").startswith("w.yaml")


@pytest.mark.parametrize(
    "arguments",
    [
        ["evaluate"],
        ["evaluate", "."],
        ["evaluate", "nowhere", "--truth", "."],
        ["evaluate", ".", "--truth", "nowhere.csv"],
        ["evaluate", ".", "--truth", ".", "--radius", "0"],
        ["evaluate", ".", "--truth", ".", "--radius", "thick"],
        ["evaluate", ".", "--truth", ".", "--radius", "nan"],
    ],
)
def test_evaluate__usage(call, arguments):
    result = call(*arguments)
    assert result.exit_code == USAGE
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
