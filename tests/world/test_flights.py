"""The flights of the shipped worlds: they see what stands there, and keep clear of it."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.geometry import RigidTransform
from beamseg_batch.simulation.casting import Caster
from beamseg_batch.simulation.seen import SeenParts, SeenRule
from beamseg_batch.simulation.sensor import load_sensor
from beamseg_batch.simulation.trajectory import TruePath, read_flight
from beamseg_batch.world import load_scene_file, world_names

RULE = SeenRule(min_scans=1)


@pytest.mark.parametrize("name", world_names())
def test_shipped_flight__sees_every_member_and_touches_none(name):
    world, every_s = load_scene_file(name), 0.4
    path = TruePath(read_flight(world.document, ("flight",)), seed=1)
    sensor = load_sensor(world.sensor)
    slant = np.linalg.norm(sensor.camera.grid.directions, axis=2)
    grid, seen = sensor.camera.grid, SeenParts(world.scene.members, RULE)
    caster, nearest = Caster(world.scene), np.inf
    poses = path.poses(np.arange(0.0, path.flight.duration_s, every_s))
    for position, quaternion in zip(*poses, strict=True):
        T = RigidTransform.from_quaternion(position, quaternion) @ sensor.T_body_sensor
        hits = caster.cast(T, grid)
        nearest = min(nearest, (hits.depths * slant)[hits.owners >= 0].min(initial=np.inf))
        seen.add(hits, hits.depths, grid, T, sensor.T_cloud_sensor)
    assert nearest > 0.35
    for member, part in zip(world.scene.members, seen.parts(), strict=True):
        low, high = sorted([member.start[2], member.end[2]])
        above = (high - max(low, RULE.floor_trim_m)) / (high - low) if high > low else 1.0
        start, end = part.longest or (0.0, 0.0)
        assert end - start > 0.8 * above * member.length, member.name
