"""The structure as a hypothesis that all rays of the flight are asked about, pass by pass."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from beamseg_batch.catalogue import load_catalogue
from beamseg_batch.config import RunConfig
from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import (
    Candidate,
    DepthNoise,
    Detections,
    Intersection,
    PoseJitter,
    Segment,
)
from beamseg_batch.structure.candidates import Candidates
from beamseg_batch.structure.ends import with_measured_ends
from beamseg_batch.structure.fates import Fates, Refusal
from beamseg_batch.structure.hypothesis import Beam, Sums
from beamseg_batch.structure.intersections import intersections_of
from beamseg_batch.structure.neighbours import Neighbours
from beamseg_batch.structure.pixel_rays import PixelRays
from beamseg_batch.structure.questions import (
    AxisQuestion,
    Camera,
    EndQuestion,
    LeftoverQuestion,
    Leftovers,
)
from beamseg_batch.structure.radius_classes import radius_classes, reclassed
from beamseg_batch.structure.radius_trial import RadiusTrial
from beamseg_batch.structure.refinement import PassRules, is_apart, refined, side_by_side
from beamseg_batch.structure.section_question import NearRays, SectionQuestion, reach_around
from beamseg_batch.structure.section_refit import SectionRefit
from beamseg_batch.structure.sections import SectionTrial, without_parts

__all__ = ["EvidenceStructure"]

_NO_JITTER = PoseJitter()
_SETTLED_ACROSS_M = 0.001
_SETTLED_ALONG_M = 0.005
_MEASURED_ALONG_M = 0.02  # by which an end may move along its axis, if it is measured afterwards
_MOST_SEARCHES = 3
_FINE_MEASUREMENTS = 4  # the last ones, in which only beams count that know their radius well
_EXACT_M = 1e-4
_LEAST_ASIDE, _LEAST_ASIDE_M, _MOST_ASIDE = 600.0, 0.3, 12
_BEHIND = 0.8  # radii from the visible surface to the axis, on average


@dataclass(frozen=True)
class _Pass:
    """One pass: who competes for rays, and what may be done afterwards.

    Attributes
    ----------
    competitors : str
        ``none``, ``likelier`` (than the beam itself) or ``all``.
    tukey : float
        Reach of Tukey's weight in the fit, sigmas.
    rules : PassRules
    flanks : bool
        Whether rays that pass the beams closely are asked, too.
    """

    competitors: str
    tukey: float
    rules: PassRules
    flanks: bool = False


_FRESH = (
    _Pass("none", 5.0, PassRules(drop=False)),
    _Pass("likelier", 5.0, PassRules(split=False)),
    _Pass("all", 5.0, PassRules(bow=True, trimmed=True), flanks=True),
)
"""Passes after new beams came: refit all, drop doubles, then let all compete."""

_SETTLING = _Pass("all", 4.0, PassRules(cut=True, snap=True, bow=True, trimmed=True), flanks=True)
"""The pass that is repeated until nothing moves."""


class EvidenceStructure:
    """Beams of a flight, found by asking every ray what it says about each.

    Parameters
    ----------
    config : RunConfig
    noise : DepthNoise
    jitter : PoseJitter, optional
        Of the poses of the scans.
    measurements : int, optional
        How often radii that beams measure replace the configured ones, at most: 0 where these
        are known, a few where they are right but for millimetres, more where they are a guess.
    """

    def __init__(
        self,
        config: RunConfig,
        noise: DepthNoise,
        jitter: PoseJitter = _NO_JITTER,
        *,
        measurements: int = 0,
    ) -> None:
        self.config = config
        self._jitter = jitter
        self._stamps_ns: list[int] = []
        self._radii = config.filtering.radii
        self._measurements = measurements
        self._pixels = PixelRays()
        self._camera = Camera(config.filtering, noise, self._pixels, jitter)
        self._candidates = Candidates(self._camera.sigma)
        self._fewest = config.structure.min_scans  # sightings of a candidate
        self._beams: list[Beam] | None = None
        self._waiting = list(_FRESH)
        self._searches = 0
        self._known = -1  # beams when leftovers were last searched
        self._trial: RadiusTrial | None = None
        self._closely = False
        self._fates = Fates(keep=config.outputs.candidates)
        self._aside: list[Beam] = []
        shapes = config.structure.shapes
        self._catalogue = (
            load_catalogue(Path(shapes.catalogue) if shapes.catalogue else None)
            if shapes.enabled
            else ()
        )

    def __len__(self) -> int:
        return len(self._candidates) if self._beams is None else len(self._beams)

    def update(self, detections: Detections) -> None:
        """Take in the segments of one scan.

        Parameters
        ----------
        detections : Detections
            World frame, on the axes of the beams.
        """
        self._pixels.learn(detections.scan)
        self._stamps_ns.append(detections.scan.stamp_ns)
        for segment in detections.segments:
            self._candidates.add(segment)

    @property
    def pitch_rad(self) -> float | None:
        """Angle between neighbouring pixels, radians; None where clouds are no image."""
        return self._pixels.pitch_rad

    @property
    def wants_leftovers(self) -> bool:
        """Whether the beams explain what they can, so that it is time to search the rest.

        What a search brings may hide what is left, so it is repeated while it pays.
        """
        return (
            self.config.refinement.leftovers
            and not self._waiting
            and self._trial is None
            and self._searches < _MOST_SEARCHES
            and len(self._hypothesis()) > self._known
        )

    def question(self) -> AxisQuestion:
        """Return what all rays of the flight should be asked next about the present beams."""
        trying = self._trial is not None and not self._trial.is_over
        kind = replace(_SETTLING, flanks=False) if trying else self._next_pass()
        return AxisQuestion(
            self._trial.beams if self._trial and trying else self._hypothesis(),
            self._camera,
            competitors=kind.competitors,
            tukey=kind.tukey,
            flanks=kind.flanks,
            stride=self._stride,
        )

    @property
    def _stride(self) -> int:
        """Every so manieth row and column is asked."""
        return 1 if self._closely else self._camera.stride

    def renew(self, sums: Sums) -> bool:
        """Renew the beams by what all rays answered to the last `question`.

        Parameters
        ----------
        sums : Sums

        Returns
        -------
        bool
            Whether another pass would change anything.
        """
        kind = self._next_pass()
        self._fates.begin_pass(competing=kind.competitors != "none")
        if self._trial and not self._trial.is_over:
            if self._trial.take(sums):
                self._beams = self._trial.winners()
            return True
        beams = self._hypothesis()
        if self._beams is None:
            beams = self._fates.numbered(beams, "scans")
        self._waiting = self._waiting[1:]
        radii = self._radii
        self._beams = refined(
            beams, sums, self._camera.sigma, kind.rules, radii, self._scans_alike(), self._fates,
            asked=1.0 / self._stride**2,
        )  # fmt: skip
        self._put_aside(beams, self._beams)
        along = _MEASURED_ALONG_M if self.config.refinement.ends else _SETTLED_ALONG_M
        if self._waiting or self.wants_leftovers or _have_moved(beams, self._beams, along):
            return True
        if not self._closely and self._camera.stride > 1:
            # What is there is known from some of the pixels; where exactly, all of them tell.
            self._closely = True
            return True
        wanted = self.config.refinement.radii and len(radii) > 1
        if wanted and self._trial is None and self._beams:
            self._trial = RadiusTrial(self._beams, self._radii, self._scans_alike())
            return True
        return self._have_new_classes()

    def _have_new_classes(self) -> bool:
        """Take the radii that the beams measure in place of those before; whether they differ."""
        if not self._measurements or self._beams is None:
            return False
        radii = radius_classes(self._beams, rough=self._measurements > _FINE_MEASUREMENTS)
        self._measurements -= 1
        if not radii or _same(radii, self._radii):
            return False
        self._radii, self._beams = radii, reclassed(self._beams, radii)
        return True

    @property
    def measured_radii(self) -> tuple[float, ...]:
        """Radii that beams have in common, metres, from the largest on; none where none tells."""
        return radius_classes(self._kept(self._hypothesis()))

    def _scans_alike(self) -> float:
        """Number of successive scans that share about the same error of their poses."""
        steps_ns = np.diff(self._stamps_ns)
        if not len(steps_ns) or not np.median(steps_ns) > 0:
            return 1.0
        return max(self._jitter.memory_s / (float(np.median(steps_ns)) * 1e-9), 1.0)

    def _next_pass(self) -> _Pass:
        kind = self._waiting[0] if self._waiting else _SETTLING
        rules = {
            name: allowed and getattr(self.config.refinement, name, True)
            for name, allowed in vars(kind.rules).items()
        }
        competing = self.config.refinement.competition
        competitors = kind.competitors if competing else "none"
        return replace(kind, competitors=competitors, rules=PassRules(**rules))

    def leftover_question(self) -> LeftoverQuestion:
        """Return which rays of the flight no beam explains."""
        return LeftoverQuestion(self._hypothesis(), self._camera)

    def propose(self, found: Iterable[tuple[Segment, Leftovers]]) -> None:
        """Add beams to the hypothesis; those of one axis become one.

        Parameters
        ----------
        found : iterable of (Segment, Leftovers)
            On the surface, world frame, and what it was found in.
        """
        self._searches += 1
        self._known = len(self._hypothesis())
        candidates = Candidates(self._camera.sigma)
        for segment, left in found:
            away = segment.midpoint - left.seen_from
            away -= (away @ segment.direction) * segment.direction
            away /= max(float(np.linalg.norm(away)), 1e-9)
            anchor = segment.anchor + _BEHIND * segment.radius * away
            stamp = left.stamp_ns
            candidates.add(replace(segment, anchor=anchor, first_seen_ns=stamp, last_seen_ns=stamp))
        if len(candidates):
            fresh = [replace(beam, doubtful=True) for beam in candidates.beams(1)]
            fresh = self._fates.numbered(fresh, "leftovers")
            self._beams = [*self._hypothesis(), *fresh]
            self._waiting = list(_FRESH)

    def end_question(self) -> EndQuestion:
        """Return where all rays of the flight put the ends of the present beams."""
        return EndQuestion(self._hypothesis(), self._camera)

    def set_ends(self, likelihood: FloatArray) -> None:
        """Move the ends to where the rays put them.

        Parameters
        ----------
        likelihood : (G, M, 2, N) float64
            What the rays of each part of the flight answered to `end_question`.
        """
        self._beams = with_measured_ends(self._hypothesis(), likelihood, self._camera.pixel_m)

    @property
    def has_sections(self) -> bool:
        """Whether a beam was found to be other than round, and its section known."""
        return any(beam.cross_section.size is not None for beam in self._hypothesis())

    def section_question(self) -> SectionQuestion:
        """Return which rays pass near the beams, and near those that may be no round ones.

        Once sections are known, it is about the beams that have one.
        """
        standing = self._hypothesis()
        beams = [*standing, *self._still_aside()]
        return SectionQuestion(beams, self._camera, len(standing), again=self.has_sections)

    def section_trial(self) -> SectionTrial:
        """Return what finds the section of one beam."""
        reach = reach_around(self._hypothesis())
        return SectionTrial(reach, self._camera.background, self._catalogue)

    def section_refit(self) -> SectionRefit:
        """Return what measures axis and ends of a beam whose section is known."""
        reach = reach_around(self._hypothesis())
        return SectionRefit(reach, self._camera.background, self._camera.pixel_m)

    def beams_with(self, near: NearRays) -> Iterator[tuple[Beam, FloatArray]]:
        """Beams that `section_question` asked about, each with the rays near it."""
        asked = enumerate([*self._hypothesis(), *self._still_aside()])
        return ((beam, near.of(index)) for index, beam in asked)

    def set_sections(self, beams: Sequence[Beam]) -> None:
        """Take in what `section_trial` or `section_refit` found, in the order of `beams_with`."""
        standing = len(self._hypothesis())
        found = [beam for beam in beams[standing:] if beam.cross_section.size is not None]
        found = [*beams[:standing], *self._fates.numbered(found, "refused")]
        whole = without_parts(found)
        left = [beam for beam in whole if beam.cross_section.shape != "unknown" or is_apart(beam)]
        for beam in found:
            part = all(beam.number != other.number for other in whole)
            self._fates.note(beam, Refusal("section_part") if part else Refusal("shapeless"))
        self._beams = self._fates.settled(found, left, side_by_side)

    def _put_aside(self, before: Sequence[Beam], after: Sequence[Beam]) -> None:
        """Keep those of the beams that are gone for which much speaks, if not as round ones.

        Among all leftovers are the edges of whatever is large, and two of these make a section.
        """
        if self.config.structure.shapes.enabled:
            least = max(self.config.structure.min_length, _LEAST_ASIDE_M)
            left = Neighbours(after)
            self._aside += [
                beam
                for beam in before
                if not beam.doubtful
                and beam.score > _LEAST_ASIDE
                and beam.length > least
                and not any(side_by_side(beam, left.beams[k]) for k in left.near(beam))
            ]

    def _still_aside(self) -> list[Beam]:
        """Those of them where no beam was found since, the likeliest of each place."""
        known = Neighbours(self._hypothesis())
        standing = len(known.beams)
        for beam in sorted(self._aside, key=lambda one: -one.score):
            if len(known.beams) == standing + _MOST_ASIDE:
                break
            if not any(side_by_side(beam, known.beams[k]) for k in known.near(beam)):
                known.append(beam)
        return known.beams[standing:]

    def _hypothesis(self) -> list[Beam]:
        if self._beams is None:
            return self._candidates.beams(self._fewest)
        return self._beams

    def _kept(self, beams: Iterable[Beam]) -> list[Beam]:
        """Beams seen often and long enough, in order of first detection."""
        kept = [beam for beam in beams if self._refusal(beam) is None]
        return sorted(kept, key=lambda beam: (beam.first_seen_ns, *beam.anchor))

    def segments(self) -> tuple[Segment, ...]:
        """Segments seen often and long enough, in order of first detection."""
        return tuple(map(_segment, self._kept(self._hypothesis())))

    def intersections(self) -> tuple[Intersection, ...]:
        """Intersections of those segments (algorithm 2 of the report)."""
        return intersections_of(self.segments(), self.config.structure.intersections)

    def rejections(self) -> Counter[str]:
        """Candidates that are no beam of the result, by reason."""
        late = (refusal for beam in self._hypothesis() if (refusal := self._refusal(beam)))
        refusals = [refusal for *_, refusal in self._seldom_seen()] + list(late)
        return self._fates.counts + Counter(refusal.reason for refusal in refusals)

    def candidates(self) -> tuple[Candidate, ...]:
        """All candidates and what became of them; those of passes only if they are kept."""
        beams = self._hypothesis()
        if self._beams is None:
            beams = self._fates.numbered(beams, "scans")
        numbers = {beam.number: index for index, beam in enumerate(self._kept(beams))}
        last = [(beam, numbers.get(beam.number), self._refusal(beam)) for beam in beams]
        return self._fates.candidates(last, self._seldom_seen())

    def _seldom_seen(self) -> list[tuple[Beam, int, Refusal]]:
        """Candidates found in too few scans to be asked about, with how often and why."""
        return [
            (beam, sightings, Refusal("too_few_sightings", sightings, self._fewest))
            for beam, sightings in self._candidates.all()
            if sightings < self._fewest
        ]

    def _refusal(self, beam: Beam) -> Refusal | None:
        """Why a beam is left out of the result, or None."""
        structure = self.config.structure
        if self._beams is not None and beam.scans < structure.min_scans:
            return Refusal("too_few_scans", beam.scans, structure.min_scans)
        if beam.length < structure.min_length:
            return Refusal("too_short", beam.length, structure.min_length)
        return None


def _same(radii: Sequence[float], others: Sequence[float]) -> bool:
    return len(radii) == len(others) and bool(np.allclose(radii, others, rtol=0.0, atol=_EXACT_M))


def _have_moved(before: Sequence[Beam], after: Sequence[Beam], most_along: float) -> bool:
    """Whether beams came, went, or moved: by their ends and the middle of their axis."""
    if len(before) != len(after):
        return True
    places = np.array([_places(beam) for beam in before])
    return any(_furthest(places, beam, most_along).min() > 1.0 for beam in after)


def _places(beam: Beam) -> FloatArray:
    """(3, 3) float64, metres: both ends of a beam, and the middle of its axis."""
    first, last = beam.ends
    return np.array([first, last, 0.5 * (first + last) + beam.bow])


def _furthest(places: FloatArray, beam: Beam, most_along: float) -> FloatArray:
    """How far a beam is from each of some others, in what counts as settled.

    Parameters
    ----------
    places : (M, 3, 3) float64, metres
        Of beams whose order may be another: the least counts.
    beam : Beam
    most_along : float, metres
        What counts as settled along the axis.

    Returns
    -------
    (M,) float64
    """
    shifts = _places(beam) - places
    along = shifts @ beam.direction
    across = np.linalg.norm(shifts - along[..., None] * beam.direction, axis=2)
    moved: FloatArray = np.maximum(np.abs(along) / most_along, across / _SETTLED_ACROSS_M)
    return np.asarray(moved.max(axis=1))


def _segment(beam: Beam) -> Segment:
    """Give the beam as the report models it; the spread of its rays takes the points' place."""
    spread = beam.length**2 / 12.0
    across = 0.5 * beam.radius**2
    return Segment(
        anchor=beam.anchor,
        direction=beam.direction,
        t_min=beam.first,
        t_max=beam.last,
        radius=beam.radius,
        n_points=int(beam.hits),
        pca_coeff=spread / (spread + 2.0 * across),
        pca_eig=np.array([spread, across, across]),
        n_scans=beam.scans,
        first_seen_ns=beam.first_seen_ns,
        last_seen_ns=beam.last_seen_ns,
        covariance=beam.covariance,
        measured_radius=beam.free_radius,
        sigma_radius=beam.sigma_radius,
        sigma_ends=beam.sigma_ends,
        ends_seen=beam.ends_seen,
        bow_vector=beam.measured_bow,
        sigma_bow=beam.sigma_bow,
        cross_section=beam.cross_section,
    )
