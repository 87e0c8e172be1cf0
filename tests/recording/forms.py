"""One simulated flight in every form that a recorder may give it.

A form is a kind of file with its compression; in each, clouds of every layout and poses of
every kind. Numbers stay what they are, but where a form has room for float32 alone.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.writer import CompressionType

from beamseg_batch.model import Trajectory
from beamseg_batch.simulation.scans import ScanSimulator
from beamseg_batch.simulation.sensor import load_sensor
from beamseg_batch.simulation.trajectory import Orbit, TruePath
from beamseg_batch.world.scene import Member, Scene, Section
from tests import foxglove
from tests.recording.px4 import ATTITUDE, LOCAL_POSITION, ODOMETRY, px4_poses
from tests.recordings import (
    CDR,
    ROS1,
    START_NS,
    Message,
    cloud_message,
    encoding_of,
    header,
    message,
    pose_message,
    serialized,
    static_tf,
    write_messages,
)

SECTION = Section("round", 0.1, 0.1)
BEAMS = (
    Member("rail", np.array([0.0, -0.8, 1.2]), np.array([0.0, 0.8, 1.2]), SECTION),
    Member("post", np.array([0.0, 0.2, 0.4]), np.array([0.0, 0.2, 2.0]), SECTION),
)
N_SCANS, SIZE, FOV = 3, 32, 1.3
TURN_OPTICAL = (-0.5, 0.5, -0.5, 0.5)
"""``T_body_sensor`` of an optical frame that looks along the body's x axis."""
NO_TURN = (0.0, 0.0, 0.0, 1.0)

CLOUD, POINT_FIELD = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/PointField"
POINT_LIST, POINT = "sensor_msgs/msg/PointCloud", "geometry_msgs/msg/Point32"
IMAGE, CAMERA = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
TF, OLD_TF = "tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"
OPTICAL = "tof_optical_frame"


class Form(NamedTuple):
    """A kind of file: its name, encoding of messages, kind and compression."""

    name: str
    encoding: str
    kind: str
    compression: str = ""


FORMS = (
    *(Form(f"bag-{c or 'none'}", ROS1, f"bag-{c}".rstrip("-")) for c in ("", "bz2", "lz4")),
    *(
        Form(f"{kind}-{c or 'none'}", CDR, kind, c)
        for kind in ("ros2-sqlite3", "ros2-mcap")
        for c in ("", "file", "message")
    ),
    *(Form(f"db3-{c or 'none'}", CDR, "db3", c) for c in ("", "file")),
    *(
        Form(f"{kind}-{c}", encoding_of(kind), kind, c)
        for kind in ("mcap", "mcap-cdr", "mcap-ros1")
        for c in ("none", "lz4", "zstd")
    ),
    *(
        Form(f"mcap-{encoding}-{c}", encoding, "mcap", c)
        for encoding in ("protobuf", "json")
        for c in ("none", "lz4", "zstd")
    ),
)


@cache
def simulated() -> tuple[list[tuple[int, Any]], list[tuple[int, Any, Any]]]:
    """Clouds, float32, and poses of a drone that flies past two beams."""
    settings = [f"camera.{key}={SIZE}" for key in ("width", "height")]
    settings += [f"camera.horizontal_fov={FOV}", "camera.rate_hz=2", "camera.noise=0.004"]
    sensor = load_sensor("webots_range_finder", [*settings, "camera.stamp_jitter_s=0"])
    path = TruePath(Orbit(centre=(0, 0, 1.2), radius=1.0, turns=0.2, speed=0.4), seed=3)
    scans = ScanSimulator(Scene("cross", BEAMS), path, sensor, N_SCANS * 0.5)
    stamps = [START_NS + round(time * 1e9) for time in scans.times]
    clouds = [
        (stamp, scan.points.astype(np.float32).reshape(SIZE, SIZE, 3))
        for stamp, scan in zip(stamps, scans.scans(), strict=True)
    ]
    poses = zip(stamps, *path.poses(np.array(scans.times)), strict=True)
    return clouds, list(poses)


