"""Kernel that asks every ray of a scan what it says about each beam of a hypothesis.

A ray that returned from where a beam's surface is *explains* it; one that returned from
behind, or not at all, *saw through* it; one that returned from before it, or whose way is
blocked by another beam, says nothing. Beams compete: a return that another beam explains
as well is no evidence.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.accelerate import kernel
from beamseg_batch.cylinder.meeting_kernels import (
    NEAR_MISS,
    Cylinders,
    Meetings,
    View,
    forget,
    meet,
    rivals,
    sight,
)
from beamseg_batch.geometry import FloatArray

__all__ = ["COARSE", "FINE", "NORMAL_COLUMNS", "Evidence", "gain", "gather"]

FINE = 0.004
"""Length of a bin of the likelihood along an axis, metres."""

COARSE = 0.02
"""Length of a bin of the normal equations along an axis, metres."""

NORMAL_COLUMNS = 22
"""Nine products of the axis' derivatives, four with the residual, its square, rays, weight;
then five products of the radius' derivative with those and itself, and with the residual."""

GATE = 4.0
"""A residual of so many sigmas is still explained."""

_THROUGH = -4.0  # log-likelihood ratio of a ray that saw through
_EDGE = 0.8  # share of the radius beyond which a ray that passes proves nothing
_MIN_INCIDENCE = 0.2
_CONTESTED = 2.0  # sigmas by which a ray must fit one beam better than any other
_LEAST_APART = 4.0  # sigmas from the nearest competitor, for a ray to tell of the axis
_FEWEST_ALONE = 3
_FEWEST_BESIDE = 4.0
_FITTED = 7  # numbers of an axis: offsets, slopes, radius, and the square of the place


class Evidence(NamedTuple):
    """Sums over rays, by beam and along its axis.

    Attributes
    ----------
    fine_at, coarse_at : (M + 1,) int64
        First bin of each beam.
    likelihood, hits : (F,) float64
        By fine bin: log-likelihood ratio, rays explained by the beam alone.
    normal : (C, 22) float64
        By coarse bin: normal equations of the axis and the radius.
    scans : (M,) int64
        Scans with at least three rays that are explained by the beam alone.
    flanks : (M, 3, 2) float64
        Rays that pass a beam closely on its left and right, and found something at its
        depth, or nothing; then both sides' rays, scan by scan, divided as those of the side
        that found more. Not asked for where it is empty.
    beside : (C, 2, 2) float64
        By coarse bin: those rays on the left and right. Empty where `flanks` is.
    scatter : (M, 7, 7) float64
        Sums over scans of the product with itself of a scan's right-hand side of the normal
        equations: how far scans, not rays, disagree. Offsets, slopes, radius, and offsets
        that grow with the square of the place along the axis.
    asked : (M,) int64
        Meetings of rays with the beam: where there is none, nothing was added.
    """

    fine_at: NDArray[np.int64]
    coarse_at: NDArray[np.int64]
    likelihood: FloatArray
    hits: FloatArray
    normal: FloatArray
    scans: NDArray[np.int64]
    flanks: FloatArray
    beside: FloatArray
    scatter: FloatArray
    asked: NDArray[np.int64]


@kernel
def gain(residual: float, hidden: bool, best: float, side: float, background: float) -> float:
    """Log-likelihood ratio of a ray that meets a beam: the beam against none.

    Parameters
    ----------
    residual : float
        Measured depth less the beam's, sigmas.
    hidden : bool
        Whether a competitor stands before it.
    best : float
        Least distance of the measured depth from a competitor, sigmas.
    side : float
        Distance of the ray's line from the axis, as a share of the radius.
    background : float
        Cost of a return that no beam explains, as half a squared residual.

    Returns
    -------
    float
    """
    if hidden or residual < -GATE:
        return 0.0
    if residual > GATE:
        return _THROUGH if side < _EDGE else 0.0
    return min(0.5 * best * best, background) - min(0.5 * residual * residual, background)


@kernel
def _sunk(
    footprint: float, entry: float, wx: float, wy: float, wz: float, b: FloatArray, side: float,
    radius: float,
) -> float:  # fmt: skip
    """How much deeper than its middle a pixel's footprint lies on a cylinder, on average, metres.

    A surface curves away on both sides: half its second derivative across the axis, times the
    variance of the lateral place within the footprint, a square in the image.
    """
    along = wx * b[0] + wy * b[1] + wz * b[2]
    across = 1.0 - along * along
    tilt = wy * b[2] - wz * b[1]  # of the direction of that place against the image, times sines
    width = footprint * entry * wx
    variance = width * width / 12.0 * (1.0 - tilt * tilt / across)
    return float(0.5 * variance / (radius * (1.0 - side * side) ** 1.5 * np.sqrt(across)))


@kernel
def _weigh(
    row: FloatArray, score: FloatArray, weight: float, s: float, u: float, v: float, r: float,
    e: float,
) -> None:  # fmt: skip
    """Add a ray to the normal equations of a bin, and to the right-hand side of its scan."""
    su, sv = s * u, s * v
    row[0] += weight * u * u
    row[1] += weight * u * v
    row[2] += weight * v * v
    row[3] += weight * su * u
    row[4] += weight * su * v
    row[5] += weight * sv * v
    row[6] += weight * su * su
    row[7] += weight * su * sv
    row[8] += weight * sv * sv
    row[9] += weight * u * e
    row[10] += weight * v * e
    row[11] += weight * su * e
    row[12] += weight * sv * e
    row[13] += weight * e * e
    row[14] += 1.0
    row[15] += weight
    row[16] += weight * u * r
    row[17] += weight * v * r
    row[18] += weight * su * r
    row[19] += weight * sv * r
    row[20] += weight * r * r
    row[21] += weight * r * e
    score[0] += weight * u * e
    score[1] += weight * v * e
    score[2] += weight * su * e
    score[3] += weight * sv * e
    score[4] += weight * r * e
    score[5] += weight * s * su * e
    score[6] += weight * s * sv * e


