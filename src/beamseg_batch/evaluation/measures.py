"""A run measured against the truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.evaluation.matching import (
    PairMeasures,
    assign,
    assignment_cost,
    candidates,
    pair_measures,
)
from beamseg_batch.evaluation.results import Result
from beamseg_batch.evaluation.truth import JOINT_M, Truth
from beamseg_batch.geometry import FloatArray

__all__ = [
    "MEASURES",
    "EndError",
    "Evaluation",
    "JointMatches",
    "Match",
    "Measure",
    "Metrics",
    "Verdict",
    "evaluate",
    "joint_pairs",
    "metric_names",
    "spread",
]

Metrics: TypeAlias = Mapping[str, float | int | None]
"""Figures by flat, dotted name; None where there is nothing to measure."""

Verdict: TypeAlias = Literal["matched", "duplicate", "fragment", "false", "set aside"]

_STATISTICS = ("median", "p95", "max")
_CLAIMED = ("offset", "angle_deg", "radius", "bow")  # deviations of a whole segment
_HALF = 0.5  # of the shorter of two segments: beyond this overlap one is a duplicate


@dataclass(frozen=True)
class Measure:
    """A figure, or with `is_spread` its median, 95th percentile and maximum.

    `meaning` is one sentence without its full stop, `unit` is empty for counts and shares.
    """

    name: str
    unit: str
    meaning: str
    is_spread: bool = False

    @property
    def metric_names(self) -> tuple[str, ...]:
        """Flat names of its figures."""
        if not self.is_spread:
            return (self.name,)
        return tuple(f"{self.name}.{statistic}" for statistic in _STATISTICS)


MEASURES = (
    Measure("members", "", "Members of which at least 0.3 m was seen: those that count"),
    Measure("segments", "", "Segments of the run, without those set aside"),
    Measure("matched", "", "Members with a segment, and segments with a member"),
    Measure("missed", "", "Members that count and have no segment"),
    Measure("duplicates", "", "Further segments on a matched member that overlap its own by half"),
    Measure("fragments", "", "Further segments on a matched member that do not"),
    Measure("false", "", "Segments that are no member"),
    Measure("set_aside", "", "Segments on a member of which too little was seen to count"),
    Measure("recall", "", "`matched` of `members`"),
    Measure("precision", "", "`matched` of `segments`"),
    Measure("axis_offset", "m", "Mean distance between axis and member over the overlap", True),
    Measure("angle_deg", "°", "Angle between axis and member", True),
    Measure("own_end_error", "m", "From an end to the seen end, where that is the member's", True),
    Measure("own_end_error.count", "", "Number of those ends"),
    Measure("member_end_error", "m", "From those ends to where the member truly ends", True),
    Measure("cut_end_error", "m", "From an end to the seen end, where the view was cut", True),
    Measure("cut_end_error.count", "", "Number of those ends"),
    Measure("coverage.median", "", "Share of what was seen of a member beside its segment, median"),
    Measure("coverage.min", "", "The same, the least"),
    Measure("radius_error", "m", "Between the radii, round members only", True),
    Measure("measured_radius_error", "m", "Likewise of radii that were measured freely", True),
    Measure(
        "radius_class.right", "", "Share of round members nearest to their own of the true radii"
    ),
    Measure("shape.right", "", "Share of matches with the right cross-section"),
    Measure("bow_error", "m", "Between the deviations from the chord at mid-length", True),
    Measure("midpoint_distance", "m", "Between the mid-points, as in the report's figure 13", True),
    Measure("angle_rad", "rad", "Angle between axis and member, as in that figure", True),
    Measure("joints.truth", "", "Joints near which at least two members that count were seen"),
    Measure("joints.claimed", "", "Joints of the run, without those set aside"),
    Measure("joints.found", "", "True joints with one of the run within 0.1 m, one to one"),
    Measure("joints.missed", "", "True joints without one"),
    Measure("joints.invented", "", "Joints of the run without a true one"),
    Measure("joints.set_aside", "", "Joints of the run at a true one that was not seen"),
    Measure("joints.recall", "", "`joints.found` of `joints.truth`"),
    Measure("joints.precision", "", "`joints.found` of `joints.claimed`"),
    Measure("joints.error", "m", "From a true joint to the one found", True),
    Measure("honesty.offset", "", "Share of offsets at mid-overlap within 2 `sigma_offset`"),
    Measure("honesty.angle", "", "Share of angles within 2 `sigma_angle_deg`"),
    Measure("honesty.radius", "", "Share of errors of measured radii within 2 `sigma_radius`"),
    Measure("honesty.bow", "", "Share of errors of bows within 2 `sigma_bow`"),
    Measure("honesty.ends", "", "Share of own ends within 2 `sigma_end`, along the axis"),
    Measure("honesty.member_ends", "", "The same, from where the member truly ends"),
)
"""Every measure, in the order in which it is told."""


@dataclass(frozen=True)
class EndError:
    """How far an end of a segment is from the end of what was seen, and from the member's.

    Attributes
    ----------
    distance, along : float, metres
        From the seen end: in space, and along the member.
    member_distance, member_along : float, metres
        Likewise from the member's end.
    own : bool
        Whether what was seen ends where the member does.
    sigma : float, metres
        What the run claims; NaN if it does not.
    """

    distance: float
    along: float
    member_distance: float
    member_along: float
    own: bool
    sigma: float


@dataclass(frozen=True)
class Match:
    """A member and its segment.

    Attributes
    ----------
    member, segment : int
        Indices into the truth's members and the result's segments.
    axis_offset, mid_offset : float, metres
        Mean distance over the overlap, and in its middle.
    angle_deg : float, degrees
    coverage : float, 0 to 1
    midpoint_distance : float, metres
    ends : two EndError
        In the direction of the member.
    radius_error, measured_radius_error : float, metres
        Signed, claimed minus true; NaN if the member is not round.
    bow_error : float, metres
        Signed; NaN if the run claims none.
    """

    member: int
    segment: int
    axis_offset: float
    mid_offset: float
    angle_deg: float
    coverage: float
    midpoint_distance: float
    ends: tuple[EndError, EndError]
    radius_error: float
    measured_radius_error: float
    bow_error: float


@dataclass(frozen=True, eq=False)
class JointMatches:
    """True joints and those of the run.

    Attributes
    ----------
    pairs : (K, 2) int64
        Index of the true joint, and of the run's.
    errors : (K,) float64, metres
    missed : tuple of int
        True joints.
    invented, set_aside : tuple of int
        Joints of the run.
    """

    pairs: NDArray[np.int64]
    errors: FloatArray
    missed: tuple[int, ...]
    invented: tuple[int, ...]
    set_aside: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A run held against the truth.

    Attributes
    ----------
    truth : Truth
    result : Result
    matches : tuple of Match
        By member.
    missed : tuple of int
        Members that count and have no segment.
    verdicts : tuple of Verdict
        One per segment.
    nearest : tuple of (int or None)
        Per segment the member that the verdict is about.
    joints : JointMatches or None
        None if the run says nothing of joints.
    shapes : mapping of str to Counter of str
        Matches by true, then by claimed cross-section; empty if the run claims none.
    metrics : Metrics
        The figures of `MEASURES`.
    """

    truth: Truth
    result: Result
    matches: tuple[Match, ...]
    missed: tuple[int, ...]
    verdicts: tuple[Verdict, ...]
    nearest: tuple[int | None, ...]
    joints: JointMatches | None
    shapes: Mapping[str, Counter[str]]
    metrics: Metrics

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader of the figures must know."""
        return (*self.truth.notes, *self.result.notes)


def evaluate(truth: Truth, result: Result) -> Evaluation:
    """Measure a run against the truth.

    Parameters
    ----------
    truth : Truth
    result : Result

    Returns
    -------
    Evaluation
    """
    measures = pair_measures(truth.chords, truth.spans, result.axes)
    allowed = candidates(measures)
    pairs = assign(assignment_cost(measures), allowed & truth.counts[:, None])
    matches = tuple(_match(truth, result, measures, int(m), int(s)) for m, s in pairs)
    verdicts, nearest = _verdicts(truth, result, measures, allowed, pairs)
    joints = _match_joints(truth, result)
    shapes = _shapes(truth, result, matches)
    return Evaluation(
        truth=truth,
        result=result,
        matches=matches,
        missed=_left_over(np.flatnonzero(truth.counts), pairs[:, 0]),
        verdicts=verdicts,
        nearest=nearest,
        joints=joints,
        shapes=shapes,
        metrics={
            **_count_metrics(truth, verdicts),
            **_accuracy_metrics(matches),
            **_section_metrics(truth, result, matches, shapes),
            **_joint_metrics(truth, joints),
            **_honesty_metrics(result, matches),
        },
    )


def metric_names(measures: Iterable[Measure]) -> tuple[str, ...]:
    """Flat names of the figures of some measures, in their order."""
    return tuple(name for measure in measures for name in measure.metric_names)


def spread(name: str, values: Iterable[float]) -> dict[str, float | None]:
    """Median, 95th percentile and maximum of the values that are numbers, by metric name."""
    numbers = np.array([value for value in values if not np.isnan(value)], dtype=np.float64)
    keys = [f"{name}.{statistic}" for statistic in _STATISTICS]
    if not len(numbers):
        return dict.fromkeys(keys)
    return dict(zip(keys, np.percentile(numbers, (50, 95, 100)).tolist(), strict=True))


def joint_pairs(one: FloatArray, other: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Pair joints one to one, within `JOINT_M`, the nearest overall.

    Parameters
    ----------
    one, other : (N, 3), (M, 3) float64, metres

    Returns
    -------
    pairs : (K, 2) int64
    distances : (K,) float64, metres
    """
    distances = np.linalg.norm(one[:, None] - other[None, :], axis=2)
    pairs = assign(distances, distances <= JOINT_M)
    return pairs, distances[pairs[:, 0], pairs[:, 1]]


