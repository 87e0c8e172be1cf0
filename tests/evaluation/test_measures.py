"""A run measured against the truth: each fault shows where it should, and nowhere else."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamseg_batch.evaluation import MEASURES, evaluate, load_truth, metric_names
from beamseg_batch.evaluation.matching import Lines
from beamseg_batch.world.joints import Joint
from tests.evaluation.structures import (
    any_transform,
    moved_result,
    moved_truth,
    noisy,
    own_result,
    result_of,
    scattered,
    swapped,
    truth_of,
)

TRUTHS = Path(__file__).parents[1] / "data" / "truths"
N = 5
ENDS = scattered(N, seed=2)
TRUTH = truth_of(ENDS)
COUNTS = ("matched", "missed", "duplicates", "fragments", "false", "set_aside")


def counts(metrics):
    return tuple(metrics[name] for name in COUNTS)


def metrics_of(ends, truth=TRUTH, **more):
    return evaluate(truth, result_of(ends, **more)).metrics


def across(ends):
    """Unit vectors square to the lines, (n, 3)."""
    directions = ends[:, 1] - ends[:, 0]
    vectors = np.cross(directions, [0.3, -0.5, 0.8])
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def part(ends, start, end):
    """Give the stretch of each line between two shares of its length."""
    span = ends[:, 1] - ends[:, 0]
    return np.stack([ends[:, 0] + start * span, ends[:, 0] + end * span], axis=1)


# The truth as its own result


@pytest.mark.parametrize("name", ["tower", "webots_tests", "scattered"])
def test_evaluate__truth_as_its_own_result_is_perfect(name):
    """Files hold metres with five decimals."""
    truth = TRUTH if name == "scattered" else load_truth(TRUTHS / f"{name}.csv")
    rounding = 1e-9 if name == "scattered" else 1e-5
    metrics = evaluate(truth, own_result(truth)).metrics
    n = len(truth.names)
    assert counts(metrics) == (n, 0, 0, 0, 0, 0)
    assert metrics["recall"] == metrics["precision"] == metrics["shape.right"] == 1.0
    assert metrics["coverage.min"] == pytest.approx(1.0, abs=rounding)
    for measure in ("axis_offset", "own_end_error", "radius_error", "bow_error"):
        assert metrics[f"{measure}.max"] == pytest.approx(0.0, abs=rounding)
    assert metrics["angle_rad.max"] == pytest.approx(0.0, abs=3 * rounding)
    assert metrics["joints.found"] == metrics["joints.truth"] == metrics["joints.claimed"]
    assert metrics["joints.missed"] == metrics["joints.invented"] == 0
    if truth.joints:
        assert metrics["joints.recall"] == metrics["joints.precision"] == 1.0
        assert metrics["joints.error.max"] == 0.0


def test_evaluate__has_every_measure_in_order():
    assert tuple(metrics_of(ENDS)) == metric_names(MEASURES)
    assert tuple(metrics_of([], joints=None)) == metric_names(MEASURES)


# One fault at a time


def test_evaluate__shifted_across():
    metrics = metrics_of(ENDS + 0.005 * across(ENDS)[:, None])
    assert counts(metrics) == (N, 0, 0, 0, 0, 0)
    for name in ("axis_offset", "own_end_error", "midpoint_distance"):
        assert metrics[f"{name}.median"] == pytest.approx(0.005, abs=1e-12)
        assert metrics[f"{name}.max"] == pytest.approx(0.005, abs=1e-12)
    assert metrics["angle_deg.max"] == pytest.approx(0.0, abs=1e-6)


def test_evaluate__shifted_along():
    along = (ENDS[:, 1] - ENDS[:, 0]) / np.linalg.norm(ENDS[:, 1] - ENDS[:, 0], axis=1)[:, None]
    metrics = metrics_of(ENDS + 0.005 * along[:, None])
    assert metrics["axis_offset.max"] == pytest.approx(0.0, abs=1e-12)
    assert metrics["own_end_error.median"] == pytest.approx(0.005, abs=1e-12)
    assert metrics["coverage.min"] == pytest.approx(
        1.0 - 0.005 / np.linalg.norm(ENDS[:, 1] - ENDS[:, 0], axis=1).min(), abs=1e-9
    )


def test_evaluate__tilted_by_a_degree():
    middles, half = ENDS.mean(axis=1), (ENDS[:, 1] - ENDS[:, 0]) / 2.0
    lengths = np.linalg.norm(half, axis=1)
    lean = np.tan(np.radians(1.0)) * lengths[:, None] * across(ENDS)
    metrics = metrics_of(np.stack([middles - half - lean, middles + half + lean], axis=1))
    assert counts(metrics) == (N, 0, 0, 0, 0, 0)
    assert metrics["angle_deg.median"] == pytest.approx(1.0, abs=1e-9)
    assert metrics["angle_deg.max"] == pytest.approx(1.0, abs=1e-9)
    assert metrics["angle_rad.max"] == pytest.approx(np.pi / 180.0)
    # The distance goes from its largest at an end to nothing in the middle, and back.
    assert metrics["axis_offset.max"] == pytest.approx(np.linalg.norm(lean, axis=1).max() / 2.0)
    assert metrics["own_end_error.max"] == pytest.approx(np.linalg.norm(lean, axis=1).max())
    assert metrics["midpoint_distance.max"] == pytest.approx(0.0, abs=1e-12)


def test_evaluate__doubled():
    metrics = metrics_of(np.concatenate([ENDS, ENDS]))
    assert counts(metrics) == (N, 0, N, 0, 0, 0)
    assert (metrics["recall"], metrics["precision"]) == (1.0, 0.5)
    assert metrics["axis_offset.max"] == pytest.approx(0.0, abs=1e-12)


def test_evaluate__cut_in_two():
    """The longer piece is the match, and its new end is as far from the member's."""
    metrics = metrics_of(np.concatenate([part(ENDS, 0.0, 0.4), part(ENDS, 0.4, 1.0)]))
    assert counts(metrics) == (N, 0, 0, N, 0, 0)
    assert metrics["coverage.median"] == pytest.approx(0.6)
    lengths = np.linalg.norm(ENDS[:, 1] - ENDS[:, 0], axis=1)
    assert metrics["own_end_error.max"] == pytest.approx(0.4 * lengths.max())
    assert metrics["own_end_error.count"] == 2 * N
    assert metrics["axis_offset.max"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("end", "verdict"), [(0.798, "fragment"), (0.802, "duplicate")])
