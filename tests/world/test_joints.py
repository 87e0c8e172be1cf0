"""Where members meet."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest

from beamseg_batch.world.joints import _closest
from beamseg_batch.world.scene import Member, Scene, Section

ROUND = Section("round", 0.1, 0.1)


def between(start, end, bow=0.0, roll=0.0):
    return Member("", np.array(start, float), np.array(end, float), ROUND, roll, bow)


def joints_of(*members):
    return [
        (joint.members, joint.position.round(6).tolist()) for joint in Scene("", members).joints
    ]


def test_find_joints__two_that_cross():
    assert joints_of(between((-1, 0, 1), (1, 0, 1)), between((0.2, -1, 1.04), (0.2, 1, 1.04))) == [
        ((0, 1), [0.2, 0.0, 1.02])
    ]


def test_find_joints__two_that_pass_one_another():
    assert joints_of(between((-1, 0, 1), (1, 0, 1)), between((0, -1, 1.11), (0, 1, 1.11))) == []


def test_find_joints__five_at_one_place():
    rng = np.random.default_rng(2)
    place = np.array([0.3, -0.2, 1.4])
    members = [between(place, place + direction) for direction in rng.normal(size=(5, 3))]
    assert joints_of(*members) == [((0, 1, 2, 3, 4), place.round(6).tolist())]


def test_find_joints__two_places_of_the_same_member():
    rail = between((0, 0, 1), (2, 0, 1))
    posts = [between((x, 0, 0), (x, 0, 1)) for x in (0.0, 2.0)]
    assert joints_of(rail, *posts) == [((0, 1), [0.0, 0.0, 1.0]), ((0, 2), [2.0, 0.0, 1.0])]


def test_find_joints__one_that_continues_another():
    first, second = between((0, 0, 0), (0, 0, 1)), between((0, 0, 1.02), (0, 0, 2))
    assert joints_of(first, second) == [((0, 1), [0.0, 0.0, 1.01])]


def test_find_joints__two_that_lie_along_one_another():
    assert joints_of(between((0, 0, 0), (0, 0, 1)), between((0.1, 0, 0), (0.1, 0, 1))) == []


def test_find_joints__bent_member():
    bent = between((-1, 0, 1), (1, 0, 1), bow=0.2)
    post = between((0, 0, 1.18), (0, 0, 2))
    straight = between((-1, 0, 1), (1, 0, 1))
    assert joints_of(straight, post) == []
    ((members, (x, y, z)),) = joints_of(bent, post)
    assert members == (0, 1)
    assert (x, y, z) == pytest.approx((0.0, 0.0, 1.2), abs=1e-3)


def test_find_joints__none():
    assert Scene("").joints == ()


def test_find_joints__within_the_sum_of_the_radii():
    rail = between((-1, 0, 0), (1, 0, 0))
    assert joints_of(rail, between((0, -1, 0.099), (0, 1, 0.099))) == [((0, 1), [0.0, 0.0, 0.0495])]
    assert joints_of(rail, between((0, -1, 0.101), (0, 1, 0.101))) == []


def test_find_joints__end_on_the_others_surface():
    """The joint lies where the axes would meet."""
    rail = between((-1, 0, 0), (1, 0, 0))
    assert joints_of(rail, between((0, 0.09, 0), (0, 1, 0))) == [((0, 1), [0.0, 0.0, 0.0])]
    assert joints_of(rail, between((0, 0.11, 0), (0, 1, 0))) == []


@pytest.mark.parametrize("n_nodes", [2, 3])
def test_closest__of_two_chains_by_brute_force(n_nodes):
    rng = np.random.default_rng(4)
    share = np.linspace(0, 1, 101)[:, None]
    for first, second in combinations(rng.uniform(-1, 1, (8, n_nodes, 3)), 2):
        a, b = _closest(first, second)
        dense = [
            np.concatenate([p + share * (q - p) for p, q in pairwise(c)]) for c in (first, second)
        ]
        distances = np.linalg.norm(dense[0][:, None] - dense[1], axis=2)
        assert np.linalg.norm(a - b) <= distances.min() + 1e-12
        assert np.linalg.norm(a - b) == pytest.approx(distances.min(), abs=0.04)
        assert min(np.linalg.norm(dense[0] - a, axis=1)) < 0.02
        assert min(np.linalg.norm(dense[1] - b, axis=1)) < 0.02


def test_closest__parallel_and_apart():
    a, b = _closest(np.array([[0.0, 0, 0], [2, 0, 0]]), np.array([[2.5, 0.1, 0], [4.5, 0.1, 0]]))
    np.testing.assert_allclose([a, b], [[2.0, 0.0, 0.0], [2.5, 0.1, 0.0]], atol=1e-12)


@pytest.mark.parametrize("bow", [0.0, 0.01, -0.05])
def test_nodes__lie_on_the_bowed_axis(bow):
    member = between((-0.2, -0.8, 0.9), (0.1, 0.7, 1.4), bow, roll=0.6)
    nodes = member.nodes
    np.testing.assert_allclose(nodes[[0, -1]], [member.start, member.end])
    off = (nodes - (member.start + member.end) / 2) @ member.rotation[:, 1]
    assert np.max(np.sign(bow) * off, initial=0.0) <= abs(bow) + 1e-12
    assert np.max(np.sign(bow) * off) == pytest.approx(abs(bow), rel=1e-3)


def test_nodes__as_many_as_the_bow_needs():
    assert len(between((0, 0, 0), (1, 0, 0)).nodes) == 2
    assert 20 < len(between((0, 0, 0), (1, 0, 0), bow=0.05).nodes) < 200
