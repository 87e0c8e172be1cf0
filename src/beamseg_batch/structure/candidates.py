"""Sightings of single scans, gathered into candidates for beams."""

from __future__ import annotations

import numpy as np

from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import Segment
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
        self._rows = np.empty((16, 8))  # anchor, direction, both ends along it
        self._groups: list[_Group] = []

    def __len__(self) -> int:
        return len(self._groups)

    def add(self, segment: Segment) -> None:
        """Take in a sighting.

        Parameters
        ----------
        segment : Segment
            World frame, on the beam's axis.
        """
        index = self._nearest(segment)
        if index is None:
            index = len(self._groups)
            self._groups.append(_Group(segment))
            if index == len(self._rows):
                self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        self._groups[index].add(segment)
        self._rows[index] = self._groups[index].row()

    def _nearest(self, segment: Segment) -> int | None:
        """Index of the candidate whose axis passes nearest both ends, if near enough."""
        rows = self._rows[: len(self._groups)]
        anchors, directions = rows[:, 0:3], rows[:, 3:6]
        offsets, places = [], []
        for end in (segment.end_1, segment.end_2):
            apart = end - anchors
            along = np.einsum("ij,ij->i", apart, directions)
            offsets.append(np.linalg.norm(apart - along[:, None] * directions, axis=1))
            places.append(along)
        furthest = np.maximum(*offsets)
        near = (
            (furthest < self._most_offset)
            & (np.abs(directions @ segment.direction) > _MOST_ANGLE)
            & (np.minimum(*places) < rows[:, 7] + _BRIDGE_M)
            & (np.maximum(*places) > rows[:, 6] - _BRIDGE_M)
        )
        same = near & (np.array([g.radius for g in self._groups]) == segment.radius)
        if not same.any():
            return None
        return int(np.argmin(np.where(same, furthest, np.inf)))

    def beams(self, min_scans: int) -> list[Beam]:
        """Candidates seen in enough scans."""
        return [group.beam() for group in self._groups if group.sightings >= min_scans]


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
        weight = float(segment.n_points)
        for point in (segment.end_1, segment.midpoint, segment.end_2):
            self._weight += weight
            self._sum += weight * point
            self._products += weight * np.outer(point, point)
        self.anchor: FloatArray = self._sum / self._weight
        scatter = self._products / self._weight - np.outer(self.anchor, self.anchor)
        axis = np.linalg.eigh(scatter)[1][:, 2]
        self._direction = axis if axis @ self._direction > 0.0 else -axis
        ends = np.concatenate([self._ends, [segment.end_1, segment.end_2]])
        along = (ends - self.anchor) @ self._direction
        self.first, self.last = float(along.min()), float(along.max())
        self._ends = self.anchor + np.outer([self.first, self.last], self._direction)
        self.sightings += 1
        self.last_seen_ns = segment.last_seen_ns

    def row(self) -> FloatArray:
        return np.concatenate([self.anchor, self._direction, [self.first, self.last]])

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
