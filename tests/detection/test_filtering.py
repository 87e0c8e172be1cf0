"""Window, floor trim and voxel grid against plain numpy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamseg_batch.config import FilteringConfig, WindowConfig
from beamseg_batch.detection.filtering import crop_scan, voxel_grid
from beamseg_batch.errors import ConfigError
from beamseg_batch.geometry import RigidTransform
from tests import naive
from tests.detection.scans import make_scan

NO_FLOOR = FilteringConfig(floor_trim="none")
LOW, HIGH = np.array([0.0, -1.5, -1.5]), np.array([1.5, 1.5, 1.5])


def cloud_with_holes(seed, dtype, count=500):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-2, 2, (count, 3)).astype(dtype)
    for value in (np.nan, np.inf, -np.inf):
        points[rng.integers(0, count, 20), rng.integers(0, 3, 20)] = value
    points[0] = [np.inf, -np.inf, 0.5]  # their sum is NaN, and numpy would warn of it
    points[1] = [np.nan, np.nan, np.nan]
    return points


# --- window ---------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_crop_scan__keeps_what_a_mask_keeps(seed, dtype):
    points = cloud_with_holes(seed, dtype)
    returns, inside = naive.cropped(points, LOW, HIGH)
    cropped = crop_scan(make_scan(points), NO_FLOOR)
    assert np.array_equal(cropped.points, inside)
    assert cropped.points.dtype == np.float64
    assert (cropped.num_returns, cropped.num_window) == (len(returns), len(inside))
    assert 0 < len(inside) < len(returns) < len(points)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_crop_scan__bounds_are_included(dtype):
    # Bounds that single precision holds exactly.
    window = WindowConfig(x=(0.25, 1.5), y=(-0.5, 0.75), z=(-1.5, -0.125))
    low, high = np.array([window.x, window.y, window.z]).T
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T.astype(dtype)
    beyond = np.concatenate(
        [np.nextafter(corners[:1], dtype(-9)), np.nextafter(corners[-1:], dtype(9))]
    )
    config = FilteringConfig(window=window, floor_trim="none")
    cropped = crop_scan(make_scan(np.concatenate([corners, beyond])), config)
    assert np.array_equal(cropped.points, corners.astype(np.float64))
    assert cropped.num_returns == 10


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_crop_scan__cloud_without_a_return(dtype):
    for points in (np.empty((0, 3), dtype), np.full((7, 3), np.nan, dtype)):
        cropped = crop_scan(make_scan(points), NO_FLOOR)
        assert cropped.points.shape == (0, 3)
        assert (cropped.num_returns, cropped.num_window) == (0, 0)


def test_crop_scan__takes_read_only_and_strided_points():
    points = cloud_with_holes(4, np.float32)
    wide = np.zeros((len(points), 5), np.float32)
    wide[:, 1:4] = points
    view = wide[:, 1:4]
    view.flags.writeable = False
    plain = crop_scan(make_scan(points), NO_FLOOR)
    assert np.array_equal(crop_scan(make_scan(view), NO_FLOOR).points, plain.points)


def test_crop_scan__does_not_hand_out_the_message():
    points = np.full((4, 3), 0.5)
    cropped = crop_scan(make_scan(points), NO_FLOOR)
    cropped.points[:] = 9.0
    assert np.all(points == 0.5)


# --- floor ----------------------------------------------------------------------------


def tilted_pose():
    return RigidTransform.from_quaternion(
        np.array([0.3, -0.2, 0.9]), np.array([0.1, 0.4, -0.2, 0.9])
    )


@pytest.mark.parametrize("height", [0.3, 0.9, -5.0, 5.0])
def test_crop_scan__drops_points_below_the_floor_in_the_world(height):
    points = cloud_with_holes(5, np.float64)
    extrinsic = RigidTransform.from_quaternion(
        np.array([0.07, 0.01, 0.04]), np.array([0.0, 0.1, 0.05, 0.99])
    )
    scan = make_scan(points, pose=tilted_pose(), extrinsic=extrinsic)
    cropped = crop_scan(scan, FilteringConfig(floor_trim="points", floor_trim_height=height))
    _, inside = naive.cropped(points, LOW, HIGH)
    world = []
    for point in inside:
        body = naive.rotated([0.0, 0.1, 0.05, 0.99], point) + extrinsic.translation
        world.append(naive.rotated([0.1, 0.4, -0.2, 0.9], body) + tilted_pose().translation)
    kept = np.array(world)[:, 2] >= height
    assert np.array_equal(cropped.points, inside[kept])
    assert cropped.num_window == len(inside), "the floor does not count against the window"


def test_crop_scan__point_on_the_floor_trim_height_stays():
    scan = make_scan(np.array([[1.0, 0.0, 0.25], [1.0, 0.0, 0.125]]))
    cropped = crop_scan(scan, FilteringConfig(floor_trim_height=0.25))
    assert cropped.points.tolist() == [[1.0, 0.0, 0.25]]


@pytest.mark.parametrize("floor_trim", ["segment", "none"])
def test_crop_scan__points_stay_when_the_floor_is_not_trimmed_by_points(floor_trim):
    points = np.array([[1.0, 0.0, -1.0], [1.0, 0.0, 1.0]])
    cropped = crop_scan(make_scan(points), FilteringConfig(floor_trim=floor_trim))
    assert np.array_equal(cropped.points, points)


# --- voxel grid -----------------------------------------------------------------------


def assert_same_as_twin(points, leaf):
    voxels = naive.voxel_means(points, leaf)
    expected = np.array([voxels[key] for key in sorted(voxels, key=lambda key: key[::-1])])
    grid = voxel_grid(np.asarray(points, dtype=np.float64), leaf)
    assert grid.shape == (len(voxels), 3)
    np.testing.assert_allclose(grid, expected.reshape(-1, 3), rtol=1e-12, atol=1e-15)


@settings(derandomize=True, deadline=None, max_examples=60, database=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 400),
    leaf=st.sampled_from([0.01, 0.05 / 1.5, 0.1, 0.25, 1.0, 7.0]),
    shift=st.sampled_from([0.0, -3.0, 1e3]),
)
def test_voxel_grid__agrees_with_twin(seed, count, leaf, shift):
    points = np.random.default_rng(seed).normal(size=(count, 3)) + shift
    assert_same_as_twin(points, leaf)


@pytest.mark.parametrize("leaf", [0.1, 0.25, 0.3, 1 / 3])
def test_voxel_grid__agrees_with_twin_on_voxel_edges(leaf):
    steps = np.random.default_rng(6).integers(-9, 10, (300, 3))
    assert_same_as_twin(steps * leaf, leaf)


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        # Aligned at floor(x / leaf), not at the cloud: 0.9 and 1.1 lie 0.2 apart in two voxels.
        ([[0.9, 0.5, 0.5], [1.1, 0.5, 0.5]], [[0.9, 0.5, 0.5], [1.1, 0.5, 0.5]]),
        ([[0.1, 0.5, 0.5], [0.9, 0.5, 0.5]], [[0.5, 0.5, 0.5]]),
        # floor, not truncation: -0.1 and 0.1 are not neighbours.
        ([[-0.1, 0.5, 0.5], [0.1, 0.5, 0.5]], [[-0.1, 0.5, 0.5], [0.1, 0.5, 0.5]]),
        ([[-0.9, -0.5, -0.5], [-0.1, -0.5, -0.5]], [[-0.5, -0.5, -0.5]]),
        # A lower edge belongs to its voxel, an upper one to the next.
        ([[1.0, 0.0, 0.0], [1.5, 0.0, 0.0], [2.0, 0.0, 0.0]], [[1.25, 0, 0], [2.0, 0, 0]]),
        # Ordered by z, then y, then x.
        (
            [[0, 0, 5], [3, 0, 0], [0, 2, 0], [1, 0, 0]],
            [[1, 0, 0], [3, 0, 0], [0, 2, 0], [0, 0, 5]],
        ),
    ],
)
def test_voxel_grid__is_aligned_as_pcl_does(points, expected):
    grid = voxel_grid(np.array(points, dtype=np.float64), 1.0)
    np.testing.assert_allclose(grid, np.array(expected, dtype=np.float64), rtol=0, atol=1e-15)


def test_voxel_grid__a_voxel_is_the_same_whatever_else_is_in_the_cloud():
    points = np.random.default_rng(7).uniform(-1, 1, (200, 3))
    alone = voxel_grid(points, 0.2)
    together = voxel_grid(np.concatenate([points, [[-3.017, 2.34, 8.9]]]), 0.2)
    assert len(together) == len(alone) + 1
    assert {tuple(row) for row in alone} < {tuple(row) for row in together}


def test_voxel_grid__order_of_points_matters_by_rounding_only():
    rng = np.random.default_rng(8)
    points = rng.uniform(-1, 1, (300, 3))
    np.testing.assert_allclose(
        voxel_grid(points, 0.3), voxel_grid(rng.permutation(points), 0.3), rtol=1e-13, atol=1e-15
    )


def test_voxel_grid__empty_cloud():
    assert voxel_grid(np.empty((0, 3)), 0.1).shape == (0, 3)


def test_voxel_grid__one_point_stays_where_it_is():
    assert voxel_grid(np.array([[0.1, 0.2, 0.3]]), 0.05).tolist() == [[0.1, 0.2, 0.3]]


def test_voxel_grid__raise_on_absurdly_small_leaf():
    with pytest.raises(ConfigError, match=r"filtering\.rad_2_leaf_ratio"):
        voxel_grid(np.array([[0.0, 0, 0], [1.0, 0, 0]]), 1e-7)


def test_voxel_grid__largest_grid_keeps_voxels_apart():
    """2**20 and a bit voxels along one axis: the last must not run into the next row."""
    leaf = 1.0
    points = np.array([[0.9, 0.5, 0.5], [2.0**20 + 0.1, 0.5, 0.5], [0.9, 1.5, 0.5]])
    assert len(voxel_grid(points, leaf)) == 3
