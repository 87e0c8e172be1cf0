"""Intersections become joints of any number of segments."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamseg_batch.config import IntersectionConfig
from beamseg_batch.geometry import normalised
from beamseg_batch.structure.intersections import intersections_of
from beamseg_batch.structure.joints import _united, joints_of
from tests.structure.segments import between, known, turned

LEG = between([0, 0, 0], [0, 0, 3])
SLACK = IntersectionConfig(end_slack=0.06)


def found(segments, config=SLACK):
    return joints_of(segments, intersections_of(segments, config))


def beams_of(segments, config=SLACK):
    """Segments of each joint."""
    return [joint.segments for joint in found(segments, config)[0]]


def bracing(height, angle_deg=90.0, towards=(1.0, 0.0, 0.0), **options):
    """A beam that leaves the leg at a height, at an angle with it."""
    angle = np.radians(angle_deg)
    direction = np.sin(angle) * np.array(towards) + np.cos(angle) * np.array([0.0, 0.0, 1.0])
    foot = np.array([0.0, 0.0, height])
    return between(foot, foot + direction, **options)


def node(rng, count, scatter=0.0, size=1.0):
    """Beams that meet in one place, and the place: each is off by so much at both ends."""
    place = rng.uniform(-1.0, 1.0, 3)
    directions = spread_out(rng, count)
    offsets = rng.normal(0.0, scatter, (count, 2, 3)) if scatter else np.zeros((count, 2, 3))
    beams = [
        between(place - 0.02 * b + off[0], place + size * b + off[1])
        for b, off in zip(directions, offsets, strict=True)
    ]
    return beams, place


def spread_out(rng, count):
    """Unit vectors, of which no two lie within 25 degrees of the same line."""
    chosen = []
    while len(chosen) < count:
        one = normalised(rng.normal(size=3))
        if all(abs(one @ other) < np.cos(np.radians(25)) for other in chosen):
            chosen.append(one)
    return chosen


def naive_point(segments):
    """Point with the least sum of squared distances to all axes, by a stacked linear system."""
    rows, right = [], []
    for one in segments:
        across = np.eye(3) - np.outer(one.direction, one.direction)
        rows.append(across)
        right.append(across @ one.anchor)
    return np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]


def naive_groups(places, reaches, spreads):
    """Unite the closest two groups, in units of their limit, until none are close enough."""
    groups = [[k] for k in range(len(places))]

    def centre(group):
        return np.average(places[group], axis=0, weights=spreads[group] ** -2.0)

    def ratio(one, other):
        spread = [np.sqrt(1.0 / np.sum(spreads[group] ** -2.0)) for group in (one, other)]
        limit = max(*reaches[one], *reaches[other], np.hypot(*spread))
        return np.linalg.norm(centre(one) - centre(other)) / limit

    while len(groups) > 1:
        best = min(combinations(groups, 2), key=lambda pair: ratio(*pair))
        if ratio(*best) > 1.0:
            break
        groups = [group for group in groups if group not in best] + [sorted(best[0] + best[1])]
    return sorted(groups)


@pytest.mark.parametrize("seed", range(5))
def test_united__agrees_with_the_slow_twin(seed):
    rng = np.random.default_rng(seed)
    places = rng.uniform(-0.15, 0.15, (14, 3))
    reaches = rng.uniform(0.04, 0.12, 14)
    spreads = rng.uniform(0.005, 0.15, 14)
    groups = [group.tolist() for group in _united(places, reaches, spreads)]
    assert groups == naive_groups(places, reaches, spreads)
    assert 1 < len(groups) < 14


def test_joints_of__nothing_touches():
    assert joints_of([], ()) == ((), ())
    assert found([LEG]) == ((), ())


def test_joints_of__two_that_cross():
    segments = [LEG, between([-1, 0.04, 1], [1, 0.04, 1])]
    (joint,), (touch,) = found(segments)
    np.testing.assert_allclose(joint.position, [0.0, 0.02, 1.0], atol=1e-12)
    assert joint.segments == (0, 1)
    assert joint.t == pytest.approx((-0.5, 0.0))
    assert joint.residual == pytest.approx(0.02)
    assert np.isnan(joint.covariance).all()
    assert touch.joint == 0


@pytest.mark.parametrize("seed", range(8))
def test_joints_of__node_whose_pairs_scatter_is_one(seed):
    rng = np.random.default_rng(seed)
    segments, place = node(rng, 5, scatter=0.015)
    touching = intersections_of(segments, SLACK)
    places = np.array([one.position for one in touching])
    assert 0.02 < np.linalg.norm(places - place, axis=1).max() < 0.2
    (joint,), numbered = joints_of(segments, touching)
    assert joint.segments == (0, 1, 2, 3, 4)
    assert {one.joint for one in numbered} == {0}
    np.testing.assert_allclose(joint.position, naive_point(segments), atol=1e-9)
    assert np.linalg.norm(joint.position - place) < 0.03


@pytest.mark.parametrize("angle_deg", [90.0, 60.0, 45.0, 30.0])
@pytest.mark.parametrize(("apart", "joints"), [(0.08, 1), (0.12, 2)])
def test_joints_of__bracings_along_a_leg(angle_deg, apart, joints):
    """Both from the same side, and one from either side."""
    for towards in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)):
        upper = bracing(1.0 + apart, angle_deg, towards)
        segments = [LEG, bracing(1.0, 180.0 - angle_deg), upper]
        # Those from one side cross nothing but the leg; nor do they reach beyond it.
        assert len(found(segments, IntersectionConfig(epsilon=0.01))[0]) == joints


def test_joints_of__chain_of_bracings_does_not_become_one():
    segments = [LEG, *(bracing(1.0 + 0.09 * k) for k in range(6))]
    joints, touching = found(segments)
    assert len(joints) > 1
    for one in touching:
        assert np.linalg.norm(one.position - joints[one.joint].position) <= 0.1
    heights = sorted(joint.position[2] for joint in joints)
    assert min(np.diff(heights)) > 0.1


@pytest.mark.parametrize("bend_deg", [4.0, 5.0, 6.0])
@pytest.mark.parametrize("seed", range(6))
def test_joints_of__bend_that_a_third_beam_meets_is_one(bend_deg, seed):
    """The closest approach of the two pieces lies far along them, and they overlap there."""
    rng = np.random.default_rng(seed)
    turn = np.radians(bend_deg)
    tilted = np.array([np.sin(turn), 0.0, np.cos(turn)])

    def off():
        return rng.normal(0.0, 0.003, 3)

    place = np.array([0.0, 0.0, 1.0])
    segments = [
        between(off(), np.array([0.0, 0.0, 1.15]) + off()),
        between(place - 0.15 * tilted + off(), place + 1.2 * tilted + off()),
        between(place + off(), np.array([0.0, 1.0, 1.2]) + off()),
    ]
    (joint,), touching = found(segments)
    assert joint.segments == (0, 1, 2)
    assert len(touching) == 3
    assert np.linalg.norm(joint.position - place) < 0.03


def test_joints_of__beam_beside_a_bend_that_is_known_is_another():
    """The bend of unknown axes may be where the beam is; that of known ones is not."""
    turn = np.radians(2.0)
    tilted = np.array([np.sin(turn), 0.0, np.cos(turn)])
    segments = [
        between([0, 0, -1], [0, 0, 0.4]),
        between(-0.4 * tilted, 1.2 * tilted),
        bracing(0.25, towards=(0.0, 1.0, 0.0)),
    ]
    assert beams_of(segments) == [(0, 1, 2)]
    sure = [known(segment, 0.0003) for segment in segments]
    assert beams_of(sure) == [(0, 1), (0, 1, 2)]


def test_joints_of__thick_beams_reach_further():
    thin = [bracing(height, radius=0.02) for height in (1.0, 1.1)]
    assert beams_of([between([0, 0, 0], [0, 0, 3], radius=0.1), *thin]) == [(0, 1, 2)]
    assert beams_of([between([0, 0, 0], [0, 0, 3], radius=0.02), *thin]) == [(0, 1), (0, 2)]


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(2, 6))
def test_joints_of__random_node_is_one_joint_at_its_place(seed, count):
    segments, place = node(np.random.default_rng(seed), count)
    (joint,), touching = found(segments)
    assert joint.segments == tuple(range(count))
    assert len(touching) == count * (count - 1) // 2
    np.testing.assert_allclose(joint.position, place, atol=1e-9)
    assert joint.residual < 1e-9


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_joints_of__order_and_sense_of_the_segments_do_not_matter(seed):
    rng = np.random.default_rng(seed)
    segments = [beam for _ in range(4) for beam in node(rng, 4, scatter=0.01)[0]]
    order = rng.permutation(len(segments)).tolist()
    shuffled = [turned(segments[k]) if k % 2 else segments[k] for k in order]
    ours = {joint.segments: joint for joint in found(segments)[0]}
    theirs, touching = found(shuffled)
    assert [joint.segments for joint in theirs] == sorted(joint.segments for joint in theirs)
    assert len(ours) == len(theirs)
    for joint in theirs:
        same = ours[tuple(sorted(order[k] for k in joint.segments))]
        np.testing.assert_allclose(joint.position, same.position, atol=1e-9)
        assert joint.residual == pytest.approx(same.residual, abs=1e-9)
    for one in touching:
        assert {one.segment_1, one.segment_2} <= set(theirs[one.joint].segments)


def test_joints_of__the_better_known_axes_count_more():
    """Here axes miss one another by no more than is known of them."""
    exact = [LEG, between([-1, 0, 1], [1, 0, 1])]
    off = between([0.01, -1, 1.01], [0.01, 1, 1.01])
    alike, _ = found([*exact, off])
    weighted, _ = found([*(known(one, 0.0005) for one in exact), known(off, 0.02)])
    assert np.linalg.norm(alike[0].position - [0, 0, 1]) > 0.005
    np.testing.assert_allclose(weighted[0].position, [0, 0, 1], atol=0.0005)


def test_joints_of__axes_that_truly_miss_count_alike():
    """Beams laid on one another: the place is halfway, and known no better than that."""
    segments = [known(LEG, 0.0001), known(between([-1, 0.08, 1], [1, 0.08, 1]), 0.001)]
    (joint,), _ = found(segments)
    np.testing.assert_allclose(joint.position, [0.0, 0.04, 1.0], atol=1e-4)
    assert joint.residual == pytest.approx(0.04, abs=1e-4)
    assert 0.02 < np.sqrt(joint.covariance[1, 1]) < 0.06


def test_joints_of__one_axis_that_is_not_known_leaves_the_place_unknown():
    segments = [known(LEG, 0.001), between([-1, 0.01, 1], [1, 0.01, 1])]
    (joint,), _ = found(segments)
    assert np.isnan(joint.covariance).all()
    np.testing.assert_allclose(joint.position, [0.0, 0.005, 1.0], atol=1e-12)


def test_joints_of__covariance_is_that_of_the_place():
    """Beams moved and turned at random by their own deviations, many times."""
    rng = np.random.default_rng(5)
    segments, place = node(rng, 4)
    sigmas, slope = (0.0005, 0.001, 0.002, 0.003), 0.002
    errors, sizes = [], []
    for _ in range(400):
        moved = [
            known(moved_at_random(one, rng, sigma, slope), sigma, slope)
            for one, sigma in zip(segments, sigmas, strict=True)
        ]
        (joint,), _ = found(moved)
        error = joint.position - place
        errors.append(error @ np.linalg.solve(joint.covariance, error))
        sizes.append(np.sqrt(np.trace(joint.covariance)))
    assert 2.2 < np.mean(errors) < 3.8  # three on average, if the covariance is right
    assert max(sizes) < 0.01


def moved_at_random(segment, rng, sigma, slope):
    across = np.eye(3) - np.outer(segment.direction, segment.direction)
    anchor = segment.anchor + across @ rng.normal(0.0, sigma, 3)
    direction = normalised(segment.direction + across @ rng.normal(0.0, slope, 3))
    return between(anchor + segment.t_min * direction, anchor + segment.t_max * direction)


def test_joints_of__flat_angle_leaves_the_place_open_along_the_axes():
    turn = np.radians(5.0)
    tilted = np.array([np.sin(turn), 0.0, np.cos(turn)])
    segments = [
        known(between([0, 0, -1], [0, 0, 0]), 0.001),
        known(between([0, 0, 0], tilted), 0.001),
    ]
    (joint,), _ = found(segments)
    sigma_x, sigma_y, sigma_z = np.sqrt(joint.covariance.diagonal())
    assert sigma_x < 0.002
    assert sigma_y < 0.001
    assert sigma_z == pytest.approx(0.001 * np.sqrt(2) / np.sin(turn), rel=0.05)
