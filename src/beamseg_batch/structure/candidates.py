"""Sightings of single scans, gathered into candidates for beams."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beamseg_batch.model import Segment
from beamseg_batch.structure.candidate_kernels import STATE_SIZE, grow, nearest_candidate
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
        self._states = np.zeros((16, STATE_SIZE))  # as of grow
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
            if index == len(self._rows):
                self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
                self._states = np.concatenate([self._states, np.zeros_like(self._states)])
            self._rows[index, 8] = segment.radius
            self._groups.append(_Group(segment.first_seen_ns))
        group = self._groups[index]
        group.sightings, group.last_seen_ns = group.sightings + 1, segment.last_seen_ns
        grow(
            self._states[index], self._rows[index],
            segment.anchor, segment.direction, segment.t_min, segment.t_max, segment.n_points,
        )  # fmt: skip
        return index

    def beams(self, min_scans: int) -> list[Beam]:
        """Candidates seen in enough scans."""
        return [beam for beam, sightings in self.all() if sightings >= min_scans]

    def all(self) -> list[tuple[Beam, int]]:
        """Every candidate with the number of its sightings, in order of the first."""
        return [(self._beam(index), group.sightings) for index, group in enumerate(self._groups)]

    def _beam(self, index: int) -> Beam:
        row, group = self._rows[index], self._groups[index]
        return Beam(
            row[:3].copy(),
            row[3:6].copy(),
            float(row[6]),
            float(row[7]),
            float(row[8]),
            first_seen_ns=group.first_seen_ns,
            last_seen_ns=group.last_seen_ns,
        )


@dataclass
class _Group:
    """When and how often a candidate was seen."""

    first_seen_ns: int
    last_seen_ns: int = 0
    sightings: int = 0
