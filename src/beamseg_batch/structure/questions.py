"""What all rays of the flight are asked about the beams of a hypothesis, scans at a time.

A question is fixed when it is made, can be sent to another process, and is answered by
sums over scans alone; answers are added up in the order of the scans.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.config import FilteringConfig
from beamseg_batch.cylinder.end_kernels import gather_ends
from beamseg_batch.cylinder.evidence_kernels import gather
from beamseg_batch.cylinder.meeting_kernels import Cylinders, Meetings, View
from beamseg_batch.cylinder.ray_kernels import on_cylinders
from beamseg_batch.foreground import thin_foreground
from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import DepthNoise, PoseJitter, Scan
from beamseg_batch.structure.hypothesis import Answer, Beam, Sums
from beamseg_batch.structure.pixel_rays import PixelRays, every

__all__ = [
    "END_PLACES",
    "AxisQuestion",
    "Beams",
    "Camera",
    "EndQuestion",
    "LeftoverQuestion",
    "Leftovers",
]

_NO_JITTER = PoseJitter()

END_PLACES: FloatArray = np.arange(-20.0, 21.0) * 0.002
"""Where an end may be, metres from where it was."""

_RANGE_M = 3.0  # where a return that no beam explains may lie, for its likelihood
_TYPICAL_DEPTH_M = 1.0
_EXPLAINED_SIGMAS = 3.5
_BLURRED_PIXELS = 0.75
_WIDTH = np.sqrt(12.0)  # of an even distribution, in its standard deviations
_ASKED_BEYOND_M = 0.5  # more than the margin beyond a beam's ends that is asked about
_ENOUGH_PIXELS = 8000


class Camera:
    """How scans were seen: noise, window, floor, and the directions of the pixels.

    Parameters
    ----------
    filtering : FilteringConfig
    noise : DepthNoise
    pixels : PixelRays
    jitter : PoseJitter, optional
        Of the poses of the scans.
    """

    def __init__(
        self,
        filtering: FilteringConfig,
        noise: DepthNoise,
        pixels: PixelRays,
        jitter: PoseJitter = _NO_JITTER,
    ) -> None:
        window = filtering.window
        self.low, self.high = np.array([window.x, window.y, window.z]).T.copy()
        trimmed = filtering.floor_trim != "none"
        self.floor = filtering.floor_trim_height if trimmed else -np.inf
        self.noise, self.pixels = noise, pixels
        self.thin = filtering.foreground == "thin"
        self.thickest = max(filtering.radii)
        shaken = np.hypot(jitter.left_attitude, jitter.left_position / _TYPICAL_DEPTH_M)
        self.shake = float(shaken) if jitter.memory_s > 0.0 else 0.0

    @property
    def sigma(self) -> float:
        """Noise of a depth, typically, metres."""
        return self.noise.at(_TYPICAL_DEPTH_M)

    @property
    def background(self) -> float:
        """Cost of a return that no beam explains, as half a squared residual."""
        return float(np.log(_RANGE_M / (self.sigma * np.sqrt(2.0 * np.pi))))

    @property
    def pixel_m(self) -> float:
        """Width of a pixel that mixes depths, typically, metres; 0 where none does."""
        pitch = self.pixels.pitch_rad if self.noise.mixed else None
        return _TYPICAL_DEPTH_M * (pitch or 0.0)

    @property
    def reach(self) -> float:
        """How far away something in the window may be, metres."""
        return float(np.linalg.norm(np.maximum(np.abs(self.low), np.abs(self.high))))

    @property
    def stride(self) -> int:
        """Every so manieth row and column is enough to tell where beams are, roughly."""
        return max(int(np.sqrt(self.pixels.count / _ENOUGH_PIXELS)), 1)

    def view(self, scan: Scan, stride: int = 1) -> View:
        """Return a scan as the kernels take it, or every so manieth row and column of it."""
        rays, width, image = self.pixels.of(scan, stride)
        points, footprint = scan.points, abs(float(image[1])) if self.noise.mixed else 0.0
        if len(rays) < len(points):
            points, footprint = every(points, scan.width, stride), footprint / stride
            points.flags.writeable = False  # as all points of a recording
        # What is left of the jitter smears a surface over the scans as a pixel does over its own
        # width. Without that, outlines count, which are smeared the other way.
        smeared = float(np.hypot(footprint, _WIDTH * self.shake)) if footprint else 0.0
        pose = scan.T_world_sensor
        return View(
            points, rays, width, image, self.noise.constant, self.noise.relative,
            self.low, self.high, pose.rotation[2].copy(), float(pose.translation[2]), self.floor,
            _BLURRED_PIXELS * footprint, smeared,
        )  # fmt: skip


class Beams:
    """Arrays of a hypothesis, in the world frame, and who competes with whom."""

    def __init__(self, beams: Sequence[Beam], competitors: str) -> None:
        self.anchors = _stacked([beam.anchor for beam in beams])
        self.directions = _stacked([beam.direction for beam in beams])
        normals = [beam.normals for beam in beams]
        self.us, self.vs = (_stacked([pair[k] for pair in normals]) for k in (0, 1))
        self.bows = _stacked([beam.bow for beam in beams])
        self.radii = np.array([beam.radius for beam in beams])
        self.firsts = np.array([beam.first for beam in beams])
        self.lasts = np.array([beam.last for beam in beams])
        # Doubtful ones that no ray was asked about yet.
        fresh = np.array([beam.doubtful and np.isnan(beam.beside) for beam in beams], np.bool_)
        order = np.lexsort((np.array([-beam.score for beam in beams]), fresh))
        self.ranks = np.empty(len(beams), np.int64)
        self.ranks[order] = np.arange(len(beams))
        # Several of them may cover a surface, each explaining what is beside the others.
        self.excused = np.full(len(beams), np.sum(~fresh) - 1)
        self.limits = {
            "none": np.full(len(beams), -1),
            "likelier": self.ranks - 1,
            "all": np.full(len(beams), len(beams)),
        }[competitors]

    def near(self, scans: Sequence[Scan], reach: float) -> NDArray[np.int64]:
        """Indices of the beams that come as near to the camera as that in some of the scans."""
        if not scans:
            return np.zeros(0, np.int64)
        places = np.array([scan.T_world_sensor.translation for scan in scans])
        middles = self.anchors + 0.5 * (self.firsts + self.lasts)[:, None] * self.directions
        bows = np.linalg.norm(self.bows, axis=1)
        sizes = 0.5 * (self.lasts - self.firsts) + self.radii + bows + _ASKED_BEYOND_M
        low, high = places.min(axis=0) - reach, places.max(axis=0) + reach
        beyond = np.maximum(np.maximum(low - middles, middles - high), 0.0)
        return np.flatnonzero(np.einsum("ij,ij->i", beyond, beyond) <= sizes * sizes)

    def part(self, indices: NDArray[np.int64]) -> Beams:
        """Return some of the beams; who competes with whom stays the same."""
        part = copy(self)
        for name, values in vars(self).items():
            setattr(part, name, values[indices])
        return part

    def seen_from(self, scan: Scan, starts: FloatArray, stops: FloatArray) -> Cylinders:
        """Return the beams in the sensor frame of a scan, to be asked about on a stretch."""
        pose = scan.T_world_sensor
        turn = pose.rotation
        return Cylinders(
            (self.anchors - pose.translation) @ turn, self.directions @ turn,
            self.us @ turn, self.vs @ turn, self.bows @ turn,
            self.radii, self.firsts, self.lasts,
            starts, stops, self.ranks, self.limits, self.excused,
        )  # fmt: skip


class AxisQuestion:
    """How well every ray fits each beam, and where the axis should be instead.

    Parameters
    ----------
    beams : sequence of Beam
    camera : Camera
    competitors : {'none', 'likelier', 'all'}
        Which beams a beam competes with for rays.
    tukey : float
        Reach of Tukey's weight, sigmas.
    flanks : bool
        Whether rays that pass the beams closely are asked, too.
    stride : int, optional
        Every so manieth row and column is asked.
    """

    def __init__(
        self,
        beams: Sequence[Beam],
        camera: Camera,
        *,
        competitors: str,
        tukey: float,
        flanks: bool,
        stride: int = 1,
    ) -> None:
        self.beams = tuple(beam.bare() for beam in beams)
        self.camera, self.tukey, self.flanks, self.stride = camera, tukey, flanks, stride
        self._arrays = Beams(beams, competitors)

    def sums(self) -> Sums:
        """Nothing yet, to be added to."""
        return Sums(self.beams, flanks=self.flanks)

    def ask(self, scans: Sequence[Scan]) -> Answer:
        """Ask the rays of some scans.

        Parameters
        ----------
        scans : sequence of Scan
            The fewer beams are in view of any of them, the less work it is.

        Returns
        -------
        Answer
        """
        near = self._arrays.near(scans, self.camera.reach)
        arrays = self._arrays.part(near)
        sums, scratch = Sums([self.beams[k] for k in near], flanks=self.flanks), _Scratch()
        alone, scores = np.zeros(len(near), np.int64), np.zeros((len(near), 11))
        for scan in scans:
            view = self.camera.view(scan, self.stride)
            gather(
                view, arrays.seen_from(scan, sums.starts, sums.stops),
                sums.evidence, self.tukey, self.camera.background,
                scratch.meetings(len(view.points)), alone, scores,
            )  # fmt: skip
        answer = sums.answer()
        return replace(answer, beams=near[answer.beams])


class EndQuestion:
    """Where the rays near the ends of beams put these.

    Parameters
    ----------
    beams : sequence of Beam
    camera : Camera
    """

    def __init__(self, beams: Sequence[Beam], camera: Camera) -> None:
        self.camera = camera
        self._arrays = Beams(beams, "all")

    def sums(self) -> FloatArray:
        """(M, 2, N) float64: log-likelihood of each beam by both ends' places, none yet."""
        return np.zeros((len(self._arrays.radii), 2, len(END_PLACES)))

    def ask(self, scans: Iterable[Scan]) -> FloatArray:
        """Ask the rays of some scans.

        Parameters
        ----------
        scans : iterable of Scan

        Returns
        -------
        (M, 2, N) float64
            Log-likelihood ratio of each beam with its first or last end moved to each of
            `END_PLACES`.
        """
        likelihood, scratch = self.sums(), _Scratch()
        margin = 0.3
        starts, stops = self._arrays.firsts - margin, self._arrays.lasts + margin
        for scan in scans:
            gather_ends(
                self.camera.view(scan), self._arrays.seen_from(scan, starts, stops),
                END_PLACES, likelihood, self.camera.background,
                scratch.meetings(len(scan.points)),
            )  # fmt: skip
        return likelihood


