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
    "NEAR_MISS",
    "Cylinders",
    "Meetings",
    "Room",
    "View",
    "counts_at",
    "forget",
    "in_reach",
    "local_axis",
    "meet",
    "pixel_box",
    "ray_noise",
    "rivals",
    "room_of",
    "sight",
]

NEAR_MISS = 1.5
"""Side of a ray that passes by an outline, but not all of its pixel."""
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
        Width of a pixel that measures the mean depth over it, with what jitter smears over
        the scans; 0 for one that is a point.
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


class Room(NamedTuple):
    """Where returns count and how noisy they are: a `View` without its arrays.

    A kernel that is given arrays counts who holds them, which costs more than what it does for
    one ray.

    Attributes
    ----------
    low, high : (float, float, float), metres
    up : (float, float, float)
    height, floor, noise : float, metres
    noise_relative : float
        As of `View`.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    up: tuple[float, float, float]
    height: float
    floor: float
    noise: float
    noise_relative: float


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
    excused : (M,) int64
        What ``o`` explains beside ``j`` is not held against it where ``ranks[o] <= excused[j]``.
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
    excused: NDArray[np.int64]


class Meetings(NamedTuple):
    """Scratch for the meetings of one scan; `head` is -1 before and after.

    Attributes
    ----------
    head, pixels : (R,) int64
        First meeting of each pixel, and the pixels that have one.
    chain, who : (K,) int64
        Next meeting of the same pixel, and which beam it is with.
    along, side, entry, sigma, residual, nearest, depth : (K,) float64
        Where along the axis; on which side, as a share of the radius, and 2 or -2 for a
        ray that passes by, or `NEAR_MISS`; depth of the endless cylinder, metres; noise of
        that depth, metres; measured depth less that, sigmas; depth of the capped cylinder, infinite
        if the ray passes it by; measured depth, infinite where nothing returned.
    """

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
    depth: FloatArray


@kernel
def sight(
    points: NDArray[np.floating], rays: FloatArray, k: int
) -> tuple[float, float, float, float]:
    """Direction of a ray, and the depth at which it returned, infinite if it did not.

    Parameters
    ----------
    points, rays : (R, 3)
        Of a `View`.
    k : int
        Pixel.

    Returns
    -------
    wx, wy, wz : float
        Unit direction: of the return, or of the pixel.
    depth : float, metres
    """
    x, y, z = np.float64(points[k, 0]), np.float64(points[k, 1]), np.float64(points[k, 2])
    depth = np.sqrt(x * x + y * y + z * z)
    if np.isfinite(depth) and depth > 0.0:
        scale = 1.0 / depth
        return x * scale, y * scale, z * scale, depth
    return rays[k, 0], rays[k, 1], rays[k, 2], np.inf


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
    a: FloatArray, b: FloatArray, bow: FloatArray, first: float, last: float, s: float
) -> tuple[float, float, float, float, float, float, float]:
    """Line that touches the axis of a bent beam.

    Parameters
    ----------
    a, b, bow : (3,) float64
        Anchor, direction and bow of the beam, as of `Cylinders`.
    first, last : float, metres
        Its ends.
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
def _deepest(bow: FloatArray, first: float, last: float, begin: float, end: float) -> float:
    """How far an axis is from its chord, at most, on the stretch that is asked about."""
    size = np.sqrt(bow[0] * bow[0] + bow[1] * bow[1] + bow[2] * bow[2])
    middle, half = 0.5 * (first + last), 0.5 * (last - first)
    beyond = max(middle - begin, end - middle) / half
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
def room_of(view: View) -> Room:
    """Return where the returns of a view count, and how noisy they are."""
    low, high, up = view.low, view.high, view.up
    return Room(
        (low[0], low[1], low[2]), (high[0], high[1], high[2]), (up[0], up[1], up[2]),
        view.height, view.floor, view.noise, view.noise_relative,
    )  # fmt: skip


@kernel
def counts_at(room: Room, x: float, y: float, z: float) -> bool:
    """Whether a place lies in the window and above the floor."""
    low, high, up = room.low, room.high, room.up
    inside: bool = (
        low[0] <= x <= high[0]
        and low[1] <= y <= high[1]
        and low[2] <= z <= high[2]
        and up[0] * x + up[1] * y + up[2] * z + room.height >= room.floor
    )
    return inside


@kernel
def ray_noise(room: Room, x: float, wx: float) -> float:
    """Noise of a depth along its ray, from that of the forward depth ``x``."""
    relative = room.noise_relative * x
    return float(np.sqrt(room.noise * room.noise + relative * relative) / wx)


@kernel
def _reach_of(room: Room) -> float:
    """How far away something in the window may be, metres."""
    low, high = room.low, room.high
    squared = 0.0
    for axis in range(3):
        squared += max(low[axis] * low[axis], high[axis] * high[axis])
    return float(np.sqrt(squared))


@kernel
def _moment(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float
) -> tuple[float, float, float]:
    """Normal of the plane through the camera and a line, as long as the line is away."""
    return by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax


