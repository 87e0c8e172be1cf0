"""What became of everything that might have been a beam, and why.

A candidate has a number from the pass in which it comes to be until the end. What is
refused is noted on the way; a candidate whose number is no longer among the beams after a
pass has met its fate, and that is counted once, whatever happened to its parts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias

import numpy as np

from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import Candidate, RefusedLine, Segment
from beamseg_batch.reasons import LEFTOVER
from beamseg_batch.structure.candidates import Candidates
from beamseg_batch.structure.hypothesis import Beam
from beamseg_batch.structure.neighbours import Neighbours

__all__ = [
    "FEWEST_BESIDE",
    "MOST_LINES",
    "Fates",
    "Refusal",
    "RefusedLines",
    "flank_shares",
    "segments_as_candidates",
]

FEWEST_BESIDE = 20.0
"""Rays that must pass a side of a beam, for their share to mean anything."""

MOST_LINES = 20_000
"""Places at which refused lines are kept: memory stays bounded, however long the flight."""

_MERGED = {"bent", "duplicate", "merged", "section_part"}
_OF_EVIDENCE = {"no_evidence", "low_score", "low_share"}
_THROUGH = 4.0  # what a ray that saw through takes from the log-likelihood ratio

_Beside: TypeAlias = Callable[[Beam, Beam], bool]


class Refusal(NamedTuple):
    """Why a beam is refused.

    Attributes
    ----------
    reason : str
        A name out of `beamseg_batch.reasons.REASONS`.
    value, limit : float
        What was found and what was needed, in the unit of the reason.
    other : int
        Number of the candidate that is in the way; -1 for none.
    """

    reason: str
    value: float = np.nan
    limit: float = np.nan
    other: int = -1


@dataclass(frozen=True)
class _Origin:
    kind: str
    parent: int | None = None


class Fates:
    """Fates of candidates, pass by pass.

    Parameters
    ----------
    keep : bool
        Whether the candidates are kept, or only counted.

    Attributes
    ----------
    counts : Counter of str
        Candidates refused so far, by reason.
    """

    def __init__(self, *, keep: bool = False) -> None:
        self.counts: Counter[str] = Counter()
        self._keep = keep
        self._next = 0
        self._pass = 0
        self._competing = False
        self._noted: dict[int, tuple[Beam, Refusal]] = {}
        self._origins: dict[int, _Origin] = {}
        self._kept: list[Candidate] = []

    def numbered(self, beams: Iterable[Beam], origin: str) -> list[Beam]:
        """Give numbers to new candidates.

        Parameters
        ----------
        beams : iterable of Beam
        origin : str
            ``scans`` or ``leftovers``.

        Returns
        -------
        list of Beam
        """
        return [replace(beam, number=self._new(_Origin(origin))) for beam in beams]

    def begin_pass(self, *, competing: bool) -> None:
        """Hear that a pass is over, and whether beams competed for rays in it."""
        self._pass += 1
        self._competing = competing

    def note(self, beam: Beam, refusal: Refusal) -> None:
        """Hear that a beam, or a part of one, is refused; of its parts the likeliest counts."""
        known = self._noted.get(beam.number)
        if refusal.other != beam.number and (known is None or beam.score > known[0].score):
            self._noted[beam.number] = beam, refusal

    def settled(
        self, before: Sequence[Beam], after: Sequence[Beam], side_by_side: _Beside
    ) -> list[Beam]:
        """Decide the fates of those that a pass left out.

        Parameters
        ----------
        before, after : sequence of Beam
            The hypothesis that was asked about, and what was made of it.
        side_by_side : callable
            Whether two beams run along one another.

        Returns
        -------
        list of Beam
            Those after the pass, in the same order; of the parts of one beam all but the
            first are new candidates.
        """
        alive, left = {beam.number for beam in after}, Neighbours(after)
        for beam in before:
            if beam.number >= 0 and beam.number not in alive:
                self._decide(beam, left, side_by_side)
        self._noted.clear()
        return self._with_own_numbers(after)

    def _decide(self, beam: Beam, left: Neighbours, side_by_side: _Beside) -> None:
        last, refusal = self._noted.get(beam.number, (beam, Refusal("superseded")))
        if self._competing and refusal.reason in _OF_EVIDENCE:
            near = (left.beams[index] for index in left.near(beam))
            rivals = [one for one in near if one.score > last.score and side_by_side(beam, one)]
            rival = max(rivals, key=lambda one: one.score, default=None)
            if rival is not None:
                refusal = Refusal("outdone", last.score, rival.score, rival.number)
        self.counts[refusal.reason] += 1
        if self._keep:
            self._kept.append(self._record(last, "pass", refusal, self._pass))

    def _with_own_numbers(self, beams: Sequence[Beam]) -> list[Beam]:
        taken: set[int] = set()
        own = []
        for beam in beams:
            if beam.number in taken:
                beam = replace(beam, number=self._new(_Origin("split", beam.number)))  # noqa: PLW2901
            elif beam.number >= 0:
                taken.add(beam.number)
            own.append(beam)
        return own

    def _new(self, origin: _Origin) -> int:
        number, self._next = self._next, self._next + 1
        if self._keep:
            self._origins[number] = origin
        return number

    def candidates(
        self,
        last: Iterable[tuple[Beam, int | None, Refusal | None]],
        gathered: Iterable[tuple[Beam, int, Refusal]],
    ) -> tuple[Candidate, ...]:
        """All candidates with their fates, in the order in which these were decided.

        Parameters
        ----------
        last : iterable of (Beam, int or None, Refusal or None)
            The hypothesis in the end: of each beam the segment that it is, or why it is none.
        gathered : iterable of (Beam, int, Refusal)
            Candidates that came before no pass, how many lines were found of them, and why.

        Returns
        -------
        tuple of Candidate
        """
        early = [
            replace(
                self._record(beam, "gathering", refusal, None),
                number=None, n_lines=lines, n_scans=lines,
            )
            for beam, lines, refusal in gathered
        ]  # fmt: skip
        late = [
            replace(self._record(beam, "end", refusal, None), segment=segment)
            for beam, segment, refusal in last
        ]
        return _with_segments([*early, *self._kept, *late])

    def _record(
        self, beam: Beam, stage: str, refusal: Refusal | None, in_pass: int | None
    ) -> Candidate:
        origin = self._origins.get(beam.number, _Origin("scans"))
        asked = beam.scans > 0 or len(beam.profile) > 0
        reason = refusal.reason if refusal else ""
        left, right, _ = flank_shares(beam.flanks)
        return Candidate(
            stage=stage,
            number=beam.number,
            in_pass=in_pass,
            origin=origin.kind,
            parent=origin.parent,
            end_1=beam.ends[0],
            end_2=beam.ends[1],
            radius=beam.radius,
            n_scans=beam.scans,
            n_points=int(beam.hits),
            score=beam.score if asked else np.nan,
            seen_through=_seen_through(beam) if asked else np.nan,
            flanks=(float(left), float(right)),
            reduced_chi2=beam.reduced_chi2 if asked else np.nan,
            first_seen_ns=beam.first_seen_ns,
            last_seen_ns=beam.last_seen_ns,
            fate="kept" if refusal is None else "merged" if reason in _MERGED else "refused",
            reason=reason,
            value=refusal.value if refusal else np.nan,
            limit=refusal.limit if refusal else np.nan,
            into=refusal.other if refusal and refusal.other >= 0 else None,
        )


class RefusedLines:
    """Lines that screening refused, those at one place for one reason together.

    Parameters
    ----------
    sigma : float, metres
        Noise of a depth, which sets what one place is.
    stage : str
        Of the candidates that they become: ``scan`` or ``leftovers``.
    most : int, optional
        Places that are kept.

    Attributes
    ----------
    n_left_out : int
        Lines at further places, which are not kept.
    """

    def __init__(self, sigma: float, stage: str, most: int = MOST_LINES) -> None:
        self.n_left_out = 0
        self._sigma, self._stage, self._most = sigma, stage, most
        self._places: dict[str, Candidates] = {}
        self._found: dict[str, list[_Place]] = {}
        self._count = 0

    def add(self, lines: Iterable[RefusedLine]) -> None:
        """Take in the lines of a scan.

        Parameters
        ----------
        lines : iterable of RefusedLine
            World frame.
        """
        for line in lines:
            places = self._places.setdefault(line.reason, Candidates(self._sigma))
            index = places.nearest(line.segment)
            if index < 0 and self._count >= self._most:
                self.n_left_out += 1
                continue
            found = self._found.setdefault(line.reason, [])
            if index < 0:
                self._count += 1
                found.append(_Place())
            found[places.add(line.segment, index)].add(line)

    def candidates(self) -> list[Candidate]:
        """Give each place as a candidate, in order of its first line."""
        prefix = LEFTOVER if self._stage == "leftovers" else ""
        rows = [
            place.candidate(beam, self._stage, prefix + reason)
            for reason, places in self._places.items()
            for place, (beam, _) in zip(self._found[reason], places.all(), strict=True)
        ]
        return sorted(rows, key=lambda row: row.first_seen_ns)


class _Place:
    """Lines at one place: how many there are, and the one that was refused most narrowly."""

    def __init__(self) -> None:
        self.n_lines = self.n_scans = self.n_points = 0
        self._best: RefusedLine | None = None
        self._last_ns = -1

    def add(self, line: RefusedLine) -> None:
        self.n_lines += 1
        self.n_scans += line.segment.last_seen_ns != self._last_ns
        self._last_ns = line.segment.last_seen_ns
        self.n_points += line.segment.n_points
        if self._best is None or _shortfall(line) < _shortfall(self._best):
            self._best = line

    def candidate(self, beam: Beam, stage: str, reason: str) -> Candidate:
        assert self._best is not None
        return Candidate(
            stage=stage,
            origin="leftovers" if stage == "leftovers" else "scans",
            end_1=beam.ends[0],
            end_2=beam.ends[1],
            radius=beam.radius,
            fate="refused",
            first_seen_ns=beam.first_seen_ns,
            last_seen_ns=beam.last_seen_ns,
            n_lines=self.n_lines,
            n_scans=self.n_scans,
            n_points=self.n_points,
            reason=reason,
            value=self._best.value,
            limit=self._best.limit,
        )


def _shortfall(line: RefusedLine) -> float:
    return abs(line.value - line.limit) / max(abs(line.limit), 1e-9)


def flank_shares(flanks: FloatArray) -> FloatArray:
    """Share of the rays beside a beam that found something at its depth.

    Parameters
    ----------
    flanks : (3, 2) float64
        As of `Beam`.

    Returns
    -------
    (3,) float64
        On its left, on its right, and by scan on the worse side; NaN where too few rays passed.
    """
    passed = flanks.sum(axis=1)
    return np.where(passed >= FEWEST_BESIDE, flanks[:, 0] / np.maximum(passed, 1.0), np.nan)


def _seen_through(beam: Beam) -> float:
    """Rays that saw through: where more did than returned from it, so at least so many."""
    part = beam.profile_between(beam.first, beam.last)
    return float(np.abs(part[part < 0.0]).sum() / _THROUGH)


def _with_segments(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Say of each that gave way which segment took its place in the end."""
    known: dict[int | None, Candidate] = {
        one.number: one for one in candidates if one.number is not None
    }
    return tuple(replace(one, segment=_segment(one, known)) for one in candidates)


