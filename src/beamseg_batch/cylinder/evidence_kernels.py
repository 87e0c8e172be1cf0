"""Kernel that asks every ray of a scan what it says about each beam of a hypothesis.

A ray that returned from where a beam's surface is *explains* it; one that returned from
behind, or not at all, *saw through* it; one that returned from before it, or whose way is
blocked by another beam, says nothing. Beams compete: a return that another beam explains
as well is no evidence. Everything is in the sensor frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.accelerate import kernel
from beamseg_batch.cylinder.ray_kernels import enter_cylinder, finite_depth
from beamseg_batch.geometry import FloatArray

__all__ = ["COARSE", "FINE", "NORMAL_COLUMNS", "gather"]

FINE = 0.004
"""Length of a bin of the likelihood along an axis, metres."""

COARSE = 0.02
"""Length of a bin of the normal equations along an axis, metres."""

NORMAL_COLUMNS = 16
"""Nine products of the derivatives, four with the residual, its square, rays, weight."""

_GATE = 4.0  # a residual of so many sigmas is still explained
_THROUGH = -4.0  # log-likelihood ratio of a ray that saw through
_EDGE = 0.8  # share of the radius beyond which a ray that passes proves nothing
_MIN_INCIDENCE = 0.2
_FLANK = 1.35  # radii from the axis at which a beam's surroundings begin
_FLANK_FROM, _FLANK_TO = 0.01, 0.06  # and where they are looked at, metres further
_CONTESTED = 2.0  # sigmas by which a ray must fit one beam better than any other


@kernel
def _pixels(
    a: FloatArray,
    b: FloatArray,
    begin: float,
    end: float,
    radius: float,
    width: int,
    height: int,
    image: FloatArray,
) -> tuple[int, int, int, int]:
    """First row, row past the last, and the same of columns that a beam can appear in.

    A straight line is straight in the image, so what lies between two balls around its
    ends lies between their images. What is nearer than a radius and a bit is let go.
    """
    least = radius + 0.05
    first_x, last_x = a[0] + begin * b[0], a[0] + end * b[0]
    if first_x < least and last_x < least:
        return 0, 0, 0, 0
    if first_x < least:
        begin += (least - first_x) / b[0]
    if last_x < least:
        end += (least - last_x) / b[0]
    low_u, high_u, low_v, high_v = np.inf, -np.inf, np.inf, -np.inf
    for s in (begin, end):
        x, y, z = a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]
        near, far = x - radius, x + radius
        low_u = min(low_u, (y - radius) / near, (y - radius) / far)
        high_u = max(high_u, (y + radius) / near, (y + radius) / far)
        low_v = min(low_v, (z - radius) / near, (z - radius) / far)
        high_v = max(high_v, (z + radius) / near, (z + radius) / far)
    column_1, column_2 = (low_u - image[0]) / image[1], (high_u - image[0]) / image[1]
    row_1, row_2 = (low_v - image[2]) / image[3], (high_v - image[2]) / image[3]
    first_column = int(max(np.floor(min(column_1, column_2)), 0.0))
    first_row = int(max(np.floor(min(row_1, row_2)), 0.0))
    last_column = int(min(np.ceil(max(column_1, column_2)) + 1.0, float(width)))
    last_row = int(min(np.ceil(max(row_1, row_2)) + 1.0, float(height)))
    return (
        first_row,
        max(last_row, first_row),
        first_column,
        max(last_column, first_column),
    )


@kernel
def gather(
    points: NDArray[np.floating],
    rays: FloatArray,
    width: int,
    image: FloatArray,
    noise: float,
    noise_relative: float,
    low: FloatArray,
    high: FloatArray,
    up: FloatArray,
    height: float,
    floor: float,
    anchors: FloatArray,
    directions: FloatArray,
    us: FloatArray,
    vs: FloatArray,
    radii: FloatArray,
    firsts: FloatArray,
    lasts: FloatArray,
    ranks: NDArray[np.int64],
    limits: NDArray[np.int64],
    starts: FloatArray,
    fine_at: NDArray[np.int64],
    coarse_at: NDArray[np.int64],
    likelihood: FloatArray,
    hits: FloatArray,
    normal: FloatArray,
    scans: NDArray[np.int64],
    flanks: FloatArray,
    tukey: float,
    background: float,
    head: NDArray[np.int64],
    pixels: NDArray[np.int64],
    chain: NDArray[np.int64],
    who: NDArray[np.int64],
    meetings: FloatArray,
) -> None:
    """Add what a scan says about each beam to sums along its axis.

    Parameters
    ----------
    points : (R, 3) float32 or float64, metres, x forward
        Not finite where nothing returned.
    rays : (R, 3) float64, unit vectors
        Direction of each pixel, for those without return; zero where it is not known.
    width : int
        Pixels of a row; 0 for a cloud without rows.
    image : (4,) float64
        ``y / x`` of the first column and its step to the next, ``z / x`` of the first row
        and its step.
    noise, noise_relative : float
        Standard deviation of the forward depth: metres, and share of the depth.
    low, high : (3,) float64, metres
        Window outside of which nothing counts.
    up : (3,) float64
        The world's z axis; with `height`, the sensor's, and `floor`, metres, it gives the
        floor trim.
    anchors, directions : (M, 3) float64
    us, vs : (M, 3) float64, unit vectors
        Normal to each axis and to one another; the normal equations are in these.
    radii, firsts, lasts : (M,) float64, metres
        Radius of each beam, and its ends along its axis.
    ranks, limits : (M,) int64
        Beam ``o`` competes with ``j`` where ``ranks[o] <= limits[j]``.
    starts : (M,) float64, metres
        Where the first bin of a beam begins, along its axis.
    fine_at, coarse_at : (M + 1,) int64
        First bin of each beam.
    likelihood, hits : (F,) float64
        Sums by fine bin, added to: log-likelihood ratio, rays explained.
    normal : (C, 16) float64
        Sums by coarse bin, added to.
    scans : (M,) int64
        Added to where at least three rays are explained by the beam alone.
    flanks : (M, 2, 2) float64
        Added to: rays that pass a beam closely on its left and right, and found something
        at its depth, or nothing. Not asked for where it is empty.
    tukey : float
        Reach of Tukey's weight, in sigmas.
    background : float
        Cost of a return that no beam explains, as half a squared residual.
    head, pixels : (R,) int64
        Scratch; `head` is -1 before and after.
    chain, who : (K,) int64
    meetings : (6, K) float64
        Scratch for what may meet; beyond K it is left out.
    """
    num_beams = len(anchors)
    num_rays = len(points)
    reach = 0.0
    for axis in range(3):
        reach += max(low[axis] * low[axis], high[axis] * high[axis])
    reach = np.sqrt(reach)
    ask_flanks = len(flanks) == num_beams
    along, side, residual = meetings[0], meetings[1], meetings[2]
    entries, sigmas, nearest = meetings[3], meetings[4], meetings[5]
    # Rays that may meet a beam, chained by pixel: most pixels meet none.
    used = 0
    touched = 0
    for j in range(num_beams):
        a, b, radius = anchors[j], directions[j], radii[j]
        ab = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
        begin = starts[j]
        end = begin + (fine_at[j + 1] - fine_at[j]) * FINE
        closest = min(max(-ab, begin), end)
        gone = 0.0
        for axis in range(3):
            gone += (a[axis] + closest * b[axis]) ** 2
        if gone > (reach + radius) ** 2:
            continue
        inner = _FLANK * radius + _FLANK_FROM
        outer = _FLANK * radius + _FLANK_TO if ask_flanks else radius
        row_first, row_last, column_first, column_last = 0, 1, 0, num_rays
        if width > 0:
            row_first, row_last, column_first, column_last = _pixels(
                a, b, begin, end, outer, width, num_rays // width, image
            )
        mx, my, mz = b[1] * a[2] - b[2] * a[1], b[2] * a[0] - b[0] * a[2], b[0] * a[1] - b[1] * a[0]
        for pixel in range((row_last - row_first) * (column_last - column_first)):
            k = pixel
            if width > 0:
                columns = column_last - column_first
                k = (row_first + pixel // columns) * width + column_first + pixel % columns
            wx, wy, wz = (
                np.float64(points[k, 0]),
                np.float64(points[k, 1]),
                np.float64(points[k, 2]),
            )
            depth = np.sqrt(wx * wx + wy * wy + wz * wz)
            if np.isfinite(depth) and depth > 0.0:
                wx, wy, wz = wx / depth, wy / depth, wz / depth
            else:
                wx, wy, wz, depth = rays[k, 0], rays[k, 1], rays[k, 2], np.inf
            mixed = wx * mx + wy * my + wz * mz
            wb = wx * b[0] + wy * b[1] + wz * b[2]
            across = 1.0 - wb * wb
            if mixed * mixed > outer * outer * across:
                continue
            if mixed * mixed > radius * radius * across:
                middle = (wx * a[0] + wy * a[1] + wz * a[2] - wb * ab) / across
                s = middle * wb - ab
                x, y, z = middle * wx, middle * wy, middle * wz
                if (
                    mixed * mixed > inner * inner * across
                    and middle > 0.0
                    and firsts[j] <= s <= lasts[j]
                    and low[0] <= x <= high[0]
                    and low[1] <= y <= high[1]
                    and low[2] <= z <= high[2]
                    and up[0] * x + up[1] * y + up[2] * z + height >= floor
                    and used < len(who)
                ):
                    sigma = np.sqrt(noise * noise + (noise_relative * x) ** 2) / wx
                    who[used], along[used], side[used] = j, s, 2.0 if mixed > 0.0 else -2.0
                    entries[used], sigmas[used], nearest[used] = middle, sigma, np.inf
                    residual[used] = (depth - middle) / sigma
                    if head[k] < 0:
                        pixels[touched] = k
                        touched += 1
                    chain[used] = head[k]
                    head[k] = used
                    used += 1
                continue
            entry, leave, s, lateral = enter_cylinder(
                wx, wy, wz, a[0], a[1], a[2], b[0], b[1], b[2], radius
            )
            if not (entry > 0.0 and begin <= s < end):
                continue
            x, y, z = entry * wx, entry * wy, entry * wz
            if not (low[0] <= x <= high[0] and low[1] <= y <= high[1] and low[2] <= z <= high[2]):
                continue
            if up[0] * x + up[1] * y + up[2] * z + height < floor or used == len(who):
                continue
            sigma = np.sqrt(noise * noise + (noise_relative * x) ** 2) / wx
            who[used], along[used], side[used] = j, s, lateral / radius
            entries[used], sigmas[used] = entry, sigma
            residual[used] = (depth - entry) / sigma
            nearest[used] = finite_depth(entry, leave, s, wb, ab, firsts[j], lasts[j])
            if head[k] < 0:
                pixels[touched] = k
                touched += 1
            chain[used] = head[k]
            head[k] = used
            used += 1
    alone = np.zeros(num_beams, np.int64)
    for number in range(touched):
        k = pixels[number]
        slot = head[k]
        while slot >= 0:
            this = slot
            slot = chain[this]
            j, s, e, entry = who[this], along[this], residual[this], entries[this]
            depth = entry + e * sigmas[this]
            before, best = np.inf, np.inf
            other = head[k]
            while other >= 0:
                near = nearest[other]
                if other != this and near < np.inf and ranks[who[other]] <= limits[j]:
                    before = min(before, near)
                    best = min(best, abs(depth - near) / sigmas[this])
                other = chain[other]
            if abs(side[this]) > 1.0:
                reaches = 2.0 * radii[j] / sigmas[this] + _GATE
                if best > _GATE and e >= -reaches:
                    flanks[j, int(side[this] > 0.0), int(e > reaches)] += 1.0
                continue
            hidden = entry >= before
            if e < -_GATE or (hidden and e > _GATE):
                continue
            # A place just before the end may round up to it.
            fine = min(fine_at[j] + int((s - starts[j]) / FINE), fine_at[j + 1] - 1)
            if e > _GATE:
                if side[this] < _EDGE:
                    likelihood[fine] += _THROUGH
                continue
            if not hidden:
                gain = min(0.5 * best * best, background) - min(0.5 * e * e, background)
                likelihood[fine] += gain
            explained = best > abs(e) + _CONTESTED
            if explained:
                hits[fine] += 1.0
            inside = firsts[j] <= s <= lasts[j]
            if not inside or not explained or abs(e) >= tukey:
                continue
            alone[j] += 1
            a, b = anchors[j], directions[j]
            # A ray with a fitting depth returned, so its point tells its direction.
            wx, wy, wz = points[k, 0] / depth, points[k, 1] / depth, points[k, 2] / depth
            nx = (entry * wx - a[0] - s * b[0]) / radii[j]
            ny = (entry * wy - a[1] - s * b[1]) / radii[j]
            nz = (entry * wz - a[2] - s * b[2]) / radii[j]
            incidence = nx * wx + ny * wy + nz * wz
            if abs(incidence) < _MIN_INCIDENCE:
                continue
            share = e / tukey
            weight = (1.0 - share * share) ** 2
            scale = 1.0 / sigmas[this]
            u = (nx * us[j, 0] + ny * us[j, 1] + nz * us[j, 2]) / incidence * scale
            v = (nx * vs[j, 0] + ny * vs[j, 1] + nz * vs[j, 2]) / incidence * scale
            coarse = min(coarse_at[j] + int((s - starts[j]) / COARSE), coarse_at[j + 1] - 1)
            row = normal[coarse]
            su, sv = s * u, s * v
            row[0] += weight * u * u
            row[1] += weight * u * v
            row[2] += weight * v * v
            row[3] += weight * su * u
            row[4] += weight * su * v
            row[5] += weight * sv * v
            row[6] += weight * su * su
            row[7] += weight * su * sv
            row[8] += weight * sv * sv
            row[9] += weight * u * e
            row[10] += weight * v * e
            row[11] += weight * su * e
            row[12] += weight * sv * e
            row[13] += weight * e * e
            row[14] += 1.0
            row[15] += weight
    for number in range(touched):
        head[pixels[number]] = -1
    for j in range(num_beams):
        scans[j] += alone[j] >= 3
