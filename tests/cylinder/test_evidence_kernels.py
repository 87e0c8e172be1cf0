"""What rays say about beams: the kernel beside its slow twin, and case by case."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from beamseg_batch.cylinder.evidence_kernels import COARSE, FINE, _add_flanks, gather
from beamseg_batch.structure.hypothesis import normal_matrix
from tests.cylinder.naive import Gathered
from tests.cylinder.scenes import empty_sums, gathered, recorded, scene_of, some_beams
from tests.rays import camera_rays, seen_depths

BEAM = ([1.0, 0.0, -0.3], [1.0, 0.0, 0.3], 0.05)
BEFORE = ([0.7, 0.0, -0.3], [0.7, 0.0, 0.3], 0.05)


def as_beams(*beams):
    return [(np.array(start), np.array(end), radius) for start, end, radius in beams]


def random_scene(seed, count=4, **kwargs):
    rng = np.random.default_rng(seed)
    beams = some_beams(rng, count)
    seen = scene_of(beams, rng, wall=rng.choice([1.1, 1.6, np.inf]), **kwargs)
    moved = [(a + rng.normal(0, 0.005, 3), b + rng.normal(0, 0.005, 3), r) for a, b, r in beams]
    scene = scene_of(moved, rng, depths=np.zeros(len(seen.rays)), **kwargs)
    scene.points = seen.points
    return scene


def assert_same(sums, wanted, *, rounding=1e-9):
    np.testing.assert_allclose(sums.likelihood, wanted.likelihood, rtol=rounding, atol=rounding)
    np.testing.assert_array_equal(sums.hits, wanted.hits)
    for name in ("normal", "scatter"):
        got, want = getattr(sums, name), getattr(wanted, name)
        most = max(np.abs(want).max(initial=0.0), 1.0)
        np.testing.assert_allclose(got, want, rtol=0.0, atol=10 * rounding * most)
    np.testing.assert_array_equal(sums.asked, wanted.asked)
    np.testing.assert_array_equal(sums.scans, wanted.scans)
    np.testing.assert_array_equal(sums.flanks, wanted.flanks)
    np.testing.assert_array_equal(sums.beside, wanted.beside)


def assert_agrees(scene, *, flanks=True):
    """Compiled, depths have the single precision of the points; the source has more."""
    wanted = Gathered(scene, flanks=flanks)
    assert_same(gathered(scene, flanks=flanks), wanted, rounding=1e-7)
    with np.errstate(all="ignore"):
        assert_same(gathered(scene, flanks=flanks, run=gather.py_func), wanted, rounding=1e-7)


# --- the twin -------------------------------------------------------------------------


@pytest.mark.parametrize("competitors", ["none", "likelier", "all"])
@pytest.mark.parametrize("seed", range(3))
def test_gather__agrees_with_its_twin(seed, competitors):
    scene = random_scene(seed)
    limits = {"none": scene.ranks * 0 - 1, "likelier": scene.ranks - 1, "all": scene.limits}
    scene.limits = limits[competitors]
    scene.excused = scene.ranks - 1
    sums = gathered(scene)
    assert sums.hits.sum() > 20
    assert sums.likelihood.min() < 0.0
    assert sums.flanks.sum() > 10
    assert_agrees(scene)


def test_gather__agrees_with_its_twin_without_flanks():
    scene = random_scene(7)
    assert_agrees(scene, flanks=False)


def test_gather__agrees_with_its_twin_above_a_floor_and_in_a_window():
    scene = random_scene(8)
    scene.up, scene.height, scene.floor = np.array([0.1, 0.0, np.sqrt(0.99)]), 0.4, 0.3
    scene.low[1], scene.high[0] = -0.2, 1.2
    assert_agrees(scene)


def test_gather__agrees_with_its_twin_where_outlines_are_blurred():
    scene = random_scene(9)
    sharp = gathered(scene).normal[:, 14].sum()
    scene.blur = 0.02
    assert_agrees(scene)
    assert 0 < gathered(scene).normal[:, 14].sum() < 0.9 * sharp


def test_gather__agrees_with_its_twin_where_pixels_are_wide():
    scene = random_scene(9)
    scene.blur, scene.footprint = 0.02, 0.02
    assert_agrees(scene)


def test_gather__wide_pixels_measure_no_other_radius():
    """A pixel's mean depth lies behind the surface in its middle, the more the more it curves."""
    rng, size, many = np.random.default_rng(3), 160, 5
    beam = np.array([1.1, 0.02, -0.4]), np.array([1.05, -0.03, 0.4]), 0.05
    pitch = 2.0 / (size - 1)
    middles = camera_rays(size, size)
    inner = (np.arange(many) - (many - 1) / 2) / many * pitch
    forward = np.zeros(len(middles))
    for dy in inner:
        for dz in inner:
            rays = middles / middles[:, :1] + np.array([0.0, dy, dz])
            lengths = np.linalg.norm(rays, axis=1)
            forward += seen_depths(np.zeros(3), rays / lengths[:, None], *beam) / lengths
    depths = forward / many**2 / middles[:, 0]
    errors = []
    for footprint in (0.0, pitch):
        scene = scene_of([beam], rng, size=size, depths=depths)
        scene.blur, scene.footprint = 0.75 * pitch, footprint
        matrix, right = normal_matrix(gathered(scene).normal)
        errors.append(abs(right[4] / matrix[4, 4]))
    assert errors[1] < 0.2 * errors[0]


