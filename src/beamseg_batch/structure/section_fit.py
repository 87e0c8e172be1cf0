"""Cross-sections fitted to the rays near a beam, and which of them explains these best."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beamseg_batch.cylinder.section_kernels import (
    descend,
    ended_costs,
    normal_equations,
    ray_costs,
)
from beamseg_batch.geometry import FloatArray, parabola
from beamseg_batch.section import SHAPES, Section, Shape

__all__ = [
    "Lead",
    "SectionFit",
    "about_axis",
    "axis_covariance",
    "costs_with_ends",
    "fit_again",
    "fit_sections",
    "fit_standard",
    "is_richer",
    "lead",
    "section_bow",
]

_COARSE_RAYS = 700
_FIRST_STEP_M, _LAST_STEP_M = 0.012, 0.0002
_ROUGH_STEP_M = 0.002
_TURNS = 24
_BEST_STARTS = 4
_PLATE_M = 0.008
_RADIANS_A_M = 6.0  # turn that moves the edges of a section about as far
_SLOPES_A_M = 2.0
_GATE = 3.0
_NO_CHANCE_SIGMAS = 5.0
_DRAWS = 16
_WAYS = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
_SYMMETRY = {"round": 1, "square": 4, "i": 2, "l": 1, "c": 1}
"""Turns of a circle that look alike, the sizes exchanged for a square."""


def _moves(shape: Shape) -> FloatArray:
    """What may change of a shape, each row for a step of a metre."""
    centre = [[1, 1, 0, 0, 0, 0, 0, 0, 0], [0, 0, 1, 1, 0, 0, 0, 0, 0]]
    slopes = [[0, 0, 0, 0, 0, 0, 0, _SLOPES_A_M, 0], [0, 0, 0, 0, 0, 0, 0, 0, _SLOPES_A_M]]
    if shape == "round":
        return np.array([*centre, [-1, 1, -1, 1, 0, 0, 0, 0, 0], *slopes], np.float64)
    edges = np.eye(4, 9).tolist()
    turn = [[0, 0, 0, 0, _RADIANS_A_M, 0, 0, 0, 0]]
    plates = np.eye(9)[5:7].tolist()
    if shape == "l":  # angles are rolled with legs of one thickness
        plates = [[0, 0, 0, 0, 0, 1, 1, 0, 0]]
    elif shape == "square":
        plates = []
    return np.array([*centre, *edges, *turn, *plates, *slopes], np.float64)


_MOVES = {shape: _moves(shape) for shape in SHAPES}
_FREE = {shape: moves if shape == "round" else moves[2:] for shape, moves in _MOVES.items()}
"""Those of them that are independent."""
_PLACED = {
    shape: np.concatenate([moves[:2], moves[6:7], moves[-2:]]) for shape, moves in _MOVES.items()
}
"""Those of them that leave the size as it is."""


@dataclass(frozen=True, eq=False)
class SectionFit:
    """A section as it fits the rays best.

    Attributes
    ----------
    shape : Shape
    p : (9,) float64
        As of `beamseg_batch.cylinder.section_kernels`.
    costs : (N,) float64
        Of each ray.
    """

    shape: Shape
    p: FloatArray
    costs: FloatArray

    @property
    def cost(self) -> float:
        """Of all rays."""
        return float(self.costs.sum())

    @property
    def section(self) -> Section:
        """The section alone."""
        left, right, low, high, _, web, flange = self.p[:7].tolist()
        if self.shape == "round":
            diameter = 0.5 * (right - left + high - low)
            return Section("round", diameter, diameter)
        plates = (web, flange) if self.shape != "square" else (0.0, 0.0)
        return Section(self.shape, right - left, high - low, *plates)

    @property
    def centre(self) -> FloatArray:
        """(2,) float64, metres: the centre of area along the beam's normals."""
        return centre_of(self.shape, self.p)


