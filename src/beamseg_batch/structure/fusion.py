"""How two segments of one beam become one: solutions 1 and 2 of section 3.2.6."""

from __future__ import annotations

from beamseg_batch.config import StructureConfig
from beamseg_batch.model import Segment
from beamseg_batch.structure.axis_kernels import blend_axes

__all__ = ["fuse", "fusion_coefficient", "point_weight"]


def point_weight(n_known: int, n_new: int, min_weight: float) -> float:
    """Weight ``w`` of the new segment by the number of its points.

    Parameters
    ----------
    n_known, n_new : int
        Points of the two segments.
    min_weight : float
        ``w_min``: new information is never weighted less than this.

    Returns
    -------
    float, 0 to 1

    Notes
    -----
    ``w = max(n2 / (n1 + n2), w_min)`` as a real number.
    """
    return max(n_new / (n_known + n_new), min_weight)


def fusion_coefficient(known: Segment, new: Segment, weight: float) -> float:
    """Share ``f`` of the new segment in the fused axis.

    Parameters
    ----------
    known, new : Segment
    weight : float
        ``w`` of `point_weight`.

    Returns
    -------
    float, 0 to 1

    Notes
    -----
    ``f = pca_coeff2 w / (pca_coeff1 (1 - w) + pca_coeff2 w)``. Two segments without any
    extent have no coefficient; their points alone decide then.
    """
    total = known.pca_coeff * (1.0 - weight) + new.pca_coeff * weight
    return new.pca_coeff * weight / total if total > 0.0 else weight


def fuse(known: Segment, new: Segment, config: StructureConfig) -> Segment | None:
    """Fuse a new segment into a known one.

    Parameters
    ----------
    known, new : Segment
        World frame; found similar.
    config : StructureConfig
        ``fusion`` and ``min_weight`` are used.

    Returns
    -------
    Segment or None
        None when the two do not overlap along the fused axis, and so stay two.

    Notes
    -----
    With ``q = proj1(e2)``, the new ends' feet on the known axis, and the share ``f`` (one
    half for the mean segment)::

        a = q1 + f (e1 - q1)
        b = (q2 - q1) + f ((e2 - q2) - (e1 - q1))

    The direction is normalised, and the ends are the outermost of the four ends projected
    onto the new axis. The points are dropped: their number, span and variance are kept.
    Scans add up, too: whether two sightings are of one scan, the structure knows.
    """
    weight = point_weight(known.n_points, new.n_points, config.min_weight)
    share = 0.5 if config.fusion == "mean" else fusion_coefficient(known, new, weight)
    overlaps, anchor, direction, t_min, t_max = blend_axes(
        known.anchor, known.direction, known.end_1, known.end_2, new.end_1, new.end_2, share
    )
    if not overlaps:
        return None
    return Segment(
        anchor=anchor,
        direction=direction,
        t_min=t_min,
        t_max=t_max,
        radius=known.radius,
        n_points=known.n_points + new.n_points,
        pca_coeff=known.pca_coeff * (1.0 - weight) + new.pca_coeff * weight,
        pca_eig=known.pca_eig * (1.0 - weight) + new.pca_eig * weight,
        n_scans=known.n_scans + new.n_scans,
        first_seen_ns=min(known.first_seen_ns, new.first_seen_ns),
        last_seen_ns=max(known.last_seen_ns, new.last_seen_ns),
    )
