"""What is told of a flight beside its structure."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from beamseg_batch.config import RunConfig
from beamseg_batch.detection import (
    Refusals,
)
from beamseg_batch.errors import NoScansError
from beamseg_batch.model import (
    Candidate,
    DepthNoise,
    Detections,
    FlightResult,
    RecordingInfo,
    ScanRecord,
    Segment,
    SensorModel,
    SkippedScan,
)
from beamseg_batch.reasons import LEFTOVER
from beamseg_batch.recording import Flight
from beamseg_batch.structure import (
    EvidenceStructure,
    RefusedLines,
    Structure,
    ThinnedCloud,
    joints_of,
    members_of,
)
from beamseg_batch.structure.fates import MOST_LINES

__all__ = ["FlightLog", "millimetres"]


class FlightLog:
    """What is told of a flight beside its structure: scans, skips, times, the cloud.

    Parameters
    ----------
    config : RunConfig
    noise : DepthNoise
    asked : RunConfig, optional
        What the user asked for, where radii were found since.
    told : str, optional
        What is to be said of those.

    Attributes
    ----------
    scans : list of ScanRecord
        Those that were searched.
    """

    def __init__(
        self,
        config: RunConfig,
        noise: DepthNoise,
        asked: RunConfig | None = None,
        told: str = "",
    ) -> None:
        self.config, self.asked, self.told = config, asked or config, told
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
        self.refused = RefusedLines(noise.constant, "scan")
        self.refused_leftovers = RefusedLines(noise.constant, "leftovers")

    @property
    def n_clouds(self) -> int:
        """Clouds that were searched or skipped."""
        return len(self.scans) + self.skipped.total()

    def skip(self, scan: SkippedScan) -> None:
        """Hear of a cloud that cannot be used."""
        self.first_skip = self.first_skip or scan
        self.skipped[scan.reason] += 1

    def add(self, detections: Detections, fuse_us: float, n_segments: int) -> None:
        """Hear of a scan that was searched, and how many segments are known since."""
        scan, stage_us = detections.scan, {**detections.stage_us, "fuse": fuse_us}
        self.rejections.update(detections.rejections)
        self.refused.add(detections.refused)
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

    def add_leftovers(self, refusals: Refusals) -> None:
        """Hear of lines that were refused in what no beam explains."""
        counts = {LEFTOVER + reason: count for reason, count in refusals.counts.items()}
        self.rejections.update(counts)
        self.refused_leftovers.add(refusals.lines)

    def stop(self, reason: str) -> None:
        """Hear that the flight is not processed to its end, and why."""
        self.interrupted = True
        self.warnings.append(reason)

    def check_used(self, flight: Flight) -> None:
        """Refuse a flight of which nothing could be used, saying what stood in the way."""
        if self.interrupted:
            return
        topic = f"{flight.recording.name}: {flight.info.cloud_topic}"
        if self.n_clouds == 0:
            raise NoScansError(f"{topic}: holds no cloud")
        if not self.scans:
            reasons = ", ".join(f"{n} {reason}" for reason, n in self.skipped.most_common())
            first = f"; the first: {self.first_skip.detail}" if self.first_skip else ""
            raise NoScansError(
                f"{topic}: none of {self.n_clouds} clouds is usable: {reasons}{first}"
            )
        if self.n_returns == 0:
            raise NoScansError(f"{topic}: none of {len(self.scans)} clouds holds a return")
        if self.n_window == 0:
            window = self.config.filtering.window
            raise NoScansError(
                f"{topic}: none of the {self.n_returns} points in {len(self.scans)} scans lies in "
                f"the window x {list(window.x)}, y {list(window.y)}, z {list(window.z)} m "
                "(sensor axes, x forward); see filtering.window"
            )

    def result(
        self, flight: Flight, structure: Structure | EvidenceStructure, sensor: SensorModel
    ) -> FlightResult:
        """Put together all that is known of a flight."""
        segments = structure.segments()
        joints, intersections = joints_of(segments, structure.intersections())
        end_slack = self.config.structure.intersections.end_slack
        if isinstance(structure, EvidenceStructure):
            sensor = replace(sensor, pitch_rad=structure.pitch_rad)
        return FlightResult(
            segments=segments,
            intersections=intersections,
            joints=joints,
            members=members_of(segments, joints, end_slack),
            scans=tuple(self.scans),
            skipped=self.skipped,
            rejections=self.rejections + structure.rejections(),
            trajectory=flight.trajectory,
            cloud=self.cloud.points(),
            recording=self._info(flight, segments),
            config=self.asked,
            wall_s=time.perf_counter() - self.start,
            sensor=sensor,
            warnings=(
                *flight.info.damage_notes,
                *self._skip_warnings(),
                *self._candidate_warnings(),
                *self.warnings,
            ),
            interrupted=self.interrupted,
            candidates=self._candidates(structure),
        )

    def _candidates(self, structure: Structure | EvidenceStructure) -> tuple[Candidate, ...] | None:
        """All that might have been a beam, from the first stage to the last, if it is kept."""
        if not self.config.outputs.candidates:
            return None
        lines = (*self.refused.candidates(), *self.refused_leftovers.candidates())
        return (*lines, *structure.candidates())

    def _candidate_warnings(self) -> list[str]:
        left_out = self.refused.n_left_out + self.refused_leftovers.n_left_out
        if not left_out:
            return []
        return [
            f"candidates.parquet leaves out {left_out} refused lines: it keeps those at "
            f"{MOST_LINES} places; they are counted all the same"
        ]

    def _info(self, flight: Flight, segments: Sequence[Segment]) -> RecordingInfo:
        """What was read, and what radii it was found to hold where none was configured."""
        if not self.told:
            return flight.info
        found = sorted({segment.radius for segment in segments}, reverse=True)
        outcome = f"the beams have the radii {millimetres(found)}" if found else "no beam was found"
        return replace(flight.info, notes=(*flight.info.notes, self.told, outcome))

    def _skip_warnings(self) -> list[str]:
        if self.first_skip is None:
            return []
        reasons = ", ".join(f"{n} {reason}" for reason, n in self.skipped.most_common())
        return [
            f"{self.skipped.total()} of {self.n_clouds} clouds skipped: {reasons}; "
            f"the first: {self.first_skip.detail}"
        ]


def millimetres(radii: Sequence[float]) -> str:
    """Say radii, metres, for people."""
    return ", ".join(f"{1e3 * radius:.1f} mm" for radius in radii)
