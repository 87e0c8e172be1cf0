"""Slow, obvious twins of the method: plain numpy and Python, written from the papers.

Nothing here is taken from the kernels. The Hough twin follows Dalitz, Schramke and
Jeltsch, IPOL 2017 (algorithms 1 and 2, equations 2 and 3) with one dense accumulator;
the rest follows the formulas of the report, sections 3.2.2 to 3.2.7.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

# --- directions -----------------------------------------------------------------------


def sphere_directions(granularity):
    """All vertices of the subdivided icosahedron, both halves, as unit rows, in any order."""
    golden = (1.0 + math.sqrt(5.0)) / 2.0
    corners = []
    for one in (-1.0, 1.0):
        for phi in (-golden, golden):
            corners += [(0.0, one, phi), (one, phi, 0.0), (phi, 0.0, one)]
    corners = [np.array(corner) / np.linalg.norm(corner) for corner in corners]
    edge = min(np.linalg.norm(corners[0] - other) for other in corners[1:])
    faces = [
        (a, b, c)
        for i, a in enumerate(corners)
        for j, b in enumerate(corners[:i])
        for c in corners[:j]
        if all(abs(np.linalg.norm(p - q) - edge) < 1e-9 for p, q in ((a, b), (b, c), (c, a)))
    ]
    assert len(faces) == 20
    for _ in range(granularity):
        smaller = []
        for a, b, c in faces:
            ab, bc, ca = ((p + q) / np.linalg.norm(p + q) for p, q in ((a, b), (b, c), (c, a)))
            smaller += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = smaller
    unique = {tuple(np.round(corner, 9) + 0.0): corner for face in faces for corner in face}
    return np.array(list(unique.values()))


# --- iterative Hough transform --------------------------------------------------------


@dataclass
class Line:
    """One line of the twin, and whether rounding could have decided it otherwise."""

    votes: int
    cell: int
    cell_anchor: np.ndarray
    cell_direction: np.ndarray
    anchor: np.ndarray
    direction: np.ndarray
    indices: list
    fragile: bool


def plane_coordinates(point, directions):
    """Equation (2): where the lines through a point in all directions cross their planes."""
    bx, by, bz = directions.T
    beta = 1 / (1 + bz)
    x = ((1 - (beta * (bx * bx))) * point[0]) - ((beta * (bx * by)) * point[1]) - (bx * point[2])
    y = ((-beta * (bx * by)) * point[0]) + ((1 - (beta * (by * by))) * point[1]) - (by * point[2])
    return x, y


def rounded_half_away(value):
    return np.where(value > 0, np.floor(value + 0.5), np.ceil(value - 0.5))


def voted_cells(point, directions, max_x, dx, num_x):
    """Flat index of the cell in each direction; only the flat bound is checked."""
    x, y = plane_coordinates(point, directions)
    column = rounded_half_away((x + max_x) / dx).astype(np.int64)
    row = rounded_half_away((y + max_x) / dx).astype(np.int64)
    num_b = len(directions)
    flat = (column * num_x + row) * num_b + np.arange(num_b)
    return flat[flat < num_x * num_x * num_b], row


def anchor_of(x, y, direction):
    """Equation (3): the point of a line that is nearest to the origin."""
    bx, by, bz = direction
    return np.array(
        [
            x * (1 - bx * bx / (1 + bz)) - y * (bx * by / (1 + bz)),
            -x * (bx * by / (1 + bz)) + y * (1 - by * by / (1 + bz)),
            -x * bx - y * by,
        ]
    )


def line_distances(points, anchor, direction):
    points = np.reshape(points, (-1, 3))
    return np.array(
        [np.linalg.norm(p - (anchor + ((p - anchor) @ direction) * direction)) for p in points]
    )


def least_squares(points):
    """Mean, first eigenvector, largest eigenvalue, and whether the eigenvector is unique."""
    mean = points.mean(axis=0)
    centred = points - mean
    values, vectors = np.linalg.eigh(centred.T @ centred)
    unique = values[2] - values[1] > 1e-6 * values[2]
    return mean, vectors[:, 2], values[2], unique


def iterative_hough(points, directions, *, dx=None, minvotes=2, nlines=0):
    """Lines as in the published program, with one dense accumulator.

    `directions` come in the published order, which breaks ties.
    """
    points = np.array(points, dtype=np.float64)
    lines = []
    if len(points) < 2:
        return lines
    low, high = points.min(axis=0), points.max(axis=0)
    diagonal = np.linalg.norm(high - low)
    dx = diagonal / 64 if dx is None else dx
    if diagonal == 0 or dx >= diagonal:
        return lines
    shift = (low + high) / 2
    points -= shift
    max_x = max(np.linalg.norm(points.min(axis=0)), np.linalg.norm(points.max(axis=0)))
    num_x = int(rounded_half_away(2 * max_x / dx))
    num_b = len(directions)
    accumulator = np.zeros(num_x * num_x * num_b, dtype=np.int64)
    votes_of = [voted_cells(point, directions, max_x, dx, num_x)[0] for point in points]
    for cells in votes_of:
        accumulator[cells] += 1
    left = list(range(len(points)))
    while len(left) > 1 and (nlines == 0 or len(lines) < nlines):
        winner = int(np.argmax(accumulator))
        votes = int(accumulator[winner])
        column, row = divmod(winner // num_b, num_x)
        cell_direction = directions[winner % num_b]
        cell_anchor = anchor_of(column * dx - max_x, row * dx - max_x, cell_direction)
        anchor, direction, fragile = cell_anchor, cell_direction, False
        for fewest in (1, max(minvotes, 1)):
            distances = line_distances(points[left], anchor, direction)
            fragile |= bool(np.any(np.abs(distances - dx) < 1e-9 * diagonal))
            close = [i for i, distance in zip(left, distances, strict=True) if distance <= dx]
            if len(close) < fewest:
                return lines
            anchor, direction, largest, unique = least_squares(points[close])
            fragile |= not unique
            # Copies of one point may differ from their mean by a rounding error.
            if largest <= 1e-28 * diagonal * diagonal:
                return lines
        lines.append(
            Line(
                votes, winner, cell_anchor + shift, cell_direction,
                anchor + shift, direction, close, fragile,
            )
        )  # fmt: skip
        for i in close:
            accumulator[votes_of[i]] -= 1
        left = [i for i in left if i not in set(close)]
    return lines


# --- pre-processing -------------------------------------------------------------------


def voxel_means(points, leaf):
    """Mean of the points of each voxel by voxel index (PCL: floor(x * (1 / leaf)))."""
    voxels = {}
    for point in np.asarray(points, dtype=np.float64):
        index = tuple(math.floor(value * (1.0 / leaf)) for value in point)
        voxels.setdefault(index, []).append(point)
    return {index: np.mean(members, axis=0) for index, members in voxels.items()}


def cropped(points, low, high):
    points = np.asarray(points, dtype=np.float64)
    returns = points[np.isfinite(points).all(axis=1)]
    return returns, returns[((returns >= low) & (returns <= high)).all(axis=1)]


def rotated(quaternion_xyzw, vector):
    """``q v q*`` by quaternion products."""

    def product(p, q):
        (px, py, pz, pw), (qx, qy, qz, qw) = p, q
        return np.array(
            [
                pw * qx + px * qw + py * qz - pz * qy,
                pw * qy - px * qz + py * qw + pz * qx,
                pw * qz + px * qy - py * qx + pz * qw,
                pw * qw - px * qx - py * qy - pz * qz,
            ]
        )

    q = np.asarray(quaternion_xyzw) / np.linalg.norm(quaternion_xyzw)
    conjugate = q * np.array([-1.0, -1.0, -1.0, 1.0])
    return product(product(q, np.append(vector, 0.0)), conjugate)[:3]


# --- screening ------------------------------------------------------------------------


def principal_axis(points):
    """Mean, axis, PCA coefficient and eigenvalues of the covariance, largest first."""
    values, vectors = np.linalg.eigh(np.cov(points.T))
    return points.mean(axis=0), vectors[:, 2], values[2] / values.sum(), values[::-1]


def failed_criteria(points, radius, leaf, min_pca_coeff, max_gap_factor=2.0):
    """Which of the four criteria of section 3.2.4 a line fails, as they are written."""
    diag_voxel = math.sqrt(3) * leaf
    mean, axis, pca_coeff, _ = principal_axis(points)
    t = sorted((point - mean) @ axis for point in points)
    fewest = 2 * radius * (t[-1] - t[0]) / ((radius / leaf) * 2 * diag_voxel * 2 * diag_voxel)
    failed = []
    if len(points) < fewest:
        failed.append("too_few_points")
    if abs(line_distances(points, mean, axis).max() - radius) >= diag_voxel:
        failed.append("wrong_radius")
    if max(b - a for a, b in itertools.pairwise(t)) > max_gap_factor * diag_voxel:
        failed.append("gap")
    if pca_coeff < min_pca_coeff:
        failed.append("low_pca_coeff")
    return failed


def stretch_of_most_metres(ordered, max_gap):
    """Start and stop of the longest stretch without a gap: all stretches, the first of equals."""
    stretches = [
        (start, stop)
        for start in range(len(ordered))
        for stop in range(start + 1, len(ordered) + 1)
        if all(b - a <= max_gap for a, b in itertools.pairwise(ordered[start:stop]))
    ]
    # Points that coincide belong to the stretch, so of equal lengths the one with most points.
    return max(
        stretches,
        key=lambda s: (ordered[s[1] - 1] - ordered[s[0]], -s[0], s[1]),
    )


# --- similarity and fusion ------------------------------------------------------------
# Segments are anything with anchor a, direction b, t_min, t_max, radius, n_points,
# pca_coeff and pca_eig.


def ends(segment):
    return (
        segment.t_min * segment.direction + segment.anchor,
        segment.t_max * segment.direction + segment.anchor,
    )


def middle(segment):
    half = (segment.t_max - segment.t_min) / 2 + segment.t_min
    return half * segment.direction + segment.anchor


def projection(segment, point):
    a, b = segment.anchor, segment.direction
    return a + ((point - a) @ b) / (b @ b) * b


def similar_by_parameters(known, new, T_a, T_b, T_p):
    away = min(
        np.linalg.norm(new.direction - known.direction),
        np.linalg.norm(new.direction + known.direction),
    )
    return (
        np.linalg.norm(new.anchor - known.anchor) <= T_a
        and away <= T_b
        and np.linalg.norm(middle(new) - middle(known)) <= T_p
    )


def similar_by_midpoint(known, new, T_d, T_p):
    return (
        abs(known.direction @ new.direction) >= T_d
        and np.linalg.norm(middle(new) - middle(known)) <= T_p
    )


def similar_by_projection(known, new, diag_voxel):
    epsilon = 2 * diag_voxel + known.radius + new.radius
    away = [np.linalg.norm(end - projection(known, end)) for end in ends(new)]
    return max(away) <= epsilon and known.radius == new.radius


def fused_line(known, new, f):
    """Anchor and (normalised) direction of the fused segment for a share `f` of the new."""
    e1, e2 = ends(new)
    q1, q2 = projection(known, e1), projection(known, e2)
    anchor = q1 + f * (e1 - q1)
    direction = (q2 - q1) + f * ((e2 - q2) - (e1 - q1))
    return anchor, direction / np.linalg.norm(direction)


def fusion_share(known, new, min_weight):
    """``w`` and ``f`` of solution 2."""
    w = max(new.n_points / (known.n_points + new.n_points), min_weight)
    return w, new.pca_coeff * w / (known.pca_coeff * (1 - w) + new.pca_coeff * w)


# --- intersections --------------------------------------------------------------------


def intersection(one, two, epsilon, parallel_norm=1e-3):
    """Algorithm 2 for one pair: (t1, t2, point, d) or None, by solving the 3x3 system.

    ``t1`` and ``t2`` count from the anchors, as everywhere in our tables.
    """
    n = np.cross(one.direction, two.direction)
    if np.linalg.norm(n) <= parallel_norm:
        return None
    start_1, start_2 = ends(one)[0], ends(two)[0]
    matrix = np.column_stack([one.direction, -two.direction, n / np.linalg.norm(n)])
    u1, u2, d = np.linalg.solve(matrix, start_2 - start_1)
    t1, t2 = u1 + one.t_min, u2 + two.t_min
    inside = one.t_min <= t1 <= one.t_max and two.t_min <= t2 <= two.t_max
    if abs(d) > epsilon or not inside:
        return None
    point = 0.5 * (one.anchor + t1 * one.direction + two.anchor + t2 * two.direction)
    return t1, t2, point, abs(d)


# --- thinned cloud --------------------------------------------------------------------


def first_in_their_cells(points, cell_size, held=()):
    """Which points are the first in their cell, of those that are not held, and all cells."""
    cells, first = set(held), []
    for point in points:
        cell = tuple(math.floor(float(value) / cell_size) for value in point)
        first.append(cell not in cells)
        cells.add(cell)
    return first, cells
