"""Rays that meet bent beams: the kernels beside a slow twin, and a straight one as a limit."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.cylinder.end_kernels import gather_ends
from beamseg_batch.cylinder.meeting_kernels import local_axis, meet
from beamseg_batch.cylinder.ray_kernels import on_cylinders
from beamseg_batch.geometry import normalised
from tests.cylinder.naive import BentTube, frame_of
from tests.cylinder.scenes import cylinders_of, gathered, meetings_of, scene_of, view_of

SIZE = 48


def bent_scene(seed, *, size=0.04, depths=None):
    """One beam before the camera that is bent, and its slow twin."""
    rng = np.random.default_rng(seed)
    middle = np.array([rng.uniform(0.9, 1.3), *rng.uniform(-0.2, 0.2, 2)])
    way = normalised(rng.normal(size=3) * (0.4, 1.0, 1.0)) * 0.5
    depths = np.full(SIZE * SIZE, np.inf) if depths is None else depths
    scene = scene_of([(middle - way, middle + way, 0.06)], rng, size=SIZE, depths=depths)
    scene.low[:] = -9.0
    turn = rng.uniform(0, 2 * np.pi)
    scene.bows = size * (np.cos(turn) * scene.us + np.sin(turn) * scene.vs)
    tube = BentTube(
        scene.anchors[0], scene.directions[0], scene.bows[0],
        scene.firsts[0], scene.lasts[0], scene.radii[0],
    )  # fmt: skip
    return scene, tube


def met(scene, *, width=None, flanks=False):
    """Meetings of each ray, by their pixel: where along, entry, and depth with caps."""
    meetings = meetings_of(len(scene.points))
    width = scene.width if width is None else width
    count = meet(view_of(scene, width), cylinders_of(scene), meetings, flanks)
    pixels = meetings.pixels[:count]
    heads = meetings.head[pixels]
    found = np.full((len(scene.points), 4), np.nan)
    columns = (meetings.along, meetings.entry, meetings.nearest, meetings.side)
    found[pixels] = np.stack([column[heads] for column in columns], axis=1)
    return found


@pytest.mark.parametrize("seed", range(6))
def test_meet__bent_beam_agrees_with_its_twin(seed):
    scene, tube = bent_scene(seed)
    along, entry, _, side = met(scene).T
    wanted, s = tube.entry(scene.rays)
    asked = np.isfinite(wanted) & (s > scene.starts[0]) & (s < scene.lasts[0] + 0.29)
    clear = side[np.isfinite(side)] < 0.98  # what grazes the outline may go either way
    assert clear.sum() > 40
    assert (np.isfinite(entry) == asked).mean() > 0.99
    both = np.isfinite(entry) & asked & (side < 0.98)
    np.testing.assert_allclose(entry[both], wanted[both], atol=2e-5)
    np.testing.assert_allclose(along[both], s[both], atol=2e-4)


@pytest.mark.parametrize("seed", range(4))
def test_meet__bent_beam_is_met_through_the_image_as_by_all_rays(seed):
    scene, _ = bent_scene(seed)
    np.testing.assert_array_equal(met(scene, flanks=True), met(scene, width=0, flanks=True))


def test_meet__hardly_bent_beam_is_a_straight_one():
    scene, _ = bent_scene(1, size=1e-9)
    bent = met(scene, flanks=True)
    scene.bows[:] = 0.0
    np.testing.assert_allclose(bent, met(scene, flanks=True), atol=1e-7)


def test_meet__caps_of_a_bent_beam_stand_square_to_its_axis():
    scene, _ = bent_scene(2)
    along, entry, nearest, _ = met(scene).T
    inside = (along > scene.firsts[0]) & (along < scene.lasts[0])
    np.testing.assert_array_equal(nearest[inside], entry[inside])
    ends = scene.firsts[0], scene.lasts[0]
    for s in ends:
        touch = np.array(local_axis(scene.anchors[0], scene.directions[0], scene.bows[0], *ends, s))
        on_cap = np.isfinite(nearest) & ~inside & (abs(along - s) < 0.15)
        off = (scene.rays[on_cap] * nearest[on_cap, None] - touch[:3]) @ touch[3:6]
        assert np.abs(off).max(initial=0.0) < 0.004  # the axis turns a little beyond its end


@pytest.mark.parametrize("seed", range(3))
def test_gather__normal_equations_of_a_bent_beam(seed):
    """An axis that is moved a little gives residuals that the equations undo."""
    scene, _ = bent_scene(seed)
    scene.anchors = scene.anchors + 0.0002 * scene.us - 0.0003 * scene.vs
    entry = met(scene)[:, 1]
    scene.points = scene.rays * entry[:, None]
    scene.anchors = scene.anchors - 0.0002 * scene.us + 0.0003 * scene.vs
    total = gathered(scene, flanks=False).normal.sum(axis=0)
    matrix = np.array([[total[0], total[1]], [total[1], total[2]]])
    assert total[14] > 40
    np.testing.assert_allclose(
        np.linalg.solve(matrix, total[9:11]), [0.0002, -0.0003], rtol=0.05, atol=1e-5
    )


def test_gather__scatter_tells_of_the_square_of_the_place():
    scene, _ = bent_scene(3)
    entry = met(scene)[:, 1]
    scene.points = scene.rays * (entry[:, None] + 0.004)
    sums = gathered(scene, flanks=False)
    middles = scene.starts[0] + 0.02 * (np.arange(len(sums.normal)) + 0.5)
    squares = sums.normal[:, 11:13] * middles[:, None]
    wanted = np.append(sums.normal[:, 9:11].sum(axis=0), squares.sum(axis=0))
    got = sums.scatter[0][np.ix_([0, 1, 5, 6], [0, 1, 5, 6])]
    np.testing.assert_allclose(got, np.outer(wanted, wanted), rtol=0.05, atol=0.02 * got.max())


def test_gather_ends__likes_the_ends_of_a_bent_beam():
    scene, _ = bent_scene(4)
    nearest = met(scene)[:, 2]
    scene.points = scene.rays * np.where(nearest < 9, nearest, np.nan)[:, None]
    places = np.arange(-20.0, 21.0) * 0.002
    likelihood = np.zeros((1, 2, len(places)))
    beams, meetings = cylinders_of(scene), meetings_of(len(scene.points))
    gather_ends(view_of(scene, scene.width), beams, places, likelihood, scene.background, meetings)
    ahead, behind = likelihood[0]
    for told, inwards in ((ahead, 40), (behind, 0)):
        assert told[20] > told.max() - 1.0
        assert told[inwards] < told[20] - 5.0


def test_on_cylinders__of_a_bent_beam():
    scene, tube = bent_scene(5)
    rng = np.random.default_rng(0)
    s = rng.uniform(scene.firsts[0], scene.lasts[0], 400)
    u, v, _ = frame_of(scene.directions[0])
    turn, size = rng.uniform(0, 2 * np.pi, 400), rng.uniform(0.0, 0.12, 400)
    points = tube.axis(s) + size[:, None] * (np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * v)
    near = on_cylinders(
        points, scene.anchors, scene.directions, scene.firsts, scene.lasts,
        scene.bows, scene.radii, 0.01,
    )  # fmt: skip
    np.testing.assert_array_equal(near, size < 0.07)
