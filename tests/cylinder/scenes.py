"""Random beams before a camera, and the arrays that the evidence kernel asks for."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from beamseg_batch.cylinder.evidence_kernels import (
    COARSE,
    FINE,
    NORMAL_COLUMNS,
    Evidence,
    gather,
)
from beamseg_batch.cylinder.meeting_kernels import Cylinders, Meetings, View
from beamseg_batch.geometry import normalised
from tests.cylinder.naive import frame_of
from tests.rays import camera_rays, seen_depths

SIZE = 24
NOISE = (0.005, 0.003)
MARGIN = 0.3


def image_of(width, height):
    """Scale of the image of `camera_rays`."""
    return np.array([1.0, -2.0 / (width - 1), 1.0, -2.0 / (height - 1)])


def some_beams(rng, count):
    """Ends and radius of beams that lie well before the camera."""
    beams = []
    for _ in range(count):
        middle = np.array([rng.uniform(0.9, 1.4), *rng.uniform(-0.5, 0.5, 2)])
        way = normalised(rng.normal(size=3) * (0.5, 1.0, 1.0)) * rng.uniform(0.2, 0.5)
        beams.append((middle - way, middle + way, rng.uniform(0.03, 0.08)))
    return beams


def recorded(points):
    """Points as those of a recording are kept: single precision, read only."""
    points = np.array(points, np.float32)
    points.flags.writeable = False
    return points


def scene_of(beams, rng, *, size=SIZE, noise=NOISE, wall=np.inf, depths=None):
    """All that `gather` takes, for a camera at the origin that sees these beams."""
    rays = camera_rays(size, size)
    if depths is None:
        depths = np.min([seen_depths(np.zeros(3), rays, *beam) for beam in beams], axis=0)
        depths = np.minimum(depths, wall / rays[:, 0])
        with np.errstate(invalid="ignore"):
            forward = np.hypot(noise[0], noise[1] * depths * rays[:, 0])
            depths = depths + rng.normal(size=len(rays)) * forward / rays[:, 0]
    points = rays * np.where(np.isfinite(depths), depths, np.nan)[:, None]
    starts, ends, radii = (np.array(column) for column in zip(*beams, strict=True))
    lengths = np.linalg.norm(ends - starts, axis=1)
    directions = (ends - starts) / lengths[:, None]
    bins = np.ceil((lengths + 2 * MARGIN) / COARSE).astype(np.int64)
    coarse_at = np.concatenate([[0], np.cumsum(bins)])
    frames = np.array([frame_of(direction) for direction in directions])
    return SimpleNamespace(
        points=recorded(points), rays=rays, width=size, image=image_of(size, size), noise=noise,
        low=np.array([0.3, -1.5, -1.5]), high=np.array([2.0, 1.5, 1.5]),
        up=np.array([0.0, 0.0, 1.0]), height=1.0, floor=-np.inf, blur=0.0, footprint=0.0,
        anchors=(starts + ends) / 2, directions=directions,
        us=frames[:, 0].copy(), vs=frames[:, 1].copy(), bows=np.zeros((len(beams), 3)), radii=radii,
        firsts=-lengths / 2, lasts=lengths / 2,
        ranks=rng.permutation(len(beams)), limits=np.full(len(beams), len(beams)),
        excused=np.full(len(beams), len(beams)),
        starts=-lengths / 2 - MARGIN, fine_at=coarse_at * round(COARSE / FINE),
        coarse_at=coarse_at, tukey=4.0, background=5.0,
    )  # fmt: skip


def view_of(scene, width):
    """What the kernels take as a scan."""
    return View(
        recorded(scene.points), scene.rays, width, scene.image, *scene.noise,
        scene.low, scene.high, scene.up, scene.height, scene.floor, scene.blur,
        scene.footprint,
    )  # fmt: skip


def cylinders_of(scene):
    """What the kernels take as beams."""
    stops = scene.starts + np.diff(scene.fine_at) * FINE
    return Cylinders(
        scene.anchors, scene.directions, scene.us, scene.vs, scene.bows, scene.radii,
        scene.firsts, scene.lasts, scene.starts, stops, scene.ranks, scene.limits, scene.excused,
    )  # fmt: skip


def meetings_of(count, room=None):
    """Scratch of the kernels."""
    room = 4 * count + 64 if room is None else room
    return Meetings(
        np.full(count, -1), np.empty(count, np.int64),
        np.empty(room, np.int64), np.empty(room, np.int64),
        *(np.empty(room) for _ in range(7)),
    )  # fmt: skip


def empty_sums(scene, *, flanks=True):
    """Sums of the kernel, nothing in them."""
    count = len(scene.anchors)
    return Evidence(
        fine_at=scene.fine_at,
        coarse_at=scene.coarse_at,
        likelihood=np.zeros(scene.fine_at[-1]),
        hits=np.zeros(scene.fine_at[-1]),
        normal=np.zeros((scene.coarse_at[-1], NORMAL_COLUMNS)),
        scans=np.zeros(count, np.int64),
        flanks=np.zeros((count if flanks else 0, 3, 2)),
        beside=np.zeros((scene.coarse_at[-1] if flanks else 0, 2, 2)),
        scatter=np.zeros((count, 7, 7)),
        asked=np.zeros(count, np.int64),
    )


def gathered(scene, *, flanks=True, width=None, room=None, sums=None, run=gather):
    """Sums of the kernel, which leaves its scratch as it was."""
    sums = sums or empty_sums(scene, flanks=flanks)
    count = len(scene.anchors)
    meetings = meetings_of(len(scene.points), room)
    alone, scores = np.zeros(count, np.int64), np.zeros((count, 11))
    view = view_of(scene, scene.width if width is None else width)
    run(view, cylinders_of(scene), sums, scene.tukey, scene.background, meetings, alone, scores)
    assert (meetings.head == -1).all()
    assert not alone.any()
    assert not scores.any()
    return sums
