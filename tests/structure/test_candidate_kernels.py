"""The candidate that a sighting belongs to: the kernel beside its slow twin."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.geometry import distances_to_line, normalised
from beamseg_batch.structure.candidate_kernels import nearest_candidate

OFFSET, COSINE, BRIDGE = 0.3, np.cos(np.radians(25.0)), 0.4


def naive_nearest(rows, end_1, end_2, radius):
    """Ask each candidate in words, then take the nearest."""
    ends, sighting = np.array([end_1, end_2]), normalised(end_2 - end_1)
    best, found = OFFSET, -1
    for g, row in enumerate(rows):
        anchor, direction, first, last = row[:3], row[3:6], row[6], row[7]
        furthest = distances_to_line(ends, anchor, direction).max()
        along = (ends - anchor) @ direction
        gap = max(along.min() - last, first - along.max())
        alike = row[8] == radius and abs(direction @ sighting) > COSINE
        if alike and gap < BRIDGE and furthest < best:
            best, found = furthest, g
    return found


@pytest.mark.parametrize("seed", range(5))
def test_nearest_candidate__agrees_with_its_twin(seed):
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(40):
        directions = [normalised(rng.normal(size=3) * (1, 0.3, 0.3)) for _ in range(30)]
        ends = np.sort(rng.uniform(-0.6, 0.6, (30, 2)), axis=1)
        radii = rng.choice([0.05, 0.1], 30)[:, None]
        rows = np.column_stack([rng.uniform(-0.5, 0.5, (30, 3)), directions, ends, radii])
        middle, way = rng.uniform(-0.3, 0.3, 3), normalised(rng.normal(size=3) * (1, 0.2, 0.2))
        sighting = (middle - 0.2 * way, middle + 0.2 * way, 0.05)
        found.append(nearest_candidate(rows, *sighting, OFFSET, COSINE, BRIDGE))
        assert found[-1] == naive_nearest(rows, *sighting)
    assert -1 in found
    assert max(found) > 0


def test_nearest_candidate__of_none():
    ends = (np.zeros(3), np.ones(3))
    assert nearest_candidate(np.empty((0, 9)), *ends, 0.05, OFFSET, COSINE, BRIDGE) == -1
