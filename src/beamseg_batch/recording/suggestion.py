"""A configuration proposed from what a recording shows, with the reason for each value."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence

import numpy as np

from beamseg_batch.config import FilteringConfig, RunConfig, SensorConfig
from beamseg_batch.model import DepthNoise, PoseJitter
from beamseg_batch.noise import depth_noise
from beamseg_batch.recording.flight import Flight, open_flight
from beamseg_batch.recording.source import Recording
from beamseg_batch.recording.survey import Survey, survey_flight, surveyed_scans

__all__ = ["suggest_config"]

_PIXELS_ACROSS = 2.5
"""Pixels that a beam must cover: the published method has that many at its 1.5 m."""
_FARTHEST_M = 3.0
_RADIUS_ERROR = 0.1
"""Share by which a radius may be off that is told by widths."""
_FLOOR_CLEARANCE_M, _FLOOR_SIGMAS = 0.1, 5.0


def suggest_config(recording: Recording, config: RunConfig) -> str:
    """Propose a configuration for a recording.

    Parameters
    ----------
    recording : Recording
    config : RunConfig
        What is known already; its topics, frames and clocks are taken over.

    Returns
    -------
    str
        YAML that `load_config` reads, with a comment at each value.

    Raises
    ------
    TopicError, RecordingError
        What would stop a run.
    """
    flight = open_flight(recording, config).organised()
    survey = survey_flight(flight)
    noise = depth_noise(surveyed_scans(flight), config.sensor)
    lines = [
        f"# Proposed for {_comment(recording.name)}, from {survey.n_scans} of its "
        f"{flight.n_clouds} clouds.",
        "# Lengths are metres and times seconds unless a name says otherwise.",
        f"profile: {config.profile}",
        *_recording_lines(flight),
        *_matching_lines(flight),
        *_sensor_lines(flight, survey),
        *_noise_lines(noise, config.sensor),
        *_jitter_lines(flight.jitter),
        *_filtering_lines(survey, noise, config),
    ]
    return "\n".join(lines) + "\n"


def _comment(text: str) -> str:
    """Text that stays on its line."""
    return json.dumps(text)[1:-1]


def _line(key: str, value: object, why: str) -> str:
    return f"  {key + ': ' + json.dumps(value):40}  # {_comment(why)}"


def _recording_lines(flight: Flight) -> Iterator[str]:
    config, roles = flight.config.recording, flight.roles
    yield "recording:"
    yield _line("cloud_topic", flight.clouds.topic.name, flight.clouds.reason)
    if config.pose_file is None:
        yield _line("pose_topic", flight.poses.topic.name, flight.poses.reason)
    else:
        yield _line("pose_file", config.pose_file, flight.poses.reason)
    for role in ("world", "body"):
        if name := getattr(roles, role):
            yield _line(f"{role}_frame", name, roles.reasons[role])
    if config.time_source != "header":
        yield _line("time_source", config.time_source, "as it was asked for")
    if config.time_offset_s:
        yield _line("time_offset_s", config.time_offset_s, "as it was asked for")


def _matching_lines(flight: Flight) -> Iterator[str]:
    allowed_s = flight.config.matching.max_gap_s
    steps_s = np.diff(flight.trajectory.stamps_ns) * 1e-9
    if len(steps_s) == 0:
        return
    median_s = float(np.median(steps_s))
    gap_s = max(allowed_s, math.ceil(100 * median_s) / 100)
    yield "matching:"
    yield _line("max_gap_s", gap_s, f"the poses are {median_s:.3f} s apart (median)")


def _sensor_lines(flight: Flight, survey: Survey) -> Iterator[str]:
    axis, extrinsic = flight.axis, flight.extrinsic
    yield "sensor:"
    yield f"  # {survey.width} x {survey.height} pixels{_optics(survey)}"
    yield _line("axes", "z_forward" if axis.is_z else "x_forward", axis.reason)
    x, y, z = extrinsic.T_body_sensor.translation.tolist()
    where = f"{x:.3f}, {y:.3f}, {z:.3f} m on the drone"
    configured = flight.config.sensor.extrinsic
    if configured is not None:
        yield _line("extrinsic", configured.model_dump(), "as it was asked for")
    elif extrinsic.source == "tf_static":
        yield _line("extrinsic_from_tf", True, f"/tf_static has the camera at {where}")
    else:
        why = "not in the recording: measure it, since it displaces every beam"
        yield _line("extrinsic", None, why)


def _optics(survey: Survey) -> str:
    if survey.pitch_rad is None:
        return ", not an image: the footprint of one cannot be told"
    pitch_mrad = 1e3 * survey.pitch_rad
    return f", {pitch_mrad:.1f} mrad apart: each covers {pitch_mrad:.0f} mm at 1 m"


def _noise_lines(noise: DepthNoise, config: SensorConfig) -> Iterator[str]:
    if noise.source == "default":
        why = "nothing flat in organised clouds to measure it on: it is taken as 10 mm"
        yield _line("noise_m", None, why)
        return
    if config.noise_m is not None:
        yield _line("noise_m", noise.constant, "as it was asked for")
        yield _line("noise_relative", noise.relative, "as it was asked for")
        return
    near, far = (f"{1e3 * noise.at(depth):.1f} mm at {depth:g} m" for depth in (1.0, 2.0))
    why = "deviation of the depths, measured on what is flat"
    yield _line("noise_m", float(f"{noise.constant:.3g}"), why)
    yield _line("noise_relative", float(f"{noise.relative:.3g}"), f"{near}, {far} in all")
    if noise.mixed_source == "measured":
        found = "often" if noise.mixed else "seldom"
        why = f"edges {found} have a depth between those of both sides"
        yield _line("mixed_pixels", noise.mixed, why)


def _jitter_lines(jitter: PoseJitter) -> Iterator[str]:
    values = {
        "pose_jitter_m": (jitter.position, jitter.position_source, "along"),
        "pose_jitter_deg": (math.degrees(jitter.attitude), jitter.attitude_source, "about"),
    }
    for key, (value, source, how) in values.items():
        if source == "default":
            yield _line(key, None, "too few poses to measure it on")
        elif source == "configured":
            yield _line(key, value, "as it was asked for")
        else:
            why = f"noise of each pose {how} each axis, beside what its neighbours foretell"
            yield _line(key, float(f"{value:.3g}"), why)


def _filtering_lines(survey: Survey, noise: DepthNoise, config: RunConfig) -> Iterator[str]:
    measured, known = survey.beam_radii(), config.filtering.radii
    chosen = list(dict.fromkeys(_candidate(radius, known) for radius in measured)) or list(known)
    yield "filtering:"
    yield from _window_lines(survey, min(chosen or FilteringConfig().radii))
    yield from _floor_lines(survey, noise)
    told = ", ".join(f"{1e3 * radius:.1f} mm" for radius in measured)
    why = (
        f"widths of what stands free say {told}, give or take 10 %"
        if told
        else "no width stands out"
    )
    yield _line("radii", chosen or "auto", f"{why}; put the true ones, or auto to measure them")


def _candidate(measured: float, known: Sequence[float]) -> float:
    """Known radius that a measured one agrees with, else that one, rounded."""
    nearest = min(known, key=lambda radius: abs(math.log(radius / measured)), default=math.inf)
    return nearest if abs(nearest / measured - 1.0) <= _RADIUS_ERROR else _rounded(measured)


def _rounded(radius: float) -> float:
    """Radius in steps of 1, 2 or 5 mm, or decades of these, of a tenth of it at most."""
    finest = _RADIUS_ERROR * radius
    decade = 10.0 ** math.floor(math.log10(finest))
    step = max(nice for nice in (1.0, 2.0, 5.0) if nice * decade <= finest) * decade
    return round(round(radius / step) * step, 6)


def _window_lines(survey: Survey, radius: float) -> Iterator[str]:
    within = survey.far_range(0.95) if survey.n_returns else _FARTHEST_M
    ends = {
        within: f"95 % of the returns are within {within:.2f} m",
        _FARTHEST_M: "farther away noise and jitter grow, and the search slows",
    }
    if survey.pitch_rad:
        resolved = 2.0 * radius / (_PIXELS_ACROSS * survey.pitch_rad)
        ends[resolved] = f"there a beam of radius {radius:g} m is {_PIXELS_ACROSS:g} pixels wide"
    ahead = min(ends)
    # An angle that the camera sees is as wide at any range.
    sides = [_side(survey.aside, ahead), _side(survey.above, ahead)]
    yield "  window:"
    ahead_m = max(math.floor(10 * ahead + 1e-6), 1) / 10
    yield "  " + _line("x", [0.0, ahead_m], ends[ahead])
    for name, side in zip("yz", sides, strict=True):
        yield "  " + _line(name, [-side, side], "as wide as ahead, or as what is seen")


def _side(bounds: list[float], ahead: float) -> float:
    """Half the width of the window: no wider than deep, nor than what the clouds hold."""
    seen = max(bounds, default=ahead)
    return max(math.ceil(10 * min(seen, ahead) - 1e-6), 1) / 10


def _floor_lines(survey: Survey, noise: DepthNoise) -> Iterator[str]:
    floor_m = survey.floor_m
    if floor_m is None:
        yield _line("floor_trim", "none", "no floor stands out")
        return
    clearance = max(_FLOOR_CLEARANCE_M, _FLOOR_SIGMAS * noise.at(_FARTHEST_M))
    height = math.ceil(20 * (floor_m + clearance) - 1e-6) / 20
    why = f"the lowest level surface lies at {floor_m:.2f} m; {height - floor_m:.2f} m above it"
    yield _line("floor_trim_height", height, why)
    yield _line("floor_trim", "points", "below it nothing is a beam")
