"""Which section a beam has: from rays on all sides, on one, and of a round one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamseg_batch.catalogue import StandardSection, load_catalogue
from beamseg_batch.model import CrossSection, across_of
from beamseg_batch.section import Section
from beamseg_batch.structure.hypothesis import Beam
from beamseg_batch.structure.section_fit import (
    about_axis,
    axis_covariance,
    fit_again,
    fit_sections,
    fit_standard,
    lead,
    section_bow,
)
from beamseg_batch.structure.section_question import NearRays
from beamseg_batch.structure.sections import SectionTrial, without_parts
from tests.section_rays import REACH, WORST, rays_at

TUBE = Section("square", 0.09, 0.12)
I_BEAM = Section("i", 0.1, 0.12, 0.008, 0.01)
ANGLE = Section("l", 0.1, 0.08, 0.009, 0.009)
CHANNEL = Section("c", 0.06, 0.12, 0.008, 0.01)
CENTRE = np.array([0.01, -0.015])


def a_beam():
    direction = np.array([0.2, -0.1, 1.0]) / np.linalg.norm([0.2, -0.1, 1.0])
    return Beam(np.array([1.0, 2.0, 1.5]), direction, -0.6, 0.6, 0.05)


def found(rays, catalogue=()):
    return SectionTrial(REACH, WORST, catalogue)((a_beam(), rays))


@pytest.mark.parametrize("section", [TUBE, I_BEAM, ANGLE, CHANNEL])
def test_section_trial__every_shape_with_its_size_turn_and_centre(section):
    roll = 0.9
    beam, start = found(rays_at(section, roll=roll, centre=CENTRE)), a_beam()
    cross = beam.cross_section
    assert cross.shape == section.shape
    assert cross.confidence > 0.999
    u, v = start.normals
    centre = start.anchor + CENTRE[0] * u + CENTRE[1] * v
    assert np.linalg.norm(beam.anchor - centre) < 0.0025
    assert beam.direction @ start.direction > np.cos(np.radians(0.2))
    across = np.cos(roll) * u + np.sin(roll) * v
    sizes, turn = [cross.size.width, cross.size.height], cross.across @ across
    if section.shape == "square" and abs(turn) < 0.5:
        sizes, turn = sizes[::-1], np.sqrt(1.0 - turn**2)
    assert abs(turn) > np.cos(np.radians(2.0))
    assert sizes == pytest.approx([section.width, section.height], abs=0.003)
    if section.web:
        assert cross.size.web == pytest.approx(section.web, abs=0.002)
        assert cross.size.flange == pytest.approx(section.flange, abs=0.002)
    assert cross.name == ""


@pytest.mark.parametrize("noise", [0.003, 0.01, 0.03])
def test_section_trial__round_stays_round_and_where_it_was(noise):
    beam = found(rays_at(Section("round", 0.1, 0.1), noise=noise, centre=(0.001, 0.0)))
    assert beam.cross_section.shape == "round"
    np.testing.assert_array_equal(beam.anchor, a_beam().anchor)
    assert beam.cross_section.size is None


def test_section_trial__round_where_depths_are_worse_than_told():
    rays = rays_at(Section("round", 0.1, 0.1), noise=0.012)
    rays[:, 4] = 0.009
    beam = found(rays)
    assert beam.cross_section.shape == "round"
    assert beam.cross_section.confidence > 0.999


@pytest.mark.parametrize("section", [TUBE, CHANNEL, I_BEAM])
def test_section_trial__unknown_where_one_side_alone_was_seen(section):
    face = np.pi if section.shape != "i" else np.pi / 2.0  # its flat side
    beam = found(rays_at(section, roll=0.0, views=[face - np.pi], noise=0.005))
    assert beam.cross_section.shape in {"unknown", "round"}
    assert beam.cross_section.size is None
    np.testing.assert_array_equal(beam.anchor, a_beam().anchor)


def test_section_trial__a_board_is_no_section():
    board = Section("square", 0.02, 0.14)
    beam = found(rays_at(board))
    assert beam.cross_section.shape in {"unknown", "round"}
    assert beam.cross_section.size is None


@pytest.mark.parametrize("part", [None, CrossSection("unknown")])
def test_without_parts__what_lies_in_a_section_is_of_it(part):
    size = CrossSection("i", I_BEAM, np.array([1.0, 0.0, 0.0]))
    whole = Beam(np.zeros(3), np.array([0.0, 0.0, 1.0]), -0.5, 0.5, 0.05, cross_section=size)
    whole = replace(whole, score=9.0)
    flange = replace(whole, anchor=np.array([0.0, 0.05, 0.4]), score=20.0)
    flange = replace(flange, cross_section=part or CrossSection())
    beside = replace(flange, anchor=np.array([0.0, 0.2, 0.4]))
    across = replace(flange, direction=np.array([1.0, 0.0, 0.0]))
    kept = without_parts([flange, beside, whole, across])
    assert [beam.anchor[1] for beam in kept] == [0.2, 0.0, 0.05]
    assert kept[1].length == pytest.approx(1.4)


def test_section_trial__few_rays_say_nothing():
    beam = found(rays_at(I_BEAM, scans=5, each=10))
    assert beam.cross_section.shape == "round"
    assert np.isnan(beam.cross_section.confidence)


def test_section_trial__sigma_covers_the_error_of_the_axis():
    squares, variances = [], []
    for seed in range(8):
        beam = found(rays_at(TUBE, seed=seed, scans=60))
        u, v = beam.normals
        miss = beam.anchor - a_beam().anchor
        squares.append(np.sum((np.array([miss @ u, miss @ v]) - CENTRE) ** 2))
        variances.append(np.trace(beam.covariance_at(0.0)))
    ratio = np.mean(squares) / np.mean(variances)
    assert 0.1 < ratio < 2.0


def test_section_trial__snaps_to_a_standard_size():
    size = next(e.section for e in load_catalogue() if e.name == "HEB 100")
    beam = found(rays_at(size), load_catalogue())
    assert beam.cross_section.name == "HEB 100"
    assert beam.cross_section.size.web == pytest.approx(size.web)
    assert beam.cross_section.size.width == pytest.approx(size.width)


def test_section_trial__either_leg_of_an_angle_may_be_the_longer():
    catalogue = (StandardSection("L 100x80x9", Section("l", 0.08, 0.1, 0.009, 0.009)),)
    beam = found(rays_at(ANGLE), catalogue)
    assert beam.cross_section.name == "L 100x80x9"
    assert beam.cross_section.size.width > beam.cross_section.size.height


def test_section_trial__no_name_for_a_size_that_is_not_made():
    odd = Section("i", 0.107, 0.127, 0.008, 0.01)
    assert found(rays_at(odd), load_catalogue()).cross_section.name == ""


def test_section_trial__no_name_where_two_sizes_fit_alike():
    sizes = [Section("square", 0.09, 0.12), Section("square", 0.0901, 0.12)]
    catalogue = tuple(StandardSection(str(k), size) for k, size in enumerate(sizes))
    assert found(rays_at(TUBE), catalogue).cross_section.name == ""


@pytest.mark.parametrize("section", [TUBE, I_BEAM, ANGLE])
def test_section_trial__an_axis_that_leans(section):
    slopes = np.array([0.07, -0.05])  # five degrees: a flange was taken for the beam
    start, beam = a_beam(), found(rays_at(section, centre=CENTRE, slopes=slopes))
    u, v = start.normals
    direction = start.direction + slopes[0] * u + slopes[1] * v
    assert beam.cross_section.shape == section.shape
    assert beam.direction @ direction / np.linalg.norm(direction) > np.cos(np.radians(0.2))
    assert np.linalg.norm(beam.anchor - start.anchor - CENTRE[0] * u - CENTRE[1] * v) < 0.003


def test_fit_standard__keeps_the_size():
    rays = rays_at(TUBE)
    (fit,) = fit_sections(rays, REACH, WORST, ["square"])
    standard = fit_standard(fit, fit.section, rays, REACH, WORST)
    assert standard.section.width == pytest.approx(fit.section.width)
    assert standard.cost <= fit.cost * 1.001


def test_lead__grows_with_the_scans_that_agree():
    rays = rays_at(TUBE)
    tube, circle = fit_sections(rays, REACH, WORST, ["square", "round"])
    ahead, behind = lead(tube, circle, rays), lead(circle, tube, rays)
    assert ahead.gain == pytest.approx(-behind.gain)
    assert ahead.sigmas > 4.0
    rays[:, 7] = 0.0  # all of one scan
    assert lead(tube, circle, rays).sigmas == pytest.approx(1.0, abs=0.1)


def test_fit_sections__from_one_side_all_with_a_flat_back_fit_alike():
    rays = rays_at(CHANNEL, roll=0.0, views=[0.0], noise=0.005)
    fits = {fit.shape: fit for fit in fit_sections(rays, REACH, WORST)}
    assert abs(lead(fits["square"], fits["c"], rays).sigmas) < 3.5


def test_axis_covariance__unknown_where_the_rays_leave_it_open():
    rays = rays_at(Section("round", 0.1, 0.1))
    (fit,) = fit_sections(rays, REACH, WORST, ["round"])
    assert np.isfinite(axis_covariance(fit, rays)).all()
    rays[:, 3] = 1.0
    assert np.isnan(axis_covariance(fit, rays)).all()


def moved(rays, error):
    """The same rays as they would have met the beam where it is not, (N, 2) metres off."""
    rays = rays.copy()
    rays[:, 2] += error[:, 1] * rays[:, 0] - error[:, 0] * rays[:, 1]
    rays[:, 3] += (error * rays[:, :2]).sum(axis=1)
    return rays


@pytest.mark.parametrize("bow", [(0.0, 0.0), (0.004, -0.002)])
def test_section_bow__finds_a_bow_and_how_sure_it_is(bow):
    rays = rays_at(TUBE, centre=(0.0, 0.0), noise=0.004)
    rays = moved(rays, (1.0 - (rays[:, 5] / 0.6) ** 2)[:, None] * bow)
    fit = fit_again("square", about_axis(TUBE, 0.4), rays, REACH, WORST, sized=False)
    found_bow, sigma = section_bow(fit, rays, REACH, WORST, -0.6, 0.6)
    assert np.linalg.norm(found_bow - bow) < 2.0 * sigma
    assert sigma < 0.001


def test_near_rays__keep_the_same_whatever_their_order():
    rays = rays_at(TUBE, scans=400, each=50).astype(np.float32)
    parts = np.array_split(rays, 40)
    forward, whole = NearRays(), NearRays()
    for part in parts:
        forward.add({3: part})
    whole.add({3: rays})
    kept = forward.of(3)
    np.testing.assert_array_equal(kept, whole.of(3))
    assert len(kept) < len(rays)
    turns = np.floor(np.arctan2(kept[:, 1], kept[:, 0]) / (np.pi / 18.0))
    assert np.unique(turns, return_counts=True)[1].max() <= 150
    assert len(forward.of(0)) == 0


@pytest.mark.parametrize("direction", [[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, -1.0, 0.0]])
def test_across_of__is_undone_by_roll_deg(direction):
    direction = np.array(direction)
    for roll in (0.0, 35.0, 200.0):
        across = across_of(roll, direction)
        assert across @ direction == pytest.approx(0.0, abs=1e-12)
        assert CrossSection("i", I_BEAM, across).roll_deg(direction) == pytest.approx(roll)
