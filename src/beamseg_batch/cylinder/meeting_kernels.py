"""Kernels that find which rays of a scan meet which beams of a hypothesis, and where.

Everything is in the sensor frame. Beams are few and thin, so most pixels meet none: the
meetings of a pixel are a chain that begins at its `head`, and a pixel without is never
visited again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.accelerate import kernel
from beamseg_batch.cylinder.ray_kernels import enter_cylinder, finite_depth
from beamseg_batch.geometry import FloatArray

__all__ = [
    "Cylinders",
    "Meetings",
    "View",
    "counts_at",
    "forget",
    "in_reach",
    "local_axis",
    "meet",
    "pixel_box",
    "ray_noise",
    "rivals",
    "sights",
]

_FLANK = 1.35  # radii from the axis at which a beam's surroundings begin
_FLANK_FROM, _FLANK_TO = 0.01, 0.06  # and where they are looked at, metres further
_PIXEL = 0.75  # pixels by which a ray may lie beside its place in the image
_TANGENTS = 3  # along which a ray looks for a bent axis, each from where the last one put it


class View(NamedTuple):
    """What a camera saw, in the sensor frame.

    Attributes
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
    height, floor : float, metres
    blur : float, radians
        How far from the outline of a beam its pixels may hold something else, too.
    footprint : float, radians
        Width of a pixel that measures the mean depth over it; 0 for one that is a point.
    """

    points: NDArray[np.floating]
    rays: FloatArray
    width: int
    image: FloatArray
    noise: float
    noise_relative: float
    low: FloatArray
    high: FloatArray
    up: FloatArray
    height: float
    floor: float
    blur: float
    footprint: float


class Cylinders(NamedTuple):
    """Beams of a hypothesis, in the sensor frame.

    Attributes
    ----------
    anchors, directions : (M, 3) float64
    us, vs : (M, 3) float64, unit vectors
        Normal to each axis and to one another.
    bows : (M, 3) float64, metres
        By how much each axis leaves its chord, ``anchor + s direction``, midway between its
        ends: a parabola, which goes on beyond them. Zero for a straight beam.
    radii : (M,) float64, metres
    firsts, lasts : (M,) float64, metres
        Ends of each beam along its axis.
    starts, stops : (M,) float64, metres
        The stretch of each axis that is asked about.
    ranks, limits : (M,) int64
        Beam ``o`` competes with ``j`` where ``ranks[o] <= limits[j]``.
    """

    anchors: FloatArray
    directions: FloatArray
    us: FloatArray
    vs: FloatArray
    bows: FloatArray
    radii: FloatArray
    firsts: FloatArray
    lasts: FloatArray
    starts: FloatArray
    stops: FloatArray
    ranks: NDArray[np.int64]
    limits: NDArray[np.int64]


class Meetings(NamedTuple):
    """Scratch for the meetings of one scan; `head` is -1 before and after.

    Attributes
    ----------
    sight : (R, 4) float64
        Direction of each ray, and the depth at which it returned, infinite if it did not.
    head, pixels : (R,) int64
        First meeting of each pixel, and the pixels that have one.
    chain, who : (K,) int64
        Next meeting of the same pixel, and which beam it is with.
    along, side, entry, sigma, residual, nearest : (K,) float64
        Where along the axis; on which side, as a share of the radius, and 2 or -2 for a
        ray that passes by; depth of the endless cylinder, metres; noise of that depth,
        metres; measured depth less that, sigmas; depth of the capped cylinder, infinite
        if the ray passes it by.
    """

    sight: FloatArray
    head: NDArray[np.int64]
    pixels: NDArray[np.int64]
    chain: NDArray[np.int64]
    who: NDArray[np.int64]
    along: FloatArray
    side: FloatArray
    entry: FloatArray
    sigma: FloatArray
    residual: FloatArray
    nearest: FloatArray


@kernel
def _look(view: View, sight: FloatArray, k: int) -> None:
    """Note the direction of a ray, and how far it went."""
    points, rays = view.points, view.rays
    x, y, z = np.float64(points[k, 0]), np.float64(points[k, 1]), np.float64(points[k, 2])
    depth = np.sqrt(x * x + y * y + z * z)
    if np.isfinite(depth) and depth > 0.0:
        scale = 1.0 / depth
        sight[k, 0], sight[k, 1], sight[k, 2] = x * scale, y * scale, z * scale
    else:
        sight[k, 0], sight[k, 1], sight[k, 2] = rays[k, 0], rays[k, 1], rays[k, 2]
        depth = np.inf
    sight[k, 3] = depth


@kernel
def sights(view: View, sight: FloatArray) -> None:
    """Note the direction of each ray, and how far it went.

    Parameters
    ----------
    view : View
    sight : (R, 4) float64
        Filled, as of `Meetings`.
    """
    for k in range(len(view.points)):
        _look(view, sight, k)


@kernel
def pixel_box(
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
def _tangents(
    a: FloatArray, b: FloatArray, radius: float
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Normals of the planes from the camera that touch a cylinder, towards it.

    A ray meets the endless cylinder where it has no negative part along either; both are
    zero for a camera inside of it.
    """
    ab = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    x, y, z = a[0] - ab * b[0], a[1] - ab * b[1], a[2] - ab * b[2]
    away = np.sqrt(x * x + y * y + z * z)
    if away <= radius:
        return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    x, y, z = x / away, y / away, z / away
    sine = radius / away
    cosine = np.sqrt(1.0 - sine * sine)
    p = cosine * (b[1] * z - b[2] * y)
    q = cosine * (b[2] * x - b[0] * z)
    r = cosine * (b[0] * y - b[1] * x)
    x, y, z = sine * x, sine * y, sine * z
    return (x + p, y + q, z + r), (x - p, y - q, z - r)


