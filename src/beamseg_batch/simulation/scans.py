"""The scans of a simulated flight: what the camera measures on its way."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.errors import ConfigError
from beamseg_batch.geometry import FloatArray, RigidTransform
from beamseg_batch.simulation.casting import Caster, Hits
from beamseg_batch.simulation.seen import SeenPart, SeenParts, SeenRule
from beamseg_batch.simulation.sensor import Camera, Sensor
from beamseg_batch.simulation.trajectory import TruePath
from beamseg_batch.world.scene import Scene

__all__ = ["ScanSimulator", "SimulatedScan", "scan_times"]

_STAMPS, _SCANS = 1, 2  # of the seeds: the wobble is 0, the poses are 3


@dataclass(frozen=True, eq=False)
class SimulatedScan:
    """A cloud as it is recorded, and where it was truly taken.

    Attributes
    ----------
    time_s : float
        From the start of the flight.
    points : (H, W, 3) float32, metres
        In the camera's axes, or the drone's if the extrinsic is applied; not finite
        without return. (1, N, 3), returns only, of a camera that is not organised.
    T_world_sensor : RigidTransform
    """

    time_s: float
    points: NDArray[np.float32]
    T_world_sensor: RigidTransform


def scan_times(camera: Camera, duration_s: float, seed: int) -> FloatArray:
    """When the clouds are taken.

    Parameters
    ----------
    camera : Camera
    duration_s : float
    seed : int

    Returns
    -------
    (N,) float64, seconds from the start
        Half an interval after it, and so on at the camera's rate, with its jitter.

    Raises
    ------
    ConfigError
        If there is no time for one.
    """
    n_scans = math.floor(duration_s * camera.rate_hz + 1e-6)
    if n_scans == 0:
        raise ConfigError(
            f"a flight of {duration_s:g} s is too short for a scan: the camera takes "
            f"{camera.rate_hz:g} a second"
        )
    even = (np.arange(n_scans) + 0.5) / camera.rate_hz
    jitter = camera.stamp_jitter_s * np.random.default_rng([seed, _STAMPS]).normal(size=n_scans)
    most = 0.45 / camera.rate_hz  # a jitter of any size must not change their order
    times: FloatArray = even + jitter.clip(-most, most)
    return times


class ScanSimulator:
    """Flies a camera through a scene.

    Parameters
    ----------
    scene : Scene
    path : TruePath
    sensor : Sensor
    duration_s : float

    Raises
    ------
    ConfigError
        If the flight is too short for a scan.
    WorldError
        If a mesh cannot be read.
    Open3DMissingError
        If the scene has meshes and Open3D cannot be loaded.
    """

    def __init__(self, scene: Scene, path: TruePath, sensor: Sensor, duration_s: float) -> None:
        camera = sensor.camera
        self.times = scan_times(camera, duration_s, path.seed)
        self.rule = _rule(camera)
        self._path, self._sensor = path, sensor
        self._caster = Caster(scene, farthest=camera.range[1] + 6.0 * _largest_noise(camera))
        self._seen = SeenParts(scene.members, self.rule)

    def scans(self) -> Iterator[SimulatedScan]:
        """Take the scans in order of time, one at a time.

        Yields
        ------
        SimulatedScan
            The same ones for the same seed, however far they are read.
        """
        sensor, camera = self._sensor, self._sensor.camera
        for number, time_s in enumerate(self.times.tolist()):
            T_world_sensor = self._path.pose(time_s) @ sensor.T_body_sensor
            hits = self._caster.cast(T_world_sensor, camera.sub_grid)
            rng = np.random.default_rng([self._path.seed, _SCANS, number])
            depths = _measured(hits, camera, rng)
            middle = _middle_rays(hits, camera.footprint)
            self._seen.add(middle, depths, camera.grid, T_world_sensor, sensor.T_cloud_sensor)
            yield SimulatedScan(time_s, _points(depths, sensor), T_world_sensor)

    @property
    def n_members_seen(self) -> int:
        """Number of members that the scans taken so far hit."""
        return self._seen.n_members

    def seen(self) -> list[SeenPart]:
        """What the scans that were taken so far saw of each member."""
        return self._seen.parts()


def _largest_noise(camera: Camera) -> float:
    return float(camera.noise_at(np.array(camera.range[1])))


def _rule(camera: Camera) -> SeenRule:
    """Take five deviations of the noise for a hit, where that is more than usual."""
    rule = SeenRule()
    noise = float(camera.noise_at(np.array(rule.x_max)))
    return replace(rule, off_surface_m=max(rule.off_surface_m, 5.0 * noise))


def _measured(hits: Hits, camera: Camera, rng: np.random.Generator) -> FloatArray:
    """Depths that the camera measures, (H, W) metres; infinite without return."""
    from beamseg_batch.simulation.casting_kernels import average_pixels

    least_facing = math.sin(math.radians(camera.grazing_deg))
    depths = average_pixels(hits.depths, hits.facings, camera.footprint, least_facing)
    # All pixels draw, so that what one of them hits does not change the noise of the next.
    noise, chance = rng.standard_normal(depths.shape), rng.random(depths.shape)
    returned = np.isfinite(depths) & (chance >= camera.dropout)
    depths[returned] += camera.noise_at(depths[returned]) * noise[returned]
    nearest, farthest = camera.range
    depths[~returned | (depths < nearest) | (depths > farthest)] = np.inf
    return depths


def _middle_rays(hits: Hits, footprint: int) -> Hits:
    """Keep of each pixel the sub-ray in the middle."""
    middle = slice(footprint // 2, None, footprint)
    place = (middle, middle)
    return Hits(hits.depths[place], hits.owners[place], hits.facings[place])


def _points(depths: FloatArray, sensor: Sensor) -> NDArray[np.float32]:
    with np.errstate(invalid="ignore"):  # straight ahead, an infinite depth gives 0 * inf
        points = sensor.camera.grid.directions * depths[..., None]
        if sensor.extrinsic_in == "cloud":
            points = sensor.T_body_sensor.apply(points)
    if not sensor.camera.organised:
        points = points[np.isfinite(depths)][None]
    return points.astype(np.float32)
