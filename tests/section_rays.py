"""Rays that pass a cross-section, made without any kernel."""

from __future__ import annotations

import numpy as np

REACH, WORST = 0.15, 4.8


def entries(section, x, d):
    """Where lines enter a section about its centre of area, in its own axes; inf beside it."""
    if section.shape == "round":
        beside = x[:, 0] * d[:, 1] - x[:, 1] * d[:, 0]
        with np.errstate(invalid="ignore"):
            root = np.sqrt(section.radius**2 - beside**2)
        return np.where(np.isnan(root), np.inf, -(x * d).sum(axis=1) - root)
    found = np.full(len(x), np.inf)
    for u, v, width, height in section.plates():
        half = np.array([width, height]) / 2.0
        with np.errstate(divide="ignore", invalid="ignore"):
            sides = (np.array([u, v]) + np.array([-half, half])[:, None] - x) / d
        enters, leaves = np.sort(sides, axis=0)
        first, last = enters.max(axis=1), leaves.min(axis=1)
        found = np.minimum(found, np.where(first <= last, first, np.inf))
    return found


def first_of_solid(section, x, d, s, rise, ends):
    """Where rays enter a member that may end: tried at steps of 1 mm where it does."""
    stretch = np.linalg.norm(d, axis=1)
    depths = entries(section, x, d / stretch[:, None]) / stretch
    if np.isinf(ends).all():
        return depths
    steps = np.arange(-0.12, 0.12, 0.001)
    found = np.full(len(x), np.inf)
    for t in steps[::-1]:
        along = s + t * rise
        inside = holds(section, x + t * d) & (along >= ends[0]) & (along <= ends[1])
        found[inside] = t
    return found


def holds(section, points):
    """Whether points lie in a section about its centre of area, in its own axes."""
    if section.shape == "round":
        return np.linalg.norm(points, axis=1) <= section.radius
    return np.any(
        [
            (np.abs(points - (u, v)) <= (width / 2.0, height / 2.0)).all(axis=1)
            for u, v, width, height in section.plates()
        ],
        axis=0,
    )


def rays_at(
    section, *, roll=0.4, centre=(0.01, -0.015), noise=0.008, seed=1, views=None, scans=90, each=30,
    slopes=(0.0, 0.0), ends=(-np.inf, np.inf), reach_along=0.6,
):  # fmt: skip
    """(N, 10) rays as `gather_near` gives them, from all around or from the `views`, radians.

    The section leans by `slopes` against the axis that the rays are about, and may end.
    """
    rng = np.random.default_rng(seed)
    around = 2.0 * np.pi * np.arange(scans) / scans if views is None else np.resize(views, scans)
    turns = np.repeat(around, each) + rng.uniform(-0.15, 0.15, scans * each)
    beside = rng.uniform(-REACH, REACH, len(turns))
    d = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    x = beside[:, None] * np.stack([-d[:, 1], d[:, 0]], axis=1) - np.array(centre)
    cos, sin = np.cos(roll), np.sin(roll)
    own = np.array([[cos, -sin], [sin, cos]])
    errors = rng.normal(0.0, noise, len(turns))
    s, drawn = rng.uniform(-reach_along, reach_along, len(turns)), rng.random(len(turns))
    rise = rng.uniform(-0.7, 0.7, len(turns))
    depths = first_of_solid(
        section, (x - np.outer(s, slopes)) @ own, (d - np.outer(rise, slopes)) @ own, s, rise, ends
    )
    rays = np.zeros((len(turns), 10))
    rays[:, :2], rays[:, 2], rays[:, 4] = d, beside, noise
    rays[:, 3] = depths + errors
    rays[:, 5], rays[:, 9] = s, rise
    rays[:, 7] = np.repeat(np.arange(scans), each)
    rays[:, 8] = drawn
    return rays
