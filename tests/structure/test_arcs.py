"""Bent beams: bows that rays show, against kinks, joints and straight ones."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from beamseg_batch.cylinder.evidence_kernels import COARSE
from beamseg_batch.geometry import normalised
from beamseg_batch.structure.arcs import Piece, along_chord, arc_gain, is_clear, with_arcs
from beamseg_batch.structure.fates import Fates
from beamseg_batch.structure.hypothesis import Beam
from beamseg_batch.structure.refinement import PassRules, bend, refined, refit
from tests.structure.answers import NOISE, told, told_of


def beam(start, end, bow=(0.0, 0.0, 0.0), **values):
    start, end = np.array(start, np.float64), np.array(end, np.float64)
    half = 0.5 * float(np.linalg.norm(end - start))
    values = {"score": 2000.0, "hits": 500.0, "scans": 50, **values}
    return Beam(
        0.5 * (start + end), normalised(end - start), -half, half, 0.05,
        bow=np.array(bow, np.float64), **values,
    )  # fmt: skip


LONG = beam([-1, 0, 0], [1, 0, 0])


def to_curve(one, curve):
    """Offset of a curve from a beam's axis: where it crosses the plane square to its chord."""

    def offset(s):
        foot = one.anchor + s * one.direction
        x = foot[0]
        for _ in range(5):
            x -= (curve(x) - foot) @ one.direction / one.direction[0]
        return np.array(one.normals) @ (curve(x) - one.at(s))

    return offset


def arc(bow):
    """Parabola between the ends of LONG."""
    return lambda x: np.array([x, 0.6 * bow * (1 - x * x), 0.8 * bow * (1 - x * x)])


def kink(degrees):
    """Two straight pieces between the ends of LONG."""
    high = np.tan(np.radians(0.5 * degrees))
    return lambda x: np.array([x, high * (1 - abs(x)), 0.0])


# --- one stretch ----------------------------------------------------------------------


@pytest.mark.parametrize("bow", [0.01, 0.02, 0.04])
def test_refit__recovers_a_bow(bow):
    sums = told(LONG, to_curve(LONG, arc(bow)), noise=1.0)
    found = refit(LONG, 0, LONG.first, LONG.last, sums, bow=True)
    np.testing.assert_allclose(found.bow, [0.0, 0.6 * bow, 0.8 * bow], atol=6e-4)
    np.testing.assert_allclose(found.ends, LONG.ends, atol=1e-3)
    assert found.reduced_chi2 == pytest.approx(1.0, abs=0.1)


def test_refit__improves_a_bow():
    bent = beam([-1, 0, 0], [1, 0, 0], [0, 0.01, 0.02])
    sums = told(bent, to_curve(bent, arc(0.03)))
    found = refit(bent, 0, bent.first, bent.last, sums)
    np.testing.assert_allclose(found.bow, [0.0, 0.018, 0.024], atol=1e-5)
    np.testing.assert_allclose(found.at(0.3), arc(0.03)(0.3), atol=1e-5)


def test_refit__bow_of_a_part_is_that_of_the_part():
    sums = told(LONG, to_curve(LONG, arc(0.04)))
    found = refit(LONG, 0, 0.0, 1.0, sums, bow=True)
    assert np.linalg.norm(found.bow) == pytest.approx(0.01, abs=2e-5)
    for x in (0.0, 0.4, 1.0):
        s = (arc(0.04)(x) - found.anchor) @ found.direction
        np.testing.assert_allclose(found.at(s), arc(0.04)(x), atol=5e-5)


def test_refit__straightens_what_the_rays_show_straight():
    bent = beam([-1, 0, 0], [1, 0, 0], [0, 0.01, 0.0])
    sums = told(bent, to_curve(bent, arc(0.0)), noise=1.0)
    found = refit(bent, 0, bent.first, bent.last, sums, bow=True)
    assert not found.is_bent
    assert found.stiff
    np.testing.assert_allclose(found.ends, LONG.ends, atol=1e-3)
    assert np.linalg.norm(found.measured_bow) < 1e-3


def test_refit__does_not_try_again_to_bend_what_is_stiff():
    stiff = replace(LONG, stiff=True)
    sums = told(stiff, to_curve(stiff, arc(0.02)), noise=1.0)  # each bin is a scan of its own
    assert not refit(stiff, 0, stiff.first, stiff.last, sums, bow=True).is_bent
    assert refit(LONG, 0, LONG.first, LONG.last, sums, bow=True).is_bent


def test_refit__a_bow_is_certain_once_it_is_found():
    bent = beam([-1, 0, 0], [1, 0, 0], [0, 0.012, 0.016])
    sums = told(bent, to_curve(bent, arc(0.02)), noise=1.0)
    found = refit(bent, 0, bent.first, bent.last, sums, bow=True)
    assert found.is_bent
    assert not found.stiff
    assert 1e-4 < found.sigma_bow < 6e-4


