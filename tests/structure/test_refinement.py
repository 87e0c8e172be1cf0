"""From evidence to a better hypothesis: refit, bend, merge and drop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamseg_batch.cylinder.evidence_kernels import COARSE, FINE
from beamseg_batch.geometry import normalised
from beamseg_batch.structure.arcs import arc_matrix
from beamseg_batch.structure.hypothesis import Beam, Sums, normal_matrix
from beamseg_batch.structure.refinement import (
    INTERVAL_COST,
    LEAST_SCORE,
    PassRules,
    bend,
    is_apart,
    is_likely,
    refined,
    refit,
    share_beside,
    stands_free,
    without_collisions,
    without_duplicates,
    without_hidden_gaps,
)
from tests.structure.answers import NOISE, told

ALONG = np.array([1.0, 0.0, 0.0])


def beam(start, end, **values):
    start, end = np.array(start, np.float64), np.array(end, np.float64)
    half = 0.5 * float(np.linalg.norm(end - start))
    return Beam(0.5 * (start + end), normalised(end - start), -half, half, 0.05, **values)


GOOD = beam([0, 0, 0], [1, 0, 0], score=2000.0, hits=500.0, scans=5)


def straight(one, du=0.004, dv=-0.006, su=0.01, sv=0.004):
    """Offset of a straight axis, and the points where its ends are."""
    u, v = one.normals
    ends = [one.at(s) + (du + s * su) * u + (dv + s * sv) * v for s in (one.first, one.last)]
    return (lambda s: np.array([du + s * su, dv + s * sv])), ends


def bent(place, degrees):
    """Offset of an axis that turns at a place by so much."""
    half = 0.5 * np.tan(np.radians(degrees))
    return lambda s: np.array([half * abs(s - place), 0.0])


# --- refit ----------------------------------------------------------------------------


def test_refit__moves_the_axis_to_where_the_rays_put_it():
    offset, ends = straight(GOOD)
    moved = refit(GOOD, 0, GOOD.first, GOOD.last, told(GOOD, offset))
    np.testing.assert_allclose(moved.ends, ends, atol=1e-4)  # to first order
    axis = normalised(ends[1] - ends[0])
    assert np.linalg.norm(np.cross(moved.direction, axis)) < 1e-9
    assert moved.reduced_chi2 == pytest.approx(0.0, abs=1e-9)
    assert moved.length == pytest.approx(GOOD.length)


def test_refit__tells_how_certain_the_axis_is():
    steps, matrices = [], []
    for seed in range(60):
        sums = told(GOOD, lambda s: np.zeros(2), noise=1.0, seed=seed, per_bin=10)
        moved = refit(GOOD, 0, GOOD.first, GOOD.last, sums)
        steps.append([moved.at(0.0) @ part for part in GOOD.normals])
        across = np.array(GOOD.normals)
        matrices.append(across @ moved.covariance[:3, :3] @ across.T)
        assert moved.reduced_chi2 == pytest.approx(1.0, abs=0.25)
    spread = np.std(steps, axis=0)
    np.testing.assert_allclose(spread, np.sqrt(np.diag(np.mean(matrices, axis=0))), rtol=0.3)


def test_refit__measures_the_radius_with_one_look():
    errors, sigmas = [], []
    for seed in range(60):
        sums = told(
            GOOD, lambda s: np.zeros(2), noise=1.0, seed=seed, per_bin=20, thicker=0.001, tukey=4.0
        )
        found = refit(GOOD, 0, GOOD.first, GOOD.last, sums)
        errors.append(found.free_radius - GOOD.radius - 0.001)
        sigmas.append(found.sigma_radius)
    assert abs(np.mean(errors)) < 3.0 * np.mean(sigmas) / np.sqrt(60)
    assert np.std(errors) == pytest.approx(np.mean(sigmas), rel=0.2)


def test_refit__scans_that_share_an_error_count_as_fewer():
    """Each scan lies off as a whole, by an error that four scans in a row share."""
    rng, zero = np.random.default_rng(2), straight(GOOD, 0, 0, 0, 0)[0]
    one, many = replace(GOOD, scans=400), told(GOOD, zero, noise=1.0, per_bin=2000)
    span = many.coarse_bins(0, one.first, one.last)
    ends = one.first, one.last
    matrix, _ = arc_matrix(many.coarse(0)[span], many.middles(0)[span], *ends)
    bows = np.eye(7)  # of offsets, slopes and the offsets that grow with the square of the place
    bows[[5, 6], [0, 1]], bows[[5, 6], [5, 6]] = 1.0, -4.0 / one.length**2
    back = np.linalg.inv(bows)
    # As rays alone would scatter, which share nothing.
    many.evidence.scatter[0] = 0.579 * back @ matrix @ back.T
    own, shared = (refit(one, 0, one.first, one.last, many, (), k).covariance for k in (1.0, 4.0))
    np.testing.assert_allclose(own, shared, rtol=1e-6, atol=1e-15)
    errors = np.repeat(rng.normal(0.0, 0.003, (100, 2)), 4, axis=0)
    scores = (matrix[:2, :2] / 400 @ errors.T).T
    many.evidence.scatter[0, :2, :2] += scores.T @ scores
    alike = refit(one, 0, one.first, one.last, many, (), 4.0)
    across = np.array(one.normals) @ alike.covariance[:3, :3] @ np.array(one.normals).T
    true = 0.003 / np.sqrt(100) / 0.771  # Tukey's slope, for rays without noise of their own
    np.testing.assert_allclose(np.sqrt(np.diag(across)), true, rtol=0.2)


def test_refit__asks_only_the_stretch():
    def offset(s):
        return np.array([0.003, 0.0]) if s < 0.0 else np.array([0.03, 0.0])

    part = refit(GOOD, 0, -0.5, 0.0, told(GOOD, offset))
    assert part.at(0.0) @ GOOD.normals[0] == pytest.approx(0.003, abs=1e-9)
    assert part.length == pytest.approx(0.5)


@pytest.mark.parametrize("per_bin", [0, 40])
def test_refit__without_rays_changes_the_ends_alone(per_bin):
    sums = told(GOOD, lambda s: np.array([0.01, 0.0]), per_bin=per_bin)
    part = refit(GOOD, 0, 0.6, 0.7, sums)
    np.testing.assert_allclose(part.ends, [[1.1, 0, 0], [1.2, 0, 0]], atol=1e-12)


def test_refit__takes_no_leaps():
    moved = refit(GOOD, 0, GOOD.first, GOOD.last, told(GOOD, lambda s: np.array([0.5, 0.0])))
    assert np.linalg.norm(moved.at(0.0) - GOOD.at(0.0)) == pytest.approx(0.05, abs=1e-9)


# --- bend -----------------------------------------------------------------------------


def naive_bend(one, sums):
    """The bin at which two least squares fits leave the least, by brute force."""
    span = sums.coarse_bins(0, one.first, one.last)
    rows = sums.coarse(0)[span]

    def left_over(part):
        matrix, right = normal_matrix(part)
        matrix, right = matrix[:4, :4], right[:4]
        return part[:, 13].sum() - right @ np.linalg.lstsq(matrix, right, rcond=None)[0]

    least = round(0.25 / COARSE)
    cuts = range(least, len(rows) - least + 1)
    best = min(cuts, key=lambda k: left_over(rows[:k]) + left_over(rows[k:]))
    return sums.starts[0] + (span.start + best) * COARSE


@pytest.mark.parametrize("place", [-0.15, 0.0, 0.11])
@pytest.mark.parametrize("degrees", [6.0, 10.0, 20.0])
def test_bend__is_found_where_it_is(place, degrees):
    sums = told(GOOD, bent(place, degrees), noise=1.0)
    found = bend(sums.coarse(0), sums, 0, GOOD.first, GOOD.last, NOISE)
    assert found == pytest.approx(naive_bend(GOOD, sums), abs=1e-9)
    assert found == pytest.approx(place, abs=0.03)


@pytest.mark.parametrize("seed", range(5))
def test_bend__is_not_found_in_noise(seed):
    offset, _ = straight(GOOD)
    sums = told(GOOD, offset, noise=1.0, seed=seed)
    assert bend(sums.coarse(0), sums, 0, GOOD.first, GOOD.last, NOISE) is None


def test_bend__is_not_looked_for_in_what_is_short():
    short = beam([0, 0, 0], [0.4, 0, 0])
    sums = told(short, bent(0.0, 20.0))
    assert bend(sums.coarse(0), sums, 0, short.first, short.last, NOISE) is None


# --- likely and free ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "likely"),
    [
        ({}, True),
        ({"score": 299.0, "hits": 100.0}, False),
        ({"score": 301.0, "hits": 100.0}, True),
        ({"score": 301.0, "hits": 500.0}, False),
        ({"first": -0.08, "last": 0.08}, False),
        ({"flanks": np.array([[50.0, 50.0], [0.0, 100.0], [0.0, 0.0]])}, False),
    ],
)
def test_is_likely__asks_for_evidence_length_and_air(change, likely):
    assert is_likely(replace(GOOD, **change)) is likely


@pytest.mark.parametrize(
    ("flanks", "free"),
    [
        ([[0, 0], [0, 0], [0, 0]], True),
        ([[19, 0], [19, 0], [0, 0]], True),
        ([[20, 0], [0, 0], [0, 0]], False),
        ([[0, 0], [20, 0], [0, 0]], False),
        ([[44, 56], [44, 56], [29, 71]], True),
        ([[46, 54], [0, 99], [0, 0]], False),
        ([[44, 56], [44, 56], [31, 69]], False),
    ],
)
def test_stands_free__on_either_side(flanks, free):
    assert stands_free(replace(GOOD, flanks=np.array(flanks, np.float64))) is free


@pytest.mark.parametrize(
    ("flanks", "doubtful", "beside", "free"),
    [
        ([[50, 50], [0, 99], [0, 0]], True, 0.24, True),  # joined to something
        ([[50, 50], [0, 99], [0, 0]], True, 0.26, False),
        ([[50, 50], [0, 99], [0, 0]], False, 0.24, False),
        ([[30, 70], [0, 99], [0, 0]], True, 0.26, False),
        ([[30, 70], [0, 99], [0, 0]], False, 0.26, True),
        ([[30, 70], [0, 99], [0, 0]], True, np.nan, True),
        ([[0, 99], [0, 99], [31, 69]], True, 0.0, False),  # an edge
    ],
)
def test_stands_free__what_is_doubtful_along_half_of_its_length(flanks, doubtful, beside, free):
    asked = replace(GOOD, flanks=np.array(flanks, np.float64), doubtful=doubtful, beside=beside)
    assert stands_free(asked) is free


@pytest.mark.parametrize(
    ("doubtful", "share", "likely"), [(False, 0.69, True), (True, 0.69, False), (True, 0.71, True)]
)
def test_is_likely__what_is_doubtful_must_be_as_round_as_a_beam(doubtful, share, likely):
    assert (
        is_likely(replace(GOOD, score=share * 4.3 * 1000.0, hits=1000.0, doubtful=doubtful))
        is likely
    )


def beside(*stretches):
    """Rays beside 10 cm each, left and right: of ten on a side so many that found something."""
    found = np.repeat(np.reshape(stretches, (-1, 2)).astype(np.float64), 5, axis=0)
    return np.stack([found, 10.0 - found], axis=2) / 5.0


@pytest.mark.parametrize(
    ("rows", "share"),
    [
        (beside(), np.nan),
        (beside([0, 3], [2, 0], [10, 10]), 0.3),
        (beside([9, 0], [0, 9], [9, 0]), 0.9),  # an edge, on one side or the other
        (beside([10, 0], [1, 0], [0, 0], [0, 1], [0, 10]), 0.1),  # joined at both ends
        (0.5 * beside([9, 0], [0, 9], [9, 0]), np.nan),  # too few rays to tell
    ],
)
def test_share_beside__is_that_of_most_of_the_length(rows, share):
    np.testing.assert_allclose(share_beside(rows), share)


def test_stands_free__a_thicker_beam_than_assumed_goes_on_beside_itself():
    attached = replace(GOOD, flanks=np.array([[40.0, 60.0], [40.0, 60.0], [60.0, 40.0]]))
    assert not stands_free(replace(attached, free_radius=1.1 * GOOD.radius))
    assert stands_free(replace(attached, free_radius=1.2 * GOOD.radius))


# --- duplicates -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("start", "end", "count"),
    [
        ([0.1, 0.011, 0], [0.9, 0.011, 0], 1),  # the same, seen worse
        ([0.9, 0.011, 0], [0.1, 0.011, 0], 1),  # turned round
        ([0.1, 0.013, 0], [0.9, 0.013, 0], 2),  # beside it
        ([0.6, 0.01, 0], [1.5, 0.01, 0], 2),  # overlaps by less than half
        ([1.04, 0.005, 0], [2, 0.005, 0], 1),  # goes on
        ([1.04, 0.007, 0], [2, 0.007, 0], 2),
        ([1.06, 0, 0], [2, 0, 0], 2),  # goes on after a gap
        ([0.4, 0, 0], [0.6, 0.006, 0], 2),  # turned by 1.7 degrees
        ([0.5, -0.5, 0], [0.5, 0.5, 0], 2),
    ],
)
@pytest.mark.parametrize("order", [1, -1])
def test_without_duplicates__keeps_the_likelier(start, end, count, order):
    kept = without_duplicates([GOOD, beam(start, end, score=400.0)][::order])
    assert len(kept) == count
    assert kept[0].score == GOOD.score


def test_without_duplicates__the_likelier_takes_in_the_length():
    (kept,) = without_duplicates([beam([0.8, 0.004, 0], [2, 0.004, 0]), GOOD])
    np.testing.assert_allclose(kept.ends, [[0, 0, 0], [2, 0, 0]], atol=1e-9)


# --- all of it ------------------------------------------------------------------------


def test_refined__cuts_what_the_rays_deny():
    sums = told(GOOD, lambda s: np.zeros(2))
    likelihood, hits = sums.fine(0)
    places = sums.starts[0] + FINE * (np.arange(len(hits)) + 0.5)
    likelihood[places > 0.3], hits[places > 0.3] = -4.0, 0.0
    (found,) = refined([GOOD], sums, NOISE, PassRules())
    assert found.length == pytest.approx(0.8, abs=FINE)
    assert found.score == pytest.approx(likelihood[(places > -0.5) & (places < 0.3)].sum())


@pytest.mark.parametrize("several", [False, True])
def test_refined__cuts_in_two_where_that_is_allowed(several):
    sums = told(GOOD, lambda s: np.zeros(2))
    likelihood, hits = sums.fine(0)
    places = sums.starts[0] + FINE * (np.arange(len(hits)) + 0.5)
    gap = np.abs(places) < 0.1
    likelihood[gap], hits[gap] = -4.0, 0.0
    found = refined([GOOD], sums, NOISE, PassRules(cut=several))
    lengths = sorted(one.length for one in found)
    assert lengths == pytest.approx([0.4, 0.4] if several else [1.0], abs=2 * FINE)


@pytest.mark.parametrize(("through", "count"), [(-4.0, 2), (-0.8, 1)])
def test_refined__cuts_where_rays_see_through_not_where_few_reach(through, count):
    sums = told(GOOD, lambda s: np.zeros(2))
    likelihood, hits = sums.fine(0)
    places = sums.starts[0] + FINE * (np.arange(len(hits)) + 0.5)
    hidden = np.abs(places) < 0.15
    likelihood[hidden], hits[hidden] = through, 0.0
    assert -likelihood[hidden].sum() > INTERVAL_COST
    assert len(refined([GOOD], sums, NOISE, PassRules(cut=True))) == count


def test_without_hidden_gaps__joins_what_it_leaves_together():
    likelihood = np.full(100, 20.0)
    likelihood[20:30], likelihood[50:60], likelihood[80:90] = -3.0, -20.0, -3.0
    stretches = np.array([[0, 20], [30, 50], [60, 80], [90, 100]])
    joined = without_hidden_gaps(stretches, likelihood, 10.0)
    np.testing.assert_array_equal(joined, [[0, 50], [60, 100]])
    np.testing.assert_array_equal(
        without_hidden_gaps(stretches[:0], likelihood, 10.0), np.empty((0, 2))
    )


@pytest.mark.parametrize(("asked", "count"), [(1.0, 0), (0.25, 1)])
def test_refined__a_share_of_the_rays_needs_a_share_of_the_evidence(asked, count):
    sums = told(GOOD, lambda s: np.zeros(2), per_bin=1)
    likelihood = sums.fine(0)[0]
    assert 0.25 * LEAST_SCORE < likelihood[likelihood > 0.0].sum() < LEAST_SCORE
    assert len(refined([GOOD], sums, NOISE, PassRules(), asked=asked)) == count


@pytest.mark.parametrize(("split", "count"), [(True, 2), (False, 1)])
def test_refined__splits_at_a_bend_where_that_is_allowed(split, count):
    sums = told(GOOD, bent(0.0, 5.0), noise=1.0)
    found = refined([GOOD], sums, NOISE, PassRules(split=split))
    assert len(found) == count
    if split:
        between = np.degrees(np.arccos(abs(found[0].direction @ found[1].direction)))
        assert between == pytest.approx(5.0, abs=0.5)


@pytest.mark.parametrize("drop", [True, False])
def test_refined__drops_the_unlikely_where_that_is_allowed(drop):
    sums = told(GOOD, lambda s: np.zeros(2), per_bin=20, like=0.2)
    assert len(refined([GOOD], sums, NOISE, PassRules(drop=drop))) == (0 if drop else 1)


def test_refined__of_no_evidence_is_nothing():
    assert refined([GOOD], Sums([GOOD]), NOISE, PassRules(drop=False)) == []
    assert refined([], Sums([]), NOISE, PassRules(snap=True)) == []


# --- beams in one another's way -------------------------------------------------------


def test_refined__of_two_beams_for_one_the_likelier_waits_a_pass():
    weaker = beam([0.1, 0.01, 0], [0.9, 0.02, 0], score=900.0, hits=230.0, scans=4)
    silent = Sums([weaker, GOOD])
    assert refined([weaker, GOOD], silent, NOISE, PassRules()) == [GOOD]
    assert refined([GOOD], Sums([GOOD]), NOISE, PassRules()) == []


@pytest.mark.parametrize(
    "other",
    [
        beam([0.1, 0.2, 0], [0.9, 0.2, 0], score=900.0, hits=230.0),
        beam([1.5, 0, 0], [2.5, 0, 0], score=900.0, hits=230.0),
    ],
)
def test_refined__beams_apart_do_not_wait_for_one_another(other):
    assert refined([GOOD, other], Sums([GOOD, other]), NOISE, PassRules()) == []


def test_refined__what_was_unlikely_before_does_not_wait():
    poor = [replace(GOOD, score=200.0), replace(GOOD, score=100.0)]
    assert refined(poor, Sums(poor), NOISE, PassRules()) == []


@pytest.mark.parametrize(
    ("other", "count"),
    [
        (beam([0.1, 0.07, 0], [0.9, 0.09, 0], score=900.0), 1),  # in the same place
        (beam([0.1, 0.15, 0], [0.9, 0.15, 0], score=900.0), 2),  # beside it
        (beam([0.5, -0.5, 0.05], [0.5, 0.5, 0.05], score=900.0), 2),  # across
        (beam([0.8, 0.05, 0], [1.8, 0.05, 0], score=900.0), 2),  # mostly further on
    ],
)
def test_without_collisions__two_beams_do_not_share_their_place(other, count):
    kept = without_collisions([other, GOOD])
    assert len(kept) == count
    assert kept[0] is GOOD


@pytest.mark.parametrize(
    ("flanks", "apart"),
    [
        ([[24, 76], [20, 80], [0, 0]], True),
        ([[26, 74], [0, 100], [0, 0]], False),
        ([[0, 100], [0, 100], [30, 70]], False),
        ([[9, 9], [0, 0], [0, 0]], True),
    ],
)
def test_is_apart__what_has_no_shape_must_stand_more_freely(flanks, apart):
    assert is_apart(replace(GOOD, flanks=np.array(flanks, np.float64))) is apart
