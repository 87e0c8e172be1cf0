"""Segments cut at their joints."""

from __future__ import annotations

from itertools import groupby, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamseg_batch.config import IntersectionConfig
from beamseg_batch.model import Member
from beamseg_batch.structure.intersections import intersections_of
from beamseg_batch.structure.joints import joints_of
from beamseg_batch.structure.members import members_of
from tests.structure.segments import between, random_segment

LEG = between([0, 0, 0], [0, 0, 3], anchor=0.0)


def post(height, radius=0.05):
    return between([0, 0, height], [1, 0, height], anchor=0.0, radius=radius)


def cut(*segments, end_slack=0.06):
    config = IntersectionConfig(end_slack=end_slack)
    joints, _ = joints_of(segments, intersections_of(segments, config))
    return members_of(segments, joints, end_slack)


def of_leg(members):
    return [(m.t_1, m.t_2, m.joint_1, m.joint_2) for m in members if m.segment == 0]


def test_members_of__without_joints_is_the_whole():
    assert members_of([LEG], ()) == (Member(0, 0.0, 3.0, None, None),)
    assert members_of([], ()) == ()


def test_members_of__between_joints_and_ends():
    members = cut(LEG, post(1.0), post(2.5))
    assert of_leg(members) == [
        (0.0, pytest.approx(1.0), None, 0),
        (pytest.approx(1.0), pytest.approx(2.5), 0, 1),
        (pytest.approx(2.5), 3.0, 1, None),
    ]
    assert [(m.segment, m.joint_1, m.joint_2) for m in members[3:]] == [(1, 0, None), (2, 1, None)]
    assert members[0].length == pytest.approx(1.0)


@pytest.mark.parametrize("beyond", [-0.05, 0.0, 0.05, 0.09])
def test_members_of__joint_near_an_end_is_the_ends_own(beyond):
    members = cut(LEG, post(beyond), post(3.0 - beyond))
    assert of_leg(members) == [(0.0, 3.0, 0, 1)]


def test_members_of__joint_further_from_an_end_leaves_a_piece():
    assert [m[2:] for m in of_leg(cut(LEG, post(0.11)))] == [(None, 0), (0, None)]


def test_members_of__thick_beams_and_slack_reach_further():
    assert of_leg(cut(LEG, post(0.11, radius=0.08))) == [(0.0, 3.0, 0, None)]
    assert of_leg(cut(LEG, post(0.11), end_slack=0.12)) == [(0.0, 3.0, 0, None)]


def test_members_of__joint_is_not_at_both_ends_of_a_short_segment():
    short = between([0, 0, 0], [0, 0, 0.15], anchor=0.0)
    assert of_leg(cut(short, post(0.06))) == [(0.0, 0.15, 0, None)]
    assert of_leg(cut(short, post(0.09))) == [(0.0, 0.15, None, 0)]
    assert of_leg(cut(short, post(0.0), post(0.15))) == [(0.0, 0.15, 0, 1)]


def test_members_of__second_joint_within_reach_of_an_end_cuts():
    members = of_leg(cut(LEG, post(-0.05), post(0.08)))
    assert members == [(0.0, pytest.approx(0.08), 0, 1), (pytest.approx(0.08), 3.0, 1, None)]


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1))
def test_members_of__tile_every_segment_without_stubs(seed):
    rng = np.random.default_rng(seed)
    segments = [random_segment(rng, size=0.5) for _ in range(25)]
    members = cut(*segments)
    assert list(members) == sorted(members, key=lambda m: (m.segment, m.t_1))
    by_segment = {k: list(group) for k, group in groupby(members, key=lambda m: m.segment)}
    assert list(by_segment) == list(range(len(segments)))
    for k, parts in by_segment.items():
        assert (parts[0].t_1, parts[-1].t_2) == (segments[k].t_min, segments[k].t_max)
        assert min(part.length for part in parts) >= segments[k].radius - 1e-12
        for one, other in pairwise(parts):
            assert (one.t_2, one.joint_2) == (other.t_1, other.joint_1)
            assert one.joint_2 is not None
        for part in parts:
            assert part.joint_1 is None or part.joint_1 != part.joint_2
