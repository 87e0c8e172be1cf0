"""How noisy the depths of a flight are, measured in its own clouds."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import islice

import numpy as np

from beamseg_batch.bearings import bearing_image
from beamseg_batch.config import SensorConfig
from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import DepthNoise, Scan

__all__ = ["DEFAULT_NOISE", "depth_noise", "has_mixed_pixels", "measured_noise"]

DEFAULT_NOISE = DepthNoise(0.01, source="default")
"""Of a camera about which nothing is known."""

_SMALLEST_M = 5e-4
_BINS = 8
_FEWEST_A_BIN = 200
_ENOUGH = 200_000  # samples
_MIXED = 0.35  # share of steps with a depth in between: 0.6 with mixed pixels, up to 0.17 without
_FEWEST_STEPS, _ENOUGH_STEPS, _MOST_SCANS = 100, 500, 200
_PLANAR = 0.5 / np.sqrt(6.0)  # metres: what is further off is an edge, whatever the noise
_LEAST_SPREAD = 0.05  # determinant of a plane's normal equations against that of a regular ring


def depth_noise(scans: Iterable[Scan], config: SensorConfig) -> DepthNoise:
    """Noise of the depths: as configured, else as measured.

    Parameters
    ----------
    scans : iterable of Scan
        Read no further than is needed.
    config : SensorConfig

    Returns
    -------
    DepthNoise
    """
    further = iter(scans)
    if config.noise_m is not None:
        noise = DepthNoise(config.noise_m, config.noise_relative or 0.0)
    else:
        noise = measured_noise(further)
    if config.mixed_pixels is not None:
        return replace(noise, mixed=config.mixed_pixels, mixed_source="configured")
    mixed = has_mixed_pixels(further, noise)
    return noise if mixed is None else replace(noise, mixed=mixed, mixed_source="measured")


def measured_noise(scans: Iterable[Scan]) -> DepthNoise:
    """Measure the noise on the flat parts of clouds.

    Parameters
    ----------
    scans : iterable of Scan
        Read no further than is needed.

    Returns
    -------
    DepthNoise
        1 cm where the clouds show nothing flat.

    Notes
    -----
    On a plane the inverse of the forward depth is linear across the pixels of a row. The
    second difference of three neighbours, times the squared depth, is noise with the
    variance ``6 sigma**2``. What is not flat is left out by the median: the deviation
    comes from the median of absolute values, renewed within two of itself. In clouds that
    are not organised the plane is that of the eight cells around one of an image of bearings.
    """
    depths, residuals, count = [], [], 0
    for scan in scans:
        if scan.height > 1 and len(scan.points) != scan.width * scan.height:
            continue
        x, residual = _along_rows(scan) if scan.height > 1 else _among_cells(scan)
        good = np.abs(residual) < _PLANAR
        depths.append(x[good])
        residuals.append(residual[good])
        count += int(good.sum())
        if count > _ENOUGH:
            break
    if count < _BINS * _FEWEST_A_BIN:
        return DEFAULT_NOISE
    return _fitted(np.concatenate(depths), np.concatenate(residuals))


def _along_rows(scan: Scan) -> tuple[FloatArray, FloatArray]:
    """Depths of the pixels of an image, and how far each lies off its neighbours in the row."""
    x = np.asarray(scan.points[:, 0], np.float64).reshape(scan.height, scan.width)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = np.where(np.isfinite(x) & (x > 0.0), 1.0 / x, np.nan)
        second = (inverse[:, :-2] - 2.0 * inverse[:, 1:-1] + inverse[:, 2:]) * x[:, 1:-1] ** 2
    return x[:, 1:-1].ravel(), second.ravel() / np.sqrt(6.0)


def _among_cells(scan: Scan) -> tuple[FloatArray, FloatArray]:
    """Depths in an image of bearings, and how far each lies off the plane around it."""
    image = bearing_image(scan.points, keep="middle")
    if image.width < 3 or image.height < 3:
        return np.empty(0), np.empty(0)
    with np.errstate(divide="ignore", invalid="ignore"):
        scaled = image.points / np.where(image.points[:, :1] > 0.0, image.points[:, :1], np.nan)
        scaled[:, 0] = 1.0 / image.points[:, 0]
    cells = scaled.reshape(image.height, image.width, 3)
    around = np.lib.stride_tricks.sliding_window_view(cells, (3, 3), axis=(0, 1))
    around = np.moveaxis(around.reshape(-1, 3, 9), 1, 2)
    around = around[np.isfinite(around).all(axis=(1, 2))]
    middle, ring = around[:, 4], np.delete(around, 4, axis=1)
    # The inverse depth as a plane over the bearing, seen from the middle.
    design = np.concatenate([np.ones_like(ring[..., :1]), ring[..., 1:] - middle[:, None, 1:]], 2)
    normal = np.einsum("nki,nkj->nij", design, design)
    regular = np.prod(np.diagonal(normal, axis1=1, axis2=2), axis=1)
    usable = np.linalg.det(normal) > _LEAST_SPREAD * regular
    inverse = np.linalg.inv(normal[usable])[:, 0]
    ring, middle, design = ring[usable], middle[usable, 0], design[usable]
    expected = np.einsum("ni,nki,nk->n", inverse, design, ring[..., 0])
    return 1.0 / middle, (middle - expected) / middle**2 / np.sqrt(1.0 + inverse[:, 0])


def has_mixed_pixels(scans: Iterable[Scan], noise: DepthNoise) -> bool | None:
    """Whether large steps of the depth often have one pixel in between.

    Parameters
    ----------
    scans : iterable of Scan
        Read no further than is needed; those without rows are left out.
    noise : DepthNoise

    Returns
    -------
    bool or None
        None where there are too few steps to tell.
    """
    steps = between = 0
    for scan in islice(scans, _MOST_SCANS):
        rows = scan.height > 1 and scan.width >= 5
        if not rows or len(scan.points) != scan.width * scan.height:
            continue
        x = np.asarray(scan.points[:, 0], np.float64).reshape(scan.height, scan.width)
        a, b, c, d, e = (x[:, k : scan.width - 4 + k] for k in range(5))
        with np.errstate(invalid="ignore"):
            sigma = np.hypot(noise.constant, noise.relative * c)
            flat = (np.abs(a - b) < 5.0 * sigma) & (np.abs(d - e) < 5.0 * sigma)
            step = flat & (np.abs(b - d) > 24.0 * sigma)
            low, high = np.minimum(b, d) + 6.0 * sigma, np.maximum(b, d) - 6.0 * sigma
            between += int((step & (c > low) & (c < high)).sum())
        steps += int(step.sum())
        if steps >= _ENOUGH_STEPS:
            break
    return between > _MIXED * steps if steps >= _FEWEST_STEPS else None


def _fitted(depths: FloatArray, residuals: FloatArray) -> DepthNoise:
    """Fit ``sigma**2 = constant**2 + (relative * depth)**2``, neither below zero."""
    order = np.argsort(depths)
    parts = np.array_split(order, _BINS)
    squares = np.array([np.median(depths[part]) for part in parts]) ** 2
    # Depths in whole millimetres, or of a simulated wall, may not differ at all.
    variances = np.array([max(_deviation(residuals[part]), _SMALLEST_M) for part in parts]) ** 2
    weights = 1.0 / variances
    design = np.stack([np.ones(_BINS), squares], axis=1) * weights[:, None]
    (constant, slope), *_ = np.linalg.lstsq(design, variances * weights, rcond=None)
    if slope < 0.0:
        constant, slope = np.average(variances, weights=weights**2), 0.0
    if constant < 0.0:
        constant = 0.0
        slope = np.average(variances / squares, weights=(weights * squares) ** 2)
    constant, slope = max(float(np.sqrt(constant)), _SMALLEST_M), float(np.sqrt(slope))
    return DepthNoise(constant, slope, source="measured")


def _deviation(values: FloatArray) -> float:
    """Standard deviation of the normal core of values with zero mean."""
    deviation = 1.4826 * float(np.median(np.abs(values)))
    for _ in range(5):
        core = values[np.abs(values) < 2.0 * deviation]
        deviation = float(np.sqrt(np.mean(core**2) / 0.7737)) if len(core) else deviation
    return deviation
