"""Poses of PX4, of Foxglove and of files, and clocks that differ or jump."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

from beamseg_batch.errors import AmbiguousTopicError, PoseFileError, RecordingError
from beamseg_batch.geometry import matrix_from_quaternion
from beamseg_batch.model import Scan, SkippedScan
from beamseg_batch.recording.clocks import stamp_jumps
from beamseg_batch.recording.pose_files import read_pose_file
from beamseg_batch.recording.poses import _EXTRACTORS
from beamseg_batch.recording.px4 import px4_values
from tests.recording.conftest import MS, configured, some_clouds, some_poses
from tests.recordings import CDR, START_NS, STORES, Message, message, pose_message

ODOMETRY, POSITION, ATTITUDE = (
    f"px4_msgs/msg/Vehicle{name}" for name in ("Odometry", "LocalPosition", "Attitude")
)
PX4_TYPES = {
    ODOMETRY: "uint64 timestamp\nuint64 timestamp_sample\nuint8 pose_frame\n"
    "float32[3] position\nfloat32[4] q\n",
    POSITION: "uint64 timestamp\nuint64 timestamp_sample\nbool xy_valid\nbool z_valid\n"
    "float32 x\nfloat32 y\nfloat32 z\nfloat32 heading\n",
    ATTITUDE: "uint64 timestamp\nuint64 timestamp_sample\nfloat32[4] q\n",
}
"""The fields that matter of PX4's messages, as version 1.14 has them."""
for name, text in PX4_TYPES.items():
    STORES[CDR].register(get_types_from_msg(text, name))

NED_ENU = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
FRD_FLU = np.diag([1.0, -1.0, -1.0])
FRAMES = {"ned": (1, NED_ENU), "frd": (2, FRD_FLU)}


def px4_of(position, quaternion_xyzw, world):
    """Position and quaternion w, x, y, z of FRD in a PX4 world, from FLU in a ROS world."""
    matrix = world.T @ matrix_from_quaternion(np.array(quaternion_xyzw)) @ FRD_FLU
    w = 0.5 * np.sqrt(max(1.0 + np.trace(matrix), 0.0))
    if w < 1e-3:
        raise AssertionError("half a turn: choose other poses")
    x, y, z = (
        matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]
    )  # fmt: skip
    return world.T @ np.array(position), np.array([w, x / (4 * w), y / (4 * w), z / (4 * w)])


