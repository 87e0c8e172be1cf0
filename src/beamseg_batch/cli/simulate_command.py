"""`beamseg simulate`: a world, a flight and a sensor -> a recording with its truth."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from beamseg_batch.cli.console import ScanProgress, note, say, warn
from beamseg_batch.cli.options import parse_extrinsic, verbosity_options
from beamseg_batch.errors import ConfigError

if TYPE_CHECKING:
    from beamseg_batch.simulation import FlightOutput, FlightTruth, Sensor, Simulation
    from beamseg_batch.simulation.trajectory import Flight
    from beamseg_batch.world import World

__all__ = ["command"]

_LEAST_CLEARANCE_M = 0.2


@click.command("simulate")
@click.argument("world", type=click.Path(readable=False, path_type=Path))
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    required=True,
    type=click.Path(readable=False, path_type=Path),
    help="The recording: FILE.mcap, FILE.bag, FILE.db3, or a folder for a ROS 2 bag. The truth "
    "goes into a folder 'truth' beside it.",
)
@click.option("--overwrite", is_flag=True, help="Replace an earlier flight and its truth there.")
@click.option(
    "--waypoints",
    metavar="FILE",
    type=click.Path(readable=False, path_type=Path),
    help="Fly along the waypoints of a CSV file: x,y,z,yaw,duration (metres, radians, seconds).",
)
@click.option(
    "--trajectory",
    metavar="FILE",
    type=click.Path(readable=False, path_type=Path),
    help="Fly as a YAML file says: waypoints, orbit, spiral, lawnmower or figure_eight.",
)
@click.option("--duration", metavar="SECONDS", type=float, help="End the flight after so long.")
@click.option(
    "--sensor",
    metavar="NAME|FILE",
    help="Camera and poses: 'webots_range_finder' (default), 'voxl_tof', or a YAML file.",
)
@click.option("--noise", metavar="METRES", type=float, help="Standard deviation of the depth.")
@click.option(
    "--drift",
    metavar="METRES[,RADIANS]",
    help="Let the poses drift: standard deviations of the step from pose to pose.",
)
@click.option(
    "--extrinsic",
    metavar="X,Y,Z[,R,P,Y]",
    help="Where the camera sits on the drone: metres, then roll, pitch, yaw in degrees.",
)
@click.option(
    "--extrinsic-in",
    type=click.Choice(["tf", "cloud", "none"]),
    help="Who knows it: /tf_static (default), the points (which are then in the drone's axes), "
    "or nobody.",
)
@click.option(
    "--set",
    "settings",
    metavar="KEY=VALUE",
    multiple=True,
    help="Change one value of the sensor, such as camera.dropout=0.05. Repeatable.",
)
@click.option(
    "--seed",
    metavar="NUMBER",
    type=click.IntRange(min=0),
    default=0,
    help="Another seed is another flight through the same world; 0 without.",
)
@click.option(
    "--format",
    "format_",
    metavar="NAME",
    help="Kind of recording, if its name does not tell: bag, mcap, mcap-ros1, ros2, ros2-mcap, "
    "db3.",
)
@click.option("--compression", metavar="NAME", help="none, bz2 or lz4 (bag); zstd, lz4 (mcap).")
@verbosity_options
def command(
    world: Path,
    output: Path,
    overwrite: bool,
    waypoints: Path | None,
    trajectory: Path | None,
    duration: float | None,
    sensor: str | None,
    noise: float | None,
    drift: str | None,
    extrinsic: str | None,
    extrinsic_in: str | None,
    settings: tuple[str, ...],
    seed: int,
    format_: str | None,
    compression: str | None,
    verbose: bool,
    quiet: bool,
) -> None:
    """Fly a camera through a known world: a recording with its truth.

    WORLD is a YAML file, a Webots world (.wbt), or the name of a shipped one such as arena,
    lattice_tower or joints (docs/worlds.md shows them all). The truth beside the recording
    tells what stands there (truth.csv, truth_joints.csv), which part of each member the
    flight saw, and where the drone truly was (true_poses.tum); 'beamseg evaluate' measures a
    run against it. The same seed gives the same flight.

    \b
    Examples:
      beamseg simulate arena -o sim/flight.mcap
      beamseg simulate my.wbt -o sim/flight.bag --waypoints wp.csv --noise 0.02
      beamseg simulate lattice_tower -o tower/flight.mcap --drift 0.001,0.0005
      beamseg simulate arena -o gap/flight.mcap --set poses.gaps=[[20,2]]

    \b
    Then:
      beamseg run sim/flight.mcap -o out
      beamseg evaluate out --truth sim/truth
    """  # noqa: D301 (click reads the backspace)
    from beamseg_batch.simulation import FlightOutput, Simulation, choose_kind, load_sensor
    from beamseg_batch.world import load_scene_file

    loaded = load_scene_file(world)
    simulation = Simulation(
        scene=loaded.scene,
        flight=_flight(loaded, world, waypoints, trajectory),
        sensor=load_sensor(
            _sensor(loaded, sensor),
            [*_settings(noise, drift, extrinsic, extrinsic_in), *settings],
        ),
        seed=seed,
        limit_s=_positive("--duration", duration),
    )
    kind = choose_kind(output, format_, compression)
    place = FlightOutput(output, overwrite)
    place.check()
    if not quiet:
        _tell(simulation, verbose)
    with ScanProgress(enabled=not quiet) as progress:
        truth = simulation.write(place, kind, progress)
    if not quiet:
        say("\n".join(_lines(simulation, truth, place)))


def _flight(world: World, path: Path, waypoints: Path | None, trajectory: Path | None) -> Flight:
    from beamseg_batch.simulation.trajectory import (
        Waypoints,
        load_flight,
        read_flight,
        read_waypoints,
    )

    if waypoints is not None and trajectory is not None:
        raise click.UsageError("--waypoints and --trajectory: name one of them")
    if waypoints is not None:
        return Waypoints(points=read_waypoints(waypoints))
    if trajectory is not None:
        return load_flight(trajectory)
    if world.document is None or world.flight is None:
        raise click.UsageError(
            f"{path} does not say how to fly: name a --waypoints or --trajectory file"
        )
    return read_flight(world.document, ("flight",))


def _sensor(world: World, asked: str | None) -> str | Path:
    """Name or file of the sensor: as asked, or the world's, whose file is beside its own."""
    from beamseg_batch.simulation import DEFAULT_SENSOR, sensor_names

    if asked is not None or world.sensor is None:
        return asked or DEFAULT_SENSOR
    if world.sensor in sensor_names() or world.document is None:
        return world.sensor
    return world.document.path.parent / world.sensor


