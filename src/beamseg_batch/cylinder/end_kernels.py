"""Kernel that asks the rays near the ends of beams where these ends are.

A beam's own flat cap counts here: a ray that comes from beyond an end meets the cap, which
lies deeper than the endless cylinder, and seen so it tells where the end is.
"""

from __future__ import annotations

import numpy as np

from beamseg_batch.accelerate import kernel
from beamseg_batch.cylinder.evidence_kernels import gain
from beamseg_batch.cylinder.meeting_kernels import (
    Cylinders,
    Meetings,
    View,
    forget,
    local_axis,
    meet,
    rivals,
    sight,
)
from beamseg_batch.cylinder.ray_kernels import enter_cylinder, finite_depth
from beamseg_batch.geometry import FloatArray

__all__ = ["gather_ends"]


@kernel
def gather_ends(
    view: View,
    beams: Cylinders,
    places: FloatArray,
    likelihood: FloatArray,
    background: float,
    meetings: Meetings,
) -> None:
    """Add what a scan says about where beams end.

    Parameters
    ----------
    view : View
    beams : Cylinders
    places : (N,) float64, metres
        Where an end could be, along the axis from where it is thought to be; increasing.
    likelihood : (M, 2, N) float64
        Added to: log-likelihood ratio of a beam with its first or last end there.
    background : float
        Cost of a return that no beam explains, as half a squared residual.
    meetings : Meetings
        Scratch.
    """
    touched = meet(view, beams, meetings, False)
    points, rays, ranks, limits = view.points, view.rays, beams.ranks, beams.limits
    head, chain, who, nearest = meetings.head, meetings.chain, meetings.who, meetings.nearest
    sides, entries = meetings.side, meetings.entry
    for number in range(touched):
        k = meetings.pixels[number]
        wx, wy, wz, depth = sight(points, rays, k)
        this = meetings.head[k]
        while this >= 0:
            j, s = meetings.who[this], meetings.along[this]
            first, last = beams.firsts[j], beams.lasts[j]
            near_first, near_last = s < first + places[-1], s > last + places[0]
            if near_first or near_last:
                a, b, bow = beams.anchors[j], beams.directions[j], beams.bows[j]
                ax, ay, az, bx, by, bz = a[0], a[1], a[2], b[0], b[1], b[2]
                from_s, stretch = 0.0, 1.0
                if bow[0] != 0.0 or bow[1] != 0.0 or bow[2] != 0.0:
                    from_s = s
                    ax, ay, az, bx, by, bz, stretch = local_axis(a, b, bow, first, last, s)
                entry, leave, at, _ = enter_cylinder(
                    wx, wy, wz, ax, ay, az, bx, by, bz, beams.radii[j]
                )
                wb = wx * bx + wy * by + wz * bz
                ab = ax * bx + ay * by + az * bz
                sigma, side = meetings.sigma[this], meetings.side[this]
                before, best, _ = rivals(
                    ranks, limits[j], head[k], this, chain, who, nearest, sides, entries,
                    entry, depth, sigma,
                )  # fmt: skip
                for which in range(2):
                    if not (near_last if which else near_first):
                        continue
                    for place in range(len(places)):
                        begin = first if which else first + places[place]
                        end = last + places[place] if which else last
                        own = finite_depth(
                            entry, leave, at, wb, ab,
                            (begin - from_s) * stretch, (end - from_s) * stretch,
                        )  # fmt: skip
                        if own < np.inf:
                            likelihood[j, which, place] += gain(
                                (depth - own) / sigma, own >= before, best, side, background
                            )
            this = meetings.chain[this]
    forget(meetings, touched)
