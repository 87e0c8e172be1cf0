"""The thinned cloud of a flight."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.structure import ThinnedCloud
from beamseg_batch.structure.cloud_kernels import claim_cells
from tests import naive


def scans(seed, count=20, size=500):
    rng = np.random.default_rng(seed)
    return [rng.uniform(-5, 5, (size, 3)).astype(np.float32) for _ in range(count)]


def thinned(clouds, limit, cell_size=0.05):
    cloud = ThinnedCloud(limit, cell_size)
    for points in clouds:
        cloud.add(points)
        assert len(cloud.points()) <= limit
    return cloud.points()


@pytest.mark.parametrize("limit", [8, 100, 3000, 100_000])
def test_thinned_cloud__is_bounded_and_keeps_given_points(limit):
    clouds = scans(1)
    points = thinned(clouds, limit)
    assert points.dtype == np.float32
    assert 0 < len(points) <= limit
    given = {tuple(row) for cloud in clouds for row in cloud.tolist()}
    assert {tuple(row) for row in points.tolist()} <= given


def test_thinned_cloud__is_deterministic():
    assert np.array_equal(thinned(scans(2), 700), thinned(scans(2), 700))


def test_thinned_cloud__keeps_the_first_point_of_each_cell():
    cloud = ThinnedCloud(10, 1.0)
    cloud.add(np.array([[0.25, 0, 0], [0.5, 0, 0], [1.0, 0, 0], [-0.25, 0, 0]], np.float32))
    cloud.add(np.array([[0.125, 0, 0], [5.0, 0, 0]], np.float32))
    assert cloud.points()[:, 0].tolist() == [0.25, 1.0, -0.25, 5.0]


def test_thinned_cloud__covers_the_whole_evenly():
    points = thinned(scans(3, count=40), 400)
    counts, _ = np.histogramdd(points, bins=[2, 2, 2], range=[(-5, 5)] * 3)
    assert counts.min() > 0.5 * counts.mean()


@pytest.mark.parametrize("limit", [1, 7])
def test_thinned_cloud__keeps_even_a_tiny_limit(limit):
    """Cells that meet at the origin never become one, however large they grow."""
    corners = np.array(np.meshgrid(*3 * [[-1.0, 1.0]])).reshape(3, -1).T.astype(np.float32)
    assert 1 <= len(thinned([corners], limit)) <= limit


def test_thinned_cloud__limit_zero_keeps_none():
    assert thinned(scans(4), 0).shape == (0, 3)


def test_thinned_cloud__without_points():
    cloud = ThinnedCloud(10, 0.1)
    cloud.add(np.empty((0, 3), np.float32))
    assert cloud.points().shape == (0, 3)
    assert cloud.points().dtype == np.float32


@pytest.mark.parametrize("cell_size", [0.05, 0.5, 3.0])
@pytest.mark.parametrize("seed", range(5))
def test_claim_cells__agrees_with_twin(seed, cell_size):
    """Cells that an earlier scan claimed stay claimed; the table is nearly full at last."""
    slots, held = np.full(1024, -1, np.int64), set()
    for points in scans(seed, count=4, size=250):
        expected, held = naive.first_in_their_cells(points, cell_size, held)
        assert claim_cells(points, cell_size, slots).tolist() == expected
    assert np.sum(slots != -1) == len(held)