def _match(
    truth: Truth, result: Result, measures: PairMeasures, member: int, segment: int
) -> Match:
    is_round = truth.shapes[member] == "round"
    middles = [
        (lines.starts[row] + lines.ends[row]) / 2.0
        for lines, row in ((truth.chords, member), (result.axes, segment))
    ]
    return Match(
        member=member,
        segment=segment,
        axis_offset=float(measures.offset[member, segment]),
        mid_offset=float(measures.mid_offset[member, segment]),
        angle_deg=float(measures.angle_deg[member, segment]),
        coverage=float(measures.coverage[member, segment]),
        midpoint_distance=float(np.linalg.norm(middles[1] - middles[0])),
        ends=_end_errors(truth, result, member, segment),
        radius_error=float(result.radii[segment] - truth.radii[member]) if is_round else np.nan,
        measured_radius_error=(
            float(result.measured_radii[segment] - truth.radii[member])
            if is_round and result.measured_radii is not None
            else np.nan
        ),
        bow_error=(
            np.nan
            if result.bows is None
            else float(result.bows[segment] - truth.chord_bows[member])
        ),
    )


def _end_errors(
    truth: Truth, result: Result, member: int, segment: int
) -> tuple[EndError, EndError]:
    direction = truth.chords.directions[member]
    ends = [result.axes.starts[segment], result.axes.ends[segment]]
    unknown = np.full(len(result.numbers), np.nan)
    sigmas = [result.sigmas.get(name, unknown)[segment] for name in ("end_1", "end_2")]
    if result.axes.directions[segment] @ direction < 0.0:
        ends, sigmas = ends[::-1], sigmas[::-1]

    member_ends = (truth.axes.starts[member], truth.axes.ends[member])

    def error(k: int) -> EndError:
        # What was seen is known by bins of 2 cm, where the member ends exactly.
        miss, member_miss = ends[k] - truth.seen[member, k], ends[k] - member_ends[k]
        return EndError(
            distance=float(np.linalg.norm(miss)),
            along=abs(float(miss @ direction)),
            member_distance=float(np.linalg.norm(member_miss)),
            member_along=abs(float(member_miss @ direction)),
            own=bool(truth.own_ends[member, k]),
            sigma=float(sigmas[k]),
        )

    return error(0), error(1)


