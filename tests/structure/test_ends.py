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
    (found,) = with_measured_ends([BEAM], peaked(0.013, -0.007)[None])
    np.testing.assert_allclose(found.ends, [[-0.513, 0, 0], [0.493, 0, 0]], atol=1e-5)
    deviation = np.hypot(np.sqrt(0.5 / 4e5), 0.0005)
    np.testing.assert_allclose(found.sigma_ends, deviation, rtol=0.05)


def test_with_measured_ends__between_two_places_of_equal_likelihood_lies_the_mean():
    likelihood = np.where(np.abs(OUTWARDS - 0.01) < 0.0041, 0.0, -100.0)
    (found,) = with_measured_ends([BEAM], likelihood[None])
    np.testing.assert_allclose(found.last, 0.51, atol=1e-9)
    np.testing.assert_allclose(found.sigma_ends, np.hypot(0.0028284, 0.0005), rtol=1e-3)


def test_with_measured_ends__an_end_that_nothing_denies_stays():
    open_ended = np.minimum(0.0, 500.0 * (OUTWARDS + 0.01))  # shorter is denied, longer is not
    (found,) = with_measured_ends([BEAM], open_ended[None])
    np.testing.assert_allclose(found.ends, BEAM.ends, atol=1e-12)
    assert np.isnan(found.sigma_ends).all()


def test_with_measured_ends__an_end_drawn_to_an_axis_stays():
    snapped = replace(BEAM, snapped=(True, False), sigma_ends=np.array([0.002, np.nan]))
    (found,) = with_measured_ends([snapped], peaked(0.013, 0.013)[None])
    np.testing.assert_allclose(found.ends, [[-0.5, 0, 0], [0.513, 0, 0]], atol=1e-5)
    assert found.sigma_ends[0] == pytest.approx(np.hypot(0.002, 0.0005))


@pytest.mark.parametrize(("beyond", "seen"), [(-0.5, True), (0.0, False), (0.5, False)])
def test_with_measured_ends__is_seen_where_rays_deny_that_it_goes_on(beyond, seen):
    profile = np.where(np.arange(400) < 325, 1.0, beyond)  # from -0.8 m on; it ends at 0.5
    beam = replace(BEAM, profile=profile, profile_start=-0.8)
    (found,) = with_measured_ends([beam], peaked(0.0, 0.0)[None])
    assert found.ends_seen == (False, seen)


def test_with_measured_ends__of_none():
    assert with_measured_ends([], np.empty((0, 2, len(END_PLACES)))) == []
