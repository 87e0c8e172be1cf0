"""Fusion solutions 1 and 2 of the report's section 3.2.6 against plain formulas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamseg_batch.config import StructureConfig
from beamseg_batch.structure.fusion import fuse, fusion_coefficient, point_weight
from tests import naive
from tests.structure.segments import between, jittered, random_segment, turned

WEIGHTED = StructureConfig(fusion="weighted")
MEAN = StructureConfig(fusion="mean")


def overlapping_pairs(seed, count=100):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        known = random_segment(rng, shortest=0.6)
        yield known, jittered(known, rng, 0.03)


def assert_same_line(segment, anchor, direction):
    np.testing.assert_allclose(segment.anchor, anchor, atol=1e-12)
    assert (
        min(
            np.abs(segment.direction - direction).max(), np.abs(segment.direction + direction).max()
        )
        < 1e-9
    )


def assert_ends_are_the_outermost(fused, known, new):
    t = [
        (end - fused.anchor) @ fused.direction
        for segment in (known, new)
        for end in naive.ends(segment)
    ]
    assert fused.t_min == pytest.approx(min(t), abs=1e-12)
    assert fused.t_max == pytest.approx(max(t), abs=1e-12)


def test_fuse__mean_agrees_with_twin():
    for known, new in overlapping_pairs(1):
        fused = fuse(known, new, MEAN)
        assert_same_line(fused, *naive.fused_line(known, new, 0.5))
        assert_ends_are_the_outermost(fused, known, new)


@pytest.mark.parametrize("min_weight", [0.0, 0.01, 0.7])
def test_fuse__weighted_agrees_with_twin(min_weight):
    config = StructureConfig(fusion="weighted", min_weight=min_weight)
    for known, new in overlapping_pairs(2):
        w, f = naive.fusion_share(known, new, min_weight)
        assert point_weight(known.n_points, new.n_points, min_weight) == pytest.approx(w)
        assert fusion_coefficient(known, new, w) == pytest.approx(f)
        fused = fuse(known, new, config)
        assert_same_line(fused, *naive.fused_line(known, new, f))
        assert_ends_are_the_outermost(fused, known, new)
        assert fused.pca_coeff == pytest.approx(known.pca_coeff * (1 - w) + new.pca_coeff * w)
        np.testing.assert_allclose(fused.pca_eig, known.pca_eig * (1 - w) + new.pca_eig * w)


def test_point_weight__is_a_real_number():
    """Fault of the original: int / int is 0, so that `min_weight` always applied."""
    assert point_weight(300, 100, 0.01) == pytest.approx(0.25)
    assert point_weight(1, 1, 0.01) == pytest.approx(0.5)
    assert point_weight(9999, 1, 0.01) == pytest.approx(0.01)


def test_fusion_coefficient__by_hand():
    known, new = between([0, 0, 0], [1, 0, 0], pca_coeff=0.9), between([0, 0, 0], [1, 0, 0])
    new = replace(new, pca_coeff=0.6)
    # 0.6 * 0.25 / (0.9 * 0.75 + 0.6 * 0.25) = 0.15 / 0.825
    assert fusion_coefficient(known, new, 0.25) == pytest.approx(0.15 / 0.825)


def test_fusion_coefficient__without_any_extent_points_decide():
    flat = replace(between([0, 0, 0], [1, 0, 0]), pca_coeff=0.0)
    assert fusion_coefficient(flat, flat, 0.25) == 0.25


def test_fuse__moves_by_its_share_by_hand():
    known = between([0, 0, 0], [4, 0, 0], n_points=300)
    new = between([1, 0.1, 0], [3, 0.1, 0], n_points=100)
    fused = fuse(known, new, WEIGHTED)
    np.testing.assert_allclose(fused.anchor, [1, 0.025, 0], atol=1e-12)
    np.testing.assert_allclose(fused.direction, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(fused.end_1, [0, 0.025, 0], atol=1e-12)
    np.testing.assert_allclose(fused.end_2, [4, 0.025, 0], atol=1e-12)
    half = fuse(known, new, MEAN)
    np.testing.assert_allclose(half.end_1, [0, 0.05, 0], atol=1e-12)


def test_fuse__members_are_those_of_both():
    """Fault of the original: it read them before they were set, and dropped the old points."""
    known = replace(between([0, 0, 0], [2, 0, 0], n_points=300, stamp_ns=5), n_scans=7)
    new = between([1, 0, 0], [3, 0, 0], n_points=100, stamp_ns=9)
    fused = fuse(known, new, WEIGHTED)
    assert (fused.n_points, fused.n_scans, fused.radius) == (400, 8, 0.05)
    assert (fused.first_seen_ns, fused.last_seen_ns) == (5, 9)
    back = fuse(new, known, WEIGHTED)
    assert (back.n_points, back.n_scans) == (400, 8)
    assert (back.first_seen_ns, back.last_seen_ns) == (5, 9)


def test_fuse__direction_is_a_unit_vector():
    """Fault of the original: it stayed as long as the new segment, so t was no metres."""
    for known, new in overlapping_pairs(3):
        for config in (MEAN, WEIGHTED):
            fused = fuse(known, new, config)
            assert np.linalg.norm(fused.direction) == pytest.approx(1.0, abs=1e-12)
            assert fused.length == pytest.approx(np.linalg.norm(fused.end_2 - fused.end_1))


def test_fuse__direction_of_travel_does_not_matter():
    for known, new in overlapping_pairs(4, 30):
        for config in (MEAN, WEIGHTED):
            plain = fuse(known, new, config)
            for other in (
                fuse(known, turned(new), config),
                turned(fuse(turned(known), new, config)),
            ):
                np.testing.assert_allclose(other.end_1, plain.end_1, atol=1e-9)
                np.testing.assert_allclose(other.end_2, plain.end_2, atol=1e-9)
                assert plain.direction @ known.direction > 0.0


@pytest.mark.parametrize("direction", [[0, 1, 0], [0, 0, 1], [0, 0.6, -0.8], [1, 0, 0]])
def test_fuse__ends_by_projection_for_any_direction(direction):
    """Fault of the original: t from x alone divides by zero on beams normal to x."""
    direction = np.array(direction, dtype=np.float64)
    fused = fuse(
        between(0 * direction, direction), between(0.5 * direction, 2 * direction), WEIGHTED
    )
    np.testing.assert_allclose(fused.end_1, 0 * direction, atol=1e-12)
    np.testing.assert_allclose(fused.end_2, 2 * direction, atol=1e-12)


def test_fuse__segments_apart_along_the_axis_stay_two():
    known = between([0, 0, 0], [1, 0, 0])
    assert fuse(known, between([1.01, 0, 0], [2, 0, 0]), WEIGHTED) is None
    assert fuse(known, between([-2, 0, 0], [-0.01, 0, 0]), WEIGHTED) is None
    assert fuse(known, between([0.99, 0, 0], [2, 0, 0]), WEIGHTED) is not None
    assert fuse(known, between([0.4, 0, 0], [0.6, 0, 0]), WEIGHTED) is not None


def test_fuse__same_segment_changes_nothing_but_counts():
    known = between([0.3, -0.2, 0.5], [1.1, 0.9, 1.7])
    fused = fuse(known, known, WEIGHTED)
    np.testing.assert_allclose(fused.end_1, known.end_1, atol=1e-12)
    np.testing.assert_allclose(fused.end_2, known.end_2, atol=1e-12)
    assert fused.pca_coeff == pytest.approx(known.pca_coeff)


@pytest.mark.parametrize("config", [MEAN, WEIGHTED])
def test_fuse__new_segment_without_length(config):
    known = between([0, 0, 0], [2, 0, 0])
    point = replace(known, anchor=np.array([1.0, 0.02, 0.0]), t_min=0.0, t_max=0.0)
    fused = fuse(known, point, config)
    np.testing.assert_allclose(fused.direction, [1, 0, 0], atol=1e-12)
    assert fused.length == pytest.approx(2.0)
