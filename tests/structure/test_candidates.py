"""Sightings gathered into candidates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamseg_batch.geometry import angle_between_deg, distances_to_line
from beamseg_batch.structure.candidate_kernels import STATE_SIZE, grow
from beamseg_batch.structure.candidates import Candidates
from tests.structure.segments import between, jittered, turned

SIGMA = 0.005  # offsets up to 3 cm are one beam's
BEAM = between([0, 0, 1], [1, 0, 1])


def gather(*segments):
    candidates = Candidates(SIGMA)
    for segment in segments:
        candidates.add(segment)
    return candidates


def test_candidates__start_empty():
    assert len(gather()) == 0
    assert gather().beams(0) == []


def test_beams__of_one_sighting_are_that_sighting():
    (beam,) = gather(BEAM).beams(1)
    np.testing.assert_allclose(beam.ends, [BEAM.end_1, BEAM.end_2], atol=1e-12)
    assert beam.radius == BEAM.radius


@pytest.mark.parametrize(
    ("other", "count"),
    [
        (turned(BEAM), 1),
        (between([0, 0.029, 1], [1, 0.029, 1]), 1),
        (between([0, 0.031, 1], [1, 0.031, 1]), 2),
        (between([1.35, 0, 1], [2, 0, 1]), 1),
        (between([1.45, 0, 1], [2, 0, 1]), 2),
        (between([-1, 0, 1], [-0.35, 0, 1]), 1),
        (between([-1, 0, 1], [-0.45, 0, 1]), 2),
        (between([0.4, 0, 1], [0.6, 0.0135, 1]), 1),
        (between([0.4, 0, 1], [0.6, 0.0145, 1]), 2),
        (between([0.5, -0.5, 1], [0.5, 0.5, 1]), 2),
        (replace(BEAM, radius=0.1), 2),
    ],
)
def test_add__tells_one_beam_from_two(other, count):
    assert len(gather(BEAM, other)) == count


def test_add__takes_the_nearest_of_two():
    near, far = between([0, 0.05, 1], [1, 0.05, 1]), BEAM
    candidates = gather(far, near, between([0, 0.028, 1], [1, 0.028, 1]))
    assert len(candidates) == 2
    (beam,) = candidates.beams(2)
    assert 0.03 < beam.anchor[1] < 0.05


def test_beams__are_the_weighted_mean_and_span_all_sightings():
    light = between([-0.2, 0.02, 1], [0.8, 0.02, 1], n_points=100, stamp_ns=7)
    (beam,) = gather(replace(BEAM, n_points=300), light).beams(2)
    assert beam.first_seen_ns == 0
    assert beam.last_seen_ns == 7
    assert min(end[0] for end in beam.ends) == pytest.approx(-0.2, abs=2e-3)
    assert max(end[0] for end in beam.ends) == pytest.approx(1.0, abs=2e-3)
    assert beam.anchor[1] == pytest.approx(0.005, abs=1e-9)


def test_beams__average_the_noise_of_many_sightings():
    rng = np.random.default_rng(0)
    candidates = gather(*(jittered(BEAM, rng, 0.004) for _ in range(100)))
    assert len(candidates) == 1
    (beam,) = candidates.beams(100)
    assert candidates.beams(101) == []
    assert angle_between_deg(beam.direction, BEAM.direction) < 0.15
    assert distances_to_line(np.array(beam.ends), BEAM.anchor, BEAM.direction).max() < 2e-3


def test_add__holds_more_candidates_than_it_has_room_for_at_first():
    columns = [between([0, float(k), 0], [0, float(k), 2]) for k in range(40)]
    candidates = gather(*columns, *columns)
    assert len(candidates) == 40
    assert [beam.anchor[1] for beam in candidates.beams(2)] == pytest.approx(list(range(40)))


@pytest.mark.parametrize("run", [grow, grow.py_func])
@pytest.mark.parametrize("seed", range(3))
def test_grow__agrees_with_lapack(run, seed):
    rng = np.random.default_rng(seed)
    state, row = np.zeros(STATE_SIZE), np.zeros(9)
    points, weights, forward = [], [], None
    for _ in range(5):
        segment = jittered(BEAM, rng, 0.01)
        forward = forward if points else segment.direction
        weight = float(rng.integers(5, 50))
        run(state, row, segment.anchor, segment.direction, segment.t_min, segment.t_max, weight)
        points += [segment.end_1, segment.midpoint, segment.end_2]
        weights += [weight] * 3
        mean = np.average(points, axis=0, weights=weights)
        scatter = np.cov(np.transpose(points), aweights=weights, ddof=0)
        axis = np.linalg.eigh(scatter)[1][:, 2]
        np.testing.assert_allclose(row[:3], mean, atol=1e-12)
        assert abs(row[3:6] @ axis) == pytest.approx(1.0, abs=1e-12)
        assert row[3:6] @ forward > 0.99
        along = (np.array(points) - mean) @ row[3:6]
        # The ends so far lie on the axis so far, hardly off the new one.
        np.testing.assert_allclose(row[6:8], [along.min(), along.max()], atol=1e-3)
