"""Ends drawn to the axes that they meet: what lies inside another beam cannot be seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from beamseg_batch.structure.hypothesis import Beam

__all__ = ["snapped"]

_MOST_APART_M = 0.025
_MOST_MOVE_M = 0.35
_FREE_LOSS = 20.0  # of log-likelihood
_LOSS_LENGTH_M = 0.005  # and what so much of a beam is worth


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
    return [_snapped(index, beams, most_loss) for index in range(len(beams))]


def _snapped(index: int, beams: Sequence[Beam], most_loss: float) -> Beam:
    beam = beams[index]
    others = [other for k, other in enumerate(beams) if k != index]
    first, last = beam.first, beam.last
    snapped = [False, False]
    nearest_first = nearest_last = np.inf
    for place, reach in _crossings(beam, others):
        at_first, at_last = abs(place - beam.first), abs(place - beam.last)
        if at_first < min(at_last, nearest_first, reach) and (
            _loss(beam, place, beam.first, outward=place < beam.first) < most_loss
        ):
            first, nearest_first, snapped[0] = place, at_first, True
        elif at_last < min(at_first, nearest_last, reach) and (
            _loss(beam, beam.last, place, outward=place > beam.last) < most_loss
        ):
            last, nearest_last, snapped[1] = place, at_last, True
    if last <= first:
        return beam
    return replace(beam, snapped=(snapped[0], snapped[1])).between(first, last)


def _loss(beam: Beam, one: float, other: float, *, outward: bool) -> float:
    """Log-likelihood that moving an end costs."""
    evidence = beam.evidence_between(min(one, other), max(one, other))
    return -evidence if outward else evidence


def _crossings(beam: Beam, others: Sequence[Beam]) -> list[tuple[float, float]]:
    """Where other axes pass close by along this one, and how far an end may be from there."""
    found = []
    for other in others:
        cosine = float(beam.direction @ other.direction)
        sine = float(np.sqrt(max(1.0 - cosine * cosine, 0.0)))
        if sine < 0.02:
            continue
        apart = other.anchor - beam.anchor
        along, across = float(apart @ beam.direction), float(apart @ other.direction)
        place = (along - cosine * across) / sine**2
        there = (cosine * along - across) / sine**2
        reach = min(0.1 / sine + 0.05, _MOST_MOVE_M)
        if not other.first - reach <= there <= other.last + reach:
            continue
        if float(np.linalg.norm(beam.at(place) - other.at(there))) <= _MOST_APART_M:
            found.append((place, reach))
    return found
