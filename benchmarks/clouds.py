"""Clouds to search: random ones, and every kind of degenerate one."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

__all__ = ["KINDS", "random_cloud"]

Cloud = NDArray[np.float64]
Rng = np.random.Generator


def _uniform(rng: Rng, size: int) -> Cloud:
    return rng.uniform(-1.0, 1.0, (size, 3)) * rng.uniform(0.05, 1.0, 3)


def _beams(rng: Rng, size: int) -> Cloud:
    parts = []
    for _ in range(rng.integers(1, 5)):
        start, end = rng.uniform(-1.0, 1.0, (2, 3))
        along = rng.uniform(0.0, 1.0, (size // 4 + 2, 1))
        noise = rng.normal(0.0, rng.choice([0.0, 0.01, 0.05]), (len(along), 3))
        parts.append(start + along * (end - start) + noise)
    return np.concatenate(parts)


def _collinear(rng: Rng, size: int) -> Cloud:
    start, step = rng.uniform(-1.0, 1.0, (2, 3))
    return start + np.outer(rng.uniform(-1.0, 1.0, size), step)


def _coplanar(rng: Rng, size: int) -> Cloud:
    cloud = _uniform(rng, size)
    cloud[:, rng.integers(3)] = rng.uniform(-1.0, 1.0)
    return cloud


def _lattice(rng: Rng, size: int) -> Cloud:
    """Many cells with the same number of votes, so that ties decide."""
    side = max(round(size ** (1 / 3)), 2)
    axes = np.arange(side) * rng.choice([0.1, 0.125, 0.25])
    return np.stack(np.meshgrid(axes, axes, axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _two_points(rng: Rng, _size: int) -> Cloud:
    return rng.uniform(-1.0, 1.0, (2, 3))


def _duplicates(rng: Rng, size: int) -> Cloud:
    few = _uniform(rng, max(size // 4, 2))
    return few[rng.integers(len(few), size=size)]


def _cell_edges(rng: Rng, size: int) -> Cloud:
    """Coordinates at multiples of half a cell, where a vote belongs to either."""
    return rng.integers(-16, 17, (size, 3)) / 32.0


KINDS: Mapping[str, Callable[[Rng, int], Cloud]] = {
    "uniform": _uniform,
    "beams": _beams,
    "collinear": _collinear,
    "coplanar": _coplanar,
    "lattice": _lattice,
    "two points": _two_points,
    "duplicates": _duplicates,
    "cell edges": _cell_edges,
}
"""Makers of clouds by name; each takes a generator and about how many points."""


def random_cloud(seed: int) -> tuple[str, Cloud, dict[str, float | int | None]]:
    """Make one cloud and the parameters to search it with.

    Parameters
    ----------
    seed : int

    Returns
    -------
    str
        Its kind, one of `KINDS`.
    (N, 3) float64
        Scaled by 1e-6, 1 or 1e6.
    dict
        Keyword arguments of `beamseg_batch.detection.iterative_hough`.
    """
    rng = np.random.default_rng(seed)
    kind = list(KINDS)[seed % len(KINDS)]
    scale = rng.choice([1e-6, 1.0, 1.0, 1e6])
    cloud = KINDS[kind](rng, int(rng.integers(2, 90))) * scale
    granularity = int(rng.choice(7, p=[0.2, 0.2, 0.2, 0.2, 0.15, 0.04, 0.01]))
    dx = None if rng.uniform() < 0.3 else float(rng.choice([1 / 32, 1 / 16, 0.1]) * scale)
    minvotes, nlines = int(rng.integers(2, 6)), int(rng.choice([0, 3]))
    parameters = {"granularity": granularity, "dx": dx, "minvotes": minvotes, "nlines": nlines}
    return kind, np.ascontiguousarray(cloud), parameters
