"""The three similarity solutions of the report's section 3.2.6 against plain formulas."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.config import FilteringConfig, StructureConfig, ThresholdConfig
from beamseg_batch.structure.arrays import SegmentArrays
from beamseg_batch.structure.similarity import (
    midpoint_scores,
    parameter_scores,
    projection_scores,
    reverse_projection_scores,
    similarity_by,
)
from tests import naive
from tests.structure.segments import DIAG_VOXEL, EPSILON, between, jittered, random_segment, turned

LIMITS = ThresholdConfig()


def pairs(seed, count=300):
    """Pairs of segments, from the same beam to far apart."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        known = random_segment(rng)
        yield known, jittered(known, rng, rng.choice([0.001, 0.03, 0.1, 0.2]))


def decisions(similar, scores, seed):
    """What the twin and the scores say of many pairs."""
    wanted, got = [], []
    for known, new in pairs(seed):
        wanted.append(bool(similar(known, new)))
        got.append(bool(scores(new, SegmentArrays([known]))[0] <= 1.0))
    assert 20 < sum(wanted) < len(wanted) - 20, "both answers must occur"
    return wanted, got


@pytest.mark.parametrize("seed", [1, 2])
def test_projection_scores__agree_with_twin(seed):
    wanted, got = decisions(
        lambda known, new: naive.similar_by_projection(known, new, DIAG_VOXEL),
        lambda new, known: projection_scores(new, known, LIMITS, DIAG_VOXEL),
        seed,
    )
    assert wanted == got


@pytest.mark.parametrize("seed", [1, 2])
def test_midpoint_scores__agree_with_twin(seed):
    wanted, got = decisions(
        lambda known, new: naive.similar_by_midpoint(known, new, LIMITS.T_d, LIMITS.T_p),
        lambda new, known: midpoint_scores(new, known, LIMITS),
        seed,
    )
    assert wanted == got


@pytest.mark.parametrize("seed", [1, 2])
def test_parameter_scores__agree_with_twin(seed):
    wide = ThresholdConfig(T_a=0.8, T_b=0.3, T_p=0.3)
    wanted, got = decisions(
        lambda known, new: naive.similar_by_parameters(known, new, 0.8, 0.3, 0.3),
        lambda new, known: parameter_scores(new, known, wide),
        seed,
    )
    assert wanted == got


def test_projection_scores__epsilon_is_two_diagonals_and_both_radii():
    """Fault of the original: it used 4 diag_voxel + r1 + r2."""
    assert pytest.approx(2 * np.sqrt(3) * (0.05 / 1.5) + 0.05 + 0.05) == EPSILON
    known = SegmentArrays([between([0, 0, 0], [2, 0, 0])])
    scores = similarity_by(StructureConfig(), FilteringConfig()).scores
    for away, similar in ((0.99, True), (1.01, False), (1.5, False)):
        new = between([0.5, away * EPSILON, 0], [1.5, away * EPSILON, 0])
        assert scores(new, known)[0] == pytest.approx(away)
        assert bool(scores(new, known)[0] <= 1.0) is similar


def test_projection_scores__the_further_end_counts():
    known = SegmentArrays([between([0, 0, 0], [2, 0, 0])])
    new = between([0.5, 0, 0], [1.5, 0, 2 * EPSILON])
    for one in (new, turned(new)):
        assert projection_scores(one, known, LIMITS, DIAG_VOXEL)[0] == pytest.approx(2.0)


def test_projection_scores__other_radius_is_never_similar():
    known = SegmentArrays([between([0, 0, 0], [2, 0, 0], radius=0.1)])
    assert projection_scores(between([0, 0, 0], [2, 0, 0]), known, LIMITS, DIAG_VOXEL)[0] == np.inf


def test_projection_scores__epsilon_can_be_set():
    known = SegmentArrays([between([0, 0, 0], [2, 0, 0])])
    new = between([0.5, 0.03, 0], [1.5, 0.03, 0])
    limits = ThresholdConfig(epsilon=0.02)
    assert projection_scores(new, known, limits, DIAG_VOXEL)[0] == pytest.approx(1.5)


