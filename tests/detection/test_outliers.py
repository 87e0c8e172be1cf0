"""Optional filters by Open3D in front of the search."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from beamseg_batch.config import load_config
from beamseg_batch.detection.detector import Detector
from beamseg_batch.detection.outliers import check_outlier_filter, without_outliers
from beamseg_batch.extras import Open3DMissingError
from tests.detection.scans import lifted, make_scan

FILTERS = ("statistical", "plane", "dbscan")


@pytest.fixture
def open3d():
    return pytest.importorskip("open3d", exc_type=ImportError)


def filtering(outliers):
    return load_config(overrides=[f"filtering.outliers={outliers}"]).filtering


def cloud(seed=0):
    """A beam, a wall, and some points far from all; and which is which."""
    rng = np.random.default_rng(seed)
    beam = rng.normal([0.8, 0.0, 0.0], [0.01, 0.02, 0.0], (300, 3))
    beam[:, 2] = rng.uniform(-0.7, 0.7, 300)
    wall = np.stack([rng.normal(1.3, 0.005, 900), *rng.uniform(-0.7, 0.7, (2, 900))], axis=1)
    stray = rng.uniform([0.1, -1.4, -1.4], [0.5, 1.4, 1.4], (25, 3))
    order = rng.permutation(1225)
    return np.concatenate([beam, wall, stray])[order], np.repeat([0, 1, 2], [300, 900, 25])[order]


def kept_shares(outliers):
    points, kinds = cloud()
    kept = (
        (points[:, None] == without_outliers(points, filtering(outliers))).all(axis=2).any(axis=1)
    )
    return [kept[kinds == kind].mean() for kind in range(3)]


def test_without_outliers__statistical_drops_what_is_alone(open3d):
    beam, wall, stray = kept_shares("statistical")
    assert min(beam, wall) > 0.95
    assert stray < 0.2


def test_without_outliers__plane_drops_the_wall(open3d):
    beam, wall, stray = kept_shares("plane")
    assert beam > 0.95
    assert wall < 0.02
    assert stray > 0.9


def test_without_outliers__dbscan_drops_what_is_alone(open3d):
    beam, wall, stray = kept_shares("dbscan")
    assert min(beam, wall) > 0.95
    assert stray < 0.1


def corner(seed):
    """Two walls that meet, and clutter before them."""
    rng = np.random.default_rng(seed)
    sizes = [(800, [1.5, 1.5, 0.03]), (700, [0.03, 1.5, 1.5]), (300, [1.5, 1.5, 1.5])]
    return np.concatenate([rng.uniform(0, 1, (count, 3)) * size for count, size in sizes])


@pytest.mark.parametrize("outliers", FILTERS)
def test_without_outliers__is_the_same_again(open3d, outliers):
    """Open3D works in threads, which may get on as they like."""
    for points in (cloud(1)[0], *map(corner, range(12))):
        first, second = (without_outliers(points, filtering(outliers)) for _ in range(2))
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("outliers", FILTERS)
@pytest.mark.parametrize("count", [0, 1, 49])
def test_without_outliers__leaves_few_points_alone(open3d, outliers, count):
    points = cloud()[0][:count]
    assert without_outliers(points, filtering(outliers)) is points


def test_without_outliers__a_beam_is_no_plane(open3d):
    points, kinds = cloud()
    assert len(without_outliers(points[kinds == 0], filtering("plane"))) == 300


def test_detector__searches_what_the_filter_leaves(open3d):
    points, _ = cloud()
    scan = make_scan(points, pose=lifted(2.0))

    def searched(outliers):
        overrides = ["filtering.foreground=all", f"filtering.outliers={outliers}"]
        return Detector(load_config(overrides=overrides))(scan).n_points_filtered

    assert searched("plane") < 0.5 * searched("none")


def test_without_outliers__none_needs_no_open3d(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    check_outlier_filter(filtering("none"))
    points, _ = cloud()
    assert without_outliers(points, filtering("none")) is points


@pytest.mark.parametrize("outliers", FILTERS)
def test_check_outlier_filter__says_how_to_get_open3d(monkeypatch, outliers):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(
        Open3DMissingError, match=rf"^filtering.outliers: {outliers} .*apt-get"
    ) as it:
        check_outlier_filter(filtering(outliers))
    assert it.value.exit_code == 2
    assert "\n" not in str(it.value)
