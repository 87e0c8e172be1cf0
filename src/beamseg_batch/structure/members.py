"""Members: segments cut at their joints."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from beamseg_batch.model import Joint, Member, Segment

__all__ = ["members_of"]


def members_of(
    segments: Sequence[Segment], joints: Sequence[Joint], end_slack: float = 0.0
) -> tuple[Member, ...]:
    """Cut segments at their joints.

    Parameters
    ----------
    segments : sequence of Segment
    joints : sequence of Joint
        Of these segments.
    end_slack : float, metres
        How far from an end a joint is at least taken for the end's own.

    Returns
    -------
    tuple of Member
        Ordered by segment, then along it. Those of a segment reach from its one end to its
        other without a gap.

    Notes
    -----
    A joint within the radius of the segment and the thickest other beam of an end is at that
    end, so that no stub is left over where a beam goes a little further than the axis that
    it meets; nor is one left between two joints side by side.
    """
    stations: list[list[_Station]] = [[] for _ in segments]
    for number, joint in enumerate(joints):
        for k, t in zip(joint.segments, joint.t, strict=True):
            thickest = max(segments[j].radius for j in joint.segments if j != k)
            reach = max(segments[k].radius + thickest, end_slack)
            stations[k].append(_Station(t, number, reach))
    return tuple(
        Member(index, one.t, other.t, one.joint, other.joint)
        for index, segment in enumerate(segments)
        for one, other in pairwise(_cuts(segment, sorted(stations[index])))
    )


class _Station(NamedTuple):
    """A joint, or none, on a segment: where, which, and how far it reaches along."""

    t: float
    joint: int | None
    reach: float = 0.0


def _cuts(segment: Segment, stations: list[_Station]) -> list[_Station]:
    """Both ends of a segment, and what cuts it between them, in order."""
    middle = 0.5 * (segment.t_min + segment.t_max)
    first, last = _Station(segment.t_min, None), _Station(segment.t_max, None)
    if stations and stations[0].t <= min(segment.t_min + stations[0].reach, middle):
        first = first._replace(joint=stations.pop(0).joint)
    if stations and stations[-1].t >= max(segment.t_max - stations[-1].reach, middle):
        last = last._replace(joint=stations.pop().joint)
    cuts = [first]
    for station in stations:
        if cuts[-1].t + segment.radius <= station.t <= segment.t_max - segment.radius:
            cuts.append(station)
    return [*cuts, last]
