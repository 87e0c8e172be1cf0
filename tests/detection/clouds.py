"""Small clouds for the Hough search: random ones, and those where rounding and ties bite."""

from __future__ import annotations

import numpy as np


def noisy_line(rng, count, start, end, noise):
    t = rng.uniform(size=(count, 1))
    return np.asarray(start) * (1 - t) + np.asarray(end) * t + rng.normal(0, noise, (count, 3))


def uniform(rng):
    return rng.uniform(-1, 1, (60, 3))


def beams(rng):
    return np.concatenate(
        [
            noisy_line(rng, 40, [1, -0.6, -0.4], [0.9, 0.7, 0.5], 0.01),
            noisy_line(rng, 30, [0.5, 0.4, -0.8], [1.2, 0.3, 0.9], 0.01),
            noisy_line(rng, 15, [0.7, -0.5, 0.5], [0.7, 0.5, 0.5], 0.01),
            rng.uniform([0, -1, -1], [1.5, 1, 1], (15, 3)),
        ]
    )


def collinear_x(rng):
    return np.outer(np.arange(20), [0.1, 0, 0])


def collinear_diagonal(rng):
    return np.outer(rng.permutation(17), [0.25, 0.25, 0.25]) + np.array([3, -2, 1])


def collinear_down(rng):
    return np.outer(rng.uniform(-1, 1, 25), [0.2, 0.3, -0.9])


def coplanar(rng):
    return np.column_stack([rng.uniform(-1, 1, (50, 2)), np.full(50, 0.75)])


def plane_lattice(rng):
    x, y = np.meshgrid(np.arange(6.0), np.arange(4.0))
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(24)])


def space_lattice(rng):
    x, y, z = np.meshgrid(np.arange(4.0), np.arange(3.0), np.arange(5.0))
    return np.column_stack([x.ravel(), y.ravel(), z.ravel()])


def square_lattice(rng):
    x, y = np.meshgrid(np.arange(5.0), np.arange(5.0))
    return np.column_stack([np.zeros(25), x.ravel(), y.ravel()])


def two_points(rng):
    return np.array([[0.3, -0.2, 0.9], [1.1, 0.4, -0.6]])


def two_copies_each(rng):
    return np.repeat(noisy_line(rng, 20, [0, 0, 0], [1, 2, 3], 0.05), 2, axis=0)


def copies_beside_a_line(rng):
    copies = np.tile([0.1, 0.7, 0.3], (9, 1))
    return np.concatenate([copies, noisy_line(rng, 12, [1, 1, 1], [2, 1, 3], 0.02)])


def cell_edges(rng):
    """Half extents 2, 1, 2, so the reach is 3; multiples of 1/8 are edges of 1/4 m cells."""
    corners = np.array([[2.0, 1.0, 2.0], [-2.0, -1.0, -2.0]])
    steps = rng.integers([-15, -7, -15], [16, 8, 16], (60, 3)) / 8.0
    return np.concatenate([corners, steps])


def cross(rng):
    t = np.linspace(-1, 1, 21)
    zero = np.zeros(21)
    return np.concatenate([np.column_stack([t, zero, zero]), np.column_stack([zero, t, zero])])


def tiny(rng):
    return beams(rng) * 1e-6


def huge(rng):
    return beams(rng) * 1e6


def far_away(rng):
    return beams(rng) + np.array([512.0, -1024.0, 256.0])


CLOUDS = (
    uniform, beams, collinear_x, collinear_diagonal, collinear_down, coplanar, plane_lattice,
    space_lattice, square_lattice, two_points, two_copies_each, copies_beside_a_line,
    cell_edges, cross, tiny, huge, far_away,
)  # fmt: skip


def make(cloud):
    return np.asarray(cloud(np.random.default_rng(20170712)), dtype=np.float64)
