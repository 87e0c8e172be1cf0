"""`beamseg compare`: a run held against another run."""

from __future__ import annotations

import json
from xml.etree import ElementTree

import numpy as np
import pytest

from beamseg_batch.evaluation import COMPARED, metric_names
from tests.evaluation.structures import scattered, write_run

ENDS = scattered(4, seed=6)
FAILED, USAGE, DIFFERS = 1, 2, 3


@pytest.fixture
def a(here):
    return write_run(here / "a", ENDS)


@pytest.fixture
def b(here):
    """Write a run in which one segment has moved by 2 mm, one is gone, and one is new."""
    others = np.concatenate([ENDS[:3], np.add(ENDS[:1], [0.0, 0.0, 0.6])])
    others[0] += [0.0, 0.0, 0.002]
    return write_run(here / "b", others)


def test_compare__equal_runs(ok, a):
    result = ok("compare", a, a)
    assert "4 in A, 4 in B: 0 vanished, 0 appeared, 0 moved" in result.stdout
    assert "segments.csv equal, intersections.csv equal" in result.stdout
    assert result.stderr == ""


def test_compare__runs_that_differ(call, a, b):
    result = call("compare", a, b)
    assert result.exit_code == DIFFERS
    assert "4 in A, 4 in B: 1 vanished, 1 appeared, 1 moved" in result.stdout
    assert "vanished: segments of A 3" in result.stdout
    assert "appeared: segments of B 3" in result.stdout
    assert "moved: segment 0 of A, 0 of B: axis" in result.stdout
    assert "segments.csv differs" in result.stdout
    assert result.stderr.splitlines() == [
        "beamseg: failed: segments.vanished == 0: is 1",
        "beamseg: failed: segments.appeared == 0: is 1",
        "beamseg: failed: segments.moved == 0: is 1",
    ]


def test_compare__tolerances(call, ok, here, a):
    moved = np.add(ENDS, [0.0, 0.0, 0.002])
    write_run(here / "b", moved, radii=0.0505)
    assert call("compare", a, "b").exit_code == DIFFERS
    ok("compare", a, "b", "--tol-offset", 0.003)
    assert call("compare", a, "b", "--tol-offset", 0.003, "--tol-end", 0.001).exit_code == DIFFERS
    strict = ("--tol-offset", 0.003, "--tol-radius", 0.0001)
    assert call("compare", a, "b", *strict).exit_code == DIFFERS


def test_compare__json_for_machines(call, a, b):
    result = call("compare", a, b, "--json")
    document = json.loads(result.stdout)
    assert result.exit_code == DIFFERS
    assert tuple(document["metrics"]) == metric_names(COMPARED)
    assert (document["vanished"], document["appeared"]) == ([3], [3])
    (move,) = document["moved"]
    assert (move["a"], move["b"], move["shapes"]) == (0, 0, None)
    assert move["end"] == pytest.approx(0.002)
    assert document["tolerances"]["offset"] == 0.001
    assert document["tables"] == {"segments.csv": "differs", "intersections.csv": "equal"}
    assert document["metrics"]["time.median_ms.ratio"] is None


def test_compare__junit(call, here, a, b):
    assert call("compare", a, b, "--junit", "compare.xml").exit_code == DIFFERS
    suite = ElementTree.parse(here / "compare.xml").getroot().find("testsuite")
    assert suite.get("failures") == "3"
    failed = [case.get("name") for case in suite if case.find("failure") is not None]
    assert failed == ["segments.vanished == 0", "segments.appeared == 0", "segments.moved == 0"]


def test_compare__a_gate(call, ok, a):
    ok("compare", a, a, "--require", "tables.differing==0")
    result = call("compare", a, a, "--require", "time.wall_s.ratio<=1.5")
    assert result.exit_code == DIFFERS
    assert "time.wall_s.ratio <= 1.5: has no value" in result.stderr


def test_compare__runs_of_the_original_node(ok, refused, here, a):
    old = write_run(here / "old", ENDS, original=True)
    ok("compare", a, old, "--radius", 0.05)
    assert "old/segments.csv: has no column radius" in refused(USAGE, "compare", a, "old")
    assert old.is_dir()


def test_compare__broken_run(refused, here, a):
    (here / "b").mkdir()
    assert refused(FAILED, "compare", a, "b") == "b has no segments.csv"
    (here / "b" / "segments.csv").write_text("segment,a_x,a_y,a_z,b_x,b_y,b_z,t_min,t_max\n1\n")
    reason = refused(FAILED, "compare", a, "b")
    assert "row 1 has 1 values, the header 9; it ends on line 2" in reason


@pytest.mark.parametrize(
    "arguments",
    [
        ["compare"],
        ["compare", "."],
        ["compare", ".", "nowhere"],
        ["compare", ".", ".", "--tol-offset", "-1"],
        ["compare", ".", ".", "--tol-end", "wide"],
        ["compare", ".", ".", "--tol-end", "nan"],
        ["compare", ".", ".", "--tol-joint", "inf"],
    ],
)
def test_compare__usage(call, arguments):
    result = call(*arguments)
    assert result.exit_code == USAGE
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