@kernel
def _add_flanks(flanks: FloatArray, beside: FloatArray) -> None:
    """Add what a scan found on both sides of a beam, and forget it."""
    total, worst = 0.0, 0.0
    for side in range(2):
        occupied, free = beside[2 * side], beside[2 * side + 1]
        flanks[side, 0] += occupied
        flanks[side, 1] += free
        if occupied + free >= _FEWEST_BESIDE:
            total += occupied + free
            worst = max(worst, occupied / (occupied + free))
    flanks[2, 0] += worst * total
    flanks[2, 1] += (1.0 - worst) * total
    beside[:] = 0.0


@kernel
def gather(
    view: View,
    beams: Cylinders,
    evidence: Evidence,
    tukey: float,
    background: float,
    meetings: Meetings,
    alone: NDArray[np.int64],
    scores: FloatArray,
) -> None:
    """Add what a scan says about each beam to sums along its axis.

    Parameters
    ----------
    view : View
    beams : Cylinders
        Asked about from the first bin to the last.
    evidence : Evidence
        Added to.
    tukey : float
        Reach of Tukey's weight, in sigmas.
    background : float
        Cost of a return that no beam explains, as half a squared residual.
    meetings : Meetings
        Scratch.
    alone : (M,) int64
    scores : (M, 11) float64
        Scratch, zero before and after.
    """
    flanks = evidence.flanks
    touched = meet(view, beams, meetings, len(flanks) > 0)
    points, rays, ranks, limits = view.points, view.rays, beams.ranks, beams.limits
    head, chain, who, nearest = meetings.head, meetings.chain, meetings.who, meetings.nearest
    sides, entries, excused = meetings.side, meetings.entry, beams.excused
    for number in range(touched):
        k = meetings.pixels[number]
        wx, wy, wz, depth = sight(points, rays, k)
        this = meetings.head[k]
        while this >= 0:
            j, s, e = meetings.who[this], meetings.along[this], meetings.residual[this]
            side, entry, sigma = meetings.side[this], meetings.entry[this], meetings.sigma[this]
            limit = limits[j] if abs(side) <= 1.0 else excused[j]
            before, best, apart = rivals(
                ranks, limit, head[k], this, chain, who, nearest, sides, entries,
                entry, depth, sigma,
            )  # fmt: skip
            this = chain[this]
            if side == NEAR_MISS:
                continue
            evidence.asked[j] += 1
            radius, start = beams.radii[j], beams.starts[j]
            # A place just before the end may round up to it.
            coarse = evidence.coarse_at[j] + int((s - start) / COARSE)
            coarse = min(coarse, evidence.coarse_at[j + 1] - 1)
            if abs(side) > 1.0:
                reaches = 2.0 * radius / sigma + GATE
                if best > GATE and e >= -reaches:
                    right, free = int(side > 0.0), int(e > reaches)
                    scores[j, _FITTED + 2 * right + free] += 1.0
                    evidence.beside[coarse, right, free] += 1.0
                continue
            fine = evidence.fine_at[j] + int((s - start) / FINE)
            fine = min(fine, evidence.fine_at[j + 1] - 1)
            evidence.likelihood[fine] += gain(e, entry >= before, best, side, background)
            if abs(e) <= GATE and best > abs(e) + _CONTESTED:
                evidence.hits[fine] += 1.0
            # Which side of the beam a ray's noise lies on must not decide whether it counts:
            # that would push the axis away from its neighbours.
            if entry >= before or apart < _LEAST_APART or abs(e) >= min(tukey, 0.5 * apart):
                continue
            first, last = beams.firsts[j], beams.lasts[j]
            if not first <= s <= last:
                continue
            if side * radius > radius - view.blur * entry:
                continue
            alone[j] += 1
            a, b, u, v = beams.anchors[j], beams.directions[j], beams.us[j], beams.vs[j]
            bow, share = beams.bows[j], (2.0 * s - first - last) / (last - first)
            off = 1.0 - share * share
            nx = (entry * wx - a[0] - s * b[0] - off * bow[0]) / radius
            ny = (entry * wy - a[1] - s * b[1] - off * bow[1]) / radius
            nz = (entry * wz - a[2] - s * b[2] - off * bow[2]) / radius
            incidence = nx * wx + ny * wy + nz * wz
            if abs(incidence) < _MIN_INCIDENCE:
                continue
            if view.footprint > 0.0:
                e -= _sunk(view.footprint, entry, wx, wy, wz, b, side, radius) / sigma
            share = min(abs(e) / tukey, 1.0)
            scale = 1.0 / (incidence * sigma)
            _weigh(
                evidence.normal[coarse],
                scores[j],
                (1.0 - share * share) ** 2,
                s,
                (nx * u[0] + ny * u[1] + nz * u[2]) * scale,
                (nx * v[0] + ny * v[1] + nz * v[2]) * scale,
                scale,
                e,
            )
    forget(meetings, touched)
    for j in range(len(alone)):
        if alone[j] > 0:
            evidence.scans[j] += alone[j] >= _FEWEST_ALONE
            for row in range(_FITTED):
                for column in range(_FITTED):
                    evidence.scatter[j, row, column] += scores[j, row] * scores[j, column]
            scores[j, :_FITTED] = 0.0
            alone[j] = 0
    for j in range(len(flanks)):
        _add_flanks(flanks[j], scores[j, _FITTED:])
