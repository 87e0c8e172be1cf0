"""From the visible surface to the axis behind it, and beams of a pooled cloud."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.config import load_config
from beamseg_batch.detection.axis import Returns, fit_segment_axis
from beamseg_batch.detection.detector import Detector
from beamseg_batch.geometry import angle_between_deg, distances_to_line
from beamseg_batch.model import DepthNoise
from tests.detection.scans import make_scan
from tests.rays import pose_at, scan_points
from tests.structure.segments import between

NOISE = DepthNoise(0.004, 0.002)
START, END = np.array([1.0, -0.4, -0.1]), np.array([1.1, 0.4, 0.15])
AXIS = (END - START) / np.linalg.norm(END - START)


def seen(noise=0.004, seed=0, beams=((START, END, 0.05),)):
    points = scan_points(pose_at([0, 0, 0]), beams, np.random.default_rng(seed), noise=noise)
    return make_scan(points)


def on_surface(*, shift=(0.0, 0.0, 0.0)):
    """The line that a search finds: some way before the axis."""
    away = START - (START @ AXIS) * AXIS
    before = -0.8 * 0.05 * away / np.linalg.norm(away) + shift
    return between(START + before, END + before)


def off_axis(segment):
    return distances_to_line(np.array([segment.end_1, segment.end_2]), START, AXIS).max()


def test_Returns__are_rays_depths_and_their_noise():
    points = [[1.0, 0.5, 0.0], [np.nan] * 3, [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [2.0, 0.0, 1.0]]
    returns = Returns(make_scan(np.array(points, np.float32)), NOISE)
    np.testing.assert_allclose(returns.points, [points[0], points[4]])
    np.testing.assert_allclose(returns.rays * returns.depths[:, None], returns.points)
    forward = [NOISE.at(1.0), NOISE.at(2.0)]
    np.testing.assert_allclose(returns.sigmas * returns.rays[:, 0], forward, rtol=1e-12)


@pytest.mark.parametrize("shift", [(0, 0, 0), (0.01, 0, 0.005), (-0.01, 0, -0.01)])
def test_fit_segment_axis__finds_the_axis_of_exact_depths(shift):
    line = on_surface(shift=shift)
    fitted = fit_segment_axis(line, Returns(seen(0.0), DepthNoise(0.004)))
    assert off_axis(line) > 0.03
    assert off_axis(fitted) < 1e-5
    assert (fitted.t_min, fitted.t_max) == (line.t_min, line.t_max)
    assert fitted.n_points > 50


@pytest.mark.parametrize("seed", range(4))
def test_fit_segment_axis__averages_the_noise(seed):
    fitted = fit_segment_axis(on_surface(), Returns(seen(0.004, seed), DepthNoise(0.004)))
    assert off_axis(fitted) < 0.004
    assert angle_between_deg(fitted.direction, AXIS) < 0.5


def test_fit_segment_axis__does_not_heed_what_crosses():
    across = (np.array([1.0, 0.05, -0.5]), np.array([1.0, 0.05, 0.5]), 0.05)
    scan = seen(0.003, beams=((START, END, 0.05), across))
    fitted = fit_segment_axis(on_surface(), Returns(scan, DepthNoise(0.003)))
    assert off_axis(fitted) < 0.012


@pytest.mark.parametrize(
    "points", [np.empty((0, 3)), np.full((9, 3), np.nan), [[5.0, 3.0, 0.0]] * 20]
)
def test_fit_segment_axis__without_returns_the_line_is_moved_back(points):
    fitted = fit_segment_axis(on_surface(), Returns(make_scan(np.array(points)), NOISE))
    assert off_axis(fitted) < 1e-9
    assert fitted.n_points == on_surface().n_points


def test_in_cloud__finds_the_beams_that_scans_share():
    beams = ((START, END, 0.05), (np.array([1.2, -0.4, -0.4]), np.array([1.2, 0.4, -0.6]), 0.05))
    scans = [seen(0.003, seed, beams).points for seed in range(3)]
    points = np.concatenate(scans).astype(np.float64)
    points = points[np.isfinite(points).all(axis=1)]
    found = Detector(load_config("precise")).in_cloud(points)
    assert len(found) == 2
    for start, end, radius in beams:
        way = (end - start) / np.linalg.norm(end - start)
        nearest = min(found, key=lambda s: distances_to_line(s.midpoint[None], start, way)[0])
        assert distances_to_line(nearest.midpoint[None], start, way)[0] < radius + 0.01
        assert angle_between_deg(nearest.direction, way) < 3.0
        assert nearest.length > 0.6


def test_in_cloud__allows_a_cloud_that_is_thick():
    rng = np.random.default_rng(0)
    turn, along = rng.uniform(0, 2 * np.pi, 900), rng.uniform(-0.2, 0.2, 900)
    points = np.stack([1 + 0.05 * np.cos(turn), 0.05 * np.sin(turn), along], axis=1)
    detect = Detector(load_config("precise"))
    least = detect.config.detection.screening.min_pca_coeff
    found = max(detect.in_cloud(points), key=lambda segment: segment.n_points)
    assert angle_between_deg(found.direction, np.array([0.0, 0.0, 1.0])) < 3.0
    assert 0.9 < found.pca_coeff < least


def test_in_cloud__of_nothing():
    assert Detector(load_config("precise")).in_cloud(np.empty((0, 3))) == []
