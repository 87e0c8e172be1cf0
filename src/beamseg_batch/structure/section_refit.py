"""Axis and ends of a beam whose section is known, from the rays along its own axis."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from beamseg_batch.geometry import FloatArray
from beamseg_batch.structure.ends import with_measured_ends
from beamseg_batch.structure.hypothesis import Beam
from beamseg_batch.structure.questions import END_PLACES
from beamseg_batch.structure.section_fit import SectionFit, about_axis, costs_with_ends, fit_again
from beamseg_batch.structure.section_question import END_MARGIN_M
from beamseg_batch.structure.sections import placed

__all__ = ["SectionRefit"]

_FEWEST_RAYS = 400
_GROUPS = 12  # parts of the flight, of which poses err alike
_FAR_MOVES: FloatArray = np.arange(-12.0, 13.0) * 0.02
_FINE_STEPS = 2
_DENIED = 12.0  # log-likelihood of three rays that saw through
_SHORTEST_M = 0.15


@dataclass(frozen=True)
class SectionRefit:
    """Measures axis and ends of a beam with its section; can be sent to another process.

    Attributes
    ----------
    reach, worst : float
        As of `beamseg_batch.structure.sections.SectionTrial`.
    pixel_m : float, metres
        Width of a pixel on a beam, where pixels mix depths.
    """

    reach: float
    worst: float
    pixel_m: float = 0.0

    def __call__(self, asked: tuple[Beam, FloatArray]) -> Beam:
        """Fit the section once more, and move the ends to where the rays put them.

        Parameters
        ----------
        asked : Beam and (N, 10) float64
            The rays near it, past its ends, too.

        Returns
        -------
        Beam
            The same, if its section is not known.

        Notes
        -----
        The first rays were collected along the axis of the cylinder that was found, which
        may lean, end early, or be that of a part of the section alone.
        """
        beam, rays = asked
        size, across = beam.cross_section.size, beam.cross_section.across
        if size is None or across is None:
            return beam
        u, v = beam.normals
        roll = float(np.arctan2(across @ v, across @ u))
        fit = self._fitted(beam, about_axis(size, roll), rays)
        if fit is None:
            return beam
        ended = self._with_ends(beam, fit, rays)
        again = self._fitted(ended, fit.p, rays)
        cross, inside = beam.cross_section, _inside(ended if again else beam, rays)
        moved = placed(
            beam, again or fit, inside, self.reach, self.worst, cross.name, cross.confidence
        )
        return replace(
            moved.between(ended.first, ended.last),
            sigma_ends=ended.sigma_ends,
            ends_seen=ended.ends_seen,
        )

    def _fitted(self, beam: Beam, p: FloatArray, rays: FloatArray) -> SectionFit | None:
        """Fit the section to the rays between the ends."""
        inside = _inside(beam, rays)
        size = beam.cross_section.size
        if size is None or len(inside) < _FEWEST_RAYS:
            return None
        sized = bool(beam.cross_section.name)
        return fit_again(size.shape, p, inside, self.reach, self.worst, sized=sized)

    def _with_ends(self, beam: Beam, fit: SectionFit, rays: FloatArray) -> Beam:
        """Return the beam with other ends on the same axis, from the same anchor."""
        likelihood = self._likelihood_of_ends(beam, fit, rays, _FAR_MOVES)
        for which, outermost in enumerate((0, -1)):
            whole = likelihood[:, 0, which].sum(axis=0)
            # What nothing denies may go on for ever, and stays as it was found.
            if not beam.snapped[which] and whole[outermost] < whole.max() - _DENIED:
                move = float(_FAR_MOVES[np.argmax(whole)])
                beam = _between(beam, beam.first + move * (not which), beam.last + move * which)
        for _ in range(_FINE_STEPS):
            likelihood = self._likelihood_of_ends(beam, fit, rays, END_PLACES)
            (moved,) = with_measured_ends([beam], likelihood, self.pixel_m)
            start = float((moved.anchor - beam.anchor) @ beam.direction)
            beam = _between(beam, moved.first + start, moved.last + start)
        return replace(beam, sigma_ends=moved.sigma_ends, ends_seen=moved.ends_seen)

    def _likelihood_of_ends(
        self, beam: Beam, fit: SectionFit, rays: FloatArray, moves: FloatArray
    ) -> FloatArray:
        """(G, 1, 2, N) float64: of each end moved by so much, by parts of the flight."""
        _, scans = np.unique(rays[:, 7], return_inverse=True)
        parts = scans * _GROUPS // (int(scans.max()) + 1)
        likelihood = np.empty((_GROUPS, 1, 2, len(moves)))
        for place, move in enumerate(moves):
            stretches = (beam.first + move, beam.last), (beam.first, beam.last + move)
            for which, ends in enumerate(stretches):
                costs = costs_with_ends(fit, *ends, rays, self.reach, self.worst)
                likelihood[:, 0, which, place] = -np.bincount(parts, costs, _GROUPS)
        return likelihood


def _inside(beam: Beam, rays: FloatArray) -> FloatArray:
    """Rays that pass a beam between its ends."""
    first, last = beam.first + END_MARGIN_M, beam.last - END_MARGIN_M
    return rays[(rays[:, 5] > first) & (rays[:, 5] < last)]


def _between(beam: Beam, first: float, last: float) -> Beam:
    """Return a beam with other ends, its anchor where it was, unless these leave nothing."""
    return replace(beam, first=first, last=last) if last - first > _SHORTEST_M else beam
