"""Which beams lie near one another."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.structure.hypothesis import Beam
from beamseg_batch.structure.neighbours import Neighbours


def beam_at(*middle, way=(0.0, 0.0, 1.0), half=0.5):
    return Beam(np.array(middle, float), np.array(way), -half, half, 0.05)


def closest(one, other):
    """Distance of two beams' surfaces, near enough."""
    share = np.linspace(0.0, 1.0, 80)[:, None]
    p, q = (b.at(b.first) + share * (b.at(b.last) - b.at(b.first)) for b in (one, other))
    apart = np.linalg.norm(p[:, None] - q[None], axis=2).min()
    return apart - one.radius - other.radius


@pytest.mark.parametrize("seed", range(5))
def test_near__leaves_out_no_beam_that_is_near(seed):
    rng = np.random.default_rng(seed)
    ways = rng.normal(size=(40, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    beams = [beam_at(*rng.uniform(-2, 2, 3), way=way) for way in ways]
    neighbours = Neighbours(beams, reach=0.2)
    for beam in beams:
        near = neighbours.near(beam)
        wanted = [k for k, other in enumerate(beams) if closest(beam, other) < 0.2]
        assert set(wanted) <= set(near)
        assert len(near) < len(beams)


def test_near__of_far_beams_there_are_none():
    neighbours = Neighbours([beam_at(k, 0, 0) for k in range(100)])
    assert neighbours.near(beam_at(40, 0, 0)).tolist() == [40]
    assert neighbours.near(beam_at(40, 0, 5)).tolist() == []


def test_replace__moves_the_beam():
    neighbours = Neighbours([beam_at(0, 0, 0), beam_at(5, 0, 0)])
    neighbours.replace(0, beam_at(5, 0.1, 0))
    assert neighbours.near(beam_at(5, 0, 0)).tolist() == [0, 1]
    assert neighbours.near(beam_at(0, 0, 0)).tolist() == []
