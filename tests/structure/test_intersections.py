"""Algorithm 2 of the report against the linear system of its section 3.2.7."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamseg_batch.config import IntersectionConfig
from beamseg_batch.geometry import normalised
from beamseg_batch.structure.arrays import SegmentArrays
from beamseg_batch.structure.axis_kernels import closest_approaches
from beamseg_batch.structure.intersections import intersections_of
from beamseg_batch.structure.joints import joints_of
from tests import naive
from tests.structure.segments import between, random_segment, turned

DEFAULT = IntersectionConfig()


def found(segments, config=DEFAULT):
    return intersections_of(segments, config)


@pytest.mark.parametrize("seed", range(6))
def test_intersections_of__agree_with_the_linear_system(seed):
    rng = np.random.default_rng(seed)
    segments = [random_segment(rng, size=0.6) for _ in range(40)]
    wanted = {}
    for i, one in enumerate(segments):
        for j in range(i + 1, len(segments)):
            solved = naive.intersection(one, segments[j], 0.15)
            if solved:
                wanted[i, j] = solved
    got = found(segments, IntersectionConfig(epsilon=0.15))
    assert [(touch.segment_1, touch.segment_2) for touch in got] == list(wanted)
    assert len(wanted) > 8
    for touch, (t1, t2, point, distance) in zip(got, wanted.values(), strict=True):
        assert touch.t_1 == pytest.approx(t1, abs=1e-9)
        assert touch.t_2 == pytest.approx(t2, abs=1e-9)
        assert touch.distance == pytest.approx(distance, abs=1e-9)
        np.testing.assert_allclose(touch.position, point, atol=1e-9)


def test_intersections_of__by_hand():
    one = between([0, 0, 0], [4, 0, 0], anchor=0.25)
    two = between([3, -1, 0.06], [3, 3, 0.06], anchor=0.75)
    (touch,) = found([one, two])
    assert (touch.segment_1, touch.segment_2) == (0, 1)
    assert touch.t_1 == pytest.approx(2.0)
    assert touch.t_2 == pytest.approx(-2.0)
    assert touch.distance == pytest.approx(0.06)
    assert touch.angle_deg == pytest.approx(90.0)
    np.testing.assert_allclose(touch.position, [3, 0, 0.03], atol=1e-12)
    np.testing.assert_allclose(one.anchor + touch.t_1 * one.direction, [3, 0, 0], atol=1e-12)


def test_intersections_of__order_of_the_segments_swaps_the_two():
    segments = [between([0, 0, 0], [2, 0, 0]), between([1, -1, 0], [1, 0.5, 0], anchor=0.1)]
    (one,), (other,) = found(segments), found(segments[::-1])
    assert (one.segment_1, one.segment_2) == (other.segment_1, other.segment_2) == (0, 1)
    assert (one.t_1, one.t_2) == pytest.approx((other.t_2, other.t_1))


@pytest.mark.parametrize(("distance", "touches"), [(0.0, True), (0.099, True), (0.101, False)])
def test_intersections_of__touch_within_both_radii(distance, touches):
    segments = [between([0, 0, 0], [2, 0, 0]), between([1, -1, distance], [1, 1, distance])]
    assert bool(found(segments)) is touches


def test_intersections_of__several_radii_add_up():
    segments = [
        between([0, 0, 0], [2, 0, 0], radius=0.1),
        between([1, -1, 0.12], [1, 1, 0.12], radius=0.03),
        between([1.5, -1, 0.14], [1.5, 1, 0.14], radius=0.03),
    ]
    assert [i.segment_2 for i in found(segments)] == [1]


@pytest.mark.parametrize(("end", "touches"), [(0.001, True), (-0.001, False), (-0.06, False)])
def test_intersections_of__only_within_both_ends(end, touches):
    tee = [between([0, 0, 0], [2, 0, 0]), between([1, -1, 0], [1, end, 0])]
    assert bool(found(tee)) is touches
    assert bool(found(tee[::-1])) is touches


def test_intersections_of__end_slack_reaches_beyond_the_ends():
    tee = [between([0, 0, 0], [2, 0, 0]), between([1, -1, 0], [1, -0.05, 0])]
    assert not found(tee, IntersectionConfig(end_slack=0.04))
    (touch,) = found(tee, IntersectionConfig(end_slack=0.06))
    assert touch.t_2 == pytest.approx(0.525)


def test_intersections_of__parallel_segments_do_not_touch():
    along = between([0, 0, 0], [2, 0, 0])
    for other in (along, turned(along), between([0, 0.01, 0], [2, 0.01, 0]),
                  between([0, -5e-4, 0], [2, 5e-4, 0])):  # fmt: skip
        assert found([along, other]) == ()
    assert found([along, between([0, -0.01, 0], [2, 0.01, 0])])


def test_intersections_of__direction_has_no_sign():
    one, two = between([0, 0, 0], [2, 0.3, 0]), between([1, -1, 0.02], [1.2, 1, 0.02])
    for other in ([turned(one), two], [one, turned(two)], [turned(one), turned(two)]):
        (touch,) = found(other)
        np.testing.assert_allclose(touch.position, found([one, two])[0].position, atol=1e-12)


def test_closest_approaches__parallel_lines_are_nan():
    rows = SegmentArrays([between([0, 1, 0], [-1, 1, 0])]).rows
    t_1, t_2, distance, sine = closest_approaches(rows, np.zeros(3), np.array([1.0, 0, 0]))
    assert np.isnan([t_1[0], t_2[0], distance[0]]).all()
    assert sine[0] == 0.0


@pytest.mark.parametrize("count", [0, 1])
def test_intersections_of__fewer_than_two_segments(count):
    assert found([between([0, 0, 0], [1, 0, 0])] * count) == ()


# --- bent segments --------------------------------------------------------------------


def bent(segment, bow, sigma=0.001):
    return replace(segment, bow_vector=np.array(bow, np.float64), sigma_bow=sigma)


@pytest.mark.parametrize("anchor", [0.0, 0.5])
def test_intersections_of__meet_a_bent_segment_where_it_is(anchor):
    """Its chord is 0.12 m from the rail that it touches."""
    post = bent(between([0, 0, 0], [0, 0, 2], anchor=anchor), [0.12, 0, 0])
    rail = between([0.05, 0, 1.5], [1, 0, 1.5])
    for segments in ([post, rail], [rail, post]):
        (touch,) = found(segments)
        np.testing.assert_allclose(touch.position, [0.09, 0, 1.5], atol=1e-3)
        assert touch.angle_deg == pytest.approx(90.0 - np.degrees(np.arctan(0.12)), abs=0.01)
        (joint,) = joints_of(segments, [touch])[0]
        np.testing.assert_allclose(joint.position, [0.09, 0, 1.5], atol=1e-3)


def test_intersections_of__chord_of_a_bent_segment_touches_nothing():
    post = bent(between([0, 0, 0], [0, 0, 2]), [0.12, 0, 0])
    rail = between([-1, 0, 1], [0.01, 0, 1])
    assert found([post, rail]) == ()
    assert len(found([bent(post, [0.12, 0, 0], sigma=0.1), rail])) == 1  # is not bent for sure


def test_tangent__touches_a_bent_segment():
    post = bent(between([0, 0, 0], [0, 0, 2], anchor=0.25), [0.1, 0, 0])
    line = post.tangent(1.0)
    np.testing.assert_allclose(line.anchor + 1.0 * line.direction, [0.075, 0, 1.5], atol=1e-12)
    np.testing.assert_allclose(line.direction, normalised(np.array([-0.1, 0, 1.0])), atol=1e-12)
    assert post.bow == pytest.approx(0.1)
    assert not line.is_bent
    straight = between([0, 0, 0], [0, 0, 2])
    assert straight.tangent(0.3) is straight
    assert np.isnan(straight.bow)
