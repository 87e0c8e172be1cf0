"""What the clouds of a flight show: ranges, pixels, widths of beams, the floor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import Scan
from beamseg_batch.recording.flight import Flight

__all__ = ["Survey", "survey_flight", "surveyed_scans"]

_MOST_SCANS = 120
_RANGE_STEP_M, _RANGE_BINS = 0.05, 2000
_HEIGHT_STEP_M, _HEIGHT_BINS = 0.02, 20_000
_EDGE_M = 0.15
"""How much farther than a beam what stands behind it is."""
_SHARP = 3.0
"""How many times as large as the range's steps within a thing the jump at its edge is."""
_FEWEST_WIDE = 4
"""Pixels across a beam from which its width is measured."""
_WIDEST_RAD = 0.35
"""Angle from which a thing is no beam, but a patch of floor or wall, at most ranges."""
_RADII = np.geomspace(0.005, 0.25, 79)
_CENTRES = np.sqrt(_RADII[:-1] * _RADII[1:])
_FEWEST_WIDTHS = 200
_PEAK_SHARE, _PEAK_REACH = 0.1, 3
_NEAR_RANGES = 200
"""Steps of range in which things that may be beams are counted."""
_NEAR_PIXELS, _NEAR_REACH, _FEWEST_RUNS = 4, 1.5, 50
"""A radius is averaged where it is so many pixels wide, over widths so many times off at most."""
_FLANK, _PROMINENCE = 6, 1.8
"""A peak of radii is so many times as high as both of its flanks, a third smaller and larger."""
_FLOOR_SHARE, _FLOOR_OF_HIGHEST = 0.03, 0.2