def centre_of(shape: Shape, p: FloatArray) -> FloatArray:
    """Centre of area of a section along the normals of its beam, (2,) float64, metres."""
    left, right, low, high, roll, web, flange = p[:7].tolist()
    section = Section(shape, right - left, high - low, web, flange)
    # The rectangles are about the centre of area; where their edges are tells where that is.
    plates = section.plates() or [(0.0, 0.0, right - left, high - low)]
    u = left - min(u - 0.5 * width for u, _, width, _ in plates)
    v = low - min(v - 0.5 * height for _, v, _, height in plates)
    cos, sin = math.cos(roll), math.sin(roll)
    return np.array([cos * u - sin * v, sin * u + cos * v])


def about_axis(size: Section, roll: float) -> FloatArray:
    """Parameters of a section whose centre of area is on the axis of its beam.

    Parameters
    ----------
    size : Section
    roll : float, radians

    Returns
    -------
    (9,) float64
        As of `beamseg_batch.cylinder.section_kernels`.
    """
    p = np.array([0.0, size.width, 0.0, size.height, roll, size.web, size.flange, 0.0, 0.0])
    turned = np.cos(roll), np.sin(roll)
    u, v = centre_of(size.shape, p)
    p[:2] -= turned[0] * u + turned[1] * v
    p[2:4] -= turned[0] * v - turned[1] * u
    return p


def fit_again(
    shape: Shape, p: FloatArray, rays: FloatArray, reach: float, worst: float, *, sized: bool
) -> SectionFit:
    """Improve a section that is known well.

    Parameters
    ----------
    shape : Shape
    p : (9,) float64
    rays, reach, worst
        As of `fit_sections`.
    sized : bool
        Whether its size is known, too, and stays.

    Returns
    -------
    SectionFit
    """
    moves = (_PLACED if sized else _MOVES)[shape]
    return _settled(shape, p, moves, (_ROUGH_STEP_M, _LAST_STEP_M), rays, reach, worst)


def costs_with_ends(
    fit: SectionFit, first: float, last: float, rays: FloatArray, reach: float, worst: float
) -> FloatArray:
    """How badly a section explains each ray, if it ends.

    Parameters
    ----------
    fit : SectionFit
    first, last : float, metres
        Places along the beam.
    rays, reach, worst
        As of `fit_sections`; the rays may be others than those that it was fitted to.

    Returns
    -------
    (N,) float64
    """
    costs = np.empty(len(rays))
    ended_costs(SHAPES.index(fit.shape), fit.p, rays, reach, worst, first, last, costs)
    return costs


