"""When two segments are the same beam: solutions 1 to 3 of the report's section 3.2.6.

Each solution scores one new segment against many known ones at once: the score is the
largest ratio of a distance to its threshold, so that up to 1 they are similar and the
lowest is the best match.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from beamseg_batch.config import FilteringConfig, StructureConfig, ThresholdConfig
from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import Segment
from beamseg_batch.structure.arrays import SegmentArrays
from beamseg_batch.structure.axis_kernels import axes_to_ends, ends_to_axes

__all__ = [
    "Similarity",
    "midpoint_scores",
    "parameter_scores",
    "projection_epsilon",
    "projection_scores",
    "reverse_projection_scores",
    "similarity_by",
]


Scores = Callable[[Segment, SegmentArrays], FloatArray]
"""Scores of one segment against known ones; up to 1 is similar, infinite never."""


@dataclass(frozen=True)
class Similarity:
    """A similarity solution, asked both ways.

    Attributes
    ----------
    scores : callable
        Score of a new segment against each known one.
    reverse_scores : callable
        Score of each known segment as if it were new, against the one given.
    """

    scores: Scores
    reverse_scores: Scores


def parameter_scores(new: Segment, known: SegmentArrays, limits: ThresholdConfig) -> FloatArray:
    """Score by anchor, direction and midpoint: solution 1.

    Parameters
    ----------
    new : Segment
    known : SegmentArrays
    limits : ThresholdConfig
        ``T_a``, ``T_b`` and ``T_p`` are used.

    Returns
    -------
    (N,) float64

    Notes
    -----
    ``|a2 - a1| <= T_a``, ``|b2 - b1| <= T_b``, ``|p2 - p1| <= T_p``. A beam has no front,
    so the nearer of ``b`` and ``-b`` counts.
    """
    anchor = np.linalg.norm(known.anchors - new.anchor, axis=1)
    same = np.linalg.norm(known.directions - new.direction, axis=1)
    opposite = np.linalg.norm(known.directions + new.direction, axis=1)
    middle = np.linalg.norm(known.midpoints - new.midpoint, axis=1)
    ratios = [anchor / limits.T_a, np.minimum(same, opposite) / limits.T_b, middle / limits.T_p]
    scores: FloatArray = np.max(ratios, axis=0)
    return scores


def midpoint_scores(new: Segment, known: SegmentArrays, limits: ThresholdConfig) -> FloatArray:
    """Score by direction and midpoint: solution 2.

    Parameters
    ----------
    new : Segment
    known : SegmentArrays
    limits : ThresholdConfig
        ``T_d`` and ``T_p`` are used.

    Returns
    -------
    (N,) float64

    Notes
    -----
    ``b1 . b2 >= T_d`` and ``|p2 - p1| <= T_p``; the sign of the product does not matter.
    """
    cosine = np.abs(known.directions @ new.direction)
    middle = np.linalg.norm(known.midpoints - new.midpoint, axis=1)
    return np.where(cosine >= limits.T_d, middle / limits.T_p, np.inf)


def projection_epsilon(radius: float, limits: ThresholdConfig, diag_voxel: float) -> float:
    """Largest distance of an end from the other axis, for two segments of one radius.

    Parameters
    ----------
    radius : float, metres
    limits : ThresholdConfig
        ``epsilon`` is used when it is set.
    diag_voxel : float, metres
        For that radius.

    Returns
    -------
    float, metres

    Notes
    -----
    ``epsilon = 2 * diag_voxel + r1 + r2``, solution 3 of the report's section 3.2.6.
    """
    return limits.epsilon or 2.0 * diag_voxel + 2.0 * radius


def projection_scores(
    new: Segment, known: SegmentArrays, limits: ThresholdConfig, diag_voxel: float
) -> FloatArray:
    """Score by the distances of the new ends from the known axes: solution 3.

    Parameters
    ----------
    new : Segment
    known : SegmentArrays
    limits : ThresholdConfig
        ``epsilon`` is used when it is set.
    diag_voxel : float, metres
        For the new segment's radius.

    Returns
    -------
    (N,) float64

    Notes
    -----
    ``epsilon = 2 * diag_voxel + r1 + r2``, and the radii are identical.
    """
    furthest = ends_to_axes(known.rows, new.end_1, new.end_2)
    return _projection_ratio(furthest, new, known, limits, diag_voxel)


def reverse_projection_scores(
    segment: Segment, known: SegmentArrays, limits: ThresholdConfig, diag_voxel: float
) -> FloatArray:
    """Score by the distances of the known ends from one axis: solution 3, turned round.

    Parameters
    ----------
    segment : Segment
    known : SegmentArrays
    limits : ThresholdConfig
    diag_voxel : float, metres

    Returns
    -------
    (N,) float64
        As `projection_scores` would give it for each known segment against this one.
    """
    furthest = axes_to_ends(known.rows, segment.anchor, segment.direction)
    return _projection_ratio(furthest, segment, known, limits, diag_voxel)


def _projection_ratio(
    furthest: FloatArray,
    segment: Segment,
    known: SegmentArrays,
    limits: ThresholdConfig,
    diag_voxel: float,
) -> FloatArray:
    # The radii are identical where it matters, so one threshold serves all.
    furthest /= projection_epsilon(segment.radius, limits, diag_voxel)
    furthest[known.radii != segment.radius] = np.inf
    return furthest


def similarity_by(structure: StructureConfig, filtering: FilteringConfig) -> Similarity:
    """Choose the similarity solution that the configuration names.

    Parameters
    ----------
    structure : StructureConfig
    filtering : FilteringConfig

    Returns
    -------
    Similarity
    """
    limits = structure.thresholds
    diag = filtering.diag_voxel
    if structure.similarity == "projection":
        return Similarity(
            lambda new, known: projection_scores(new, known, limits, diag(new.radius)),
            lambda one, known: reverse_projection_scores(one, known, limits, diag(one.radius)),
        )
    # The other two solutions treat both segments alike.
    alike = parameter_scores if structure.similarity == "parameters" else midpoint_scores
    return Similarity(
        lambda new, known: alike(new, known, limits), lambda one, known: alike(one, known, limits)
    )
