"""Slow twins of the measures, by dense sampling and by trying everything."""

from __future__ import annotations

import itertools

import numpy as np

SAMPLES = 3_001


def measure(member, span, segment):
    """Mean distance, distance in the middle, angle and overlap of one segment and one member.

    `member` and `segment` are (2, 3) ends, `span` is metres along the member. The axis of the
    member is sampled; a sample has a partner where the plane square to the axis meets the
    segment.
    """
    length = np.linalg.norm(member[1] - member[0])
    direction = (member[1] - member[0]) / length
    step = segment[1] - segment[0]
    distances, places = [], []
    for t in np.linspace(span[0], span[1], SAMPLES):
        point = member[0] + t * direction
        s = (point - segment[0]) @ direction / (step @ direction)
        if 0.0 <= s <= 1.0:
            distances.append(np.linalg.norm(segment[0] + s * step - point))
            places.append(t)
    cosine = abs(step @ direction) / np.linalg.norm(step)
    angle = np.degrees(np.arccos(min(cosine, 1.0)))
    if not places:
        return np.inf, np.inf, angle, 0.0
    return np.mean(distances), distances[len(distances) // 2], angle, places[-1] - places[0]


def assign(cost, allowed):
    """Most pairs, then least cost: (number, cost), by trying every assignment."""
    n_rows, n_columns = cost.shape
    best = (0, 0.0)
    for n in range(1, min(n_rows, n_columns) + 1):
        for rows in itertools.combinations(range(n_rows), n):
            for columns in itertools.permutations(range(n_columns), n):
                if allowed[rows, columns].all():
                    total = cost[rows, columns].sum()
                    if n > best[0] or total < best[1]:
                        best = (n, total)
    return best
