"""Ends of beams, by how well each place for them explains the rays nearby."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from beamseg_batch.geometry import FloatArray
from beamseg_batch.structure.hypothesis import Beam
from beamseg_batch.structure.questions import END_PLACES

__all__ = ["with_measured_ends"]

_LEAST_SIGMA_M = 0.0005
_MIXING = 0.5 / np.sqrt(12.0)
"""Deviation in pixels: a mixed pixel shortens a beam by anything up to half of its width."""
_BEYOND_M = 0.25
_DENIED = -12.0  # log-likelihood of three rays that saw through


def with_measured_ends(
    beams: Sequence[Beam], likelihood: FloatArray, pixel_m: float = 0.0
) -> list[Beam]:
    """Move each end that is free to where the rays put it, and say how sure that is.

    Parameters
    ----------
    beams : sequence of Beam
    likelihood : (G, M, 2, N) float64
        Log-likelihood ratio of each beam with its first or last end moved to each of
        `END_PLACES`, by parts of the flight.
    pixel_m : float, metres
        Width of a pixel on a beam, where pixels at an edge mix what is on both sides.

    Returns
    -------
    list of Beam
        In the same order. An end that was drawn to another axis stays, and so does one
        beyond which no ray tells anything: how far off that is, nobody knows.
    """
    parts = np.moveaxis(likelihood, 0, 2)
    mixing = _MIXING * pixel_m
    return [_measured(beam, each, mixing) for beam, each in zip(beams, parts, strict=True)]


def _measured(beam: Beam, likelihood: FloatArray, mixing: float) -> Beam:
    moves, sigmas = np.zeros(2), beam.sigma_ends.copy()
    for which, outermost in enumerate((0, -1)):
        whole = likelihood[which].sum(axis=0)
        if not beam.snapped[which] and whole[outermost] < whole.max() + _DENIED:
            moves[which], sigma = _expected(whole)
            sigmas[which] = np.hypot(max(sigma, _disagreement(likelihood[which])), mixing)
    sigmas = np.hypot(sigmas, _LEAST_SIGMA_M)
    seen = (_is_denied(beam, -1), _is_denied(beam, 1))
    beam = replace(beam, sigma_ends=sigmas, ends_seen=seen)
    return beam.between(beam.first + moves[0], beam.last + moves[1])


def _expected(likelihood: FloatArray) -> tuple[float, float]:
    """Mean place and deviation, all places being as likely as the rays say."""
    share = np.exp(likelihood - likelihood.max())
    share /= share.sum()
    mean = float(share @ END_PLACES)
    variance = float(share @ (END_PLACES - mean) ** 2)
    return mean, float(np.sqrt(variance))


def _disagreement(parts: FloatArray) -> float:
    """Deviation of the place that all parts of a flight give, by how much it hangs on each.

    Rays are not independent: those of a scan share an error of its pose, and what a pixel at
    an edge measures is not quite what a point would.

    Notes
    -----
    The jackknife (Quenouille 1956, Tukey 1958), over the parts that tell anything.
    """
    telling = parts[np.ptp(parts, axis=1) > 0.0]
    count = len(telling)
    if count < 2:
        return 0.0
    without = [_expected(telling.sum(axis=0) - part)[0] for part in telling]
    return float(np.sqrt((count - 1) * np.var(without)))


def _is_denied(beam: Beam, way: int) -> bool:
    """Whether rays saw through where the beam would go on."""
    end = beam.last if way > 0 else beam.first
    beyond = end + way * _BEYOND_M
    return beam.evidence_between(min(end, beyond), max(end, beyond)) < _DENIED
