"""The structure as a hypothesis that all rays of the flight are asked about, pass by pass."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from beamseg_batch.config import RunConfig
from beamseg_batch.cylinder.evidence_kernels import gather
from beamseg_batch.cylinder.ray_kernels import on_cylinders
from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import DepthNoise, Detections, Intersection, Scan, Segment
from beamseg_batch.structure.candidates import Candidates
from beamseg_batch.structure.hypothesis import Beam, Sums
from beamseg_batch.structure.intersections import intersections_of
from beamseg_batch.structure.refinement import PassRules, refined

__all__ = ["EvidenceStructure", "Leftovers"]

_TYPICAL_DEPTH_M = 1.0
_EXPLAINED_SIGMAS = 3.5
_POOLED_SCANS = 25
_SETTLED_M = 0.001
_BEHIND = 0.8  # radii from the visible surface to the axis, on average
_RANGE_M = 3.0  # where a return that no beam explains may lie, for its likelihood


@dataclass(frozen=True)
class _Pass:
    """One pass: who competes for rays, and what may be done afterwards.

    Attributes
    ----------
    competitors : str
        ``none``, ``likelier`` (than the beam itself) or ``all``.
    tukey : float
        Reach of Tukey's weight in the fit, sigmas.
    rules : PassRules
    flanks : bool
        Whether rays that pass the beams closely are asked, too.
    """

    competitors: str
    tukey: float
    rules: PassRules
    flanks: bool = False


_FRESH = (
    _Pass("none", 5.0, PassRules(split=True, drop=False, several=False)),
    _Pass("likelier", 5.0, PassRules(split=False, drop=True, several=False)),
    _Pass("all", 5.0, PassRules(split=True, drop=True, several=False), flanks=True),
)
"""Passes after new beams came: refit all, drop doubles, then let all compete."""

_SETTLING = _Pass(
    "all", 4.0, PassRules(split=True, drop=True, several=True, snap=True), flanks=True
)
"""The pass that is repeated until nothing moves."""


class EvidenceStructure:
    """Beams of a flight, found by asking every ray what it says about each.

    Parameters
    ----------
    config : RunConfig
    noise : DepthNoise
    """

    def __init__(self, config: RunConfig, noise: DepthNoise) -> None:
        self.config = config
        self.noise = noise
        self._sigma = noise.at(_TYPICAL_DEPTH_M)
        self._candidates = Candidates(self._sigma)
        self._pixels = _PixelRays()
        self._beams: list[Beam] | None = None
        self._waiting = list(_FRESH)
        self._searched = False

    def __len__(self) -> int:
        return len(self._candidates) if self._beams is None else len(self._beams)

    def update(self, detections: Detections) -> None:
        """Take in the segments of one scan.

        Parameters
        ----------
        detections : Detections
            World frame, on the axes of the beams.
        """
        self._pixels.learn(detections.scan)
        for segment in detections.segments:
            self._candidates.add(segment)

    @property
    def wants_leftovers(self) -> bool:
        """Whether the beams explain what they can, so that it is time to search the rest."""
        return not self._searched and not self._waiting

    def refine(self, scans: Iterable[Scan]) -> bool:
        """Ask all rays of the flight about the present beams, and renew these.

        Parameters
        ----------
        scans : iterable of Scan
            All of the flight.

        Returns
        -------
        bool
            Whether another pass would change anything.
        """
        beams = self._hypothesis()
        kind = self._waiting.pop(0) if self._waiting else _SETTLING
        question = _Question(beams, kind, self.config, self.noise)
        for scan in scans:
            question.ask(scan, self._pixels)
        self._beams = refined(beams, question.sums, self._sigma, kind.rules)
        return bool(self._waiting) or not self._searched or _have_moved(beams, self._beams)

    def leftovers(self, scans: Iterable[Scan]) -> Iterator[Leftovers]:
        """Pool the returns that no beam explains, of some scans at a time.

        Parameters
        ----------
        scans : iterable of Scan
            All of the flight.

        Yields
        ------
        Leftovers
        """
        question = _Question(self._hypothesis(), _SETTLING, self.config, self.noise)
        points: list[FloatArray] = []
        origins: list[FloatArray] = []
        for scan in scans:
            points.append(question.unexplained(scan, _EXPLAINED_SIGMAS * self._sigma))
            origins.append(scan.T_world_sensor.translation)
            if len(points) == _POOLED_SCANS:
                yield Leftovers(np.concatenate(points), np.mean(origins, axis=0), scan.stamp_ns)
                points, origins = [], []
        if points:
            yield Leftovers(np.concatenate(points), np.mean(origins, axis=0), scan.stamp_ns)

    def propose(self, found: Iterable[tuple[Segment, Leftovers]]) -> None:
        """Add beams to the hypothesis; those of one axis become one.

        Parameters
        ----------
        found : iterable of (Segment, Leftovers)
            On the surface, world frame, and what it was found in.
        """
        self._searched = True
        candidates = Candidates(self._sigma)
        for segment, left in found:
            away = segment.midpoint - left.seen_from
            away -= (away @ segment.direction) * segment.direction
            away /= max(float(np.linalg.norm(away)), 1e-9)
            anchor = segment.anchor + _BEHIND * segment.radius * away
            stamp = left.stamp_ns
            candidates.add(replace(segment, anchor=anchor, first_seen_ns=stamp, last_seen_ns=stamp))
        if len(candidates):
            self._beams = [*self._hypothesis(), *candidates.beams(1)]
            self._waiting = list(_FRESH)

    def _hypothesis(self) -> list[Beam]:
        if self._beams is None:
            return self._candidates.beams(self.config.structure.min_scans)
        return self._beams

    def _kept(self) -> list[Beam]:
        return [beam for beam in self._hypothesis() if self._refusal(beam) is None]

    def segments(self) -> tuple[Segment, ...]:
        """Segments seen often and long enough, in order of first detection."""
        kept = sorted(self._kept(), key=lambda beam: (beam.first_seen_ns, *beam.anchor))
        return tuple(_segment(beam) for beam in kept)

    def intersections(self) -> tuple[Intersection, ...]:
        """Intersections of those segments (algorithm 2 of the report)."""
        return intersections_of(self.segments(), self.config.structure.intersections)

    def rejections(self) -> Counter[str]:
        """Beams that are left out of the result, by reason."""
        refusals = map(self._refusal, self._hypothesis())
        return Counter(reason for reason in refusals if reason is not None)

    def _refusal(self, beam: Beam) -> str | None:
        if self._beams is not None and beam.scans < self.config.structure.min_scans:
            return "too_few_scans"
        if beam.length < self.config.structure.min_length:
            return "too_short"
        return None


@dataclass(frozen=True, eq=False)
class Leftovers:
    """Returns of some scans that no beam explains.

    Attributes
    ----------
    points : (N, 3) float64, metres, world frame
    seen_from : (3,) float64, metres, world frame
        Where the camera was, on average.
    stamp_ns : int
        Of the last of the scans.
    """

    points: FloatArray
    seen_from: FloatArray
    stamp_ns: int


class _PixelRays:
    """Direction of each pixel of an organised camera, learned from its returns.

    A pixel without return has no direction of its own, yet it saw through whatever is
    said to stand there.
    """

    def __init__(self) -> None:
        self._sum: FloatArray | None = None
        self._rays: FloatArray | None = None
        self._width = 0
        self._image_width = 0
        self._image = np.zeros(4)

    def learn(self, scan: Scan) -> None:
        if scan.height < 2 or scan.width < 2 or len(scan.points) != scan.width * scan.height:
            return
        if self._sum is None:
            self._sum, self._width = np.zeros((len(scan.points), 3)), scan.width
        if len(scan.points) != len(self._sum) or scan.width != self._width:
            return
        points = np.asarray(scan.points, np.float64)
        finite = np.isfinite(points).all(axis=1)
        self._sum[finite] += points[finite]

    def of(self, scan: Scan) -> tuple[FloatArray, int, FloatArray]:
        """Direction of each pixel, or zeros; pixels a row, or 0; the image's scale."""
        known = self._directions()
        if known is None or len(known) != len(scan.points) or scan.width != self._width:
            return np.zeros((len(scan.points), 3)), 0, self._image
        return known, self._image_width, self._image

    def _directions(self) -> FloatArray | None:
        if self._sum is None:
            return None
        if self._rays is None:
            lengths = np.linalg.norm(self._sum, axis=1)
            self._rays = self._sum / np.where(lengths > 0.0, lengths, np.inf)[:, None]
            self._image_width = self._fit_image(self._rays)
        return self._rays

    def _fit_image(self, rays: FloatArray) -> int:
        """Find the scale of a pinhole image; the width, or 0 if it is none."""
        seen = np.flatnonzero(rays[:, 0] > 1e-3)
        rows, columns = np.divmod(seen, self._width)
        if len(np.unique(rows)) < 2 or len(np.unique(columns)) < 2:
            return 0
        for part, (index, axis) in enumerate(((columns, 1), (rows, 2))):
            slope = rays[seen, axis] / rays[seen, 0]
            step, first = np.polyfit(index, slope, 1)
            if step == 0.0 or np.abs(slope - first - step * index).max() > 0.5 * abs(step):
                return 0
            self._image[2 * part : 2 * part + 2] = first, step
        return self._width