def px4_message(msgtype, stamp_ns, **content):
    content = message("mcap", msgtype, timestamp_sample=stamp_ns // 1000, **content)
    return Message(f"/fmu/out/{msgtype[13:].lower()}", stamp_ns, msgtype, content)


def assert_trajectory(trajectory, poses, atol=1e-6):
    np.testing.assert_array_equal(trajectory.stamps_ns, [stamp for stamp, *_ in poses])
    np.testing.assert_allclose(trajectory.positions, [p for _, p, _ in poses], atol=atol)
    for found, (_, _, quaternion) in zip(trajectory.quaternions_xyzw, poses, strict=True):
        expected = matrix_from_quaternion(np.array(quaternion))
        np.testing.assert_allclose(matrix_from_quaternion(found), expected, atol=atol)


@pytest.mark.parametrize("frame", FRAMES)
def test_open_flight__px4_odometry(fly, frame):
    code, world = FRAMES[frame]
    more = []
    for stamp, position, quaternion in some_poses():
        place, wxyz = px4_of(position, quaternion, world)
        content = {"pose_frame": code, "position": place, "q": wxyz}
        more.append(px4_message(ODOMETRY, stamp, **_floats(content)))
    flight = fly(poses=[], more=more)
    assert flight.poses.topic.msgtype == ODOMETRY
    assert_trajectory(flight.trajectory, some_poses())


def _floats(content):
    arrays = {k: v.astype(np.float32) for k, v in content.items() if isinstance(v, np.ndarray)}
    return {**content, **arrays}


def positions(poses, attitudes: bool):
    more = []
    for stamp, position, quaternion in poses:
        place, wxyz = px4_of(position, quaternion, NED_ENU)
        forward = NED_ENU.T @ matrix_from_quaternion(np.array(quaternion))[:, 0]
        values = dict(zip("xyz", map(float, place), strict=True))
        heading = float(np.arctan2(forward[1], forward[0]))
        valid = {"xy_valid": True, "z_valid": True}
        more.append(px4_message(POSITION, stamp, heading=heading, **values, **valid))
        if attitudes:
            more.append(px4_message(ATTITUDE, stamp, **_floats({"q": wxyz})))
    return more


@pytest.mark.parametrize("attitudes", [True, False])
def test_open_flight__px4_local_position(fly, attitudes):
    """These poses turn about z alone, so that the heading is the whole attitude."""
    flight = fly(poses=[], more=positions(some_poses(), attitudes))
    assert_trajectory(flight.trajectory, some_poses())
    expected = "are those of /fmu/out/vehicleattitude" if attitudes else "holds the heading alone"
    assert any(expected in note for note in flight.notes)


def test_open_flight__px4_attitude_tilts_local_positions(fly):
    tilted = [
        (stamp, position, (0.0, np.sin(0.2), 0.0, np.cos(0.2)))
        for stamp, position, _ in some_poses()
    ]
    assert_trajectory(fly(poses=[], more=positions(tilted, True)).trajectory, tilted)


def test_open_flight__px4_positions_that_do_not_hold_are_refused(fly):
    more = positions(some_poses(), True)
    for entry in more[:6:2]:
        entry.content.xy_valid = False
    flight = fly(poses=[], more=more)
    assert len(flight.trajectory) == 37
    assert any("3 of 40 poses refused" in note for note in flight.notes)


def test_px4_values__older_versions():
    """Before 1.14 the position was x, y, z, and 0 stood for NED."""
    old = SimpleNamespace(x=1.0, y=2.0, z=3.0, q=[1.0, 0, 0, 0], local_frame=0)
    np.testing.assert_allclose(px4_values(old)[:3], (2.0, 1.0, -3.0))
    old.local_frame = 1
    np.testing.assert_allclose(px4_values(old), (1.0, -2.0, -3.0, 0, 0, 0, 1))


def foxglove(**content):
    return SimpleNamespace(timestamp=SimpleNamespace(sec=5, nsec=6), **content)


VECTOR = SimpleNamespace(x=1.0, y=2.0, z=3.0)
TURN = SimpleNamespace(x=0.1, y=0.2, z=0.3, w=0.9)
POSE = SimpleNamespace(position=VECTOR, orientation=TURN)
TRANSFORM = foxglove(
    parent_frame_id="/map", child_frame_id="base", translation=VECTOR, rotation=TURN
)


@pytest.mark.parametrize(
    ("name", "content", "edges"),
    [
        ("PoseInFrame", foxglove(frame_id="map", pose=POSE), [("map", "")]),
        ("PosesInFrame", foxglove(frame_id="map", poses=[POSE]), [("map", "")]),
        (
            "PosesInFrame",
            foxglove(frame_id="map", poses=[POSE, POSE]),
            [("map", "pose 0"), ("map", "pose 1")],
        ),
        ("FrameTransform", TRANSFORM, [("map", "base")]),
        ("FrameTransforms", SimpleNamespace(transforms=[TRANSFORM] * 2), [("map", "base")] * 2),
    ],
)
@pytest.mark.parametrize("package", ["foxglove.", "foxglove_msgs/msg/"])
def test_extractors__foxglove(package, name, content, edges):
    records = _EXTRACTORS[package + name](content)
    assert [record.edge for record in records] == edges
    for record in records:
        assert record.stamp_ns == 5_000_000_006
        assert record.values == (1.0, 2.0, 3.0, 0.1, 0.2, 0.3, 0.9)


def tum(poses):
    lines = ["# t x y z qx qy qz qw"]
    for stamp, position, quaternion in poses:
        seconds, nanoseconds = divmod(stamp, 10**9)
        values = " ".join(f"{value:.17g}" for value in (*position, *quaternion))
        lines.append(f"{seconds}.{nanoseconds:09d} {values}")
    return "\n".join([*lines, ""])


def csv(poses, stamp="stamp_ns"):
    lines = [f"qw,qx,qy,qz,x,y,z,quality,{stamp}"]
    for stamp_ns, position, (x, y, z, w) in poses:
        time = stamp_ns if stamp == "stamp_ns" else f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}"
        lines.append(",".join(map(repr, (w, x, y, z, *position))) + f",good,{time}")
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("truth.tum", tum(some_poses())),
        ("poses.CSV", csv(some_poses())),
        ("poses.csv", csv(some_poses(), "t")),
    ],
)
def test_open_flight__poses_of_a_file(fly, tmp_path, file, text):
    path = tmp_path / file
    path.write_text(text.replace("np.float64(", "").replace(")", ""))
    flight = fly(configured(recording={"pose_file": str(path)}), poses=[])
    assert_trajectory(flight.trajectory, some_poses(), atol=1e-12)
    assert flight.info.pose_topic == str(path)
    assert all(isinstance(scan, Scan) for scan in flight.scans())


