"""Which part of each member counts as seen, by the rule and by a slow twin of it."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from beamseg_batch.geometry import RigidTransform
from beamseg_batch.simulation.casting import Caster
from beamseg_batch.simulation.seen import SeenPart, SeenParts, SeenRule, seen_parts
from beamseg_batch.simulation.sensor import Camera
from beamseg_batch.world.scene import Scene
from tests.simulation.conftest import looking, make_member

CAMERA = Camera(width=64, height=64, horizontal_fov=2.0)
MEMBER = make_member(start=(0.0, -1.4, 1.0), end=(0.0, 1.4, 1.0))
AHEAD = looking(0.8, 0.0, 1.0, 180)


def true_scans(scene, poses):
    caster = Caster(scene)
    return [(pose, caster.cast(pose, CAMERA.grid).depths) for pose in poses]


def part_of(poses, members=(MEMBER,), **rule):
    scene = Scene("", tuple(members))
    return seen_parts(scene, true_scans(scene, poses), CAMERA.grid, rule=SeenRule(**rule))[0]


def test_seen_parts__needs_three_scans():
    assert part_of([AHEAD] * 2).intervals == ()
    assert part_of([AHEAD] * 2).n_scans == 2
    assert part_of([AHEAD] * 2).length == 0.0
    ((low, high),) = part_of([AHEAD] * 3).intervals
    # The camera sees tan(1.0) * 0.75 m to each side of the middle.
    assert low == pytest.approx(1.4 - 1.168, abs=0.04)
    assert high == pytest.approx(1.4 + 1.168, abs=0.04)


def test_seen_parts__window():
    assert part_of([looking(1.6, 0.0, 1.0, 180)] * 3).intervals == ()
    assert part_of([looking(1.6, 0.0, 1.0, 180)] * 3, x_max=2.0).intervals != ()
    narrow = part_of([AHEAD] * 3, y_z_max=0.5).intervals
    assert narrow[0] == pytest.approx((0.9, 1.9), abs=0.021)


def test_seen_parts__window_has_the_axes_of_the_cloud():
    scene = Scene("", (MEMBER,))
    scans = true_scans(scene, [AHEAD] * 3)
    ahead = RigidTransform(np.eye(3), np.array([0.0, 0.0, 0.0]))
    shifted = RigidTransform(np.eye(3), np.array([0.9, 0.0, 0.0]))
    assert seen_parts(scene, scans, CAMERA.grid, ahead)[0].intervals != ()
    assert seen_parts(scene, scans, CAMERA.grid, shifted)[0].intervals == ()


def test_seen_parts__floor_trim():
    leaning = make_member(start=(0.0, -1.0, 0.0), end=(0.0, 1.0, 1.0))
    ((low, _),) = part_of([looking(0.9, 0.0, 0.5, 180)] * 3, [leaning]).intervals
    assert low * leaning.rotation[2, 2] == pytest.approx(0.3, abs=0.05)


def test_seen_parts__closes_gaps_up_to_ten_centimetres():
    def post(width, y):
        ends = {"start": (0.3, y, 0.5), "end": (0.3, y, 1.5)}
        return make_member("square", **ends, width=width, height=width)

    # A post before the member hides 0.75 / 0.5 of its width; pixels are 4 cm apart there.
    assert len(part_of([AHEAD] * 3, [MEMBER, post(0.02, 0.0)]).intervals) == 1
    halves = part_of([AHEAD] * 3, [MEMBER, post(0.16, 0.2)]).intervals
    assert len(halves) == 2
    assert part_of([AHEAD] * 3, [MEMBER, post(0.16, 0.2)]).longest == halves[0]


def test_seen_parts__mixed_pixels_hit_nothing():
    scene = Scene("", (MEMBER,))
    scans = [(pose, depths + 0.06) for pose, depths in true_scans(scene, [AHEAD] * 3)]
    assert seen_parts(scene, scans, CAMERA.grid)[0] == SeenPart((), 0)
    wide = SeenRule(off_surface_m=0.1)
    assert seen_parts(scene, scans, CAMERA.grid, rule=wide)[0].n_scans == 3


def naive_part(scans, member, rule):
    """Bins by a counter, one return after the other."""
    bins = Counter()
    for pose, depths in scans:
        hits = Caster(Scene("", (member,))).cast(pose, CAMERA.grid)
        found = set()
        for (v, u), depth in np.ndenumerate(depths):
            if not abs(depth - hits.depths[v, u]) <= rule.off_surface_m:
                continue
            point = CAMERA.grid.directions[v, u] * depth
            world = pose.apply(point)
            inside = point[0] <= rule.x_max and np.abs(point[1:]).max() <= rule.y_z_max
            if inside and world[2] >= rule.floor_trim_m:
                t = (world - member.start) @ member.rotation[:, 2]
                found.add(int(np.clip(t, 0, member.length - 1e-9) // rule.bin_m))
        bins.update(found)
    seen = sorted(k for k, count in bins.items() if count >= rule.min_scans)
    runs = []
    for k in seen:
        if runs and (k - runs[-1][1] - 1) * rule.bin_m <= rule.merge_gap_m + 1e-9:
            runs[-1][1] = k
        else:
            runs.append([k, k])
    return [(a * rule.bin_m, min((b + 1) * rule.bin_m, member.length)) for a, b in runs]


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_seen_parts__naive_twin():
    rng = np.random.default_rng(8)
    poses = [looking(0.9, y, 0.8, 180 + a, 10) for y, a in rng.uniform(-0.8, 0.8, (8, 2)) * (1, 20)]
    scans = [
        (pose, depths + rng.normal(0.0, 0.02, depths.shape))
        for pose, depths in true_scans(Scene("", (MEMBER,)), poses)
    ]
    (part,) = seen_parts(Scene("", (MEMBER,)), scans, CAMERA.grid)
    np.testing.assert_allclose(part.intervals, naive_part(scans, MEMBER, SeenRule()))


def test_seen_parts__no_members():
    assert SeenParts((), SeenRule()).parts() == []