def test_evaluate__a_further_segment_overlaps_by_half_or_not(end, verdict):
    """A match from 0.4 to 1 of the member, a further piece of 0.2 of it, to `end` - 0.3."""
    pieces = np.concatenate([part(ENDS[:1], 0.4, 1.0), part(ENDS[:1], end - 0.5, end - 0.3)])
    evaluation = evaluate(truth_of(ENDS[:1]), result_of(pieces))
    assert evaluation.verdicts == ("matched", verdict)
    assert evaluation.nearest == (0, 0)


def test_evaluate__one_missing():
    evaluation = evaluate(TRUTH, result_of(np.delete(ENDS, 3, axis=0)))
    assert counts(evaluation.metrics) == (N - 1, 1, 0, 0, 0, 0)
    assert evaluation.missed == (3,)
    assert evaluation.metrics["recall"] == (N - 1) / N
    assert evaluation.metrics["precision"] == 1.0


def test_evaluate__one_false():
    stray = np.add(ENDS[:1], [0.0, 0.0, 0.3])
    evaluation = evaluate(TRUTH, result_of(np.concatenate([ENDS, stray])))
    assert counts(evaluation.metrics) == (N, 0, 0, 0, 1, 0)
    assert evaluation.verdicts[-1] == "false"
    assert evaluation.metrics["precision"] == N / (N + 1)


