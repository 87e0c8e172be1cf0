"""Lines and rigid transforms against plain formulas."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamseg_batch.errors import BeamsegError, ShapeError
from beamseg_batch.geometry import (
    RigidTransform,
    angle_between_deg,
    clusters,
    connected,
    covariance_along,
    distances_to_line,
    interpolate_quaternion,
    line_parameters,
    matrix_from_quaternion,
    matrix_from_rpy,
    normalised,
    project_onto_line,
    unknown,
)
from tests import naive

SEEDED = settings(derandomize=True, deadline=None, max_examples=50, database=None)
SEEDS = st.integers(0, 2**32 - 1)


def random_quaternion(rng):
    return normalised(rng.normal(size=4))


def random_transform(rng):
    return RigidTransform.from_quaternion(rng.normal(size=3), random_quaternion(rng))


# --- lines ----------------------------------------------------------------------------


@SEEDED
@given(seed=SEEDS)
def test_distances_to_line__agree_with_twin(seed):
    rng = np.random.default_rng(seed)
    points, anchor, direction = (
        rng.normal(size=(20, 3)),
        rng.normal(size=3),
        normalised(rng.normal(size=3)),
    )
    expected = naive.line_distances(points, anchor, direction)
    np.testing.assert_allclose(distances_to_line(points, anchor, direction), expected, atol=1e-12)
    feet = project_onto_line(points, anchor, direction)
    np.testing.assert_allclose((points - feet) @ direction, 0.0, atol=1e-12)
    t = line_parameters(points, anchor, direction)
    np.testing.assert_allclose(anchor + t[:, None] * direction, feet, atol=1e-12)


def test_line_parameters__direction_normal_to_x():
    points = np.array([[1.0, -0.5, 2.0], [1.0, 3.0, 2.0]])
    t = line_parameters(points, np.array([1.0, 0, 2]), np.array([0.0, 1, 0]))
    assert t.tolist() == [-0.5, 3.0]


def test_line_parameters__no_points():
    assert line_parameters(np.empty((0, 3)), np.zeros(3), np.eye(3)[0]).shape == (0,)


@pytest.mark.parametrize("function", [line_parameters, project_onto_line, distances_to_line])
@pytest.mark.parametrize("shape", [(3,), (2, 2), (1, 3, 1)])
def test_line_functions__raise_on_other_shape(function, shape):
    with pytest.raises(ShapeError, match=r"must have shape \(N, 3\)"):
        function(np.zeros(shape), np.zeros(3), np.eye(3)[0])


@pytest.mark.parametrize("vector", [np.zeros(3), np.full(3, np.nan)])
def test_normalised__raise_without_direction(vector):
    with pytest.raises(ShapeError, match="no direction"):
        normalised(vector)


def test_shape_error__is_a_value_error_of_ours():
    assert issubclass(ShapeError, (BeamsegError, ValueError))


@pytest.mark.parametrize("length", [1e-150, 1.0, 1e150])
def test_normalised__any_length(length):
    np.testing.assert_allclose(normalised(np.array([3.0, 0, 4.0]) * length), [0.6, 0, 0.8])


@pytest.mark.parametrize("degrees", [0.0, 1e-6, 0.01, 30.0, 89.999, 90.0])
def test_angle_between_deg__is_sharp_everywhere(degrees):
    radians = np.radians(degrees)
    one, other = np.array([1.0, 0, 0]), np.array([np.cos(radians), np.sin(radians), 0])
    assert angle_between_deg(one, other) == pytest.approx(degrees, rel=1e-9, abs=1e-12)
    assert angle_between_deg(one, -other) == pytest.approx(degrees, rel=1e-9, abs=1e-12)


# --- rotations ------------------------------------------------------------------------


@SEEDED
@given(seed=SEEDS)
def test_matrix_from_quaternion__agrees_with_twin(seed):
    rng = np.random.default_rng(seed)
    quaternion, vector = random_quaternion(rng), rng.normal(size=3)
    matrix = matrix_from_quaternion(quaternion)
    np.testing.assert_allclose(matrix @ vector, naive.rotated(quaternion, vector), atol=1e-12)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    np.testing.assert_allclose(matrix_from_quaternion(-3.0 * quaternion), matrix, atol=1e-12)


def test_matrix_from_quaternion__by_hand():
    half = np.sqrt(0.5)
    quarter_about_z = matrix_from_quaternion(np.array([0.0, 0.0, half, half]))
    np.testing.assert_allclose(quarter_about_z @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(matrix_from_quaternion(np.array([0.0, 0, 0, 1])), np.eye(3))


def test_matrix_from_quaternion__raise_on_zero():
    with pytest.raises(ShapeError):
        matrix_from_quaternion(np.zeros(4))


@SEEDED
@given(roll=st.floats(-4, 4), pitch=st.floats(-4, 4), yaw=st.floats(-4, 4))
def test_matrix_from_rpy__is_three_turns_about_fixed_axes(roll, pitch, yaw):
    turns = [
        matrix_from_quaternion(np.append(np.sin(angle / 2) * axis, np.cos(angle / 2)))
        for angle, axis in zip((roll, pitch, yaw), np.eye(3), strict=True)
    ]
    expected = turns[2] @ turns[1] @ turns[0]
    np.testing.assert_allclose(matrix_from_rpy(roll, pitch, yaw), expected, atol=1e-12)


@SEEDED
@given(seed=SEEDS, share=st.floats(0, 1), turn=st.sampled_from([1e-9, 1e-4, 1.9e-3, 0.1, 2.0, 3.1]))
def test_interpolate_quaternion__turns_evenly(seed, share, turn):
    rng = np.random.default_rng(seed)
    first = random_quaternion(rng)
    axis = matrix_from_quaternion(first) @ normalised(rng.normal(size=3))
    start = matrix_from_quaternion(first)

    def turned_by(angle):
        half = 0.5 * angle
        return matrix_from_quaternion(np.append(np.sin(half) * axis, np.cos(half))) @ start

    half = 0.5 * turn
    step = np.append(np.sin(half) * axis, np.cos(half))
    vector = step[3] * first[:3] + first[3] * step[:3] + np.cross(step[:3], first[:3])
    second = np.append(vector, step[3] * first[3] - step[:3] @ first[:3])
    np.testing.assert_allclose(matrix_from_quaternion(second), turned_by(turn), atol=1e-12)
    for sign in (1.0, -1.0):
        between = interpolate_quaternion(first, sign * second, share)
        assert np.linalg.norm(between) == pytest.approx(1.0, abs=1e-12)
        np.testing.assert_allclose(
            matrix_from_quaternion(between), turned_by(share * turn), atol=1e-9
        )


def test_interpolate_quaternion__does_not_change_its_arguments():
    first, second = np.array([0.0, 0, 0, 1]), np.array([0.0, 0, 0, -1])
    np.testing.assert_allclose(np.abs(interpolate_quaternion(first, second, 0.5)), [0, 0, 0, 1])
    assert second.tolist() == [0, 0, 0, -1]


# --- transforms -----------------------------------------------------------------------


@SEEDED
@given(seed=SEEDS)
def test_rigid_transform__chain_and_inverse(seed):
    rng = np.random.default_rng(seed)
    T_a_b, T_b_c, points = random_transform(rng), random_transform(rng), rng.normal(size=(5, 3))
    np.testing.assert_allclose(
        (T_a_b @ T_b_c).apply(points), T_a_b.apply(T_b_c.apply(points)), atol=1e-12
    )
    np.testing.assert_allclose(T_a_b.inverse().apply(T_a_b.apply(points)), points, atol=1e-12)
    one = T_a_b.apply(points[0])
    assert one.shape == (3,)
    np.testing.assert_allclose(one, T_a_b.apply(points)[0], atol=1e-12)
    np.testing.assert_allclose(
        T_a_b.rotate(points[1] - points[0]), T_a_b.apply(points[1]) - one, atol=1e-12
    )


def test_rigid_transform__report_formula_by_hand():
    half = np.sqrt(0.5)
    T_world_body = RigidTransform.from_quaternion(
        np.array([10.0, 20, 30]), np.array([0, 0, half, half])
    )
    np.testing.assert_allclose(T_world_body.apply(np.array([1.0, 2, 3])), [8, 21, 33], atol=1e-12)
    np.testing.assert_allclose(T_world_body.rotate(np.array([1.0, 2, 3])), [-2, 1, 3], atol=1e-12)


def test_rigid_transform__identity_moves_nothing():
    points = np.random.default_rng(1).normal(size=(4, 3))
    assert np.array_equal(RigidTransform.identity().apply(points), points)


def test_connected__labels_by_the_lowest():
    links = np.array([[5, 3], [3, 1], [0, 4]])
    assert connected(6, links).tolist() == [0, 1, 2, 1, 0, 1]


def test_clusters__chain_and_reach():
    positions = np.array([[0.0, 0, 0], [5.0, 0, 0], [0.09, 0, 0], [0.18, 0, 0], [5.15, 0, 0]])
    groups = clusters(positions, np.array([0.1, 0.1, 0.1, 0.1, 0.2]))
    assert [group.tolist() for group in groups] == [[0, 2, 3], [1, 4]]


def test_clusters__none():
    assert clusters(np.empty((0, 3)), np.empty(0)) == []


@pytest.mark.parametrize("t", [-1.3, 0.0, 0.7])
def test_covariance_along__is_that_of_the_sum(t):
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6))
    covariance = root @ root.T
    shift = np.hstack([np.eye(3), t * np.eye(3)])
    np.testing.assert_allclose(covariance_along(covariance, t), shift @ covariance @ shift.T)


def test_unknown__is_nan_and_stays_so():
    assert np.isnan(unknown((2, 3))).all()
    assert unknown(3) is unknown(3)
    with pytest.raises(ValueError, match="read-only"):
        unknown(3)[0] = 1.0
