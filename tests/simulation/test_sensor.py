"""Cameras and pose sources, and the files that describe them."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from beamseg_batch.errors import ConfigError, WorldError
from beamseg_batch.simulation.sensor import Camera, Sensor, load_sensor, sensor_names


def test_sensor_names__shipped():
    assert sensor_names() == ("voxl_tof", "webots_range_finder")


def test_load_sensor__webots_range_finder():
    sensor = load_sensor("webots_range_finder")
    camera = sensor.camera
    assert (camera.width, camera.height, camera.range) == (64, 64, (0.1, 4.0))
    assert camera.focal_px == pytest.approx(32 / np.tan(1.02))
    assert sensor.T_body_sensor.translation.tolist() == [0.071, 0.011, 0.04]


def test_load_sensor__voxl_tof():
    sensor = load_sensor("voxl_tof")
    camera = sensor.camera
    assert (camera.width, camera.height, camera.footprint) == (224, 172, 3)
    assert camera.noise_at(np.array([0.0, 2.0])).tolist() == pytest.approx(
        [0.003, np.hypot(0.003, 0.014)]
    )
    # Pitched down: what lies ahead of the camera lies below the drone's horizon.
    assert sensor.T_body_sensor.rotate(np.array([1.0, 0.0, 0.0]))[2] < -0.08


def test_camera__rays():
    """Pixel (u, v) looks along y/x = (width/2 - u - offset) / focal, z/x alike."""
    camera = Camera(width=8, height=6, horizontal_fov=1.0, pixel_offset=0.5, footprint=3)
    focal = 4 / np.tan(0.5)
    rays = camera.grid.directions
    assert rays.shape == (6, 8, 3)
    np.testing.assert_allclose(rays[0, 0], [1.0, 3.5 / focal, 2.5 / focal])
    np.testing.assert_allclose(rays[5, 7], [1.0, -3.5 / focal, -2.5 / focal])
    sub_rays = camera.sub_grid.directions
    assert sub_rays.shape == (18, 24, 3)
    np.testing.assert_allclose(sub_rays[1::3, 1::3], rays, atol=1e-15)
    np.testing.assert_allclose(np.diff(sub_rays[0, :, 1]), -1 / 3 / focal)


def test_camera__rays_without_offset_pass_through_the_upper_left_corners():
    rays = Camera(width=8, height=6, horizontal_fov=1.0).grid.directions
    np.testing.assert_allclose(rays[3, 4], [1.0, 0.0, 0.0])
    np.testing.assert_allclose(rays[0, 0, 1], np.tan(0.5))


def test_load_sensor__settings():
    settings = ["camera.noise=0.02", "poses.gaps=[[1, 2]]", "extrinsic_in=none"]
    settings.append("extrinsic={translation: [1, 2, 3], rotation_rpy_deg: [0, 0, 90]}")
    sensor = load_sensor("webots_range_finder", settings)
    assert sensor.camera.noise == 0.02
    assert sensor.poses.gaps == ((1.0, 2.0),)
    assert sensor.extrinsic_in == "none"
    np.testing.assert_allclose(sensor.T_body_sensor.apply(np.array([1.0, 0, 0])), [1, 3, 3])


@pytest.mark.parametrize(
    ("setting", "complaint"),
    [
        ("camera.nose=1", "unknown setting 'camera.nose'; did you mean 'camera.noise'"),
        ("nonsense.deep.er=1", "unknown setting 'nonsense.deep.er'"),
        ("camera.noise", "'camera.noise' is not a setting; write KEY=VALUE"),
        ("camera.noise=-1", "camera.noise=-1: must be at least 0"),
        ("camera.noise=[", "'camera.noise=\\[': the value is not valid YAML"),
        ("camera.range=[4, 1]", "must be two rising depths from 0, not 4, 1"),
        ("extrinsic_in=hat", "'tf', 'cloud' or 'none'"),
    ],
)
def test_load_sensor__bad_settings(setting, complaint):
    with pytest.raises(ConfigError, match=complaint):
        load_sensor("webots_range_finder", [setting])


def test_load_sensor__file(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("camera: {width: 32, height: 24, horizontal_fov: 1.2}\n", encoding="utf-8")
    sensor = load_sensor(path)
    assert isinstance(sensor, Sensor)
    assert sensor.camera.noise == 0.0
    path.write_text("camera:\n  width: 32\n  height: 24\n  horizontal_fov: 4\n", encoding="utf-8")
    with pytest.raises(WorldError, match=r"mine\.yaml:4: camera\.horizontal_fov: .*below 3\.1"):
        load_sensor(path)


def test_load_sensor__unknown_name():
    with pytest.raises(WorldError, match=r"unknown sensor 'voxel_tof'; did you mean 'voxl_tof'"):
        load_sensor("voxel_tof")
    with pytest.raises(WorldError, match="cannot be read"):
        load_sensor("none.yaml")


def test_camera__is_closed_to_unknown_keys():
    with pytest.raises(ValidationError):
        Camera(width=8, height=8, horizontal_fov=1.0, colour="red")
