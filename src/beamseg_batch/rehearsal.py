"""Which radii the beams of a flight have, where none is configured."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from beamseg_batch.config import FilteringConfig, RefinementConfig, RunConfig, ShapeConfig
from beamseg_batch.detection import (
    Detector,
    depth_noise,
)
from beamseg_batch.flight_log import FlightLog, millimetres
from beamseg_batch.model import (
    DepthNoise,
)
from beamseg_batch.parallel import Workers
from beamseg_batch.passes import Progress, detect_segments, passes_of, refine_structure
from beamseg_batch.recording import Flight
from beamseg_batch.recording.survey import survey_flight
from beamseg_batch.structure import (
    EvidenceStructure,
)

_LADDER = (0.1, 0.05, 0.03)
"""Radii to begin with where none is configured, metres: near enough to any between and beyond."""
_REHEARSED_SCANS, _REHEARSAL_PASSES, _REHEARSED_MEASUREMENTS = 120, 60, 10

__all__ = ["Rehearsal", "with_found_radii"]


class Rehearsal:
    """A part of the flight processed with many radii, to learn which ones the beams have.

    Parameters
    ----------
    flight : Flight
        Its configuration says what is to be processed, and how.
    noise : DepthNoise
        Of its camera, when it was measured.
    """

    def __init__(self, flight: Flight, noise: DepthNoise) -> None:
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
        return self.n_scans * (1 + passes_of(self._config))

    def hold(self, workers: Workers, progress: Progress, should_stop: Callable[[], bool]) -> None:
        """Process the part."""
        detect = Detector(self._config, self._noise)
        structure = EvidenceStructure(
            self._config, self._noise, measurements=_REHEARSED_MEASUREMENTS
        )
        log = FlightLog(self._config, self._noise)
        watched = (workers, log, progress, should_stop)
        if not detect_segments(structure, detect, self._part, *watched):
            refine_structure(structure, detect, self._part, passes_of(self._config), *watched)
        self.radii = structure.measured_radii

    def outcome(self, config: RunConfig) -> RunConfig:
        """Return a configuration with the radii that were found, else with the usual one."""
        return with_found_radii(config, self.radii)

    @property
    def told(self) -> str:
        """What came of it, for people."""
        where = f"in {self.n_scans} clouds of the flight"
        if not self.radii:
            usual = millimetres(FilteringConfig().radii)
            return f"no beam shows its radius {where}: beams of {usual} were looked for"
        return (
            f"beams {where} seem to have the radii {millimetres(self.radii)}, which were looked for"
        )


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


def with_found_radii(config: RunConfig, radii: Sequence[float]) -> RunConfig:
    """Return a configuration with the radii that were found, else with the usual one."""
    return _with_radii(config, sorted(set(radii), reverse=True) or FilteringConfig().radii)


def _with_radii(config: RunConfig, radii: Sequence[float]) -> RunConfig:
    filtering = config.filtering.model_copy(update={"radii": tuple(radii)})
    return config.model_copy(update={"filtering": filtering})
