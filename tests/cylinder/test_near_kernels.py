"""Rays near beams, seen along their axes: the kernel beside its slow twin."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.cylinder.near_kernels import RAY_COLUMNS, BesideBeams, gather_near
from tests.cylinder.naive import line_distance
from tests.cylinder.scenes import cylinders_of, recorded, scene_of, some_beams, view_of

REACH = 0.15


def collected(scene, neighbours=None, *, width=None, most=10_000, scan=0, run=gather_near):
    """Rays by beam."""
    count = len(scene.anchors)
    view = view_of(scene, scene.width if width is None else width)
    beams = cylinders_of(scene)._replace(starts=scene.firsts, stops=scene.lasts)
    counts = np.zeros(count, np.int64)
    rays = np.empty((min(most, 1000) * count, RAY_COLUMNS))
    near = [[] for _ in range(count)] if neighbours is None else neighbours
    at = np.concatenate([[0], np.cumsum([len(each) for each in near])]).astype(np.int64)
    who = np.array([o for each in near for o in each], np.int64)
    args = (scan, most, rays, counts)
    assert run(view, beams, REACH, BesideBeams(at, who), *args) == counts.sum()
    return np.split(rays[: counts.sum()], np.cumsum(counts)[:-1])


def wanted(scene, j):
    """What one beam's rays should be: by vectors in space."""
    a, b = scene.anchors[j], scene.directions[j]
    found = []
    for point, ray in zip(np.asarray(scene.points, np.float64), scene.rays, strict=True):
        depth = np.linalg.norm(point) if np.isfinite(point).all() else np.inf
        w = point / depth if np.isfinite(depth) else ray
        apart, foot = line_distance(w, a, b)
        x = foot * w
        s = (x - a) @ b
        across = np.linalg.norm(w - (w @ b) * b)
        inside = np.all((x >= scene.low) & (x <= scene.high))
        if abs(apart) > REACH or across < 0.1 or foot * across <= 0 or foot <= REACH:
            continue
        if not inside or not scene.firsts[j] <= s <= scene.lasts[j]:
            continue
        behind = (depth - foot) * across
        if behind >= -REACH:
            noise = np.hypot(scene.noise[0], scene.noise[1] * x[0]) / w[0] * across
            found.append((abs(apart), behind, noise, s, w @ b / across))
    return np.array(found).reshape(-1, 5)


@pytest.mark.parametrize("organised", [True, False])
@pytest.mark.parametrize("compiled", [True, False])
def test_gather_near__agrees_with_its_twin(organised, compiled):
    rng = np.random.default_rng(4)
    scene = scene_of(some_beams(rng, 3), rng, wall=1.6)
    run = gather_near if compiled else gather_near.py_func
    for j, rays in enumerate(collected(scene, width=None if organised else 0, run=run)):
        want = wanted(scene, j)
        assert len(want) > 5
        np.testing.assert_allclose(np.abs(rays[:, 2]), want[:, 0], atol=1e-6)
        np.testing.assert_allclose(rays[:, 3], want[:, 1], atol=1e-6)
        np.testing.assert_allclose(rays[:, 4], want[:, 2], atol=1e-6)
        np.testing.assert_allclose(rays[:, 5], want[:, 3], atol=1e-6)
        np.testing.assert_allclose(rays[:, 9], want[:, 4], atol=1e-6)
        assert ((rays[:, 8] >= 0.0) & (rays[:, 8] < 1.0)).all()


def test_gather_near__a_return_lies_where_its_ray_says():
    rng = np.random.default_rng(5)
    scene = scene_of([(np.array([1.0, 0.1, -0.4]), np.array([1.1, 0.0, 0.4]), 0.05)], rng)
    (rays,) = collected(scene)
    hits = rays[np.abs(rays[:, 3]) < REACH]
    d = hits[:, :2]
    places = hits[:, 2:3] * np.stack([-d[:, 1], d[:, 0]], axis=1) + hits[:, 3:4] * d
    assert len(hits) > 5
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), 0.05, atol=0.03)
    assert abs(np.linalg.norm(places, axis=1).mean() - 0.05) < 0.01


def test_gather_near__no_more_than_asked_and_from_all_along():
    rng = np.random.default_rng(6)
    scene = scene_of([(np.array([1.0, 0.0, -0.4]), np.array([1.0, 0.0, 0.4]), 0.05)], rng)
    (every,), (some,) = collected(scene), collected(scene, most=20)
    assert len(some) <= 20 < len(every)
    assert np.ptp(some[:, 5]) > 0.5 * np.ptp(every[:, 5])
    (other,) = collected(scene, most=20, scan=1)
    assert not np.array_equal(some[:, 5], other[:, 5])


def test_gather_near__says_nothing_beside_another_beam():
    rng = np.random.default_rng(7)
    post = (np.array([1.0, 0.0, -0.4]), np.array([1.0, 0.0, 0.4]), 0.05)
    rail = (np.array([1.0, -0.4, 0.0]), np.array([1.0, 0.4, 0.0]), 0.05)
    scene = scene_of([post, rail], rng)
    whole, _ = collected(scene)
    rays, _ = collected(scene, [[1], []])
    assert 0 < len(rays) < len(whole)
    assert np.abs(rays[:, 5]).min() > 0.08
    assert np.abs(whole[:, 5]).min() < 0.08


def test_gather_near__leaves_out_what_stands_before_a_beam():
    rng = np.random.default_rng(8)
    scene = scene_of([(np.array([1.0, 0.0, -0.4]), np.array([1.0, 0.0, 0.4]), 0.05)], rng)
    scene.points = recorded(scene.rays * 0.5)
    (rays,) = collected(scene)
    assert len(rays) == 0
