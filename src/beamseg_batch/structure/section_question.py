"""Which rays of the flight pass near each beam, as they look along its axis."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.cylinder.near_kernels import RAY_COLUMNS, BesideBeams, gather_near
from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import Scan
from beamseg_batch.structure.hypothesis import Beam
from beamseg_batch.structure.questions import Beams, Camera

__all__ = ["END_MARGIN_M", "NearRays", "SectionQuestion", "reach_around"]

_REACH_M, _REACH_RADII = 0.15, 3.0
_MOST_A_SCAN = 150
_DIRECTIONS = 36
_MOST_A_DIRECTION = 150
END_MARGIN_M = 0.06
"""What stands this near to an end may not be of the section."""

_BEYOND_M = 0.3
_SAME = np.cos(np.radians(10.0))
_SAME_RADII = 2.2

Sample = NDArray[np.float32]
Samples = dict[int, Sample]
"""Rays by the number of their beam, (N, 10) float32; see `gather_near`."""


def reach_around(beams: Sequence[Beam]) -> float:
    """How far from an axis its section may reach, metres."""
    return max([_REACH_M, *(_REACH_RADII * beam.radius for beam in beams)])


class SectionQuestion:
    """Which rays pass near each beam, and how far they went.

    Parameters
    ----------
    beams : sequence of Beam
    camera : Camera
    standing : int
        The first so many are known to stand there; the others are not in their way.
    again : bool, optional
        Whether those alone are asked whose section is known, and past their ends as well.

    Attributes
    ----------
    reach : float, metres
    starts, stops : (M,) float64, metres
        The stretch of each axis that is asked about; nothing if it stops where it starts.
    """

    def __init__(
        self, beams: Sequence[Beam], camera: Camera, standing: int, *, again: bool = False
    ) -> None:
        self.camera, self.reach = camera, reach_around(beams)
        self._arrays = Beams(beams, "none")
        self._neighbours = _neighbours(beams, self.reach, standing)
        margin = -_BEYOND_M if again else END_MARGIN_M
        self.starts, self.stops = self._arrays.firsts + margin, self._arrays.lasts - margin
        if again:
            vague = [beam.cross_section.size is None for beam in beams]
            self.stops = np.where(vague, self.starts, self.stops)

    def ask(self, scans: Iterable[Scan]) -> Samples:
        """Collect the rays of some scans.

        Parameters
        ----------
        scans : iterable of Scan

        Returns
        -------
        mapping of int to (N, 10) float32
        """
        found: dict[int, list[Sample]] = {}
        arrays = self._arrays
        starts, stops = self.starts, self.stops
        counts = np.zeros(len(starts), np.int64)
        rays = np.empty((_MOST_A_SCAN * len(starts), RAY_COLUMNS))
        for scan in scans:
            gather_near(
                self.camera.view(scan), arrays.seen_from(scan, starts, stops),
                self.reach, self._neighbours, scan.index, _MOST_A_SCAN, rays, counts,
            )  # fmt: skip
            first = 0
            for index in np.flatnonzero(counts):
                last = first + counts[index]
                found.setdefault(int(index), []).append(rays[first:last].astype(np.float32))
                first = last
        return {index: np.concatenate(parts) for index, parts in found.items()}


class NearRays:
    """Rays near each beam, a bounded number, evenly from all sides that it was seen from.

    Which are kept does not depend on the order in which they came.
    """

    def __init__(self) -> None:
        self._parts: dict[int, list[Sample]] = {}

    def add(self, samples: Samples) -> None:
        """Take in the answer of some scans to a `SectionQuestion`."""
        for index, rays in samples.items():
            parts = self._parts.setdefault(index, [])
            parts.append(rays)
            if sum(map(len, parts)) > 2 * _DIRECTIONS * _MOST_A_DIRECTION:
                self._parts[index] = [_thinned(np.concatenate(parts))]

    def of(self, index: int) -> FloatArray:
        """(N, 10) float64: rays near one beam, scan after scan."""
        parts = self._parts.get(index)
        if not parts:
            return np.empty((0, RAY_COLUMNS))
        return _thinned(np.concatenate(parts)).astype(np.float64)


def _thinned(rays: Sample) -> Sample:
    """Keep so many rays of each direction: those that drew the lowest numbers."""
    turns = np.arctan2(rays[:, 1], rays[:, 0]) / (2.0 * np.pi) + 0.5
    sides = np.minimum((turns * _DIRECTIONS).astype(np.int64), _DIRECTIONS - 1)
    order = np.lexsort((rays[:, 8], sides))
    firsts = np.searchsorted(sides[order], np.arange(_DIRECTIONS))
    rank = np.arange(len(rays)) - firsts[sides[order]]
    return rays[np.sort(order[rank < _MOST_A_DIRECTION])]


def _neighbours(beams: Sequence[Beam], reach: float, standing: int) -> BesideBeams:
    """Beams that come near each, but for those that may be a part of the same section."""
    near = [
        [o for o, other in enumerate(beams[:standing]) if o != j and _is_beside(beam, other, reach)]
        for j, beam in enumerate(beams)
    ]
    at = np.concatenate([[0], np.cumsum([len(each) for each in near])]).astype(np.int64)
    return BesideBeams(at, np.array([o for each in near for o in each], np.int64))


def _is_beside(beam: Beam, other: Beam, reach: float) -> bool:
    places = np.linspace(other.first, other.last, 33)[:, None]
    apart = other.anchor + places * other.direction - beam.anchor
    along = apart @ beam.direction
    inside = np.clip(along, beam.first, beam.last)[:, None] * beam.direction
    distances = np.linalg.norm(apart - inside, axis=1)
    spacing = 0.5 * other.length / 32.0
    if distances.min() > reach + 2.0 * other.radius + spacing:
        return False
    parallel = abs(float(beam.direction @ other.direction)) > _SAME
    return not (parallel and distances.min() < _SAME_RADII * max(beam.radius, other.radius))
