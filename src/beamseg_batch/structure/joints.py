"""Joints: intersections that are one place, and the point closest to all axes there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.geometry import FloatArray, clusters, line_parameters
from beamseg_batch.model import Intersection, Joint, Segment

__all__ = ["joints_of"]

_USUAL_MISS = 0.1
"""How far two axes of a joint miss one another, of the sum of their radii, if not known."""
_SIGMAS = 3.0
_LEAST_M = 1e-6  # below which no axis is known, whatever its covariance says


def joints_of(
    segments: Sequence[Segment], intersections: Sequence[Intersection]
) -> tuple[tuple[Joint, ...], tuple[Intersection, ...]]:
    """Unite the intersections that are one place.

    Parameters
    ----------
    segments : sequence of Segment
        World frame.
    intersections : sequence of Intersection
        Of these segments.

    Returns
    -------
    tuple of Joint
        Ordered by their segments.
    tuple of Intersection
        The same intersections in the same order, each with the index of its joint.

    Notes
    -----
    Two places are one when they lie within the sum of the radii of two beams that meet
    there; the closest are united first, and what is united lies in their mean. So a node of
    many beams becomes one joint however its pairs scatter, while a chain of bracings along a
    leg does not: its ends lie further from the mean than that.

    Where axes meet at a flat angle, an error across them moves the place along them by that
    error divided by the sine of the angle. Such a place weighs less in the mean, and may lie
    as far away as that.
    """
    groups = _groups(segments, intersections)
    made = [_joint(segments, [intersections[k] for k in group]) for group in groups]
    order = sorted(range(len(made)), key=lambda j: (made[j].segments, made[j].t))
    joint_of = {k: number for number, j in enumerate(order) for k in groups[j]}
    numbered = (replace(one, joint=joint_of[k]) for k, one in enumerate(intersections))
    return tuple(made[j] for j in order), tuple(numbered)


def _groups(
    segments: Sequence[Segment], intersections: Sequence[Intersection]
) -> list[NDArray[np.int64]]:
    """Intersections of each joint, by index."""
    places = np.array([one.position for one in intersections]).reshape(-1, 3)
    reaches = np.array(
        [segments[one.segment_1].radius + segments[one.segment_2].radius for one in intersections]
    )
    spreads = np.array([_spread(segments, one) for one in intersections])
    # What cannot hang together need not be compared: a structure has many joints.
    parts = clusters(places, np.maximum(reaches, np.sqrt(2.0) * spreads))
    return [
        part[group]
        for part in parts
        for group in _united(places[part], reaches[part], spreads[part])
    ]


def _spread(segments: Sequence[Segment], one: Intersection) -> float:
    """How far along the axes an intersection may be from where they truly meet, metres."""
    first, second = segments[one.segment_1], segments[one.segment_2]
    variance = np.trace(first.covariance_at(one.t_1) + second.covariance_at(one.t_2))
    known = np.isfinite(variance)
    usual = _USUAL_MISS * (first.radius + second.radius)
    miss = _SIGMAS * float(np.sqrt(variance)) if known else usual
    return max(miss, _LEAST_M) / float(np.sin(np.radians(one.angle_deg)))


def _united(
    places: FloatArray, reaches: FloatArray, spreads: FloatArray
) -> list[NDArray[np.int64]]:
    """Group places, the closest first.

    Parameters
    ----------
    places : (N, 3) float64, metres
    reaches, spreads : (N,) float64, metres
        How far others of the same group may be, and how well each is known.

    Returns
    -------
    list of (K,) int64
        Indices of each group, ascending, in order of their first.
    """
    groups = _Groups(places, reaches, spreads)
    while groups.unite_closest():
        pass
    return [np.array(sorted(members)) for members in groups.members if members]


class _Groups:
    """Groups of places, each of which remembers the closest other one.

    So time and memory are those of a row of distances at a time, not of all pairs.
    """

    def __init__(self, places: FloatArray, reaches: FloatArray, spreads: FloatArray) -> None:
        self.members = [[k] for k in range(len(places))]
        self._centres, self._reaches = places.copy(), reaches.copy()
        self._weights = spreads**-2.0
        self._gone = np.zeros(len(places), dtype=np.bool_)
        self._closest = np.zeros(len(places), dtype=np.int64)
        self._apart = np.full(len(places), np.inf)
        for k in range(len(places)):
            self._look_around(k)

    def unite_closest(self) -> bool:
        """Unite the two closest groups, unless none are close enough."""
        one = int(self._apart.argmin())
        if not self._apart[one] <= 1.0:
            return False
        keep, drop = sorted((one, int(self._closest[one])))
        self._merge(keep, drop)
        looking = np.isin(self._closest, (keep, drop)) & ~self._gone
        row = self._look_around(keep)
        closer = row < self._apart
        self._closest[closer], self._apart[closer] = keep, row[closer]
        for k in np.flatnonzero(looking & ~closer).tolist():
            self._look_around(k)
        return True

    def _merge(self, keep: int, drop: int) -> None:
        weight = self._weights[keep] + self._weights[drop]
        share = self._weights[drop] / weight
        self._centres[keep] += share * (self._centres[drop] - self._centres[keep])
        self._reaches[keep] = max(self._reaches[keep], self._reaches[drop])
        self._weights[keep] = weight
        self.members[keep] += self.members[drop]
        self.members[drop] = []
        self._gone[drop], self._apart[drop] = True, np.inf

    def _look_around(self, k: int) -> FloatArray:
        """Distances of all groups from one, as shares of what they may be; note the closest."""
        reaches = np.maximum(self._reaches, self._reaches[k])
        spreads = np.sqrt(1.0 / self._weights + 1.0 / self._weights[k])
        row: FloatArray = np.linalg.norm(self._centres - self._centres[k], axis=1)
        row /= np.maximum(reaches, spreads)
        row[self._gone], row[k] = np.inf, np.inf
        self._closest[k] = row.argmin()
        self._apart[k] = row[self._closest[k]]
        return row


def _joint(segments: Sequence[Segment], touching: Sequence[Intersection]) -> Joint:
    """Put a joint to the point closest to all its axes.

    Notes
    -----
    Weighted least squares of the distances across the axes. Beams need not truly meet in a
    point: what their axes miss it by beyond their covariances is a variance that is added to
    each of these, so that where they do not meet all count alike.
    """
    numbers = sorted({k for one in touching for k in (one.segment_1, one.segment_2)})
    guess = np.mean([one.position for one in touching], axis=0)
    beams = [segments[k].tangent(_parameter(segments[k], guess)) for k in numbers]
    feet = np.array([beam.anchor + _parameter(beam, guess) * beam.direction for beam in beams])
    directions = np.array([beam.direction for beam in beams])
    across = np.linalg.svd(directions[:, None])[2][:, 1:]  # what is normal to each
    covariances = across @ [b.covariance_at(_parameter(b, guess)) for b in beams]
    covariances = covariances @ across.transpose(0, 2, 1)
    position, covariance = _meeting_point(feet, across, covariances)
    return Joint(
        position=position,
        covariance=covariance,
        residual=float(np.sqrt(_squared_distances(position, feet, across).mean())),
        segments=tuple(numbers),
        t=tuple(_parameter(beam, position) for beam in beams),
    )


def _meeting_point(
    feet: FloatArray, across: FloatArray, covariances: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Point closest to axes, and its covariance.

    Parameters
    ----------
    feet : (N, 3) float64, metres
        A point of each axis.
    across : (N, 2, 3) float64
        Unit vectors normal to each axis and to one another.
    covariances : (N, 2, 2) float64, square metres
        Of each axis there, along them; NaN where it is not known.

    Returns
    -------
    (3,) float64, metres
    (3, 3) float64, square metres; NaN where one of the axes is not known
    """
    alike = np.broadcast_to(np.eye(2), covariances.shape)
    position, _ = _closest_point(feet, across, alike)
    if not np.isfinite(covariances).all():
        return position, np.full((3, 3), np.nan)
    missed = _squared_distances(position, feet, across).sum() / (2 * len(feet) - 3)
    expected = 0.5 * np.trace(covariances, axis1=1, axis2=2).mean()
    excess = max(missed - expected, _LEAST_M**2)
    return _closest_point(feet, across, np.linalg.inv(covariances + excess * np.eye(2)))


def _closest_point(
    feet: FloatArray, across: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Point closest to axes, given the (N, 2, 2) inverse covariance of each, and its covariance."""
    information = across.transpose(0, 2, 1) @ weights @ across
    covariance = np.linalg.pinv(information.sum(axis=0), hermitian=True)
    middle = feet.mean(axis=0)  # differences are small, so the sums lose no digits
    pull = np.einsum("nij,nj->i", information, feet - middle)
    return middle + covariance @ pull, covariance


def _squared_distances(point: FloatArray, feet: FloatArray, across: FloatArray) -> FloatArray:
    """Squared distance of a point to each line: (N,) float64."""
    distances = np.einsum("nij,nj->ni", across, point - feet)
    squares: FloatArray = (distances**2).sum(axis=1)
    return squares


def _parameter(beam: Segment, point: FloatArray) -> float:
    """Where on the axis of a beam the foot of a point is, metres."""
    return float(line_parameters(point[None], beam.anchor, beam.direction)[0])