def _segment(candidate: Candidate, known: Mapping[int | None, Candidate]) -> int | None:
    for _ in known:  # at most; each gave way to one that met its fate later
        if candidate.into not in known:
            break
        candidate = known[candidate.into]
    return candidate.segment


def segments_as_candidates(
    segments: Sequence[Segment], refusals: Sequence[Refusal | None]
) -> tuple[Candidate, ...]:
    """Segments of a structure that is only fused, as candidates that met their fate at the end.

    Parameters
    ----------
    segments : sequence of Segment
        World frame.
    refusals : sequence of Refusal or None
        Of each why it is left out of the result, or None.

    Returns
    -------
    tuple of Candidate
    """
    kept = 0
    found = []
    for number, (segment, refusal) in enumerate(zip(segments, refusals, strict=True)):
        found.append(
            Candidate(
                stage="end",
                number=number,
                end_1=segment.end_1,
                end_2=segment.end_2,
                radius=segment.radius,
                fate="refused" if refusal else "kept",
                first_seen_ns=segment.first_seen_ns,
                last_seen_ns=segment.last_seen_ns,
                n_scans=segment.n_scans,
                n_points=segment.n_points,
                reason=refusal.reason if refusal else "",
                value=refusal.value if refusal else np.nan,
                limit=refusal.limit if refusal else np.nan,
                segment=None if refusal else kept,
            )
        )
        kept += refusal is None
    return tuple(found)
