"""What rays hit, against a slow caster of other mathematics and against plain loops."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.geometry import matrix_from_rpy
from beamseg_batch.simulation.casting import Caster
from beamseg_batch.simulation.casting_kernels import average_pixels
from beamseg_batch.simulation.solids import BALL, BOX, CLUTTER, solids_of
from beamseg_batch.world.scene import Box, Rectangle, Scene, Sphere
from tests.simulation.conftest import VIEWS, looking, make_member
from tests.simulation.fields import to_member, walk


def unit_rays(grid):
    rays = grid.directions.reshape(-1, 3)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def walked_depths(distance, pose, grid, steps=300):
    """Depths by walking, (H, W), and the least distance of each ray to the surface."""
    rays = unit_rays(grid)
    ranges, closest = walk(distance, pose.translation, pose.rotate(rays), steps=steps)
    shape = (len(grid.down), len(grid.right))
    return (ranges * rays[:, 0]).reshape(shape), closest.reshape(shape)


@pytest.mark.parametrize("view", range(len(VIEWS)))
def test_cast__depths_of_every_shape(member, camera, view):
    hits = Caster(Scene("", (member,))).cast(VIEWS[view], camera.grid)
    depths, closest = walked_depths(
        lambda p: to_member(p, member), VIEWS[view], camera.grid, steps=150
    )
    hit, expected = np.isfinite(hits.depths), np.isfinite(depths)
    # Walking comes to its end slowly where it grazes; and a bent member is a chain of pieces.
    assert np.all(closest[hit & ~expected] < 5e-4)
    both = hit & expected
    assert both.sum() > 20
    off_surface = np.abs(hits.depths[both] - depths[both]) * hits.facings[both]
    assert off_surface.max() < (2e-4 if member.bow else 1e-6)
    missed = expected & ~hit
    assert missed.sum() <= (0.02 * both.sum() + 1 if member.bow else 0)
    assert set(hits.owners[hit]) == {0}
    assert set(hits.owners[~hit]) <= {CLUTTER}


def to_box(points, box):
    beyond = np.abs((points - box.centre) @ box.rotation) - box.size / 2
    return np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0)


def test_cast__depths_of_clutter(camera):
    turn = matrix_from_rpy(0.3, -0.5, 0.9)
    box = Box(np.array([0.1, 0.2, 1.2]), np.array([0.3, 0.5, 0.4]), turn)
    sphere = Sphere(np.array([0.2, -0.5, 1.0]), 0.2)
    wall = Rectangle(np.array([-1.0, 0.0, 1.0]), np.array([2.0, 1.5]), matrix_from_rpy(0, 1.4, 0))
    scene = Scene("", boxes=(box,), spheres=(sphere,), rectangles=(wall,))
    flat = Box(wall.centre, np.append(wall.size, 0.0), wall.rotation)

    def distance(points):
        to_sphere = np.linalg.norm(points - sphere.centre, axis=1) - sphere.radius
        return np.min([to_box(points, box), to_sphere, to_box(points, flat)], axis=0)

    hits = Caster(scene).cast(VIEWS[0], camera.grid)
    depths, _ = walked_depths(distance, VIEWS[0], camera.grid)
    both = np.isfinite(depths) & np.isfinite(hits.depths)
    assert both.sum() > 400
    assert (np.isfinite(depths) != np.isfinite(hits.depths)).sum() == 0
    assert np.abs(hits.depths[both] - depths[both]).max() < 1e-5
    assert set(hits.owners.ravel()) == {CLUTTER}


def naive_hits(solids, pose, grid):
    """Try every ray against every solid, nothing left out for being out of view."""
    rays = grid.directions.reshape(-1, 3)
    depths, owners = np.full(len(rays), np.inf), np.full(len(rays), CLUTTER)
    for number in range(len(solids)):
        axes = pose.rotation.T @ solids.rotations[number]
        o = (pose.translation - solids.centres[number]) @ solids.rotations[number]
        for k, d in enumerate(rays @ axes):
            t = naive_entry(solids.kinds[number], o, d, solids.halves[number])
            if t < depths[k]:
                depths[k], owners[k] = t, solids.owners[number]
    shape = (len(grid.down), len(grid.right))
    return depths.reshape(shape), owners.reshape(shape)


def naive_entry(kind, o, d, half):
    """Cut the ray by each pair of planes and by the round, and keep what all of them leave."""
    spans = []
    if kind != BALL:
        with np.errstate(divide="ignore"):
            ends = np.sort([(-half - o) / d, (half - o) / d], axis=0).T
        spans += list(ends if kind == BOX else ends[2:])
    if kind != BOX:
        size = 3 if kind == BALL else 2
        a, b = d[:size] @ d[:size], o[:size] @ d[:size]
        root = b * b - a * (o[:size] @ o[:size] - half[0] ** 2)
        if root < 0:
            return np.inf
        spans.append(((-b - np.sqrt(root)) / a, (-b + np.sqrt(root)) / a))
    enters, leaves = max(low for low, _ in spans), min(high for _, high in spans)
    return enters if 0 < enters <= leaves else np.inf


def test_cast_rays__leaves_out_nothing_that_is_in_view():
    """Solids before, beside, behind and around the camera, against a plain loop."""
    rng = np.random.default_rng(3)
    from beamseg_batch.simulation.sensor import Camera

    members = tuple(
        make_member(
            ("round", "i", "square")[k % 3], start=rng.uniform(-2, 2, 3), end=rng.uniform(-2, 2, 3)
        )
        for k in range(12)
    )
    scene = Scene(
        "",
        members,
        boxes=(Box(np.array([0.5, 0.0, 0.0]), np.array([0.4, 6.0, 0.3])),),
        spheres=(Sphere(np.array([0.0, 0.6, 0.2]), 0.3),),
        rectangles=(Rectangle(np.array([0.0, 0.0, -0.5]), np.array([8.0, 8.0])),),
    )
    camera = Camera(width=20, height=16, horizontal_fov=2.0, pixel_offset=0.5)
    for pose in (looking(0, 0, 0, 30), looking(-1.5, 1.0, 0.3, -50, 20, 40)):
        hits = Caster(scene).cast(pose, camera.grid)
        depths, owners = naive_hits(solids_of(scene), pose, camera.grid)
        np.testing.assert_array_equal(np.isfinite(hits.depths), np.isfinite(depths))
        both = np.isfinite(depths)
        assert both.mean() > 0.5
        np.testing.assert_allclose(hits.depths[both], depths[both], atol=1e-9)
        np.testing.assert_array_equal(hits.owners[both], owners[both])


def test_cast__farthest_leaves_the_near_as_it_is(camera):
    scene = Scene("", (make_member(), make_member(start=(-3, -1, 1), end=(-3, 1, 1))))
    all_hits = Caster(scene).cast(VIEWS[0], camera.grid)
    near_hits = Caster(scene, farthest=2.0).cast(VIEWS[0], camera.grid)
    assert set(all_hits.owners.ravel()) == {CLUTTER, 0, 1}
    assert set(near_hits.owners.ravel()) == {CLUTTER, 0}
    near = all_hits.owners == 0
    np.testing.assert_array_equal(near_hits.depths[near], all_hits.depths[near])


def test_cast__camera_inside_of_a_solid_sees_the_world_around(camera):
    scene = Scene("", (make_member(),), spheres=(Sphere(VIEWS[0].translation, 0.2),))
    hits = Caster(scene).cast(VIEWS[0], camera.grid)
    bare = Caster(Scene("", scene.members)).cast(VIEWS[0], camera.grid)
    np.testing.assert_array_equal(hits.depths, bare.depths)


def test_cast__facing_is_the_sine_between_ray_and_surface(camera):
    floor = Scene("", rectangles=(Rectangle(np.zeros(3), np.array([50.0, 50.0])),))
    hits = Caster(floor).cast(VIEWS[0], camera.grid)
    rays = VIEWS[0].rotate(unit_rays(camera.grid)).reshape(*hits.depths.shape, 3)
    hit = np.isfinite(hits.depths)
    np.testing.assert_allclose(hits.facings[hit], -rays[hit][:, 2], atol=1e-12)


def naive_average(depths, facings, n, least):
    height, width = depths.shape[0] // n, depths.shape[1] // n
    pixels = np.full((height, width), np.inf)
    for v, u in np.ndindex(height, width):
        block = np.s_[v * n : (v + 1) * n, u * n : (u + 1) * n]
        kept = depths[block][np.isfinite(depths[block]) & (facings[block] >= least)]
        if 2 * len(kept) >= n * n:
            pixels[v, u] = kept.mean()
    return pixels


@pytest.mark.parametrize("footprint", [1, 2, 3])
def test_average_pixels__naive_twin(footprint):
    rng = np.random.default_rng(5)
    depths = rng.uniform(0.5, 3.0, (12 * footprint, 10 * footprint))
    depths[rng.random(depths.shape) < 0.4] = np.inf
    facings = rng.random(depths.shape)
    for kernel in (average_pixels, average_pixels.py_func):
        np.testing.assert_allclose(
            kernel(depths, facings, footprint, 0.2), naive_average(depths, facings, footprint, 0.2)
        )
