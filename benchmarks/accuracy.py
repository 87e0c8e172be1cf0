"""Accuracy on random worlds: simulate, run, evaluate, and sum up over all of them.

python -m benchmarks.accuracy --seeds 101,102 --output DIR [--profile precise] [--set KEY=VALUE]

A seed draws the geometry of every family of worlds, and the noise of its flight: the
figures of the documentation are those of seeds that nothing was tuned on.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from beamseg_batch.geometry import FloatArray
from benchmarks import rough_worlds as rough

World = dict[str, Any]
Random = np.random.Generator

SHAPES = ("round", "square", "i", "l", "c")

HONEST = ("offset", "angle", "radius", "ends", "member_ends", "bow")


def bends(rng: Random) -> World:
    """Pairs that are bent by 4 to 20 degrees."""
    angles = [float(a) for a in np.round(rng.uniform([4, 8, 13], [8, 13, 20]), 1)]
    pairs = {"angles_deg": angles, "length": _between(rng, 1.0, 1.3), "spacing": 0.9}
    pose = {"translation": [0.0, 0.0, 1.8], "rotation_rpy_deg": [0, 0, _between(rng, -30, 30)]}
    return {
        "generate": [{"angle_pairs": {**pairs, "pose": pose}}],
        "flight": _spiral(1.6, 0.7, 3.0),
    }


def stars(rng: Random) -> World:
    """Joints of three, four and five members."""
    kinds = [
        {
            "star_joint": {
                "name": f"of {count}",
                "count": count,
                "length": _between(rng, 0.7, 1.1),
                "pose": {
                    "translation": [_between(rng, -0.2, 0.2), place, 0.8],
                    "rotation_rpy_deg": [0, 0, _between(rng, 0, 360)],
                },
            }
        }
        for count, place in ((3, -2.2), (4, 0.0), (5, 2.2))
    ]
    return {"generate": kinds, "flight": _round_trip(1.5, 3.4, [0.8, 1.5])}


def crossings(rng: Random) -> World:
    """A T, an X and an L, each turned at random."""
    members = []
    for name, place in (("T", -2.0), ("X", 0.0), ("L", 2.0)):
        u, v = _two_directions(rng)
        middle = np.array([0.0, place, 1.5])
        first, second = {
            "T": ((-0.6, 0.6), (0.0, 0.8)),
            "X": ((-0.6, 0.6), (-0.5, 0.5)),
            "L": ((0.0, 0.9), (0.0, 0.9)),
        }[name]
        members += [
            _member(f"{name} one", middle + first[0] * u, middle + first[1] * u),
            _member(f"{name} two", middle + second[0] * v, middle + second[1] * v),
        ]
    return {"members": members, "flight": _round_trip(1.4, 3.2, [1.0, 1.9])}


def parallels(rng: Random) -> World:
    """Pairs 0.15 m apart and a little more."""
    kinds = [
        {
            "parallel_pairs": {
                "name": f"pair {number}",
                "distances": [0.15 if number < 2 else _between(rng, 0.16, 0.25)],
                "length": _between(rng, 1.2, 1.9),
                "pose": {
                    "translation": [0.0, place, 1.5],
                    "rotation_rpy_deg": [_between(rng, -40, 40), 0, _between(rng, 0, 360)],
                },
            }
        }
        for number, place in enumerate((-1.8, 0.0, 1.8))
    ]
    return {"generate": kinds, "flight": _round_trip(1.4, 3.0, [0.8, 1.5, 2.2])}


def truss(rng: Random) -> World:
    """A short truss bridge."""
    bridge = {
        "length": _between(rng, 3.6, 4.4),
        "width": _between(rng, 0.9, 1.3),
        "height": _between(rng, 0.9, 1.3),
        "panels": 4,
        "pose": {"translation": [0.0, 0.0, 0.8]},
    }
    flight = _round_trip(1.7, 3.0, [0.7, 1.4, 2.1], along="x")
    return {"generate": [{"bridge_truss": bridge}], "flight": flight}


def tower(rng: Random) -> World:
    """A lattice tower of three storeys."""
    kind = {
        "height": _between(rng, 3.0, 3.8),
        "base": _between(rng, 1.2, 1.5),
        "top": _between(rng, 0.7, 1.0),
        "panels": 3,
    }
    return {"generate": [{"lattice_tower": kind}], "flight": _spiral(1.8, 0.5, 3.6)}


def ends_first(rng: Random) -> World:
    """Long members whose two ends are seen before their middle."""
    members = []
    for height in (1.0, 1.9):
        lean = _between(rng, -0.2, 0.2)
        half = _between(rng, 1.6, 1.9)
        members.append(_member(f"at {height}", [0, -half, height - lean], [0, half, height + lean]))
    members.append(_member("post", [0, 0, 0.5], [_between(rng, -0.1, 0.1), 0.1, 2.3]))
    points = [[-1.2, -2.0, 1.4], [-1.2, -1.3, 1.4]]
    points += [[-2.6, -1.0, 1.4], [-2.6, 1.0, 1.4]]  # too far away to see anything
    points += [[-1.2, 1.3, 1.4], [-1.2, 2.0, 1.4], [-1.2, -2.0, 1.2], [-1.2, 2.0, 1.8]]
    legs = [{"x": x, "y": y, "z": z, "yaw": 0.0, "duration": 8} for x, y, z in points]
    return {"members": members, "flight": {"kind": "waypoints", "points": legs}}


def thicket(rng: Random) -> World:
    """Members anywhere, no two axes nearer than 0.25 m."""
    members: list[World] = []
    axes: list[tuple[FloatArray, FloatArray]] = []
    while len(members) < 8:
        middle = rng.uniform([-0.6, -0.6, 0.9], [0.6, 0.6, 2.2])
        way = rng.normal(size=3)
        way *= rng.uniform(0.3, 0.6) / np.linalg.norm(way)
        axis = (middle - way, middle + way)
        if min(axis[0][2], axis[1][2]) > 0.4 and all(_apart(axis, one) > 0.25 for one in axes):
            axes.append(axis)
            members.append(_member(f"member {len(members)}", *axis))
    return {"members": members, "flight": _spiral(1.5, 0.7, 2.4)}


def bows(rng: Random) -> World:
    """Members that leave their chord by 5 to 50 mm, any way, and straight ones."""
    members: list[World] = []
    deviations = rng.permutation(
        [0.0, 0.0, *rng.uniform(0.005, 0.02, 2), *rng.uniform(0.02, 0.05, 2)]
    )
    for number, deviation in enumerate(deviations):
        half, lean = 0.5 * rng.uniform(1.2, 2.5), rng.uniform(-0.25, 0.25, 2)
        if number < 4:  # upright, in a row
            middle, way = np.array([0.0, number - 1.5, 1.65]), np.array([*lean, 1.0])
        else:  # lying, on either side of it
            side = 2 * number - 9
            middle, way = (
                np.array([0.4 * side, 0.0, 1.65 + 0.6 * side]),
                np.array([0.0, 1.0, lean[0]]),
            )
        way *= half / np.linalg.norm(way)
        member = _member(f"member {number}", middle - way, middle + way)
        sign, roll = rng.choice([-1.0, 1.0]), _between(rng, 0, 360)
        members.append({**member, "bow": round(float(sign * deviation), 4), "roll_deg": roll})
    return {"members": members, "flight": _round_trip(1.5, 2.6, [0.8, 1.6, 2.4])}


def sections(rng: Random) -> World:
    """Every cross-section that there is, of any size, turned at random: posts and rails."""
    turns = 2.0 * np.pi * (np.arange(5) + rng.uniform(0.0, 0.3)) / 5
    members = []
    for shape, turn in zip(rng.permutation(SHAPES), turns, strict=True):
        foot = np.array([0.55 * np.cos(turn), 0.55 * np.sin(turn), 0.45])
        lean = [_between(rng, -0.1, 0.1), _between(rng, -0.1, 0.1), _between(rng, 1.3, 1.6)]
        members.append({**_member(f"{shape} post", foot, foot + lean), **_section(rng, shape)})
    for shape, height in zip(rng.permutation(SHAPES), (2.5, 2.85, 3.2, 3.55, 3.9), strict=True):
        turn = rng.uniform(0.0, 2.0 * np.pi)
        half = np.array([np.cos(turn), np.sin(turn), 0.1]) * rng.uniform(0.5, 0.8)
        middle = np.array([0.0, 0.0, height])
        ends = (middle - half, middle + half)
        members.append({**_member(f"{shape} rail", *ends), **_section(rng, shape)})
    return {"members": members, "flight": {**_spiral(1.35, 0.6, 4.0), "turns": 6}}


def sections_voxl(rng: Random) -> World:
    """The same, seen by a camera of more pixels that has the flaws of a real one."""
    return {**sections(rng), "sensor": "voxl_tof"}


FAMILIES: dict[Callable[[Random], World], int] = {
    bends: 0, stars: 1, crossings: 2, parallels: 3, truss: 4, tower: 5, ends_first: 6, thicket: 7,
    bows: 8, sections: 8, sections_voxl: 8,
    rough.clutters: 8, rough.clutters_4cm: 8, rough.clutters_voxl: 8, rough.thicket_cluttered: 8,
    rough.tower_cluttered: 8, rough.tower_voxl: 8, rough.radii_3: 8, rough.mixed: 8,
}  # fmt: skip
"""Families of worlds; those of a number draw from the same random numbers."""

SETTINGS = {
    rough.radii_3: ["filtering.radii=[0.10,0.05,0.03]"],
    rough.mixed: ["filtering.radii=[0.10,0.05,0.03]"],
}
"""What a run needs to be told of a family."""


def main() -> None:
    """Measure every family with every seed, and print a row for each and one for all."""
    arguments = _arguments()
    rows = []
    print(
        f"{'world':18}{'found':>10}{'wrong':>6}{'axis mm':>14}{'angle':>8}{'  own ends mm':>15}"
        f"{'  to the member':>15}{'joints':>10}"
        f"{'bow mm':>14}{'  within 2 sigma: axis angle radius ends member bow':54}{'s':>6}"
    )
    for seed in arguments.seeds:
        for family in FAMILIES:
            if family.__name__ not in arguments.only:
                continue
            folder = arguments.output / f"{family.__name__}-{seed}"
            rows.append(measure(family, seed, folder, arguments))
            print(_row(f"{family.__name__} {seed}", rows[-1]), flush=True)
    (arguments.output / "accuracy.json").write_text(json.dumps(rows, indent=1))
    print(_row("all", _pooled(rows)))


def measure(
    family: Callable[[Random], World], seed: int, folder: Path, arguments: argparse.Namespace
) -> dict[str, Any]:
    """Simulate a world unless that was done before, run, evaluate."""
    folder.mkdir(parents=True, exist_ok=True)
    world, flight = folder / "world.yaml", folder / "flight.mcap"
    text = json.dumps(family(np.random.default_rng([seed, FAMILIES[family]])))
    noisy = ("--noise", "0.04") if family is rough.clutters_4cm else ()
    if not flight.exists() or not world.exists() or world.read_text() != text:
        world.write_text(text)  # JSON is YAML, too
        _beamseg("simulate", world, "-o", flight, "--seed", seed, "--overwrite", "-q", *noisy)
    chosen = [*SETTINGS.get(family, ()), *arguments.set]
    settings = [part for each in chosen for part in ("--set", each)]
    _beamseg(
        "run", flight, "-o", folder / "run", "--overwrite", "-q", "--profile", arguments.profile,
        "--set", "outputs.report=false", *settings,
    )  # fmt: skip
    text = _beamseg("evaluate", folder / "run", "--truth", folder / "truth", "--json")
    found: dict[str, Any] = json.loads(text)
    found["seconds"] = json.loads((folder / "run/summary.json").read_text())["totals"]["wall_s"]
    return found


def _beamseg(*words: object) -> str:
    command = [sys.executable, "-m", "beamseg_batch", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}: {done.stderr}")
    return done.stdout


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.accuracy", description=__doc__)
    parser.add_argument("--seeds", type=lambda t: [int(n) for n in t.split(",")], default=[101])
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--profile", default="precise")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    usual = [family.__name__ for family in FAMILIES if family not in (sections, sections_voxl)]
    parser.add_argument("--only", type=lambda text: text.split(","), default=usual)
    return parser.parse_args()


def _between(rng: Random, low: float, high: float) -> float:
    return round(float(rng.uniform(low, high)), 3)


def _section(rng: Random, shape: str) -> World:
    """A section of sizes that beams about as thick as one of 0.05 m radius have."""
    if shape == "round":
        return {}
    widths = {"square": (0.08, 0.11), "i": (0.08, 0.12), "l": (0.09, 0.12), "c": (0.05, 0.07)}
    found: World = {"shape": shape, "width": _between(rng, *widths[shape]), "radius": None}
    found["height"] = found["width"] if shape == "square" else _between(rng, 0.09, 0.14)
    found |= {"web": _between(rng, 0.005, 0.01), "flange": _between(rng, 0.007, 0.012)}
    if shape == "l":  # rolled with legs of one thickness
        found["web"] = found["flange"]
    return {**found, "roll_deg": _between(rng, 0.0, 360.0)}


def _member(name: str, start: Any, end: Any) -> World:
    ends = [[round(float(x), 4) for x in np.asarray(point)] for point in (start, end)]
    return {"name": name, "ends": ends, "radius": 0.05}


def _two_directions(rng: Random) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors, 40 to 90 degrees apart."""
    while True:
        u, v = rng.normal(size=(2, 3))
        u, v = u / np.linalg.norm(u), v / np.linalg.norm(v)
        if abs(u @ v) < np.cos(np.radians(40.0)):
            return u, v


