"""What the camera measures: surfaces, noise and the flaws of a real one."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.errors import ConfigError
from beamseg_batch.simulation.scans import ScanSimulator, scan_times
from beamseg_batch.simulation.sensor import Camera, Sensor
from beamseg_batch.simulation.trajectory import Orbit, TruePath, Waypoint, Waypoints, Wobble
from beamseg_batch.world.scene import Rectangle, Scene
from tests.simulation.conftest import make_member
from tests.simulation.fields import to_member, walk

CAMERA = Camera(width=40, height=40, horizontal_fov=1.8)
ORBIT = Orbit(centre=(0, 0, 1.15), radius=0.9, turns=0.4, speed=0.5, start_angle_deg=-60)
WALL = Scene("", rectangles=(Rectangle(np.zeros(3), np.array([40.0, 40.0])),))
STILL = Wobble(position=0, attitude_deg=0)
HOVER = Waypoints(
    points=[Waypoint(x=0, y=0, z=1, yaw=0, duration=20)], start=(0, 0, 1), wobble=STILL
)
DOWN = {"rotation_rpy_deg": (0, 90, 0)}
"""Looks at the floor, 1 m below."""


def take(scene, flight, duration_s=2.0, seed=0, extrinsic=None, extrinsic_in="tf", **camera):
    sensor = Sensor(
        camera=CAMERA.model_copy(update=camera),
        extrinsic=extrinsic or {},
        extrinsic_in=extrinsic_in,
    )
    simulator = ScanSimulator(scene, TruePath(flight, seed), sensor, duration_s)
    return list(simulator.scans()), simulator


def floor_depths(**camera):
    scans, _ = take(WALL, HOVER, extrinsic=DOWN, **camera)
    return np.array([scan.points[..., 0] for scan in scans])


def test_scan_times__rate_and_jitter():
    camera = CAMERA.model_copy(update={"rate_hz": 10.0, "stamp_jitter_s": 0.002})
    times = scan_times(camera, 100.0, 0)
    assert len(times) == 1000
    off = times - (np.arange(1000) + 0.5) / 10
    assert off.std() == pytest.approx(0.002, rel=0.1)
    rough = scan_times(camera.model_copy(update={"stamp_jitter_s": 5.0}), 100.0, 0)
    assert (np.diff(rough) > 0).all()


def test_scan_times__too_short():
    with pytest.raises(ConfigError, match=r"0\.1 s is too short for a scan: the camera takes 5"):
        scan_times(CAMERA, 0.1, 0)


def test_scans__points_lie_on_the_surface_with_the_noise_asked_for(member):
    """Against the depths that walking along the rays finds."""
    scans, _ = take(Scene("", (member,)), ORBIT, 2.0, noise=0.01)
    residuals = []
    for scan in scans:
        measured = scan.points[..., 0]
        returned = np.isfinite(measured)
        rays = CAMERA.grid.directions[returned]
        lengths = np.linalg.norm(rays, axis=1)
        pose = scan.T_world_sensor
        ranges, _ = walk(
            lambda p: to_member(p, member),
            pose.translation,
            pose.rotate(rays / lengths[:, None]),
            steps=150,
        )
        hit = np.isfinite(ranges)
        assert hit.mean() > 0.95  # the rest grazes, where walking takes too long
        residuals.append(measured[returned][hit] - (ranges / lengths)[hit])
    residuals = np.concatenate(residuals)
    assert len(residuals) > 500
    assert abs(residuals.mean()) < 1e-3
    assert residuals.std() == pytest.approx(0.01, rel=0.08)


def test_scans__without_noise_lie_on_the_surface(member):
    scans, _ = take(Scene("", (member,)), ORBIT, 0.6)
    for scan in scans:
        points = scan.points[np.isfinite(scan.points[..., 0])].astype(float)
        distances = to_member(scan.T_world_sensor.apply(points), member)
        assert len(points) > 50
        # A bent member is a chain of pieces, whose ends stand askew by some 0.1 mm.
        assert np.abs(distances).max() < (2e-4 if member.bow else 1e-6)
        assert np.median(np.abs(distances)) < 2e-5


def test_scans__noise_acts_on_the_depth_wherever_the_pixel_is():
    noise = floor_depths(noise=0.02) - 1.0
    assert noise.mean() == pytest.approx(0.0, abs=5e-4)
    for half in (noise[:, 10:30, 10:30], noise[:, :5]):
        assert half.std() == pytest.approx(0.02, rel=0.05)


def test_scans__relative_noise_is_added_in_squares():
    assert floor_depths(noise=0.01, noise_relative=0.02).std() == pytest.approx(
        np.hypot(0.01, 0.02), rel=0.03
    )


def test_scans__no_return_is_not_finite():
    scans, _ = take(Scene("", (make_member(),)), HOVER)
    empty = ~np.isfinite(scans[0].points[..., 0])
    assert empty.any()
    assert not np.isfinite(scans[0].points[empty]).any()
    assert scans[0].points.dtype == np.float32


def test_scans__range():
    assert np.isfinite(floor_depths(range=(0.1, 1.001))).all()
    assert not np.isfinite(floor_depths(range=(0.1, 0.999))).any()
    assert not np.isfinite(floor_depths(range=(1.001, 4.0))).any()
    assert np.isfinite(floor_depths(range=(0.1, 1.0), noise=0.01)).mean() == pytest.approx(
        0.5, abs=0.02
    )


def test_scans__dropout():
    assert np.isfinite(floor_depths(dropout=0.1)).mean() == pytest.approx(0.9, abs=0.01)


def test_scans__grazing_rays_do_not_return():
    scans, _ = take(WALL, HOVER, grazing_deg=25.0, range=(0.1, 1000.0))
    returned = np.isfinite(scans[0].points[..., 0])
    points = scans[0].points[returned]
    angles = np.degrees(np.arcsin(-points[:, 2] / np.linalg.norm(points, axis=1)))
    assert angles.min() > 24.9
    all_returned = np.isfinite(take(WALL, HOVER, range=(0.1, 1000.0))[0][0].points[..., 0])
    assert 0.3 < returned.sum() / all_returned.sum() < 0.9


def test_scans__footprint_mixes_pixels_at_edges():
    """An edge 1 m away before a wall at 2 m: pixels between them where sub-rays hit both."""
    edge = Rectangle(np.array([5.0, 0.0, 0.0]), np.array([10.0, 40.0]))
    wall = Rectangle(np.array([0.0, 0.0, -1.0]), np.array([40.0, 40.0]))
    scene, shifted = Scene("", rectangles=(edge, wall)), {**DOWN, "translation": (0.01, 0, 0)}
    (sharp,) = np.unique(take(scene, HOVER, extrinsic=shifted)[0][0].points[..., 0])[None]
    assert sharp.tolist() == pytest.approx([1.0, 2.0])
    mixed = take(scene, HOVER, extrinsic=shifted, footprint=3)[0][0].points[..., 0]
    between = mixed[(mixed > 1.01) & (mixed < 1.99)]
    assert len(between) == CAMERA.width  # one row of pixels
    assert between[0] == pytest.approx(np.round(3 * between[0]) / 3, abs=1e-6)


def test_scans__extrinsic_applied_gives_the_same_world_points():
    scene = Scene("", (make_member(),), rectangles=WALL.rectangles)
    extrinsic = {"translation": (0.07, 0.01, 0.04), "rotation_rpy_deg": (3, 12, -20)}
    worlds = []
    for place in ("tf", "cloud"):
        scans, _ = take(scene, ORBIT, 0.6, 4, extrinsic, place, noise=0.01)
        sensor = Sensor(camera=CAMERA, extrinsic=extrinsic, extrinsic_in=place)
        T_world_cloud = scans[1].T_world_sensor @ sensor.T_cloud_sensor.inverse()
        points = scans[1].points[np.isfinite(scans[1].points).all(axis=-1)]
        worlds.append(T_world_cloud.apply(points.astype(float)))
    assert len(worlds[0]) > 400
    np.testing.assert_allclose(*worlds, atol=1e-6)


def test_scans__same_seed_same_scans():
    scene = Scene("", (make_member(),))
    clouds = [
        [scan.points for scan in take(scene, ORBIT, 1.0, seed, noise=0.01, dropout=0.1)[0]]
        for seed in (1, 1, 2)
    ]
    np.testing.assert_array_equal(clouds[0], clouds[1])
    assert not np.array_equal(clouds[0], clouds[2], equal_nan=True)


def test_scans__noise_of_a_scan_does_not_depend_on_those_before():
    scene = Scene("", (make_member(),))
    long, short = (take(scene, ORBIT, duration, noise=0.01)[0] for duration in (1.4, 0.6))
    # The jitter of the stamps is drawn for all scans at once, the rest for each.
    np.testing.assert_array_equal(long[1].points, short[1].points)


def test_simulator__seen_parts_are_those_of_the_taken_scans():
    _, simulator = take(Scene("", (make_member(),)), ORBIT, 2.0, noise=0.05)
    (part,) = simulator.seen()
    assert simulator.n_members_seen == 1
    assert part.n_scans == 10
    assert part.length == pytest.approx(make_member().length, abs=0.2)
    assert simulator.rule.off_surface_m == pytest.approx(0.25)