def test_evaluate__turned_by_more_than_15_degrees_is_false_and_missed():
    lean = np.tan(np.radians(16.0)) * np.linalg.norm(ENDS[:1, 1] - ENDS[:1, 0]) * across(ENDS[:1])
    turned = ENDS.copy()
    turned[0] += [-lean[0] / 2.0, lean[0] / 2.0]
    assert counts(metrics_of(turned)) == (N - 1, 1, 0, 0, 1, 0)


def test_evaluate__nothing_found():
    metrics = metrics_of([])
    assert counts(metrics) == (0, N, 0, 0, 0, 0)
    assert metrics["recall"] == 0.0
    assert metrics["precision"] is None
    assert metrics["axis_offset.median"] is metrics["joints.error.max"] is None
    assert metrics["coverage.min"] is metrics["own_end_error.p95"] is None


# What was seen


def test_evaluate__members_hardly_seen_do_not_count():
    """Neither as missed, nor do they make their segment false."""
    seen = ENDS.copy()
    seen[0] = part(ENDS[:1], 0.0, 0.29 / np.linalg.norm(ENDS[0, 1] - ENDS[0, 0]))[0]
    seen[1] = np.nan
    truth = truth_of(ENDS, seen)
    without = metrics_of(ENDS[2:], truth)
    assert (without["members"], without["missed"]) == (N - 2, 0)
    assert (without["recall"], without["precision"]) == (1.0, 1.0)
    evaluation = evaluate(truth, result_of(ENDS))
    assert evaluation.verdicts[:2] == ("set aside", "set aside")
    assert counts(evaluation.metrics) == (N - 2, 0, 0, 0, 0, 2)
    assert evaluation.metrics["precision"] == 1.0


def test_evaluate__offset_and_ends_are_those_of_what_was_seen():
    """A segment that bends away where nobody looked is no worse for it."""
    member = np.array([[[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]]])
    seen = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]])
    segment = np.array([[[0.0, 0.0, 0.0], [4.0, 0.04, 0.0]]])
    metrics = metrics_of(segment, truth_of(member, seen))
    assert metrics["axis_offset.max"] == pytest.approx(0.005, abs=1e-12)
    assert metrics["own_end_error.count"] == metrics["cut_end_error.count"] == 1
    assert metrics["own_end_error.max"] == 0.0
    assert metrics["cut_end_error.max"] == pytest.approx(np.hypot(3.0, 0.04))
    assert metrics["midpoint_distance.max"] == pytest.approx(0.02)