@pytest.mark.parametrize("similarity", ["parameters", "midpoint", "projection"])
def test_similarity_by__direction_has_no_sign(similarity):
    scores = similarity_by(StructureConfig(similarity=similarity), FilteringConfig()).scores
    rng = np.random.default_rng(3)
    for _ in range(20):
        known, new = random_segment(rng), random_segment(rng)
        plain = scores(new, SegmentArrays([known]))
        np.testing.assert_allclose(scores(turned(new), SegmentArrays([known])), plain, rtol=1e-9)
        np.testing.assert_allclose(scores(new, SegmentArrays([turned(known)])), plain, rtol=1e-9)


@pytest.mark.parametrize("similarity", ["parameters", "midpoint", "projection"])
def test_similarity_by__scores_many_as_it_scores_one(similarity):
    scores = similarity_by(StructureConfig(similarity=similarity), FilteringConfig()).scores
    rng = np.random.default_rng(4)
    known = [random_segment(rng) for _ in range(40)]
    new = jittered(known[7], rng, 0.01)
    together = scores(new, SegmentArrays(known))
    alone = [scores(new, SegmentArrays([segment]))[0] for segment in known]
    np.testing.assert_allclose(together, alone, rtol=1e-12)
    assert int(np.argmin(together)) == 7 or similarity == "parameters"


@pytest.mark.parametrize("similarity", ["parameters", "midpoint", "projection"])
def test_similarity_by__reverse_scores_swap_the_two(similarity):
    both = similarity_by(StructureConfig(similarity=similarity), FilteringConfig())
    rng = np.random.default_rng(6)
    known = [random_segment(rng) for _ in range(30)]
    one = jittered(known[3], rng, 0.05)
    expected = [both.scores(other, SegmentArrays([one]))[0] for other in known]
    np.testing.assert_allclose(both.reverse_scores(one, SegmentArrays(known)), expected, rtol=1e-9)


def test_reverse_projection_scores__short_segment_on_a_long_axis():
    long, short = between([0, 0, 0], [4, 0, 0]), between([0.2, 0, -0.02], [0.6, 0, 0.03])
    known = SegmentArrays([short])
    assert projection_scores(long, known, LIMITS, DIAG_VOXEL)[0] > 1.0
    assert reverse_projection_scores(long, known, LIMITS, DIAG_VOXEL)[0] == pytest.approx(
        0.03 / EPSILON
    )


# --- the arrays beside the list -------------------------------------------------------


def test_segment_arrays__follow_the_list_through_any_change():
    rng = np.random.default_rng(5)
    segments, arrays = [], SegmentArrays()
    for _ in range(300):
        change = rng.choice(["append", "append", "replace", "delete"])
        if change == "append" or not segments:
            segments.append(random_segment(rng))
            arrays.append(segments[-1])
        elif change == "replace":
            index = int(rng.integers(len(segments)))
            segments[index] = random_segment(rng)
            arrays.replace(index, segments[index])
        else:
            index = int(rng.integers(len(segments)))
            del segments[index]
            arrays.delete(index)
    assert len(arrays) == len(segments) > 20
    assert np.array_equal(arrays.anchors, [s.anchor for s in segments])
    assert np.array_equal(arrays.directions, [s.direction for s in segments])
    np.testing.assert_allclose(arrays.midpoints, [s.midpoint for s in segments], atol=1e-14)
    assert np.array_equal(arrays.t_min, [s.t_min for s in segments])
    assert np.array_equal(arrays.t_max, [s.t_max for s in segments])
    assert np.array_equal(arrays.radii, [s.radius for s in segments])


def test_segment_arrays__empty():
    arrays = SegmentArrays()
    assert len(arrays) == 0
    for similarity in ("parameters", "midpoint", "projection"):
        both = similarity_by(StructureConfig(similarity=similarity), FilteringConfig())
        new = between([0, 0, 0], [1, 0, 0])
        assert both.scores(new, arrays).shape == both.reverse_scores(new, arrays).shape == (0,)
