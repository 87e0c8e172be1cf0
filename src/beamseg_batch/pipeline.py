"""The whole method on one screen: a recording -> the structure it shows."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from typing import Protocol

from beamseg_batch.config import RunConfig
from beamseg_batch.detection import Detector
from beamseg_batch.errors import NoScansError, RecordingError
from beamseg_batch.model import Detections, FlightResult, ScanRecord, SkippedScan
from beamseg_batch.recording import Flight, Recording, open_flight
from beamseg_batch.structure import Structure, ThinnedCloud

__all__ = ["Progress", "process_flight"]


class Progress(Protocol):
    """Whoever watches a flight being processed."""

    def begin(self, n_clouds: int) -> None:
        """Hear how many clouds there are, before the first."""

    def step(self, n_segments: int) -> None:
        """Hear of one more cloud done or skipped, and how many segments are known."""


class _NobodyWatches:
    def begin(self, n_clouds: int) -> None:
        pass

    def step(self, n_segments: int) -> None:
        pass


def process_flight(
    recording: Recording,
    config: RunConfig,
    *,
    progress: Progress | None = None,
    should_stop: Callable[[], bool] = lambda: False,
) -> FlightResult:
    """Turn a recorded flight into the structure it shows.

    Parameters
    ----------
    recording : Recording
        As `beamseg_batch.recording.open_recording` gives it.
    config : RunConfig
        As `beamseg_batch.config.load_config` gives it.
    progress : Progress, optional
    should_stop : callable, optional
        Asked after every scan; when true, the result is what is known by then, marked
        as interrupted.

    Returns
    -------
    FlightResult
        Also marked as interrupted when the recording turns out to be damaged further on.

    Raises
    ------
    RecordingError
        If the recording has no fitting topics, or no scan of it can be used.
    ConfigError
        If a value does not fit the data.

    Notes
    -----
    The report's figure 2: acquisition, pre-processing, iterative Hough transform,
    sorting, frame conversion, fusion, intersections.
    """
    progress = progress or _NobodyWatches()
    flight = open_flight(recording, config)
    detect = Detector(config)
    structure = Structure(config)
    log = _FlightLog(config)
    progress.begin(flight.n_clouds)
    try:
        for scan in flight.scans():
            if isinstance(scan, SkippedScan):
                log.skip(scan)
            else:
                detections = detect(scan)
                start = time.perf_counter()
                structure.update(detections)
                log.add(detections, (time.perf_counter() - start) * 1e6, len(structure))
            progress.step(len(structure))
            if should_stop():
                log.stop(f"interrupted after {log.n_clouds} of {flight.n_clouds} clouds")
                break
    except RecordingError as error:
        if not log.scans:
            raise
        log.stop(str(error))
    log.check_used(flight, config)
    return log.result(flight, structure)


class _FlightLog:
    """What is told of a flight beside its structure: scans, skips, times, the cloud."""

    def __init__(self, config: RunConfig) -> None:
        self.config = config
        self.start = time.perf_counter()
        self.scans: list[ScanRecord] = []
        self.skipped: Counter[str] = Counter()
        self.first_skip: SkippedScan | None = None
        self.rejections: Counter[str] = Counter()
        self.n_window = 0
        self.n_returns = 0
        self.warnings: list[str] = []
        self.interrupted = False
        leaf_size = config.filtering.leaf_size(max(config.filtering.radii))
        self.cloud = ThinnedCloud(config.outputs.cloud_points, leaf_size)

    @property
    def n_clouds(self) -> int:
        return len(self.scans) + self.skipped.total()

    def skip(self, scan: SkippedScan) -> None:
        self.first_skip = self.first_skip or scan
        self.skipped[scan.reason] += 1

    def add(self, detections: Detections, fuse_us: float, n_segments: int) -> None:
        scan, stage_us = detections.scan, {**detections.stage_us, "fuse": fuse_us}
        self.rejections.update(detections.rejections)
        self.n_window += detections.n_points_window
        self.n_returns += detections.n_points_raw
        self.cloud.add(detections.cloud)
        self.scans.append(
            ScanRecord(
                stamp_ns=scan.stamp_ns,
                pose_stamp_ns=scan.pose_stamp_ns,
                pose_gap_s=scan.pose_gap_s,
                n_points_raw=detections.n_points_raw,
                n_points_filtered=detections.n_points_filtered,
                n_lines=detections.n_lines,
                n_segments=n_segments,
                wall_us=(time.perf_counter() - self.start) * 1e6,
                processing_us=sum(stage_us.values()),
                stage_us=stage_us,
            )
        )

    def stop(self, reason: str) -> None:
        self.interrupted = True
        self.warnings.append(reason)

    def check_used(self, flight: Flight, config: RunConfig) -> None:
        """Refuse a flight of which nothing could be used, saying what stood in the way."""
        topic = f"{flight.recording.name}: {flight.info.cloud_topic}"
        if self.n_clouds == 0 and not self.interrupted:
            raise NoScansError(f"{topic}: holds no cloud")
        if not self.scans and not self.interrupted:
            reasons = ", ".join(f"{n} {reason}" for reason, n in self.skipped.most_common())
            first = f"; the first: {self.first_skip.detail}" if self.first_skip else ""
            raise NoScansError(
                f"{topic}: none of {self.n_clouds} clouds is usable: {reasons}{first}"
            )
        if self.scans and self.n_returns == 0 and not self.interrupted:
            raise NoScansError(f"{topic}: none of {len(self.scans)} clouds holds a return")
        if self.scans and self.n_window == 0 and not self.interrupted:
            window = config.filtering.window
            raise NoScansError(
                f"{topic}: none of the {self.n_returns} points in {len(self.scans)} scans lies in "
                f"the window x {list(window.x)}, y {list(window.y)}, z {list(window.z)} m "
                "(sensor axes, x forward); see filtering.window"
            )

    def result(self, flight: Flight, structure: Structure) -> FlightResult:
        return FlightResult(
            segments=structure.segments(),
            intersections=structure.intersections(),
            scans=tuple(self.scans),
            skipped=self.skipped,
            rejections=self.rejections + structure.rejections(),
            trajectory=flight.trajectory,
            cloud=self.cloud.points(),
            recording=flight.info,
            config=self.config,
            wall_s=time.perf_counter() - self.start,
            warnings=(*self._skip_warnings(), *self.warnings),
            interrupted=self.interrupted,
        )

    def _skip_warnings(self) -> list[str]:
        if self.first_skip is None:
            return []
        reasons = ", ".join(f"{n} {reason}" for reason, n in self.skipped.most_common())
        return [
            f"{self.skipped.total()} of {self.n_clouds} clouds skipped: {reasons}; "
            f"the first: {self.first_skip.detail}"
        ]
