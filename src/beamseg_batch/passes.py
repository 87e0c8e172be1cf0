"""Passes over a flight: the search of its scans, and what all rays say about the beams."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import Protocol

import numpy as np

from beamseg_batch.config import RunConfig
from beamseg_batch.detection import (
    Detector,
    Refusals,
)
from beamseg_batch.errors import BeamsegError, WorkerError
from beamseg_batch.flight_log import FlightLog
from beamseg_batch.geometry import RigidTransform
from beamseg_batch.model import (
    Detections,
    Scan,
    Segment,
    SensorModel,
    SkippedScan,
)
from beamseg_batch.parallel import Workers
from beamseg_batch.recording import Flight
from beamseg_batch.structure import (
    EvidenceStructure,
    LeftoverQuestion,
    Leftovers,
    NearRays,
    Structure,
)

_SCANS_A_BATCH = 25
SCANS_SENT = 5
"""Scans that are sent to a worker at a time in the first pass."""
_END_GROUPS = 12
"""Parts of the flight that each tell where the ends are, by how far they differ how surely."""

__all__ = [
    "SCANS_SENT",
    "Progress",
    "ScanSearch",
    "detect_segments",
    "new_structure",
    "passes_of",
    "refine_structure",
]


class Progress(Protocol):
    """Whoever watches a flight being processed."""

    def begin(self, n_clouds: int) -> None:
        """Hear how many clouds there are, before the first."""

    def step(self, n_segments: int) -> None:
        """Hear of one more cloud done or skipped, and how many segments are known."""


def detect_segments(
    structure: Structure | EvidenceStructure,
    detect: Detector,
    flight: Flight,
    workers: Workers,
    log: FlightLog,
    progress: Progress,
    should_stop: Callable[[], bool],
) -> bool:
    """Find the segments of every scan; return whether a stop was asked for."""
    try:
        for scan, detections in workers.map(ScanSearch(detect), flight.scans(), SCANS_SENT):
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
class ScanSearch:
    """What a worker does with a scan; its points are not sent back."""

    detect: Detector

    def __call__(self, scan: Scan | SkippedScan) -> Detections | None:
        """Search a scan; None of one that cannot be used."""
        if isinstance(scan, SkippedScan):
            return None
        detections = self.detect(scan)
        return replace(detections, scan=replace(scan, points=scan.points[:0]))


def refine_structure(
    structure: EvidenceStructure,
    detect: Detector,
    flight: Flight,
    passes: int,
    workers: Workers,
    log: FlightLog,
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
    """Ask the rays near each beam for its cross-section, and then those along its own axis."""
    for measure in (structure.section_trial, structure.section_refit):
        question, near = structure.section_question(), NearRays()
        for _, samples in workers.map(question.ask, _batches(flight)):
            near.add(samples)
        found = workers.map(measure(), structure.beams_with(near))
        structure.set_sections([beam for _, beam in found])
        if not structure.has_sections:
            break


def _search_leftovers(
    structure: EvidenceStructure,
    detect: Detector,
    flight: Flight,
    workers: Workers,
    log: FlightLog,
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
        # What stands free is searched by itself, too: surfaces hide it among all the others.
        segments = [
            segment
            for points in (left.points[left.is_free], left.points)
            for segment in self.detect.in_cloud(points, refusals)
        ]
        refusals.move(RigidTransform.identity(), left.stamp_ns)
        return replace(left, points=left.points[:0]), segments, refusals


def _batches(flight: Flight) -> Iterator[list[Scan]]:
    """So many scans at a time, whatever the number of processes: sums depend on it."""
    scans = flight.usable()
    while batch := list(islice(scans, _SCANS_A_BATCH)):
        yield batch


def passes_of(config: RunConfig) -> int:
    """Passes over the rays, at most."""
    return config.refinement.passes if config.structure.fusion == "evidence" else 0


def new_structure(
    config: RunConfig, sensor: SensorModel, *, measurements: int = 0
) -> Structure | EvidenceStructure:
    """Make what the segments of a flight become."""
    if config.structure.fusion == "evidence":
        return EvidenceStructure(config, sensor.noise, sensor.jitter, measurements=measurements)
    return Structure(config)
