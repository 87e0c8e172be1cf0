"""Sections met by rays: the kernels beside slow twins."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.cylinder.section_kernels import (
    descend,
    ended_costs,
    enter_section,
    normal_equations,
    ray_costs,
)
from beamseg_batch.section import SHAPES, Section
from tests.section_rays import REACH, WORST, entries, first_of_solid, rays_at

SECTIONS = {
    "round": Section("round", 0.1, 0.1),
    "square": Section("square", 0.09, 0.12),
    "i": Section("i", 0.1, 0.12, 0.008, 0.01),
    "l": Section("l", 0.1, 0.08, 0.01, 0.01),
    "c": Section("c", 0.06, 0.12, 0.008, 0.01),
}
SHIFTS = np.eye(9)[[7, 8]]


def parameters(section, roll=0.4, centre=(0.01, -0.015)):
    """Edges of a section whose centre of area is at a place; (9,)."""
    plates = section.plates() or [(0.0, 0.0, section.width, section.height)]
    u = min(p[0] - p[2] / 2.0 for p in plates)
    v = min(p[1] - p[3] / 2.0 for p in plates)
    cos, sin = np.cos(roll), np.sin(roll)
    at = np.array([[cos, sin], [-sin, cos]]) @ np.array(centre) + (u, v)
    edges = [at[0], at[0] + section.width, at[1], at[1] + section.height]
    return np.array([*edges, roll, section.web, section.flange, 0.0, 0.0])


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("shape", SHAPES)
def test_enter_section__agrees_with_its_twin(shape, compiled):
    rng = np.random.default_rng(3)
    section, enter = SECTIONS[shape], enter_section if compiled else enter_section.py_func
    p = parameters(section, roll=0.0, centre=(0.0, 0.0))
    turns = rng.uniform(0.0, 2.0 * np.pi, 300)
    x, d = rng.uniform(-0.08, 0.08, (300, 2)), np.stack([np.cos(turns), np.sin(turns)], axis=1)
    x -= 0.3 * d  # from outside
    got = [enter(SHAPES.index(shape), p, *x[k], *d[k], -np.inf) for k in range(300)]
    along = np.array([depth for depth, _ in got])
    np.testing.assert_allclose(along, entries(section, x, d), atol=1e-12)
    assert np.isfinite(along).any()
    assert np.isinf(along).any()
    assert all(0.0 <= facing <= 1.0 for _, facing in got)


@pytest.mark.parametrize("shape", ["square", "i"])
def test_enter_section__along_a_side(shape):
    p = parameters(SECTIONS[shape], roll=0.0, centre=(0.0, 0.0))
    number = SHAPES.index(shape)
    assert enter_section(number, p, 0.0, -1.0, 0.0, 1.0, -np.inf)[0] == pytest.approx(0.94)
    assert enter_section(number, p, 0.2, -1.0, 0.0, 1.0, -np.inf)[0] == np.inf
    assert enter_section(number, p, -1.0, 0.2, 1.0, 0.0, -np.inf)[0] == np.inf


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("shape", SHAPES)
def test_ray_costs__agree_with_their_twin(shape, compiled):
    section = SECTIONS[shape]
    rays = rays_at(section, scans=20, each=20, noise=0.01)
    rays[::7, 3] = 0.02  # in front of it, or beside it
    rays[3::7, 3] = 1.0
    p, costs = parameters(section), np.empty(len(rays))
    run = ray_costs if compiled else ray_costs.py_func
    total = run(SHAPES.index(shape), p, rays, REACH, WORST, costs)
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    x = rays[:, 2:3] * np.stack([-rays[:, 1], rays[:, 0]], axis=1) - (0.01, -0.015)
    depths = entries(section, x @ turn, rays[:, :2] @ turn)
    with np.errstate(invalid="ignore"):
        squares = np.minimum(0.5 * ((rays[:, 3] - depths) / rays[:, 4]) ** 2, WORST)
    missed = np.where(rays[:, 3] < REACH, WORST, 0.0)
    np.testing.assert_allclose(costs, np.where(np.isinf(depths), missed, squares), atol=1e-6)
    assert total == pytest.approx(costs.sum())


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("shape", SHAPES)
def test_ended_costs__agree_with_a_solid(shape, compiled):
    section, ends = SECTIONS[shape], (-0.05, 0.08)
    rays = rays_at(section, scans=30, each=20, noise=0.01, ends=ends, reach_along=0.15)
    rays[:, 3] += np.random.default_rng(2).normal(0.0, 0.02, len(rays))
    p, costs = parameters(section), np.empty(len(rays))
    run = ended_costs if compiled else ended_costs.py_func
    run(SHAPES.index(shape), p, rays, REACH, WORST, *ends, costs)
    x = rays[:, 2:3] * np.stack([-rays[:, 1], rays[:, 0]], axis=1) - (0.01, -0.015)
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    solid = x @ turn, rays[:, :2] @ turn, rays[:, 5], rays[:, 9], ends
    depths = first_of_solid(section, *solid)
    with np.errstate(invalid="ignore"):
        squares = np.minimum(0.5 * ((rays[:, 3] - depths) / rays[:, 4]) ** 2, WORST)
    missed = np.where(rays[:, 3] < REACH, WORST, 0.0)
    wanted = np.where(np.isinf(depths), missed, squares)
    alike = np.isclose(costs, wanted, atol=0.4)  # the solid is met at steps of a millimetre
    assert alike.mean() > 0.98
    assert np.isfinite(depths).sum() > 30


def test_ray_costs__of_an_axis_that_leans():
    slopes = (0.06, -0.03)
    rays = rays_at(SECTIONS["i"], scans=30, each=20, noise=0.002, slopes=slopes)
    p, costs = parameters(SECTIONS["i"]), np.empty(len(rays))
    p[7:9] = slopes
    assert ray_costs(2, p, rays, REACH, WORST, costs) < 0.7 * len(rays)


def test_ray_costs__a_pixel_at_the_outline_may_hold_something_else():
    rays = rays_at(SECTIONS["square"], roll=0.0, centre=(0.0, 0.0), scans=2, each=1)
    rays[:, :2], rays[:, 2], rays[:, 3], costs = (1.0, 0.0), (0.0595, 0.03), 0.5, np.empty(2)
    p = parameters(SECTIONS["square"], 0.0, (0.0, 0.0))
    ray_costs(1, p, rays, REACH, WORST, costs)
    assert costs[0] == WORST
    rays[:, 6] = 0.002
    ray_costs(1, p, rays, REACH, WORST, costs)
    assert costs.tolist() == [0.0, WORST]


def test_ray_costs__a_grazed_surface_may_send_nothing_back():
    rays, costs = np.zeros((2, 10)), np.empty(2)
    angle = np.arcsin(0.1)  # against the upper side
    rays[:, :2], rays[:, 4] = (np.cos(angle), -np.sin(angle)), 0.01
    rays[:, 2] = 0.06 * np.cos(angle)
    rays[:, 3] = np.inf, 1.0
    ray_costs(1, parameters(SECTIONS["square"], 0.0, (0.0, 0.0)), rays, REACH, WORST, costs)
    assert costs.tolist() == [WORST / 2.0, WORST]


@pytest.mark.parametrize("compiled", [True, False])
def test_descend__finds_edges_that_are_off(compiled):
    section = SECTIONS["square"]
    rays = rays_at(section, scans=40, each=15, noise=0.002)
    p = parameters(section)
    start = p + np.array([0.004, 0.004, -0.003, 0.002, 0.0, 0, 0, 0, 0])
    run = descend if compiled else descend.py_func
    found = start.copy()
    cost = run(1, found, np.eye(4, 9), 0.004, 0.0005, rays, REACH, WORST)
    costs = np.empty(len(rays))
    assert cost == pytest.approx(ray_costs(1, found, rays, REACH, WORST, costs))
    assert cost < ray_costs(1, start, rays, REACH, WORST, costs)
    np.testing.assert_allclose(found[:4], p[:4], atol=0.0012)
    np.testing.assert_array_equal(found[4:], p[4:])


@pytest.mark.parametrize("shape", SHAPES)
def test_descend__leaves_what_is_possible(shape):
    rays = rays_at(SECTIONS[shape], scans=10, each=10)
    p = parameters(SECTIONS[shape])
    descend(SHAPES.index(shape), p, np.eye(9), 0.5, 0.1, rays, REACH, WORST)
    assert min(p[1] - p[0], p[3] - p[2]) >= 0.02
    assert max(abs(p[7]), abs(p[8])) <= 0.12


@pytest.mark.parametrize("compiled", [True, False])
def test_normal_equations__agree_with_differences(compiled):
    section = SECTIONS["round"]
    rays = rays_at(section, scans=6, each=20, noise=0.01)
    rays[:, 2] *= 0.1  # away from the outline
    p = parameters(section)
    turns = np.stack([-rays[:, 1], rays[:, 0]], axis=1)

    def depths(offset, slopes):
        x = rays[:, 2:3] * turns - (0.01, -0.015) - offset - rays[:, 5:6] * np.array(slopes)
        d = rays[:, :2] - rays[:, 9:10] * np.array(slopes)
        stretch = np.linalg.norm(d, axis=1)
        return entries(section, x, d / stretch[:, None]) / stretch

    rays[:, 3] = depths(np.zeros(2), (0.0, 0.0)) + 0.004
    cos, sin = np.cos(0.4), np.sin(0.4)
    shift = np.array([cos, cos, -sin, -sin, 0, 0, 0, 0, 0])  # along the beam's u
    moves = np.stack([shift, *SHIFTS])
    matrix, scores = np.zeros((3, 3)), np.zeros((6, 3))
    groups = rays[:, 7].astype(np.int64)
    run = normal_equations if compiled else normal_equations.py_func
    run(0, p, moves, rays, 3.0, matrix, scores, groups)
    h = 1e-6
    slopes = (
        np.stack(
            [
                (depths(np.array([h, 0.0]), (0, 0)) - depths(np.array([-h, 0.0]), (0, 0)))
                / (2 * h),
                (depths(np.zeros(2), (h, 0)) - depths(np.zeros(2), (-h, 0))) / (2 * h),
                (depths(np.zeros(2), (0, h)) - depths(np.zeros(2), (0, -h))) / (2 * h),
            ],
            axis=1,
        )
        / 0.01
    )
    np.testing.assert_allclose(matrix, slopes.T @ slopes, rtol=1e-3, atol=1e-3 * matrix.max())
    wanted = np.array([(0.4 * slopes[groups == g]).sum(axis=0) for g in range(6)])
    np.testing.assert_allclose(scores, wanted, atol=1e-3 * np.abs(wanted).max())


def test_normal_equations__leave_out_what_is_not_explained():
    rays = rays_at(SECTIONS["round"], scans=4, each=10)
    rays[:, 3] = 1.0
    matrix, scores = np.zeros((2, 2)), np.zeros((4, 2))
    groups = rays[:, 7].astype(np.int64)
    normal_equations(0, parameters(SECTIONS["round"]), SHIFTS, rays, 3.0, matrix, scores, groups)
    assert not matrix.any()
    assert not scores.any()
