"""The whole method on one screen: a recording -> the structure it shows."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Protocol

import numpy as np

from beamseg_batch.config import FilteringConfig, RefinementConfig, RunConfig, ShapeConfig
from beamseg_batch.detection import (
    DEFAULT_NOISE,
    Detector,
    Refusals,
    check_outlier_filter,
    depth_noise,
)
from beamseg_batch.errors import BeamsegError, NoScansError, WorkerError
from beamseg_batch.foreground import thin_foreground
from beamseg_batch.geometry import RigidTransform
from beamseg_batch.model import (
    Candidate,
    DepthNoise,
    Detections,
    FlightResult,
    RecordingInfo,
    Scan,
    ScanRecord,
    Segment,
    SensorModel,
    SkippedScan,
)
from beamseg_batch.parallel import Workers
from beamseg_batch.reasons import LEFTOVER
from beamseg_batch.recording import Flight, Recording, open_flight
from beamseg_batch.recording.survey import survey_flight
from beamseg_batch.structure import (
    EvidenceStructure,
    LeftoverQuestion,
    Leftovers,
    NearRays,
    RefusedLines,
    Structure,
    ThinnedCloud,
    intersections_of,
    joints_of,
    members_of,
    warm_up_sections,
)
from beamseg_batch.structure.fates import MOST_LINES

_SCANS_A_BATCH = 25
_SCANS_SENT = 5
"""Scans that are sent to a worker at a time in the first pass."""
_END_GROUPS = 12
"""Parts of the flight that each tell where the ends are, by how far they differ how surely."""
_LADDER = (0.1, 0.05, 0.03)
"""Radii to begin with where none is configured, metres: near enough to any between and beyond."""
_REHEARSED_SCANS, _REHEARSAL_PASSES, _REHEARSED_MEASUREMENTS = 120, 60, 10
_MEASUREMENTS = 3  # of radii that a rehearsal told

__all__ = ["Progress", "process_flight", "search_scans", "warm_up"]


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
    jobs: int = 1,
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
    jobs : int, optional
        Processes that search the scans and ask their rays; 0 for as many as there are
        cores. The result does not depend on it, only the time it takes.
    progress : Progress, optional
    should_stop : callable, optional
        Asked after every scan; when true, the result is what is known by then, marked
        as interrupted.

    Returns
    -------
    FlightResult
        Also marked as interrupted when the recording turns out to be damaged further on,
        a value not to fit a later scan, or a worker process ends: what is known by then is
        not lost.

    Raises
    ------
    RecordingError
        If the recording has no fitting topics, or no scan of it can be used.
    ConfigError
        If a value does not fit the first scan, or `jobs` is negative.
    WorkerError
        If a worker process ends before the first scan is done.
    Open3DMissingError
        If ``filtering.outliers`` asks for a filter that cannot be loaded.

    Notes
    -----
    The report's figure 2: acquisition, pre-processing, iterative Hough transform,
    sorting, frame conversion, fusion, intersections; then what these make, joints and members.
    """
    progress = progress or _NobodyWatches()
    check_outlier_filter(config.filtering)
    with Workers(jobs) as workers:
        flight = open_flight(recording, config)
        if config.sensor.organise:
            flight = flight.organised()
        warm_up(config)
        workers.start(warm_up, config)
        noise, passes = _noise(flight, config), _passes(config)
        rehearsal = _Rehearsal(flight, noise) if not config.filtering.radii else None
        clouds = flight.n_clouds * (1 + passes)
        progress.begin(clouds + (rehearsal.n_clouds if rehearsal else 0))
        if rehearsal:
            rehearsal.hold(workers, progress, should_stop)
            config = rehearsal.outcome(config)
        detect = Detector(config, noise)
        sensor = SensorModel(noise, flight.jitter)
        structure = _structure(config, sensor, measurements=_MEASUREMENTS if rehearsal else 0)
        log = _FlightLog(config, noise, rehearsal)
        try:
            stopped = _detect(structure, detect, flight, workers, log, progress, should_stop)
            if isinstance(structure, EvidenceStructure) and not stopped:
                _refine(structure, detect, flight, passes, workers, log, progress, should_stop)
        except WorkerError as error:
            if not log.scans:
                raise
            log.stop(str(error))
    log.check_used(flight)
    return log.result(flight, structure, sensor)