def _apart(one: tuple[FloatArray, FloatArray], other: tuple[FloatArray, FloatArray]) -> float:
    """Distance of two segments, near enough."""
    share = np.linspace(0.0, 1.0, 60)[:, None]
    p, q = (start + share * (end - start) for start, end in (one, other))
    return float(np.linalg.norm(p[:, None] - q[None], axis=2).min())


def _spiral(radius: float, low: float, high: float) -> World:
    return {
        "kind": "spiral", "centre": [0.0, 0.0], "radius": radius, "heights": [low, high],
        "turns": 4,
    }  # fmt: skip


def _round_trip(distance: float, reach: float, heights: list[float], along: str = "y") -> World:
    """Past a row on one side and back on the other, looking at it, at each height."""
    points = []
    for height in heights:
        for side in (1.0, -1.0):
            for end in (-side, side):
                x, y = side * distance, end * reach
                yaw = np.pi if side > 0 else 0.0
                if along == "x":
                    x, y, yaw = y, x, -np.pi / 2 if side > 0 else np.pi / 2
                points.append({"x": x, "y": y, "z": height, "yaw": float(yaw), "duration": 18})
    for before, after in zip(points[1:-1:2], points[2::2], strict=True):
        after["duration"] = 6 if before["x"] == after["x"] or before["y"] == after["y"] else 10
    return {"kind": "waypoints", "points": points}


