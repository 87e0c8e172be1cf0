"""Returns of what is thin and stands free, among floor and walls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamseg_batch.foreground import thin_foreground
from beamseg_batch.foreground_kernels import free_pixels, row_pitch, surveyed, without_others
from beamseg_batch.model import DepthNoise
from tests.detection.scans import make_scan
from tests.rays import camera_rays, seen_depths

SIZE = 64
NOISE = DepthNoise(0.005)
POST = (np.array([1.0, 0.1, -0.8]), np.array([1.0, 0.1, 0.8]), 0.05)
RAIL = (np.array([1.1, -0.8, 0.5]), np.array([0.9, 0.8, -0.5]), 0.05)


def view(*beams, wall=np.inf, lean=0.0, seed=0):
    """Scan of beams and a wall, and which of its pixels show a beam."""
    rays = camera_rays(SIZE, SIZE, 70.0)
    depths = np.full(len(rays), np.inf)
    for beam in beams:
        depths = np.minimum(depths, seen_depths(np.zeros(3), rays, *beam))
    on_beam = np.isfinite(depths)
    behind = wall / (rays[:, 0] + lean * rays[:, 1])
    on_beam &= depths < behind
    depths = np.minimum(depths, np.where(behind > 0, behind, np.inf))
    depths += np.random.default_rng(seed).normal(0.0, NOISE.constant, len(depths))
    points = (rays * np.where(np.isfinite(depths), depths, np.nan)[:, None]).astype(np.float32)
    return replace(make_scan(points), width=SIZE, height=SIZE), on_beam


def kept_by(scan, *, radius=0.05, reach=1.5):
    return np.isfinite(thin_foreground(scan, radius, reach, NOISE).points).all(axis=1)


@pytest.mark.parametrize("beam", [POST, RAIL])
@pytest.mark.parametrize("wall", [1.4, np.inf])
def test_thin_foreground__keeps_a_beam_and_drops_the_wall(beam, wall):
    scan, on_beam = view(beam, wall=wall)
    kept = kept_by(scan)
    assert on_beam.sum() > 100
    assert kept[on_beam].mean() > 0.9
    assert kept[~on_beam].sum() == 0


def test_thin_foreground__of_a_beam_that_the_border_cuts():
    rim = (np.array([1.0, 0.7, -0.8]), np.array([1.0, 0.7, 0.8]), 0.05)
    scan, on_beam = view(rim, wall=1.4)
    kept, more = (
        np.isfinite(thin_foreground(scan, 0.05, 1.5, NOISE, beyond=beyond).points).all(axis=1)
        for beyond in (False, True)
    )
    assert on_beam.sum() > 50
    assert not kept.any()
    assert more[on_beam].mean() > 0.9
    assert not more[~on_beam].any()


@pytest.mark.parametrize("lean", [0.0, 0.4, -0.8])
def test_thin_foreground__keeps_nothing_of_a_wall(lean):
    scan, _ = view(wall=1.0, lean=lean)
    assert np.isfinite(scan.points).all(axis=1).sum() > 1000
    assert not kept_by(scan).any()


def test_thin_foreground__what_is_wider_than_a_beam_is_no_beam():
    scan, on_post = view((POST[0], POST[1], 0.2))
    assert kept_by(scan, radius=0.2)[on_post].mean() > 0.8
    assert kept_by(scan, radius=0.02)[on_post].mean() < 0.1


def test_thin_foreground__what_is_far_is_not_asked():
    scan, _ = view(POST)
    assert not kept_by(scan, reach=0.8).any()


def test_thin_foreground__what_lies_below_the_floor_is_not_asked():
    scan, _ = view(POST)
    heights = scan.T_world_sensor.apply(scan.points.astype(float))[:, 2]
    floor = float(np.nanmedian(heights))
    points = thin_foreground(scan, 0.05, 1.5, NOISE, floor).points
    kept = np.isfinite(points).all(axis=1)
    assert kept.sum() > 50
    assert (heights[kept] >= floor).all()
    np.testing.assert_array_equal(kept, kept_by(scan) & (heights >= floor))


def test_thin_foreground__one_failed_pixel_beside_a_wall_is_no_opening():
    scan, _ = view(wall=1.0)
    points = scan.points.copy()
    points[np.random.default_rng(1).random(len(points)) < 0.02] = np.nan
    assert kept_by(replace(scan, points=points)).mean() < 0.001


def without_rows(scan, share=1.0):
    """The returns of a scan in any order, some of them left out."""
    seen = np.flatnonzero(np.isfinite(scan.points).all(axis=1))
    kept = np.random.default_rng(2).permutation(seen)[: int(share * len(seen))]
    return replace(scan, points=scan.points[kept], width=len(kept), height=1), kept


@pytest.mark.parametrize("share", [1.0, 0.5])
@pytest.mark.parametrize("beam", [POST, RAIL])
def test_thin_foreground__of_a_cloud_without_rows(beam, share):
    scan, on_beam = view(beam, wall=1.6)
    scan, order = without_rows(scan, share)
    kept = kept_by(scan)
    assert kept[on_beam[order]].mean() > 0.8
    assert kept[~on_beam[order]].mean() < 0.02


@pytest.mark.parametrize("lean", [0.0, 0.4, -0.8])
def test_thin_foreground__keeps_little_of_a_wall_without_rows(lean):
    scan, _ = without_rows(view(wall=1.0, lean=lean)[0], 0.5)
    assert kept_by(scan).mean() < 0.02


def test_thin_foreground__leaves_a_cloud_alone_whose_size_is_not_that_of_its_image():
    scan, _ = view(POST)
    scan = replace(scan, width=SIZE - 1)
    assert thin_foreground(scan, 0.05, 1.5, NOISE) is scan


def test_thin_foreground__of_nothing():
    scan = replace(make_scan(np.full((25, 3), np.nan, np.float32)), width=5, height=5)
    assert not kept_by(scan).any()


def naive_free(depths, wanted, pitch, width, jump, beyond):
    """Walk from each pixel along each line through it."""
    free = np.zeros(depths.shape, bool)

    def opens(row, column, way, most, here, beyond):
        line = [np.array([row, column]) + k * np.array(way) for k in range(1, most + 1)]
        inside = [tuple(p) for p in line if (p >= 0).all() and (p < depths.shape).all()]
        seen = [depths[p] for p in inside]
        for k, depth in enumerate(seen):
            if np.isnan(depth):
                if k and np.isnan(seen[k - 1]):
                    return True
            elif abs(depth - here) > jump[row, column]:
                return bool(depth > here)
        return beyond and len(inside) < most

    for row, column in zip(*np.nonzero(wanted), strict=True):
        here = depths[row, column]
        most = int(width / (here * pitch) + 1.5)
        free[row, column] = any(
            opens(row, column, way, most, here, one)
            and opens(row, column, tuple(-part for part in way), most, here, other)
            for way in ((0, 1), (1, 0), (1, 1), (1, -1))
            for one, other in ((False, beyond), (beyond, False))
        )
    return free


@pytest.mark.parametrize("beyond", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_free_pixels__agrees_with_its_twin(seed, beyond):
    rng = np.random.default_rng(seed)
    depths = rng.choice([0.8, 1.0, 1.5, np.nan], (20, 17), p=[0.2, 0.4, 0.2, 0.2])
    depths += rng.normal(0, 0.01, depths.shape)
    wanted = np.isfinite(depths) & (rng.random(depths.shape) < 0.8)
    jump = rng.uniform(0.05, 0.15, depths.shape)
    free = free_pixels(depths, wanted, 0.03, 0.1, jump, beyond)
    assert 0 < free.sum() < wanted.sum()
    np.testing.assert_array_equal(free, naive_free(depths, wanted, 0.03, 0.1, jump, beyond))


@pytest.mark.parametrize("run", [row_pitch, row_pitch.py_func])
def test_row_pitch__is_the_angle_between_neighbours(run):
    scan, _ = view(POST, wall=1.4)
    rows = scan.points.reshape(SIZE, SIZE, 3).astype(np.float64)
    rays = rows / np.linalg.norm(rows, axis=2)[..., None]
    steps = np.linalg.norm(np.diff(rays, axis=1), axis=2)
    assert run(rows, 1) == pytest.approx(np.nanmedian(steps))
    assert run(rows, 3) == pytest.approx(np.nanmedian(steps[::3]))
    rows[:, ::2] = np.nan
    assert np.isnan(run(rows, 1))


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("run", [surveyed, surveyed.py_func])
def test_surveyed__agrees_with_its_twin(run, kind):
    rng = np.random.default_rng(3)
    points = rng.normal([1.2, 0.0, 0.0], 0.4, (12, 9, 3))
    points[rng.random((12, 9)) < 0.2] = np.nan
    up = np.array([0.6, 0.0, 0.8])
    points = points.astype(kind)
    depths, wanted, jump = run(points, 1.5, up, 0.5, 0.06, 0.01, 0.05)
    forward = points[..., 0]
    np.testing.assert_allclose(depths, np.linalg.norm(points, axis=2))
    with np.errstate(invalid="ignore"):
        np.testing.assert_array_equal(wanted, (forward <= 1.5) & (points @ up >= 0.5))
    least = np.maximum(0.06, np.hypot(0.01, 0.05 * forward))
    np.testing.assert_allclose(jump, np.where(wanted, least, 0.0))


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("run", [without_others, without_others.py_func])
def test_without_others__agrees_with_its_twin(run, kind):
    rng = np.random.default_rng(4)
    points, kept = rng.normal(size=(30, 3)).astype(kind), rng.random(30) < 0.4
    found = run(points, kept)
    assert found.dtype == kind
    np.testing.assert_array_equal(found, np.where(kept[:, None], points, np.nan))