@dataclass(frozen=True, eq=False)
class Leftovers:
    """Returns of some scans that no beam explains.

    Attributes
    ----------
    points : (N, 3) float64, metres, world frame
    is_free : (N,) bool
        Which of them stand free in their picture.
    seen_from : (3,) float64, metres, world frame
        Where the camera was, on average.
    stamp_ns : int
        Of the last of the scans.
    """

    points: FloatArray
    is_free: NDArray[np.bool_]
    seen_from: FloatArray
    stamp_ns: int


class LeftoverQuestion:
    """Which returns no beam explains.

    Parameters
    ----------
    beams : sequence of Beam
    camera : Camera
    """

    def __init__(self, beams: Sequence[Beam], camera: Camera) -> None:
        self.camera = camera
        self._arrays = Beams(beams, "none")

    def ask(self, scans: Sequence[Scan]) -> Leftovers:
        """Pool what some scans leave.

        Parameters
        ----------
        scans : sequence of Scan
            At least one.

        Returns
        -------
        Leftovers
        """
        points, free = zip(*map(self._unexplained, scans), strict=True)
        return Leftovers(
            np.concatenate(points),
            np.concatenate(free),
            np.mean([scan.T_world_sensor.translation for scan in scans], axis=0),
            scans[-1].stamp_ns,
        )

    def _unexplained(self, scan: Scan) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Returns in the window and above the floor that lie on no beam, and which are free."""
        camera = self.camera
        inside = np.ones(len(scan.points), np.bool_)
        for part, low, high in zip(scan.points.T, camera.low, camera.high, strict=True):
            inside &= (part >= low) & (part <= high)
        points = scan.points[inside].astype(np.float64)
        world, free = scan.T_world_sensor.apply(points), self._free(scan)[inside]
        high = world[:, 2] >= camera.floor
        world, free = world[high], free[high]
        reach = _EXPLAINED_SIGMAS * camera.sigma
        beams = self._arrays.part(self._arrays.near([scan], camera.reach))
        explained = on_cylinders(
            world, beams.anchors, beams.directions, beams.firsts, beams.lasts,
            beams.bows, beams.radii, reach,
        )  # fmt: skip
        return world[~explained], free[~explained]

    def _free(self, scan: Scan) -> NDArray[np.bool_]:
        """Which pixels show something thin that stands free."""
        camera = self.camera
        if not camera.thin:
            return np.ones(len(scan.points), np.bool_)
        # What is only seen at the border of the image is seen too seldom to be found
        # in a scan alone, so it counts here; whether it is a beam all rays decide.
        thin = thin_foreground(
            scan, camera.thickest, camera.high[0], camera.noise, camera.floor, beyond=True
        )
        free: NDArray[np.bool_] = np.isfinite(thin.points[:, 0])
        return free


class _Scratch:
    """Meetings of a scan, made once for scans of the same size."""

    def __init__(self) -> None:
        self._meetings: Meetings | None = None

    def meetings(self, num_rays: int) -> Meetings:
        if self._meetings is None or len(self._meetings.head) != num_rays:
            most = 4 * num_rays + 64
            whole: Any = [np.empty(most, np.int64) for _ in range(2)]
            self._meetings = Meetings(
                np.full(num_rays, -1), np.empty(num_rays, np.int64),
                *whole, *(np.empty(most) for _ in range(7)),
            )  # fmt: skip
        return self._meetings


def _stacked(vectors: Sequence[FloatArray]) -> FloatArray:
    return np.array(vectors, np.float64).reshape(-1, 3)