@kernel
def _clipped(
    normal: tuple[float, float, float],
    row: int,
    image: FloatArray,
    first: int,
    last: int,
) -> tuple[int, int]:
    """Columns of a row, out of some, whose rays have no negative part along a normal."""
    step = normal[1] * image[1]
    down = normal[2] * image[3]
    begin = normal[0] + normal[1] * image[0] + normal[2] * image[2] + row * down
    begin += _PIXEL * (abs(step) + abs(down))
    if step == 0.0:
        return first, last if begin >= 0.0 else first
    column = min(max(-begin / step, -1.0), last + 1.0)
    if step > 0.0:
        return max(first, int(np.ceil(column))), last
    return first, min(last, int(np.floor(column)) + 1)


@kernel
def local_axis(
    beams: Cylinders, j: int, s: float
) -> tuple[float, float, float, float, float, float, float]:
    """Line that touches the axis of a bent beam.

    Parameters
    ----------
    beams : Cylinders
    j : int
    s : float, metres
        Where, along the chord.

    Returns
    -------
    ax, ay, az : float, metres
        The point of the axis.
    bx, by, bz : float
        Unit direction of the axis there.
    stretch : float
        Length of the line by length of the chord.
    """
    a, b, bow = beams.anchors[j], beams.directions[j], beams.bows[j]
    first, last = beams.firsts[j], beams.lasts[j]
    share = (2.0 * s - first - last) / (last - first)
    off, slope = 1.0 - share * share, -4.0 * share / (last - first)
    bx, by, bz = b[0] + slope * bow[0], b[1] + slope * bow[1], b[2] + slope * bow[2]
    stretch = np.sqrt(bx * bx + by * by + bz * bz)
    return (
        a[0] + s * b[0] + off * bow[0],
        a[1] + s * b[1] + off * bow[1],
        a[2] + s * b[2] + off * bow[2],
        bx / stretch,
        by / stretch,
        bz / stretch,
        stretch,
    )


@kernel
def _deepest(beams: Cylinders, j: int) -> float:
    """How far an axis is from its chord, at most, on the stretch that is asked about."""
    bow = beams.bows[j]
    size = np.sqrt(bow[0] * bow[0] + bow[1] * bow[1] + bow[2] * bow[2])
    middle, half = (
        0.5 * (beams.firsts[j] + beams.lasts[j]),
        0.5 * (beams.lasts[j] - beams.firsts[j]),
    )
    beyond = max(middle - beams.starts[j], beams.stops[j] - middle) / half
    return float(size * max(1.0, beyond * beyond - 1.0))