def fit_sections(
    rays: FloatArray, reach: float, worst: float, shapes: Sequence[Shape] = SHAPES
) -> list[SectionFit]:
    """Find the section of each shape that explains the rays best.

    Parameters
    ----------
    rays : (N, 10) float64
        See `beamseg_batch.cylinder.near_kernels.gather_near`.
    reach : float, metres
        Returns this near behind the axis are of the section or of something beside it.
    worst : float
        Cost of a ray that is not explained.
    shapes : sequence of Shape

    Returns
    -------
    list of SectionFit
        The likeliest first. One that has no chance by a part of the rays is left as those
        show it.
    """
    some = np.ascontiguousarray(rays[:: max(len(rays) // _COARSE_RAYS, 1)])
    rough = [_likeliest(shape, _starts(shape, some, reach, worst), some, reach, worst)
             for shape in shapes]  # fmt: skip
    best = min(rough, key=lambda fit: fit.cost)
    # What the best one shows of the outline, the others may show as well: from one side, all
    # sections with a flat back look alike.
    rough = [
        min(fit, _likeliest(fit.shape, _turned(best.p), some, reach, worst), key=_cost)
        if fit is not best and fit.shape != "round"
        else fit
        for fit in rough
    ]
    best = min(rough, key=_cost)
    steps = 2.0 * _ROUGH_STEP_M, _LAST_STEP_M
    fits = [
        _settled(
            fit.shape, fit.p, _MOVES[fit.shape],
            steps if lead(best, fit, some).sigmas < _NO_CHANCE_SIGMAS else (0.0, 1.0),
            rays, reach, worst,
        )
        for fit in rough
    ]  # fmt: skip
    return sorted(fits, key=_cost)


def _cost(fit: SectionFit) -> float:
    return fit.cost


def _likeliest(
    shape: Shape, starts: Sequence[FloatArray], rays: FloatArray, reach: float, worst: float
) -> SectionFit:
    steps = _FIRST_STEP_M, _ROUGH_STEP_M
    fits = (_settled(shape, p, _MOVES[shape], steps, rays, reach, worst) for p in starts)
    return min(fits, key=_cost)


def _turned(p: FloatArray) -> list[FloatArray]:
    """Turn a section by quarters, its outline where it is."""
    turned = [p.copy()]
    for _ in range(3):
        left, right, low, high, roll = turned[-1][:5].tolist()
        turned.append(np.array([low, high, -right, -left, roll + 0.5 * np.pi, *p[5:]]))
    for each in turned:
        each[5:7] = _PLATE_M
    return turned


def fit_standard(
    fit: SectionFit, size: Section, rays: FloatArray, reach: float, worst: float
) -> SectionFit:
    """Put a section of a given size where the rays want it, near where another was found.

    Parameters
    ----------
    fit : SectionFit
        Of the same shape, and about as large.
    size : Section
    rays, reach, worst
        As of `fit_sections`.

    Returns
    -------
    SectionFit
    """
    p = fit.p.copy()
    for first, extent in ((0, size.width), (2, size.height)):
        middle = 0.5 * (p[first] + p[first + 1])
        p[first : first + 2] = middle - 0.5 * extent, middle + 0.5 * extent
    p[5:7] = (size.web, size.flange) if size.web else p[5:7]
    steps = _ROUGH_STEP_M, _LAST_STEP_M
    return _settled(fit.shape, p, _PLACED[fit.shape], steps, rays, reach, worst)


def _settled(
    shape: Shape, start: FloatArray, moves: FloatArray, steps: tuple[float, float],
    rays: FloatArray, reach: float, worst: float,
) -> SectionFit:  # fmt: skip
    p, costs = start.copy(), np.empty(len(rays))
    descend(SHAPES.index(shape), p, moves, *steps, rays, reach, worst)
    ray_costs(SHAPES.index(shape), p, rays, reach, worst, costs)
    return SectionFit(shape, p, costs)


@dataclass(frozen=True)
class Lead:
    """By how much one section explains the rays better than another.

    Attributes
    ----------
    gain : float
        Of log-likelihood, less what the rival's further parameters are worth.
    sigmas : float
        The same, in standard deviations.
    """

    gain: float
    sigmas: float


def lead(fit: SectionFit, rival: SectionFit, rays: FloatArray) -> Lead:
    """Hold two sections against one another.

    Parameters
    ----------
    fit, rival : SectionFit
    rays : (N, 10) float64
        That both were fitted to.

    Returns
    -------
    Lead

    Notes
    -----
    Vuong's test for models of which neither contains the other, with a scan for an
    observation: the rays of one scan share the error of its pose, so that they are not
    independent. The penalty is that of Schwarz, by the number of scans.
    """
    _, groups = np.unique(rays[:, 7], return_inverse=True)
    by_scan = np.bincount(groups, rival.costs - fit.costs)
    further = len(_FREE[fit.shape]) - len(_FREE[rival.shape])
    gain = float(by_scan.sum()) - 0.5 * further * math.log(max(len(by_scan), 1))
    return Lead(gain, gain / max(float(np.sqrt((by_scan**2).sum())), 1e-9))


def _starts(shape: Shape, rays: FloatArray, reach: float, worst: float) -> list[FloatArray]:
    """Sections about the size of what was hit, turned every way: the likeliest few."""
    number, costs = SHAPES.index(shape), np.empty(len(rays))
    hits = np.abs(rays[:, 3]) < reach
    points = rays[hits, 2:3] * np.stack([-rays[hits, 1], rays[hits, 0]], axis=1)
    points += rays[hits, 3:4] * rays[hits, :2]
    tried = []
    for turn in np.arange(_TURNS) * 2.0 * np.pi / _TURNS / _SYMMETRY[shape]:
        cos, sin = np.cos(turn), np.sin(turn)
        turned = points @ np.array([[cos, -sin], [sin, cos]])
        low, high = np.percentile(turned, (6, 94), axis=0)
        half = np.clip(0.5 * (high - low), 0.03, 0.15)
        middle = 0.5 * (low + high)
        u, v = middle - half, middle + half
        p = np.array([u[0], v[0], u[1], v[1], turn, _PLATE_M, _PLATE_M, 0.0, 0.0])
        tried.append((ray_costs(number, p, rays, reach, worst, costs), tuple(p)))
    tried.sort()
    return [np.array(p) for _, p in tried[:_BEST_STARTS]]


def is_richer(one: SectionFit, other: SectionFit) -> bool:
    """Whether the shape of one section has more to choose than that of another."""
    return len(_FREE[one.shape]) > len(_FREE[other.shape])


def axis_covariance(fit: SectionFit, rays: FloatArray) -> FloatArray:
    """Covariance of the axis of a section, from how far scans disagree about it.

    Parameters
    ----------
    fit : SectionFit
    rays : (N, 10) float64
        That it was fitted to.

    Returns
    -------
    (4, 4) float64, metres and radians
        Of its centre of area along the beam's normals, and of its slopes; NaN where the rays
        leave something open.
    """
    moves = _FREE[fit.shape]
    _, groups = np.unique(rays[:, 7], return_inverse=True)
    matrix = np.zeros((len(moves), len(moves)))
    scores = np.zeros((int(groups.max(initial=-1)) + 1, len(moves)))
    normal_equations(
        SHAPES.index(fit.shape), fit.p, moves, rays, _GATE, matrix, scores, groups
    )  # fmt: skip
    try:
        inverse = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        return np.full((4, 4), np.nan)
    small = 1e-5
    changes = [
        centre_of(fit.shape, fit.p + small * move) - centre_of(fit.shape, fit.p - small * move)
        for move in moves
    ]
    slopes = np.concatenate([np.array(changes).T / (2.0 * small), moves[:, 7:9].T])
    free = inverse @ (scores.T @ scores) @ inverse
    covariance: FloatArray = slopes @ free @ slopes.T
    return covariance


def section_bow(
    fit: SectionFit, rays: FloatArray, reach: float, worst: float, first: float, last: float
) -> tuple[FloatArray, float]:
    """How far a beam of a known section is bent.

    Parameters
    ----------
    fit : SectionFit
        With a straight axis.
    rays : (N, 10) float64
        That it was fitted to.
    reach, worst
        As of `fit_sections`.
    first, last : float, metres
        Ends of the beam.

    Returns
    -------
    bow : (2,) float64, metres
        Along the beam's normals.
    sigma : float, metres
        Its standard deviation, by the bootstrap over scans (Efron 1979).
    """
    numbers, groups = np.unique(rays[:, 7], return_inverse=True)
    random, count = np.random.default_rng(0), len(numbers)
    drawn = (np.bincount(random.integers(count, size=count), minlength=count)
             for _ in range(_DRAWS))  # fmt: skip
    samples = [np.repeat(rays, often[groups], axis=0) for often in drawn]
    bow, *others = (_bow(fit, each, reach, worst, first, last) for each in (rays, *samples))
    spread = np.var(others, axis=0, ddof=1).sum() + 2.0 * _LAST_STEP_M**2 / 3.0
    return bow, float(np.sqrt(spread))


def _bow(
    fit: SectionFit, rays: FloatArray, reach: float, worst: float, first: float, last: float
) -> FloatArray:
    """Find the bow that explains the rays best, step by step."""
    off, costs = parabola(rays[:, 5], first, last)[0], np.empty(len(rays))
    off -= off.mean()  # the axis went through the middle of a bow

    def cost(bow: FloatArray) -> float:
        seen = rays.copy()  # a beam further aside is one that is passed less far aside
        seen[:, 2] -= off * (bow[1] * rays[:, 0] - bow[0] * rays[:, 1])
        seen[:, 3] -= off * (bow[0] * rays[:, 0] + bow[1] * rays[:, 1])
        return float(ray_costs(SHAPES.index(fit.shape), fit.p, seen, reach, worst, costs))

    bow, step = np.zeros(2), 2.0 * _ROUGH_STEP_M
    best = cost(bow)
    while step > _LAST_STEP_M:
        tried = [bow + step * way for way in _WAYS]
        found = [cost(each) for each in tried]
        if min(found) < best:
            best, bow = min(found), tried[int(np.argmin(found))]
        else:
            step *= 0.5
    return bow
