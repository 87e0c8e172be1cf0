"""Which cross-section each beam has, as the rays from all sides show it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from beamseg_batch.catalogue import StandardSection
from beamseg_batch.cylinder.near_kernels import RAY_COLUMNS
from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import CrossSection
from beamseg_batch.section import Section
from beamseg_batch.structure.hypothesis import Beam
from beamseg_batch.structure.section_fit import (
    SectionFit,
    axis_covariance,
    fit_sections,
    fit_standard,
    is_richer,
    lead,
    section_bow,
)

__all__ = ["SectionTrial", "placed", "warm_up_sections", "without_parts"]

_FEWEST_HITS = 200
_FEWEST_SCANS = 8
_ROUND_A_HIT = 0.7  # cost of the hits on a round beam where depths have normal noise: 0.5
_ROUND_AT_MOST = 1.5
_WORST_A_HIT = 1.8
_THINNEST_M = 0.025
_WIDEST = 1.8  # of the reach: more would not be seen whole
_VIEW = np.pi / 18.0
_FEWEST_A_VIEW, _FEWEST_VIEWS = 5, 12
_EDGE_SHARE = 0.3  # of a third of a pixel by which edges, and so the axis, may be off
_PARALLEL, _GAP_M = float(np.cos(np.radians(6.0))), 0.05
_CLEAR_SIGMAS, _LIKELY_SIGMAS = 3.5, 1.5
_RICHER_SIGMAS = 2.0  # over a shape with more to choose, that still explains less
_CLEAR_SHARE = 0.03  # of all costs: what depends on details of the camera
_NEAR_SIZE_M, _NEAR_PLATE_M = 0.0025, 0.004
_MOST_STANDARD = 4
_STANDARD_SHARE = 0.01  # of all costs that a standard size may cost
_STANDARD_SIGMAS = 2.0


@dataclass(frozen=True)
class SectionTrial:
    """Finds the section of a beam; can be sent to another process.

    Attributes
    ----------
    reach : float, metres
        How far from the axis rays were collected.
    worst : float
        Cost of a ray that is not explained.
    catalogue : tuple of StandardSection
    """

    reach: float
    worst: float
    catalogue: tuple[StandardSection, ...] = ()

    def __call__(self, asked: tuple[Beam, FloatArray]) -> Beam:
        """Give a beam its section, and if that is not round, the axis through its centre.

        Parameters
        ----------
        asked : Beam and (N, 10) float64
            The rays near it; see `beamseg_batch.cylinder.near_kernels.gather_near`.

        Returns
        -------
        Beam
        """
        beam, rays = asked
        if beam.is_bent:
            return beam  # outlines are those of straight members
        hits = float((np.abs(rays[:, 3]) < self.reach).sum())
        if hits < _FEWEST_HITS or len(np.unique(rays[:, 7])) < _FEWEST_SCANS:
            return beam
        (circle,) = fit_sections(rays, self.reach, self.worst, ["round"])
        if circle.cost < _ROUND_A_HIT * hits:
            return beam
        (tube,) = fit_sections(rays, self.reach, self.worst, ["square"])
        ahead = lead(circle, tube, rays)
        if circle.cost < _ROUND_AT_MOST * hits and ahead.sigmas > _CLEAR_SIGMAS:
            return _as(beam, CrossSection(confidence=_confidence(ahead.sigmas)))
        return self._judged(beam, rays, fit_sections(rays, self.reach, self.worst), hits)

    def _judged(
        self, beam: Beam, rays: FloatArray, fits: Sequence[SectionFit], hits: float
    ) -> Beam:
        """Give the beam the likeliest section, if that is sure."""
        best = fits[0]
        leads = [lead(best, rival, rays) for rival in fits[1:]]
        sure = min(each.sigmas for each in leads)
        clear = all(
            each.sigmas > (_RICHER_SIGMAS if is_richer(rival, best) else _CLEAR_SIGMAS)
            and each.gain > _CLEAR_SHARE * best.cost
            for each, rival in zip(leads, fits[1:], strict=True)
        )
        confidence = _confidence(sure)
        if best.shape == "round" or not _beats_round(best, fits, rays):
            return _as(beam, CrossSection(confidence=confidence))
        whole = self._is_whole(best) and self._is_seen_around(rays)
        if not clear or not whole or best.cost > _WORST_A_HIT * hits:
            return _as(beam, CrossSection(shape="unknown", confidence=confidence))
        name, best = self._standard(best, rays)
        return placed(beam, best, rays, self.reach, self.worst, name, confidence)

    def _is_whole(self, fit: SectionFit) -> bool:
        """Whether all of a section lies where rays were collected; boards and walls go on."""
        sizes = (fit.section.width, fit.section.height)
        return min(sizes) > _THINNEST_M and max(sizes) < _WIDEST * self.reach

    def _is_seen_around(self, rays: FloatArray) -> bool:
        """Whether what was hit was seen from more than one side."""
        hits = rays[np.abs(rays[:, 3]) < self.reach]
        turns = np.floor(np.arctan2(hits[:, 1], hits[:, 0]) / _VIEW).astype(np.int64)
        _, counts = np.unique(turns, return_counts=True)
        return int((counts >= _FEWEST_A_VIEW).sum()) >= _FEWEST_VIEWS

    def _standard(self, fit: SectionFit, rays: FloatArray) -> tuple[str, SectionFit]:
        """Take the standard size that the section has, if one explains the rays as well."""
        near = [
            (apart, number, size)
            for number, entry in enumerate(self.catalogue)
            if entry.section.shape == fit.shape
            for size in _ways_round(entry.section)
            if (apart := _apart(fit.section, size)) < 1.0
        ]
        tried = [
            (fit_standard(fit, size, rays, self.reach, self.worst), number)
            for _, number, size in sorted(near, key=lambda each: each[:2])[:_MOST_STANDARD]
        ]
        if not tried:
            return "", fit
        best, number = min(tried, key=lambda each: each[0].cost)
        lost = lead(fit, best, rays)
        if lost.gain > _STANDARD_SHARE * fit.cost or lost.sigmas > _STANDARD_SIGMAS:
            return "", fit
        rivals = [lead(best, other, rays) for other, which in tried if which != number]
        if any(each.sigmas < _STANDARD_SIGMAS for each in rivals):
            return "", fit
        return self.catalogue[number].name, best


def _confidence(sigmas: float) -> float:
    """Probability that a difference of so many standard deviations is none by chance."""
    return 0.5 * math.erfc(-sigmas / math.sqrt(2.0))


def _beats_round(best: SectionFit, fits: Sequence[SectionFit], rays: FloatArray) -> bool:
    ahead = lead(best, next(fit for fit in fits if fit.shape == "round"), rays)
    return ahead.sigmas > _LIKELY_SIGMAS and ahead.gain > _CLEAR_SHARE * best.cost


def _ways_round(size: Section) -> list[Section]:
    """Sections of a size with its sides in either order, where both look alike."""
    if size.shape not in ("square", "l") or size.width == size.height:
        return [size]
    return [size, replace(size, width=size.height, height=size.width)]


def _apart(one: Section, other: Section) -> float:
    """How far two sizes differ, as a share of what is near."""
    sizes = [one.width - other.width, one.height - other.height]
    plates = [one.web - other.web, one.flange - other.flange] if one.shape != "square" else []
    return max(
        max(map(abs, sizes)) / _NEAR_SIZE_M, max(map(abs, plates), default=0.0) / _NEAR_PLATE_M
    )


def _as(beam: Beam, cross_section: CrossSection) -> Beam:
    return replace(beam, cross_section=cross_section)


def placed(
    beam: Beam,
    fit: SectionFit,
    rays: FloatArray,
    reach: float,
    worst: float,
    name: str,
    confidence: float,
) -> Beam:
    """Put the beam's axis through the centre of area of its section.

    Parameters
    ----------
    beam : Beam
    fit : SectionFit
    rays : (N, 10) float64
        That it was fitted to.
    reach, worst : float
        As of `SectionTrial`.
    name : str
        Of the standard size; empty for none.
    confidence : float

    Returns
    -------
    Beam
    """
    u, v = beam.normals
    centre, slopes, roll = fit.centre, fit.p[7:9], float(fit.p[4])
    direction = beam.direction + slopes[0] * u + slopes[1] * v
    across = np.cos(roll) * u + np.sin(roll) * v
    direction /= np.linalg.norm(direction)
    across -= (across @ direction) * direction
    frame = np.zeros((6, 4))
    frame[:3, 0], frame[:3, 1], frame[3:, 2], frame[3:, 3] = u, v, u, v
    bow, sigma_bow = section_bow(fit, rays, reach, worst, beam.first, beam.last)
    found = CrossSection(fit.shape, fit.section, across / np.linalg.norm(across), name, confidence)
    return replace(
        beam,
        anchor=beam.anchor + centre[0] * u + centre[1] * v,
        direction=direction,
        covariance=frame @ (axis_covariance(fit, rays) + _details(rays)) @ frame.T,
        measured_bow=bow[0] * u + bow[1] * v,
        sigma_bow=sigma_bow,
        free_radius=np.nan,
        sigma_radius=np.nan,
        cross_section=found,
    )


def _details(rays: FloatArray) -> FloatArray:
    """(4, 4) covariance of what pixels that mix the depths at edges do to these."""
    blurred = _EDGE_SHARE * float(np.median(rays[:, 6]))
    return np.diag([blurred**2, blurred**2, 0.0, 0.0])


def without_parts(beams: Sequence[Beam]) -> list[Beam]:
    """Drop beams that are a part of another's section, which takes in their length.

    Parameters
    ----------
    beams : sequence of Beam
        With their sections.

    Returns
    -------
    list of Beam
        In the same order.
    """
    order = sorted(range(len(beams)), key=lambda k: (_is_vague(beams[k]), -beams[k].score))
    kept: dict[int, Beam] = {}
    for index in order:
        beam = beams[index]
        for other, whole in kept.items():
            if (longer := _with_part(whole, beam)) is not None:
                kept[other] = longer
                break
        else:
            kept[index] = beam
    return [kept[index] for index in sorted(kept)]


def _is_vague(beam: Beam) -> bool:
    return beam.cross_section.size is None


def _with_part(whole: Beam, part: Beam) -> Beam | None:
    """Return a beam as long as both, if the other lies inside its section, or goes on with it."""
    size = whole.cross_section.size
    if size is None or abs(float(whole.direction @ part.direction)) < _PARALLEL:
        return None
    along = sorted(float((end - whole.anchor) @ whole.direction) for end in part.ends)
    middle = part.at(0.5 * (part.first + part.last))
    place = float((middle - whole.anchor) @ whole.direction)
    offset = float(np.linalg.norm(middle - whole.at(place)))
    inside = 0.6 * max(size.width, size.height)
    overlap = min(along[1], whole.last) - max(along[0], whole.first)
    if offset > inside or overlap < -_GAP_M:
        return None
    return whole.between(min(along[0], whole.first), max(along[1], whole.last))


def warm_up_sections() -> None:
    """Load or compile the kernels that fit sections, on a handful of made-up rays."""
    rays = np.zeros((8, RAY_COLUMNS))
    rays[:, 0], rays[:, 2], rays[:, 3], rays[:, 4] = 1.0, np.linspace(-0.07, 0.07, 8), -0.04, 0.01
    (fit,) = fit_sections(rays, 0.15, 1.0, ["round"])
    axis_covariance(fit, rays)