def _verdicts(
    truth: Truth,
    result: Result,
    measures: PairMeasures,
    allowed: NDArray[np.bool_],
    pairs: NDArray[np.int64],
) -> tuple[tuple[Verdict, ...], tuple[int | None, ...]]:
    """What each segment is, and the member that makes it so."""
    segment_of = dict(pairs.tolist())
    member_of = {segment: member for member, segment in segment_of.items()}
    verdicts: list[Verdict] = []
    nearest: list[int | None] = []
    for segment in range(len(result.axes)):
        possible = np.flatnonzero(allowed[:, segment])
        if segment in member_of:
            verdicts.append("matched")
            nearest.append(member_of[segment])
        elif not len(possible):
            verdicts.append("false")
            nearest.append(None)
        else:
            member = int(possible[np.argmin(measures.offset[possible, segment])])
            verdicts.append(_further(truth, result, member, segment, segment_of.get(member)))
            nearest.append(member)
    return tuple(verdicts), tuple(nearest)


def _further(truth: Truth, result: Result, member: int, segment: int, own: int | None) -> Verdict:
    """What a segment is that may be a member but is not its match.

    A member that counts has a match `own`: had none been left, this one would be it.
    """
    if own is None:
        return "set aside"
    return "duplicate" if _overlap_by_half(truth, result, member, segment, own) else "fragment"


