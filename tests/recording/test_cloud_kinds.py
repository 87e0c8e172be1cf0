"""Clouds of every type and orientation: what else than a PointCloud2 with x forward."""

from __future__ import annotations

import base64
from types import SimpleNamespace

import numpy as np
import pytest

from beamseg_batch.config import SensorConfig
from beamseg_batch.errors import RecordingError
from beamseg_batch.geometry import matrix_from_rpy
from beamseg_batch.model import Scan, SkippedScan
from beamseg_batch.recording.axes import T_OPTICAL_SENSOR, AheadCounts, choose_axis, turned_ahead
from beamseg_batch.recording.clouds import Confidence
from beamseg_batch.recording.other_clouds import read_foxglove_cloud, read_point_list
from tests.recording.conftest import configured, some_poses
from tests.recordings import START_NS, Message, cloud_message, header, message

IMAGE, CAMERA = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
IDENTITY = (0.0, 0.0, 0.0, 1.0)


def ahead_points(count=400, seed=2) -> np.ndarray:
    """Points before a camera with x forward."""
    rng = np.random.default_rng(seed)
    points = rng.uniform((0.3, -1.0, -0.8), (2.0, 1.0, 0.8), size=(count, 3))
    return points.astype(np.float32)


def optical(points: np.ndarray) -> np.ndarray:
    """The same points in optical axes."""
    return np.stack([-points[:, 1], -points[:, 2], points[:, 0]], axis=1)


def test_turned_ahead__is_the_rotation_and_rounds_nothing():
    points = ahead_points()
    np.testing.assert_array_equal(turned_ahead(optical(points)), points)
    np.testing.assert_allclose(T_OPTICAL_SENSOR.apply(points), optical(points))


@pytest.mark.parametrize(
    ("axes", "frame", "cloud", "rotation", "is_z"),
    [
        ("auto", "tof", "ahead", None, False),
        ("auto", "tof", "optical", None, True),
        ("auto", "tof_optical_frame", "ahead", None, False),
        ("auto", "tof_optical_frame", "everywhere", None, True),
        ("auto", "tof", "everywhere", "optical", True),
        ("auto", "tof", "everywhere", "level", False),
        ("auto", "tof", "few", None, False),
        ("x_forward", "tof", "optical", None, False),
        ("z_forward", "tof", "ahead", None, True),
    ],
)
def test_choose_axis__by_choice_then_data_then_name_then_tree(axes, frame, cloud, rotation, is_z):
    points = {
        "ahead": ahead_points(),
        "optical": optical(ahead_points()),
        "everywhere": np.random.default_rng(0).normal(size=(500, 3)),
        "few": optical(ahead_points(20)),
    }[cloud]
    turn = {"optical": T_OPTICAL_SENSOR.rotation.T, "level": np.eye(3)}.get(rotation)
    counts = AheadCounts.of([points, np.full((5, 3), np.nan)])
    chosen = choose_axis(SensorConfig(axes=axes), frame, counts, turn)
    assert chosen.is_z == is_z
    expects_note = axes == "auto" and (is_z or "optical" in frame)
    assert bool(chosen.note) == expects_note


def scans_of(flight) -> list[Scan]:
    return [scan for scan in flight.scans() if isinstance(scan, Scan)]


def test_scans__optical_cloud_is_turned(fly):
    points = ahead_points()
    flight = fly(clouds=[(START_NS, optical(points))])
    (scan,) = scans_of(flight)
    np.testing.assert_array_equal(scan.points, points)
    np.testing.assert_array_equal(scan.T_body_sensor.rotation, np.eye(3))
    assert any("looks along z" in note and "sensor.axes" in note for note in flight.notes)


