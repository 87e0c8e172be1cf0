"""The beams that stand to question, and what a pass over the flight says of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from beamseg_batch.cylinder.evidence_kernels import COARSE, FINE, NORMAL_COLUMNS
from beamseg_batch.cylinder.ray_kernels import perpendiculars
from beamseg_batch.geometry import FloatArray

__all__ = ["Beam", "Sums", "normal_matrix"]

_MARGIN_BINS = 15
"""Coarse bins beyond each end in which evidence is gathered: 0.3 m."""

_FINE_A_COARSE = round(COARSE / FINE)


@dataclass(frozen=True, eq=False)
class Beam:
    """A beam of the hypothesis, in the world frame.

    Attributes
    ----------
    anchor, direction : (3,) float64
    first, last : float, metres
        Ends: ``anchor + first * direction`` and likewise.
    radius : float, metres
    score : float
        Log-likelihood ratio of the evidence between the ends: beam against none.
    hits : float
        Rays between the ends that it explains alone.
    scans : int
        Scans that hold at least three of them.
    first_seen_ns, last_seen_ns : int
        Stamps of the first and the last scan in which a line of it was found.
    covariance : (4, 4) float64
        Of the axis: offsets along `normals` at the anchor, metres, and slopes.
    reduced_chi2 : float
    flanks : (2, 2) float64
        Rays that pass closely on its left and right and found something at its depth, or
        nothing.
    profile : (N,) float64
        Log-likelihood ratios along the axis, by fine bin, from `profile_start` on, metres.
    profile_start : float
    """

    anchor: FloatArray
    direction: FloatArray
    first: float
    last: float
    radius: float
    score: float = 0.0
    hits: float = 0.0
    scans: int = 0
    first_seen_ns: int = 0
    last_seen_ns: int = 0
    covariance: FloatArray = field(default_factory=lambda: np.zeros((4, 4)))
    reduced_chi2: float = 1.0
    flanks: FloatArray = field(default_factory=lambda: np.zeros((2, 2)))
    profile: FloatArray = field(default_factory=lambda: np.zeros(0))
    profile_start: float = 0.0

    @property
    def normals(self) -> tuple[FloatArray, FloatArray]:
        """(3,), (3,) float64: unit vectors normal to the axis and to one another."""
        return perpendiculars(self.direction)

    @property
    def length(self) -> float:
        """Distance between the ends, metres."""
        return self.last - self.first

    @property
    def ends(self) -> tuple[FloatArray, FloatArray]:
        """(3,), (3,) float64, metres: both ends."""
        return self.at(self.first), self.at(self.last)

    def at(self, s: float) -> FloatArray:
        """Point of the axis."""
        return self.anchor + s * self.direction

    def between(self, first: float, last: float) -> Beam:
        """Return the same axis with other ends, the anchor midway."""
        middle = 0.5 * (first + last)
        return replace(
            self,
            anchor=self.at(middle),
            first=first - middle,
            last=last - middle,
            profile_start=self.profile_start - middle,
        )

    def evidence_between(self, first: float, last: float) -> float:
        """Sum of the profile over a stretch of the axis."""
        low, high = ((place - self.profile_start) / FINE for place in (first, last))
        bins = slice(max(round(low), 0), max(round(high), 0))
        return float(self.profile[bins].sum())


class Sums:
    """Evidence about some beams, summed along their axes; two of them can be added.

    Parameters
    ----------
    beams : sequence of Beam
    flanks : bool
        Whether rays that pass the beams closely are asked, too.
    """

    def __init__(self, beams: Sequence[Beam], *, flanks: bool = False) -> None:
        self.starts = np.array([beam.first - _MARGIN_BINS * COARSE for beam in beams])
        lengths = np.array([beam.length for beam in beams])
        bins = np.ceil(lengths / COARSE).astype(np.int64) + 2 * _MARGIN_BINS
        self.coarse_at = np.concatenate([[0], np.cumsum(bins)]).astype(np.int64)
        self.fine_at = self.coarse_at * _FINE_A_COARSE
        self.likelihood = np.zeros(self.fine_at[-1])
        self.hits = np.zeros(self.fine_at[-1])
        self.normal = np.zeros((self.coarse_at[-1], NORMAL_COLUMNS))
        self.scans = np.zeros(len(beams), np.int64)
        self.flanks = np.zeros((len(beams) if flanks else 0, 2, 2))

    def fine(self, index: int) -> tuple[FloatArray, FloatArray]:
        """Log-likelihood ratios and hits of one beam, by fine bin."""
        part = slice(self.fine_at[index], self.fine_at[index + 1])
        return self.likelihood[part], self.hits[part]

    def coarse(self, index: int) -> FloatArray:
        """(N, 16) float64: normal equations of one beam, by coarse bin."""
        return self.normal[self.coarse_at[index] : self.coarse_at[index + 1]]

    def place(self, index: int, fine_bin: float) -> float:
        """Where a fine bin of a beam begins, along its axis, metres."""
        return float(self.starts[index] + fine_bin * FINE)

    def coarse_bins(self, index: int, first: float, last: float) -> slice:
        """Coarse bins of a beam whose middles lie on a stretch of its axis."""
        low = int(np.ceil((first - self.starts[index]) / COARSE - 0.5))
        high = int(np.ceil((last - self.starts[index]) / COARSE - 0.5))
        return slice(max(low, 0), max(high, 0))


def normal_matrix(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Normal equations of an axis from the sums of some bins.

    Parameters
    ----------
    rows : (N, 16) float64

    Returns
    -------
    matrix : (4, 4) float64
    right : (4,) float64
    """
    uu, uv, vv, suu, suv, svv, ssuu, ssuv, ssvv = rows[:, :9].sum(axis=0)
    matrix = np.array(
        [[uu, uv, suu, suv], [uv, vv, suv, svv], [suu, suv, ssuu, ssuv], [suv, svv, ssuv, ssvv]]
    )
    right: FloatArray = rows[:, 9:13].sum(axis=0)
    return matrix, right
