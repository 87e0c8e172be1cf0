"""Noise of the depths, measured on what is flat."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamseg_batch.config import SensorConfig
from beamseg_batch.model import DepthNoise
from beamseg_batch.noise import DEFAULT_NOISE, depth_noise, has_mixed_pixels, measured_noise
from tests.detection.scans import make_scan
from tests.rays import camera_rays

WIDTH, HEIGHT = 96, 64


def wall_scan(rng, noise, *, distance=1.0, slope=0.6, ragged=0.0):
    """A slanted wall, so that depths differ; part of it may be anything but flat."""
    rays = camera_rays(WIDTH, HEIGHT)
    rays = rays / rays[:, :1]
    depths = distance / (1.0 + slope * rays[:, 1])
    depths += rng.normal(size=len(depths)) * np.hypot(noise.constant, noise.relative * depths)
    odd = rng.uniform(size=len(depths)) < ragged
    depths[odd] += rng.choice([-0.4, 0.5, np.nan], odd.sum())
    return replace(make_scan(rays * depths[:, None]), width=WIDTH, height=HEIGHT)


def flight(seed, noise, count=12, **kwargs):
    rng = np.random.default_rng(seed)
    return [wall_scan(rng, noise, distance=d, **kwargs) for d in np.linspace(0.6, 2.5, count)]


@pytest.mark.parametrize("constant", [0.002, 0.005, 0.01])
def test_measured_noise__of_constant_noise(constant):
    noise = measured_noise(flight(0, DepthNoise(constant)))
    for depth in (0.7, 1.0, 2.0):
        assert noise.at(depth) == pytest.approx(constant, rel=0.08)


def test_measured_noise__of_noise_that_grows():
    true = DepthNoise(0.002, 0.004)
    noise = measured_noise(flight(1, true))
    for depth in (0.7, 1.0, 2.0, 3.0):
        assert noise.at(depth) == pytest.approx(true.at(depth), rel=0.1)


def test_measured_noise__does_not_heed_edges():
    noise = measured_noise(flight(2, DepthNoise(0.005), ragged=0.05))
    assert noise.at(1.0) == pytest.approx(0.005, rel=0.12)


def test_measured_noise__of_exact_depths_is_small_but_not_zero():
    noise = measured_noise(flight(3, DepthNoise(0.0)))
    assert 0.0 < noise.at(1.0) < 1e-3


def test_measured_noise__of_a_wall_of_one_depth():
    """As a depth image in whole millimetres shows it: most neighbours do not differ at all."""
    wall = wall_scan(np.random.default_rng(8), DepthNoise(0.0), slope=0.0)
    assert 0.0 < measured_noise([wall] * 3).at(1.0) < 1e-3


@pytest.mark.parametrize("true", [DepthNoise(0.003), DepthNoise(0.01), DepthNoise(0.002, 0.004)])
def test_measured_noise__of_clouds_without_rows(true):
    rng = np.random.default_rng(4)
    scans = [
        replace(scan, points=rng.permutation(scan.points)[: len(scan.points) // 3], height=1)
        for scan in flight(4, true, count=20, ragged=0.02)
    ]
    noise = measured_noise([replace(scan, width=len(scan.points)) for scan in scans])
    for depth in (0.7, 1.0, 2.0):
        assert noise.at(depth) == pytest.approx(true.at(depth), rel=0.15)


def test_measured_noise__is_not_known_of_nothing():
    few = replace(make_scan(np.ones((7, 3))), width=7, height=1)
    assert measured_noise([]) == measured_noise([few]) == DEFAULT_NOISE


def test_measured_noise__is_not_known_of_an_empty_sky():
    scans = [
        replace(scan, points=np.full_like(scan.points, np.nan))
        for scan in flight(5, DepthNoise(0.003))
    ]
    assert measured_noise(scans) == DEFAULT_NOISE


def test_measured_noise__reads_no_further_than_it_needs():
    scan = wall_scan(np.random.default_rng(6), DepthNoise(0.004))
    read = []

    def endless():
        while True:
            read.append(1)
            yield scan

    assert measured_noise(endless()).at(1.0) == pytest.approx(0.004, rel=0.1)
    assert len(read) < 40


def test_depth_noise__takes_what_is_configured():
    assert depth_noise(iter(()), SensorConfig(noise_m=0.02)) == DepthNoise(0.02, 0.0)
    both = SensorConfig(noise_m=0.02, noise_relative=0.01)
    assert depth_noise(iter(()), both) == DepthNoise(0.02, 0.01)


def test_depth_noise__tells_where_it_is_from():
    """Mixed pixels are measured beside noise that is configured, too."""
    scans = [steps(True, seed=k) for k in range(8)]
    given = depth_noise(scans, SensorConfig(noise_m=0.005))
    assert (given.source, given.mixed, given.mixed_source) == ("configured", True, "measured")
    flat = flight(7, DepthNoise(0.006))
    found = depth_noise(flat, SensorConfig(mixed_pixels=True))
    assert (found.source, found.mixed, found.mixed_source) == ("measured", True, "configured")
    unknown = depth_noise([], SensorConfig())
    assert (unknown.source, unknown.mixed, unknown.mixed_source) == ("default", False, "default")


def test_depth_noise__is_measured_otherwise():
    scans = flight(7, DepthNoise(0.006))
    assert depth_noise(scans, SensorConfig()).at(1.0) == pytest.approx(0.006, rel=0.1)


def steps(mixed, *, seed=0, share=0.6):
    """Scan of posts before a wall; where pixels mix, edges have a depth in between."""
    rng = np.random.default_rng(seed)
    x = np.full((40, 60), 2.0)
    for left in range(5, 55, 10):
        x[:, left : left + 4] = 1.0
        if mixed:
            for edge in (left - 1, left + 4):
                some = rng.random(40) < share
                x[some, edge] = rng.uniform(1.2, 1.8, int(some.sum()))
    x += rng.normal(0.0, 0.005, x.shape)
    points = np.stack([x, np.zeros_like(x), np.zeros_like(x)], axis=-1).reshape(-1, 3)
    return replace(make_scan(points.astype(np.float32)), width=60, height=40)


@pytest.mark.parametrize("mixed", [False, True])
def test_has_mixed_pixels__tells_blurred_edges_from_sharp_ones(mixed):
    scans = [steps(mixed, seed=k) for k in range(4)]
    assert has_mixed_pixels(scans, DepthNoise(0.005)) is mixed
    assert not has_mixed_pixels(scans, DepthNoise(0.1))  # no step stands out of that noise


def test_has_mixed_pixels__a_few_are_no_sign():
    scans = [steps(True, seed=k, share=0.1) for k in range(4)]
    assert not has_mixed_pixels(scans, DepthNoise(0.005))


def test_has_mixed_pixels__of_too_few_steps_or_no_rows_is_not_known():
    scan = steps(True)
    flat = replace(scan, width=len(scan.points), height=1)
    small = replace(scan, points=scan.points[: 60 * 4], height=4)
    assert not has_mixed_pixels([small], DepthNoise(0.005))
    assert not has_mixed_pixels([flat] * 3, DepthNoise(0.005))
    assert not has_mixed_pixels([], DepthNoise(0.005))


@pytest.mark.parametrize("given", [False, True])
def test_depth_noise__mixed_pixels_as_configured(given):
    config = SensorConfig(mixed_pixels=given)
    assert depth_noise([steps(not given, seed=k) for k in range(4)], config).mixed is given
