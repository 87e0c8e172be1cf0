"""Ends drawn to the axes that they meet: what lies inside another beam cannot be seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from beamseg_batch.structure.hypothesis import Beam
from beamseg_batch.structure.neighbours import Neighbours

__all__ = ["snapped"]

_MOST_APART_M = 0.025
_MOST_MOVE_M = 0.35
_FREE_LOSS = 20.0  # of log-likelihood
_LOSS_LENGTH_M = 0.005  # and what so much of a beam is worth
_TANGENTS = 3  # along which a crossing with a bent axis is sought


def snapped(beams: Sequence[Beam]) -> list[Beam]:
    """Move each end to the crossing with an axis that passes by, unless the evidence denies it.

    Parameters
    ----------
    beams : sequence of Beam

    Returns
    -------
    list of Beam
        In the same order.

    Notes
    -----
    Rays that meet the end of a beam inside another one are hidden or explained by either,
    so the evidence leaves the end open there; that axes meet is likelier than that they
    almost do. The evidence only vetoes.
    """
    if len(beams) < 2:
        return list(beams)
    per_metre = float(np.median([beam.score / beam.length for beam in beams]))
    most_loss = _FREE_LOSS + _LOSS_LENGTH_M * max(per_metre, 0.0)
    neighbours = Neighbours(beams, reach=2.0 * _MOST_MOVE_M)
    return [_snapped(index, neighbours, most_loss) for index in range(len(beams))]


@dataclass(frozen=True, eq=False)
class _Crossing:
    """Where another axis passes close by: along the beam, how far an end may be, deviation."""

    place: float
    reach: float
    sigma: float


def _snapped(index: int, beams: Neighbours, most_loss: float) -> Beam:
    beam = beams.beams[index]
    others = [beams.beams[k] for k in beams.near(beam) if k != index]
    crossings = [found for other in others if (found := _nearby(beam, other)) is not None]
    ends, sigmas = [beam.first, beam.last], np.full(2, np.nan)
    for which, end, far in ((0, beam.first, beam.last), (1, beam.last, beam.first)):
        outwards = np.sign(end - far)
        at_end = [
            crossing
            for crossing in crossings
            if abs(crossing.place - end) < min(abs(crossing.place - far), crossing.reach)
            and _loss(beam, end, crossing.place, outward=(crossing.place - end) * outwards > 0.0)
            < most_loss
        ]
        if at_end:
            nearest = min(at_end, key=lambda crossing: abs(crossing.place - end))
            ends[which], sigmas[which] = nearest.place, nearest.sigma
    if ends[1] <= ends[0]:
        return beam
    snapped = (bool(np.isfinite(sigmas[0])), bool(np.isfinite(sigmas[1])))
    return replace(beam, snapped=snapped, sigma_ends=sigmas).between(*ends)


def _loss(beam: Beam, end: float, place: float, *, outward: bool) -> float:
    """Log-likelihood that moving an end costs."""
    evidence = beam.evidence_between(min(end, place), max(end, place))
    return -evidence if outward else evidence


def _nearby(beam: Beam, other: Beam) -> _Crossing | None:
    """Crossing of the axes where they pass one another, which bent ones do off their chords."""
    if not (beam.is_bent or other.is_bent):
        return _crossing(beam, other)
    there = float((beam.anchor - other.anchor) @ other.direction)
    place = 0.0
    for _ in range(_TANGENTS):
        found = _closest(beam.tangent(place), other.tangent(there))
        if found is None:
            return None
        place = min(max(found[0], beam.first), beam.last)
        there = min(max(found[1], other.first), other.last)
    return _crossing(beam.tangent(place), other.tangent(there))


def _closest(beam: Beam, other: Beam) -> tuple[float, float] | None:
    """Where two straight axes are closest, along each; None if they are about parallel."""
    cosine = float(beam.direction @ other.direction)
    sine = float(np.sqrt(max(1.0 - cosine * cosine, 0.0)))
    if sine < 0.02:
        return None
    apart = other.anchor - beam.anchor
    along, across = float(apart @ beam.direction), float(apart @ other.direction)
    place = (along - cosine * across) / sine**2
    return place, (cosine * along - across) / sine**2


def _crossing(beam: Beam, other: Beam) -> _Crossing | None:
    closest = _closest(beam, other)
    if closest is None:
        return None
    place, there = closest
    cosine = float(beam.direction @ other.direction)
    sine = float(np.sqrt(max(1.0 - cosine * cosine, 0.0)))
    reach = min(0.1 / sine + 0.05, _MOST_MOVE_M)
    if not other.first - reach <= there <= other.last + reach:
        return None
    if float(np.linalg.norm(beam.at(place) - other.at(there))) > _MOST_APART_M:
        return None
    # In the plane of both, across the other axis.
    normal = (beam.direction - cosine * other.direction) / sine
    variance = normal @ (beam.covariance_at(place) + other.covariance_at(there)) @ normal
    sigma = float(np.sqrt(variance)) / sine if np.isfinite(variance) else 0.0
    return _Crossing(place, reach, sigma)