def _overlap_by_half(truth: Truth, result: Result, member: int, one: int, other: int) -> bool:
    """Whether two segments lie side by side along a member for half of the shorter."""
    rows = [one, other]
    ends = np.stack([result.axes.starts[rows], result.axes.ends[rows]], axis=1)
    along = np.sort((ends - truth.axes.starts[member]) @ truth.axes.directions[member], axis=1)
    overlap = along[:, 1].min() - along[:, 0].max()
    return bool(overlap >= _HALF * (along[:, 1] - along[:, 0]).min())


def _match_joints(truth: Truth, result: Result) -> JointMatches | None:
    if result.joints is None:
        return None
    positions = np.array([joint.position for joint in truth.joints]).reshape(-1, 3)
    seen = np.flatnonzero(truth.joint_counts)
    pairs, errors = joint_pairs(positions[seen], result.joints)
    pairs[:, 0] = seen[pairs[:, 0]]
    left = _left_over(np.arange(len(result.joints)), pairs[:, 1])
    unseen = positions[~truth.joint_counts]
    hidden = [
        bool((np.linalg.norm(unseen - result.joints[joint], axis=1) <= JOINT_M).any())
        for joint in left
    ]
    return JointMatches(
        pairs=pairs,
        errors=errors,
        missed=_left_over(seen, pairs[:, 0]),
        invented=tuple(joint for joint, aside in zip(left, hidden, strict=True) if not aside),
        set_aside=tuple(joint for joint, aside in zip(left, hidden, strict=True) if aside),
    )


def _shapes(truth: Truth, result: Result, matches: Sequence[Match]) -> dict[str, Counter[str]]:
    shapes: dict[str, Counter[str]] = {}
    if result.shapes is not None:
        for match in matches:
            true, claimed = truth.shapes[match.member], result.shapes[match.segment]
            shapes.setdefault(true, Counter())[claimed] += 1
    return shapes


def _left_over(those: NDArray[np.int64], taken: NDArray[np.int64]) -> tuple[int, ...]:
    return tuple(np.setdiff1d(those, taken).tolist())


