"""A slow second way to find what a ray hits: walking along it by the distance to the surface.

The distance fields are written from what a shape is (a polygon drawn along a curve), not
from the solids that the simulator makes of it.
"""

from __future__ import annotations

import numpy as np


def outline(section):
    """Corners of a section in order, (N, 2), about its centre of area."""
    w, h, web, flange = section.width, section.height, section.web, section.flange
    u, v = w / 2, h / 2
    corners = {
        "square": [(-u, -v), (u, -v), (u, v), (-u, v)],
        "i": [
            (-u, -v), (u, -v), (u, -v + flange), (web / 2, -v + flange), (web / 2, v - flange),
            (u, v - flange), (u, v), (-u, v), (-u, v - flange), (-web / 2, v - flange),
            (-web / 2, -v + flange), (-u, -v + flange),
        ],
        "c": [
            (-u, -v), (u, -v), (u, -v + flange), (-u + web, -v + flange), (-u + web, v - flange),
            (u, v - flange), (u, v), (-u, v),
        ],
        "l": [(-u, -v), (u, -v), (u, -v + flange), (-u + web, -v + flange), (-u + web, v), (-u, v)],
    }[section.shape]  # fmt: skip
    corners = np.array(corners)
    return corners - centroid(corners)


def centroid(corners):
    """Centre of area of a polygon (the shoelace formula)."""
    following = np.roll(corners, -1, axis=0)
    cross = corners[:, 0] * following[:, 1] - following[:, 0] * corners[:, 1]
    return ((corners + following) * cross[:, None]).sum(axis=0) / (3 * cross.sum())


def to_polygon(points, corners):
    """Distance of points (N, 2) to a polygon, negative inside."""
    a, following = corners, np.roll(corners, -1, axis=0)
    side, from_a = following - a, points[:, None] - a
    share = np.clip((from_a * side).sum(axis=2) / (side**2).sum(axis=1), 0, 1)
    nearest = np.linalg.norm(from_a - share[..., None] * side, axis=2).min(axis=1)
    y = points[:, 1:]
    crosses = (a[:, 1] > y) != (following[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        x = a[:, 0] + (y - a[:, 1]) / side[:, 1] * side[:, 0]
        beyond = crosses & (points[:, :1] < x)
    inside = beyond.sum(axis=1) % 2 == 1
    return np.where(inside, -nearest, nearest)


def to_member(points, member):
    """Distance of points (N, 3) to the surface of a member, negative inside."""
    u, v, w = ((points - member.start) @ member.rotation).T
    length, bow = member.length, member.bow

    def axis(s):
        """How far the parabola lies from the chord, and its slope."""
        return 4 * bow * s * (length - s) / length**2, 4 * bow * (length - 2 * s) / length**2

    s = np.clip(w, 0, length)
    for _ in range(8 if bow else 0):  # the nearest point of the parabola, by Newton's method
        height, slope = axis(s)
        off = v - height
        s = s - ((s - w) - off * slope) / (1 + slope**2 + off * 8 * bow / length**2)
        s = np.clip(s, 0, length)
    height, slope = axis(s)
    across = ((v - height) - slope * (w - s)) / np.hypot(1, slope)
    along = ((w - s) + slope * (v - height)) / np.hypot(1, slope)  # 0 except beyond the ends
    if member.section.shape == "round":
        beside = np.hypot(u, across) - member.section.radius
    else:
        beside = to_polygon(np.column_stack([u, across]), outline(member.section))
    inside = -np.minimum(s, length - s)
    beyond = np.where(s <= 0, -along, np.where(s >= length, along, inside))
    outside = np.hypot(np.maximum(beside, 0), np.maximum(beyond, 0))
    return outside + np.minimum(np.maximum(beside, beyond), 0)


def walk(distance, origin, rays, farthest=2.5, steps=300):
    """How far along unit rays (N, 3) the surface lies, infinite where they miss it.

    Returns
    -------
    ranges, closest : (N,)
        The second is the least distance to the surface on the way.
    """
    ranges, closest = np.zeros(len(rays)), np.full(len(rays), np.inf)
    active = np.ones(len(rays), dtype=bool)
    for _ in range(steps):
        d = distance(origin + ranges[active, None] * rays[active])
        closest[active] = np.minimum(closest[active], d)
        ranges[active] += d
        still = (d > 1e-7) & (ranges[active] < farthest)
        active[np.flatnonzero(active)[~still]] = False
        if not active.any():
            break
    ranges[closest > 1e-6] = np.inf
    return ranges, closest
