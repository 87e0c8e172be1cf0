"""The same simulated flight in every format, with every kind of poses and clouds."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beamseg_batch.config import RunConfig
from beamseg_batch.detection import Detector
from beamseg_batch.geometry import RigidTransform, matrix_from_quaternion
from beamseg_batch.model import Scan, Trajectory
from beamseg_batch.recording import open_flight, open_recording
from beamseg_batch.simulation.scans import ScanSimulator
from beamseg_batch.simulation.sensor import load_sensor
from beamseg_batch.simulation.trajectory import Orbit, TruePath
from beamseg_batch.structure import Structure
from beamseg_batch.world.scene import Member, Scene, Section
from tests.recordings import (
    KINDS,
    START_NS,
    Message,
    cloud_message,
    encoding_of,
    message,
    pose_message,
    static_tf,
    write_messages,
)

SECTION = Section("round", 0.1, 0.1)
BEAMS = (
    Member("rail", np.array([0.0, -0.8, 1.2]), np.array([0.0, 0.8, 1.2]), SECTION),
    Member("post", np.array([0.0, 0.2, 0.4]), np.array([0.0, 0.2, 2.0]), SECTION),
)
N_SCANS, SIZE = 3, 32
QUATERNION_OPTICAL = (-0.5, 0.5, -0.5, 0.5)
"""``T_body_sensor`` of an optical frame that looks along the body's x axis."""
POINT_FIELD = "sensor_msgs/msg/PointField"
CLOUD = "sensor_msgs/msg/PointCloud2"
TF = "tf2_msgs/msg/TFMessage"


@cache
def simulated() -> tuple[list[tuple[int, Any]], list[tuple[int, Any, Any]]]:
    """Clouds, float32, and poses of a drone that flies past two beams."""
    settings = [f"camera.{key}={SIZE}" for key in ("width", "height")]
    settings += ["camera.horizontal_fov=1.3", "camera.rate_hz=2", "camera.noise=0.004"]
    sensor = load_sensor("webots_range_finder", settings)
    path = TruePath(Orbit(centre=(0, 0, 1.2), radius=1.0, turns=0.2, speed=0.4), seed=3)
    scans = ScanSimulator(Scene("cross", BEAMS), path, sensor, N_SCANS * 0.5)
    stamps = [START_NS + round(time * 1e9) for time in scans.times]
    clouds = [
        (stamp, scan.points.astype(np.float32).reshape(SIZE, SIZE, 3))
        for stamp, scan in zip(stamps, scans.scans(), strict=True)
    ]
    positions, quaternions = path.poses(np.array(scans.times))
    return clouds, [
        (stamp, position, quaternion)
        for stamp, position, quaternion in zip(stamps, positions, quaternions, strict=True)
    ]


def plain(kind, stamp, points):
    return cloud_message(kind, stamp, points)


def packed(names, dtypes, offsets, step, *, order="<", row_padding=0, frame="tof"):
    """Make a writer of clouds with fields of some types at some places."""

    def write(kind, stamp, points):
        layout = np.dtype(
            {
                "names": names,
                "formats": [np.dtype(d).newbyteorder(order) for d in dtypes],
                "offsets": offsets,
                "itemsize": step,
            }
        )
        rows = np.zeros(points.shape[:2], dtype=layout)
        for axis, values in zip("xyz", np.moveaxis(points, -1, 0), strict=True):
            rows[axis] = values
        codes = {"f4": 7, "f8": 8, "u2": 4}
        fields = [
            message(kind, POINT_FIELD, name=name, offset=offset, datatype=codes[dtype], count=1)
            for name, dtype, offset in zip(names, dtypes, offsets, strict=True)
        ]
        data = b"".join(row.tobytes() + bytes(row_padding) for row in rows)
        return cloud_message(
            kind,
            stamp,
            points,
            frame,
            fields=fields,
            point_step=step,
            row_step=step * points.shape[1] + row_padding,
            is_bigendian=order == ">",
            data=np.frombuffer(data, np.uint8),
        )

    return write


def optical(kind, stamp, points):
    turned = np.stack([-points[..., 1], -points[..., 2], points[..., 0]], axis=-1)
    return cloud_message(kind, stamp, turned, "tof_optical_frame")


def flat(kind, stamp, points):
    return cloud_message(kind, stamp, points.reshape(-1, 3))


LAYOUTS = {
    "plain": plain,
    "flat": flat,
    "double": packed(["x", "y", "z"], ["f8"] * 3, [0, 8, 16], 24),
    "big-endian": packed(["x", "y", "z"], ["f4"] * 3, [0, 4, 8], 12, order=">"),
    "padded": packed(["x", "y", "z"], ["f4"] * 3, [4, 8, 12], 32, row_padding=16),
    "mixed": packed(
        ["intensity", "z", "y", "x"], ["u2", "f4", "f8", "f4"], [0, 2, 6, 14], 19, row_padding=5
    ),
    "optical": optical,
}