def true_trajectory() -> Trajectory:
    """Poses as they were simulated."""
    stamps, positions, quaternions = map(np.array, zip(*simulated()[1], strict=True))
    return Trajectory(stamps, positions, quaternions)


def turned_optical(points):
    return np.stack([-points[..., 1], -points[..., 2], points[..., 0]], axis=-1)


def structured(points, names, dtypes, offsets, step, order="<"):
    """Points as rows of fields of some types at some places."""
    formats = [np.dtype(dtype).newbyteorder(order) for dtype in dtypes]
    layout = {"names": names, "formats": formats, "offsets": offsets, "itemsize": step}
    rows = np.zeros(points.shape[:-1], dtype=np.dtype(layout))
    for axis, values in zip("xyz", np.moveaxis(points, -1, 0), strict=True):
        rows[axis] = values
    return rows


CODES = {"f4": 7, "f8": 8, "u2": 4}
MIXED = (["intensity", "z", "y", "x"], ["u2", "f4", "f8", "f4"], [0, 2, 6, 14], 19)
DOUBLE = (["x", "y", "z"], ["f8"] * 3, [0, 8, 16], 24)


def packed(names, dtypes, offsets, step, *, order="<", row_padding=0):
    """Make a writer of PointCloud2 with fields of some types at some places."""

    def write(kind, stamp, points):
        fields = [
            message(kind, POINT_FIELD, name=name, offset=offset, datatype=CODES[dtype], count=1)
            for name, dtype, offset in zip(names, dtypes, offsets, strict=True)
        ]
        rows = structured(points, names, dtypes, offsets, step, order)
        data = b"".join(row.tobytes() + bytes(row_padding) for row in rows)
        content = {"fields": fields, "point_step": step, "is_bigendian": order == ">"}
        content["row_step"] = step * points.shape[1] + row_padding
        data = np.frombuffer(data, np.uint8)
        return [(CLOUD, cloud_message(kind, stamp, points, **content, data=data))]

    return write


def plain(kind, stamp, points):
    return [(CLOUD, cloud_message(kind, stamp, points))]


def flat(kind, stamp, points):
    return [(CLOUD, cloud_message(kind, stamp, points.reshape(-1, 3)))]


def optical(kind, stamp, points):
    return [(CLOUD, cloud_message(kind, stamp, turned_optical(points), OPTICAL))]


def point_list(kind, stamp, points):
    rows = [dict(zip("xyz", map(float, row), strict=True)) for row in points.reshape(-1, 3)]
    content = [message(kind, POINT, **row) for row in rows]
    head = header(kind, stamp, "tof")
    return [(POINT_LIST, message(kind, POINT_LIST, header=head, points=content))]


def depth_image(kind, stamp, points):
    """Pixel (u, v) of the simulated camera looks at y/x = (SIZE/2 - u)/focal, z/x alike."""
    depths = points[..., 0].astype("<f4")
    focal = SIZE / 2.0 / np.tan(FOV / 2.0)
    matrix = np.array([focal, 0.0, SIZE / 2, 0.0, focal, SIZE / 2, 0.0, 0.0, 1.0])
    size = {"header": header(kind, stamp, OPTICAL), "height": SIZE, "width": SIZE}
    data = np.frombuffer(depths.tobytes(), np.uint8)
    image = message(kind, IMAGE, **size, encoding="32FC1", step=4 * SIZE, data=data)
    name = "K" if encoding_of(kind) == ROS1 else "k"
    camera = message(kind, CAMERA, **size, distortion_model="plumb_bob", **{name: matrix})
    return [(IMAGE, image), (CAMERA, camera)]


