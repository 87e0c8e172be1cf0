"""Worlds as they are outside of a laboratory: clutter, walls, several radii and shapes."""

from __future__ import annotations

from typing import Any

import numpy as np

from beamseg_batch.geometry import FloatArray

World = dict[str, Any]
Random = np.random.Generator
Axis = tuple[FloatArray, FloatArray]

__all__ = ["clutters", "clutters_4cm", "clutters_voxl", "mixed", "radii_3", "thicket_cluttered",
           "tower_cluttered", "tower_voxl"]  # fmt: skip

VOXL = "voxl_tof"
_RADII = (0.03, 0.05, 0.1)


def clutters(rng: Random) -> World:
    """No beam: floor, walls, boards, boxes and balls, turned at random."""
    things: list[World] = _walls(2.1)
    boards = [[_between(rng, 0.6, 1.2), _between(rng, 0.8, 1.5)] for _ in range(2)]
    boxes = [[_between(rng, 0.2, 0.7) for _ in range(3)] for _ in range(3)]
    things += [_thing(rng, "plane", size) for size in boards]
    things += [_thing(rng, "box", size) for size in boxes]
    things.append(_thing(rng, "box", [_between(rng, 0.4, 0.8), _between(rng, 0.03, 0.08), 0.6]))
    for _ in range(2):
        centre = [_between(rng, -0.5, 0.5), _between(rng, -0.5, 0.5), _between(rng, 0.5, 2.0)]
        things.append({"sphere": {"centre": centre, "radius": _between(rng, 0.1, 0.3)}})
    return {"floor": {"size": [6, 6]}, "clutter": things, "flight": _spiral(1.5)}


def clutters_4cm(rng: Random) -> World:
    """The same, seen by a noisy camera."""
    return clutters(rng)


def clutters_voxl(rng: Random) -> World:
    """The same, seen by a camera of more pixels that has the flaws of a real one."""
    return {**clutters(rng), "sensor": VOXL}


def thicket_cluttered(rng: Random) -> World:
    """Members anywhere among walls and boxes."""
    axes = _axes(rng, 7)
    members = [_member(f"member {n}", axis, radius=0.05) for n, axis in enumerate(axes)]
    return _furnished(rng, members, axes)


def radii_3(rng: Random) -> World:
    """Members of three radii."""
    axes = _axes(rng, 7)
    radii = rng.permutation([*_RADII, *_RADII, 0.05])
    members = [
        _member(f"member {n}", axis, radius=float(radius))
        for n, (axis, radius) in enumerate(zip(axes, radii, strict=True))
    ]
    return {"members": members, "flight": _spiral(1.5)}


def mixed(rng: Random) -> World:
    """Three radii, I and square sections, floor, wall and boxes, seen by a realistic camera."""
    axes = _axes(rng, 8)
    kinds: list[World] = [{"radius": radius} for radius in (*_RADII, *_RADII)]
    for shape in ("i", "square"):
        width, thick = _between(rng, 0.08, 0.12), _between(rng, 0.006, 0.01)
        section = {"shape": shape, "width": width, "web": thick, "flange": thick, "height": width}
        kinds.append({**section, "roll_deg": _between(rng, 0.0, 360.0)})
    members = [
        _member(f"member {n}", axis, **kinds[k])
        for n, (axis, k) in enumerate(zip(axes, rng.permutation(len(kinds)), strict=True))
    ]
    return {**_furnished(rng, members, axes), "sensor": VOXL}


def tower_voxl(rng: Random) -> World:
    """A lattice tower of two storeys, seen by a realistic camera."""
    kind = {
        "height": _between(rng, 2.0, 2.5),
        "base": _between(rng, 1.1, 1.4),
        "top": _between(rng, 0.7, 1.0),
        "panels": 2,
    }
    flight = {**_spiral(1.8), "heights": [0.5, 2.6]}
    return {"generate": [{"lattice_tower": kind}], "flight": flight, "sensor": VOXL}


def tower_cluttered(rng: Random) -> World:
    """A lattice tower among walls and boxes."""
    world = tower_voxl(rng)
    del world["sensor"]
    things = [*_walls(3.0), *(_thing(rng, "box", [0.4, 0.3, 0.5], away=1.3) for _ in range(3))]
    return {**world, "floor": {"size": [8, 8]}, "clutter": things}


def _furnished(rng: Random, members: list[World], axes: list[Axis]) -> World:
    """Members with floor, walls, and boxes and a ball that touch none of them."""
    things = _walls(2.1)
    while len(things) < 6:
        place = rng.uniform([-0.8, -0.8, 0.3], [0.8, 0.8, 2.2])
        if min(_apart((place, place), axis) for axis in axes) < 0.45:
            continue
        size = [_between(rng, 0.15, 0.35) for _ in range(3)]
        if len(things) < 5:
            things.append(_thing(rng, "box", size, place))
        else:
            centre = [round(float(x), 3) for x in place]
            things.append({"sphere": {"centre": centre, "radius": _between(rng, 0.1, 0.2)}})
    return {
        "members": members, "floor": {"size": [6, 6]}, "clutter": things, "flight": _spiral(1.5),
    }  # fmt: skip


def _axes(rng: Random, count: int) -> list[Axis]:
    """Axes anywhere, no two nearer than 0.3 m."""
    axes: list[Axis] = []
    while len(axes) < count:
        middle = rng.uniform([-0.6, -0.6, 0.9], [0.6, 0.6, 2.2])
        way = rng.normal(size=3)
        way *= rng.uniform(0.35, 0.7) / np.linalg.norm(way)
        axis = (middle - way, middle + way)
        if min(axis[0][2], axis[1][2]) > 0.45 and all(_apart(axis, one) > 0.3 for one in axes):
            axes.append(axis)
    return axes


def _walls(away: float) -> list[World]:
    """Two walls, so far from the middle."""
    places = (([3, 6], [-away, 0.0, 1.5], [0, 90, 0]), ([6, 3], [0.0, away, 1.5], [90, 0, 0]))
    return [
        {"plane": {"size": size, "translation": place, "rotation_rpy_deg": turn}}
        for size, place, turn in places
    ]


def _thing(
    rng: Random, kind: str, size: list[float], place: FloatArray | None = None, away: float = 0.0
) -> World:
    if place is None:
        place = rng.uniform([-0.6, -0.6, 0.4], [0.6, 0.6, 2.0])
        turn = rng.uniform(0.0, 2.0 * np.pi)
        place += away * np.array([np.cos(turn), np.sin(turn), 0.0])
    turned = [round(float(angle), 1) for angle in rng.uniform(-60.0, 60.0, 3)]
    where = [round(float(x), 3) for x in place]
    return {kind: {"size": size, "translation": where, "rotation_rpy_deg": turned}}


def _member(name: str, axis: Axis, **kind: Any) -> World:
    ends = [[round(float(x), 4) for x in point] for point in axis]
    return {"name": name, "ends": ends, **kind}


def _between(rng: Random, low: float, high: float) -> float:
    return round(float(rng.uniform(low, high)), 3)


def _apart(one: Axis, other: Axis) -> float:
    """Distance of two segments, near enough."""
    share = np.linspace(0.0, 1.0, 60)[:, None]
    p, q = (start + share * (end - start) for start, end in (one, other))
    return float(np.linalg.norm(p[:, None] - q[None], axis=2).min())


def _spiral(radius: float) -> World:
    return {
        "kind": "spiral", "centre": [0.0, 0.0], "radius": radius, "heights": [0.6, 2.4], "turns": 4,
    }  # fmt: skip
