"""A world and a trajectory -> a recording with truth."""

from __future__ import annotations

from beamseg_batch.simulation.flight import Clearance, Simulation
from beamseg_batch.simulation.output import FlightOutput
from beamseg_batch.simulation.recorder import FORMATS, RecordingKind, choose_kind
from beamseg_batch.simulation.seen import SeenPart, SeenRule, seen_parts
from beamseg_batch.simulation.sensor import DEFAULT_SENSOR, Sensor, load_sensor, sensor_names
from beamseg_batch.simulation.trajectory import Flight, load_flight, read_flight, read_waypoints
from beamseg_batch.simulation.truth import FlightTruth

__all__ = [
    "DEFAULT_SENSOR",
    "FORMATS",
    "Clearance",
    "Flight",
    "FlightOutput",
    "FlightTruth",
    "RecordingKind",
    "SeenPart",
    "SeenRule",
    "Sensor",
    "Simulation",
    "choose_kind",
    "load_flight",
    "load_sensor",
    "read_flight",
    "read_waypoints",
    "seen_parts",
    "sensor_names",
]