@pytest.mark.parametrize(("gap", "own"), [(0.029, 2), (0.031, 1)])
def test_evaluate__an_end_is_the_members_own_within_3_cm(gap, own):
    member = np.array([[[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]])
    seen = np.array([[[gap, 0.0, 0.0], [2.0, 0.0, 0.0]]])
    metrics = metrics_of(member, truth_of(member, seen))
    assert metrics["own_end_error.count"] == own
    assert metrics["cut_end_error.count"] == 2 - own


# Parallel members


def test_evaluate__two_segments_on_one_of_two_parallel_members():
    """The neighbour 0.12 m away stays missed: the other member is more than 5 cm nearer."""
    pair = np.concatenate([ENDS[:1], ENDS[:1] + 0.12 * across(ENDS[:1])[:, None]])
    evaluation = evaluate(truth_of(pair), result_of(np.concatenate([pair[:1], pair[:1]])))
    assert counts(evaluation.metrics) == (1, 1, 1, 0, 0, 0)
    assert evaluation.missed == (1,)


def test_evaluate__two_parallel_members_closer_than_the_errors():
    """Both segments lie nearer to the first member: one to one, each still has its own."""
    shift = across(ENDS[:1])[:, None]
    pair = np.concatenate([ENDS[:1], ENDS[:1] + 0.04 * shift])
    segments = np.concatenate([ENDS[:1] + 0.015 * shift, ENDS[:1] - 0.005 * shift])
    evaluation = evaluate(truth_of(pair), result_of(segments))
    assert [(match.member, match.segment) for match in evaluation.matches] == [(0, 1), (1, 0)]


# Radius, section, bow


def test_evaluate__radii():
    truth = truth_of(ENDS, radii=[0.05, 0.05, 0.03, 0.1, 0.1])
    metrics = metrics_of(ENDS, truth, radii=[0.051, 0.05, 0.045, 0.1, 0.08])
    assert metrics["radius_error.median"] == pytest.approx(0.001)
    assert metrics["radius_error.max"] == pytest.approx(0.02)
    assert metrics["radius_class.right"] == pytest.approx(4 / 5)


def test_evaluate__radius_of_round_members_only():
    truth = truth_of(ENDS, shapes=["i", "round", "i", "l", "c"])
    assert metrics_of(ENDS, truth, radii=0.07)["radius_error.max"] == pytest.approx(0.02)
    none_round = truth_of(ENDS, shapes=["i"] * N)
    metrics = metrics_of(ENDS, none_round, radii=0.07)
    assert metrics["radius_error.max"] is metrics["radius_class.right"] is None


def test_evaluate__shapes():
    truth = truth_of(ENDS, shapes=["i", "i", "l", "round", "round"])
    claimed = ("i", "c", "l", "round", "unknown")
    evaluation = evaluate(truth, result_of(ENDS, shapes=claimed))
    assert evaluation.shapes == {
        "i": {"i": 1, "c": 1},
        "l": {"l": 1},
        "round": {"round": 1, "unknown": 1},
    }
    assert evaluation.metrics["shape.right"] == pytest.approx(3 / 5)
    assert metrics_of(ENDS, truth)["shape.right"] is None


def test_evaluate__bow():
    truth = truth_of(ENDS, bows=[0.0, 0.01, 0.02, 0.05, 0.0])
    metrics = metrics_of(ENDS, truth, bows=np.array([0.001, 0.01, 0.015, 0.053, 0.0]))
    assert metrics["bow_error.median"] == pytest.approx(0.001)
    assert metrics["bow_error.max"] == pytest.approx(0.005)
    assert metrics_of(ENDS, truth)["bow_error.max"] is None


# Joints

CORNERS = [np.array([k, 0.0, 0.0]) for k in range(4)]


def truth_with_joints():
    """A rail, and a rung at each of four corners; the last rung is not seen."""
    rails = [[[-1.0, 0.0, 0.0], [4.0, 0.0, 0.0]]]
    rungs = [[[k, 0.0, 0.0], [k, 1.0, 0.0]] for k in range(4)]
    ends = np.array(rails + rungs, dtype=float)
    seen = ends.copy()
    seen[4] = np.nan
    joints = [Joint(corner, (0, k + 1)) for k, corner in enumerate(CORNERS)]
    return truth_of(ends, seen, joints=joints)


@pytest.mark.parametrize(
    ("claimed", "figures"),
    [
        ([0, 1, 2], (3, 3, 0, 0, 0)),
        ([0, 1], (2, 2, 1, 0, 0)),
        ([0, 1, 2, 3], (3, 3, 0, 0, 1)),
        ([0, 0, 1, 2], (4, 3, 0, 1, 0)),
        ([0, 1, 2, 7], (4, 3, 0, 1, 0)),
        ([], (0, 0, 3, 0, 0)),
    ],
)
def test_evaluate__joints(claimed, figures):
    """Claimed, found, missed, invented, set aside."""
    places = [[k, 0.0, 0.03] for k in claimed]
    metrics = metrics_of(ENDS, truth_with_joints(), joints=places)
    assert metrics["joints.truth"] == 3
    names = ("claimed", "found", "missed", "invented", "set_aside")
    assert tuple(metrics[f"joints.{name}"] for name in names) == figures
    assert metrics["joints.recall"] == pytest.approx(figures[1] / 3)
    if figures[1]:
        assert metrics["joints.error.max"] == pytest.approx(0.03)


def test_evaluate__joints_are_named_by_their_place_in_the_truth():
    """The joint that does not count comes first here."""
    truth = truth_with_joints()
    truth = dataclasses.replace(truth, joints=truth.joints[::-1])
    joints = evaluate(truth, result_of(ENDS, joints=[[1.0, 0.0, 0.0], [8.0, 0.0, 0.0]])).joints
    assert joints.pairs.tolist() == [[2, 0]]
    assert joints.missed == (1, 3)
    assert joints.invented == (1,)


@pytest.mark.parametrize(("distance", "found"), [(0.0999, 1), (0.1001, 0)])
def test_evaluate__a_joint_is_found_within_10_cm(distance, found):
    metrics = metrics_of(ENDS, truth_with_joints(), joints=[[0.0, -distance, 0.0]])
    assert metrics["joints.found"] == found
    assert metrics["joints.invented"] == 1 - found


def test_evaluate__joints_are_paired_one_to_one():
    """One claimed joint between two true ones, and another beside the first, are both found."""
    joints = [Joint(np.array([x, 0.0, 0.0]), (0, 1)) for x in (0.0, 0.15)]
    ends = [[[-1, 0, 0], [1, 0, 0]], [[0, 0, 0], [0, 1, 0]]]
    truth = truth_of(ends, joints=joints)
    metrics = metrics_of(ENDS, truth, joints=[[0.07, 0, 0], [-0.09, 0, 0]])
    assert metrics["joints.found"] == 2
    assert metrics["joints.error.max"] == pytest.approx(0.09)


def test_evaluate__a_run_without_word_of_joints():
    evaluation = evaluate(truth_with_joints(), result_of(ENDS, joints=None))
    assert evaluation.joints is None
    assert evaluation.metrics["joints.truth"] == 3
    assert evaluation.metrics["joints.found"] is evaluation.metrics["joints.invented"] is None


# Honesty


def test_evaluate__sigmas_are_held_against_true_errors():
    """Each error is 5 mm or 1 degree; two in five of the sigmas claim less than half of it."""
    spans = ENDS[:, 1] - ENDS[:, 0]
    lengths = np.linalg.norm(spans, axis=1)[:, None]
    lean = np.tan(np.radians(1.0)) * lengths / 2.0 * across(ENDS)
    aside = 0.005 * np.cross(across(ENDS), spans / lengths)
    segments = ENDS + aside[:, None] + np.stack([-lean, lean], axis=1)
    small, large = 0.49, 0.51
    shares = np.array([small, small, large, large, large])
    sigmas = {"offset": 0.005 * shares, "angle_deg": shares, "radius": 0.002 * shares}
    metrics = metrics_of(segments, radii=0.052, sigmas=sigmas)
    assert metrics["honesty.offset"] == pytest.approx(3 / 5)
    assert metrics["honesty.angle"] == pytest.approx(3 / 5)
    assert metrics["honesty.radius"] == pytest.approx(3 / 5)
    assert metrics["honesty.ends"] is None


def test_evaluate__sigmas_of_bows():
    truth = truth_of(ENDS, bows=0.02)
    bows, sigmas = np.array([0.021] * 5), {"bow": np.array([0.0006, 0.0004, 0.001, 0.0001, np.nan])}
    metrics = metrics_of(ENDS, truth, bows=bows, sigmas=sigmas)
    assert metrics["honesty.bow"] == pytest.approx(2 / 4)


def test_evaluate__sigmas_of_ends_are_along_the_axis_and_of_own_ends():
    member = np.array([[[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]])
    seen = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]])
    segment = np.array([[[2.0, 0.02, 0.0], [0.01, 0.02, 0.0]]])  # the other way round
    truth, many = truth_of(member, seen), {"end_1": np.array([0.0]), "end_2": np.array([0.006])}
    assert metrics_of(segment, truth, sigmas=many)["honesty.ends"] == 1.0
    few = {"end_1": np.array([9.0]), "end_2": np.array([0.004])}
    assert metrics_of(segment, truth, sigmas=few)["honesty.ends"] == 0.0


