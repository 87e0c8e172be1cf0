"""Beams that stand to question, and the sums of their evidence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamseg_batch.cylinder.evidence_kernels import COARSE, FINE
from beamseg_batch.geometry import normalised
from beamseg_batch.structure.hypothesis import Beam, Sums, normal_matrix

PLACES = st.floats(-1.0, 1.0)


def beam(first=-0.5, last=0.5, **values):
    direction = normalised(np.array([0.2, 1.0, -0.4]))
    return Beam(np.array([1.0, 2.0, 3.0]), direction, first, last, 0.05, **values)


@given(PLACES, st.floats(0.01, 2.0))
@settings(max_examples=30)
def test_between__keeps_the_axis_and_puts_the_anchor_midway(first, length):
    one = beam()
    part = one.between(first, first + length)
    np.testing.assert_allclose(part.ends, [one.at(first), one.at(first + length)], atol=1e-12)
    np.testing.assert_allclose(part.anchor, np.mean(part.ends, axis=0), atol=1e-12)
    assert part.length == pytest.approx(length, abs=1e-12)
    assert part.first == pytest.approx(-part.last, abs=1e-12)


def test_evidence_between__follows_the_axis_when_the_anchor_moves():
    profile = np.arange(250.0)
    one = beam(profile=profile, profile_start=-0.5)
    wanted = profile[50:100].sum()
    assert one.evidence_between(-0.3, -0.1) == wanted
    middle = 0.5 * (-0.4 + 0.2)
    moved = one.between(-0.4, 0.2)
    assert moved.evidence_between(-0.3 - middle, -0.1 - middle) == wanted
    assert moved.evidence_between(-9.0, 9.0) == profile.sum()


@pytest.mark.parametrize("stretch", [(-2.0, -1.0), (1.0, 2.0), (0.1, 0.1)])
def test_evidence_between__is_nothing_where_there_is_no_profile(stretch):
    assert beam(profile=np.ones(250), profile_start=-0.5).evidence_between(*stretch) == 0.0


@given(st.lists(st.floats(0.05, 3.0), max_size=5))
@settings(max_examples=40)
def test_sums__have_bins_for_each_beam_and_its_margins(lengths):
    beams = [beam(-0.3 * length, 0.7 * length) for length in lengths]
    sums = Sums(beams, flanks=True)
    found = sums.evidence
    assert found.flanks.shape == (len(beams), 3, 2)
    assert found.beside.shape == (found.coarse_at[-1], 2, 2)
    assert len(found.likelihood) == len(found.hits) == found.fine_at[-1]
    for index, one in enumerate(beams):
        likelihood, hits = sums.fine(index)
        assert len(sums.beside(index)) == len(sums.coarse(index))
        assert len(likelihood) == len(hits) == round(COARSE / FINE) * len(sums.coarse(index))
        assert sums.place(index, 0) == pytest.approx(one.first - 0.3)
        assert one.last + 0.3 - 1e-9 <= sums.place(index, len(hits)) < one.last + 0.32 + 1e-9


def test_sums__without_flanks_ask_for_none():
    assert Sums([beam()]).evidence.flanks.shape == (0, 3, 2)
    assert Sums([beam()]).evidence.beside.shape == (0, 2, 2)


@given(PLACES, PLACES)
@settings(max_examples=60)
def test_coarse_bins__are_those_with_their_middles_on_the_stretch(one, other):
    sums, (first, last) = Sums([beam(), beam()]), sorted((one, other))
    middles = sums.starts[1] + COARSE * (np.arange(len(sums.coarse(1))) + 0.5)
    if np.abs(middles[:, None] - [first, last]).min() < 1e-9:
        return
    wanted = np.flatnonzero((middles > first) & (middles < last))
    got = np.arange(len(middles))[sums.coarse_bins(1, first, last)]
    np.testing.assert_array_equal(got, wanted)


def test_normal_matrix__is_that_of_the_jacobian():
    rng = np.random.default_rng(0)
    uv, s, residuals = rng.normal(size=(30, 2)), rng.uniform(-1, 1, 30), rng.normal(size=30)
    jacobian = np.column_stack([uv, s[:, None] * uv, rng.normal(size=30)])
    u, v, su, sv, r = jacobian.T
    rows = np.zeros((30, 22))
    rows[:, :9] = np.column_stack(
        [u * u, u * v, v * v, u * su, u * sv, v * sv, su * su, su * sv, sv * sv]
    )
    rows[:, 9:13] = jacobian[:, :4] * residuals[:, None]
    rows[:, 16:21] = jacobian * r[:, None]
    rows[:, 21] = r * residuals
    matrix, right = normal_matrix(rows)
    np.testing.assert_allclose(matrix, jacobian.T @ jacobian, atol=1e-12)
    np.testing.assert_allclose(right, jacobian.T @ residuals, atol=1e-12)


def test_beam__is_frozen_and_its_normals_are_normal():
    one = replace(beam(), radius=0.1)
    u, v = one.normals
    assert abs(u @ one.direction) + abs(v @ one.direction) + abs(u @ v) < 1e-14