def test_scans__optical_frame_of_the_tree_is_turned_with_its_cloud(fly):
    points = ahead_points()
    pitched = matrix_from_rpy(0.0, 0.3, 0.0)
    # Roll, pitch and yaw of an optical frame whose camera is pitched down by 0.3.
    turn = pitched @ T_OPTICAL_SENSOR.rotation.T
    w = 0.5 * np.sqrt(1.0 + np.trace(turn))
    vector = [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
    static = [("base_link", "tof_optical", (0.1, 0.0, 0.2), (*(np.array(vector) / (4 * w)), w))]
    flight = fly(clouds=[(START_NS, optical(points))], cloud_frame="tof_optical", tf_static=static)
    (scan,) = scans_of(flight)
    np.testing.assert_array_equal(scan.points, points)
    np.testing.assert_allclose(scan.T_body_sensor.rotation, pitched, atol=1e-12)
    np.testing.assert_allclose(scan.T_body_sensor.translation, [0.1, 0.0, 0.2])


def test_scans__poses_of_the_optical_frame_itself(fly):
    flight = fly(
        clouds=[(START_NS, optical(ahead_points()))],
        cloud_frame="cam_optical",
        body_frame="cam_optical",
        pose_type="nav_msgs/msg/Odometry",
        pose_topic="/odom",
    )
    (scan,) = scans_of(flight)
    np.testing.assert_array_equal(scan.T_body_sensor.rotation, T_OPTICAL_SENSOR.rotation)


def field(name, offset, datatype=7):
    return message(
        "mcap", "sensor_msgs/msg/PointField", name=name, offset=offset, datatype=datatype, count=1
    )


def confident(points, confidence):
    """A cloud with a confidence of 8 bits behind each point."""
    rows = np.zeros(len(points), dtype=[("p", "<f4", 3), ("c", "u1")])
    rows["p"], rows["c"] = points, confidence
    fields = [*(field(name, 4 * k) for k, name in enumerate("xyz")), field("confidence", 12, 2)]
    content = cloud_message(
        "mcap",
        START_NS,
        points,
        fields=fields,
        point_step=13,
        row_step=13 * len(points),
        data=np.frombuffer(rows.tobytes(), np.uint8),
    )
    return Message("/tof_pc", START_NS, "sensor_msgs/msg/PointCloud2", content)


def test_scans__points_of_low_confidence_are_no_returns(fly):
    points, confidence = ahead_points(6), [0, 9, 10, 11, 200, 3]
    config = configured(sensor={"min_confidence": 10})
    for count in (1, 2):  # the second one is read by the template of the first
        *_, scan = fly(config, clouds=[], more=[confident(points, confidence)] * count).scans()
        kept = np.array(confidence) >= 10
        np.testing.assert_array_equal(scan.points[kept], points[kept])
        assert np.isnan(scan.points[~kept]).all()
        assert len(scan.points) == 6
    (scan,) = fly(clouds=[], more=[confident(points, confidence)]).scans()
    np.testing.assert_array_equal(scan.points, points)


def test_scans__cloud_without_confidence_is_skipped(fly):
    config = configured(sensor={"min_confidence": 10, "confidence_fields": ["amplitude"]})
    (skipped,) = fly(config, clouds=[(START_NS, ahead_points(3))]).scans()
    assert isinstance(skipped, SkippedScan)
    assert "no field 'amplitude', which sensor.min_confidence asks for" in skipped.detail


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_scans__point_cloud_of_the_first_type(fly, kind):
    points = ahead_points(5)
    rows = [
        message(kind, "geometry_msgs/msg/Point32", **dict(zip("xyz", map(float, p), strict=True)))
        for p in points
    ]
    content = message(
        kind, "sensor_msgs/msg/PointCloud", header=header(kind, START_NS, "tof"), points=rows
    )
    more = [Message("/cloud", START_NS, "sensor_msgs/msg/PointCloud", content)]
    (scan,) = fly(kind=kind, clouds=[], more=more).scans()
    np.testing.assert_array_equal(scan.points, points)
    assert (scan.width, scan.height) == (5, 1)


def test_read_point_list__confidence_is_a_channel():
    stamp = SimpleNamespace(sec=1, nanosec=2)
    content = SimpleNamespace(
        header=SimpleNamespace(frame_id="/tof", stamp=stamp),
        points=[SimpleNamespace(x=1.0, y=2.0, z=3.0)] * 3,
        channels=[SimpleNamespace(name="intensity", values=np.array([5.0, np.nan, 7.0]))],
    )
    cloud = read_point_list(content, Confidence(("confidence", "intensity"), 6.0))
    assert (cloud.header.frame, cloud.header.stamp_ns) == ("tof", 1_000_000_002)
    np.testing.assert_array_equal(np.isfinite(cloud.points[:, 0]), [False, False, True])
    content.channels[0].values = np.array([5.0])
    assert (
        "3 points have 1 values" in read_point_list(content, Confidence(("intensity",), 6)).problem
    )
    assert "no field" in read_point_list(content, Confidence(("amplitude",), 6)).problem


def foxglove_cloud(points, pose=None, as_text=False):
    rows = np.zeros(len(points), dtype=[("i", "<u2"), ("z", "<f4"), ("y", "<f4"), ("x", "<f4")])
    rows["x"], rows["y"], rows["z"] = np.asarray(points).T
    data = rows.tobytes()
    fields = [("i", 0, 3), ("z", 2, 7), ("y", 6, 7), ("x", 10, 7)]  # 3 is uint16 there
    return SimpleNamespace(
        timestamp=SimpleNamespace(sec=7, nsec=8),
        frame_id="tof",
        pose=pose,
        point_stride=14,
        fields=[SimpleNamespace(name=n, offset=o, type=t) for n, o, t in fields],
        data=base64.b64encode(data).decode() if as_text else data,
    )


def pose_of(position, quaternion):
    return SimpleNamespace(
        position=SimpleNamespace(**dict(zip("xyz", position, strict=True))),
        orientation=SimpleNamespace(**dict(zip("xyzw", quaternion, strict=True))),
    )


@pytest.mark.parametrize("as_text", [False, True])
@pytest.mark.parametrize(
    ("pose", "turn", "shift"),
    [
        (None, np.eye(3), (0, 0, 0)),
        (pose_of((0, 0, 0), (0, 0, 0, 0)), np.eye(3), (0, 0, 0)),
        (pose_of((1, 2, 3), (0, 0, 0, 0)), np.eye(3), (1, 2, 3)),
        (pose_of((0, 0, 1), (0, 0, 2, 2)), matrix_from_rpy(0, 0, np.pi / 2), (0, 0, 1)),
    ],
)
def test_read_foxglove_cloud__applies_its_pose(pose, turn, shift, as_text):
    points = ahead_points(9)
    cloud = read_foxglove_cloud(foxglove_cloud(points, pose, as_text))
    assert cloud.header == ("tof", 7_000_000_008)
    np.testing.assert_allclose(cloud.points, points @ turn.T + shift, atol=1e-6)


def test_read_foxglove_cloud__bad_stride():
    content = foxglove_cloud(ahead_points(4))
    content.point_stride = 6
    assert "does not fit" in read_foxglove_cloud(content).problem
    content.point_stride = 0
    assert len(read_foxglove_cloud(content).points) == 0


def depth_message(kind, depths, encoding, step_padding=0, big_endian=False):
    pixel = {"16UC1": "u2", "32FC1": "f4"}[encoding]
    rows = np.asarray(depths).astype(np.dtype(pixel).newbyteorder(">" if big_endian else "<"))
    step = rows.shape[1] * rows.itemsize + step_padding
    data = b"".join(row.tobytes() + bytes(step_padding) for row in rows)
    content = message(
        kind,
        IMAGE,
        header=header(kind, START_NS, "cam_optical"),
        height=rows.shape[0],
        width=rows.shape[1],
        encoding=encoding,
        is_bigendian=int(big_endian),
        step=step,
        data=np.frombuffer(data, np.uint8),
    )
    return Message("/cam/depth/image", START_NS, IMAGE, content)


def camera_message(kind, distortion=(), topic="/cam/depth/camera_info", model="plumb_bob"):
    names = "KDP" if kind == "bag" else "kdp"
    values = {
        names[0]: np.array([40.0, 0, 3.5, 0, 50.0, 2.5, 0, 0, 1.0]),
        names[1]: np.array(distortion, dtype=np.float64),
        names[2]: np.zeros(12),
    }
    head = header(kind, START_NS, "cam_optical")
    content = message(kind, CAMERA, header=head, distortion_model=model, **values)
    return Message(topic, START_NS, CAMERA, content)


DEPTHS = np.random.default_rng(3).uniform(0.5, 3.0, size=(6, 8))


@pytest.mark.parametrize("kind", ["bag", "mcap"])
@pytest.mark.parametrize(("encoding", "unit"), [("16UC1", 1000.0), ("32FC1", 1.0)])
@pytest.mark.parametrize(("padding", "big_endian"), [(0, False), (6, True)])
def test_scans__depth_image(fly, kind, encoding, unit, padding, big_endian):
    depths = np.round(DEPTHS, 3)
    depths[0, 0] = 0.0
    more = [depth_message(kind, depths * unit, encoding, padding, big_endian), camera_message(kind)]
    flight = fly(kind=kind, clouds=[], more=more)
    (scan,) = scans_of(flight)
    assert (scan.width, scan.height, flight.axis.is_z) == (8, 6, True)
    for row in range(6):
        for column in range(8):
            depth = depths[row, column] or np.nan
            expected = depth * np.array([1.0, -(column - 3.5) / 40.0, -(row - 2.5) / 50.0])
            np.testing.assert_allclose(scan.points[8 * row + column], expected, atol=2e-6)


def test_scans__depth_image_through_a_distorting_lens(fly):
    distortion = (-0.2, 0.05, 0.002, -0.001, 0.01)
    more = [depth_message("mcap", DEPTHS, "32FC1"), camera_message("mcap", distortion)]
    (scan,) = scans_of(fly(clouds=[], more=more))
    x, y = -scan.points[:, 1] / scan.points[:, 0], -scan.points[:, 2] / scan.points[:, 0]
    k1, k2, p1, p2, k3 = distortion
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    rows, columns = np.mgrid[0:6, 0:8]
    np.testing.assert_allclose(40.0 * u + 3.5, columns.ravel(), atol=1e-4)
    np.testing.assert_allclose(50.0 * v + 2.5, rows.ravel(), atol=1e-4)


def test_open_flight__unknown_lens_is_noted(fly):
    more = [depth_message("mcap", DEPTHS, "32FC1"), camera_message("mcap", (0.1,), model="fisheye")]
    assert any("of the model 'fisheye'" in note for note in fly(clouds=[], more=more).notes)


def test_open_flight__cloud_topic_comes_before_a_depth_image(fly):
    flight = fly(more=[depth_message("mcap", DEPTHS, "32FC1"), camera_message("mcap")])
    assert flight.clouds.topic.name == "/tof_pc"


def test_open_flight__camera_in_the_same_frame_is_found(fly):
    more = [depth_message("mcap", DEPTHS, "32FC1"), camera_message("mcap", topic="/info")]
    assert len(scans_of(fly(clouds=[], more=more))) == 1


def test_open_flight__depth_image_without_a_camera(fly):
    with pytest.raises(RecordingError, match="needs its camera: no topic /cam/depth/camera_info"):
        fly(clouds=[], more=[depth_message("mcap", DEPTHS, "32FC1")])


def test_scans__depth_image_too_short_for_its_size(fly):
    image = depth_message("mcap", DEPTHS, "32FC1")
    image.content.data = image.content.data[:-1]
    (skipped,) = fly(clouds=[], more=[image, camera_message("mcap")]).scans()
    assert skipped.reason == "bad_cloud"
    assert "do not fit into 191 bytes" in skipped.detail


def test_scans__colour_image_is_no_cloud(fly):
    image = depth_message("mcap", DEPTHS, "32FC1")
    image.content.encoding = "rgb8"
    with pytest.raises(RecordingError, match="no cloud topic"):
        fly(clouds=[], poses=some_poses(), more=[image, camera_message("mcap")])
