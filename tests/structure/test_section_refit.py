"""Axis and ends of a beam of a known section: from rays past its ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamseg_batch.config import load_config
from beamseg_batch.model import CrossSection, DepthNoise
from beamseg_batch.section import Section
from beamseg_batch.structure.hypothesis import Beam
from beamseg_batch.structure.pixel_rays import PixelRays
from beamseg_batch.structure.questions import Camera
from beamseg_batch.structure.section_fit import about_axis, centre_of
from beamseg_batch.structure.section_question import SectionQuestion
from beamseg_batch.structure.section_refit import SectionRefit
from tests.section_rays import REACH, WORST, rays_at

SIZES = {
    "square": Section("square", 0.09, 0.12),
    "i": Section("i", 0.1, 0.12, 0.008, 0.01),
    "l": Section("l", 0.1, 0.08, 0.009, 0.009),
    "c": Section("c", 0.06, 0.12, 0.008, 0.01),
}
ROLL, ENDS = 0.4, (-0.44, 0.37)


def a_beam(size, first=-0.5, last=0.3, name=""):
    beam = Beam(np.array([1.0, 2.0, 1.5]), np.array([0.0, 0.0, 1.0]), first, last, 0.05)
    u, v = beam.normals
    across = np.cos(ROLL) * u + np.sin(ROLL) * v
    return replace(beam, cross_section=CrossSection(size.shape, size, across, name, 0.99))


def rays_of(size, **other):
    settings = {"scans": 150, "each": 30, "ends": ENDS, "reach_along": 0.7, "centre": (0.0, 0.0)}
    return rays_at(size, roll=ROLL, **(settings | other))


@pytest.mark.parametrize("shape", SIZES)
def test_section_refit__ends_where_the_rays_put_them(shape):
    beam = a_beam(SIZES[shape])
    found = SectionRefit(REACH, WORST)((beam, rays_of(SIZES[shape])))
    np.testing.assert_allclose(found.at(found.first), beam.at(ENDS[0]), atol=0.006)
    np.testing.assert_allclose(found.at(found.last), beam.at(ENDS[1]), atol=0.006)
    assert (found.sigma_ends < 0.006).all()
    assert np.isfinite(found.covariance).all()


def test_section_refit__an_end_a_long_way_off():
    beam = a_beam(SIZES["square"], first=-0.44, last=0.2)
    found = SectionRefit(REACH, WORST)((beam, rays_of(SIZES["square"])))
    np.testing.assert_allclose(found.at(found.last), beam.at(ENDS[1]), atol=0.006)


def test_section_refit__an_axis_that_leans_and_is_beside():
    size, slopes, centre = SIZES["l"], np.array([0.02, -0.01]), np.array([0.006, -0.004])
    beam = a_beam(size)
    rays = rays_of(size, slopes=slopes, centre=centre, ends=(-np.inf, np.inf))
    found = SectionRefit(REACH, WORST)((beam, rays))
    u, v = beam.normals
    direction = beam.direction + slopes[0] * u + slopes[1] * v
    assert found.direction @ direction / np.linalg.norm(direction) > np.cos(np.radians(0.2))
    apart = found.at(-float((found.anchor - beam.anchor) @ beam.direction)) - beam.anchor
    np.testing.assert_allclose([apart @ u, apart @ v], centre, atol=0.002)
    # Nothing denies that it goes on: its ends stay.
    assert found.length == pytest.approx(beam.length, abs=1e-6)


def test_section_refit__a_standard_size_stays():
    size = SIZES["i"]
    beam = a_beam(replace(size, width=0.102), name="of a catalogue")
    found = SectionRefit(REACH, WORST)((beam, rays_of(size)))
    assert found.cross_section.size.width == pytest.approx(0.102)
    assert found.cross_section.name == "of a catalogue"


def test_section_refit__nothing_without_a_section_or_rays():
    beam = a_beam(SIZES["i"])
    vague = replace(beam, cross_section=CrossSection())
    refit = SectionRefit(REACH, WORST)
    assert refit((vague, rays_of(SIZES["i"]))) is vague
    assert refit((beam, rays_of(SIZES["i"])[:50])) is beam


@pytest.mark.parametrize("shape", SIZES)
def test_about_axis__the_centre_of_area_is_on_the_axis(shape):
    size = SIZES[shape]
    p = about_axis(size, 1.1)
    np.testing.assert_allclose(centre_of(shape, p), 0.0, atol=1e-12)
    assert p[1] - p[0] == pytest.approx(size.width)
    assert p[3] - p[2] == pytest.approx(size.height)


def test_SectionQuestion__again_asks_past_the_ends_of_those_alone_that_have_a_section():
    beams = [a_beam(SIZES["i"]), replace(a_beam(SIZES["i"]), cross_section=CrossSection())]
    camera = Camera(load_config("precise").filtering, DepthNoise(0.004), PixelRays())
    first, again = (SectionQuestion(beams, camera, 2, again=which) for which in (False, True))
    assert (first.stops - first.starts < 0.8).all()
    assert again.stops[0] - again.starts[0] > 1.2
    assert again.stops[1] <= again.starts[1]