@pytest.mark.parametrize(
    ("file", "text", "problem"),
    [
        ("a.tum", "# t\n1 2 3\n", ":2: 3 values; 8 are needed"),
        ("a.tum", "1 2 3 4 5 6 7 x\n", ":1: could not convert string to float: 'x'"),
        ("a.tum", "one 2 3 4 5 6 7 8\n", ":1: 'one' is not a stamp"),
        ("a.tum", "inf 2 3 4 5 6 7 8\n", ":1: 'inf' is not a stamp"),
        ("a.csv", "", ":1: the header must name stamp_ns or t.*it is: empty"),
        ("a.csv", "t,x,y,z\n1,2,3,4\n", ":1: the header must name"),
        ("a.csv", "t,x,y,z,qx,qy,qz,qw\n1,2\n", ":2: 2 values under 8 names"),
        ("a.txt", "", "a file of poses ends in .tum or .csv"),
        ("a.tum", b"\xff\xfe", "is not text in UTF-8"),
    ],
)
def test_read_pose_file__bad_files(tmp_path, file, text, problem):
    path = tmp_path / file
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(PoseFileError, match=problem):
        read_pose_file(path)


def test_read_pose_file__missing(tmp_path):
    with pytest.raises(PoseFileError, match="cannot be read: No such file"):
        read_pose_file(tmp_path / "none.tum")


def test_open_flight__poses_of_an_empty_file(fly, tmp_path):
    (tmp_path / "a.tum").write_text("# nothing\n")
    with pytest.raises(RecordingError, match="no usable pose"):
        fly(configured(recording={"pose_file": str(tmp_path / "a.tum")}))


def late(poses, by_ns):
    """The same poses whose headers are of another clock."""
    kind = "geometry_msgs/msg/PoseStamped"
    return [
        Message("/p", stamp, kind, pose_message("mcap", kind, stamp - by_ns, *pose))
        for stamp, *pose in poses
    ]


def test_open_flight__clocks_that_never_meet(fly):
    more = late(some_poses(), 238 * 86400 * 10**9)
    flight = fly(poses=[], more=more)
    assert all(isinstance(scan, SkippedScan) for scan in flight.scans())
    (note,) = [note for note in flight.notes if "never meet" in note]
    assert "238 days apart; see --time-source log" in note
    by_log = fly(configured(recording={"time_source": "log"}), poses=[], more=more)
    assert not any("never meet" in note for note in by_log.notes)
    assert all(isinstance(scan, Scan) for scan in by_log.scans())
    np.testing.assert_array_equal(by_log.trajectory.stamps_ns, [s for s, *_ in some_poses()])


def test_open_flight__time_offset_that_the_note_names(fly):
    more = late(some_poses(), -(10**12))
    (note,) = [note for note in fly(poses=[], more=more).notes if "never meet" in note]
    assert "--time-offset 1000.000 would" in note
    config = configured(recording={"time_offset_s": 1000.0})
    assert all(isinstance(scan, Scan) for scan in fly(config, poses=[], more=more).scans())


@pytest.mark.parametrize("by_ns", [10**10, -(10**10)])
def test_open_flight__clock_that_is_reset_is_said(fly, by_ns):
    poses = some_poses()
    more = late(poses[:20], 0) + late(poses[20:], by_ns)
    flight = fly(poses=[], more=more)
    (note,) = [note for note in flight.notes if "was reset" in note]
    assert f"their stamps jump by {-by_ns * 1e-9:+.3f} s 0.2 s after the first;" in note
    by_log = fly(configured(recording={"time_source": "log"}), poses=[], more=more)
    assert not any("was reset" in note for note in by_log.notes)


def test_stamp_jumps__gaps_and_disorder_are_none():
    stamps = np.array([0, 10, 9, 11, 30, 31]) * 10**9 // 10
    assert stamp_jumps(stamps, stamps) == []
    stalled = np.array([0, 10, 11, 60, 60, 61]) * 10**9 // 10  # the recorder, for five seconds
    assert stamp_jumps(stamps, stalled) == []


def test_open_flight__several_poses_in_one_message_must_be_told_apart(fly, monkeypatch):
    def two(content):
        (record,) = one(content)
        return [record._replace(edge=("map", f"pose {k}")) for k in range(2)]

    msgtype = "geometry_msgs/msg/PoseStamped"
    one = _EXTRACTORS[msgtype]
    monkeypatch.setitem(_EXTRACTORS, msgtype, two)
    monkeypatch.setattr("beamseg_batch.recording.poses.pose_values_at", lambda *_: None)
    with pytest.raises(AmbiguousTopicError, match="'map' -> 'pose 0', 'map' -> 'pose 1'"):
        fly()
    flight = fly(configured(recording={"body_frame": "pose 1"}), clouds=some_clouds())
    assert flight.roles.body == "pose 1"
    assert len(flight.trajectory) == 40
    assert flight.trajectory.stamps_ns[1] == START_NS + 10 * MS
