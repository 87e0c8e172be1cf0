"""Radii that the beams of a flight measure themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamseg_batch.config import load_config
from beamseg_batch.structure.evidence import EvidenceStructure
from beamseg_batch.structure.hypothesis import Beam
from beamseg_batch.structure.radius_classes import radius_classes, reclassed
from tests.structure.segments import detections, jittered
from tests.structure.test_evidence import NOISE, POSES, RAIL, look, refine, shortened


def beam(measured, sigma=2e-4, present=None):
    return Beam(
        anchor=np.array([1.0, 0.0, 1.0]), direction=np.array([0.0, 0.0, 1.0]),
        first=-0.5, last=0.5, radius=measured if present is None else present,
        free_radius=measured, sigma_radius=sigma, growth=np.array([0.9, 0.0, 0.0, 0.0]),
    )  # fmt: skip


def test_radius_classes__means_by_precision():
    beams = [beam(0.0501), beam(0.0299), beam(0.0498), beam(0.0304, sigma=1e-3)]
    thick, thin = radius_classes(beams)
    assert thick == pytest.approx(0.04995, abs=1e-6)
    assert thin == pytest.approx(0.0299, abs=5e-5)  # the second one hardly counts


def test_radius_classes__what_is_not_known_does_not_speak():
    vague = [beam(0.08, sigma=0.01), beam(np.nan), beam(0.05, sigma=np.nan), beam(-0.01, sigma=0.1)]
    assert radius_classes(vague) == ()
    assert radius_classes([]) == ()
    assert radius_classes([*vague, beam(0.04)]) == (0.04,)


@pytest.mark.parametrize(("ratio", "count"), [(1.08, 1), (1.15, 2)])
def test_radius_classes__are_so_far_apart(ratio, count):
    assert len(radius_classes([beam(0.05), beam(0.05 * ratio)])) == count


def test_radius_classes__one_that_grows_goes_on_growing():
    assert radius_classes([beam(0.056, present=0.05)]) == pytest.approx((0.062,))
    assert radius_classes([beam(0.044, present=0.05)]) == pytest.approx((0.044,))


def test_radius_classes__rough_ones_need_only_be_surely_wrong():
    wrong, vague = beam(0.03, sigma=0.006, present=0.05), beam(0.08, sigma=0.03, present=0.05)
    assert radius_classes([wrong, vague]) == ()
    assert radius_classes([wrong, vague], rough=True) == pytest.approx((0.03,))
    assert radius_classes([beam(-0.02, sigma=0.01, present=0.05)], rough=True) == (0.025,)


def test_reclassed__each_takes_the_nearest_and_moves_with_it():
    thin, thick = reclassed([beam(0.031), beam(0.048, present=0.06)], (0.05, 0.03))
    assert (thin.radius, thick.radius) == (0.03, 0.05)
    assert np.linalg.norm(thick.anchor - beam(0.05).anchor) == pytest.approx(0.009)


def test_reclassed__of_a_beam_that_measures_nothing():
    (kept,) = reclassed([beam(np.nan, present=0.05)], (0.1, 0.049))
    assert kept.radius == 0.049


@pytest.mark.parametrize("true", [0.03, 0.04, 0.07])
@pytest.mark.parametrize("seed", [0, 1])
def test_EvidenceStructure__measures_the_radius_from_a_wrong_one(true, seed):
    rng = np.random.default_rng(seed)
    start, end, assumed = RAIL
    scans = [look(pose, [(start, end, true)], rng, stamp_ns=k) for k, pose in enumerate(POSES)]
    structure = EvidenceStructure(load_config("precise"), NOISE, measurements=10)
    behind = (assumed - true) * np.array([1.0, 0.0, 0.0])  # the surface is where it is seen
    sighting = shortened((np.array(start) + behind, np.array(end) + behind, assumed))
    for scan in scans:
        seen = replace(jittered(sighting, rng, 0.003), radius=assumed)
        structure.update(replace(detections(seen, stamp_ns=scan.stamp_ns), scan=scan))
    for _ in range(40):
        if structure.wants_leftovers:
            structure.propose([])
        if not refine(structure, scans):
            break
    (segment,) = structure.segments()
    assert segment.radius == pytest.approx(true, abs=5e-4)
    assert structure.measured_radii == pytest.approx((true,), abs=5e-4)


def test_measured_radii__of_nothing():
    assert EvidenceStructure(load_config(), NOISE, measurements=10).measured_radii == ()
