"""Bent beams: the parabola that the rays of one stretch, or of two pieces, show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.cylinder.evidence_kernels import FINE
from beamseg_batch.geometry import FloatArray, parabola
from beamseg_batch.model import BENT_M, BENT_SIGMAS
from beamseg_batch.structure.fates import Fates, Refusal
from beamseg_batch.structure.hypothesis import Beam, Sums, normal_matrices
from beamseg_batch.structure.neighbours import Neighbours

__all__ = [
    "Piece",
    "along_chord",
    "arc_gain",
    "arc_matrix",
    "is_clear",
    "is_worth_a_trial",
    "with_arcs",
]

_MOST_BOW = 0.0625  # of the length
_LEAST_LENGTH_M = 0.4
_PLAIN_M, _PLAIN_GAIN = 0.004, 200.0
_BETTER = 25.0  # by which squared residuals must fall, for an arc instead of a line
_LEFT_OVER_M = 0.0015  # root mean square that an arc may leave, beyond what its pieces do
_GAP_M, _OVERLAP_M = 0.08, 0.3
_APART_M = 0.04
_MOST_TURN = np.cos(np.radians(12.0))
_AXIS, _BOW = [0, 1, 2, 3], [5, 6]


def along_chord(rows: FloatArray, middles: FloatArray, beam: Beam) -> FloatArray:
    """Normal equations as they would be, had the rays been held against the beam's chord.

    Parameters
    ----------
    rows : (N, 22) float64
        Of bins of a beam.
    middles : (N,) float64, metres
        Where these are, along the chord.
    beam : Beam

    Returns
    -------
    (N, 22) float64
        To first order; a bin is short enough for an axis to be straight in it.
    """
    if not beam.is_bent:
        return rows
    off, slope = parabola(middles, beam.first, beam.last)
    sizes = np.array([beam.bow @ normal for normal in beam.normals])
    steps = np.zeros((len(rows), 5))
    steps[:, :2] = (off - slope * middles)[:, None] * sizes
    steps[:, 2:4] = slope[:, None] * sizes
    matrices, rights = normal_matrices(rows)
    moved = np.einsum("nij,nj->ni", matrices, steps)
    rows = rows.copy()
    rows[:, 13] += np.einsum("ni,ni->n", steps, 2.0 * rights + moved)
    rows[:, 9:13] += moved[:, :4]
    rows[:, 21] += moved[:, 4]
    return rows


def arc_matrix(
    rows: FloatArray, middles: FloatArray, first: float, last: float
) -> tuple[FloatArray, FloatArray]:
    """Normal equations of an axis, a radius and a bow.

    Parameters
    ----------
    rows : (N, 22) float64
        Of bins, against a straight axis.
    middles : (N,) float64, metres
    first, last : float, metres
        Ends of the stretch that the bow is of.

    Returns
    -------
    matrix : (7, 7) float64
        The axis' offsets and slopes, the radius, and the bow along both normals.
    right : (7,) float64
    """
    off, slope = parabola(middles, first, last)
    basis = np.zeros((len(rows), 7, 5))
    basis[:, :5] = np.eye(5)
    for k in (0, 1):
        basis[:, 5 + k, k], basis[:, 5 + k, 2 + k] = off - slope * middles, slope
    matrices, rights = normal_matrices(rows)
    matrix, right = np.zeros((7, 7)), np.zeros(7)
    wide = basis @ matrices
    matrix[:] = (wide @ basis.transpose(0, 2, 1)).sum(axis=0)
    right[:] = np.einsum("nij,nj->i", basis, rights)
    # What is there without a bow is summed as ever, to the last digit.
    matrix[:5, :5], right[:5] = normal_matrices(rows.sum(axis=0))
    return matrix, right


def arc_gain(rows: FloatArray, middles: FloatArray, first: float, last: float) -> float:
    """By how much the squared residuals of a stretch fall when its axis may be bent."""
    return _bow_gain(*arc_matrix(rows, middles, first, last))


def _bow_gain(matrix: FloatArray, right: FloatArray) -> float:
    return _gain(matrix, right, _AXIS + _BOW) - _gain(matrix, right, _AXIS)


def _gain(matrix: FloatArray, right: FloatArray, which: Sequence[int]) -> float:
    chosen = right[which]
    return float(chosen @ np.linalg.lstsq(matrix[np.ix_(which, which)], chosen, rcond=None)[0])


def is_clear(bow: FloatArray, covariance: FloatArray, length: float) -> bool:
    """Whether a bow is too large for a straight beam, and small enough for a bent one.

    Parameters
    ----------
    bow : (2,) float64, metres
        Along both normals.
    covariance : (2, 2) float64, square metres
    length : float, metres
        Of the beam.
    """
    size = _size(bow)
    if not _is_possible(size, length):
        return False
    return size**2 > BENT_SIGMAS * float(np.sqrt(bow @ covariance @ bow))


def is_worth_a_trial(bow: FloatArray, matrix: FloatArray, right: FloatArray, length: float) -> bool:
    """Whether single rays deny that a beam is straight, however far scans disagree.

    As long as a bent beam is held to be straight, scans that see other parts of it must
    disagree, so that no bow is clear. Whether they still do tells the next pass.

    Parameters
    ----------
    bow : (2,) float64, metres
        Along both normals.
    matrix, right : (7, 7), (7,) float64
        Of `arc_matrix`.
    length : float, metres
        Of the beam.
    """
    size = _size(bow)
    plain = size > _PLAIN_M and _is_possible(size, length)
    return plain and _bow_gain(matrix, right) > _PLAIN_GAIN


def _size(bow: FloatArray) -> float:
    return float(np.linalg.norm(bow))


def _is_possible(size: float, length: float) -> bool:
    return length >= _LEAST_LENGTH_M and BENT_M < size < _MOST_BOW * length


@dataclass(frozen=True, eq=False)
class Piece:
    """A beam that was made of the evidence about one that was asked about.

    Attributes
    ----------
    beam : Beam
    asked : int
        Which one that was.
    first, last : float, metres
        The stretch of that one.
    """

    beam: Beam
    asked: int
    first: float
    last: float


def with_arcs(
    pieces: Sequence[Piece], beams: Sequence[Beam], sums: Sums, noise: float, fates: Fates
) -> list[Beam]:
    """Make one bent beam of two that lie end to end, where an arc explains both.

    Parameters
    ----------
    pieces : sequence of Piece
    beams : sequence of Beam
        Those that were asked about.
    sums : Sums
        What was answered.
    noise : float, metres
    fates : Fates
        Told of the pieces that are no beams of their own any more.

    Returns
    -------
    list of Beam
        What became of the pieces, in their order.
    """
    made: list[Beam | None] = [piece.beam for piece in pieces]
    neighbours = Neighbours([piece.beam for piece in pieces], reach=_OVERLAP_M)
    pairs = ((i, j) for i, one in enumerate(pieces) for j in neighbours.near(one.beam) if j > i)
    for i, j in pairs:
        if made[i] is not pieces[i].beam or made[j] is not pieces[j].beam:
            continue  # is part of an arc already: the rest waits a pass
        chord = _chord(pieces[i].beam, pieces[j].beam)
        if chord is not None:
            arc = _arc((pieces[i], pieces[j]), chord, beams, sums, noise)
            if arc is not None:
                made[i], made[j] = arc, None
                length = float(np.linalg.norm(chord[1] - chord[0]))
                refusal = Refusal("bent", _size(arc.bow), _MOST_BOW * length, arc.number)
                for piece in (pieces[i], pieces[j]):
                    fates.note(piece.beam, refusal)
    return [beam for beam in made if beam is not None]


def _chord(one: Beam, other: Beam) -> tuple[FloatArray, FloatArray] | None:
    """Far ends of two beams that go on in one another."""
    if one.radius != other.radius or one.stiff or other.stiff:
        return None
    if abs(float(one.direction @ other.direction)) < _MOST_TURN:
        return None
    apart = [[float(np.linalg.norm(a - b)) for b in other.ends] for a in one.ends]
    near = int(np.argmin(apart))
    a, b = near // 2, near % 2
    if apart[a][b] > max(_GAP_M, _OVERLAP_M):
        return None
    start, end = one.ends[1 - a], other.ends[1 - b]
    out = (1.0 if a else -1.0) * one.direction
    step = other.ends[b] - one.ends[a]
    gap = float(step @ out)
    between = -_OVERLAP_M < gap < _GAP_M and (end - one.ends[a]) @ out > 0.0
    aside = float(np.linalg.norm(step - gap * out))
    return (start, end) if between and aside < _APART_M else None


def _arc(
    pair: tuple[Piece, Piece],
    chord: tuple[FloatArray, FloatArray],
    beams: Sequence[Beam],
    sums: Sums,
    noise: float,
) -> Beam | None:
    """Bent beam between two far ends, if it explains the rays of two pieces as well as these."""
    better = max(pair, key=lambda piece: piece.beam.score).beam
    middle, length = 0.5 * (chord[0] + chord[1]), float(np.linalg.norm(chord[1] - chord[0]))
    line = replace(
        better, anchor=middle, direction=(chord[1] - chord[0]) / length,
        first=-0.5 * length, last=0.5 * length, bow=np.zeros(3),
    )  # fmt: skip
    matrix, right = np.zeros((6, 6)), np.zeros(6)
    whole, straight, bent, rays = 0.0, 0.0, 0.0, 0.0
    for piece in pair:
        asked, span = beams[piece.asked], sums.coarse_bins(piece.asked, piece.first, piece.last)
        rows, middles = sums.coarse(piece.asked)[span], sums.middles(piece.asked)[span]
        left, toward, square = _against(line, rows, middles, asked)
        matrix, right, whole = matrix + left, right + toward, whole + square
        alone = along_chord(rows, middles, asked)
        both = arc_matrix(alone, middles, piece.first, piece.last)
        straight += float(alone[:, 13].sum()) - _gain(*both, _AXIS)
        bent += float(alone[:, 13].sum()) - _gain(*both, _AXIS + _BOW)
        rays += float(rows[:, 14].sum())
    step = np.linalg.lstsq(matrix, right, rcond=None)[0]
    arc, one = whole - float(right @ step), whole - _gain(matrix, right, _AXIS)
    most = min(straight, one - _BETTER, bent + rays * (_LEFT_OVER_M / noise) ** 2)
    if arc > most:
        return None
    u, v = line.normals
    bow = step[4] * u + step[5] * v
    if not _is_possible(_size(bow), length):
        return None
    direction = line.direction + step[2] * u + step[3] * v
    direction /= np.linalg.norm(direction)
    profile, start = _profile(pair, line)
    return replace(
        line,
        anchor=middle + step[0] * u + step[1] * v,
        direction=direction,
        bow=bow - (bow @ direction) * direction,
        score=sum(piece.beam.score for piece in pair),
        hits=sum(piece.beam.hits for piece in pair),
        scans=max(piece.beam.scans for piece in pair),
        snapped=(False, False),
        first_seen_ns=min(piece.beam.first_seen_ns for piece in pair),
        last_seen_ns=max(piece.beam.last_seen_ns for piece in pair),
        profile=profile,
        profile_start=start,
    )


def _against(
    line: Beam, rows: FloatArray, middles: FloatArray, asked: Beam
) -> tuple[FloatArray, FloatArray, float]:
    """Normal equations of another axis and its bow, of the bins of a beam that was asked.

    Parameters
    ----------
    line : Beam
        The other axis, straight, from where steps are counted.
    rows : (N, 22) float64
    middles : (N,) float64, metres
    asked : Beam

    Returns
    -------
    matrix : (6, 6) float64
        Offsets, slopes and bow along both normals of the line.
    right : (6,) float64
    square : float
        Sum of squared residuals against the line.
    """
    across = np.array(line.normals)
    off, slope = parabola(middles, asked.first, asked.last)
    axis = asked.anchor + middles[:, None] * asked.direction + off[:, None] * asked.bow
    ahead = asked.direction + slope[:, None] * asked.bow
    places, way = (axis - line.anchor) @ line.direction, ahead @ line.direction
    # Where the line is, from where the rays were asked, and how that grows along the bin.
    value = -((axis - line.anchor) @ across.T) @ across
    rise = -(ahead @ across.T) @ across
    off, slope = parabola(places, line.first, line.last)
    shapes = ((np.ones_like(places), np.zeros_like(places)), (places, way), (off, slope * way))
    normals = np.array(asked.normals)
    turn = normals @ across.T
    basis = np.zeros((len(rows), 6, 4))
    for k, (height, steep) in enumerate(shapes):
        for side in (0, 1):
            basis[:, 2 * k + side, :2] = (height - steep * middles)[:, None] * turn[:, side]
            basis[:, 2 * k + side, 2:] = steep[:, None] * turn[:, side]
    fixed = np.concatenate(
        [(value - rise * middles[:, None]) @ normals.T, rise @ normals.T], axis=1
    )
    matrices, rights = normal_matrices(rows)
    matrices, rights = matrices[:, :4, :4], rights[:, :4]
    moved = np.einsum("nij,nj->ni", matrices, fixed)
    matrix = ((basis @ matrices) @ basis.transpose(0, 2, 1)).sum(axis=0)
    right = np.einsum("nij,nj->i", basis, rights - moved)
    square = rows[:, 13].sum() + np.einsum("ni,ni->", fixed, moved - 2.0 * rights)
    return matrix, right, float(square)


def _profile(pair: tuple[Piece, Piece], line: Beam) -> tuple[FloatArray, float]:
    """Evidence of two pieces along the line that joins them, and where it begins."""
    places, values = [], []
    for beam in (piece.beam for piece in pair):
        s = beam.profile_start + (np.arange(len(beam.profile)) + 0.5) * FINE
        points = beam.anchor + s[:, None] * beam.direction
        places.append((points - line.anchor) @ line.direction)
        values.append(beam.profile)
    start = float(min(part.min() for part in places)) - 0.5 * FINE
    bins: NDArray[np.int64] = ((np.concatenate(places) - start) / FINE).astype(np.int64)
    profile: FloatArray = np.bincount(bins, np.concatenate(values)).astype(np.float64)
    return profile, start
