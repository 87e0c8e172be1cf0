"""Single rays against a cylinder, each kernel beside its slow twin."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from beamseg_batch.cylinder.ray_kernels import (
    enter_cylinder,
    finite_depth,
    fit_axis,
    near_line,
    on_cylinders,
    perpendiculars,
    solve_4,
)
from beamseg_batch.geometry import normalised
from tests.cylinder import naive
from tests.rays import camera_rays, seen_depths

SEEDS = st.integers(0, 2**32 - 1)
RADIUS = 0.05


def random_ray(rng):
    """Ray, axis and radius; about half of the rays hit."""
    a, b = rng.uniform((1, -1, -1), (3, 1, 1)), normalised(rng.normal(size=3))
    w = normalised(a + rng.uniform(-0.5, 0.5) * b + rng.normal(size=3) * 0.1)
    return w, a, b, rng.uniform(0.02, 0.2)


# --- one ray --------------------------------------------------------------------------


@given(SEEDS)
@settings(deadline=None)
def test_enter_cylinder__agrees_with_the_roots_of_a_quadratic(seed):
    w, a, b, radius = random_ray(np.random.default_rng(seed))
    apart, _ = naive.line_distance(w, a, b)
    assume(abs(abs(apart) - radius) > 1e-6 and np.linalg.norm(np.cross(w, b)) > 1e-2)
    entry, leave, s, lateral = enter_cylinder(*w, *a, *b, radius)
    met = naive.interval(w, a, b, radius)
    assert (met is None) == np.isnan(entry) == (abs(apart) > radius)
    if met is not None:
        assert (entry, leave) == pytest.approx(met, abs=1e-7)
        assert s == pytest.approx((entry * w - a) @ b, abs=1e-9)
        assert lateral == pytest.approx(abs(apart), abs=1e-8)


def test_enter_cylinder__misses_along_the_axis():
    along = enter_cylinder(1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, RADIUS)
    assert np.isnan(along[0])
    assert along[3] == np.inf


@given(SEEDS)
@settings(deadline=None)
def test_finite_depth__is_where_cylinder_and_slab_begin(seed):
    rng = np.random.default_rng(seed)
    w, a, b, radius = random_ray(rng)
    assume(np.linalg.norm(np.cross(w, b)) > 1e-2 and abs(w @ b) > 1e-3)
    first, last = np.sort(rng.uniform(-0.4, 0.4, 2))
    entry, leave, s, _ = enter_cylinder(*w, *a, *b, radius)
    assume(np.isfinite(entry))
    depth = finite_depth(entry, leave, s, w @ b, a @ b, first, last)
    met = naive.finite_interval(w, a, b, first, last, radius)
    if met is None:
        assert depth == np.inf
    else:
        assert depth == pytest.approx(met[0], abs=1e-7)


@pytest.mark.parametrize(("last", "met"), [(-0.1, np.inf), (0.1, 0.95)])
def test_finite_depth__of_a_ray_square_to_the_axis(last, met):
    assert finite_depth(0.95, 1.05, 0.0, 0.0, 0.0, -0.2, last) == met


# --- algebra --------------------------------------------------------------------------


@given(SEEDS)
@settings(deadline=None)
def test_perpendiculars__make_a_frame(seed):
    b = normalised(np.random.default_rng(seed).normal(size=3))
    u, v = perpendiculars(b)
    np.testing.assert_allclose(np.stack([u, v, b]) @ np.stack([u, v, b]).T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(np.cross(b, u), v, atol=1e-14)


@pytest.mark.parametrize("axis", range(3))
def test_perpendiculars__of_a_frame_axis(axis):
    u, v = perpendiculars(np.eye(3)[axis])
    assert abs(np.linalg.det(np.stack([u, v, np.eye(3)[axis]]))) == pytest.approx(1.0, abs=1e-15)


@given(SEEDS)
@settings(deadline=None)
def test_solve_4__agrees_with_numpy(seed):
    rng = np.random.default_rng(seed)
    half, right = rng.normal(size=(9, 4)), rng.normal(size=4)
    matrix = half.T @ half
    assume(np.linalg.cond(matrix) < 1e6)
    solution, regular = solve_4(matrix, right)
    assert regular
    np.testing.assert_allclose(solution, np.linalg.solve(matrix, right), rtol=1e-8, atol=1e-10)
    lower = np.tril(matrix)  # what `fit_axis` fills
    np.testing.assert_array_equal(solve_4(lower, right)[0], solution)


@pytest.mark.parametrize(
    "matrix",
    [
        np.zeros((4, 4)),
        np.ones((4, 4)),
        -np.eye(4),
        np.diag([1, 1, 1, 0.0]),
        np.full((4, 4), np.nan),
    ],
)
def test_solve_4__refuses_what_is_not_positive_definite(matrix):
    solution, regular = solve_4(matrix, np.ones(4))
    assert not regular
    assert not solution.any()


# --- an axis --------------------------------------------------------------------------


def seen_beam(rng, noise=0.0, size=24):
    """Rays that hit a beam, their depths, and its axis."""
    a = np.array([1.0, *rng.uniform(-0.2, 0.2, 2)])
    b = normalised(rng.normal(size=3) * (0.3, 1.0, 1.0))
    rays = camera_rays(size, size, 50.0)
    depths = seen_depths(np.zeros(3), rays, a - 0.4 * b, a + 0.4 * b, RADIUS)
    hit = np.isfinite(depths)
    return rays[hit], depths[hit] + rng.normal(0, noise, hit.sum()) if noise else depths[hit], a, b


def start_near(rng, a, b, shift=0.008, turn=0.02):
    return a + rng.uniform(-shift, shift, 3), normalised(b + rng.uniform(-turn, turn, 3))


def off_axis(points, a, b):
    return np.linalg.norm(np.cross(np.asarray(points) - a, b), axis=-1)


@pytest.mark.parametrize("seed", range(6))
def test_fit_axis__finds_the_axis_of_exact_depths(seed):
    rng = np.random.default_rng(seed)
    rays, depths, a, b = seen_beam(rng)
    start = start_near(rng, a, b)
    gates = np.array([0.1, 0.1, 0.05, 0.02, 0.02, 0.02])
    anchor, direction, count, rms = fit_axis(
        rays, depths, np.ones(len(rays)), *start, -0.42, 0.42, RADIUS, gates
    )
    assert count > 0.8 * len(rays)
    assert rms < 1e-6
    assert off_axis([anchor - 0.4 * direction, anchor + 0.4 * direction], a, b).max() < 1e-6


@pytest.mark.parametrize("seed", range(3))
def test_fit_axis__agrees_with_numerical_derivatives(seed):
    rng = np.random.default_rng(100 + seed)
    rays, depths, a, b = seen_beam(rng, noise=0.005, size=16)
    depths[::9] += rng.choice([-0.1, 0.1, np.inf], len(depths[::9]))
    scales = rng.uniform(0.5, 1.0, len(rays))
    args = (*start_near(rng, a, b), -0.3, 0.3, RADIUS, np.array([0.04, 0.03]))
    anchor, direction, count, rms = fit_axis(rays, depths, scales, *args)
    wanted = naive.fit_axis(rays, depths, scales, *args)
    np.testing.assert_allclose(anchor, wanted[0], atol=1e-7)
    np.testing.assert_allclose(direction, wanted[1], atol=1e-7)
    assert count == wanted[2]
    assert rms == pytest.approx(wanted[3], abs=1e-8)


def test_fit_axis__does_not_heed_outliers():
    rng = np.random.default_rng(5)
    rays, depths, a, b = seen_beam(rng, noise=0.001, size=32)
    depths[::4] += rng.uniform(0.1, 0.5, len(depths[::4]))
    gates = np.array([0.05, 0.02, 0.006, 0.004])
    anchor, *_ = fit_axis(rays, depths, np.ones(len(rays)), a, b, -0.42, 0.42, RADIUS, gates)
    assert off_axis(anchor, a, b) < 5e-4


@pytest.mark.parametrize("kept", [0, 7])
def test_fit_axis__says_so_where_too_few_rays_fit(kept):
    rays, depths, a, b = seen_beam(np.random.default_rng(6))
    depths[kept:] = np.inf
    anchor, direction, count, rms = fit_axis(
        rays, depths, np.ones(len(rays)), a, b, -0.5, 0.5, RADIUS, np.array([0.02])
    )
    assert (count, rms) == (0, 0.0)
    np.testing.assert_array_equal(anchor, a)
    np.testing.assert_array_equal(direction, b)


def test_fit_axis__says_so_where_the_rays_leave_it_open():
    rays, depths, a, b = seen_beam(np.random.default_rng(7))
    same = np.repeat(np.argmin(depths), 20)  # one ray, again and again
    found = fit_axis(
        rays[same], depths[same], np.ones(20), a, b, -0.5, 0.5, RADIUS, np.array([0.02])
    )
    assert found[2] == 0


# --- points ---------------------------------------------------------------------------


@given(SEEDS)
@settings(deadline=None, max_examples=40)
def test_on_cylinders__agrees_with_distances(seed):
    rng = np.random.default_rng(seed)
    points, reach = rng.uniform(-0.5, 0.5, (50, 3)), rng.uniform(0, 0.1)
    anchors, radii = rng.uniform(-0.5, 0.5, (4, 3)), rng.uniform(0.02, 0.2, 4)
    directions = np.array([normalised(rng.normal(size=3)) for _ in range(4)])
    ends = np.sort(rng.uniform(-0.5, 0.5, (4, 2)), axis=1)
    near = on_cylinders(points, anchors, directions, *ends.T.copy(), np.zeros((4, 3)), radii, reach)
    wanted = np.zeros(50, bool)
    for a, b, (first, last), radius in zip(anchors, directions, ends, radii, strict=True):
        s = (points - a) @ b
        wanted |= (
            (off_axis(points, a, b) < radius + reach) & (s >= first - reach) & (s <= last + reach)
        )
    np.testing.assert_array_equal(near, wanted)


@given(SEEDS)
@settings(deadline=None, max_examples=40)
def test_near_line__agrees_with_distances(seed):
    rng = np.random.default_rng(seed)
    points, a = rng.uniform(-0.5, 0.5, (60, 3)), rng.uniform(-0.5, 0.5, 3)
    b, reach = normalised(rng.normal(size=3)), rng.uniform(0.05, 0.5)
    first, last = np.sort(rng.uniform(-0.5, 0.5, 2))
    s = (points - a) @ b
    wanted = np.flatnonzero((off_axis(points, a, b) < reach) & (s > first) & (s < last))
    np.testing.assert_array_equal(near_line(points, a, b, first, last, reach), wanted)


def test_on_cylinders__of_none():
    none = np.empty((0, 3))
    assert not on_cylinders(
        np.zeros((3, 3)), none, none, *np.empty((2, 0)), none, np.empty(0), 0.1
    ).any()
