"""Ends drawn to the axes that they meet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamseg_batch.geometry import normalised
from beamseg_batch.structure.hypothesis import Beam
from beamseg_batch.structure.snapping import snapped

FINE = 0.004


def beam(start, end, *, score=0.0, profile=None):
    start, end = np.array(start, np.float64), np.array(end, np.float64)
    half = 0.5 * float(np.linalg.norm(end - start))
    profile = np.zeros(0) if profile is None else profile
    return Beam(
        0.5 * (start + end), normalised(end - start), -half, half, 0.05,
        score=score, profile=profile, profile_start=-half - 0.3,
    )  # fmt: skip


POST = beam([0, 0, 0], [0, 0, 2])


@pytest.mark.parametrize("gap", [-0.1, -0.03, 0.03, 0.1, 0.14])
def test_snapped__moves_an_end_to_the_axis_it_meets(gap):
    post, rail = snapped([POST, beam([gap, 0.01, 1], [1, 0.01, 1])])
    np.testing.assert_allclose(rail.ends, [[0, 0.01, 1], [1, 0.01, 1]], atol=1e-12)
    np.testing.assert_allclose(post.ends, POST.ends, atol=1e-12)


def test_snapped__moves_the_last_end_likewise():
    _, rail = snapped([POST, beam([-1, 0, 1], [-0.05, 0, 1])])
    np.testing.assert_allclose(rail.ends, [[-1, 0, 1], [0, 0, 1]], atol=1e-12)


def test_snapped__two_ends_of_a_corner_meet():
    post, rail = snapped([POST, beam([0.05, 0, 1.95], [1, 0, 1.95])])
    np.testing.assert_allclose(post.ends[1], [0, 0, 1.95], atol=1e-12)
    np.testing.assert_allclose(rail.ends[0], [0, 0, 1.95], atol=1e-12)


@pytest.mark.parametrize(
    ("start", "end"),
    [
        ([0.16, 0, 1], [1, 0, 1]),  # too far
        ([0.05, 0.026, 1], [1, 0.026, 1]),  # passes by
        ([0.05, 0, 2.2], [1, 0, 2.2]),  # above its end
        ([0.01, 0, 0.5], [0.01, 0, 1.5]),  # parallel
    ],
)
def test_snapped__lets_an_end_be_that_meets_nothing(start, end):
    one = beam(start, end)
    _, rail = snapped([POST, one])
    np.testing.assert_allclose(rail.ends, one.ends, atol=1e-12)


def test_snapped__a_slanted_beam_reaches_further():
    way = np.array([np.sin(0.4), 0, np.cos(0.4)])
    one = beam(0.25 * way + [0, 0, 0.5], 1.2 * way + [0, 0, 0.5])
    _, brace = snapped([POST, one])
    np.testing.assert_allclose(brace.ends[0], [0, 0, 0.5], atol=1e-12)


@pytest.mark.parametrize(("a_bin", "moves"), [(-4.0, False), (-0.5, True), (4.0, True)])
def test_snapped__the_evidence_vetoes_growth(a_bin, moves):
    _, rail = snapped([POST, beam([0.1, 0, 1], [1, 0, 1], profile=np.full(375, a_bin))])
    assert rail.ends[0][0] == pytest.approx(0.0 if moves else 0.1, abs=1e-12)


@pytest.mark.parametrize(("a_bin", "moves"), [(4.0, False), (0.5, True), (-4.0, True)])
def test_snapped__the_evidence_vetoes_shrinking(a_bin, moves):
    _, rail = snapped([POST, beam([-0.1, 0, 1], [1, 0, 1], profile=np.full(425, a_bin))])
    assert rail.ends[0][0] == pytest.approx(0.0 if moves else -0.1, abs=1e-12)


@pytest.mark.parametrize("beams", [[], [POST]])
def test_snapped__few_beams_stay(beams):
    assert snapped(beams) == beams


# --- bent beams -----------------------------------------------------------------------


def bowed(post):
    return replace(post, bow=np.array([0.04, 0.0, 0.0]))


@pytest.mark.parametrize("gap", [-0.02, 0.03])
def test_snapped__moves_an_end_to_an_axis_that_is_bent(gap):
    """The chord passes 4 cm from where the axis is."""
    rail = beam([0.03 + gap, 0.0, 1.5], [1, 0.0, 1.5])
    post, rail = snapped([bowed(POST), rail])
    np.testing.assert_allclose(rail.ends, [[0.03, 0, 1.5], [1, 0, 1.5]], atol=1e-5)
    np.testing.assert_allclose(post.ends, POST.ends, atol=1e-12)
    np.testing.assert_allclose(post.bow, [0.04, 0, 0], atol=1e-12)


def test_snapped__an_axis_that_only_the_chord_meets_is_passed_by():
    rail = beam([0.0, 0.045, 1.0], [1, 0.045, 1.0])
    post = replace(POST, bow=np.array([0.0, -0.04, 0.0]))
    np.testing.assert_allclose(snapped([post, rail])[1].ends, rail.ends, atol=1e-12)
    straight = beam([0.01, 0.02, 1.0], [1, 0.02, 1.0])
    assert snapped([POST, straight])[1].ends[0][0] == pytest.approx(0.0)
    assert snapped([post, straight])[1].ends[0][0] == pytest.approx(0.01)


def test_snapped__end_of_a_bent_beam_goes_on_along_its_axis():
    floor = beam([-1, 0, -0.05], [1, 0, -0.05])
    post = snapped([bowed(POST), floor])[0]
    slope = 4 * 0.04 / 2.0
    np.testing.assert_allclose(post.ends[0], [-0.05 * slope, 0, -0.05], atol=3e-4)
    np.testing.assert_allclose(post.at(post.last), bowed(POST).ends[1], atol=1e-3)