def test_refit__measures_a_bow_where_none_is_allowed():
    sums = told(LONG, to_curve(LONG, arc(0.004)), noise=1.0, per_bin=400, tukey=4.0)
    found = refit(LONG, 0, LONG.first, LONG.last, sums)
    assert not found.is_bent
    assert np.linalg.norm(found.measured_bow) == pytest.approx(0.004, abs=2e-4)


def test_refit__tells_how_certain_a_bow_is():
    bows, sigmas = [], []
    for seed in range(60):
        sums = told(LONG, lambda s: np.zeros(2), noise=1.0, seed=seed, per_bin=10, tukey=4.0)
        found = refit(LONG, 0, LONG.first, LONG.last, sums, bow=True)
        bows.append(np.linalg.norm(found.measured_bow))
        sigmas.append(found.sigma_bow)
        assert not found.is_bent
    assert np.mean(np.array(bows) <= 2.0 * np.array(sigmas)) >= 0.9
    assert np.sqrt(np.mean(np.square(bows))) == pytest.approx(np.mean(sigmas), rel=0.15)


def test_is_clear__asks_for_size_certainty_and_length():
    sure = np.eye(2) * 1e-8
    assert is_clear(np.array([0.0, 0.01]), sure, 1.0)
    assert not is_clear(np.array([0.0, 0.001]), sure, 1.0)
    assert not is_clear(np.array([0.0, 0.01]), np.eye(2) * 1e-5, 1.0)
    assert not is_clear(np.array([0.0, 0.01]), sure, 0.3)
    assert not is_clear(np.array([0.0, 0.2]), sure, 1.0)
    assert not is_clear(np.full(2, np.nan), sure, 1.0)
    assert not is_clear(np.array([0.0, 0.01]), sure * np.nan, 1.0)


def test_along_chord__is_as_if_the_chord_had_been_asked():
    bent, straight = beam([-1, 0, 0], [1, 0, 0], [0, 0.02, 0.01]), LONG
    rows = told(bent, to_curve(bent, arc(0.03))).coarse(0)
    wanted = told(straight, to_curve(straight, arc(0.03)))
    got = along_chord(rows, wanted.middles(0), bent)
    np.testing.assert_allclose(got, wanted.coarse(0), rtol=0.02, atol=1e-3 * np.abs(rows).max())
    assert along_chord(rows, wanted.middles(0), straight) is rows


# --- an arc or two pieces -------------------------------------------------------------


@pytest.mark.parametrize("bow", [0.02, 0.04])
def test_bend__an_arc_is_not_split_where_beams_may_be_bent(bow):
    sums = told(LONG, to_curve(LONG, arc(bow)), noise=1.0)
    told_so = [
        bend(sums.coarse(0), sums, 0, LONG.first, LONG.last, NOISE, bow=allowed)
        for allowed in (True, False)
    ]
    assert told_so[0] is None
    assert told_so[1] is not None


@pytest.mark.parametrize("degrees", [3.0, 5.0])
@pytest.mark.parametrize("taken_for", [0.0, 0.02])
def test_refined__a_kink_is_split_though_beams_may_be_bent(degrees, taken_for):
    bent = beam([-1, 0, 0], [1, 0, 0], [0, taken_for, 0])
    sums = told(bent, to_curve(bent, kink(degrees)), noise=1.0)
    one, other = refined([bent], sums, NOISE, PassRules(bow=True))
    angle = np.degrees(np.arccos(abs(one.direction @ other.direction)))
    assert angle == pytest.approx(degrees, abs=0.05 * degrees)
    assert not one.is_bent
    assert not other.is_bent


def test_arc_gain__of_a_straight_beam_is_that_of_noise():
    gains = []
    for seed in range(40):
        sums = told(LONG, lambda s: np.array([0.002, 0.001 * s]), noise=1.0, seed=seed)
        span = sums.coarse_bins(0, LONG.first, LONG.last)
        gains.append(arc_gain(sums.coarse(0)[span], sums.middles(0)[span], -1.0, 1.0))
    assert np.mean(gains) == pytest.approx(2.0, abs=1.0)  # one for each normal


# --- pieces that lie end to end -------------------------------------------------------


