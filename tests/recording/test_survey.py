"""What a simulated flight tells about itself: its clock, its beams, its floor, its camera."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.config import load_config
from beamseg_batch.errors import RecordingError
from beamseg_batch.model import DepthNoise
from beamseg_batch.recording import open_flight, open_recording
from beamseg_batch.recording.suggestion import _candidate, _rounded, suggest_config
from beamseg_batch.recording.survey import Survey, _beam_radii, survey_flight
from beamseg_batch.recording.time_offset import estimate_time_offset
from beamseg_batch.simulation import FlightOutput, Simulation, choose_kind, load_sensor
from beamseg_batch.simulation.trajectory import Orbit, Wobble
from beamseg_batch.world.scene import Member, Rectangle, Scene, Section
from tests.recording.conftest import configured, some_clouds, some_poses

FLOOR = Rectangle(np.array([0.0, 0.0, 0.25]), np.array([6.0, 6.0]))


def post(x, y, radius=0.06):
    return Member(
        name=f"post {x} {y}",
        start=np.array([x, y, 0.25]),
        end=np.array([x, y, 2.4]),
        section=Section("round", 2 * radius, 2 * radius),
    )


def simulated(path, offset_s=0.0, settings=(), duration_s=14.0):
    members = tuple(post(x, y) for x in (-0.5, 0.5) for y in (-0.5, 0.5))
    scene = Scene("posts", members, rectangles=(FLOOR,))
    orbit = Orbit(
        centre=(0, 0, 1.3),
        radius=1.6,
        turns=1,
        speed=0.7,
        wobble=Wobble(position=0.03, attitude_deg=4.0),
    )
    size = ["camera.width=48", "camera.height=48", "camera.horizontal_fov=1.1"]
    sensor = load_sensor(
        "webots_range_finder", [*size, f"poses.clock_offset_s={offset_s}", *settings]
    )
    flight = Simulation(scene, orbit, sensor, limit_s=duration_s)
    flight.write(FlightOutput(path, overwrite=True), choose_kind(path))
    return path


@pytest.fixture(scope="module")
def shifted(tmp_path_factory):
    """A flight whose clouds are 73 ms ahead of its poses, which jitter at 30 Hz."""
    settings = ["poses.rate_hz=30", "poses.jitter_position=0.003", "poses.jitter_attitude_deg=0.15"]
    path = tmp_path_factory.mktemp("shifted") / "flight.mcap"
    return simulated(path, 0.073, settings)


def test_estimate_time_offset__finds_the_simulated_one(shifted):
    found = estimate_time_offset(open_flight(open_recording(shifted), load_config()))
    assert found.offset_s == pytest.approx(-0.073, abs=0.005)
    assert 0.0 < found.sigma_s < 0.005
    assert found.n_scans >= 40


def test_estimate_time_offset__adds_to_the_configured_one(shifted):
    config = load_config(overrides=["recording.time_offset_s=-0.2"])
    found = estimate_time_offset(open_flight(open_recording(shifted), config))
    assert found.offset_s == pytest.approx(-0.073, abs=0.005)


def test_estimate_time_offset__raise_on_too_few_scans(fly):
    with pytest.raises(RecordingError, match=r"only 0 scans .* 20 are needed"):
        estimate_time_offset(fly(configured()))


def test_estimate_time_offset__raise_when_nothing_moves(fly):
    """At rest, every offset gives the same cloud."""
    rng = np.random.default_rng(1)
    wall = np.stack([np.ones(200), *rng.uniform(-1, 1, size=(2, 200))], axis=1)
    still = [(stamp, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)) for stamp, *_ in some_poses(600)]
    clouds = [(stamp, wall) for stamp, _ in some_clouds(60)]
    with pytest.raises(RecordingError, match="time offset cannot be told"):
        estimate_time_offset(fly(clouds=clouds, poses=still))


def test_survey_flight__of_a_simulated_flight(shifted):
    survey = survey_flight(open_flight(open_recording(shifted), load_config()))
    assert (survey.width, survey.height) == (48, 48)
    assert survey.floor_m == pytest.approx(0.25, abs=0.02)
    (radius,) = survey.beam_radii()
    assert radius == pytest.approx(0.06, rel=0.08)


@pytest.mark.parametrize("lean", [0.0, 0.4, 0.8])
@pytest.mark.parametrize("radius", [0.03, 0.08])
def test_beam_radii__of_a_leaning_cylinder(radius, lean):
    """A cylinder whose axis crosses the optical axis at 1.2 m, seen by a pinhole."""
    columns, rows = np.meshgrid(np.linspace(-0.6, 0.6, 240), np.linspace(-0.6, 0.6, 240))
    rays = np.stack([np.ones_like(columns), columns, rows], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    axis, centre = np.array([0.0, np.sin(lean), np.cos(lean)]), np.array([1.2, 0.0, 0.0])
    w = rays - (rays @ axis)[..., None] * axis
    a, b, c = np.sum(w * w, -1), w @ centre, centre @ centre - radius**2
    root = b**2 - a * c
    depths = np.where(root > 0, (b - np.sqrt(np.maximum(root, 0.0))) / a, np.nan)
    found, *_ = _beam_radii(depths, rays)
    assert len(found) > 1000
    assert np.mean(found) == pytest.approx(radius, rel=0.04)


def test_beam_radii__walls_and_steps_are_none():
    columns, rows = np.meshgrid(np.linspace(-0.6, 0.6, 60), np.linspace(-0.6, 0.6, 60))
    rays = np.stack([np.ones_like(columns), columns, rows], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    depths = np.full((60, 60), 2.0)
    assert len(_beam_radii(depths, rays)[0]) == 0
    depths[:, :20] = 1.0  # nearer, but it goes on beyond the edge of the image
    assert len(_beam_radii(depths, rays)[0]) == 0
    depths[:, :] = 2.0
    depths[:, 20:30] = 3.0  # a hole
    assert len(_beam_radii(depths, rays)[0]) == 0


def test_survey__without_a_return():
    assert (Survey().floor_m, Survey().beam_radii()) == (None, [])


@pytest.mark.parametrize(
    ("radius", "expected"),
    [(0.0513, 0.05), (0.0243, 0.024), (0.0312, 0.032), (0.154, 0.15), (0.0099, 0.01), (0.1, 0.1)],
)
def test_rounded__to_a_tenth_at_most(radius, expected):
    assert _rounded(radius) == expected


@pytest.mark.parametrize(("measured", "expected"), [(0.0474, 0.05), (0.0312, 0.03), (0.08, 0.08)])
def test_candidate__known_radii_come_first(measured, expected):
    assert _candidate(measured, (0.05, 0.03)) == expected


def test_suggest_config__loads_and_says_why(shifted, tmp_path):
    text = suggest_config(open_recording(shifted), load_config(overrides=["recording.every=2"]))
    (tmp_path / "site.yaml").write_text(text)
    config = load_config(file=tmp_path / "site.yaml")
    assert (config.recording.cloud_topic, config.recording.world_frame) == ("/tof_pc", "map")
    assert config.sensor.axes == "x_forward"
    noise = DepthNoise(config.sensor.noise_m, config.sensor.noise_relative)
    assert noise.at(1.2) == pytest.approx(0.01, rel=0.2)
    assert not config.sensor.mixed_pixels
    assert config.sensor.pose_jitter_m == pytest.approx(0.003, rel=0.1)
    assert config.sensor.pose_jitter_deg == pytest.approx(0.15, rel=0.1)
    assert config.filtering.floor_trim_height == pytest.approx(0.35, abs=0.051)
    assert config.filtering.radii == (0.06,)
    assert 0.8 < config.filtering.window.x[1] <= 3.0
    for line in text.splitlines():
        is_value = ": " in line and not line.lstrip().startswith("#")
        assert not is_value or "  # " in line or line.startswith("profile"), line


def test_suggest_config__keeps_what_is_known(fly, tmp_path):
    config = configured(
        recording={"time_offset_s": 0.25, "time_source": "log"},
        sensor={"extrinsic": {"translation": (0.1, 0.2, 0.3)}, "noise_m": 0.0123},
    )
    text = suggest_config(fly().recording, config)
    (tmp_path / "site.yaml").write_text(text)
    loaded = load_config(file=tmp_path / "site.yaml")
    assert loaded.recording.time_offset_s == 0.25
    assert loaded.recording.time_source == "log"
    assert loaded.sensor.extrinsic == config.sensor.extrinsic
    assert loaded.sensor.noise_m == 0.0123


def test_suggest_config__leaves_open_what_cannot_be_told(fly, tmp_path):
    """Clouds of 3 by 5 points anywhere are no image of anything."""
    text = suggest_config(fly().recording, load_config())
    (tmp_path / "site.yaml").write_text(text)
    config = load_config(file=tmp_path / "site.yaml")
    assert config.sensor.noise_m is None
    assert config.filtering.radii == load_config().filtering.radii
    assert "nothing flat" in text
    assert "no width stands out" in text