@kernel
def _meet_one(
    view: View, beams: Cylinders, j: int, flanks: bool, meetings: Meetings, used: int, touched: int
) -> tuple[int, int]:
    """Find the meetings of all rays and one beam; return how many there are now, and pixels."""
    points, rays, room = view.points, view.rays, room_of(view)
    who, along, side, depths = meetings.who, meetings.along, meetings.side, meetings.depth
    entries, sigmas = meetings.entry, meetings.sigma
    residual, nearest = meetings.residual, meetings.nearest
    head, pixels, chain = meetings.head, meetings.pixels, meetings.chain
    a, b, bow, radius = beams.anchors[j], beams.directions[j], beams.bows[j], beams.radii[j]
    begin, end = beams.starts[j], beams.stops[j]
    first, last = beams.firsts[j], beams.lasts[j]
    bent = bow[0] != 0.0 or bow[1] != 0.0 or bow[2] != 0.0
    deep = _deepest(bow, first, last, begin, end) if bent else 0.0
    if not in_reach(a, b, begin, end, radius + deep, _reach_of(room)):
        return used, touched
    inner = _FLANK * radius + _FLANK_FROM
    outer = _FLANK * radius + _FLANK_TO if flanks else radius
    num_rays, width = len(points), view.width
    row_first, row_last, column_first, column_last = 0, 1, 0, num_rays
    if width > 0:
        row_first, row_last, column_first, column_last = pixel_box(
            a, b, begin, end, outer + deep, width, num_rays // width, view.image
        )
    tangent_1, tangent_2 = _tangents(a, b, outer + deep)
    ax, ay, az, bx, by, bz = a[0], a[1], a[2], b[0], b[1], b[2]
    ab = ax * bx + ay * by + az * bz
    mx, my, mz = _moment(ax, ay, az, bx, by, bz)
    widest = (outer + deep) * (outer + deep)
    from_s, stretch = 0.0, 1.0
    for row in range(row_first, row_last):
        left, right = column_first, column_last
        if width > 0:
            left, right = _clipped(tangent_1, row, view.image, left, right)
            left, right = _clipped(tangent_2, row, view.image, left, right)
        for k in range(row * width + left, row * width + right):
            wx, wy, wz, depth = sight(points, rays, k)
            if bent:
                ax, ay, az, bx, by, bz = a[0], a[1], a[2], b[0], b[1], b[2]
                ab = ax * bx + ay * by + az * bz
                mx, my, mz = _moment(ax, ay, az, bx, by, bz)
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
                    ax, ay, az, bx, by, bz, stretch = local_axis(a, b, bow, first, last, from_s)
                    ab = ax * bx + ay * by + az * bz
                    mx, my, mz = _moment(ax, ay, az, bx, by, bz)
                    mixed = wx * mx + wy * my + wz * mz
                    wb = wx * bx + wy * by + wz * bz
                    across = 1.0 - wb * wb
                if mixed * mixed > outer * outer * across:
                    continue
            if mixed * mixed > radius * radius * across:  # it passes by
                entry = (wx * ax + wy * ay + wz * az - wb * ab) / across
                s = from_s + (entry * wb - ab) / stretch
                near = np.inf
                beside = 2.0 if mixed > 0.0 else -2.0
                is_met = mixed * mixed > inner * inner * across
                blurred = radius + view.blur * entry
                if not is_met and mixed * mixed < blurred * blurred * across:
                    beside, is_met = NEAR_MISS, True
                is_met = is_met and first <= s <= last
            else:
                entry, leave, at, lateral = enter_cylinder(
                    wx, wy, wz, ax, ay, az, bx, by, bz, radius
                )
                s, beside = from_s + at / stretch, lateral / radius
                near = finite_depth(
                    entry, leave, at, wb, ab, (first - from_s) * stretch, (last - from_s) * stretch
                )
                is_met = begin <= s < end
            x = entry * wx
            if not (is_met and entry > 0.0 and counts_at(room, x, entry * wy, entry * wz)):
                continue
            sigma = ray_noise(room, x, wx)
            who[used], along[used], side[used] = j, s, beside
            entries[used], sigmas[used], nearest[used] = entry, sigma, near
            residual[used], depths[used] = (depth - entry) / sigma, depth
            chain[used] = head[k]
            if head[k] < 0:
                pixels[touched] = k
                touched += 1
            head[k] = used
            used += 1
    return used, touched


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
    used, touched = 0, 0
    for j in range(len(beams.anchors)):
        used, touched = _meet_one(view, beams, j, flanks, meetings, used, touched)
    return touched


@kernel
def rivals(
    ranks: NDArray[np.int64], limit: int, head: int, this: int, chain: NDArray[np.int64],
    who: NDArray[np.int64], nearest: FloatArray, sides: FloatArray, entries: FloatArray,
    entry: float, depth: float, sigma: float,
) -> tuple[float, float, float]:  # fmt: skip
    """What the other beams that a ray meets say to it.

    Parameters
    ----------
    ranks : (M,) int64
        Of `Cylinders`.
    limit : int
        The highest rank of a beam that counts.
    head, this : int
        First meeting of the ray, and the one in question.
    chain, who : (K,) int64
    nearest, sides, entries : (K,) float64
        Of `Meetings`.
    entry, depth : float, metres
        Where the ray enters the beam, and where it returned.
    sigma : float, metres
        Noise of that.

    Returns
    -------
    before : float, metres
        Depth of the nearest competitor, infinite if there is none.
    best : float
        Least distance of the measured depth from a competitor, in sigmas.
    apart : float
        Least distance of the beam's own depth from a competitor, in sigmas.
    """
    before, best, apart = np.inf, np.inf, np.inf
    other = head
    while other >= 0:
        near = nearest[other]
        if other != this and near < np.inf and ranks[who[other]] <= limit:
            before = min(before, near)
            best = min(best, abs(depth - near) / sigma)
            apart = min(apart, abs(entry - near) / sigma)
        elif other != this and sides[other] == NEAR_MISS and entries[other] < entry:
            apart = 0.0  # the pixel is partly on what stands before
        other = chain[other]
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
