"""A scene, a flight and a sensor -> a recording with its truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import Trajectory
from beamseg_batch.simulation.output import FlightOutput, write_files
from beamseg_batch.simulation.pose_stream import (
    START_NS,
    pose_times,
    recorded_poses,
    stamps_ns,
    true_poses,
)
from beamseg_batch.simulation.recorder import Recorder, RecordingKind, open_recorder
from beamseg_batch.simulation.rotations import quaternions_from_rpy
from beamseg_batch.simulation.scans import ScanSimulator
from beamseg_batch.simulation.sensor import Sensor
from beamseg_batch.simulation.solids import BOX, CLUTTER, Solids, distances_to_solids, solids_of
from beamseg_batch.simulation.trajectory import Flight, TruePath
from beamseg_batch.simulation.truth import FlightTruth
from beamseg_batch.world.scene import Scene

__all__ = ["Clearance", "Progress", "Simulation"]

_POSES = 3  # of the seeds; see `scans`
_POSE_LATENCY_NS, _CLOUD_LATENCY_NS = 2_000_000, 30_000_000
"""From the stamp of a message to when it is recorded."""
_SENSOR_FRAME, _BODY_FRAME, _WORLD_FRAME = "tof", "base_link", "map"
_CLEARANCE_HZ = 20.0
_BATCH = 256


class Progress(Protocol):
    """Is told how far a simulation has come."""

    def begin(self, n_clouds: int) -> None:
        """Say how many scans there will be."""

    def step(self, n_segments: int) -> None:
        """Say that a scan is done, and how many members have been seen so far."""


@dataclass(frozen=True)
class Clearance:
    """Where a flight comes nearest to something: a member by its name, or clutter."""

    distance_m: float
    what: str
    time_s: float


@dataclass(frozen=True, eq=False)
class Simulation:
    """A drone that flies through a scene, before it has flown.

    Attributes
    ----------
    scene : Scene
    flight : Flight
    sensor : Sensor
    seed : int
        The same seed gives the same recording and truth, byte for byte.
    limit_s : float, optional
        Ends the flight after so many seconds.
    """

    scene: Scene
    flight: Flight
    sensor: Sensor
    seed: int = 0
    limit_s: float | None = None

    @property
    def duration_s(self) -> float:
        """Seconds from the start of the flight to its end."""
        whole = self.flight.duration_s
        return whole if self.limit_s is None else min(whole, self.limit_s)

    @cached_property
    def path(self) -> TruePath:
        """Where the drone truly is."""
        return TruePath(self.flight, self.seed)

    @cached_property
    def clearance(self) -> Clearance | None:
        """Where the middle of the drone comes nearest to the surface of something.

        The distance is 0 where it flies through. Floors and other rectangles do not count,
        nor do meshes; None if there is nothing else.
        """
        solids = _obstacles(solids_of(self.scene))
        if len(solids) == 0:
            return None
        times = np.arange(0.0, self.duration_s, 1.0 / _CLEARANCE_HZ)
        nearest = min(
            _nearest(solids, self.path, times[first : first + _BATCH])
            for first in range(0, len(times), _BATCH)
        )
        distance, time_s, owner = nearest
        what = "clutter" if owner == CLUTTER else f"member {self.scene.members[owner].name!r}"
        return Clearance(distance, what, time_s)

    def write(
        self, output: FlightOutput, kind: RecordingKind, progress: Progress | None = None
    ) -> FlightTruth:
        """Fly, and write the recording and its truth.

        Parameters
        ----------
        output : FlightOutput
        kind : RecordingKind
        progress : Progress, optional

        Returns
        -------
        FlightTruth

        Raises
        ------
        OutputError
            If it cannot be written.
        WorldError
            If a mesh cannot be read.
        Open3DMissingError
            If the scene has meshes and Open3D cannot be loaded.
        """
        scans = ScanSimulator(self.scene, self.path, self.sensor, self.duration_s)
        true = true_poses(self.path, pose_times(self.sensor.poses, self.duration_s))
        rng = np.random.default_rng([self.seed, _POSES])
        poses = recorded_poses(true, self.sensor.poses, rng)
        clearance = self.clearance
        with output.staged() as (recording, folder):
            with open_recorder(recording, kind) as recorder:
                self._record(recorder, scans, poses, progress)
            truth = FlightTruth(
                scene=self.scene,
                seen=tuple(scans.seen()),
                joints=self.scene.joints,
                poses=true,
                n_scans=len(scans.times),
                clearance_m=None if clearance is None else clearance.distance_m,
                rule=scans.rule,
            )
            write_files(folder, truth.files(self.flight, self.sensor, self.seed, self.duration_s))
        return truth

    def _record(
        self,
        recorder: Recorder,
        scans: ScanSimulator,
        poses: Trajectory,
        progress: Progress | None,
    ) -> None:
        """Write all messages in the order in which they are received."""
        sensor = self.sensor
        if sensor.extrinsic_in == "tf":
            _write_extrinsic(recorder, sensor)
        frame = _BODY_FRAME if sensor.extrinsic_in == "cloud" else _SENSOR_FRAME
        offset_ns = round(sensor.poses.clock_offset_s * 1e9)
        if progress is not None:
            progress.begin(len(scans.times))
        written = 0
        for scan, true_ns in zip(scans.scans(), stamps_ns(scans.times).tolist(), strict=True):
            log_ns = true_ns + _CLOUD_LATENCY_NS
            due = int(np.searchsorted(poses.stamps_ns, log_ns - _POSE_LATENCY_NS, side="right"))
            _write_poses(recorder, poses, range(written, due))
            written = due
            recorder.cloud(log_ns, true_ns + offset_ns, frame, scan.points)
            if progress is not None:
                progress.step(scans.n_members_seen)
        _write_poses(recorder, poses, range(written, len(poses)))


def _write_poses(recorder: Recorder, poses: Trajectory, numbers: range) -> None:
    for k in numbers:
        stamp_ns = int(poses.stamps_ns[k])
        place, attitude = poses.positions[k], poses.quaternions_xyzw[k]
        recorder.pose(stamp_ns + _POSE_LATENCY_NS, stamp_ns, _WORLD_FRAME, place, attitude)


def _write_extrinsic(recorder: Recorder, sensor: Sensor) -> None:
    rpy = np.radians([sensor.extrinsic.rotation_rpy_deg])
    translation = np.array(sensor.extrinsic.translation)
    recorder.static_transform(
        START_NS, _BODY_FRAME, _SENSOR_FRAME, translation, quaternions_from_rpy(rpy)[0]
    )


def _obstacles(solids: Solids) -> Solids:
    """Leave out rectangles: a drone stands on one of them."""
    flat = (solids.kinds == BOX) & (solids.owners == CLUTTER) & (solids.halves[:, 2] == 0.0)
    return solids.keep(~flat)


def _nearest(solids: Solids, path: TruePath, times: FloatArray) -> tuple[float, float, int]:
    """Least distance to a solid at some times, when that is, and whose solid it is."""
    distances = distances_to_solids(solids, path.poses(times)[0])
    moment, solid = np.unravel_index(int(distances.argmin()), distances.shape)
    return float(distances[moment, solid]), float(times[moment]), int(solids.owners[solid])
