"""Turning, taking apart and moving."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamseg_batch.errors import ShapeError
from beamseg_batch.geometry import RigidTransform
from beamseg_batch.world.placement import (
    matrix_from_axis_angle,
    placed,
    roll_of,
    rotation_and_scale,
)
from beamseg_batch.world.scene import Member, Section
from tests.world.worlds import rodrigues

seeds = st.integers(0, 2**32 - 1)
ROUND = Section("round", 0.1, 0.1)


def random_rotation(rng):
    return rodrigues(rng.normal(size=3), rng.uniform(-np.pi, np.pi))


@settings(max_examples=50)
@given(seeds)
def test_matrix_from_axis_angle__agrees_with_twin(seed):
    rng = np.random.default_rng(seed)
    axis, angle = rng.normal(size=3) * rng.uniform(0.1, 10), rng.uniform(-7, 7)
    np.testing.assert_allclose(
        matrix_from_axis_angle(axis, angle), rodrigues(axis, angle), atol=1e-12
    )


def test_matrix_from_axis_angle__raise_without_axis():
    with pytest.raises(ShapeError):
        matrix_from_axis_angle(np.zeros(3), 1.0)


@settings(max_examples=50)
@given(seeds)
def test_rotation_and_scale__puts_together_again(seed):
    rng = np.random.default_rng(seed)
    linear = random_rotation(rng) * rng.uniform(0.1, 10, 3) * rng.choice([-1.0, 1.0], 3)
    rotation, scale = rotation_and_scale(linear)
    np.testing.assert_allclose(rotation * scale, linear, atol=1e-9)
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-9)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "linear",
    [
        np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        np.diag([1.0, 0.0, 1.0]),
        np.zeros((3, 3)),
    ],
)
def test_rotation_and_scale__none_of_a_shear_or_nothing(linear):
    assert rotation_and_scale(linear) is None


@settings(max_examples=50)
@given(seeds, st.floats(-3.1, 3.1), st.booleans())
def test_roll_of__is_the_roll_of_the_rotation(seed, roll, upright):
    rng = np.random.default_rng(seed)
    start = rng.normal(size=3)
    end = start + ([0, 0, rng.choice([-1.0, 1.0])] if upright else rng.normal(size=3))
    member = Member("", start, end, ROUND, roll)
    assert roll_of(start, end, member.rotation[:, 0]) == pytest.approx(roll)


@settings(max_examples=50)
@given(seeds)
def test_placed__moves_the_section_with_the_axis(seed):
    rng = np.random.default_rng(seed)
    member = Member("a", rng.normal(size=3), rng.normal(size=3), ROUND, rng.uniform(-3, 3), 0.01)
    T = RigidTransform(random_rotation(rng), rng.normal(size=3))
    (moved,) = placed([member], T, "tower ")
    np.testing.assert_allclose(moved.start, T.apply(member.start))
    np.testing.assert_allclose(moved.end, T.apply(member.end))
    np.testing.assert_allclose(moved.rotation, T.rotation @ member.rotation, atol=1e-9)
    assert (moved.name, moved.bow, moved.section) == ("tower a", 0.01, ROUND)
