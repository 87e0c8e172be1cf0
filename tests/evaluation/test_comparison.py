"""A run held against another run."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamseg_batch.errors import RunError
from beamseg_batch.evaluation import COMPARED, Tolerances, compare, metric_names
from tests.evaluation.structures import noisy, scattered, write_run

ENDS = scattered(5, seed=8)
CROSS = np.array([[[-1, 0, 0], [1, 0, 0]], [[0, -1, 0], [0, 1, 0]], [[0, 0, 0], [0, 0, 3]]], float)
ALL_MEET = "0,1.0,1,1.0\n0,1.0,2,0.0\n1,1.0,2,0.0\n"
TOLERANCES = Tolerances()


@pytest.fixture
def both(tmp_path):
    """Compare two runs that are given as the arguments of `write_run`."""

    def compared(a, b, tolerances=TOLERANCES):
        folders = [
            write_run(tmp_path / name, *run[:1], **(run[1] if len(run) > 1 else {}))
            for name, run in (("a", a), ("b", b))
        ]
        return compare(*folders, tolerances)

    return compared


def differing(comparison):
    return {check.name.partition(" ")[0] for check in comparison.checks() if not check.passed}


def test_compare__has_every_figure_in_order(both):
    assert tuple(both((ENDS,), (ENDS,)).metrics) == metric_names(COMPARED)


def test_compare__equal_runs(both):
    comparison = both((CROSS, {"intersections": ALL_MEET}), (CROSS, {"intersections": ALL_MEET}))
    assert differing(comparison) == set()
    assert comparison.tables == {"segments.csv": "equal", "intersections.csv": "equal"}
    assert comparison.metrics["tables.differing"] == 0
    assert comparison.metrics["joints.a"] == comparison.metrics["joints.b"] == 1
    for name in ("offset", "angle_deg", "end", "radius", "joint"):
        assert comparison.metrics[f"{name}.max"] == 0.0


def test_compare__duplicates_and_pieces_are_paired_with_themselves(both):
    pieces = 0.8 * ENDS + 0.2 * ENDS[:, ::-1]
    ends = np.concatenate([ENDS, ENDS[:2], pieces])
    order = np.random.default_rng(1).permutation(len(ends))
    comparison = both((ends,), (ends[order],))
    assert differing(comparison) == set()
    assert comparison.metrics["end.max"] == pytest.approx(0.0, abs=1e-9)


def test_compare__a_segment_without_length_is_itself(tmp_path):
    header = "segment,a_x,a_y,a_z,b_x,b_y,b_z,t_min,t_max,radius"
    for name in "ab":
        (tmp_path / name).mkdir()
        (tmp_path / name / "segments.csv").write_text(f"{header}\n0,1,2,3,0,0,1,2,2,0.05\n")
    comparison = compare(tmp_path / "a", tmp_path / "b", TOLERANCES)
    assert len(comparison.moves) == 1
    assert differing(comparison) == set()


def test_compare__vanished_and_appeared(both):
    comparison = both((ENDS[:4],), (ENDS[2:],))
    assert comparison.vanished == (0, 1)
    assert comparison.appeared == (2,)
    assert differing(comparison) == {"segments.vanished", "segments.appeared"}
    assert comparison.tables["segments.csv"] == "differs"


def test_compare__empty_runs(both):
    comparison = both(([],), ([],))
    assert differing(comparison) == set()
    assert comparison.metrics["offset.max"] is None
    assert both((ENDS,), ([],)).vanished == (0, 1, 2, 3, 4)


@pytest.mark.parametrize(
    ("name", "tolerance"),
    [("offset", 0.003), ("angle_deg", 0.3), ("end", 0.02), ("radius", 0.004)],
)
@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_compare__moved_by_more_than_a_tolerance(both, name, tolerance, factor):
    """One segment moves in one way; all other tolerances are wide."""
    ends, amount = np.array([[[0, 0, 0], [2, 0, 0]], [[0, 9, 0], [2, 9, 0]]], float), {}
    moved = ends.copy()
    if name == "offset":
        moved[0, :, 2] += tolerance * factor
    elif name == "angle_deg":
        moved[0, 1, 2] += 2.0 * np.tan(np.radians(tolerance * factor))
    elif name == "end":
        moved[0, 1, 0] += tolerance * factor
    else:
        amount = {"radii": [0.05 + tolerance * factor, 0.05]}
    wide = {"offset": 9.0, "angle_deg": 9.0, "end": 9.0, "radius": 9.0, "joint": 9.0}
    comparison = both((ends,), (moved, amount), Tolerances(**(wide | {name: tolerance})))
    assert comparison.metrics[f"{name}.max"] == pytest.approx(tolerance * factor, rel=1e-3)
    assert [move.a for move in comparison.moved] == ([0] if factor > 1.0 else [])
    assert differing(comparison) == ({"segments.moved"} if factor > 1.0 else set())


def test_compare__ends_the_other_way_round_have_not_moved(both):
    comparison = both((ENDS,), (ENDS[:, ::-1],))
    assert differing(comparison) == set()
    assert comparison.metrics["end.max"] == pytest.approx(0.0, abs=1e-9)


def test_compare__another_shape_is_a_move(both):
    comparison = both((ENDS[:1],), (ENDS[:1], {"shape": ["square"]}))
    assert comparison.moved[0].shapes == ("round", "square")
    assert differing(comparison) == {"segments.moved"}


def test_compare__intersections_follow_their_segments(both):
    """The same three segments in another order, of which two no longer touch."""
    order = [2, 0, 1]
    comparison = both(
        (CROSS, {"intersections": ALL_MEET}),
        (CROSS[order], {"intersections": "1,1.0,2,1.0\n0,0.0,1,1.0\n"}),
    )
    assert comparison.touching_vanished == ((1, 2),)
    assert comparison.touching_appeared == ()
    assert differing(comparison) == {"intersections.vanished"}


def test_compare__joints(both):
    more = {"intersections": "0,1.0,1,1.0\n"}
    apart = CROSS[1] + [[0.03, 0.0, 0.0], [0.03, 0.0, 0.0]]
    ends = np.array([CROSS[0], apart])
    moved = both((CROSS[:2], more), (ends, {"intersections": "0,1.03,1,1.0"}))
    assert moved.metrics["joints.moved"] == 1
    assert moved.metrics["joint.max"] == pytest.approx(0.03)
    gone = both((CROSS[:2], more), (CROSS[:2], {"intersections": ""}))
    assert gone.joints_vanished == (0,)
    assert differing(gone) == {"intersections.vanished", "joints.vanished"}


def test_compare__a_table_that_one_run_lacks(both):
    comparison = both((CROSS, {"intersections": ""}), (CROSS, {"intersections": None}))
    assert comparison.tables["intersections.csv"] == "only in A"
    assert comparison.metrics["intersections.b"] is None
    assert differing(comparison) == set()


def test_compare__bytes_differ_though_nothing_has_moved(both):
    comparison = both((ENDS,), (ENDS + 1e-9,))
    assert comparison.tables["segments.csv"] == "differs"
    assert differing(comparison) == set()


def test_compare__times(tmp_path):
    for name, scan_us, wall_s in (("a", 2000, 4.0), ("b", 3000, 5.0)):
        folder = write_run(tmp_path / name, ENDS)
        (folder / "processing_time.csv").write_text(f"wall_time,processing_time\n9000,{scan_us}\n")
        (folder / "summary.json").write_text(f'{{"totals": {{"wall_s": {wall_s}}}}}')
    metrics = compare(tmp_path / "a", tmp_path / "b", TOLERANCES).metrics
    assert (metrics["time.median_ms.a"], metrics["time.median_ms.b"]) == (2.0, 3.0)
    assert metrics["time.median_ms.ratio"] == pytest.approx(1.5)
    assert metrics["time.wall_s.ratio"] == pytest.approx(1.25)


def test_compare__a_folder_without_a_run(tmp_path):
    write_run(tmp_path / "a", ENDS)
    with pytest.raises(RunError, match=r"is no folder with a segments\.csv"):
        compare(tmp_path / "a", tmp_path / "b", TOLERANCES)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_compare__the_other_way_round(tmp_path_factory, seed):
    """What vanished from A to B appeared from B to A; every distance is the same."""
    folder = tmp_path_factory.mktemp("runs")
    rng = np.random.default_rng(seed)
    a = scattered(5, seed)
    b = noisy(a, seed, 0.002)[rng.permutation(5)[:4]]
    runs = [write_run(folder / name, ends) for name, ends in (("a", a), ("b", b))]
    there, back = compare(*runs, TOLERANCES), compare(*runs[::-1], TOLERANCES)
    assert there.vanished == back.appeared
    assert len(there.moves) == len(back.moves) == 4
    for one in there.moves:
        other = next(move for move in back.moves if move.b == one.a)
        assert other.end == pytest.approx(one.end)
        assert other.angle_deg == pytest.approx(one.angle_deg)
        assert other.offset == pytest.approx(one.offset, rel=0.05, abs=1e-6)