ROS_LAYOUTS = {
    "plain": plain,
    "flat": flat,
    "double": packed(*DOUBLE),
    "big-endian": packed(["x", "y", "z"], ["f4"] * 3, [0, 4, 8], 12, order=">"),
    "padded": packed(["x", "y", "z"], ["f4"] * 3, [4, 8, 12], 32, row_padding=16),
    "mixed": packed(*MIXED, row_padding=5),
    "optical": optical,
    "point-list": point_list,
    "depth-image": depth_image,
}
_TOPICS = {IMAGE: "/depth/image", CAMERA: "/depth/camera_info"}


def single(msgtype):
    def write(kind, poses):
        return [
            (msgtype, stamp, pose_message(kind, msgtype, stamp, *pose)) for stamp, *pose in poses
        ]

    return write


def chained(poses):
    """map -> odom moves, odom -> base_link moves: (stamp, place, turn, parent, child)."""
    for k, (stamp, position, quaternion) in enumerate(poses):
        shift = np.array([0.3 * k, -0.2, 0.1])
        yield stamp, shift, NO_TURN, "map", "odom"
        yield stamp, position - shift, quaternion, "odom", "base_link"


def chain(kind, poses):
    return [(TF, link[0], pose_message(kind, TF, *link)) for link in chained(poses)]


def px4(msgtype):
    def write(kind, poses):
        return [(msgtype, *entry) for entry in px4_poses(msgtype, poses)]

    return write


ROS_POSES = {
    "pose": single("geometry_msgs/msg/PoseStamped"),
    "covariance": single("geometry_msgs/msg/PoseWithCovarianceStamped"),
    "transform": single("geometry_msgs/msg/TransformStamped"),
    "odometry": single("nav_msgs/msg/Odometry"),
    "tf": single(TF),
    "tf-chain": chain,
}
ROS1_POSES = {"old-tf": single(OLD_TF)}
CDR_POSES = {"px4-odometry": px4(ODOMETRY), "px4-position": px4(LOCAL_POSITION)}
FILES = ("csv", "tum")
"""Poses beside the recording."""


def fox_packed(names, dtypes, offsets, step):
    fields = [
        {"name": name, "offset": offset, "type": CODES[dtype]}
        for name, dtype, offset in zip(names, dtypes, offsets, strict=True)
    ]

    def write(stamp, points):
        data = structured(points, names, dtypes, offsets, step).tobytes()
        return foxglove.cloud(stamp, points, fields=fields, point_stride=step, data=data)

    return write


def fox_optical(stamp, points):
    return foxglove.cloud(stamp, turned_optical(points), frame_id=OPTICAL)


def fox_posed(stamp, points):
    """The cloud lies half a turn about z and 0.3 m away in its frame."""
    shift = np.array([0.3, -0.1, 0.2])
    moved = (points.astype(np.float64) - shift) * [-1.0, -1.0, 1.0]
    names, dtypes, offsets, step = DOUBLE
    pose = foxglove.pose(shift, (0.0, 0.0, 1.0, 0.0))
    entry = fox_packed(names, dtypes, offsets, step)(stamp, moved)
    entry[3]["pose"] = pose
    return entry


FOX_LAYOUTS = {
    "plain": foxglove.cloud,
    "double": fox_packed(*DOUBLE),
    "mixed": fox_packed(*MIXED),
    "optical": fox_optical,
    "posed": fox_posed,
}


def fox_single(name):
    def write(poses):
        return [
            (f"foxglove.{name}", stamp, foxglove.pose_content(name, stamp, *pose))
            for stamp, *pose in poses
        ]

    return write


def fox_chain(poses):
    name = "foxglove.FrameTransform"
    return [(name, link[0], foxglove.transform(*link)) for link in chained(poses)]


FOX_POSES = {
    "pose": fox_single("PoseInFrame"),
    "poses": fox_single("PosesInFrame"),
    "transform": fox_single("FrameTransform"),
    "transforms": fox_single("FrameTransforms"),
    "chain": fox_chain,
}


def is_ros(form: Form) -> bool:
    return form.encoding in (ROS1, CDR)


