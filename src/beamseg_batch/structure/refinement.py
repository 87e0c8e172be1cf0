"""From evidence to a better hypothesis: refit, cut, split, merge and drop beams."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.cylinder.evidence_kernels import COARSE, FINE
from beamseg_batch.cylinder.ray_kernels import solve_4
from beamseg_batch.geometry import FloatArray, parabola
from beamseg_batch.structure.arcs import (
    Piece,
    along_chord,
    arc_gain,
    arc_matrix,
    is_clear,
    is_worth_a_trial,
    with_arcs,
)
from beamseg_batch.structure.bend_kernels import best_bend
from beamseg_batch.structure.fates import Fates, Refusal, flank_shares
from beamseg_batch.structure.hypothesis import Beam, Sums
from beamseg_batch.structure.interval_kernels import best_intervals, densest_part
from beamseg_batch.structure.neighbours import Neighbours
from beamseg_batch.structure.snapping import snapped

__all__ = ["PassRules", "refined", "side_by_side"]

INTERVAL_COST = 50.0
LEAST_SCORE = 300.0
LEAST_SHARE = 0.15  # of the score that all hits would give
CLEAR_SHARE = 0.7  # for what is doubtful
BEST_A_HIT = 4.3
LEAST_LENGTH = 0.18
TRIM_A_HIT = 0.1
SEEN_GAP = 0.005  # metres of a beam with as much evidence as a gap in it needs against it
MOST_ATTACHED = (0.45, 0.45, 0.3)  # left, right, and by scan on either side
THICKER = 1.15  # radii
MOST_BESIDE = 0.25  # of what must stand apart
_STRETCH_BINS, _FEWEST_A_STRETCH = 5, 8  # rays beside 10 cm of a beam, on a side
MOST_OFFSET = 0.012  # of two beams that are the same
MOST_OFFSET_BEYOND = 0.006  # of one that goes on where another ends
_CLASS_SIGMAS = 2.0
_LEAST_KINK = 20.0  # by which squared residuals must fall, for two axes instead of a bent one
_OWN_SCANS = 5  # scans' worth of trust in rays that are independent
# Of Tukey's weight w at 4 sigmas, for normal residuals e: mean of d(w e)/de and of (w e)**2,
# both over the mean of w, which the normal equations hold. So a step of these goes only the
# first share of the way: an axis gets there pass by pass; what is measured off it, at once.
_SLOPE, _SQUARE = 0.771, 0.579
_STRAIGHT, _BENT = [0, 1, 2, 3], [0, 1, 2, 3, 5, 6]  # of the normal equations of an arc


@dataclass(frozen=True)
class PassRules:
    """What a pass may do.

    Attributes
    ----------
    split, drop, merge, cut, snap : bool
        Whether beams are split at bends, dropped when the evidence is weak, merged when two
        are the same, cut into several where the evidence is interrupted, and drawn to the
        axes that they meet.
    bow : bool
        Whether straight beams may become bent ones, where the rays show it clearly.
    trimmed : bool
        Whether all beams competed, so that none reaches far into its neighbour.
    """

    split: bool = True
    drop: bool = True
    merge: bool = True
    cut: bool = False
    snap: bool = False
    bow: bool = False
    trimmed: bool = False


def refined(
    beams: Sequence[Beam],
    sums: Sums,
    noise: float,
    rules: PassRules,
    radii: Sequence[float] = (),
    scans_alike: float = 1.0,
    fates: Fates | None = None,
    asked: float = 1.0,
) -> list[Beam]:
    """Make the next hypothesis of the evidence about the present one.

    A beam takes the one of `radii` that its rays show, where they show it clearly. So many
    successive scans as `scans_alike` share an error of their poses. What becomes of the beams
    that are left out is told to `fates`. Where only a share of the rays was `asked`, that
    share of the evidence is enough.
    """
    fates = fates or Fates()
    pieces: list[Piece] = []
    refused: list[Beam] = []
    for index, beam in enumerate(beams):
        parts = [
            Piece(
                refit(part, index, low, high, sums, radii, scans_alike, bow=bow), index, low, high
            )
            for part, low, high, bow in _renewed(beam, index, sums, noise, rules, asked)
        ]
        refusals = [refusal_of(part.beam, asked) if rules.drop else None for part in parts]
        likely = [part for part, no in zip(parts, refusals, strict=True) if no is None]
        pieces += likely
        refused += [] if likely else [beam]
        for part, refusal in zip(parts, refusals, strict=True):
            if refusal is not None:
                fates.note(part.beam, refusal)
        if not parts:
            fates.note(*_denied(beam, index, sums, asked))
    found = [piece.beam for piece in pieces]
    if rules.bow and rules.merge:
        found = with_arcs(pieces, beams, sums, noise, fates)
    found += _outdone(refused, asked) if rules.drop else []
    found = without_duplicates(found, fates) if rules.merge else found
    found = without_collisions(found, fates) if rules.drop and rules.trimmed else found
    found = fates.settled(beams, found, side_by_side)
    return snapped(found) if rules.snap else found


def _outdone(refused: Sequence[Beam], asked: float) -> list[Beam]:
    """Those that wait a pass, since weaker beams that go now explained the same rays.

    Two beams for one, side by side, leave one another no evidence.
    """
    waiting: list[Beam] = []
    ordered = Neighbours(sorted(refused, key=lambda beam: -beam.score))
    for rank, beam in enumerate(ordered.beams):
        weaker = (ordered.beams[k] for k in ordered.near(beam) if k > rank)
        outdone = any(side_by_side(beam, one) for one in weaker)
        likely = outdone and is_likely(beam, asked)
        if likely and not any(side_by_side(beam, one) for one in waiting):
            waiting.append(beam)
    return waiting


def side_by_side(one: Beam, other: Beam) -> bool:
    """Whether two beams lie so near one another that their rays are the same."""
    offset, overlap = _apart(one, other)[:2]
    return offset < one.radius + other.radius and overlap > 0.0


def is_likely(beam: Beam, asked: float = 1.0) -> bool:
    """Whether the evidence of a share of all rays is enough to keep a beam."""
    return refusal_of(beam, asked) is None


def refusal_of(beam: Beam, asked: float = 1.0) -> Refusal | None:
    """Why the evidence of a share of all rays is not enough to keep a beam; None if it is."""
    best, least = BEST_A_HIT * beam.hits, LEAST_SCORE * asked
    if beam.score < least:
        return Refusal("low_score", beam.score, least)
    share = CLEAR_SHARE if beam.doubtful else LEAST_SHARE
    if beam.score < share * best:
        return Refusal("low_share", beam.score / best, share)
    if beam.length < LEAST_LENGTH:
        return Refusal("evidence_too_short", beam.length, LEAST_LENGTH)
    return _attached(beam)


def stands_free(beam: Beam) -> bool:
    """Whether there is mostly nothing beside a beam, on either side."""
    return _attached(beam) is None


def _attached(beam: Beam) -> Refusal | None:
    """Refuse what does not stand free.

    Part of a wall fits a cylinder as well as the noise allows, but goes on beside it. So does
    the edge of a box, though from each place on one side alone, and a beam that is thicker
    than it is taken for. A doubtful one may be joined to something, but stands clearly free
    along half of its length.
    """
    shares = flank_shares(beam.flanks)
    if beam.doubtful:
        if beam.beside > MOST_BESIDE:
            return Refusal("not_free", beam.beside, MOST_BESIDE)
        shares[:2] = np.nan
    if beam.free_radius > THICKER * beam.radius:
        shares[2] = np.nan
    for share, most in zip(shares, MOST_ATTACHED, strict=True):
        if share > most:
            return Refusal("not_free", float(share), most)
    return None


def is_apart(beam: Beam) -> bool:
    """Whether what lies beside a beam would allow for one that has no known shape.

    What fits neither a round beam nor any other section, and goes on beside itself, is a part
    of something larger.
    """
    return not np.any(flank_shares(beam.flanks) > MOST_BESIDE)


def _denied(beam: Beam, index: int, sums: Sums, share: float) -> tuple[Beam, Refusal]:
    """Say of a beam of which no stretch is likely how likely its best one is."""
    likelihood, hits = sums.fine(index)
    first, last = densest_part(likelihood - TRIM_A_HIT * hits)
    score = float(likelihood[first:last].sum())
    asked = replace(
        beam,
        score=score,
        hits=float(hits.sum()),
        scans=int(sums.evidence.scans[index]),
        profile=likelihood,
        profile_start=float(sums.starts[index]),
    )
    return asked, Refusal("no_evidence", score, INTERVAL_COST * share)


def _renewed(
    beam: Beam, index: int, sums: Sums, noise: float, rules: PassRules, asked: float
) -> list[tuple[Beam, float, float, bool | None]]:
    """Beams that become of one, each with the stretch of its axis that it is on.

    And whether it may be bent, as `refit` takes it: what lies on either side of a kink is not.
    """
    evidence = sums.evidence
    likelihood, hits = sums.fine(index)
    cost = INTERVAL_COST * asked
    stretches = without_hidden_gaps(best_intervals(likelihood, cost), likelihood, cost)
    if len(stretches) == 0:
        return []
    if not rules.cut:
        stretches = np.array([[stretches[0, 0], stretches[-1, 1]]])
    beams: list[tuple[Beam, float, float, bool | None]] = []
    for first, last in stretches:
        begin, end = densest_part(likelihood[first:last] - TRIM_A_HIT * hits[first:last])
        if end <= begin:
            continue
        begin, end = first + begin, first + end
        low, high = sums.place(index, begin), sums.place(index, end)
        part = replace(
            beam,
            score=float(likelihood[begin:end].sum()),
            hits=float(hits[begin:end].sum()),
            scans=int(evidence.scans[index]),
            **_flanks(index, sums, low, high),
            snapped=(False, False),
            sigma_ends=np.full(2, np.nan),
            profile=likelihood,
            profile_start=float(sums.starts[index]),
        )
        rows = along_chord(sums.coarse(index), sums.middles(index), beam)
        place = bend(rows, sums, index, low, high, noise, bow=rules.bow) if rules.split else None
        if place is None:
            beams.append((part, low, high, rules.bow or None))
        else:
            beams.append((part, low, min(high, place + 0.05), False))
            beams.append((part, max(low, place - 0.05), high, False))
    return beams


def _flanks(index: int, sums: Sums, first: float, last: float) -> dict[str, Any]:
    """What the rays beside a stretch of an axis found, where they were asked."""
    if not len(sums.evidence.flanks):
        return {}
    rows = sums.beside(index)[sums.coarse_bins(index, first, last)]
    return {"flanks": sums.evidence.flanks[index], "beside": share_beside(rows)}


def share_beside(rows: FloatArray) -> float:
    """Share of the rays beside a beam that found something at its depth, along most of it.

    Parameters
    ----------
    rows : (N, 2, 2) float64
        By coarse bin: rays on the left and right that found something, or nothing.

    Returns
    -------
    float
        The median over stretches of 10 cm, each on its worse side; NaN where too few passed.
    """
    stretches = np.add.reduceat(rows, np.arange(0, len(rows), _STRETCH_BINS)) if len(rows) else rows
    passed = stretches.sum(axis=2)
    known = passed >= _FEWEST_A_STRETCH
    worst = np.where(known, stretches[..., 0] / np.maximum(passed, 1.0), 0.0).max(axis=1)
    worst = worst[known.any(axis=1)]
    return float(np.median(worst)) if len(worst) else float("nan")


def without_hidden_gaps(
    stretches: NDArray[np.int64], likelihood: FloatArray, cost: float
) -> NDArray[np.int64]:
    """Join stretches of one axis between which a gap is hidden rather than seen.

    Behind another beam a few rays still seem to see through: pixels on its outline that mix
    depths or return nothing. Through a gap that can be seen go as many as return beside it.

    Parameters
    ----------
    stretches : (K, 2) int64
        First bin of each, and the bin after its last, in order.
    likelihood : (N,) float64
        Log-likelihood ratio of each bin: beam against no beam.
    cost : float
        Of a stretch.

    Returns
    -------
    (L, 2) int64
    """
    joined: list[tuple[int, int]] = []
    for first, last in stretches:
        begin = first
        if joined:
            before, end = joined[-1]
            a_bin = min(likelihood[before:end].mean(), likelihood[first:last].mean())
            if -likelihood[end:first].sum() < cost + SEEN_GAP / FINE * a_bin:
                begin = joined.pop()[0]
        joined.append((begin, last))
    return np.array(joined, np.int64).reshape(-1, 2)


def refit(
    beam: Beam,
    index: int,
    first: float,
    last: float,
    sums: Sums,
    radii: Sequence[float] = (),
    scans_alike: float = 1.0,
    *,
    bow: bool | None = None,
) -> Beam:
    """Move an axis to where the rays of a stretch put it, and take the radius that they show.

    With `bow`, they may also show that it is bent; with None, only if it is already.
    """
    span = sums.coarse_bins(index, first, last)
    middles = sums.middles(index)[span]
    rows = along_chord(sums.coarse(index)[span], middles, beam)
    if rows[:, 14].sum() < 8:
        return beam.between(first, last)
    matrix, right = arc_matrix(rows, middles, first, last)
    step, regular = solve_4(matrix[:4, :4], right[:4])
    if not regular:
        return beam.between(first, last)
    scatter = _disagreement(beam, matrix, sums.evidence.scatter[index], first, last)
    free, spread = _solved(matrix, right, scatter, _BENT, scans_alike)
    held = beam.is_bent if bow is None else bow
    may_bend = held and is_clear(free[4:], spread[4:, 4:], last - first)
    stiff = beam.stiff or (bow is True and beam.is_bent and not may_bend)
    if bow and not (may_bend or stiff):
        may_bend = is_worth_a_trial(free[4:], matrix, right, last - first)
    axis, step = (_BENT, free) if may_bend else (_STRAIGHT, step)
    chi2 = (rows[:, 13].sum() - right[axis] @ step) / rows[:, 15].sum()
    growth, _ = solve_4(matrix[:4, :4], -matrix[:4, 4])
    known = _uncertainty(beam, matrix, right, scatter, axis, scans_alike)
    radius = _class_of(beam.radius, known, radii)
    step = np.clip(step[:4] + (radius - beam.radius) * growth, -0.05, 0.05)
    u, v = beam.normals
    direction = beam.direction + step[2] * u + step[3] * v
    direction /= np.linalg.norm(direction)
    moved = replace(
        beam,
        anchor=beam.anchor + step[0] * u + step[1] * v,
        direction=direction,
        radius=radius,
        bow=np.zeros(3),
        stiff=stiff,
        growth=growth,
        reduced_chi2=float(chi2),
        **known,
    ).between(first, last)
    bent = free[4] * u + free[5] * v
    bent -= (bent @ direction) * direction
    return replace(
        moved,
        bow=bent if may_bend else moved.bow,
        measured_bow=bent if may_bend or beam.is_bent else bent / _SLOPE,
        sigma_bow=_deviation(free[4:], spread[4:, 4:], known=may_bend),
    )


def _deviation(bow: FloatArray, covariance: FloatArray, *, known: bool) -> float:
    """Deviation of a bow: along it, where it is known which way it is, else in both."""
    along = bow @ covariance @ bow / (bow @ bow) if known else np.trace(covariance)
    return float(np.sqrt(along)) if along > 0.0 else float("nan")


def _class_of(radius: float, known: Mapping[str, Any], radii: Sequence[float]) -> float:
    """Radius out of those that there are which is nearest to the measured one, if that is sure."""
    if len(radii) < 2 or "free_radius" not in known:
        return radius
    apart = np.abs(np.asarray(radii) - known["free_radius"])
    nearest = float(radii[int(np.argmin(apart))])
    sure = 0.5 * abs(nearest - radius) > _CLASS_SIGMAS * known["sigma_radius"]
    return nearest if sure else radius


def _disagreement(
    beam: Beam, matrix: FloatArray, scatter: FloatArray, first: float, last: float
) -> FloatArray:
    """(7, 7) float64: scatter of the right-hand side of `arc_matrix`, as far as scans are known.

    The normal equations are those of independent rays; what rays of one scan have in common,
    as an error of its pose, shows in how far scans disagree; that counts as often as there
    are scans that share it.
    """
    off, slope, share = *parabola(0.0, first, last), -4.0 / (last - first) ** 2
    basis = np.eye(7)
    for k in (0, 1):  # 1, s and s squared make a bow
        basis[5 + k, [k, 2 + k, 5 + k]] = off, slope, share
    scatter = basis @ scatter @ basis.T
    whole: FloatArray = beam.scans * scatter + _OWN_SCANS * _SQUARE * matrix
    return whole / (beam.scans + _OWN_SCANS)


def _solved(
    matrix: FloatArray,
    right: FloatArray,
    scatter: FloatArray,
    which: list[int],
    scans_alike: float,
) -> tuple[FloatArray, FloatArray]:
    """Solution of some of the normal equations, and its covariance; NaN where there is none."""
    chosen = np.ix_(which, which)
    try:
        solution = np.linalg.solve(matrix[chosen], right[which])
    except np.linalg.LinAlgError:
        return np.full(len(which), np.nan), np.full((len(which), len(which)), np.nan)
    covariance = _sandwich(matrix[chosen], scatter[chosen], scans_alike)
    return np.asarray(solution, np.float64), covariance


def _uncertainty(
    beam: Beam,
    matrix: FloatArray,
    right: FloatArray,
    scatter: FloatArray,
    axis: list[int],
    scans_alike: float,
) -> dict[str, Any]:
    """Covariance of the axis, and the radius that fits best, with its deviation."""
    u, v = beam.normals
    frame = np.zeros((6, 4))
    frame[:3, 0], frame[:3, 1], frame[3:, 2], frame[3:, 3] = u, v, u, v
    _, spread = _solved(matrix, right, scatter, axis, scans_alike)
    found: dict[str, Any] = {"covariance": frame @ spread[:4, :4] @ frame.T}
    whole, spread = _solved(matrix, right, scatter, [*axis, 4], scans_alike)
    if np.isfinite(spread).all():
        found["free_radius"] = float(beam.radius + whole[-1] / _SLOPE)
        found["sigma_radius"] = float(np.sqrt(spread[-1, -1]))
    return found


def _beyond(scatter: FloatArray, own: FloatArray) -> FloatArray:
    """Part of a scatter that is more than that of independent rays, nowhere negative."""
    root = np.linalg.cholesky(own)
    whitened = np.linalg.solve(root, np.linalg.solve(root, scatter).T)
    values, vectors = np.linalg.eigh(whitened)
    turned = root @ vectors
    more: FloatArray = (turned * np.maximum(values - 1.0, 0.0)) @ turned.T
    return more


def _sandwich(matrix: FloatArray, scatter: FloatArray, scans_alike: float) -> FloatArray:
    """Covariance of a solution of normal equations, NaN where there is none."""
    try:
        inverse = np.linalg.inv(_SLOPE * matrix)
        if scans_alike > 1.0:
            scatter = scatter + (scans_alike - 1.0) * _beyond(scatter, _SQUARE * matrix)
    except np.linalg.LinAlgError:
        return np.full_like(matrix, np.nan)
    covariance: FloatArray = inverse @ scatter @ inverse
    return covariance


def bend(
    rows: FloatArray,
    sums: Sums,
    index: int,
    first: float,
    last: float,
    noise: float,
    *,
    bow: bool = False,
) -> float | None:
    """Where two axes explain a stretch much better than one, metres along it.

    And better than one that is bent, where there may be such.
    """
    span = sums.coarse_bins(index, first, last)
    rows = rows[span]
    least = round(0.25 / COARSE)
    if len(rows) < 2 * least:
        return None
    place, gain = best_bend(rows, least, np.radians(1.5))
    if place < 0 or gain < 200.0 or gain / rows[:, 14].sum() < (0.0025 / noise) ** 2:
        return None
    if bow and gain < _LEAST_KINK + arc_gain(rows, sums.middles(index)[span], first, last):
        return None
    return float(sums.starts[index] + (span.start + place) * COARSE)


def without_duplicates(beams: Sequence[Beam], fates: Fates | None = None) -> list[Beam]:
    """Drop beams that are the same as a likelier one, which takes in their length."""
    fates = fates or Fates()
    kept = Neighbours()
    for beam in sorted(beams, key=lambda one: -one.score):
        for index in kept.near(beam):
            other = kept.beams[index]
            union = _union(other, beam)
            if union is not None:
                fates.note(beam, _merging(beam, other))
                kept.replace(index, union)
                break
        else:
            kept.append(beam)
    return kept.beams


def without_collisions(beams: Sequence[Beam], fates: Fates | None = None) -> list[Beam]:
    """Drop beams that run inside a likelier one: two solids cannot share their place.

    Several beams side by side may each explain a part of a plate, and one another's
    surroundings, so that each seems to stand free.
    """
    fates = fates or Fates()
    kept = Neighbours()
    for beam in sorted(beams, key=lambda one: -one.score):
        hits = (_collision(beam, kept.beams[index]) for index in kept.near(beam))
        refusal = next((hit for hit in hits if hit is not None), None)
        if refusal is None:
            kept.append(beam)
        else:
            fates.note(beam, refusal)
    return kept.beams


def _collision(beam: Beam, other: Beam) -> Refusal | None:
    """How a beam runs inside another one; None if it does not."""
    if abs(float(beam.direction @ other.direction)) < np.cos(np.radians(20.0)):
        return None
    shorter, longer = sorted((beam, other), key=lambda one: one.length)
    _, overlap, low, high = _apart(longer, shorter)
    middle = 0.5 * (max(low, longer.first) + min(high, longer.last))
    point = longer.at(middle)
    offset = point - shorter.anchor
    offset -= (offset @ shorter.direction) * shorter.direction
    apart, together = float(np.linalg.norm(offset)), beam.radius + other.radius
    if overlap > 0.5 * shorter.length and apart < together:
        return Refusal("collision", apart, together, other.number)
    return None


def _union(one: Beam, other: Beam) -> Beam | None:
    if abs(float(one.direction @ other.direction)) < np.cos(np.radians(1.5)):
        return None
    offset, overlap, low, high = _apart(one, other)
    same = offset < MOST_OFFSET and overlap > 0.5 * min(other.length, one.length)
    touching = offset < MOST_OFFSET_BEYOND and overlap > -0.05
    if not (same or touching):
        return None
    return one.between(min(low, one.first), max(high, one.last))


def _merging(beam: Beam, into: Beam) -> Refusal:
    """Whether a beam is the same as another one, or goes on where that ends."""
    offset, overlap = _apart(into, beam)[:2]
    if overlap > 0.5 * min(into.length, beam.length):
        return Refusal("duplicate", offset, MOST_OFFSET, into.number)
    return Refusal("merged", offset, MOST_OFFSET_BEYOND, into.number)


def _apart(one: Beam, other: Beam) -> tuple[float, float, float, float]:
    """Distance of the other's ends from an axis, overlap, and where the other lies along it."""
    along = [float((end - one.anchor) @ one.direction) for end in other.ends]
    offset = max(
        float(np.linalg.norm(end - one.at(s))) for end, s in zip(other.ends, along, strict=True)
    )
    low, high = min(along), max(along)
    return offset, min(high, one.last) - max(low, one.first), low, high