def _ratio(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _share(right: Iterable[bool]) -> float | None:
    outcomes = list(right)
    return _ratio(sum(outcomes), len(outcomes))


def _count_metrics(truth: Truth, verdicts: Sequence[Verdict]) -> dict[str, float | int | None]:
    counted = Counter(verdicts)
    members = int(truth.counts.sum())
    matched, segments = counted["matched"], len(verdicts) - counted["set aside"]
    return {
        "members": members,
        "segments": segments,
        "matched": matched,
        "missed": members - matched,
        "duplicates": counted["duplicate"],
        "fragments": counted["fragment"],
        "false": counted["false"],
        "set_aside": counted["set aside"],
        "recall": _ratio(matched, members),
        "precision": _ratio(matched, segments),
    }


def _accuracy_metrics(matches: Sequence[Match]) -> dict[str, float | int | None]:
    ends = [end for match in matches for end in match.ends]
    own = [end.distance for end in ends if end.own]
    cut = [end.distance for end in ends if not end.own]
    coverage = [match.coverage for match in matches]
    return {
        **spread("axis_offset", (match.axis_offset for match in matches)),
        **spread("angle_deg", (match.angle_deg for match in matches)),
        **spread("own_end_error", own),
        "own_end_error.count": len(own),
        **spread("member_end_error", (end.member_distance for end in ends if end.own)),
        **spread("cut_end_error", cut),
        "cut_end_error.count": len(cut),
        "coverage.median": float(np.median(coverage)) if coverage else None,
        "coverage.min": min(coverage, default=None),
    }


def _section_metrics(
    truth: Truth,
    result: Result,
    matches: Sequence[Match],
    shapes: Mapping[str, Counter[str]],
) -> dict[str, float | int | None]:
    is_round = np.array([shape == "round" for shape in truth.shapes], dtype=np.bool_)
    radii = np.unique(np.round(truth.radii[is_round], 6))
    return {
        **spread("radius_error", (abs(match.radius_error) for match in matches)),
        **spread("measured_radius_error", (abs(m.measured_radius_error) for m in matches)),
        "radius_class.right": _share(
            _nearest_radius(radii, result.radii[match.segment])
            == _nearest_radius(radii, truth.radii[match.member])
            for match in matches
            if is_round[match.member]
        ),
        "shape.right": _ratio(
            sum(claimed[true] for true, claimed in shapes.items()),
            sum(claimed.total() for claimed in shapes.values()),
        ),
        **spread("bow_error", (abs(match.bow_error) for match in matches)),
        **spread("midpoint_distance", (match.midpoint_distance for match in matches)),
        **spread("angle_rad", (float(np.radians(match.angle_deg)) for match in matches)),
    }


def _nearest_radius(radii: FloatArray, radius: float) -> int:
    return int(np.argmin(np.abs(radii - radius)))


def _joint_metrics(truth: Truth, joints: JointMatches | None) -> dict[str, float | int | None]:
    n_true = int(truth.joint_counts.sum())
    names = [name for name in metric_names(MEASURES) if name.startswith("joints.")]
    metrics: dict[str, float | int | None] = dict.fromkeys(names)
    metrics["joints.truth"] = n_true
    if joints is not None:
        found = len(joints.pairs)
        claimed = found + len(joints.invented)
        metrics |= {
            "joints.claimed": claimed,
            "joints.found": found,
            "joints.missed": len(joints.missed),
            "joints.invented": len(joints.invented),
            "joints.set_aside": len(joints.set_aside),
            "joints.recall": _ratio(found, n_true),
            "joints.precision": _ratio(found, claimed),
            **spread("joints.error", joints.errors),
        }
    return metrics


def _deviating_error(match: Match) -> float:
    """Error that a run's `sigma_radius` speaks of: that of the measured radius, if it has one."""
    measured, stated = abs(match.measured_radius_error), abs(match.radius_error)
    return measured if np.isfinite(measured) else stated


def _honesty_metrics(result: Result, matches: Sequence[Match]) -> dict[str, float | int | None]:
    """Share of true errors within two of the standard deviations that are claimed."""
    unknown = np.full(len(result.numbers), np.nan)
    claimed = {name: result.sigmas.get(name, unknown) for name in _CLAIMED}
    errors = {
        "offset": [(m.mid_offset, claimed["offset"][m.segment]) for m in matches],
        "angle": [(m.angle_deg, claimed["angle_deg"][m.segment]) for m in matches],
        "radius": [(_deviating_error(m), claimed["radius"][m.segment]) for m in matches],
        "bow": [(abs(m.bow_error), claimed["bow"][m.segment]) for m in matches],
        "ends": [(end.along, end.sigma) for m in matches for end in m.ends if end.own],
        "member_ends": [(e.member_along, e.sigma) for m in matches for e in m.ends if e.own],
    }
    return {
        f"honesty.{name}": _share(
            bool(error <= 2.0 * sigma)
            for error, sigma in pairs
            if np.isfinite(error) and np.isfinite(sigma)
        )
        for name, pairs in errors.items()
    }
