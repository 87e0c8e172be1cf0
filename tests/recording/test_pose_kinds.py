"""Poses of PX4, of Foxglove and of files, and clocks that differ or jump."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from beamseg_batch.config import RunConfig
from beamseg_batch.errors import AmbiguousTopicError, PoseFileError, RecordingError
from beamseg_batch.geometry import matrix_from_quaternion
from beamseg_batch.model import Scan, SkippedScan
from beamseg_batch.recording import inspect_recording
from beamseg_batch.recording.clocks import StampWatch, clock_groups, stamp_jumps
from beamseg_batch.recording.pose_files import read_pose_file
from beamseg_batch.recording.poses import _EXTRACTORS
from beamseg_batch.recording.px4 import px4_values
from tests.recording.conftest import MS, configured, some_clouds, some_poses
from tests.recording.px4 import ATTITUDE, FRAMES, LOCAL_POSITION, ODOMETRY, px4_poses
from tests.recordings import START_NS, Message, cloud_message, pose_message


def px4_messages(msgtype, poses, frame="ned"):
    topic = f"/fmu/out/{msgtype[13:].lower()}"
    return [
        Message(topic, stamp, msgtype, entry) for stamp, entry in px4_poses(msgtype, poses, frame)
    ]


def assert_trajectory(trajectory, poses, atol=1e-6):
    np.testing.assert_array_equal(trajectory.stamps_ns, [stamp for stamp, *_ in poses])
    np.testing.assert_allclose(trajectory.positions, [p for _, p, _ in poses], atol=atol)
    for found, (_, _, quaternion) in zip(trajectory.quaternions_xyzw, poses, strict=True):
        expected = matrix_from_quaternion(np.array(quaternion))
        np.testing.assert_allclose(matrix_from_quaternion(found), expected, atol=atol)


@pytest.mark.parametrize("frame", FRAMES)
def test_open_flight__px4_odometry(fly, frame):
    flight = fly(poses=[], more=px4_messages(ODOMETRY, some_poses(), frame))
    assert flight.poses.topic.msgtype == ODOMETRY
    assert_trajectory(flight.trajectory, some_poses())


def positions(poses, attitudes: bool):
    more = px4_messages(LOCAL_POSITION, poses)
    return more + px4_messages(ATTITUDE, poses) if attitudes else more


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
    for entry in more[:3]:
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


POSE, TF = "geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage"
RESET_NS = 3 * 10**9


def reset_flight(fly, config=None, *, poses_by=0, clouds_by=0, msgtype=POSE, late_clouds=()):
    """Six seconds along x at 1 m/s; after three, clocks are set back, so that stamps repeat."""
    more = []
    for k in range(600):
        log_ns = k * 10 * MS
        stamp_ns = log_ns - poses_by * (log_ns >= RESET_NS)
        pose = ((log_ns * 1e-9, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        content = pose_message("mcap", msgtype, START_NS + stamp_ns, *pose)
        more.append(Message("/p", START_NS + log_ns, msgtype, content))
    for k in range(60):
        log_ns = k * 100 * MS
        stamp_ns = log_ns - clouds_by * (log_ns >= RESET_NS)
        log_ns += 1500 * MS * (k in late_clouds)
        content = cloud_message("mcap", START_NS + stamp_ns, some_clouds()[0][1])
        more.append(Message("/c", START_NS + log_ns, "sensor_msgs/msg/PointCloud2", content))
    static = [("base_link", "tof", (0, 0, 0), (0, 0, 0, 1))]
    return fly(config, clouds=[], poses=[], more=more, tf_static=static)


def told(flight):
    """Of each cloud where the drone is said to be, or why it is skipped."""
    return [
        scan.T_world_body.translation[0] if isinstance(scan, Scan) else scan.reason
        for scan in flight.scans()
    ]


@pytest.mark.parametrize("msgtype", [POSE, TF])
@pytest.mark.parametrize("every", [1, 2])
def test_scans__both_clocks_set_back(fly, msgtype, every):
    config = configured(recording={"every": every})
    flight = reset_flight(fly, config, poses_by=2 * 10**9, clouds_by=2 * 10**9, msgtype=msgtype)
    for _ in range(2):
        np.testing.assert_allclose(told(flight), np.arange(0, 60, every) * 0.1)
    summary = inspect_recording(flight.recording, config)
    assert (summary.match.share_within_gap, summary.match.max_dt_s) == (1.0, 0.0)


def test_scans__clock_of_the_clouds_alone_set_back(fly):
    flight = reset_flight(fly, clouds_by=2 * 10**9)
    np.testing.assert_allclose(told(flight)[:30], np.arange(30) * 0.1)
    assert told(flight)[30:] == ["clock_reset"] * 30
    *_, last = flight.scans()
    assert (
        "cloud at 5.900 s: a clock was reset, and stood as that of no pose; see --time-source log"
        in last.detail
    )
    by_log = reset_flight(fly, configured(recording={"time_source": "log"}), clouds_by=2 * 10**9)
    np.testing.assert_allclose(told(by_log), np.arange(60) * 0.1)
    assert inspect_recording(flight.recording, RunConfig()).match.share_within_gap == 0.5


def test_scans__clock_of_the_poses_alone_set_back(fly):
    """Poses stamped 3 s were logged at 5 s; the clouds stamped 3 s were seen elsewhere."""
    found = told(reset_flight(fly, poses_by=2 * 10**9))
    np.testing.assert_allclose(found[:31], [*np.arange(30) * 0.1, 2.99])
    assert set(found[31:]) == {"no_pose_within_gap"}


def test_scans__a_cloud_that_is_late_is_no_reset(fly):
    found = told(reset_flight(fly, late_clouds=(10, 40)))
    np.testing.assert_allclose(sorted(found), np.arange(60) * 0.1)


def test_clock_groups__disorder_is_one_group():
    stamps = np.random.default_rng(0).permutation(300) * 10**9
    ((_, members),) = clock_groups(stamps, np.arange(300) * 10**9)
    assert len(members) == 300


def test_stamp_watch__sees_what_stamp_jumps_finds():
    rng = np.random.default_rng(1)
    logged = np.arange(400) * 10**8
    stamps = logged + rng.integers(-2, 2, 400) * 4 * 10**8
    stamps[100:200] -= 5 * 10**9
    stamps[300:] += 9 * 10**9
    watch = StampWatch()
    seen = [watch.sees_jump(*each) for each in zip(stamps.tolist(), logged.tolist(), strict=True)]
    found = [round(when_s, 3) for when_s, _ in stamp_jumps(stamps, logged)]
    assert found == np.round(logged[seen] * 1e-9, 3).tolist()
    assert len(found) >= 2


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