# --- the image and the scratch --------------------------------------------------------


@pytest.mark.parametrize("seed", range(20))
def test_gather__asks_the_same_rays_through_the_image_as_all(seed):
    scene = random_scene(1000 + seed, count=6)
    assert_same(gathered(scene), gathered(scene, width=0))


@pytest.mark.parametrize("shift", [(-1.0, 0, 0), (0, 1.2, 0), (-0.8, 0, 0.9), (0.7, 0, 0)])
def test_gather__asks_the_same_rays_of_beams_at_the_edge(shift):
    rng = np.random.default_rng(3)
    beams = [(a + shift, b + shift, r) for a, b, r in some_beams(rng, 6)]
    depths = rng.uniform(0.3, 2.0, 24 * 24)
    scene = scene_of(beams, rng, depths=depths)
    assert_same(gathered(scene), gathered(scene, width=0))


@pytest.mark.parametrize("way", [(0, 0, 0.2), (0, 0.2, 0), (0.1, 0.1, 0.2)])
def test_gather__asks_the_same_rays_of_a_beam_that_is_near_and_thick(way):
    middle, way = np.array([0.6, 0.0, 0.0]), np.array(way)
    scene = scene_of([(middle - way, middle + way, 0.08)], np.random.default_rng(0), size=96)
    sums = gathered(scene)
    assert sums.flanks[0].sum(axis=1).min() > 100
    assert_same(sums, gathered(scene, width=0))


def test_gather__restores_its_scratch_and_adds_up():
    scene = random_scene(11)
    once = gathered(scene)
    twice = gathered(scene, sums=gathered(scene))
    np.testing.assert_allclose(twice.likelihood, 2 * once.likelihood, atol=1e-9)
    np.testing.assert_array_equal(twice.scans, 2 * once.scans)
    np.testing.assert_array_equal(twice.flanks, 2 * once.flanks)


@pytest.mark.parametrize("room", [0, 1, 40])
def test_gather__leaves_out_what_its_scratch_cannot_hold(room):
    scene = random_scene(12)
    sums = gathered(scene, room=room)
    assert sums.hits.sum() <= room


def test_gather__of_no_beams():
    scene = random_scene(13)
    for name in ("anchors", "directions", "us", "vs", "bows", "radii", "firsts", "lasts"):
        setattr(scene, name, getattr(scene, name)[:0])
    for name in ("ranks", "limits", "starts"):
        setattr(scene, name, getattr(scene, name)[:0])
    scene.fine_at = scene.coarse_at = np.zeros(1, np.int64)
    assert gathered(scene).likelihood.shape == (0,)


# --- case by case ---------------------------------------------------------------------


