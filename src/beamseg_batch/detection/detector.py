"""One scan -> its segments in the world frame. Stateless, so scans are independent."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import replace
from functools import partial

import numpy as np

from beamseg_batch.config import RunConfig, ScreeningConfig
from beamseg_batch.detection.axis import Returns, fit_segment_axis
from beamseg_batch.detection.filtering import CroppedCloud, crop_scan, voxel_grid
from beamseg_batch.detection.hough import iterative_hough
from beamseg_batch.detection.outliers import without_outliers
from beamseg_batch.detection.screening import Rejection, screen
from beamseg_batch.foreground import thin_foreground
from beamseg_batch.geometry import FloatArray, RigidTransform, distances_to_line, line_parameters
from beamseg_batch.model import DepthNoise, Detections, RefusedLine, Scan, Segment
from beamseg_batch.noise import DEFAULT_NOISE

__all__ = ["Detector", "Refusals"]

_POOLED_PCA = 0.8  # of a beam seven radii long that is seen from all sides


class Detector:
    """The report's sections 3.2.2 to 3.2.5 as a callable.

    Parameters
    ----------
    config : RunConfig
    noise : DepthNoise, optional
        Of the camera; needed for ``detection.axis: cylinder``.
    """

    def __init__(self, config: RunConfig, noise: DepthNoise = DEFAULT_NOISE) -> None:
        self.config = config
        self.noise = noise

    def __call__(self, scan: Scan) -> Detections:
        """Find the segments of one scan.

        Parameters
        ----------
        scan : Scan

        Returns
        -------
        Detections
            Segments in the world frame.
        """
        clock = _StageClock()
        cropped = crop_scan(scan, self.config.filtering)
        candidates = without_outliers(self._foreground(scan, cropped), self.config.filtering)
        refusals = Refusals(keep=self.config.outputs.candidates)
        found: list[Segment] = []
        clouds: list[FloatArray] = []
        left, num_lines = candidates, 0
        clock.lap("filter")
        for radius in sorted(self.config.filtering.radii, reverse=True):
            if found:
                left = self._unclaimed(candidates, found)
            cloud = voxel_grid(left, self.config.filtering.leaf_size(radius))
            clouds.append(cloud)
            clock.lap("filter")
            segments, lines = self._search(cloud, radius, refusals, clock)
            found += segments
            num_lines += lines
        if self.config.detection.axis == "cylinder" and found:
            returns = Returns(scan, self.noise)
            found = [fit_segment_axis(segment, returns) for segment in found]
        T_world_sensor = scan.T_world_sensor
        in_world = [_to_world(segment, T_world_sensor, scan.stamp_ns) for segment in found]
        refusals.move(T_world_sensor, scan.stamp_ns)
        in_world = self._above_floor(in_world, refusals)
        clock.lap("screen")
        return Detections(
            scan=scan,
            segments=tuple(in_world),
            n_points_raw=cropped.num_returns,
            n_points_window=cropped.num_window,
            n_points_filtered=len(clouds[0]),
            n_lines=num_lines,
            rejections=refusals.counts,
            cloud=T_world_sensor.apply(clouds[0]).astype(np.float32),
            stage_us={"read": scan.read_us, **clock.stage_us},
            refused=tuple(refusals.lines),
        )

    def _foreground(self, scan: Scan, cropped: CroppedCloud) -> FloatArray:
        """Points of the cropped cloud that are searched."""
        filtering = self.config.filtering
        if filtering.foreground == "all":
            return cropped.points
        floor = filtering.floor_trim_height if filtering.floor_trim == "points" else -np.inf
        thickest, reach = max(filtering.radii), filtering.window.x[1]
        thin = thin_foreground(scan, thickest, reach, self.noise, floor)
        return cropped.points if thin is scan else crop_scan(thin, filtering).points

    def in_cloud(self, points: FloatArray, refusals: Refusals | None = None) -> list[Segment]:
        """Find the segments of a cloud pooled from several scans.

        Points from all sides make a short beam thick, so less of their variance needs to
        lie along the axis.

        Parameters
        ----------
        points : (N, 3) float64, metres
            Finite.
        refusals : Refusals, optional
            Takes the lines that are refused.

        Returns
        -------
        list of Segment
            On the surface, in the frame of the points.
        """
        found: list[Segment] = []
        refusals = refusals or Refusals()
        for radius in sorted(self.config.filtering.radii, reverse=True):
            cloud = voxel_grid(points, self.config.filtering.leaf_size(radius))
            found += self._search(cloud, radius, refusals, _StageClock(), pooled=True)[0]
        return found

    def _search(
        self,
        cloud: FloatArray,
        radius: float,
        refusals: Refusals,
        clock: _StageClock,
        pooled: bool = False,
    ) -> tuple[list[Segment], int]:
        """Lines of one radius, screened as they come until enough are kept.

        A refused line does not count towards `nlines`: walls and floor would use up the
        limit before the beams are found.
        """
        hough = self.config.detection.hough
        leaf_size = self.config.filtering.leaf_size(radius)
        screening = self._screening(radius, pooled)
        lines = iterative_hough(
            cloud,
            dx=hough.dx or self.config.filtering.diag_voxel(radius),
            granularity=hough.granularity,
            minvotes=hough.minvotes,
        )
        kept: list[Segment] = []
        num_lines = 0
        for line in lines:
            clock.lap("search")
            num_lines += 1
            verdict = screen(
                cloud[line.indices],
                line.direction,
                radius,
                leaf_size,
                hough.minvotes,
                screening,
            )
            if isinstance(verdict, Rejection):
                refusals.add(verdict)
            else:
                kept.append(verdict)
            clock.lap("screen")
            if hough.nlines and len(kept) == hough.nlines:
                break
        clock.lap("search")
        return kept, num_lines

    def _screening(self, radius: float, pooled: bool) -> ScreeningConfig:
        """Criteria for lines of one radius."""
        screening = self.config.detection.screening
        changed: dict[str, object] = {}
        if pooled:
            changed["min_pca_coeff"] = min(screening.min_pca_coeff, _POOLED_PCA)
        if screening.half_round == "thicker" and radius == min(self.config.filtering.radii):
            changed["half_round"] = "none"  # nothing thinner could claim its points
        return screening.model_copy(update=changed)

    def _unclaimed(self, points: FloatArray, segments: list[Segment]) -> FloatArray:
        """Points that belong to none of the segments (report, section 6.3).

        The line runs through the visible surface, so all of that surface lies within a
        diameter of it.
        """
        for segment in segments:
            reach = 2.0 * segment.radius
            t = line_parameters(points, segment.anchor, segment.direction)
            close = distances_to_line(points, segment.anchor, segment.direction) <= reach
            points = points[~(close & (t >= segment.t_min) & (t <= segment.t_max))]
        return points

    def _above_floor(self, segments: list[Segment], refusals: Refusals) -> list[Segment]:
        """Refuse segments with an end below the floor trim (report, section 3.2.5)."""
        if self.config.filtering.floor_trim != "segment":
            return segments
        floor = self.config.filtering.floor_trim_height
        kept = []
        for segment in segments:
            lowest = min(segment.end_1[2], segment.end_2[2])
            if lowest > floor:
                kept.append(segment)
            else:
                refusals.add(
                    Rejection("below_floor", float(lowest), floor, partial(replace, segment))
                )
        return kept


class Refusals:
    """Lines that are refused: counted, and themselves kept only where that is asked.

    Parameters
    ----------
    keep : bool

    Attributes
    ----------
    counts : Counter of str
        By reason.
    lines : list of RefusedLine
        In the frame of what they were found in, until they are moved.
    """

    def __init__(self, *, keep: bool = False) -> None:
        self.counts: Counter[str] = Counter()
        self.lines: list[RefusedLine] = []
        self._keep = keep

    def add(self, rejection: Rejection) -> None:
        """Take in what screening says of a line."""
        self.counts[rejection.reason] += 1
        segment = rejection.segment if self._keep else None
        if segment is None:
            return
        if rejection.t is not None:  # the stretch that was judged
            low, high = float(rejection.t.min()), float(rejection.t.max())
            segment = replace(segment, t_min=low, t_max=high, n_points=len(rejection.t))
        line = replace(segment, points=np.empty((0, 3)))
        self.lines.append(RefusedLine(line, rejection.reason, rejection.value, rejection.limit))

    def move(self, T_world_sensor: RigidTransform, stamp_ns: int) -> None:
        """Move the lines to the world frame, and say when they were seen."""
        self.lines = [
            replace(line, segment=_to_world(line.segment, T_world_sensor, stamp_ns))
            for line in self.lines
        ]


def _to_world(segment: Segment, T_world_sensor: RigidTransform, stamp_ns: int) -> Segment:
    """Move a segment from the sensor frame to the world frame (report, section 3.2.5)."""
    return replace(
        segment,
        anchor=T_world_sensor.apply(segment.anchor),
        direction=T_world_sensor.rotate(segment.direction),
        points=T_world_sensor.apply(segment.points),
        first_seen_ns=stamp_ns,
        last_seen_ns=stamp_ns,
    )


class _StageClock:
    """Adds up the time between laps by stage."""

    def __init__(self) -> None:
        self.stage_us: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.stage_us[stage] = self.stage_us.get(stage, 0.0) + (now - self._last) * 1e6
        self._last = now