def pieces_of(curve, cuts, *, turned=(), bent=False):
    """Straight beams from cut to cut of a curve, and what rays that hit it say of them."""
    beams = []
    for k, (low, high) in enumerate(pairwise(cuts)):
        start, end = (curve(high), curve(low)) if k in turned else (curve(low), curve(high))
        bow = curve(0.5 * (low + high)) - 0.5 * (start + end) if bent else np.zeros(3)
        beams.append(beam(start, end, bow, score=2000.0 + k))
    sums = told_of(beams, [to_curve(one, curve) for one in beams], noise=1.0)
    kept = [refit(one, k, one.first, one.last, sums, bow=True) for k, one in enumerate(beams)]
    profile = {"profile": np.ones(50), "profile_start": -0.1}
    pieces = [
        Piece(replace(one, **profile), k, beams[k].first, beams[k].last)
        for k, one in enumerate(kept)
    ]
    return pieces, beams, sums


@pytest.mark.parametrize("turned", [(), (0,), (1,), (0, 1)])
@pytest.mark.parametrize("bent", [False, True])
def test_with_arcs__joins_two_pieces_of_an_arc(turned, bent):
    curve = arc(0.04)
    (found,) = with_arcs(
        *pieces_of(curve, (-1.0, 0.2, 1.0), turned=turned, bent=bent), NOISE, Fates()
    )
    assert np.linalg.norm(found.bow) == pytest.approx(0.04, abs=1e-3)
    for x in (-0.9, -0.3, 0.2, 0.8):
        s = (curve(x) - found.anchor) @ found.direction
        np.testing.assert_allclose(found.at(s), curve(x), atol=1e-3)
    assert found.length == pytest.approx(2.0, abs=0.01)
    assert found.hits == 1000.0
    assert found.profile.sum() == pytest.approx(100.0)


@pytest.mark.parametrize("degrees", [0.0, 3.0, 6.0, 10.0])
def test_with_arcs__leaves_straight_pieces_with_a_joint(degrees):
    pieces, beams, sums = pieces_of(kink(degrees), (-1.0, 0.0, 1.0))
    assert with_arcs(pieces, beams, sums, NOISE, Fates()) == [piece.beam for piece in pieces]


@pytest.mark.parametrize("gap", [0.02, 0.2])
def test_with_arcs__joins_what_nearly_touches(gap):
    curve = arc(0.04)
    pieces, beams, sums = pieces_of(curve, (-1.0, -0.5 * gap, 0.5 * gap, 1.0))
    ends = [pieces[0], pieces[2]]
    assert len(with_arcs(ends, beams, sums, NOISE, Fates())) == (1 if gap < 0.1 else 2)


def test_with_arcs__of_three_pieces_two_are_joined_at_a_time():
    pieces, beams, sums = pieces_of(arc(0.05), (-1.0, -0.3, 0.3, 1.0))
    assert len(with_arcs(pieces, beams, sums, NOISE, Fates())) == 2


def test_with_arcs__leaves_beams_of_other_radii_and_directions():
    pieces, beams, sums = pieces_of(arc(0.04), (-1.0, 0.0, 1.0))
    thick = replace(pieces[0], beam=replace(pieces[0].beam, radius=0.1))
    assert len(with_arcs([thick, pieces[1]], beams, sums, NOISE, Fates())) == 2
    across = beam([0, 0, 0.04], [0.3, 0.9, 0.04])
    assert (
        len(with_arcs([replace(thick, beam=across), pieces[1]], beams, sums, NOISE, Fates())) == 2
    )


# --- the axis -------------------------------------------------------------------------


def test_beam__bent_axis_keeps_its_place_between_other_ends():
    bent = beam([-1, 0, 0], [1, 0, 0], [0, 0.03, 0.04])
    part = bent.between(-0.2, 0.9)
    np.testing.assert_allclose(part.ends, [bent.at(-0.2), bent.at(0.9)], atol=1e-12)
    for s in (-0.1, 0.35, 0.8):
        foot = (bent.at(s) - part.anchor) @ part.direction
        np.testing.assert_allclose(part.at(foot), bent.at(s), atol=1e-4)
    assert abs(part.bow @ part.direction) < 1e-15


@pytest.mark.parametrize("s", [-1.0, -0.4, 0.0, 0.7])
def test_tangent__touches_the_axis(s):
    bent = beam([-1, 0, 0], [1, 0, 0], [0, 0.03, 0.04])
    line = bent.tangent(s)
    np.testing.assert_allclose(line.at(s), bent.at(s), atol=1e-12)
    way = normalised(bent.at(s + 1e-6) - bent.at(s - 1e-6))
    np.testing.assert_allclose(line.direction, way, atol=1e-6)
    assert not line.is_bent
    assert LONG.tangent(s) is LONG


def test_middles__are_those_of_the_bins():
    sums = told_of([LONG, beam([0, 0, 1], [0, 0, 2])], [lambda s: np.zeros(2)] * 2)
    middles = sums.middles(1)
    assert len(middles) == len(sums.coarse(1))
    assert middles[0] == pytest.approx(sums.starts[1] + 0.5 * COARSE)
    np.testing.assert_allclose(np.diff(middles), COARSE)
