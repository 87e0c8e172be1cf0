"""Why there is, or is not, a beam at a place: what a run tells of it, in time order."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.geometry import FloatArray, matrix_from_quaternion
from beamseg_batch.outputs.run_folder import Run
from beamseg_batch.reasons import REASONS
from beamseg_batch.tables import ColumnArrays

__all__ = [
    "Explanation",
    "NearCandidate",
    "NearSegment",
    "Nearest",
    "explain",
    "explanation_document",
]

SCHEMA_VERSION = 1
"""Raised when a key of the document changes its name or its meaning."""

_STAGES = ("scan", "gathering", "leftovers", "pass", "end")
_CLEARLY_M = 0.02
_MOST_NAMED = 10
_KEEP = "run it again with --keep-candidates"


@dataclass(frozen=True)
class NearSegment:
    """A beam near the place.

    Attributes
    ----------
    segment : int
    distance : float, metres
        From the place to its surface; 0 inside.
    radius, length : float, metres
    n_points, n_scans : int
        The evidence: rays or points, and scans.
    sigma_offset : float or None, metres
    first_seen_s, last_seen_s : float
    """

    segment: int
    distance: float
    radius: float
    length: float
    n_points: int
    n_scans: int
    sigma_offset: float | None
    first_seen_s: float
    last_seen_s: float


@dataclass(frozen=True)
class NearCandidate:
    """Something near the place that might have been a beam, and what became of it.

    Attributes
    ----------
    distance : float, metres
        From the place to its surface; 0 inside.
    stage, fate, reason, origin : str
    in_pass, candidate, parent, into, segment, n_lines : int or None
    length, radius : float, metres
    n_scans, n_points : int
    score, seen_through, flank_left, flank_right, reduced_chi2, value, limit : float or None
        As in `candidates.parquet`.
    first_seen_s, last_seen_s : float
        From the start of the recording.
    setting : str
        Configuration values that decide; empty if there is none.
    text : str
        A sentence for people.
    """

    distance: float
    stage: str
    fate: str
    reason: str
    origin: str
    in_pass: int | None
    candidate: int | None
    parent: int | None
    into: int | None
    segment: int | None
    n_lines: int | None
    length: float
    radius: float
    n_scans: int
    n_points: int
    score: float | None
    seen_through: float | None
    flank_left: float | None
    flank_right: float | None
    reduced_chi2: float | None
    value: float | None
    limit: float | None
    first_seen_s: float
    last_seen_s: float
    setting: str
    text: str

    @property
    def is_line(self) -> bool:
        """Whether it is lines of scans, which no rays were asked about."""
        return self.stage in {"scan", "leftovers"}

    @property
    def shortfall(self) -> float:
        """How far the value is from its limit, as a share of that; infinite if not known."""
        if self.value is None or self.limit is None:
            return math.inf
        return abs(self.value - self.limit) / max(abs(self.limit), 1e-9)


@dataclass(frozen=True)
class Nearest:
    """The nearest thing that the run knows of.

    Attributes
    ----------
    what : str
    distance : float, metres
    place : tuple of float, metres
        Where it is nearest.
    """

    what: str
    distance: float
    place: tuple[float, float, float]


@dataclass(frozen=True)
class Explanation:
    """What a run tells of a place.

    Attributes
    ----------
    at : tuple of float, metres
        World frame.
    within : float, metres
        What lies no further off is near.
    segments : tuple of NearSegment
        The nearest first.
    candidates : tuple of NearCandidate or None
        In the order in which they were seen and decided; None if the run did not keep them.
    n_scans : int
        Scans of the run.
    n_scans_aimed : int or None
        Those whose window held the place; None where the run does not tell.
    aimed_s : tuple of float or None
        The first and the last of them, from the start of the recording.
    below_floor : bool
        Whether the place lies where returns are not used.
    n_cloud_points : int
        Points of the thinned cloud near the place.
    nearest : Nearest or None
        When nothing is near; None too when the run holds nothing.
    conclusion : str
    """

    at: tuple[float, float, float]
    within: float
    segments: tuple[NearSegment, ...]
    candidates: tuple[NearCandidate, ...] | None
    n_scans: int
    n_scans_aimed: int | None
    aimed_s: tuple[float, float] | None
    below_floor: bool
    n_cloud_points: int
    nearest: Nearest | None
    conclusion: str


def explain(run: Run, at: Sequence[float], within: float) -> Explanation:
    """Tell what a run knows of a place.

    Parameters
    ----------
    run : Run
    at : (3,) sequence of float, metres
        World frame.
    within : float, metres
        What lies no further off is near.

    Returns
    -------
    Explanation

    Raises
    ------
    RunError
        If a file of the run cannot be read.
    MissingExtraError
        If the run kept candidates, and the library to read them is not installed.
    """
    place = np.asarray(at, np.float64)
    segments = _near_segments(run, place, within)
    candidates = _near_candidates(run, place, within)
    looks = _stamps_aimed(run, place)
    cloud = run.structure["cloud"].astype(np.float64)
    n_points = int(np.count_nonzero(np.linalg.norm(cloud - place, axis=1) <= within))
    anything = segments or candidates or n_points
    found: dict[str, Any] = {
        "at": _triple(place),
        "within": within,
        "segments": segments,
        "candidates": candidates,
        "n_scans": len(run.columns["processing_time"]["stamp_ns"]),
        "n_scans_aimed": None if looks is None else len(looks),
        "aimed_s": None if looks is None or not len(looks) else _span(run, looks),
        "below_floor": _is_below_floor(run, place),
        "n_cloud_points": n_points,
        "nearest": None if anything else _nearest(run, place),
    }
    return Explanation(**found, conclusion=" ".join(_conclusion(found)))


def explanation_document(explanation: Explanation) -> dict[str, Any]:
    """Give an explanation as JSON values, with the same keys always.

    Parameters
    ----------
    explanation : Explanation

    Returns
    -------
    dict
    """
    return {"schema_version": SCHEMA_VERSION, **asdict(explanation)}


def _near_segments(run: Run, place: FloatArray, within: float) -> tuple[NearSegment, ...]:
    columns = run.columns["segments"]
    apart = _to_surfaces(place, columns)
    near = [k for k in np.argsort(apart, kind="stable") if apart[k] <= within]
    return tuple(
        NearSegment(
            segment=int(columns["segment"][k]),
            distance=float(apart[k]),
            radius=float(columns["radius"][k]),
            length=float(columns["length"][k]),
            n_points=int(columns["n_points"][k]),
            n_scans=int(columns["n_scans"][k]),
            sigma_offset=_known(columns["sigma_offset"][k]),
            first_seen_s=float(columns["first_seen_s"][k]),
            last_seen_s=float(columns["last_seen_s"][k]),
        )
        for k in near
    )


def _near_candidates(
    run: Run, place: FloatArray, within: float
) -> tuple[NearCandidate, ...] | None:
    """Candidates near a place: scans in time order, then what came of them, pass by pass."""
    columns = run.candidates
    if columns is None:
        return None
    apart = _to_surfaces(place, columns)
    near = [
        _candidate(run, columns, int(k), float(apart[k])) for k in np.flatnonzero(apart <= within)
    ]
    return tuple(sorted(near, key=lambda one: (_rank(one), one.in_pass or 0, one.first_seen_s)))


def _candidate(run: Run, columns: ColumnArrays, k: int, distance: float) -> NearCandidate:
    row = {name: values[k] for name, values in columns.items()}
    reason = REASONS.get(row["reason"])
    numbers = ("candidate", "parent", "into", "segment", "n_lines")
    figures = ("score", "seen_through", "flank_left", "flank_right", "reduced_chi2")
    values: dict[str, Any] = {
        "distance": distance,
        **{name: str(row[name]) for name in ("stage", "fate", "reason", "origin")},
        "in_pass": _number(row["pass"]),
        **{name: _number(row[name]) for name in numbers},
        "length": float(np.linalg.norm([row[f"{c}2"] - row[f"{c}1"] for c in "xyz"])),
        "radius": float(row["radius"]),
        **{name: int(row[name]) for name in ("n_scans", "n_points")},
        **{name: _known(row[name]) for name in (*figures, "value", "limit")},
        "first_seen_s": _seconds(run, int(row["first_stamp_ns"])),
        "last_seen_s": _seconds(run, int(row["last_stamp_ns"])),
        "setting": reason.setting if reason else "",
    }
    return NearCandidate(**values, text=_sentence(values))


def _sentence(row: Mapping[str, Any]) -> str:
    """Say what a candidate was and what became of it."""
    if row["fate"] == "kept":
        return f"{_name(row)} became segment {row['segment']}"
    reason = REASONS.get(row["reason"])
    if reason is None:
        return f"{_name(row)} was refused: {row['reason']}"
    value, limit = (np.nan if row[k] is None else row[k] for k in ("value", "limit"))
    other = "another one" if row["into"] is None else f"candidate {row['into']}"
    other += "" if row["segment"] is None else f" (now segment {row['segment']})"
    return f"{_name(row)}: {reason.tell(value, limit, other)}"


def _name(row: Mapping[str, Any]) -> str:
    """Call a candidate by what it is."""
    if row["stage"] in {"scan", "leftovers"}:
        lines = f"{row['n_lines']} line{'s' if row['n_lines'] != 1 else ''}"
        where = "" if row["stage"] == "scan" else " in what no beam explains"
        best = ", the best of them" if row["n_lines"] != 1 else ""
        return f"{lines}{where}, {row['length']:.2f} m long, refused{best}"
    called = "a candidate" if row["candidate"] is None else f"candidate {row['candidate']}"
    left = ", found in what no beam explained" if row["origin"] == "leftovers" else ""
    split = "" if row["parent"] is None else f", split from candidate {row['parent']}"
    return f"{called} ({row['length']:.2f} m long{left}{split})"


def _conclusion(found: Mapping[str, Any]) -> Iterator[str]:
    """Say in a few sentences what all of it comes to."""
    segments, candidates = found["segments"], found["candidates"]
    others = [one for one in candidates or () if one.fate != "kept"]
    if segments:
        yield from _there(segments, others)
        return
    if others:
        yield "No beam is here."
        yield from _nearly(others)
    elif found["nearest"] is not None or not found["n_cloud_points"]:
        yield from _nothing(found)
    elif candidates is None:
        yield "No beam is here, but something returned rays."
    else:
        yield (
            "No beam is here. Something returned rays, but the search found no line in it: it is "
            "too small, too thin or not straight, or it was left out as floor or wall "
            "(filtering.foreground)."
        )
    if candidates is None:
        yield f"What was refused here, and why, this run did not keep: {_KEEP}."


def _there(segments: Sequence[NearSegment], others: Sequence[NearCandidate]) -> Iterator[str]:
    """Name the beams, and what lay clearly nearer but is none."""
    nearest = segments[0].distance
    if len(segments) == 1:
        away = f", {nearest:.2f} m from the place" if nearest > _CLEARLY_M else ""
        yield f"There is a beam: segment {segments[0].segment}{away}."
    else:
        names = ", ".join(str(one.segment) for one in segments[:_MOST_NAMED])
        more = len(segments) - _MOST_NAMED
        yield f"There are beams: segments {names}{f' and {more} more' if more > 0 else ''}."
    nearer = [one for one in others if one.distance < nearest - _CLEARLY_M and one.segment is None]
    if nearer:
        yield "Nearer to the place there is none."
        yield from _nearly(nearer)


def _nearly(others: Sequence[NearCandidate]) -> Iterator[str]:
    """Name what came nearest to being a beam, and what decided."""
    best = max(others, key=lambda one: (_rank(one), one.score or 0.0, -one.shortfall))
    if best.is_line:
        yield f"{sum(one.n_lines or 0 for one in others)} lines were found, and each was refused."
    yield f"What came nearest to one is {best.text}."
    if best.setting:
        yield f"What decides: {best.setting}."


def _rank(candidate: NearCandidate) -> int:
    """How far a candidate came; a later version may know further stages."""
    return _STAGES.index(candidate.stage) if candidate.stage in _STAGES else len(_STAGES)


def _nothing(found: Mapping[str, Any]) -> Iterator[str]:
    if found["n_scans_aimed"] == 0:
        yield "Nothing was seen here: the place was in the window of no scan (filtering.window)."
    elif found["below_floor"]:
        yield "Nothing is known here: what lies below filtering.floor_trim_height is not used."
    elif found["n_scans_aimed"]:
        yield (
            f"Nothing was seen here: the place was in the window of {found['n_scans_aimed']} "
            "scans, but nothing returned a ray, or it lay outside of the camera's picture or "
            "behind something."
        )
    else:
        yield "Nothing was seen here."
    if (nearest := found["nearest"]) is not None:
        x, y, z = nearest.place
        yield (
            f"The nearest thing is {nearest.what}, {nearest.distance:.2f} m away at "
            f"{x:.2f},{y:.2f},{z:.2f}."
        )


def _nearest(run: Run, place: FloatArray) -> Nearest | None:
    """Find the nearest of beams, of points of the cloud and of where the drone was."""
    found: list[Nearest] = []
    columns = run.columns["segments"]
    if len(columns["segment"]):
        apart, feet = _to_axes(place, columns)
        apart = np.maximum(apart - columns["radius"], 0.0)
        k = int(np.argmin(apart))
        found.append(Nearest(f"segment {columns['segment'][k]}", float(apart[k]), _triple(feet[k])))
    for what, name in (
        ("a point of the cloud", "cloud"),
        ("the drone's trajectory", "trajectory_position"),
    ):
        points = run.structure[name].astype(np.float64)
        if len(points):
            apart = np.linalg.norm(points - place, axis=1)
            k = int(np.argmin(apart))
            found.append(Nearest(what, float(apart[k]), _triple(points[k])))
    return min(found, key=lambda one: one.distance, default=None)


def _stamps_aimed(run: Run, place: FloatArray) -> NDArray[np.int64] | None:
    """Stamps of the scans whose window held a place, by the poses that they were matched to."""
    window = _value(run, "configuration", "filtering", "window")
    offset = _value(run, "recording", "extrinsic", "translation_m")
    turn = _value(run, "recording", "extrinsic", "rotation_matrix")
    poses = run.structure["trajectory_stamp_ns"]
    scans = run.columns["processing_time"]
    if not isinstance(window, dict) or offset is None or turn is None or not len(poses):
        return None
    at = np.clip(np.searchsorted(poses, scans["pose_stamp_ns"]), 0, len(poses) - 1)
    apart = place - run.structure["trajectory_position"][at]
    quaternions = run.structure["trajectory_quaternion_xyzw"][at]
    in_body = np.array(
        [matrix_from_quaternion(q).T @ v for q, v in zip(quaternions, apart, strict=True)]
    ).reshape(-1, 3)
    in_sensor = (in_body - np.asarray(offset)) @ np.asarray(turn)
    limits = np.array([window[axis] for axis in "xyz"], np.float64)
    inside = np.all((in_sensor >= limits[:, 0]) & (in_sensor <= limits[:, 1]), axis=1)
    stamps: NDArray[np.int64] = scans["stamp_ns"][inside]
    return stamps


def _is_below_floor(run: Run, place: FloatArray) -> bool:
    height = _value(run, "configuration", "filtering", "floor_trim_height")
    trim = _value(run, "configuration", "filtering", "floor_trim")
    return height is not None and trim != "none" and float(place[2]) < float(height)


def _value(run: Run, *keys: str) -> Any:
    """Look up an entry of the summary; None where an older version had none."""
    tree: Any = run.summary
    for key in keys:
        tree = tree.get(key) if isinstance(tree, dict) else None
    return tree


def _to_surfaces(place: FloatArray, columns: ColumnArrays) -> FloatArray:
    """Distance of a place from the surface of each row's cylinder, 0 inside."""
    outside: FloatArray = np.maximum(_to_axes(place, columns)[0] - columns["radius"], 0.0)
    return outside


def _to_axes(place: FloatArray, columns: ColumnArrays) -> tuple[FloatArray, FloatArray]:
    """Distance of a place from each row's axis between its ends, and where it is nearest."""
    first, last = (np.stack([columns[f"{c}{k}"] for c in "xyz"], axis=1) for k in (1, 2))
    way = last - first
    squared = np.maximum(np.einsum("ij,ij->i", way, way), 1e-18)
    share = np.clip(np.einsum("ij,ij->i", place - first, way) / squared, 0.0, 1.0)
    feet = first + share[:, None] * way
    return np.linalg.norm(place - feet, axis=1), feet


def _span(run: Run, stamps: NDArray[np.int64]) -> tuple[float, float]:
    return _seconds(run, int(stamps[0])), _seconds(run, int(stamps[-1]))


def _seconds(run: Run, stamp_ns: int) -> float:
    return (stamp_ns - int(run.summary["recording"]["time_origin_ns"])) / 1e9


def _triple(vector: FloatArray) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in vector)
    return x, y, z


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _number(value: float) -> int | None:
    return None if np.isnan(value) else int(value)
