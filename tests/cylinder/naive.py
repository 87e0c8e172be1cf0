"""Slow, obvious twins of the cylinder kernels: plain numpy, by other formulas.

A ray meets a cylinder where a quadratic in the depth is zero; derivatives are numerical.
"""

from __future__ import annotations

import numpy as np

FINE, COARSE = 0.004, 0.02


def frame_of(b):
    """Rows: two normals of a direction, and itself."""
    _, _, rows = np.linalg.svd(np.reshape(b, (1, 3)))
    return np.array([rows[1], rows[2], b])


def interval(w, a, b, radius):
    """Depths at which a ray from the origin enters and leaves an endless cylinder."""
    turn = frame_of(b)
    (wx, wy, _), (ax, ay, _) = turn @ w, turn @ a
    roots = np.roots([wx * wx + wy * wy, -2 * (wx * ax + wy * ay), ax * ax + ay * ay - radius**2])
    if len(roots) < 2 or abs(roots[0].imag) > 0.0:
        return None
    return min(roots.real), max(roots.real)


def finite_interval(w, a, b, first, last, radius):
    """The same for a cylinder with caps: what the endless one and a slab have in common."""
    endless = interval(w, a, b, radius)
    if endless is None:
        return None
    slab = sorted((place + a @ b) / (w @ b) for place in (first, last))
    low, high = max(endless[0], slab[0]), min(endless[1], slab[1])
    return (low, high) if low < high else None


def line_distance(w, a, b):
    """Distance of a ray's line from an axis, with a sign, and the depth nearest to it."""
    normal = np.cross(w, b)
    (depth, _), *_ = np.linalg.lstsq(np.stack([w, -b], axis=1), a, rcond=None)
    return normal @ a / np.linalg.norm(normal), depth


def entry_depth(w, a, b, radius):
    met = interval(w, a, b, radius)
    return np.nan if met is None else met[0]


def entry_slopes(w, a, b, radius, s, u, v, step=1e-6):
    """Change of a ray's entry with the axis: its offsets along u and v, and its slopes."""
    slopes = []
    for shift in (u, v, s * u, s * v):
        # A slope moves the axis near s alone, as an offset by s times the slope.
        ahead, behind = (entry_depth(w, a + k * step * shift, b, radius) for k in (1, -1))
        slopes.append((ahead - behind) / (2 * step))
    return np.array(slopes)


def fit_axis(rays, depths, scales, anchor, direction, first, last, radius, gates):
    """Gauss and Newton with Tukey's weight and numerical derivatives."""
    a, b = anchor.copy(), direction.copy()
    count, rms = 0, 0.0
    for gate in gates:
        u, v, _ = frame_of(b)
        rows, residuals, weights = [], [], []
        for w, depth, scale in zip(rays, depths, scales, strict=True):
            entry = entry_depth(w, a, b, radius)
            if not np.isfinite(depth) or np.isnan(entry):
                continue
            s = (entry * w - a) @ b
            residual = (depth - entry) * scale
            normal = (entry * w - a - s * b) / radius
            if not first <= s <= last or abs(residual) >= gate or abs(normal @ w) < 0.2:
                continue
            rows.append(entry_slopes(w, a, b, radius, s, u, v) * scale)
            residuals.append(residual)
            weights.append((1 - (residual / gate) ** 2) ** 2)
        root = np.sqrt(weights)
        step, *_ = np.linalg.lstsq(np.array(rows) * root[:, None], root * residuals, rcond=None)
        a = a + step[0] * u + step[1] * v
        b = b + step[2] * u + step[3] * v
        b /= np.linalg.norm(b)
        count, rms = len(rows), np.sqrt(np.average(np.square(residuals), weights=weights))
    return a, b, count, rms