def told(beams, hypothesis, *, wall=np.inf, noise=(0.003, 0.0), seed=0):
    """What a camera that sees some beams tells of a hypothesis."""
    rng = np.random.default_rng(seed)
    seen = scene_of(as_beams(*beams), rng, wall=wall, noise=noise, size=48)
    asked = scene_of(as_beams(*hypothesis), rng, depths=np.zeros(48 * 48), noise=noise, size=48)
    asked.points = seen.points
    asked.ranks = np.arange(len(hypothesis))
    return asked, gathered(asked)


def by_beam(scene, values):
    return [
        float(values[first:last].sum())
        for first, last in zip(scene.fine_at[:-1], scene.fine_at[1:], strict=True)
    ]


def test_gather__a_beam_that_is_there_is_explained_up_to_its_ends():
    scene, sums = told([BEAM], [BEAM])
    along = scene.starts[0] + FINE * (np.arange(len(sums.hits)) + 0.5)
    assert sums.hits[np.abs(along) < 0.3].sum() > 20
    assert sums.hits[np.abs(along) > 0.31].sum() == 0
    assert sums.likelihood[np.abs(along) < 0.3].sum() > 3.0 * sums.hits.sum()
    assert sums.likelihood[np.abs(along) > 0.31].max() <= 0.0
    assert sums.likelihood[np.abs(along) > 0.31].sum() < -100.0
    assert sums.scans[0] == 1


@pytest.mark.parametrize("wall", [1.6, np.inf])
def test_gather__rays_see_through_a_beam_that_is_not_there(wall):
    _, sums = told([([1.0, 0.9, -0.3], [1.0, 0.9, 0.3], 0.05)], [BEAM], wall=wall)
    assert sums.hits.sum() == 0
    assert sums.likelihood.sum() < -200.0
    assert set(np.unique(sums.likelihood % 4.0)) == {0.0}
    assert sums.scans[0] == 0


def test_gather__returns_from_before_a_beam_say_nothing_of_it():
    _, sums = told([BEFORE], [([1.2, 0.0, -0.2], [1.2, 0.0, 0.2], 0.02)], wall=0.65)
    assert not sums.hits.any()
    assert not sums.likelihood.any()


def test_gather__a_beam_hidden_by_a_rival_is_neither_seen_nor_denied():
    hidden = ([1.2, 0.0, -0.2], [1.2, 0.0, 0.2], 0.02)
    scene, sums = told([BEFORE], [BEFORE, hidden])
    front, behind = by_beam(scene, sums.likelihood)
    assert front > 150.0
    assert behind == 0.0


def test_gather__noise_does_not_push_an_axis_away_from_its_neighbour():
    """Where a beam stands 5 sigmas before a wall of another, its rays count on both sides."""
    noise = 0.02
    behind = ([1.1, 0.0, -0.3], [1.1, 0.0, 0.3], 0.05)
    front = ([1.0, 0.0, -0.3], [1.0, 0.0, 0.3], 0.05)
    slopes = []
    for seed in range(12):
        scene, sums = told([front], [front, behind], noise=(noise, 0.0), seed=seed)
        rows = sums.normal[: scene.coarse_at[1]].sum(axis=0)
        u = scene.us[0]
        slopes.append((rows[9] * u[0] + rows[10] * scene.vs[0][0]) / rows[15])
    assert abs(np.mean(slopes)) < 3.0 * np.std(slopes) / np.sqrt(len(slopes))


@pytest.mark.parametrize(
    ("limits", "alone"), [((-1, -1), (1, 1)), ((-1, 0), (1, 0)), ((2, 2), (0, 0))]
)
def test_gather__twins_share_their_rays_by_rank(limits, alone):
    rng = np.random.default_rng(0)
    scene = scene_of(as_beams(BEAM, BEAM), rng, noise=(0.003, 0.0), size=48)
    scene.ranks, scene.limits = np.array([0, 1]), np.array(limits)
    sums = gathered(scene)
    assert tuple(int(hits > 0) for hits in by_beam(scene, sums.hits)) == alone
    assert tuple(sums.scans) == alone