def test_evaluate__sigmas_that_are_not_claimed():
    sigmas = {"offset": np.array([1.0, np.nan, np.nan, np.nan, np.nan])}
    assert metrics_of(ENDS, sigmas=sigmas)["honesty.offset"] == 1.0
    assert metrics_of(ENDS)["honesty.offset"] is None


# What must not matter


def random_case(seed):
    """A truth, part of it seen, and a result with a bit of everything."""
    rng = np.random.default_rng(seed)
    ends = scattered(6, seed)
    truth = truth_of(ends, part(ends, rng.uniform(0, 0.3), 1.0))
    segments = [noisy(ends, seed), noisy(ends[:2], seed + 1), part(ends[2:4], 0.0, 0.3)]
    segments += [np.add(ends[:1], [0.0, 0.4, 0.0])]
    joints = ends[:3, 0] + rng.uniform(-0.05, 0.05, (3, 3))
    true = tuple(Joint(ends[k, 0], (k, k + 1)) for k in range(4))
    result = result_of(np.concatenate(segments), joints=joints)
    return dataclasses.replace(truth, joints=true), result


def assert_same(one, other):
    for name, value in one.metrics.items():
        if value is None:
            assert other.metrics[name] is None
        else:
            assert other.metrics[name] == pytest.approx(value, rel=1e-6, abs=1e-6), name


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_evaluate__swapped_ends_change_nothing(seed):
    truth, result = random_case(seed)
    which = np.random.default_rng(seed).integers(0, 2, len(result.axes)).astype(bool)
    other = dataclasses.replace(result, axes=swapped(result.axes, which))
    assert_same(evaluate(truth, result), evaluate(truth, other))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_evaluate__order_of_rows_changes_nothing(seed):
    truth, result = random_case(seed)
    order = np.random.default_rng(seed).permutation(len(result.axes))
    axes = result.axes
    permuted = Lines(axes.starts[order], axes.directions[order], axes.lengths[order])
    other = dataclasses.replace(result, axes=permuted, joints=result.joints[::-1])
    one, two = evaluate(truth, result), evaluate(truth, other)
    assert_same(one, two)
    assert [one.verdicts[k] for k in order] == list(two.verdicts)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_evaluate__moving_truth_and_result_together_changes_nothing(seed):
    truth, result = random_case(seed)
    transform = any_transform(seed)
    other = evaluate(moved_truth(truth, transform), moved_result(result, transform))
    assert_same(evaluate(truth, result), other)
    assert evaluate(truth, result).verdicts == other.verdicts


def test_evaluate__own_ends_are_also_measured_to_where_the_member_ends():
    """The seen end lies 2 cm within the member's; the segment's between the two."""
    member = np.array([[[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]])
    seen = np.array([[[0.02, 0.0, 0.0], [1.5, 0.0, 0.0]]])
    segment = np.array([[[0.005, 0.0, 0.0], [1.5, 0.0, 0.0]]])
    sigmas = {"end_1": np.array([0.004]), "end_2": np.array([0.004])}
    metrics = metrics_of(segment, truth_of(member, seen), sigmas=sigmas)
    assert metrics["own_end_error.count"] == 1
    assert metrics["own_end_error.max"] == pytest.approx(0.015)
    assert metrics["member_end_error.max"] == pytest.approx(0.005)
    assert metrics["honesty.ends"] == 0.0
    assert metrics["honesty.member_ends"] == 1.0
