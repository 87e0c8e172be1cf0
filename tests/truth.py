"""Found beams against true ones, by the rules of the project's goals.

A segment may be a beam when the mean perpendicular distance over their overlap is at most
0.15 m, the angle at most 15 degrees and the overlap at least 30 % of the shorter of the two.
The assignment is one-to-one, nearest pairs first.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

MAX_OFFSET_M = 0.15
MAX_ANGLE_DEG = 15.0
MIN_OVERLAP = 0.3
SAMPLES = 101


@dataclass(frozen=True)
class Match:
    """A true beam and the segment that was found for it, with how well they agree."""

    beam: int
    segment: int
    offset_m: float
    angle_deg: float
    overlap: float


def ends_of(table: pd.DataFrame) -> NDArray[np.float64]:
    """Ends of beams out of columns ``x1 … z2``, as (N, 2, 3) metres."""
    return table[["x1", "y1", "z1", "x2", "y2", "z2"]].to_numpy(float).reshape(-1, 2, 3)


def read_beams(path: Path) -> NDArray[np.float64]:
    """Read true beams, as (N, 2, 3) metres."""
    return ends_of(pd.read_csv(path))


def read_joints(path: Path) -> NDArray[np.float64]:
    """Read where true beams meet, as (N, 3) metres."""
    return pd.read_csv(path)[["x", "y", "z"]].to_numpy(float)


def compare(beam: NDArray[np.float64], segment: NDArray[np.float64]) -> tuple[float, float, float]:
    """Compare two pairs of ends.

    Returns
    -------
    offset_m, angle_deg, overlap : float
        The mean distance of the segment from the beam's axis where they lie side by side,
        the angle between them, and that part's length relative to the shorter of the two.
    """
    length, direction = _length_and_direction(beam)
    other_length, other_direction = _length_and_direction(segment)
    cosine = abs(float(direction @ other_direction))
    points = segment[0] + np.linspace(0.0, 1.0, SAMPLES)[:, None] * (segment[1] - segment[0])
    along = (points - beam[0]) @ direction
    beside = (along >= 0.0) & (along <= length)
    overlap = beside.mean() * other_length / min(length, other_length)
    distances = np.linalg.norm(points - beam[0] - along[:, None] * direction, axis=1)
    offset = float(distances[beside].mean()) if beside.any() else np.inf
    return offset, float(np.degrees(np.arccos(min(cosine, 1.0)))), float(overlap)


def match_beams(beams: NDArray[np.float64], segments: NDArray[np.float64]) -> list[Match]:
    """Assign segments to beams, both (N, 2, 3) metres, in order of the beams."""
    pairs = [
        Match(i, j, *compare(beam, segment))
        for i, beam in enumerate(beams)
        for j, segment in enumerate(segments)
    ]
    matches: dict[int, Match] = {}
    taken: set[int] = set()
    for pair in sorted(pairs, key=lambda pair: pair.offset_m):
        if _may_match(pair) and pair.beam not in matches and pair.segment not in taken:
            matches[pair.beam] = pair
            taken.add(pair.segment)
    return [matches[beam] for beam in sorted(matches)]


def _may_match(pair: Match) -> bool:
    return (
        pair.offset_m <= MAX_OFFSET_M
        and pair.angle_deg <= MAX_ANGLE_DEG
        and pair.overlap >= MIN_OVERLAP
    )


def _length_and_direction(ends: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    span = ends[1] - ends[0]
    length = float(np.linalg.norm(span))
    return length, span / length