def _settings(
    noise: float | None, drift: str | None, extrinsic: str | None, extrinsic_in: str | None
) -> Iterator[str]:
    """Write options as settings of the sensor."""
    if noise is not None:
        yield f"camera.noise={noise}"
    if drift is not None:
        metres, radians = _two_numbers("--drift", drift)
        yield f"poses.walk_position={metres}"
        yield f"poses.walk_attitude={radians}"
    if extrinsic is not None:
        yield f"extrinsic={json.dumps(parse_extrinsic(extrinsic))}"
    if extrinsic_in is not None:
        yield f"extrinsic_in={extrinsic_in}"


def _two_numbers(option: str, text: str) -> tuple[float, float]:
    """Read one or two numbers; the second is 0 without."""
    try:
        first, *rest = [float(part) for part in text.split(",")]
        (second,) = rest or [0.0]
    except ValueError:
        raise ConfigError(
            f"{option} {text!r}: write metres, or metres,radians, for example 0.001,0.0005"
        ) from None
    return first, second


def _positive(option: str, value: float | None) -> float | None:
    if value is not None and not 0.0 < value < math.inf:
        raise ConfigError(f"{option} must be above 0, not {value:g}")
    return value


def _tell(simulation: Simulation, verbose: bool) -> None:
    for text in simulation.scene.notes:
        note(text)
    if verbose:
        camera, poses = simulation.sensor.camera, simulation.sensor.poses
        note(
            f"{camera.width} x {camera.height} pixels, {camera.horizontal_fov:g} rad, "
            f"{camera.rate_hz:g} clouds and {poses.rate_hz:g} poses a second"
        )
    nearest = simulation.clearance
    if nearest is None or nearest.distance_m >= _LEAST_CLEARANCE_M:
        return
    if nearest.distance_m == 0.0:
        warn(f"the drone flies through {nearest.what} at {nearest.time_s:.1f} s")
    else:
        warn(
            f"the drone comes within {nearest.distance_m:.2f} m of {nearest.what} at "
            f"{nearest.time_s:.1f} s"
        )


def _lines(simulation: Simulation, truth: FlightTruth, place: FlightOutput) -> Iterator[str]:
    """Sum the flight up for the person who asked for it."""
    nearest = simulation.clearance
    yield (
        f"recording  {place.recording}: {truth.n_scans} scans, {len(truth.poses)} poses, "
        f"{simulation.duration_s:.1f} s"
    )
    yield (
        f"truth      {place.truth}: {truth.n_counted} of {len(truth.seen)} members seen, "
        f"{len(truth.joints)} joints"
    )
    if nearest is not None:
        yield f"clearance  {nearest.distance_m:.2f} m, {nearest.what} at {nearest.time_s:.1f} s"
    yield f"next       beamseg run {place.recording}{_missing_extrinsic(simulation.sensor)}"


def _missing_extrinsic(sensor: Sensor) -> str:
    if sensor.extrinsic_in != "none":
        return ""
    values = (*sensor.extrinsic.translation, *sensor.extrinsic.rotation_rpy_deg)
    return " --extrinsic " + ",".join(f"{value:g}" for value in values)
