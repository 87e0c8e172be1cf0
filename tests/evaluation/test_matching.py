"""Which claimed line is which true one."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.evaluation.matching import (
    Lines,
    PairMeasures,
    assign,
    assignment_cost,
    candidates,
    pair_measures,
)
from tests.evaluation import naive
from tests.evaluation.structures import scattered

ALONG_X = np.array([[[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]])


def lines_of(ends):
    ends = np.asarray(ends, dtype=np.float64)
    return Lines.between(ends[:, 0], ends[:, 1])


def measured(member, segment, span=None):
    members, segments = lines_of([member]), lines_of([segment])
    spans = members.whole if span is None else np.array([span])
    return pair_measures(members, spans, segments)


# The measures


@pytest.mark.parametrize("seed", range(12))
def test_pair_measures__slow_twin(seed):
    rng = np.random.default_rng(seed)
    member = rng.uniform(-1, 1, (2, 3))
    length = np.linalg.norm(member[1] - member[0])
    span = np.sort(rng.uniform(0, length, 2))
    segment = member + rng.normal(0, 0.3 * length, (2, 3))
    found = measured(member, segment, span)
    offset, middle, angle, overlap = naive.measure(member, span, segment)
    assert found.offset[0, 0] == pytest.approx(offset, rel=2e-3, abs=1e-4)
    assert found.mid_offset[0, 0] == pytest.approx(middle, rel=2e-3, abs=1e-3)
    assert found.angle_deg[0, 0] == pytest.approx(angle, abs=1e-5)
    assert found.overlap[0, 0] == pytest.approx(overlap, abs=1e-3)
    shorter = min(span[1] - span[0], np.linalg.norm(segment[1] - segment[0]))
    assert found.share[0, 0] == pytest.approx(min(overlap / shorter, 1.0), abs=2e-3)
    assert found.coverage[0, 0] == pytest.approx(overlap / (span[1] - span[0]), abs=2e-3)


def test_pair_measures__parallel_shift_is_exact():
    found = measured(ALONG_X[0], ALONG_X[0] + [0.5, 0.003, 0.004])
    assert found.offset[0, 0] == pytest.approx(0.005, abs=1e-15)
    assert found.mid_offset[0, 0] == pytest.approx(0.005, abs=1e-15)
    assert found.overlap[0, 0] == pytest.approx(1.5)
    assert found.share[0, 0] == found.coverage[0, 0] == pytest.approx(0.75)


def test_pair_measures__crossing_in_the_middle_is_half_of_the_end():
    """The distance goes to zero and back: its mean is no mean of the two ends."""
    tilted = np.array([[0.0, -0.01, 0.0], [2.0, 0.01, 0.0]])
    assert measured(ALONG_X[0], tilted).offset[0, 0] == pytest.approx(0.005, abs=1e-12)


@pytest.mark.parametrize("tilt", [1e-12, 1e-9, 1e-7, 1e-6, 1e-4])
def test_pair_measures__hardly_tilted(tilt):
    segment = ALONG_X[0] + [[0.0, 0.1, -tilt], [0.0, 0.1, tilt]]
    assert measured(ALONG_X[0], segment).offset[0, 0] == pytest.approx(0.1, abs=1e-7)


def test_pair_measures__side_by_side_nowhere():
    found = measured(ALONG_X[0], ALONG_X[0] + [3.0, 0.0, 0.0])
    assert found.offset[0, 0] == np.inf
    assert found.overlap[0, 0] == found.share[0, 0] == 0.0


def test_pair_measures__square_to_one_another():
    found = measured(ALONG_X[0], [[1.0, 0.02, 0.0], [1.0, 0.02, 1.0]])
    assert found.angle_deg[0, 0] == pytest.approx(90.0)
    assert found.overlap[0, 0] == pytest.approx(0.0, abs=1e-9)
    assert np.isfinite(found.offset[0, 0])


@pytest.mark.parametrize(("x", "share"), [(1.0, 1.0), (3.0, 0.0)])
def test_pair_measures__a_segment_without_length(x, share):
    point = Lines(np.array([[x, 0.01, 0.0]]), np.array([[1.0, 0.0, 0.0]]), np.zeros(1))
    members = lines_of(ALONG_X)
    found = pair_measures(members, members.whole, point)
    assert found.share[0, 0] == share
    assert found.coverage[0, 0] == 0.0


@pytest.mark.parametrize(("n", "m"), [(0, 3), (3, 0), (0, 0)])
def test_pair_measures__nothing(n, m):
    some = [
        lines_of(scattered(k)) if k else Lines(*np.zeros((2, 0, 3)), np.zeros(0)) for k in (n, m)
    ]
    found = pair_measures(some[0], some[0].whole, some[1])
    assert found.offset.shape == candidates(found).shape == (n, m)
    assert len(assign(assignment_cost(found), candidates(found))) == 0


# The candidates


def measures_of(offset, angle=0.0, share=1.0):
    offset = np.atleast_2d(np.asarray(offset, dtype=np.float64))
    fill = [np.full_like(offset, value) for value in (angle, 1.0, share, 1.0)]
    return PairMeasures(offset, offset, fill[0], fill[1], fill[2], fill[3])


@pytest.mark.parametrize(
    ("offset", "angle", "share", "may"),
    [
        (0.150, 15.0, 0.30, True),
        (0.151, 0.0, 1.0, False),
        (0.0, 15.1, 1.0, False),
        (0.0, 0.0, 0.29, False),
    ],
)
def test_candidates__limits(offset, angle, share, may):
    assert candidates(measures_of(offset, angle, share))[0, 0] == may


@pytest.mark.parametrize(("nearer", "may"), [(0.01, True), (0.0499, True), (0.0501, False)])
def test_candidates__another_member_nearer(nearer, may):
    allowed = candidates(measures_of([[0.06], [0.06 - nearer]]))
    assert allowed[:, 0].tolist() == [may, True]


def test_candidates__a_member_that_crosses_is_not_nearer():
    """Its mean distance over the few centimetres side by side is small, its angle is not."""
    across = [[1.0, -1.0, 0.0], [1.0, 1.0, 0.0]]
    members = lines_of([ALONG_X[0], across])
    segment = lines_of([ALONG_X[0] + [0.0, 0.0, 0.1]])
    allowed = candidates(pair_measures(members, members.whole, segment))
    assert allowed[:, 0].tolist() == [True, False]


# The assignment


@pytest.mark.parametrize("seed", range(40))
def test_assign__slow_twin(seed):
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 5, 2))
    cost = rng.uniform(0, 1, shape)
    allowed = rng.uniform(0, 1, shape) < rng.uniform(0.2, 1.0)
    pairs = assign(np.where(allowed, cost, np.inf), allowed)
    assert len(np.unique(pairs[:, 0])) == len(np.unique(pairs[:, 1])) == len(pairs)
    assert allowed[pairs[:, 0], pairs[:, 1]].all()
    number, total = naive.assign(cost, allowed)
    assert len(pairs) == number
    assert cost[pairs[:, 0], pairs[:, 1]].sum() == pytest.approx(total)


def test_assign__rather_two_pairs_than_the_nearest_one():
    cost = np.array([[0.0, 0.1], [0.1, np.inf]])
    pairs = assign(cost, np.isfinite(cost))
    assert pairs.tolist() == [[0, 1], [1, 0]]


def test_assign__a_hidden_permutation_of_many():
    rng = np.random.default_rng(4)
    order = rng.permutation(150)
    cost = rng.uniform(0.5, 1.0, (150, 150))
    cost[np.arange(150), order] = 0.1
    assert assign(cost, np.ones_like(cost, dtype=bool))[:, 1].tolist() == order.tolist()


def test_assignment_cost__prefers_the_long_piece():
    """The short piece lies a millimetre nearer, and covers a fifth of what the long one does."""
    pieces = lines_of([[[0, 0.005, 0], [1.5, 0.005, 0]], [[1.6, 0.004, 0], [1.9, 0.004, 0]]])
    members = lines_of(ALONG_X)
    found = pair_measures(members, members.whole, pieces)
    assert assign(assignment_cost(found), candidates(found)).tolist() == [[0, 0]]


def test_assignment_cost__prefers_what_is_nearer_by_centimetres():
    """Of two that cover the member, and of a far one that covers a little more of it."""
    pieces = lines_of([ALONG_X[0] + [0, 0.09, 0], [[0.0, 0.01, 0.0], [1.6, 0.01, 0.0]]])
    members = lines_of(ALONG_X)
    found = pair_measures(members, members.whole, pieces)
    assert assign(assignment_cost(found), candidates(found)).tolist() == [[0, 1]]