def test_gather__a_pixel_of_unknown_direction_says_nothing():
    scene = random_scene(20)
    scene.points = recorded(np.full_like(scene.points, np.nan))
    scene.rays = np.zeros_like(scene.rays)
    sums = gathered(scene, width=0)
    assert not sums.likelihood.any()
    assert not sums.flanks.any()


def test_gather__a_wall_goes_on_beside_a_beam_and_air_does_not():
    _, free = told([BEAM], [BEAM])
    _, walled = told([([1.0, 0.9, -0.3], [1.0, 0.9, 0.3], 0.05)], [BEAM], wall=1.0)
    assert free.flanks[0, :, 0].sum() == 0
    assert free.flanks[0, :, 1].min() > 10
    assert walled.flanks[0, :, 1].sum() == 0
    assert walled.flanks[0, :, 0].min() > 10


@pytest.mark.parametrize(("excused", "held_against"), [(2, False), (-1, True)])
def test_gather__what_a_neighbour_explains_may_be_held_against_a_beam(excused, held_against):
    both = [BEAM, ([1.0, 0.13, -0.3], [1.0, 0.13, 0.3], 0.05)]
    scene, _ = told(both, both)
    scene.excused = np.array([excused, 2])
    one, other = gathered(scene).flanks
    assert bool(one[:, 0].sum() > 10) is held_against
    assert other[:, 0].sum() == 0


def test_gather__tells_of_flanks_where_along_the_axis_they_are():
    scene = random_scene(3)
    sums = gathered(scene)
    for j, (start, stop) in enumerate(pairwise(scene.coarse_at)):
        np.testing.assert_array_equal(sums.beside[start:stop].sum(axis=0), sums.flanks[j, :2])
        outside = np.ones(stop - start, np.bool_)
        first, last = ((s - scene.starts[j]) / COARSE for s in (scene.firsts[j], scene.lasts[j]))
        outside[int(first) : int(last) + 1] = False
        assert not sums.beside[start:stop][outside].any()


def test_gather__an_edge_goes_on_beside_a_beam_on_one_side_or_the_other():
    scene = random_scene(20, count=1)
    beside = np.array([[30.0, 2.0, 0.0, 40.0], [0.0, 28.0, 33.0, 3.0], [3.0, 0.0, 0.0, 9.0]])
    flanks = empty_sums(scene).flanks[0]
    for scan in beside:
        _add_flanks(flanks, scan)
        assert not scan.any()
    np.testing.assert_array_equal(flanks[:2], [[33.0, 30.0], [33.0, 52.0]])
    # Of the last scan three rays on a side are too few, but the other side is free.
    np.testing.assert_allclose(flanks[2], [72 * 30 / 32 + 64 * 33 / 36, 72 / 16 + 64 / 12 + 9])


def test_gather__a_place_that_rounds_up_to_the_end_stays_in_the_last_bin():
    start, bins, place = -1.7371404428141006, 416, -0.0731404428141005
    assert place < start + bins * FINE
    assert int((place - start) / FINE) == bins
    points, row = np.array([[0.95, 0.0, 0.0]]), np.ones((1, 1))
    scene = SimpleNamespace(
        points=points, rays=points / 0.95, width=0, image=np.zeros(4), noise=(0.005, 0.0),
        low=np.array([0.0, -2.0, -2.0]), high=np.full(3, 2.0),
        up=np.array([0.0, 0.0, 1.0]), height=1.0, floor=-np.inf, blur=0.0, footprint=0.0,
        anchors=row * [1.0, 0.0, -place], directions=row * [0.0, 0.0, 1.0],
        us=row * [1.0, 0.0, 0.0], vs=row * [0.0, 1.0, 0.0],
        bows=np.zeros((1, 3)), radii=np.array([0.05]),
        firsts=np.array([-1.0]), lasts=np.array([0.0]), ranks=np.zeros(1, np.int64),
        limits=np.ones(1, np.int64), excused=np.ones(1, np.int64), starts=np.array([start]),
        fine_at=np.array([0, bins]), coarse_at=np.array([0, bins // 5]), tukey=4.0, background=5.0,
    )  # fmt: skip
    hits = gathered(scene, flanks=False).hits
    assert np.flatnonzero(hits).tolist() == [bins - 1]
