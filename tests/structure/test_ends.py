"""Ends of beams, from how likely each place for them is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamseg_batch.structure.ends import with_measured_ends
from beamseg_batch.structure.hypothesis import Beam
from beamseg_batch.structure.questions import END_PLACES

BEAM = Beam(np.zeros(3), np.array([1.0, 0.0, 0.0]), -0.5, 0.5, 0.05)
OUTWARDS = np.stack([-END_PLACES, END_PLACES])


def peaked(*places, sharpness=4e5):
    """Likelihood of both ends, largest where they are moved outwards by so much."""
    return -sharpness * (OUTWARDS - np.array(places)[:, None]) ** 2


def test_with_measured_ends__moves_both_to_where_they_are_likeliest():
    (found,) = with_measured_ends([BEAM], peaked(0.013, -0.007)[None, None])
    np.testing.assert_allclose(found.ends, [[-0.513, 0, 0], [0.493, 0, 0]], atol=1e-5)
    deviation = np.hypot(np.sqrt(0.5 / 4e5), 0.0005)
    np.testing.assert_allclose(found.sigma_ends, deviation, rtol=0.05)


def test_with_measured_ends__between_two_places_of_equal_likelihood_lies_the_mean():
    likelihood = np.where(np.abs(OUTWARDS - 0.01) < 0.0041, 0.0, -100.0)
    (found,) = with_measured_ends([BEAM], likelihood[None, None])
    np.testing.assert_allclose(found.last, 0.51, atol=1e-9)
    np.testing.assert_allclose(found.sigma_ends, np.hypot(0.0028284, 0.0005), rtol=1e-3)


def test_with_measured_ends__an_end_that_nothing_denies_stays():
    open_ended = np.minimum(0.0, 500.0 * (OUTWARDS + 0.01))  # shorter is denied, longer is not
    (found,) = with_measured_ends([BEAM], open_ended[None, None])
    np.testing.assert_allclose(found.ends, BEAM.ends, atol=1e-12)
    assert np.isnan(found.sigma_ends).all()


def test_with_measured_ends__an_end_drawn_to_an_axis_stays():
    snapped = replace(BEAM, snapped=(True, False), sigma_ends=np.array([0.002, np.nan]))
    (found,) = with_measured_ends([snapped], peaked(0.013, 0.013)[None, None])
    np.testing.assert_allclose(found.ends, [[-0.5, 0, 0], [0.513, 0, 0]], atol=1e-5)
    assert found.sigma_ends[0] == pytest.approx(np.hypot(0.002, 0.0005))


@pytest.mark.parametrize(("beyond", "seen"), [(-0.5, True), (0.0, False), (0.5, False)])
def test_with_measured_ends__is_seen_where_rays_deny_that_it_goes_on(beyond, seen):
    profile = np.where(np.arange(400) < 325, 1.0, beyond)  # from -0.8 m on; it ends at 0.5
    beam = replace(BEAM, profile=profile, profile_start=-0.8)
    (found,) = with_measured_ends([beam], peaked(0.0, 0.0)[None, None])
    assert found.ends_seen == (False, seen)


def test_with_measured_ends__of_none():
    assert with_measured_ends([], np.empty((1, 0, 2, len(END_PLACES)))) == []


def test_with_measured_ends__is_as_sure_as_the_parts_of_the_flight_agree():
    rng = np.random.default_rng(4)
    found, claimed = [], []
    for _ in range(200):
        places = rng.normal(0.0, 0.008, (12, 2))
        parts = np.array([peaked(*pair, sharpness=4e4) for pair in places])
        (beam,) = with_measured_ends([BEAM], parts[:, None])
        found.append(beam.ends[1][0] - 0.5)
        claimed.append(beam.sigma_ends[1])
    # Each part claims 3.5 mm, all together 1 mm; yet they lie 8 mm apart.
    assert np.std(found) == pytest.approx(0.008 / np.sqrt(12), rel=0.15)
    assert np.sqrt(np.mean(np.square(claimed))) == pytest.approx(np.std(found), rel=0.25)


def test_with_measured_ends__parts_that_saw_nothing_say_nothing():
    parts = np.array([peaked(0.013, -0.007), np.zeros_like(OUTWARDS)])
    (found,) = with_measured_ends([BEAM], parts[:, None])
    (alone,) = with_measured_ends([BEAM], parts[:1, None])
    np.testing.assert_array_equal(found.sigma_ends, alone.sigma_ends)


def test_with_measured_ends__mixed_pixels_leave_them_less_sure():
    (found,) = with_measured_ends([BEAM], peaked(0.0, 0.0)[None, None], 0.01)
    deviations = np.sqrt(0.5 / 4e5), 0.0005, 0.01 * 0.5 / np.sqrt(12)
    np.testing.assert_allclose(found.sigma_ends, np.linalg.norm(deviations), rtol=0.05)
