"""Which of several radii each beam has: the one with which the rays are likeliest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from beamseg_batch.structure.hypothesis import Beam, Sums
from beamseg_batch.structure.refinement import refit

__all__ = ["RadiusTrial"]

_ROUNDS = 2  # one to move the axis to where it fits, one to tell how well


class RadiusTrial:
    """Every beam with every radius in turn, at the same place of its axis.

    Parameters
    ----------
    beams : sequence of Beam
    radii : sequence of float, metres
    scans_alike : float, optional
        Number of successive scans that share an error of their poses.
    """

    def __init__(
        self, beams: Sequence[Beam], radii: Sequence[float], scans_alike: float = 1.0
    ) -> None:
        self._beams, self._scans_alike = list(beams), scans_alike
        self._waiting = list(radii)
        self._found: list[list[Beam]] = []
        self._present: list[Beam] = []
        self._begin()

    @property
    def is_over(self) -> bool:
        """Whether every radius was tried."""
        return not self._waiting

    @property
    def beams(self) -> list[Beam]:
        """The beams as they are to be asked about next."""
        return self._present

    def take(self, sums: Sums) -> bool:
        """Take in what all rays say of the beams as they are tried.

        Parameters
        ----------
        sums : Sums

        Returns
        -------
        bool
            Whether the trial is over.
        """
        self._rounds += 1
        if self._rounds < _ROUNDS:
            self._present = [
                refit(beam, index, beam.first, beam.last, sums, scans_alike=self._scans_alike)
                for index, beam in enumerate(self._present)
            ]
            return False
        self._found.append(
            [replace(beam, score=_score(k, beam, sums)) for k, beam in enumerate(self._present)]
        )
        self._waiting = self._waiting[1:]
        self._begin()
        return self.is_over

    def winners(self) -> list[Beam]:
        """Each beam with the radius that the rays like best."""
        return [max(tried, key=lambda beam: beam.score) for tried in zip(*self._found, strict=True)]

    def _begin(self) -> None:
        self._rounds = 0
        if self._waiting:
            self._present = [beam.resized(self._waiting[0]) for beam in self._beams]


def _score(index: int, beam: Beam, sums: Sums) -> float:
    likelihood, _ = sums.fine(index)
    places = np.array([sums.place(index, k + 0.5) for k in range(len(likelihood))])
    inside = (places > beam.first) & (places < beam.last)
    return float(likelihood[inside].sum())
