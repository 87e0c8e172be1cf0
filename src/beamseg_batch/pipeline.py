"""The whole method on one screen: a recording -> the structure it shows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from beamseg_batch.config import RunConfig
from beamseg_batch.detection import (
    DEFAULT_NOISE,
    Detector,
    check_outlier_filter,
    depth_noise,
)
from beamseg_batch.errors import WorkerError
from beamseg_batch.flight_log import FlightLog
from beamseg_batch.model import (
    DepthNoise,
    Detections,
    FlightResult,
    SensorModel,
)
from beamseg_batch.parallel import Workers
from beamseg_batch.passes import (
    SCANS_SENT,
    Progress,
    ScanSearch,
    detect_segments,
    new_structure,
    passes_of,
    refine_structure,
)
from beamseg_batch.recording import Flight, Recording, open_flight
from beamseg_batch.rehearsal import Rehearsal, with_found_radii
from beamseg_batch.structure import (
    EvidenceStructure,
)
from beamseg_batch.warming import warm_up

_MEASUREMENTS = 3  # of radii that a rehearsal told

__all__ = ["Progress", "process_flight", "search_scans"]


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
        noise, passes, asked = _noise(flight, config), passes_of(config), config
        rehearsal = Rehearsal(flight, noise) if not config.filtering.radii else None
        clouds = flight.n_clouds * (1 + passes)
        progress.begin(clouds + (rehearsal.n_clouds if rehearsal else 0))
        if rehearsal:
            rehearsal.hold(workers, progress, should_stop)
            config = rehearsal.outcome(config)
        detect = Detector(config, noise)
        sensor = SensorModel(noise, flight.jitter)
        structure = new_structure(config, sensor, measurements=_MEASUREMENTS if rehearsal else 0)
        log = FlightLog(config, noise, asked, rehearsal.told if rehearsal else "")
        try:
            watched = (workers, log, progress, should_stop)
            stopped = detect_segments(structure, detect, flight, *watched)
            if isinstance(structure, EvidenceStructure) and not stopped:
                refine_structure(structure, detect, flight, passes, *watched)
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
        config = with_found_radii(config, [segment.radius for segment in result.segments])
    with Workers(jobs) as workers:
        flight = open_flight(recording, config)
        if config.sensor.organise:
            flight = flight.organised()
        detect = Detector(config, _noise(flight, config))
        workers.start(warm_up, config)
        for scan, found in workers.map(ScanSearch(detect), flight.usable(), SCANS_SENT):
            if found is not None:
                yield replace(found, scan=scan.with_points(scan.points[:0]))


def _noise(flight: Flight, config: RunConfig) -> DepthNoise:
    """Noise of the depths, which is measured only where it is used."""
    if config.detection.axis == "centroid" and config.structure.fusion != "evidence":
        return DEFAULT_NOISE
    return depth_noise(flight.usable(), config.sensor)