def layouts_of(form: Form) -> tuple[str, ...]:
    """Layouts that the clouds of a form can have."""
    return tuple(ROS_LAYOUTS if is_ros(form) else FOX_LAYOUTS)


def poses_of(form: Form) -> tuple[str, ...]:
    """Kinds of poses that a form can hold."""
    own = {ROS1: {**ROS_POSES, **ROS1_POSES}, CDR: {**ROS_POSES, **CDR_POSES}}
    return (*own.get(form.encoding, FOX_POSES), *FILES)


def topic_of(pose: str) -> str:
    """Topic of the poses of a kind."""
    return "/" + pose.replace("-", "_")


def write_form(folder: Path, form: Form, layout: str) -> Path:
    """Write the flight with clouds of one layout and poses of all kinds, each its own topic."""
    folder.mkdir()
    if not is_ros(form):
        compression = CompressionType[form.compression.upper()]
        messages = _fox_messages(layout)
        return foxglove.write(folder / "flight.mcap", form.encoding, compression, messages)
    messages = _ros_messages(form.encoding, layout)
    return write_messages(folder, form.kind, messages, compression=form.compression)


def write_pose_files(folder: Path) -> dict[str, str]:
    """Write the poses as files; return their paths by ending."""
    rows = [(stamp, map(repr, map(float, [*p, *q]))) for stamp, p, q in simulated()[1]]
    csv, tum = ["stamp_ns,x,y,z,qx,qy,qz,qw"], []
    for stamp, values in rows:
        numbers = list(values)
        csv.append(",".join([str(stamp), *numbers]))
        tum.append(" ".join([f"{stamp // 10**9}.{stamp % 10**9:09d}", *numbers]))
    for ending, lines in (("csv", csv), ("tum", tum)):
        (folder / f"poses.{ending}").write_text("\n".join(lines))
    return {ending: str(folder / f"poses.{ending}") for ending in FILES}


@cache
def _ros_messages(encoding: str, layout: str) -> list[Message]:
    kind = "bag" if encoding == ROS1 else "mcap"
    clouds = [
        serialized(kind, Message(_TOPICS.get(msgtype, "/tof_pc"), stamp, msgtype, content))
        for stamp, points in simulated()[0]
        for msgtype, content in ROS_LAYOUTS[layout](kind, stamp, points)
    ]
    return clouds + _ros_poses(encoding)


@cache
def _ros_poses(encoding: str) -> list[Message]:
    kind = "bag" if encoding == ROS1 else "mcap"
    kinds = {**ROS_POSES, **(ROS1_POSES if encoding == ROS1 else CDR_POSES)}
    messages = [
        Message(topic_of(name), stamp, msgtype, content)
        for name, write in kinds.items()
        for msgtype, stamp, content in write(kind, simulated()[1])
    ]
    if encoding == CDR:
        attitudes = px4(ATTITUDE)(kind, simulated()[1])
        messages += [Message("/attitude", stamp, name, value) for name, stamp, value in attitudes]
    places = [("tof", NO_TURN), (OPTICAL, TURN_OPTICAL)]
    static = [("base_link", frame, (0, 0, 0), turn) for frame, turn in places]
    messages += static_tf(kind, START_NS, static)
    return [serialized(kind, entry) for entry in messages]


def _fox_messages(layout: str) -> list[tuple[str, int, str, Any]]:
    messages = [FOX_LAYOUTS[layout](stamp, points) for stamp, points in simulated()[0]]
    for name, write in FOX_POSES.items():
        for msgtype, stamp, content in write(simulated()[1]):
            messages.append((topic_of(name), stamp, msgtype, content))
    static = [
        foxglove.transform(START_NS, (0, 0, 0), turn, "base_link", frame)
        for frame, turn in (("tof", NO_TURN), (OPTICAL, TURN_OPTICAL))
    ]
    content = {"transforms": static}
    return [*messages, ("/tf_static", START_NS, "foxglove.FrameTransforms", content)]