@kernel
def in_reach(
    a: FloatArray, b: FloatArray, begin: float, end: float, radius: float, reach: float
) -> bool:
    """Whether a stretch of a beam comes as near as the window reaches."""
    ab = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    closest = min(max(-ab, begin), end)
    squared = 0.0
    for axis in range(3):
        squared += (a[axis] + closest * b[axis]) ** 2
    return squared <= (reach + radius) ** 2


@kernel
def counts_at(view: View, x: float, y: float, z: float) -> bool:
    """Whether a place lies in the window and above the floor."""
    low, high, up = view.low, view.high, view.up
    inside: bool = (
        low[0] <= x <= high[0]
        and low[1] <= y <= high[1]
        and low[2] <= z <= high[2]
        and up[0] * x + up[1] * y + up[2] * z + view.height >= view.floor
    )
    return inside


@kernel
def ray_noise(view: View, x: float, wx: float) -> float:
    """Noise of a depth along its ray, from that of the forward depth ``x``."""
    relative = view.noise_relative * x
    return float(np.sqrt(view.noise * view.noise + relative * relative) / wx)


@kernel
def _chained(meetings: Meetings, used: int, touched: int, k: int) -> int:
    """Put a meeting before those of its pixel; return how many pixels have one."""
    head = meetings.head
    if head[k] < 0:
        meetings.pixels[touched] = k
        touched += 1
    meetings.chain[used] = head[k]
    head[k] = used
    return touched


@kernel
def meet(view: View, beams: Cylinders, meetings: Meetings, flanks: bool) -> int:
    """Find all meetings of rays and beams.

    Parameters
    ----------
    view : View
    beams : Cylinders
    meetings : Meetings
        Filled; what it has no room for is left out.
    flanks : bool
        Whether rays that pass closely by a beam count, too.

    Returns
    -------
    int
        Pixels that meet something, the first so many of ``meetings.pixels``.
    """
    reach = 0.0
    for axis in range(3):
        reach += max(view.low[axis] * view.low[axis], view.high[axis] * view.high[axis])
    reach = np.sqrt(reach)
    sight, who, along, side = meetings.sight, meetings.who, meetings.along, meetings.side
    entries, sigmas = meetings.entry, meetings.sigma
    residual, nearest = meetings.residual, meetings.nearest
    num_rays, width = len(view.points), view.width
    if width == 0:
        sights(view, sight)
    used, touched = 0, 0
    for j in range(len(beams.anchors)):
        a, b, radius = beams.anchors[j], beams.directions[j], beams.radii[j]
        begin, end = beams.starts[j], beams.stops[j]
        first, last = beams.firsts[j], beams.lasts[j]
        bow = beams.bows[j]
        bent = bow[0] != 0.0 or bow[1] != 0.0 or bow[2] != 0.0
        deep = _deepest(beams, j) if bent else 0.0
        if not in_reach(a, b, begin, end, radius + deep, reach):
            continue
        inner = _FLANK * radius + _FLANK_FROM
        outer = _FLANK * radius + _FLANK_TO if flanks else radius
        row_first, row_last, column_first, column_last = 0, 1, 0, num_rays
        if width > 0:
            row_first, row_last, column_first, column_last = pixel_box(
                a, b, begin, end, outer + deep, width, num_rays // width, view.image
            )
        tangent_1, tangent_2 = _tangents(a, b, outer + deep)
        ax, ay, az, bx, by, bz = a[0], a[1], a[2], b[0], b[1], b[2]
        ab = ax * bx + ay * by + az * bz
        mx, my, mz = by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax
        widest = (outer + deep) * (outer + deep)
        from_s, stretch = 0.0, 1.0
        for row in range(row_first, row_last):
            begin_column, end_column = column_first, column_last
            if width > 0:
                begin_column, end_column = _clipped(
                    tangent_1, row, view.image, begin_column, end_column
                )
                begin_column, end_column = _clipped(
                    tangent_2, row, view.image, begin_column, end_column
                )
            for column in range(begin_column, end_column):
                k = row * width + column
                if width > 0:
                    _look(view, sight, k)
                wx, wy, wz, depth = sight[k, 0], sight[k, 1], sight[k, 2], sight[k, 3]
                if bent:
                    ax, ay, az, bx, by, bz = a[0], a[1], a[2], b[0], b[1], b[2]
                    ab = ax * bx + ay * by + az * bz
                    mx, my, mz = by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax
                mixed = wx * mx + wy * my + wz * mz
                wb = wx * bx + wy * by + wz * bz
                across = 1.0 - wb * wb
                if mixed * mixed > widest * across or used == len(who):
                    continue
                if bent:
                    # Along the chord, then along lines that touch the axis where that led.
                    from_s, stretch = 0.0, 1.0
                    for _ in range(_TANGENTS):
                        middle = (wx * ax + wy * ay + wz * az - wb * ab) / across
                        half = np.sqrt(max(radius * radius - mixed * mixed / across, 0.0) / across)
                        at = from_s + ((middle - half) * wb - ab) / stretch
                        from_s = min(max(at, begin - radius), end + radius)
                        ax, ay, az, bx, by, bz, stretch = local_axis(beams, j, from_s)
                        ab = ax * bx + ay * by + az * bz
                        mx, my, mz = by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax
                        mixed = wx * mx + wy * my + wz * mz
                        wb = wx * bx + wy * by + wz * bz
                        across = 1.0 - wb * wb
                    if mixed * mixed > outer * outer * across:
                        continue
                if mixed * mixed > radius * radius * across:
                    middle = (wx * ax + wy * ay + wz * az - wb * ab) / across
                    s = from_s + (middle * wb - ab) / stretch
                    x, y, z = middle * wx, middle * wy, middle * wz
                    if (
                        mixed * mixed > inner * inner * across
                        and middle > 0.0
                        and first <= s <= last
                        and counts_at(view, x, y, z)
                    ):
                        sigma = ray_noise(view, x, wx)
                        who[used], along[used], side[used] = j, s, 2.0 if mixed > 0.0 else -2.0
                        entries[used], sigmas[used], nearest[used] = middle, sigma, np.inf
                        residual[used] = (depth - middle) / sigma
                        touched = _chained(meetings, used, touched, k)
                        used += 1
                    continue
                entry, leave, at, lateral = enter_cylinder(
                    wx, wy, wz, ax, ay, az, bx, by, bz, radius
                )
                s = from_s + at / stretch
                x, y, z = entry * wx, entry * wy, entry * wz
                if not (entry > 0.0 and begin <= s < end and counts_at(view, x, y, z)):
                    continue
                sigma = ray_noise(view, x, wx)
                who[used], along[used], side[used] = j, s, lateral / radius
                entries[used], sigmas[used] = entry, sigma
                residual[used] = (depth - entry) / sigma
                nearest[used] = finite_depth(
                    entry, leave, at, wb, ab, (first - from_s) * stretch, (last - from_s) * stretch
                )
                touched = _chained(meetings, used, touched, k)
                used += 1
    return touched