def single(msgtype):
    def write(kind, poses):
        return [
            Message("/pose", stamp, msgtype, pose_message(kind, msgtype, stamp, *pose))
            for stamp, *pose in poses
        ]

    return write


def chain(kind, poses):
    """map -> odom moves, odom -> base_link moves, base_link -> tof is static."""
    messages = []
    for k, (stamp, position, quaternion) in enumerate(poses):
        shift = np.array([0.3 * k, -0.2, 0.1])
        for parent, child, place, turn in (
            ("map", "odom", shift, (0, 0, 0, 1)),
            ("odom", "base_link", position - shift, quaternion),
        ):
            content = pose_message(kind, TF, stamp, place, turn, parent, child)
            messages.append(Message("/tf", stamp, TF, content))
    return messages


POSES = {
    "pose": single("geometry_msgs/msg/PoseStamped"),
    "covariance": single("geometry_msgs/msg/PoseWithCovarianceStamped"),
    "transform": single("geometry_msgs/msg/TransformStamped"),
    "odometry": single("nav_msgs/msg/Odometry"),
    "tf": single(TF),
    "tf-chain": chain,
    "file": lambda kind, poses: [],
}

MATRIX = [
    *((kind, "pose", layout) for kind in KINDS for layout in LAYOUTS),
    *((kind, pose, "plain") for kind in KINDS for pose in POSES if pose != "pose"),
    *(("mcap", pose, layout) for pose in POSES for layout in ("mixed", "optical")),
]


def segments_of(scans):
    config = RunConfig()
    detect, structure = Detector(config), Structure(config)
    for scan in scans:
        structure.update(detect(scan))
    return structure.segments()


def recorded(path: Path, kind: str, pose: str, layout: str) -> Any:
    clouds, poses = simulated()
    frame = "tof_optical_frame" if layout == "optical" else "tof"
    turn = QUATERNION_OPTICAL if layout == "optical" else (0, 0, 0, 1)
    messages = [
        Message("/tof_pc", stamp, CLOUD, LAYOUTS[layout](kind, stamp, points))
        for stamp, points in clouds
    ]
    messages += POSES[pose](kind, poses)
    messages += static_tf(kind, START_NS, [("base_link", frame, (0, 0, 0), turn)])
    values = {}
    if pose == "file":
        path.mkdir()
        lines = [f"{s},{','.join(map(repr, map(float, [*p, *q])))}" for s, p, q in poses]
        (path / "poses.csv").write_text("\n".join(["stamp_ns,x,y,z,qx,qy,qz,qw", *lines]))
        values["pose_file"] = str(path / "poses.csv")
    recording = open_recording(write_messages(path, kind, messages))
    return open_flight(recording, RunConfig.model_validate({"recording": values}))


@pytest.fixture(scope="module")
def expected():
    """Segments of the scans as they were simulated, without any recording."""
    clouds, poses = simulated()
    trajectory = Trajectory(
        np.array([stamp for stamp, *_ in poses]),
        np.array([position for _, position, _ in poses]),
        np.array([quaternion for *_, quaternion in poses]),
    )
    scans = [
        Scan(
            index=k,
            stamp_ns=stamp,
            pose_stamp_ns=stamp,
            T_world_body=RigidTransform(
                matrix_from_quaternion(trajectory.quaternions_xyzw[k]), trajectory.positions[k]
            ),
            T_body_sensor=RigidTransform.identity(),
            points=points.reshape(-1, 3),
            width=SIZE,
            height=SIZE,
        )
        for k, (stamp, points) in enumerate(clouds)
    ]
    segments = segments_of(scans)
    assert len(segments) >= 2
    return segments


@pytest.mark.parametrize(
    ("kind", "pose", "layout"), MATRIX, ids=["-".join(case) for case in MATRIX]
)
def test_flight__is_the_same_in_every_form(tmp_path, expected, kind, pose, layout):
    flight = recorded(tmp_path / "r", kind, pose, layout)
    scans = list(flight.scans())
    assert [scan.index for scan in scans] == list(range(N_SCANS))
    segments = segments_of(scans)
    assert len(segments) == len(expected)
    for found, true in zip(segments, expected, strict=True):
        np.testing.assert_allclose(found.anchor, true.anchor, atol=1e-9)
        np.testing.assert_allclose(found.direction, true.direction, atol=1e-9)
        assert found.t_min == pytest.approx(true.t_min, abs=1e-9)
        assert found.t_max == pytest.approx(true.t_max, abs=1e-9)
        assert found.n_points == true.n_points


def test_matrix__has_both_encodings():
    assert {encoding_of(kind) for kind, *_ in MATRIX} == {"ros1", "cdr"}