@dataclass
class Survey:
    """Histograms and samples over some scans of a flight.

    Attributes
    ----------
    n_scans, n_returns : int
    width, height : int
        Pixels of the clouds.
    ranges : (2000,) int64
        Returns by range, in steps of 0.05 m from 0.
    heights : (20000,) int64
        Returns by height in the world frame, in steps of 0.02 m from -200 m.
    radii : (78,) int64
        Pixels on things narrow and free enough to be beams, by the radius they would have.
    runs : (78, 200) float64
        Cuts through such things, by that radius and by range, in steps of 0.05 m from 0.
    ahead, aside, above : list of float
        Per scan 99 % of the returns have a smaller x, absolute y and z, sensor axes, metres.
    pitches : list of float
        Per scan, angle between neighbouring pixels, radians.
    """

    n_scans: int = 0
    n_returns: int = 0
    width: int = 0
    height: int = 0
    ranges: NDArray[np.int64] = field(default_factory=lambda: np.zeros(_RANGE_BINS, np.int64))
    heights: NDArray[np.int64] = field(default_factory=lambda: np.zeros(_HEIGHT_BINS, np.int64))
    radii: NDArray[np.int64] = field(default_factory=lambda: np.zeros(len(_RADII) - 1, np.int64))
    runs: FloatArray = field(default_factory=lambda: np.zeros((len(_RADII) - 1, _NEAR_RANGES)))
    ahead: list[float] = field(default_factory=list)
    aside: list[float] = field(default_factory=list)
    above: list[float] = field(default_factory=list)
    pitches: list[float] = field(default_factory=list)

    def add(self, scan: Scan) -> None:
        """Take in a scan."""
        points = np.asarray(scan.points, dtype=np.float64)
        seen = points[np.isfinite(points).all(axis=1)]
        if len(seen) == 0:
            return
        self.n_scans += 1
        self.n_returns += len(seen)
        self.width, self.height = scan.width, scan.height
        self.ranges += _histogram(np.linalg.norm(seen, axis=1) / _RANGE_STEP_M, _RANGE_BINS)
        z = scan.T_world_sensor.apply(seen)[:, 2]
        self.heights += _histogram(z / _HEIGHT_STEP_M + _HEIGHT_BINS // 2, _HEIGHT_BINS)
        for values, bounds in zip(seen.T, (self.ahead, self.aside, self.above), strict=True):
            bounds.append(float(np.quantile(np.abs(values), 0.99)))
        if scan.height > 1:
            self._add_image(points.reshape(scan.height, scan.width, 3))

    def _add_image(self, image: FloatArray) -> None:
        depths = np.linalg.norm(image, axis=2)
        depths[~np.isfinite(depths) | (depths == 0.0)] = np.nan
        with np.errstate(invalid="ignore"):
            rays = image / depths[:, :, None]
        pitch = _angles(rays[:, :-1], rays[:, 1:])
        if np.isfinite(pitch).any():
            self.pitches.append(float(np.nanmedian(pitch)))
        radii, ranges, counts = _beam_radii(depths, rays)
        self.radii += np.histogram(radii[counts >= _FEWEST_WIDE], _RADII)[0]
        steps = np.arange(_NEAR_RANGES + 1) * _RANGE_STEP_M
        self.runs += np.histogram2d(radii, ranges, (_RADII, steps), weights=1.0 / counts)[0]

    def far_range(self, share: float) -> float:
        """Range within which a share of the returns lies, metres."""
        reached = np.searchsorted(np.cumsum(self.ranges), share * self.ranges.sum())
        return float((reached + 1) * _RANGE_STEP_M)

    @property
    def pitch_rad(self) -> float | None:
        """Angle between neighbouring pixels, radians; None when the clouds are no images."""
        return float(np.median(self.pitches)) if self.pitches else None

    @property
    def floor_m(self) -> float | None:
        """Height of the lowest level surface, metres, world frame; None when none stands out."""
        layers = np.convolve(self.heights, np.ones(3, np.int64), "same")
        fewest = max(_FLOOR_SHARE * self.n_returns, _FLOOR_OF_HIGHEST * layers.max(initial=0))
        dense = np.flatnonzero(layers >= fewest) if self.n_returns else np.empty(0, np.intp)
        if len(dense) == 0:
            return None
        lowest = int(dense[0]) + int(np.argmax(layers[dense[0] : dense[0] + 5]))
        window = slice(max(lowest - 1, 0), lowest + 2)
        centres = (np.arange(_HEIGHT_BINS)[window] - _HEIGHT_BINS // 2 + 0.5) * _HEIGHT_STEP_M
        return float(np.average(centres, weights=self.heights[window]))

    def beam_radii(self) -> list[float]:
        """Radii that many things narrow and free have, from the largest on, metres."""
        smooth = np.convolve(self.radii, np.ones(_PEAK_REACH), "same")
        if self.radii.sum() < _FEWEST_WIDTHS:
            return []
        peaks = []
        for k in range(len(smooth)):
            around = smooth[max(k - _PEAK_REACH, 0) : k + _PEAK_REACH + 1]
            flanks = max(smooth[max(k - _FLANK, 0)], smooth[min(k + _FLANK, len(smooth) - 1)])
            fewest = max(_PEAK_SHARE * self.radii.sum(), _PROMINENCE * flanks)
            if smooth[k] == around.max() and smooth[k] >= fewest:
                peaks.append(k)
        found: list[float] = []
        for k in peaks:
            window = slice(max(k - 1, 0), k + 2)
            radius = float(np.average(_CENTRES[window], weights=self.radii[window]))
            if not found or radius > 1.3 * found[-1]:
                found.append(radius)
        return [self._averaged(radius) for radius in found[::-1]]

    def _averaged(self, radius: float) -> float:
        """Mean radius of the cuts near enough to be wide, whatever their number of pixels.

        A cut of w pixels shows the whole number above or below w, so that its mean is right
        where none is left out for being narrow, and none counts more for being wide.
        """
        reach = 2.0 * radius / (_NEAR_PIXELS * (self.pitch_rad or np.inf))
        near = self.runs[:, : int(reach / _RANGE_STEP_M)].sum(axis=1)
        near[(radius > _NEAR_REACH * _CENTRES) | (radius * _NEAR_REACH < _CENTRES)] = 0.0
        return radius if near.sum() < _FEWEST_RUNS else float(np.average(_CENTRES, weights=near))


def surveyed_scans(flight: Flight) -> Iterator[Scan]:
    """Some of a flight's scans, spread evenly over it.

    Parameters
    ----------
    flight : Flight

    Yields
    ------
    Scan
        120 at most.

    Raises
    ------
    RecordingError
        If the file cannot be read any further.
    """
    for scan in flight.thinned(-(-flight.n_clouds // _MOST_SCANS)).scans():
        if isinstance(scan, Scan):
            yield scan


def survey_flight(flight: Flight) -> Survey:
    """Look at some of a flight's scans.

    Parameters
    ----------
    flight : Flight

    Returns
    -------
    Survey
        Of those that `surveyed_scans` gives.

    Raises
    ------
    RecordingError
        If the file cannot be read any further.
    """
    survey = Survey()
    for scan in surveyed_scans(flight):
        survey.add(scan)
    return survey


def _histogram(values: FloatArray, n_bins: int) -> NDArray[np.int64]:
    bins = np.floor(values[(values >= 0.0) & (values < n_bins)]).astype(np.int64)
    return np.bincount(bins, minlength=n_bins)


def _angles(first: FloatArray, second: FloatArray) -> FloatArray:
    """Angle between unit vectors, exact for small ones too."""
    chord = np.linalg.norm(first - second, axis=-1)
    angles: FloatArray = 2.0 * np.arcsin(np.clip(0.5 * chord, 0.0, 1.0))
    return angles


def _beam_radii(depths: FloatArray, rays: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Radius that a cylinder would have at each pixel of a narrow, free-standing thing.

    A thing is seen under an angle along its row and under one along its column; the width
    across a beam that leans lies between: ``1/w^2 = 1/w_row^2 + 1/w_column^2``. A cylinder
    that fills an angle ``2 a`` has its axis at ``r / sin a``, and its surface, on the mean
    of its width, at ``r pi/4`` before that.

    Returns
    -------
    radii : (N,) float64, metres
    ranges : (N,) float64, metres
    counts : (N,) float64
        Pixels of the narrower cut through each.
    """
    rows, n_row = _free_angles(depths, rays)
    columns, n_column = (each.T for each in _free_angles(depths.T, rays.transpose(1, 0, 2)))
    with np.errstate(divide="ignore", invalid="ignore"):
        widths = (rows**-2 + columns**-2) ** -0.5
    narrow = np.isfinite(widths) & (widths < _WIDEST_RAD)
    sines, ranges = np.sin(0.5 * widths[narrow]), depths[narrow]
    counts = np.minimum(n_row, n_column)[narrow]
    return ranges * sines / (1.0 - 0.25 * np.pi * sines), ranges, counts


def _are_smooth(
    steps: FloatArray, row: NDArray[np.intp], left: NDArray[np.intp], right: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Whether runs vary little within, against their ends: a floor seen at a flat angle does not.

    Parameters
    ----------
    steps : (height, width - 1) float64
        Absolute change of the range from pixel to pixel, metres.
    row, left, right : (N,) int
        Of each run, its row and the steps at its ends.

    Returns
    -------
    (N,) bool
    """
    if len(row) == 0:
        return np.empty(0, dtype=bool)
    first = row * steps.shape[1]
    bounds = np.stack([first + left + 1, first + right], axis=1).ravel()
    within = np.maximum.reduceat(steps.ravel(), bounds)[::2]
    ends = np.minimum(steps[row, left], steps[row, right])
    are_smooth: NDArray[np.bool_] = _SHARP * within < ends
    return are_smooth


def _free_angles(depths: FloatArray, rays: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Angle under which each pixel's run of its row is seen, and its pixels; infinite if not free.

    A run ends where the range jumps, by far more than anywhere within it. It is free when
    what is on both of its sides lies farther away, or gives no return, and it does not
    touch the edge of the image.
    """
    far = np.where(np.isfinite(depths), depths, np.inf)
    with np.errstate(invalid="ignore"):
        steps = np.diff(far, axis=1)
    steps[np.isnan(steps)] = 0.0  # no return beside no return
    rows, columns = np.nonzero(np.abs(steps) > _EDGE_M)
    row, left, right = rows[:-1], columns[:-1], columns[1:]
    count = right - left
    free = (row == rows[1:]) & (count >= 2)
    free[free] = (steps[row[free], left[free]] < 0.0) & (steps[row[free], right[free]] > 0.0)
    row, left, right, count = row[free], left[free], right[free], count[free]
    smooth = _are_smooth(np.abs(steps), row, left, right)
    row, left, right, count = row[smooth], left[smooth], right[smooth], count[smooth]
    # From the middle of the first pixel to that of the last, and half a pixel more on each side.
    widths = _angles(rays[row, left + 1], rays[row, right]) * count / np.maximum(count - 1, 1)
    angles, counts = np.full((2, depths.size), np.inf)
    first = row * depths.shape[1] + left + 1
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    pixels = np.repeat(first, count) + within
    angles[pixels], counts[pixels] = np.repeat(widths, count), np.repeat(count, count)
    return angles.reshape(depths.shape), counts.reshape(depths.shape)
