"""Which of several radii a beam has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamseg_batch.config import load_config
from beamseg_batch.structure.evidence import EvidenceStructure
from beamseg_batch.structure.hypothesis import Beam
from beamseg_batch.structure.radius_trial import RadiusTrial
from tests.structure.answers import told
from tests.structure.segments import detections, jittered
from tests.structure.test_evidence import NOISE, POSES, RAIL, look, refine, shortened

RADII = (0.1, 0.05, 0.03)


def measured(true, assumed, *, radii=RADII, trial=True, seed=0):
    """Radius of a beam that was found by the search for another."""
    rng = np.random.default_rng(seed)
    start, end, _ = RAIL
    scans = [look(pose, [(start, end, true)], rng, stamp_ns=k) for k, pose in enumerate(POSES)]
    settings = [f"filtering.radii={list(radii)}", f"refinement.radii={str(trial).lower()}"]
    structure = EvidenceStructure(load_config("precise", None, settings), NOISE)
    behind = (assumed - true) * np.array([1.0, 0.0, 0.0])  # the surface is where it is seen
    sighting = shortened((np.array(start) + behind, np.array(end) + behind, assumed))
    for scan in scans:
        seen = replace(jittered(sighting, rng, 0.003), radius=assumed)
        found = detections(seen, stamp_ns=scan.stamp_ns)
        structure.update(replace(found, scan=scan))
    for _ in range(25):
        if structure.wants_leftovers:
            structure.propose([])
        if not refine(structure, scans):
            break
    (segment,) = structure.segments()
    return segment


# Taken for less than a third, it shares too few rays; the search for 0.1 comes first, though.
PAIRS = [(true, assumed) for true in RADII for assumed in RADII if true <= 3.0 * assumed]


@pytest.mark.parametrize(("true", "assumed"), PAIRS)
def test_RadiusTrial__finds_the_true_radius_from_any(true, assumed):
    segment = measured(true, assumed)
    assert segment.radius == true
    assert segment.measured_radius == pytest.approx(true, abs=0.002)
    offset = np.cross(np.array(RAIL[0]) - segment.anchor, segment.direction)
    assert np.linalg.norm(offset) < 0.002


def test_RadiusTrial__knows_that_scans_share_an_error():
    beam = Beam(np.zeros(3), np.array([1.0, 0.0, 0.0]), -0.5, 0.5, 0.05, scans=50)
    sums = told(beam, lambda s: np.zeros(2), noise=3.0)  # scans disagree by more than rays do
    sigmas = []
    for alike in (1.0, 4.0):
        trial = RadiusTrial([beam], [0.05], alike)
        while not trial.is_over:
            trial.take(sums)
        sigmas.append(np.sqrt(np.trace(trial.winners()[0].covariance_at(0.0))))
    assert sigmas[1] == pytest.approx(2.0 * sigmas[0], rel=0.1)


def test_RadiusTrial__of_one_radius_there_is_none():
    assert measured(0.05, 0.05, radii=(0.05,)).radius == 0.05
    assert measured(0.05, 0.03, radii=(0.03,)).radius == 0.03


def test_resized__keeps_what_is_seen():
    """Thicker, the axis moves away from the camera by as much as the surface comes nearer."""
    beam = Beam(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), -0.5, 0.5, 0.05)
    away = np.array([1.0, 0.0, 0.0])
    growth = np.array([*(away @ np.array(beam.normals).T), 0.0, 0.0])
    thicker = replace(beam, growth=growth).resized(0.08)
    assert thicker.radius == 0.08
    np.testing.assert_allclose(thicker.anchor, [1.03, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(thicker.direction, beam.direction, atol=1e-12)