@kernel
def rivals(beams: Cylinders, meetings: Meetings, k: int, this: int) -> tuple[float, float, float]:
    """What the other beams that a ray meets say to it.

    Parameters
    ----------
    beams : Cylinders
    meetings : Meetings
        As `meet` left them.
    k, this : int
        A pixel, and one of its meetings.

    Returns
    -------
    before : float, metres
        Depth of the nearest competitor, infinite if there is none.
    best : float
        Least distance of the measured depth from a competitor, in sigmas.
    apart : float
        Least distance of the beam's own depth from a competitor, in sigmas.
    """
    limit, sigma = beams.limits[meetings.who[this]], meetings.sigma[this]
    entry, depth = meetings.entry[this], meetings.sight[k, 3]
    before, best, apart = np.inf, np.inf, np.inf
    other = meetings.head[k]
    while other >= 0:
        near = meetings.nearest[other]
        if other != this and near < np.inf and beams.ranks[meetings.who[other]] <= limit:
            before = min(before, near)
            best = min(best, abs(depth - near) / sigma)
            apart = min(apart, abs(entry - near) / sigma)
        other = meetings.chain[other]
    return before, best, apart


@kernel
def forget(meetings: Meetings, touched: int) -> None:
    """Make the scratch ready for the next scan.

    Parameters
    ----------
    meetings : Meetings
    touched : int
        What `meet` returned.
    """
    for number in range(touched):
        meetings.head[meetings.pixels[number]] = -1