class _Question:
    """What every ray is asked: how well it fits each of these beams."""

    def __init__(
        self, beams: Sequence[Beam], kind: _Pass, config: RunConfig, noise: DepthNoise
    ) -> None:
        self.sums = Sums(beams, flanks=kind.flanks)
        self.noise = noise
        self._scratch: tuple[Any, ...] | None = None
        window = config.filtering.window
        self.low, self.high = np.array([window.x, window.y, window.z]).T.copy()
        trimmed = config.filtering.floor_trim != "none"
        self.floor = config.filtering.floor_trim_height if trimmed else -np.inf
        self.tukey = kind.tukey
        self.background = float(
            np.log(_RANGE_M / (noise.at(_TYPICAL_DEPTH_M) * np.sqrt(2.0 * np.pi)))
        )
        self.anchors = _stacked([beam.anchor for beam in beams])
        self.directions = _stacked([beam.direction for beam in beams])
        normals = [beam.normals for beam in beams]
        self.us, self.vs = (_stacked([pair[k] for pair in normals]) for k in (0, 1))
        self.radii = np.array([beam.radius for beam in beams])
        self.firsts = np.array([beam.first for beam in beams])
        self.lasts = np.array([beam.last for beam in beams])
        order = np.argsort([-beam.score for beam in beams], kind="stable")
        self.ranks = np.empty(len(beams), np.int64)
        self.ranks[order] = np.arange(len(beams))
        below = {"none": -1, "all": len(beams)}
        self.limits = (
            self.ranks - 1
            if kind.competitors == "likelier"
            else np.full(len(beams), below[kind.competitors])
        )

    def ask(self, scan: Scan, pixels: _PixelRays) -> None:
        rays, width, image = pixels.of(scan)
        scratch = self._scratch_of(len(scan.points))
        pose = scan.T_world_sensor
        rotation, origin = pose.rotation, pose.translation
        gather(
            scan.points, rays, width, image, self.noise.constant, self.noise.relative,
            self.low, self.high, rotation[2].copy(), float(origin[2]), self.floor,
            (self.anchors - origin) @ rotation, self.directions @ rotation,
            self.us @ rotation, self.vs @ rotation,
            self.radii, self.firsts, self.lasts, self.ranks, self.limits,
            self.sums.starts, self.sums.fine_at, self.sums.coarse_at,
            self.sums.likelihood, self.sums.hits, self.sums.normal, self.sums.scans,
            self.sums.flanks, self.tukey, self.background, *scratch,
        )  # fmt: skip

    def unexplained(self, scan: Scan, reach: float) -> FloatArray:
        """Returns in the window and above the floor that lie on no beam, world frame."""
        points = np.asarray(scan.points, np.float64)
        inside = np.all((points >= self.low) & (points <= self.high), axis=1)
        world = scan.T_world_sensor.apply(points[inside])
        world = world[world[:, 2] >= self.floor]
        explained = on_cylinders(
            world, self.anchors, self.directions, self.firsts, self.lasts, self.radii, reach
        )
        left: FloatArray = world[~explained]
        return left

    def _scratch_of(self, num_rays: int) -> tuple[Any, ...]:
        if self._scratch is None or len(self._scratch[0]) != num_rays:
            most = 4 * num_rays + 64
            self._scratch = (
                np.full(num_rays, -1), np.empty(num_rays, np.int64),
                np.empty(most, np.int64), np.empty(most, np.int64), np.empty((6, most)),
            )  # fmt: skip
        return self._scratch


def _have_moved(before: Sequence[Beam], after: Sequence[Beam]) -> bool:
    """Whether beams came, went, or have an end that moved."""
    if len(before) != len(after):
        return True
    ends = np.array([np.concatenate(beam.ends) for beam in before])
    # Their order may change, so each is held against all.
    return any(
        np.abs(ends - np.concatenate(beam.ends)).max(axis=1).min() > _SETTLED_M for beam in after
    )


def _stacked(vectors: Sequence[FloatArray]) -> FloatArray:
    return np.array(vectors, np.float64).reshape(-1, 3)


def _segment(beam: Beam) -> Segment:
    """Give the beam as the report models it; the spread of its rays takes the points' place."""
    spread = beam.length**2 / 12.0
    across = 0.5 * beam.radius**2
    return Segment(
        anchor=beam.anchor,
        direction=beam.direction,
        t_min=beam.first,
        t_max=beam.last,
        radius=beam.radius,
        n_points=int(beam.hits),
        pca_coeff=spread / (spread + 2.0 * across),
        pca_eig=np.array([spread, across, across]),
        n_scans=beam.scans,
        first_seen_ns=beam.first_seen_ns,
        last_seen_ns=beam.last_seen_ns,
    )
