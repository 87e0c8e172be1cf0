"""The beams that stand to question, and what a pass over the flight says of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.cylinder.evidence_kernels import COARSE, FINE, NORMAL_COLUMNS, Evidence
from beamseg_batch.cylinder.ray_kernels import perpendiculars
from beamseg_batch.geometry import FloatArray, covariance_along, parabola, unknown
from beamseg_batch.model import CrossSection

__all__ = ["Answer", "Beam", "Sums", "normal_matrices", "normal_matrix"]

_MARGIN_BINS = 15
"""Coarse bins beyond each end in which evidence is gathered: 0.3 m."""

_FINE_A_COARSE = round(COARSE / FINE)

# Which column holds which product of offsets along u and v, slopes, and radius.
_MATRIX = np.array(
    [
        [0, 1, 3, 4, 16],
        [1, 2, 4, 5, 17],
        [3, 4, 6, 7, 18],
        [4, 5, 7, 8, 19],
        [16, 17, 18, 19, 20],
    ]
)
_RIGHT = np.array([9, 10, 11, 12, 21])


@dataclass(frozen=True, eq=False)
class Beam:
    """A beam of the hypothesis, in the world frame.

    Attributes
    ----------
    anchor, direction : (3,) float64
    first, last : float, metres
        Ends: ``anchor + first * direction`` and likewise.
    radius : float, metres
    bow : (3,) float64, metres
        By how much the axis leaves that chord midway between the ends: a parabola, which
        goes on beyond them. Zero for a straight beam.
    score : float
        Log-likelihood ratio of the evidence between the ends: beam against none.
    hits : float
        Rays between the ends that it explains alone.
    scans : int
        Scans that hold at least three of them.
    first_seen_ns, last_seen_ns : int
        Stamps of the first and the last scan in which a line of it was found.
    covariance : (6, 6) float64, metres and radians
        Of the anchor and the direction.
    reduced_chi2 : float
    free_radius, sigma_radius : float, metres
        The radius, were it measured with the axis, and its standard deviation.
    growth : (4,) float64
        How the axis must move as the radius grows, to stay as near to the rays as it can:
        offsets along `normals` a metre, and slopes.
    snapped : (bool, bool)
        Whether an end was drawn to another axis.
    sigma_ends : (2,) float64, metres
        Standard deviations of the ends along the axis.
    ends_seen : (bool, bool) or None
        Whether rays deny that the beam goes on; None where they were not asked.
    measured_bow : (3,) float64, metres
        The bow that fits best, whether the beam is taken for straight or not.
    sigma_bow : float, metres
        Standard deviation of its length.
    stiff : bool
        Whether it was taken for bent once, and the rays then did not show that clearly.
    flanks : (3, 2) float64
        Rays that pass closely on its left and right and found something at its depth, or
        nothing; then all of them, scan by scan, as on the side that found more.
    beside : float
        Share of those that found something, on the worse side, as the median over stretches
        of the axis; NaN where too few passed.
    profile : (N,) float64
        Log-likelihood ratios along the axis, by fine bin, from `profile_start` on, metres.
    profile_start : float
    number : int
        Its name among the candidates, the same from pass to pass; -1 where they have none.
    cross_section : CrossSection
    doubtful : bool
        Whether no scan showed it, so that all rays together must show that it stands free.
    """

    anchor: FloatArray
    direction: FloatArray
    first: float
    last: float
    radius: float
    bow: FloatArray = field(default_factory=lambda: np.zeros(3))
    score: float = 0.0
    hits: float = 0.0
    scans: int = 0
    first_seen_ns: int = 0
    last_seen_ns: int = 0
    covariance: FloatArray = field(default_factory=lambda: unknown((6, 6)))
    reduced_chi2: float = 1.0
    free_radius: float = np.nan
    sigma_radius: float = np.nan
    growth: FloatArray = field(default_factory=lambda: np.zeros(4))
    snapped: tuple[bool, bool] = (False, False)
    sigma_ends: FloatArray = field(default_factory=lambda: unknown(2))
    ends_seen: tuple[bool, bool] | None = None
    measured_bow: FloatArray = field(default_factory=lambda: unknown(3))
    sigma_bow: float = np.nan
    stiff: bool = False
    flanks: FloatArray = field(default_factory=lambda: np.zeros((3, 2)))
    beside: float = np.nan
    profile: FloatArray = field(default_factory=lambda: np.zeros(0))
    profile_start: float = 0.0
    number: int = -1
    cross_section: CrossSection = field(default_factory=CrossSection)
    doubtful: bool = False

    @property
    def normals(self) -> tuple[FloatArray, FloatArray]:
        """(3,), (3,) float64: unit vectors normal to the axis and to one another."""
        return perpendiculars(self.direction)

    @cached_property
    def is_bent(self) -> bool:
        """Whether the axis leaves its chord."""
        return bool(self.bow.any())

    @property
    def length(self) -> float:
        """Distance between the ends, metres."""
        return self.last - self.first

    @property
    def ends(self) -> tuple[FloatArray, FloatArray]:
        """(3,), (3,) float64, metres: both ends."""
        return self.at(self.first), self.at(self.last)

    def resized(self, radius: float) -> Beam:
        """Return the beam with another radius, its axis moved so that it fits as well as it can."""
        step = (radius - self.radius) * self.growth
        u, v = self.normals
        direction = self.direction + step[2] * u + step[3] * v
        return replace(
            self,
            anchor=self.anchor + step[0] * u + step[1] * v,
            direction=direction / np.linalg.norm(direction),
            radius=radius,
        )

    def bare(self) -> Beam:
        """Return the same beam without its profile, to be sent elsewhere."""
        return replace(self, profile=np.zeros(0))

    def at(self, s: float) -> FloatArray:
        """Point of the axis."""
        point: FloatArray = self.anchor + s * self.direction
        return point + parabola(s, self.first, self.last)[0] * self.bow if self.is_bent else point

    def tangent(self, s: float) -> Beam:
        """Return the straight beam that touches the axis at a place, which it has in common."""
        if not self.is_bent:
            return self
        direction = self.direction + parabola(s, self.first, self.last)[1] * self.bow
        direction /= np.linalg.norm(direction)
        anchor = self.at(s) - s * direction
        return replace(self, anchor=anchor, direction=direction, bow=np.zeros(3))

    def between(self, first: float, last: float) -> Beam:
        """Return the same axis with other ends, the anchor midway on the chord."""
        middle = 0.5 * (first + last)
        moved = np.eye(6)
        moved[:3, 3:] = middle * np.eye(3)
        scale = ((last - first) / self.length) ** 2
        chord: dict[str, Any] = {
            "anchor": self.at(middle), "first": first - middle, "last": last - middle
        }  # fmt: skip
        if self.is_bent:
            chord = _chord(self.at(first), self.at(last), scale * self.bow)
        return replace(
            self,
            **chord,
            measured_bow=scale * self.measured_bow,
            sigma_bow=scale * self.sigma_bow,
            covariance=moved @ self.covariance @ moved.T,
            profile_start=self.profile_start - middle,
        )

    def covariance_at(self, s: float) -> FloatArray:
        """(3, 3) float64, square metres: of a point of the axis, across it."""
        return covariance_along(self.covariance, s)

    def profile_between(self, first: float, last: float) -> FloatArray:
        """(N,) float64: the bins of the profile on a stretch of the axis."""
        low, high = ((place - self.profile_start) / FINE for place in (first, last))
        return self.profile[max(round(low), 0) : max(round(high), 0)]

    def evidence_between(self, first: float, last: float) -> float:
        """Sum of the profile over a stretch of the axis."""
        return float(self.profile_between(first, last).sum())


def _chord(start: FloatArray, end: FloatArray, bow: FloatArray) -> dict[str, Any]:
    """Lay an axis between its ends."""
    length = float(np.linalg.norm(end - start))
    direction = (end - start) / length
    return {
        "anchor": 0.5 * (start + end),
        "direction": direction,
        "first": -0.5 * length,
        "last": 0.5 * length,
        "bow": bow - (bow @ direction) * direction,
    }


class Sums:
    """Evidence about some beams, summed along their axes.

    Parameters
    ----------
    beams : sequence of Beam
    flanks : bool
        Whether rays that pass the beams closely are asked, too.

    Attributes
    ----------
    starts, stops : (M,) float64, metres
        The stretch of each axis along which evidence is summed.
    evidence : Evidence
    """

    def __init__(self, beams: Sequence[Beam], *, flanks: bool = False) -> None:
        count = len(beams)
        self._names = ("asked", "scans", "scatter", *(["flanks"] if flanks else []))
        lengths = np.array([beam.length for beam in beams])
        bins = np.ceil(lengths / COARSE).astype(np.int64) + 2 * _MARGIN_BINS
        coarse_at = np.concatenate([[0], np.cumsum(bins)]).astype(np.int64)
        fine_at = coarse_at * _FINE_A_COARSE
        self.starts = np.array([beam.first - _MARGIN_BINS * COARSE for beam in beams])
        self.stops = self.starts + np.diff(fine_at) * FINE
        self.evidence = Evidence(
            fine_at=fine_at,
            coarse_at=coarse_at,
            likelihood=np.zeros(fine_at[-1]),
            hits=np.zeros(fine_at[-1]),
            normal=np.zeros((coarse_at[-1], NORMAL_COLUMNS)),
            scans=np.zeros(count, np.int64),
            flanks=np.zeros((count if flanks else 0, 3, 2)),
            beside=np.zeros((coarse_at[-1] if flanks else 0, 2, 2)),
            scatter=np.zeros((count, 7, 7)),
            asked=np.zeros(count, np.int64),
        )

    def answer(self) -> Answer:
        """What was summed of the beams that were asked about."""
        beams = np.flatnonzero(self.evidence.asked)
        rows = self._rows(beams)
        return Answer(beams, {name: getattr(self.evidence, name)[rows[name]] for name in rows})

    def add(self, answer: Answer) -> None:
        """Take in what some scans answered about the same beams."""
        for name, rows in self._rows(answer.beams).items():
            getattr(self.evidence, name)[rows] += answer.sums[name]

    def _rows(self, beams: NDArray[np.int64]) -> dict[str, NDArray[np.int64]]:
        """Which rows of each sum belong to some beams; not in the time that all of them take."""
        fine, coarse = (
            np.concatenate([np.arange(at[beam], at[beam + 1]) for beam in beams] or [beams[:0]])
            for at in (self.evidence.fine_at, self.evidence.coarse_at)
        )
        rows = dict.fromkeys(self._names, beams)
        rows |= {"beside": coarse} if "flanks" in self._names else {}
        return rows | {"likelihood": fine, "hits": fine, "normal": coarse}

    def fine(self, index: int) -> tuple[FloatArray, FloatArray]:
        """Log-likelihood ratios and hits of one beam, by fine bin."""
        part = slice(*self.evidence.fine_at[index : index + 2])
        return self.evidence.likelihood[part], self.evidence.hits[part]

    def coarse(self, index: int) -> FloatArray:
        """(N, 22) float64: normal equations of one beam, by coarse bin."""
        return self.evidence.normal[slice(*self.evidence.coarse_at[index : index + 2])]

    def beside(self, index: int) -> FloatArray:
        """(N, 2, 2) float64: rays that passed one beam closely, by coarse bin."""
        return self.evidence.beside[slice(*self.evidence.coarse_at[index : index + 2])]

    def middles(self, index: int) -> FloatArray:
        """(N,) float64, metres: where the middles of the coarse bins of a beam are."""
        bins = np.arange(len(self.coarse(index)), dtype=np.float64) + 0.5
        middles: FloatArray = float(self.starts[index]) + bins * COARSE
        return middles

    def place(self, index: int, fine_bin: float) -> float:
        """Where a fine bin of a beam begins, along its axis, metres."""
        return float(self.starts[index] + fine_bin * FINE)

    def coarse_bins(self, index: int, first: float, last: float) -> slice:
        """Coarse bins of a beam whose middles lie on a stretch of its axis."""
        low = int(np.ceil((first - self.starts[index]) / COARSE - 0.5))
        high = int(np.ceil((last - self.starts[index]) / COARSE - 0.5))
        return slice(max(low, 0), max(high, 0))


@dataclass(frozen=True, eq=False)
class Answer:
    """What the rays of some scans say of those beams that they were asked about.

    Attributes
    ----------
    beams : (B,) int64
        Indices into the beams of the question.
    sums : mapping of str to array
        Their rows of each sum of `beamseg_batch.cylinder.evidence_kernels.Evidence`.
    """

    beams: NDArray[np.int64]
    sums: Mapping[str, NDArray[Any]]


def normal_matrix(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Normal equations of an axis and a radius from the sums of some bins.

    Parameters
    ----------
    rows : (N, 22) float64

    Returns
    -------
    matrix : (5, 5) float64
        The axis' offsets and slopes, then the radius.
    right : (5,) float64
    """
    return normal_matrices(rows.sum(axis=0))


def normal_matrices(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Normal equations of an axis and a radius, of each bin.

    Parameters
    ----------
    rows : (..., 22) float64

    Returns
    -------
    matrices : (..., 5, 5) float64
        The axis' offsets and slopes, then the radius.
    rights : (..., 5) float64
    """
    return rows[..., _MATRIX], rows[..., _RIGHT]
