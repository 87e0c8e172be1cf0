"""Sums as rays would give them that hit all along an axis, in no time."""

from __future__ import annotations

import numpy as np

from beamseg_batch.cylinder.evidence_kernels import COARSE, FINE
from beamseg_batch.structure.hypothesis import Sums

NOISE = 0.005


def told(one, offset, **how):
    """Sums of rays that hit all along an axis which lies off the beam's; see `told_of`."""
    return told_of([one], [offset], **how)


def told_of(beams, offsets, *, per_bin=40, noise=0.0, seed=0, like=4.0, thicker=0.0, tukey=np.inf):
    """Sums of rays that hit all along axes which lie off those of some beams, by their place.

    Each offset gives (u, v), metres along the beam's normals from its axis, for places
    along its chord; all are thicker by so many metres than they are taken for. Rays count with
    Tukey's weight, as far as that reaches.
    """
    rng, sums = np.random.default_rng(seed), Sums(beams)
    for index, (one, offset) in enumerate(zip(beams, offsets, strict=True)):
        middles = sums.starts[index] + COARSE * (np.arange(len(sums.coarse(index))) + 0.5)
        likelihood, hits = sums.fine(index)
        places = sums.starts[index] + FINE * (np.arange(len(hits)) + 0.5)
        inside = (places > one.first) & (places < one.last)
        hits[inside], likelihood[inside] = per_bin / 5, like * per_bin / 5
        likelihood[~inside] = -4.0
        for row, s in zip(sums.coarse(index), middles, strict=True):
            if not one.first < s < one.last:
                continue
            turn = rng.uniform(0, 2 * np.pi, per_bin)
            u, v = np.cos(turn) / NOISE, np.sin(turn) / NOISE
            r = np.full(per_bin, 1.0 / NOISE)
            e = np.stack([u, v], axis=1) @ offset(s) + r * thicker
            e += noise * rng.normal(size=per_bin)
            w = (1.0 - np.minimum(np.abs(e) / tukey, 1.0) ** 2) ** 2
            su, sv = s * u, s * v
            products = [u * u, u * v, v * v, u * su, u * sv, v * sv, su * su, su * sv, sv * sv]
            row[:9] = [w @ product for product in products]
            row[9:13] = [w @ (part * e) for part in (u, v, su, sv)]
            row[13:16] = w @ (e * e), per_bin, w.sum()
            row[16:22] = [w @ (part * r) for part in (u, v, su, sv, r, e)]
            score = np.array([*row[9:13], row[21], *(s * row[11:13])])
            sums.evidence.scatter[index] += np.outer(score, score)
    return sums
