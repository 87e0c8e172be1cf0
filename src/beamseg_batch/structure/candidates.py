"""Sightings of single scans, gathered into candidates for beams."""

from __future__ import annotations

import numpy as np

from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import Segment
from beamseg_batch.structure.candidate_kernels import nearest_candidate
from beamseg_batch.structure.hypothesis import Beam

__all__ = ["Candidates"]

_MOST_ANGLE = np.cos(np.radians(4.0))
_BRIDGE_M = 0.4
_MOST_OFFSET_SIGMAS = 3.0
_LEAST_OFFSET_M = 0.03


class Candidates:
    """Beams proposed by the axes that single scans gave, each with those near it.

    Parameters
    ----------
    sigma : float, metres
        Noise of a depth, which sets how far apart two sightings of one beam may lie.

    Notes
    -----
    A candidate is the first principal axis of points on the axes of its sightings, so
    that a new sighting costs the same however many there were. Grouping is tight: two
    candidates for one beam are merged when all rays have been asked, but one for two
    beams is hard to take apart.
    """

    def __init__(self, sigma: float) -> None:
        self._most_offset = max(_LEAST_OFFSET_M, _MOST_OFFSET_SIGMAS * sigma * 0.75)
        self._rows = np.empty((16, 9))  # as of nearest_candidate
        self._groups: list[_Group] = []

    def __len__(self) -> int:
        return len(self._groups)

    def nearest(self, segment: Segment) -> int:
        """Return the index of the candidate that a sighting belongs to, -1 if there is none."""
        found: int = nearest_candidate(
            self._rows[: len(self._groups)], segment.end_1, segment.end_2, segment.radius,
            self._most_offset, _MOST_ANGLE, _BRIDGE_M,
        )  # fmt: skip
        return found

    def add(self, segment: Segment, index: int | None = None) -> int:
        """Take in a sighting.

        Parameters
        ----------
        segment : Segment
            World frame, on the beam's axis.
        index : int, optional
            What `nearest` says of it.

        Returns
        -------
        int
            Index of the candidate that it belongs to.
        """
        index = self.nearest(segment) if index is None else index
        if index < 0:
            index = len(self._groups)
            self._groups.append(_Group(segment))
            if index == len(self._rows):
                self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        self._groups[index].add(segment)
        self._rows[index] = self._groups[index].row()
        return index

    def beams(self, min_scans: int) -> list[Beam]:
        """Candidates seen in enough scans."""
        return [beam for beam, sightings in self.all() if sightings >= min_scans]

    def all(self) -> list[tuple[Beam, int]]:
        """Every candidate with the number of its sightings, in order of the first."""
        return [(group.beam(), group.sightings) for group in self._groups]


class _Group:
    def __init__(self, segment: Segment) -> None:
        self.radius = segment.radius
        self.sightings = 0
        self.first_seen_ns = segment.first_seen_ns
        self._weight = 0.0
        self._sum = np.zeros(3)
        self._products = np.zeros((3, 3))
        self._direction = segment.direction
        self._ends = np.array([segment.end_1, segment.end_2])

    def add(self, segment: Segment) -> None:
        points = np.array([segment.end_1, segment.midpoint, segment.end_2])
        self._weight += 3.0 * segment.n_points
        self._sum += segment.n_points * points.sum(axis=0)
        self._products += segment.n_points * (points.T @ points)
        self.anchor: FloatArray = self._sum / self._weight
        scatter = self._products / self._weight - self.anchor[:, None] * self.anchor
        axis = np.linalg.eigh(scatter)[1][:, 2].copy()  # in one piece, as kernels want it
        self._direction = axis if axis @ self._direction > 0.0 else -axis
        along = (np.concatenate([self._ends, points]) - self.anchor) @ self._direction
        self.first, self.last = float(along.min()), float(along.max())
        spread = np.array([[self.first], [self.last]]) * self._direction
        self._ends = self.anchor + spread
        self.sightings += 1
        self.last_seen_ns = segment.last_seen_ns

    def row(self) -> FloatArray:
        rest = [self.first, self.last, self.radius]
        return np.concatenate([self.anchor, self._direction, rest])

    def beam(self) -> Beam:
        return Beam(
            self.anchor,
            self._direction,
            self.first,
            self.last,
            self.radius,
            first_seen_ns=self.first_seen_ns,
            last_seen_ns=self.last_seen_ns,
        )