def _pooled(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """All worlds as one: counts add up, errors are those of all members."""
    metrics: dict[str, Any] = {}
    for name in ("members", "matched", "duplicates", "fragments", "false", *map("joints.{}".format,
                 ("truth", "found", "invented"))):  # fmt: skip
        metrics[name] = sum(row["metrics"][name] for row in rows)
    for kind in HONEST:
        shares = [row["metrics"][f"honesty.{kind}"] for row in rows]
        known = [
            (s, r["metrics"]["matched"]) for s, r in zip(shares, rows, strict=True) if s is not None
        ]
        total = sum(count for _, count in known)
        metrics[f"honesty.{kind}"] = sum(s * n for s, n in known) / total if total else None
    matches = [match for row in rows for match in row["matches"]]
    return {"metrics": metrics, "matches": matches, "seconds": sum(row["seconds"] for row in rows)}


def _spread(matches: list[dict[str, Any]], which: str) -> str:
    """Median and 95 % of the errors of own ends, millimetres."""
    errors = [end[which] * 1e3 for match in matches for end in match["ends"] if end["own"]]
    errors = errors or [np.nan]
    return f"{np.median(errors):>7.2f}/{np.percentile(errors, 95):<6.2f}"


def _row(name: str, found: dict[str, Any]) -> str:
    metrics, matches = found["metrics"], found["matches"]
    wrong = metrics["duplicates"] + metrics["fragments"] + metrics["false"]
    axis = np.array([match["axis_offset"] for match in matches] or [np.nan]) * 1e3
    angle = np.median([match["angle_deg"] for match in matches] or [np.nan])
    ends = " ".join(_spread(matches, which) for which in ("error", "member_error"))
    honest = [metrics[f"honesty.{kind}"] for kind in HONEST]
    bow = np.abs([m["bow_error"] or 0.0 for m in matches] or [np.nan]) * 1e3
    shares = " ".join("     -" if share is None else f"{share:6.1%}" for share in honest)
    joints = "/".join(str(metrics[f"joints.{n}"]) for n in ("found", "truth", "invented"))
    return (
        f"{name:18}{metrics['matched']:>5}/{metrics['members']:<4}{wrong:>6}"
        f"{np.median(axis):>7.2f}/{axis.max():<6.2f}{angle:>8.3f}"
        f" {ends}{joints:>10}"
        f"{np.median(bow):>7.2f}/{bow.max():<6.2f}  {shares:43}"
        f"{found['seconds']:>6.1f}"
    )


if __name__ == "__main__":
    main()