class Gathered:
    """What a scan says about beams, ray by ray, into new sums."""

    def __init__(self, scene, *, flanks=True):
        self.scene = scene
        self.likelihood = np.zeros(scene.fine_at[-1])
        self.hits = np.zeros(scene.fine_at[-1])
        self.normal = np.zeros((scene.coarse_at[-1], 22))
        self.scores = np.zeros((len(scene.anchors), 7))
        self.asked = np.zeros(len(scene.anchors), int)
        self.alone = np.zeros(len(scene.anchors), int)
        self.flanks = np.zeros((len(scene.anchors) if flanks else 0, 3, 2))
        self.beside = np.zeros((scene.coarse_at[-1] if flanks else 0, 2, 2))
        for point, ray in zip(scene.points.astype(float), scene.rays, strict=True):
            self._ask(point, ray)
        self.scans = (self.alone >= 3).astype(int)
        self.scatter = np.einsum("ij,ik->ijk", self.scores, self.scores)
        for beside in self.flanks:
            known = [side for side in beside[:2] if side.sum() >= 4]
            worst = max((occupied / (occupied + free) for occupied, free in known), default=0.0)
            beside[2] = np.sum(known) * np.array([worst, 1.0 - worst])

    def _counts(self, place):
        scene = self.scene
        inside = np.all((scene.low <= place) & (place <= scene.high))
        return inside and scene.up @ place + scene.height >= scene.floor

    def _sigma(self, w, depth):
        noise, relative = self.scene.noise
        return np.hypot(noise, relative * depth * w[0]) / w[0]

    def _ask(self, point, ray):
        scene = self.scene
        depth = float(np.linalg.norm(point))
        w = point / depth if np.isfinite(depth) and depth > 0 else ray
        depth = depth if np.isfinite(depth) and depth > 0 else np.inf
        if not w.any():
            return
        met, nearest = {}, {}
        for j, (a, b, radius) in enumerate(
            zip(scene.anchors, scene.directions, scene.radii, strict=True)
        ):
            entry = entry_depth(w, a, b, radius)
            s = (entry * w - a) @ b
            if entry > 0 and 0 <= self._bin(j, s) < self._bins(j) and self._counts(entry * w):
                met[j] = entry, s
                capped = finite_interval(w, a, b, scene.firsts[j], scene.lasts[j], radius)
                if capped is not None:
                    nearest[j] = capped[0]
        for j, (entry, s) in met.items():
            self.asked[j] += 1
            self._answer(j, w, depth, entry, s, nearest)
        if len(self.flanks):
            for j in set(range(len(scene.anchors))) - set(met):
                self._pass_by(j, w, depth, nearest)

    def _bin(self, j, s):
        return np.floor((s - self.scene.starts[j]) / FINE) if np.isfinite(s) else -1

    def _bins(self, j):
        return self.scene.fine_at[j + 1] - self.scene.fine_at[j]

    def _rivals(self, j, nearest, limits):
        ranks = self.scene.ranks
        return np.array([n for o, n in nearest.items() if o != j and ranks[o] <= limits[j]])

    def _answer(self, j, w, depth, entry, s, nearest):
        scene, sigma = self.scene, self._sigma(w, entry)
        a, b, radius = scene.anchors[j], scene.directions[j], scene.radii[j]
        rivals = self._rivals(j, nearest, scene.limits)
        residual = (depth - entry) / sigma
        best = np.min(np.abs(depth - rivals) / sigma, initial=np.inf)
        hidden = np.any(rivals <= entry)
        fine = scene.fine_at[j] + int(self._bin(j, s))
        if residual > 4:
            if not hidden and abs(line_distance(w, a, b)[0]) < 0.8 * radius:
                self.likelihood[fine] -= 4
            return
        if residual < -4:
            return
        if not hidden:
            costs = [min(0.5 * value**2, scene.background) for value in (best, residual)]
            self.likelihood[fine] += costs[0] - costs[1]
        self.hits[fine] += best > abs(residual) + 2
        apart = np.min(np.abs(entry - rivals) / sigma, initial=np.inf)
        if any(self._is_partly_on(o, w, entry) for o in range(len(scene.anchors)) if o != j):
            apart = 0.0
        tells = not hidden and apart >= 4 and abs(residual) < min(scene.tukey, apart / 2)
        tells &= abs(line_distance(w, a, b)[0]) <= radius - scene.blur * entry
        if scene.firsts[j] <= s <= scene.lasts[j] and tells:
            self.alone[j] += 1
            normal = (entry * w - a - s * b) / radius
            if abs(normal @ w) >= 0.2:
                residual -= self._sunk(w, a, b, radius, entry) / sigma
                self._weigh(j, w, s, residual, sigma)

    def _is_partly_on(self, o, w, entry):
        """Whether a ray passes a nearer beam by less than its pixel, where flanks are asked."""
        scene = self.scene
        a, b, radius = scene.anchors[o], scene.directions[o], scene.radii[o]
        apart, middle = line_distance(w, a, b)
        beside = radius < abs(apart) < min(radius + scene.blur * middle, 1.35 * radius + 0.01)
        along = scene.firsts[o] <= (middle * w - a) @ b <= scene.lasts[o]
        return len(self.flanks) > 0 and beside and along and 0 < middle < entry

    def _sunk(self, w, a, b, radius, entry):
        """Half the entry's second derivative across, times the variance of a pixel's place."""
        side = np.cross(w, b) / np.linalg.norm(np.cross(w, b))
        lateral = line_distance(w, a, b)[0]
        curvature = radius**2 / (radius**2 - lateral**2) ** 1.5 / np.linalg.norm(np.cross(w, b))
        pixel = np.diag([0.0, 1.0, 1.0]) * (self.scene.footprint * entry * w[0]) ** 2 / 12
        return 0.5 * curvature * side @ pixel @ side

    def _weigh(self, j, w, s, residual, sigma):
        scene = self.scene
        a, b, u, v = (part[j] for part in (scene.anchors, scene.directions, scene.us, scene.vs))
        slopes = entry_slopes(w, a, b, scene.radii[j], s, u, v) / sigma
        step = 1e-6
        ahead, behind = (entry_depth(w, a, b, scene.radii[j] + k * step) for k in (1, -1))
        thicker = (ahead - behind) / (2 * step * sigma)
        weight = (1 - (residual / scene.tukey) ** 2) ** 2
        row = self.normal[scene.coarse_at[j] + int((s - scene.starts[j]) / COARSE)]
        pairs = [(0, 0), (0, 1), (1, 1), (0, 2), (0, 3), (1, 3), (2, 2), (2, 3), (3, 3)]
        row[:9] += [weight * slopes[m] * slopes[n] for m, n in pairs]
        row[9:13] += weight * slopes * residual
        row[13:16] += weight * residual**2, 1, weight
        row[16:20] += weight * slopes * thicker
        row[20:22] += weight * thicker**2, weight * thicker * residual
        far = s * slopes[2:]
        self.scores[j] += weight * residual * np.concatenate([slopes, [thicker], far])

    def _pass_by(self, j, w, depth, nearest):
        scene = self.scene
        a, b, radius = scene.anchors[j], scene.directions[j], scene.radii[j]
        apart, middle = line_distance(w, a, b)
        s = (middle * w - a) @ b
        if not 1.35 * radius + 0.01 < abs(apart) <= 1.35 * radius + 0.06 or middle <= 0:
            return
        if not scene.firsts[j] <= s <= scene.lasts[j] or not self._counts(middle * w):
            return
        self.asked[j] += 1
        sigma = self._sigma(w, middle)
        rivals = self._rivals(j, nearest, scene.excused)
        explained = np.any(np.abs(depth - rivals) <= 4 * sigma)
        behind, reaches = depth - middle, 2 * radius + 4 * sigma
        if not explained and behind >= -reaches:
            side, free = int(apart > 0), int(behind > reaches)
            self.flanks[j, side, free] += 1
            self.beside[scene.coarse_at[j] + int((s - scene.starts[j]) / COARSE), side, free] += 1


