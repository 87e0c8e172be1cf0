"""Where rays put the ends of beams: the kernel beside its slow twin, and case by case."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.cylinder.end_kernels import gather_ends
from tests.cylinder.naive import entry_depth, finite_interval, line_distance
from tests.cylinder.scenes import cylinders_of, meetings_of, scene_of, some_beams, view_of

PLACES = np.arange(-20.0, 21.0) * 0.002


def told(scene):
    likelihood = np.zeros((len(scene.radii), 2, len(PLACES)))
    meetings = meetings_of(len(scene.points))
    view, beams = view_of(scene, scene.width), cylinders_of(scene)
    gather_ends(view, beams, PLACES, likelihood, scene.background, meetings)
    assert (meetings.head == -1).all()
    return likelihood


def naive_told(scene):
    """Ask every ray about every place of every end; far from an end it is all the same."""
    likelihood = np.zeros((len(scene.radii), 2, len(PLACES)))
    for point, ray in zip(scene.points.astype(float), scene.rays, strict=True):
        depth = float(np.linalg.norm(point))
        returned = np.isfinite(depth) and depth > 0
        w, depth = (point / depth, depth) if returned else (ray, np.inf)
        caps = [
            _depth(w, scene, j, scene.firsts[j], scene.lasts[j]) for j in range(len(scene.radii))
        ]
        for j, radius in enumerate(scene.radii):
            a, b = scene.anchors[j], scene.directions[j]
            entry = entry_depth(w, a, b, radius)
            s = (entry * w - a) @ b
            stop = scene.starts[j] + (scene.fine_at[j + 1] - scene.fine_at[j]) * 0.004
            if not (entry > 0 and scene.starts[j] <= s < stop and _counts(scene, entry * w)):
                continue
            rivals = [t for o, t in enumerate(caps) if o != j and np.isfinite(t)]
            noise, relative = scene.noise
            sigma = np.hypot(noise, relative * entry * w[0]) / w[0]
            best = np.min(np.abs(depth - np.array(rivals)) / sigma, initial=np.inf)
            edge = abs(line_distance(w, a, b)[0]) / radius
            for which in range(2):
                near = (
                    s < scene.firsts[j] + PLACES[-1]
                    if which == 0
                    else s > scene.lasts[j] + PLACES[0]
                )
                if not near:
                    continue
                for n, place in enumerate(PLACES):
                    first = scene.firsts[j] + (place if which == 0 else 0.0)
                    last = scene.lasts[j] + (place if which == 1 else 0.0)
                    own = _depth(w, scene, j, first, last)
                    hidden = min(rivals, default=np.inf) <= own
                    residual = (depth - own) / sigma
                    if not np.isfinite(own) or hidden or residual < -4:
                        continue
                    if residual > 4:
                        likelihood[j, which, n] -= 4 * (edge < 0.8)
                        continue
                    costs = [min(0.5 * e**2, scene.background) for e in (best, residual)]
                    likelihood[j, which, n] += costs[0] - costs[1]
    return likelihood


def _depth(w, scene, j, first, last):
    met = finite_interval(w, scene.anchors[j], scene.directions[j], first, last, scene.radii[j])
    return np.inf if met is None else met[0]


def _counts(scene, place):
    inside = np.all((scene.low <= place) & (place <= scene.high))
    return inside and scene.up @ place + scene.height >= scene.floor


@pytest.mark.parametrize("seed", range(3))
def test_gather_ends__agrees_with_its_twin(seed):
    rng = np.random.default_rng(seed)
    beams = some_beams(rng, 3)
    seen = scene_of(beams, rng, wall=rng.choice([1.6, np.inf]))
    moved = [(a + rng.normal(0, 0.01, 3), b + rng.normal(0, 0.01, 3), r) for a, b, r in beams]
    scene = scene_of(moved, rng, depths=np.zeros(len(seen.rays)))
    scene.points = seen.points
    found = told(scene)
    assert np.abs(np.diff(found)).max() > 1.0
    np.testing.assert_allclose(found, naive_told(scene), atol=1e-4)


@pytest.mark.parametrize("length", [0.28, 0.30, 0.33])
@pytest.mark.parametrize("lean", [0.0, 0.25])
def test_gather_ends__is_likeliest_where_the_end_is(length, lean):
    """The beam is thought to end at 0.3; leaning towards the camera, its cap is in view."""
    rng = np.random.default_rng(0)
    way = np.array([-lean, 0.0, 1.0]) / np.hypot(1.0, lean)
    start = np.array([1.0, 0.0, -0.3])
    noise = (0.003, 0.0)
    seen = scene_of([(start, start + (0.3 + length) * way, 0.05)], rng, noise=noise, size=96)
    asked = scene_of(
        [(start, start + 0.6 * way, 0.05)], rng, depths=np.zeros(96 * 96), noise=noise, size=96
    )
    asked.points = seen.points
    best = PLACES[told(asked)[0, 1].argmax()]
    assert best == pytest.approx(length - 0.3, abs=0.021)  # a pixel