def search_scans(
    recording: Recording, result: FlightResult, *, jobs: int = 1
) -> Iterator[Detections]:
    """Search every scan of a flight, each by itself, as the first pass over it did.

    Parameters
    ----------
    recording : Recording
    result : FlightResult
        What `process_flight` made of it.
    jobs : int, optional
        As in `process_flight`.

    Yields
    ------
    Detections
        Of each usable scan, in order, up to where the recording ends or is damaged; the
        points of the scans are not kept.

    Raises
    ------
    RecordingError, ConfigError, WorkerError
        As `process_flight` does.
    """
    config = result.config
    if not config.filtering.radii:
        config = _with_found_radii(config, [segment.radius for segment in result.segments])
    with Workers(jobs) as workers:
        flight = open_flight(recording, config)
        if config.sensor.organise:
            flight = flight.organised()
        detect = Detector(config, _noise(flight, config))
        workers.start(warm_up, config)
        for scan, found in workers.map(_ScanSearch(detect), flight.usable(), _SCANS_SENT):
            if found is not None:
                yield replace(found, scan=scan.with_points(scan.points[:0]))


class _Rehearsal:
    """A part of the flight processed with many radii, to learn which ones the beams have.

    Parameters
    ----------
    flight : Flight
        Its configuration says what is to be processed, and how.
    noise : DepthNoise
        Of its camera, when it was measured.
    """

    def __init__(self, flight: Flight, noise: DepthNoise) -> None:
        self.asked = flight.config
        self._part = flight.thinned(-(-flight.n_clouds // _REHEARSED_SCANS))
        told = survey_flight(self._part).beam_radii()
        beyond = [r for r in told if not 0.8 * min(_LADDER) < r < 1.25 * max(_LADDER)]
        self._config = _rehearsed(flight.config, (*_LADDER, *beyond))
        self._noise = (
            noise
            if flight.config.structure.fusion == "evidence"
            else depth_noise(flight.usable(), flight.config.sensor)
        )
        self.n_scans = self._part.n_clouds
        self.radii: tuple[float, ...] = ()

    @property
    def n_clouds(self) -> int:
        """Clouds that are gone through, at most."""
        return self.n_scans * (1 + _passes(self._config))

    def hold(self, workers: Workers, progress: Progress, should_stop: Callable[[], bool]) -> None:
        """Process the part."""
        detect = Detector(self._config, self._noise)
        structure = EvidenceStructure(
            self._config, self._noise, measurements=_REHEARSED_MEASUREMENTS
        )
        log = _FlightLog(self._config, self._noise)
        watched = (workers, log, progress, should_stop)
        if not _detect(structure, detect, self._part, *watched):
            _refine(structure, detect, self._part, _passes(self._config), *watched)
        self.radii = structure.measured_radii

    def outcome(self, config: RunConfig) -> RunConfig:
        """Return a configuration with the radii that were found, else with the usual one."""
        return _with_found_radii(config, self.radii)

    @property
    def told(self) -> str:
        """What came of it, for people."""
        where = f"in {self.n_scans} clouds of the flight"
        if not self.radii:
            usual = _millimetres(FilteringConfig().radii)
            return f"no beam shows its radius {where}: beams of {usual} were looked for"
        return f"beams {where} have the radii {_millimetres(self.radii)}, which were looked for"


def _millimetres(radii: Sequence[float]) -> str:
    return ", ".join(f"{1e3 * radius:.1f} mm" for radius in radii)


def _rehearsed(config: RunConfig, radii: Sequence[float]) -> RunConfig:
    """Return the configuration of a rehearsal: rays are asked, whatever the run does later."""
    changes = {
        "detection": {"axis": "cylinder"},
        "structure": {"fusion": "evidence", "shapes": ShapeConfig(enabled=False)},
        "refinement": {**RefinementConfig().model_dump(), "passes": _REHEARSAL_PASSES},
    }
    changed = {
        name: getattr(config, name).model_copy(update=update) for name, update in changes.items()
    }
    return _with_radii(config.model_copy(update=changed), radii)


def _with_found_radii(config: RunConfig, radii: Sequence[float]) -> RunConfig:
    """Return a configuration with the radii that were found, else with the usual one."""
    return _with_radii(config, sorted(set(radii), reverse=True) or FilteringConfig().radii)


def _with_radii(config: RunConfig, radii: Sequence[float]) -> RunConfig:
    filtering = config.filtering.model_copy(update={"radii": tuple(radii)})
    return config.model_copy(update={"filtering": filtering})


def _passes(config: RunConfig) -> int:
    return config.refinement.passes if config.structure.fusion == "evidence" else 0


def _detect(
    structure: Structure | EvidenceStructure,
    detect: Detector,
    flight: Flight,
    workers: Workers,
    log: _FlightLog,
    progress: Progress,
    should_stop: Callable[[], bool],
) -> bool:
    """Find the segments of every scan; return whether a stop was asked for."""
    try:
        for scan, detections in workers.map(_ScanSearch(detect), flight.scans(), _SCANS_SENT):
            if isinstance(scan, SkippedScan):
                log.skip(scan)
            elif detections is not None:
                start = time.perf_counter()
                structure.update(replace(detections, scan=scan))
                log.add(detections, (time.perf_counter() - start) * 1e6, len(structure))
            progress.step(len(structure))
            if should_stop():
                log.stop(f"interrupted after {log.n_clouds} of {flight.n_clouds} clouds")
                return True
    except WorkerError:
        raise
    except BeamsegError as error:
        if not log.scans:
            raise
        log.stop(str(error))
    return False


@dataclass(frozen=True)
class _ScanSearch:
    """What a worker does with a scan; its points are not sent back."""

    detect: Detector

    def __call__(self, scan: Scan | SkippedScan) -> Detections | None:
        if isinstance(scan, SkippedScan):
            return None
        detections = self.detect(scan)
        return replace(detections, scan=replace(scan, points=scan.points[:0]))


def _refine(
    structure: EvidenceStructure,
    detect: Detector,
    flight: Flight,
    passes: int,
    workers: Workers,
    log: _FlightLog,
    progress: Progress,
    should_stop: Callable[[], bool],
) -> None:
    """Ask all rays of the flight about the beams found so far, pass by pass."""
    for number in range(passes):
        if structure.wants_leftovers:
            _search_leftovers(structure, detect, flight, workers, log)
        question = structure.question()
        sums = question.sums()
        for scans, answer in workers.map(question.ask, _batches(flight)):
            sums.add(answer)
            for _ in scans:
                progress.step(len(structure))
        if not structure.renew(sums):
            break
        if should_stop():
            log.stop(f"interrupted after pass {number + 1} of {passes} over the rays")
            return
    if passes and structure.config.refinement.ends:
        ends = structure.end_question()
        likelihood = np.stack([ends.sums()] * _END_GROUPS)
        answers = workers.map(ends.ask, _batches(flight))
        for number, (_, answered) in enumerate(answers):
            likelihood[number % _END_GROUPS] += answered
        structure.set_ends(likelihood)
    if passes and structure.config.structure.shapes.enabled:
        _find_sections(structure, flight, workers)


def _find_sections(structure: EvidenceStructure, flight: Flight, workers: Workers) -> None:
    """Ask the rays near each beam for its cross-section."""
    question, near = structure.section_question(), NearRays()
    for _, samples in workers.map(question.ask, _batches(flight)):
        near.add(samples)
    found = workers.map(structure.section_trial(), structure.beams_with(near))
    structure.set_sections([beam for _, beam in found])


def _search_leftovers(
    structure: EvidenceStructure,
    detect: Detector,
    flight: Flight,
    workers: Workers,
    log: _FlightLog,
) -> None:
    """Look for beams that no scan alone shows, among what the others leave unexplained."""
    search = _LeftoverSearch(structure.leftover_question(), detect)
    found: list[tuple[Segment, Leftovers]] = []
    for _, (left, segments, refusals) in workers.map(search, _batches(flight)):
        found += [(segment, left) for segment in segments]
        log.add_leftovers(refusals)
    structure.propose(found)


@dataclass(frozen=True)
class _LeftoverSearch:
    """What a worker does with scans to find what no beam explains; no points are sent back."""

    question: LeftoverQuestion
    detect: Detector

    def __call__(self, scans: list[Scan]) -> tuple[Leftovers, list[Segment], Refusals]:
        left = self.question.ask(scans)
        refusals = Refusals(keep=self.detect.config.outputs.candidates)
        segments = self.detect.in_cloud(left.points, refusals)
        refusals.move(RigidTransform.identity(), left.stamp_ns)
        return replace(left, points=left.points[:0]), segments, refusals


def _batches(flight: Flight) -> Iterator[list[Scan]]:
    """So many scans at a time, whatever the number of processes: sums depend on it."""
    scans = flight.usable()
    while batch := list(islice(scans, _SCANS_A_BATCH)):
        yield batch


def _noise(flight: Flight, config: RunConfig) -> DepthNoise:
    """Noise of the depths, which is measured only where it is used."""
    if config.detection.axis == "centroid" and config.structure.fusion != "evidence":
        return DEFAULT_NOISE
    return depth_noise(flight.usable(), config.sensor)


def _structure(
    config: RunConfig, sensor: SensorModel, *, measurements: int = 0
) -> Structure | EvidenceStructure:
    if config.structure.fusion == "evidence":
        return EvidenceStructure(config, sensor.noise, sensor.jitter, measurements=measurements)
    return Structure(config)


def warm_up(like: RunConfig) -> None:
    """Load or compile every kernel, so that no scan's time contains it.

    A made-up scan of two beams that cross is detected and fused twice; nothing of it is
    kept, and no value of the user's configuration is needed.
    """
    along = np.linspace(-0.6, 0.6, 80)
    ahead, none = np.ones_like(along), np.zeros_like(along)
    beams = np.concatenate(
        [np.stack([ahead, none, along], axis=1), np.stack([ahead, along, none], axis=1)]
    )
    points = beams.astype(np.float32)
    points.flags.writeable = False  # as those of a recording, which are compiled for apart
    T_world_body = RigidTransform(np.eye(3), np.array([0.0, 0.0, 2.0]))
    scan = Scan(
        index=0,
        stamp_ns=0,
        pose_stamp_ns=0,
        T_world_body=T_world_body,
        T_body_sensor=RigidTransform.identity(),
        points=points,
        width=len(beams),
        height=1,
    )
    config = RunConfig.model_validate(
        {"structure": {"fusion": like.structure.fusion}, "detection": {"axis": like.detection.axis}}
    )
    detect, structure = Detector(config), _structure(config, SensorModel(DEFAULT_NOISE))
    for _ in range(3):
        detections = detect(scan)
        structure.update(detections)
    if isinstance(structure, EvidenceStructure):
        for _ in range(2):
            question = structure.question()
            sums = question.sums()
            sums.add(question.ask([scan]))
            structure.renew(sums)
        structure.set_ends(structure.end_question().ask([scan])[None])
        structure.leftover_question().ask([scan])
        structure.section_question().ask([scan])
        warm_up_sections()
    if like.filtering.foreground == "thin":
        thin_foreground(replace(scan, width=16, height=10), 0.05, 1.5, DEFAULT_NOISE)
    intersections_of(detections.segments, config.structure.intersections)
    ThinnedCloud(len(beams), 0.1).add(detections.cloud)


class _FlightLog:
    """What is told of a flight beside its structure: scans, skips, times, the cloud."""

    def __init__(
        self, config: RunConfig, noise: DepthNoise, rehearsal: _Rehearsal | None = None
    ) -> None:
        self.config, self.rehearsal = config, rehearsal
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
        return len(self.scans) + self.skipped.total()

    def skip(self, scan: SkippedScan) -> None:
        self.first_skip = self.first_skip or scan
        self.skipped[scan.reason] += 1

    def add(self, detections: Detections, fuse_us: float, n_segments: int) -> None:
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
        counts = {LEFTOVER + reason: count for reason, count in refusals.counts.items()}
        self.rejections.update(counts)
        self.refused_leftovers.add(refusals.lines)

    def stop(self, reason: str) -> None:
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
            config=self.rehearsal.asked if self.rehearsal else self.config,
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
        if self.rehearsal is None:
            return flight.info
        found = sorted({segment.radius for segment in segments}, reverse=True)
        notes = [self.rehearsal.told]
        notes += [f"the beams have the radii {_millimetres(found)}"] if found else []
        return replace(flight.info, notes=(*flight.info.notes, *notes))

    def _skip_warnings(self) -> list[str]:
        if self.first_skip is None:
            return []
        reasons = ", ".join(f"{n} {reason}" for reason, n in self.skipped.most_common())
        return [
            f"{self.skipped.total()} of {self.n_clouds} clouds skipped: {reasons}; "
            f"the first: {self.first_skip.detail}"
        ]