class BentTube:
    """A tube of constant radius about a parabola, met by steps along the ray and bisection.

    The axis is ``a + s b + bow (1 - x**2)``, with x from -1 at one end to 1 at the other.
    """

    def __init__(self, a, b, bow, first, last, radius):
        self.a, self.b, self.bow = a, b, bow
        self.first, self.last, self.radius = first, last, radius

    def axis(self, s):
        x = (2 * np.asarray(s) - self.first - self.last) / (self.last - self.first)
        return self.a + np.multiply.outer(s, self.b) + np.multiply.outer(1 - x**2, self.bow)

    def nearest(self, points):
        """Where on the axis points are, by a golden section about their feet on the chord."""
        middle = (points - self.a) @ self.b
        low, high = middle - 0.2, middle + 0.2
        ratio = (np.sqrt(5) - 1) / 2
        for _ in range(60):
            left, right = high - ratio * (high - low), low + ratio * (high - low)
            closer = self._off(points, left) < self._off(points, right)
            low, high = np.where(closer, low, left), np.where(closer, right, high)
        return (low + high) / 2

    def _off(self, points, s):
        return np.linalg.norm(points - self.axis(s), axis=1)

    def entry(self, rays, near=0.2, far=2.5):
        """Depths at which rays enter, and where along the chord; NaN where they miss."""
        across = np.cross(rays, self.b)
        to_chord = np.abs(across @ self.a) / np.linalg.norm(across, axis=1)
        close = to_chord < self.radius + np.linalg.norm(self.bow)  # others cannot meet the tube
        found = np.full((2, len(rays)), np.nan)
        found[:, close] = self._entry(rays[close], near, far)
        return found

    def _entry(self, rays, near, far):
        depths = np.arange(near, far, 0.01)
        points = (rays[:, None] * depths[:, None]).reshape(-1, 3)
        off = self._off(points, self.nearest(points)).reshape(len(rays), -1)
        closest = off.argmin(axis=1)
        low, high = depths[np.maximum(closest - 12, 0)], depths[closest]
        hit = off.min(axis=1) < self.radius
        for _ in range(40):
            middle = (low + high) / 2
            points = rays * middle[:, None]
            inside = self._off(points, self.nearest(points)) < self.radius
            low, high = np.where(inside, low, middle), np.where(inside, middle, high)
        entry = np.where(hit, high, np.nan)
        return entry, np.where(hit, self.nearest(rays * high[:, None]), np.nan)
