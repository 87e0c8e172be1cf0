"""Rows and columns for clouds that came without."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.bearing_kernels import lay_out
from beamseg_batch.bearings import bearing_image, find_grid, in_order
from tests.rays import camera_rays

WIDTH, HEIGHT = 48, 36


def images(count=12, *, seed=0, dtype=np.float32, sky=0.3):
    """A wall that leans ever more, with sky above it; whole images, NaN without return."""
    rng = np.random.default_rng(seed)
    rays = camera_rays(WIDTH, HEIGHT, 80.0)
    for lean in np.linspace(-0.5, 0.5, count):
        depths = rng.normal(1.5, 0.01, len(rays)) / (1.0 + lean * rays[:, 1])
        depths[(rays[:, 2] > sky + lean) | (rng.random(len(rays)) < 0.02)] = np.nan
        yield (rays * depths[:, None]).astype(dtype)


def returns(image, rng=None):
    seen = image[np.isfinite(image).all(axis=1)]
    return seen if rng is None else rng.permutation(seen)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_find_grid__puts_every_point_back_into_its_pixel(dtype):
    rng = np.random.default_rng(1)
    whole = list(images(dtype=dtype))
    grid = find_grid(returns(image, rng) for image in whole)
    assert (grid.width, grid.height) == (WIDTH, HEIGHT)
    for image in whole:
        np.testing.assert_array_equal(grid.image_of(returns(image, rng)), image)


def test_find_grid__of_depths_in_whole_millimetres():
    rng = np.random.default_rng(2)
    grid = find_grid(np.round(returns(image, rng), 3) for image in images())
    assert (grid.width, grid.height) == (WIDTH, HEIGHT)


def test_find_grid__not_of_random_bearings():
    rng = np.random.default_rng(3)
    clouds = [rng.uniform([0.5, -1, -1], [2, 1, 1], (1500, 3)) for _ in range(8)]
    assert find_grid(clouds) is None


def test_find_grid__not_of_a_cloud_that_was_thinned():
    """What is missing amid a wall was not asked: it did not see through."""
    rng = np.random.default_rng(4)
    whole = [returns(image) for image in images()]
    assert find_grid(cloud[rng.random(len(cloud)) < 0.4] for cloud in whole) is None
    assert find_grid(cloud[rng.random(len(cloud)) < 0.95] for cloud in whole) is not None


@pytest.mark.parametrize(
    "clouds", [[], [np.empty((0, 3))], [np.ones((1, 3))], [np.ones((50, 3))], [-np.ones((50, 3))]]
)
def test_find_grid__of_nothing(clouds):
    assert find_grid(clouds) is None


def test_image_of__leaves_out_what_is_beyond():
    grid = find_grid(map(returns, images()))
    strangers = np.array([[1, 5, 0], [1, 0, -5], [-1, 0, 0], [0, 0, 0], [np.nan, 0, 0]], np.float32)
    assert np.isnan(grid.image_of(strangers)).all()


def naive_lay_out(points, columns, rows, width, height):
    found = {}
    for x, y, z in points:
        place = round((z / x - rows[0]) / rows[1]), round((y / x - columns[0]) / columns[1])
        if 0 <= place[0] < height and 0 <= place[1] < width:
            found[place] = min(found.get(place, (np.inf,)), (x, y, z))
    image = np.full((height, width, 3), np.nan)
    for place, point in found.items():
        image[place] = point
    return image.reshape(-1, 3)


def test_lay_out__agrees_with_its_twin():
    rng = np.random.default_rng(5)
    points = rng.uniform([0.3, -1, -1], [2, 1, 1], (400, 3))
    columns, rows = np.array([0.8, -0.1]), np.array([0.5, -0.2])
    image = np.full((15 * 6, 3), np.nan)
    lay_out(points, columns, rows, 15, image)
    assert 30 < np.isfinite(image[:, 0]).sum() < 90
    np.testing.assert_array_equal(image, naive_lay_out(points, columns, rows, 15, 6))


def test_in_order__does_not_depend_on_the_order():
    rng = np.random.default_rng(6)
    points = rng.choice([0.5, 1.0, 1.5], (60, 3))
    ordered = in_order(points)
    np.testing.assert_array_equal(ordered, in_order(rng.permutation(points)))
    np.testing.assert_array_equal(np.sort(ordered, axis=0), np.sort(points, axis=0))


@pytest.mark.parametrize("keep", ["nearest", "middle"])
def test_bearing_image__keeps_a_point_of_each_cell(keep):
    rng = np.random.default_rng(7)
    cloud = np.concatenate([rng.uniform([1, -1, -1], [2, 1, 1], (900, 3)), np.full((3, 3), np.nan)])
    image = bearing_image(cloud, keep)
    assert (image.cells[-3:] == -1).all()
    depths = np.linalg.norm(cloud, axis=1)
    occupied = np.unique(image.cells[:-3])
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(image.points[:, 0])), occupied)
    for cell in occupied:
        inside = np.flatnonzero(image.cells == cell)
        kept = image.points[cell]
        assert (cloud[inside] == kept).all(axis=1).any()
        if keep == "nearest":
            assert np.linalg.norm(kept) == pytest.approx(depths[inside].min())
    filled = len(occupied) / (image.width * image.height)
    assert 0.7 < filled < 0.99  # three points a cell, by chance


@pytest.mark.parametrize("cloud", [np.empty((0, 3)), np.full((20, 3), np.nan), np.zeros((20, 3))])
def test_bearing_image__of_nothing(cloud):
    image = bearing_image(cloud)
    assert len(image.points) == image.width * image.height == 0


def test_bearing_image__of_one_bearing():
    image = bearing_image(np.outer(np.linspace(1, 2, 30), [1.0, 0.5, 0.2]))
    assert np.isfinite(image.points[:, 0]).sum() >= 1
