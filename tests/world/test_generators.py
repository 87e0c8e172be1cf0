"""Parametric structures, counted and measured."""

from __future__ import annotations

import math

import numpy as np
import pytest

from beamseg_batch.geometry import angle_between_deg
from beamseg_batch.world.generators import (
    angle_pairs,
    bridge_truss,
    lattice_tower,
    parallel_pairs,
    star_joint,
)
from beamseg_batch.world.scene import Section

THICK, THIN, OTHER, LAST = (Section("round", d, d) for d in (0.2, 0.1, 0.06, 0.04))


def test_lattice_tower__by_hand():
    members = {m.name: m for m in lattice_tower(6.0, 1.5, 0.9, 6, THICK, THIN, OTHER)}
    assert len(members) == 4 + 12 * 6
    np.testing.assert_allclose(members["leg 1"].start, [0.75, 0.75, 0.0])
    np.testing.assert_allclose(members["leg 1"].end, [0.45, 0.45, 6.0])
    np.testing.assert_allclose(members["horizontal 2.3"].start, [-0.65, -0.65, 2.0])
    np.testing.assert_allclose(members["horizontal 2.3"].end, [0.65, -0.65, 2.0])
    np.testing.assert_allclose(members["diagonal 6.4b"].start, [0.5, 0.5, 5.0])
    np.testing.assert_allclose(members["diagonal 6.4b"].end, [0.45, -0.45, 6.0])
    sections = [members[name].section for name in ("leg 4", "horizontal 1.1", "diagonal 1.1a")]
    assert sections == [THICK, THIN, OTHER]


@pytest.mark.parametrize("panels", [1, 2, 5, 24])
def test_bridge_truss__every_member_once(panels):
    members = bridge_truss(24.0, 2.0, 1.5, panels, THICK, THIN, OTHER, LAST)
    ends = {frozenset([tuple(m.start), tuple(m.end)]) for m in members}
    assert len(members) == len(ends) == len({m.name for m in members}) == 8 + 10 * panels
    points = np.array([[m.start, m.end] for m in members]).reshape(-1, 3)
    np.testing.assert_allclose(points.min(axis=0), [-12.0, -1.0, 0.0])
    np.testing.assert_allclose(points.max(axis=0), [12.0, 1.0, 1.5])


def test_bridge_truss__is_symmetric_and_has_its_sections():
    members = bridge_truss(8.0, 2.0, 1.5, 4, THICK, THIN, OTHER, LAST)
    rises = {m.name: m.end - m.start for m in members if m.name.startswith("diagonal left")}
    assert [rises[f"diagonal left {i}"][0] > 0 for i in (1, 2, 3, 4)] == [True, True, False, False]
    assert all(rise[2] == 1.5 for rise in rises.values())
    counts = [sum(m.section is section for m in members) for section in (THICK, THIN, OTHER, LAST)]
    assert counts == [4, 10, 24, 10]


def test_angle_pairs__meet_and_bend():
    angles = [6.0, 10.0, 15.0]
    members = angle_pairs([math.radians(a) for a in angles], 1.2, 0.8, THIN)
    for angle, y, lower, upper in zip(
        angles, (-0.8, 0.0, 0.8), members[::2], members[1::2], strict=True
    ):
        np.testing.assert_allclose(lower.start, [0.0, y, 0.0])
        np.testing.assert_allclose(upper.start, lower.start)
        bend = angle_between_deg(lower.rotation[:, 2], upper.rotation[:, 2])
        assert bend == pytest.approx(angle)
        assert lower.length == upper.length == pytest.approx(1.2)
        assert lower.end[2] < 0 < upper.end[2]
        assert lower.end[0] < 0
        assert lower.end[0] == pytest.approx(upper.end[0])


@pytest.mark.parametrize("count", range(2, 13))
def test_star_joint__no_two_members_are_alike_or_continue_one_another(count):
    members = star_joint(count, 0.9, THIN)
    assert len(members) == count
    assert all(not m.start.any() and m.length == pytest.approx(0.9) for m in members)
    tips = np.array([m.end / 0.9 for m in members])
    angles = np.degrees(np.arccos((tips @ tips.T)[np.triu_indices(count, 1)]))
    assert angles.min() > 36.0
    assert angles.max() < 155.0
    assert (tips[:, 2] > 0).all()


def test_parallel_pairs__are_parallel_and_apart():
    members = parallel_pairs([0.15, 0.3], 2.0, 1.0, THIN)
    for distance, y, left, right in zip(
        (0.15, 0.3), (-0.5, 0.5), members[::2], members[1::2], strict=True
    ):
        np.testing.assert_allclose(left.start - right.start, [0.0, distance, 0.0], atol=1e-12)
        np.testing.assert_allclose(left.end - right.end, [0.0, distance, 0.0], atol=1e-12)
        np.testing.assert_allclose((left.start + right.end) / 2, [0.0, y, 0.0], atol=1e-12)
        assert left.length == 2.0


def test_lattice_tower__every_brace_goes_from_leg_to_leg():
    legs, braces = np.split(np.array(lattice_tower(2.0, 1.0, 0.8, 2, THIN, THIN, THIN)), [4])

    def on_a_leg(point):
        return [
            leg.name
            for leg in legs
            if np.linalg.norm(np.cross(point - leg.start, leg.rotation[:, 2])) < 1e-9
        ]

    for brace in braces:
        (first,), (second,) = on_a_leg(brace.start), on_a_leg(brace.end)
        assert first != second
