"""The four criteria of the report's section 3.2.4, each on its own and by hand."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.config import ScreeningConfig
from beamseg_batch.detection.screening import (
    REJECTION_REASONS,
    Rejection,
    longest_run,
    min_number_of_points,
    screen,
    segment_from_points,
)
from beamseg_batch.detection.screening_kernels import longest_stretch, measure_line
from beamseg_batch.errors import ShapeError
from beamseg_batch.model import Segment
from tests import naive
from tests.detection.scans import DIAG_VOXEL, LEAF

RADIUS = 0.05
X = np.array([1.0, 0.0, 0.0])
LITERAL = ScreeningConfig(gap="reject")


def tube(length=1.0, count=61, spread=0.02):
    """Points zig-zagging around the x axis: straight, dense, without gaps."""
    x = np.linspace(0.0, length, count)
    y = spread * np.where(np.arange(count) % 2, 1.0, -1.0)
    z = spread * np.where(np.arange(count) // 2 % 2, 1.0, -1.0)
    return np.column_stack([x, y, z])


def judge(points, config=LITERAL, minvotes=2):
    return screen(np.asarray(points), X, RADIUS, LEAF, minvotes, config)


# --- each criterion alone -------------------------------------------------------------


def too_few_points():
    # 3 m need 15 points; 14 lie 0.23 m apart, which is a gap unless four diagonals are none.
    return tube(length=3.0, count=14)


def wrong_radius():
    # Pairs across the axis, at 0.11 m: more than radius + diag_voxel = 0.1077 m. Its
    # coefficient stays high on 4 m, which need 75 points.
    points = tube(length=4.0, count=121)
    points[60, 1:], points[61, 1:] = [0.11, 0.0], [-0.11, 0.0]
    return points


def gap():
    points = tube(length=2.0, count=121, spread=0.015)
    return points[(points[:, 0] < 0.9) | (points[:, 0] > 1.05)]


def low_pca_coeff():
    return tube(length=0.4, count=25, spread=0.03)


@pytest.mark.parametrize("line", [too_few_points, wrong_radius, gap, low_pca_coeff])
def test_screen__each_criterion_fires_alone(line):
    points = line()
    factor = 4.0 + 1e-6 if line is too_few_points else 2.0
    assert naive.failed_criteria(points, RADIUS, LEAF, 0.99, factor) == [line.__name__]
    verdict = judge(points, ScreeningConfig(gap="reject", max_gap_factor=factor))
    assert verdict == Rejection(line.__name__)
    assert not verdict


@pytest.mark.parametrize("count", range(2, 40))
def test_screen__line_without_gap_has_enough_points(count):
    """Six leaves a point are asked for, and neighbours lie within 2 sqrt(3) = 3.5 leaves.

    So the first criterion as written fires only where the third one would, too.
    """
    widest = 2 * DIAG_VOXEL * (count - 1)
    assert count > min_number_of_points(widest, RADIUS, LEAF)


def test_screen__criteria_are_those_that_are_named():
    assert set(REJECTION_REASONS) == {"too_few_points", "wrong_radius", "gap", "low_pca_coeff"}


@pytest.mark.parametrize("config", [LITERAL, ScreeningConfig()])
def test_screen__good_line_becomes_a_segment(config):
    points = tube()
    assert naive.failed_criteria(points, RADIUS, LEAF, 0.99) == []
    segment = judge(points, config)
    assert isinstance(segment, Segment)
    assert (segment.n_points, segment.radius, segment.n_scans) == (61, RADIUS, 1)
    assert segment.length == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("seed", range(40))
def test_screen__agrees_with_twin_on_random_lines(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(5, 120))
    length, spread = rng.uniform(0.1, 2.0), rng.uniform(0.005, 0.09)
    points = np.column_stack(
        [rng.uniform(0, length, count), rng.normal(0, spread, count), rng.normal(0, spread, count)]
    )
    failed = naive.failed_criteria(points, RADIUS, LEAF, 0.99)
    verdict = judge(points)
    if failed:
        assert isinstance(verdict, Rejection)
        assert verdict.reason == next(r for r in REJECTION_REASONS if r in failed)
    else:
        assert isinstance(verdict, Segment)


# --- thresholds by hand ---------------------------------------------------------------


def test_min_number_of_points__by_hand():
    # leaf 0.1 and radius 0.2: ratio 2, diag_voxel 0.1732. 2*0.2*3 / (2 * 4 * 0.03) = 5.
    assert min_number_of_points(3.0, 0.2, 0.1) == pytest.approx(5.0)
    # The report's own parameters, radius 0.05 and ratio 1.5, for one metre.
    assert min_number_of_points(1.0, 0.05, 0.05 / 1.5) == pytest.approx(5.0)


def test_min_number_of_points__depends_on_length_and_leaf_alone():
    assert min_number_of_points(1.0, 0.07, 0.03) == pytest.approx(
        min_number_of_points(1.0, 9.0, 0.03)
    )


def test_screen__min_points_factor_scales_the_smallest_number():
    points = tube(length=1.0, count=12)
    assert judge(points, ScreeningConfig(gap="reject", min_points_factor=2.0))
    assert (
        judge(points, ScreeningConfig(gap="reject", min_points_factor=3.0)).reason
        == "too_few_points"
    )


def test_segment_from_points__coefficients_by_hand():
    # Four corners of a 4 x 2 rectangle: covariance 16/3, 4/3, 0.
    points = np.array([[3.0, 3, 3], [3, 1, 3], [-1, 3, 3], [-1, 1, 3]])
    segment = segment_from_points(points, X, RADIUS)
    np.testing.assert_allclose(segment.pca_eig, [16 / 3, 4 / 3, 0.0], atol=1e-12)
    assert segment.pca_coeff == pytest.approx(0.8)
    np.testing.assert_allclose(segment.anchor, [1, 2, 3])
    np.testing.assert_allclose(segment.direction, X, atol=1e-12)
    assert (segment.t_min, segment.t_max) == (pytest.approx(-2.0), pytest.approx(2.0))
    np.testing.assert_allclose(segment.end_1, [-1, 2, 3], atol=1e-12)
    np.testing.assert_allclose(segment.end_2, [3, 2, 3], atol=1e-12)
    assert measure_line(points, X)[-1] == pytest.approx(1.0)


def test_segment_from_points__agrees_with_twin():
    points = np.random.default_rng(0).normal(size=(50, 3)) @ np.diag([1.0, 0.1, 0.05]) + [3, 2, 1]
    mean, axis, pca_coeff, eigenvalues = naive.principal_axis(points)
    segment = segment_from_points(points, axis, RADIUS)
    np.testing.assert_allclose(segment.anchor, mean)
    np.testing.assert_allclose(segment.direction, axis, atol=1e-10)
    np.testing.assert_allclose(segment.pca_eig, eigenvalues, rtol=1e-9)
    assert segment.pca_coeff == pytest.approx(pca_coeff)


def test_measure_line__agrees_with_twin():
    points = np.random.default_rng(1).normal(size=(50, 3)) @ np.diag([1.0, 0.1, 0.05]) + [3, 2, 1]
    mean, axis, _, eigenvalues = naive.principal_axis(points)
    anchor, direction, scatter, t, t_min, t_max, furthest = measure_line(points, -axis)
    np.testing.assert_allclose(anchor, mean)
    np.testing.assert_allclose(direction, -axis, atol=1e-10)
    np.testing.assert_allclose(scatter / 49, eigenvalues, rtol=1e-9)
    np.testing.assert_allclose(t, (mean - points) @ axis, atol=1e-9)
    assert (t_min, t_max) == (t.min(), t.max())
    assert furthest == pytest.approx(naive.line_distances(points, mean, axis).max())


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_segment_from_points__points_the_way_it_is_told(sign):
    segment = segment_from_points(tube(), sign * X, RADIUS)
    assert segment.direction @ (sign * X) > 0.99
    assert segment.t_min < 0.0 < segment.t_max


@pytest.mark.parametrize("count", [0, 1])
def test_segment_from_points__raise_on_fewer_than_two(count):
    with pytest.raises(ShapeError, match=f"at least 2 points, not {count}"):
        segment_from_points(np.zeros((count, 3)), X, RADIUS)


def test_screen__identical_points_are_no_segment():
    """What is left of their variance is rounding, and has no axis."""
    for point in np.random.default_rng(2).uniform(0, 1, (50, 3)):
        assert not judge(np.tile(point, (13, 1)), ScreeningConfig(), minvotes=12)


# --- gap ------------------------------------------------------------------------------


def test_longest_run__by_hand():
    t = np.array([0.0, 0.1, 0.2, 1.0, 1.1, 1.2, 1.3, 3.0])
    assert longest_run(t, 0.15).tolist() == [3, 4, 5, 6]
    assert longest_run(t, 1.0).tolist() == [0, 1, 2, 3, 4, 5, 6]
    assert longest_run(t, 2.0).tolist() == list(range(8))
    assert longest_run(t[::-1].copy(), 0.15).tolist() == [1, 2, 3, 4]


def test_longest_run__metres_count_and_not_points():
    t = np.array([0.0, 0.01, 0.02, 0.03, 0.04, 5.0, 5.1, 5.2])
    assert longest_run(t, 0.15).tolist() == [5, 6, 7]


def test_longest_run__first_of_equals_and_bound_included():
    t = np.array([0.0, 0.5, 2.0, 2.5])
    assert longest_run(t, 0.5).tolist() == [0, 1]
    assert longest_run(t, 1.5).tolist() == [0, 1, 2, 3], "exactly the largest gap is none"
    assert longest_run(np.array([3.0]), 0.5).tolist() == [0]


@pytest.mark.parametrize("seed", range(60))
def test_longest_stretch__agrees_with_twin(seed):
    """On a grid of quarters, so that equal lengths and gaps at the bound come about."""
    rng = np.random.default_rng(seed)
    ordered = np.sort(rng.integers(0, 40, int(rng.integers(1, 25)))) * 0.25
    max_gap = float(rng.integers(0, 8)) * 0.25
    assert longest_stretch(ordered, max_gap) == naive.stretch_of_most_metres(ordered, max_gap)


def test_screen__longest_run_is_kept_where_reject_refuses():
    points = gap()
    assert judge(points).reason == "gap"
    segment = judge(points, ScreeningConfig(gap="longest_run"))
    assert segment.length == pytest.approx(0.94, abs=0.02)
    assert segment.end_1[0] == pytest.approx(1.05, abs=0.03)
    assert segment.n_points == int(np.sum(points[:, 0] > 1.05)) == len(segment.points)


def test_screen__run_must_still_have_minvotes():
    points = np.concatenate([tube(0.3, 11), tube(0.2, 9) + np.array([2.0, 0, 0])])
    config = ScreeningConfig(gap="longest_run", min_pca_coeff=0.0)
    assert judge(points, config, minvotes=11)
    assert judge(points, config, minvotes=12).reason == "too_few_points"


def test_screen__gap_is_measured_along_the_axis():
    """Fault of the original: it compared distances from the sensor.

    On a beam across the view these are the same left and right of the middle, so that the
    points of one side fill the gap of the other.
    """
    half = np.linspace(0.0, 0.6, 37)
    left, right = half[half > 0.25], half[half < 0.4]
    y = np.concatenate([-left, right])
    points = np.column_stack([np.full(len(y), 1.0), y, np.zeros(len(y))])
    from_sensor = np.sort(np.linalg.norm(points, axis=1))
    assert np.diff(from_sensor).max() < 0.02
    assert screen(points, points[1] - points[0], RADIUS, LEAF, 2, LITERAL) == Rejection("gap")


def test_screen__dense_line_past_the_sensor_has_no_gap():
    """The other side of that fault: distances from the sensor also jump where nothing is."""
    points = tube(length=1.0, count=61)
    points[:, 0] -= 0.5
    assert isinstance(judge(points), Segment)


def test_measure_line__radius_is_over_all_points():
    """Fault of the original: it looked at the first and the last stored point only."""
    points = wrong_radius()
    segment = segment_from_points(points, X, RADIUS)
    outer = naive.line_distances(points[[0, -1]], segment.anchor, segment.direction)
    assert outer.max() < RADIUS
    assert measure_line(points, X)[-1] == pytest.approx(0.11, abs=1e-3)
    assert judge(points) == Rejection("wrong_radius")


def test_screen__radius_cannot_fire_within_the_reach_of_the_search():
    """Points within dx = diag_voxel of the axis differ from 0.05 m by less than diag_voxel."""
    assert abs(DIAG_VOXEL - RADIUS) < DIAG_VOXEL
    assert abs(0.0 - RADIUS) < DIAG_VOXEL


@pytest.mark.parametrize("direction", [np.eye(3)[1], np.eye(3)[2], np.array([0.0, 0.6, -0.8])])
def test_segment_from_points__beam_normal_to_x(direction):
    """Fault of the original: t = (p.x - a.x) / b.x, which divides by zero here."""
    points = np.outer(np.linspace(-0.4, 0.6, 31), direction) + np.array([1.0, 0.0, 0.0])
    segment = segment_from_points(points, direction, RADIUS)
    np.testing.assert_allclose(segment.end_1, points[0], atol=1e-12)
    np.testing.assert_allclose(segment.end_2, points[-1], atol=1e-12)
    assert isinstance(screen(points, direction, RADIUS, LEAF, 12, LITERAL), Segment)


def half_cylinder(length, radius, count=400, seed=0, depth=1.0):
    """Points of the half of a cylinder that is seen from far away, evenly by its width."""
    rng = np.random.default_rng(seed)
    along, side = rng.uniform(0, length, count), rng.uniform(-radius, radius, count)
    towards = depth * np.sqrt(radius**2 - side**2) + rng.normal(0, 0.01, count)
    return np.column_stack([along, side, towards])


def passes(points, radius, half_round):
    config = ScreeningConfig(half_round=half_round, radius_tolerance_factor=9.0)
    return bool(screen(points, np.array([1.0, 0.0, 0.0]), radius, radius / 1.5, 12, config))


@pytest.mark.parametrize("seed", range(5))
def test_screen__half_round_lets_short_thick_beams_pass(seed):
    points = half_cylinder(0.4, 0.1, seed=seed)
    assert not passes(points, 0.1, "none")
    assert passes(points, 0.1, "all")


@pytest.mark.parametrize("seed", range(5))
def test_screen__half_round_refuses_other_shapes(seed):
    rng = np.random.default_rng(seed)
    thin = half_cylinder(0.4, 0.05, seed=seed)
    flat = half_cylinder(0.4, 0.1, seed=seed, depth=0.0)
    wide = half_cylinder(0.4, 0.115, seed=seed, depth=0.0)
    clump = rng.normal(0.0, [0.1, 0.06, 0.06], (400, 3))
    stub = half_cylinder(0.25, 0.1, seed=seed)
    for points in (thin, flat, wide, clump, stub):
        assert not passes(points, 0.1, "all")


def test_screen__half_round_or_not_long_beams_pass():
    points = half_cylinder(2.5, 0.1)
    assert passes(points, 0.1, "none")
    assert passes(points, 0.1, "all")
