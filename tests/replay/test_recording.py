"""Replays, read back: what they show, where, when and as what."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from beamseg_batch.errors import ConfigError, OutputError
from beamseg_batch.geometry import RigidTransform, matrix_from_quaternion, matrix_from_rpy
from beamseg_batch.model import Detections, Scan
from beamseg_batch.outputs import columns as output_columns
from beamseg_batch.recording.axes import T_OPTICAL_SENSOR
from beamseg_batch.replay import check_views, record_views
from beamseg_batch.replay.foxglove import SCENE_TYPES
from beamseg_batch.replay.frames import ViewFrames
from tests.export.test_bars import SECTIONS
from tests.outputs.conftest import START_NS, build_empty_flight, build_flight, make_recording

LOG_LATER_NS = 7_000_000
T_BODY_SENSOR = RigidTransform(matrix_from_rpy(0.1, -0.2, 0.3), np.array([0.07, 0.01, 0.04]))
TYPES = {
    "/markers": "visualization_msgs/msg/MarkerArray",
    "/filtered_pointcloud": "sensor_msgs/msg/PointCloud2",
    "/hough_pointcloud": "sensor_msgs/msg/PointCloud2",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/beams": "foxglove_msgs/msg/SceneUpdate",
}


def flight_of(**changes):
    """Give a flight of 30 scans, 0.1 s apart; its beams are seen one by one, in its first 0.7 s."""
    flight = build_flight(recording=make_recording(T_body_sensor=T_BODY_SENSOR), **changes)
    seen = [
        replace(segment, first_seen_ns=START_NS + k * 100_000_000)
        for k, segment in enumerate(flight.segments)
    ]
    return replace(flight, segments=tuple(seen))


def detections_of(flight):
    """What a search would give: in each scan, points of the first beam."""
    rng = np.random.default_rng(3)
    for index, record in enumerate(flight.scans):
        T = RigidTransform(matrix_from_rpy(0, 0, 0.1 * index), np.array([0.1 * index, 1.0, 2.0]))
        scan = Scan(
            index=index,
            stamp_ns=record.stamp_ns,
            pose_stamp_ns=record.pose_stamp_ns,
            T_world_body=T,
            T_body_sensor=T_BODY_SENSOR,
            points=np.empty((0, 3), dtype=np.float32),
            width=0,
            height=1,
            log_ns=record.stamp_ns + LOG_LATER_NS,
        )
        cloud = rng.uniform(-3.0, 3.0, (index, 3)).astype(np.float32)
        beams = flight.segments[:1] if index else ()
        found = [replace(b, points=rng.uniform(-3.0, 3.0, (5, 3))) for b in beams]
        yield Detections(scan, tuple(found), 100, 50, len(cloud), 1, {}, cloud, {})


def read(path: Path) -> dict:
    """Messages by topic: (log time, type, message), by another library than wrote them."""
    messages: dict = {}
    store = get_typestore(Stores.ROS2_JAZZY)
    with AnyReader([path], default_typestore=store) as reader:
        for connection, log_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            messages.setdefault(connection.topic, []).append((log_ns, connection.msgtype, message))
    return messages


def stamp(header) -> int:
    return header.stamp.sec * 10**9 + header.stamp.nanosec


@pytest.fixture(scope="module", params=[".mcap", ".bag"])
def replay(request, tmp_path_factory):
    flight = flight_of()
    path = tmp_path_factory.mktemp("replay") / f"views{request.param}"
    assert record_views(flight, detections_of(flight), path) == len(flight.scans)
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]
    return flight, read(path), path


def test_record_views__counts_stamps_and_types_are_those_of_the_scans(replay):
    flight, messages, path = replay
    stamps = [scan.stamp_ns for scan in flight.scans]
    topics = set(TYPES) - ({"/beams"} if path.suffix == ".bag" else set())
    assert set(messages) == topics
    for topic, found in messages.items():
        assert {kind for _, kind, _ in found} == {TYPES[topic]}
        expected = stamps[:1] if topic == "/tf_static" else stamps
        assert [log_ns - LOG_LATER_NS for log_ns, _, _ in found] == expected
    for topic in ("/filtered_pointcloud", "/hough_pointcloud"):
        assert [stamp(cloud.header) for _, _, cloud in messages[topic]] == stamps
    assert [stamp(tf.transforms[0].header) for _, _, tf in messages["/tf"]] == stamps
    for (_, _, array), at in zip(messages["/markers"], stamps, strict=True):
        assert {stamp(marker.header) for marker in array.markers} <= {at}
        assert {marker.header.frame_id for marker in array.markers} <= {"mocap"}


def transform(tf) -> tuple[str, str, RigidTransform]:
    (one,) = tf.transforms
    t, q = one.transform.translation, one.transform.rotation
    rotation = matrix_from_quaternion(np.array([q.x, q.y, q.z, q.w]))
    placed = RigidTransform(rotation, np.array([t.x, t.y, t.z]))
    return one.header.frame_id, one.child_frame_id, placed


def points(cloud) -> np.ndarray:
    assert [field.name for field in cloud.fields] == ["x", "y", "z"]
    return np.frombuffer(bytes(cloud.data), "<f4").reshape(-1, 3).astype(float)


def test_record_views__transforms_lead_from_the_clouds_to_the_world(replay):
    flight, messages, _ = replay
    body, camera, T_body_camera = transform(messages["/tf_static"][0][2])
    assert (body, camera) == ("world", "pico_zense_depth_frame")
    for k, found in enumerate(detections_of(flight)):
        world, moving, T_world_body = transform(messages["/tf"][k][2])
        assert (world, moving) == ("mocap", "world")
        np.testing.assert_allclose(
            T_world_body.translation, found.scan.T_world_body.translation, atol=1e-12
        )
        T = T_world_body @ T_body_camera
        on_lines = [segment.points for segment in found.segments]
        expected = {
            "/filtered_pointcloud": found.cloud,
            "/hough_pointcloud": on_lines[0] if on_lines else np.empty((0, 3)),
        }
        for topic, wanted in expected.items():
            cloud = messages[topic][k][2]
            assert cloud.header.frame_id == camera
            assert (cloud.width, cloud.height) == (len(wanted), 1)
            np.testing.assert_allclose(T.apply(points(cloud)), wanted, atol=2e-6)


def by_kind(array) -> dict:
    kinds: dict = {}
    for marker in array.markers:
        kinds.setdefault(marker.ns, {})[marker.id] = marker
    return kinds


def vector(value) -> np.ndarray:
    return np.array([value.x, value.y, value.z])


def axis_of(pose, length) -> np.ndarray:
    q = pose.orientation
    direction = matrix_from_quaternion(np.array([q.x, q.y, q.z, q.w]))[:, 2]
    return vector(pose.position) + np.outer([-0.5, 0.5], direction) * length


def test_record_views__markers_are_the_beams_seen_so_far(replay):
    flight, messages, _ = replay
    for k, (_, _, array) in enumerate(messages["/markers"]):
        kinds = by_kind(array)
        seen = list(range(min(k + 1, 7)))
        assert [*kinds["cylinders"]] == [*kinds["labels"]] == seen
        for number in seen:
            cylinder, segment = kinds["cylinders"][number], flight.segments[number]
            assert (cylinder.type, cylinder.action) == (3, 0)
            ends = axis_of(cylinder.pose, cylinder.scale.z)
            np.testing.assert_allclose(ends, [segment.end_1, segment.end_2], atol=1e-9)
            assert cylinder.scale.x == cylinder.scale.y == pytest.approx(2 * segment.radius)
            assert kinds["labels"][number].text == f"{number}: {segment.length:.2f} m"
            assert kinds["labels"][number].type == 9
        meetings = [n for n, m in enumerate(flight.intersections) if m.segment_2 in seen]
        assert [*kinds.get("intersections", {})] == meetings
        for number in meetings:
            ball = kinds["intersections"][number]
            expected = flight.intersections[number].position
            np.testing.assert_allclose(vector(ball.pose.position), expected, atol=1e-12)
    first = messages["/markers"][0][2].markers[0]
    assert first.action == 3  # what an earlier replay left is removed


def test_record_views__foxglove_shows_the_same(replay):
    flight, messages, path = replay
    if path.suffix == ".bag":
        pytest.skip("a bag has none")
    for k, (_, _, update) in enumerate(messages["/beams"]):
        beams = [entity for entity in update.entities if entity.cylinders]
        assert [entity.id for entity in beams] == [f"beam {n}" for n in range(min(k + 1, 7))]
        for entity, segment in zip(beams, flight.segments, strict=False):
            assert entity.frame_id == "mocap"
            assert entity.timestamp.sec * 10**9 + entity.timestamp.nanosec == (
                flight.scans[k].stamp_ns
            )
            (cylinder,) = entity.cylinders
            assert (cylinder.bottom_scale, cylinder.top_scale) == (1.0, 1.0)
            ends = axis_of(cylinder.pose, cylinder.size.z)
            np.testing.assert_allclose(ends, [segment.end_1, segment.end_2], atol=1e-9)


def test_record_views__mcap_embeds_every_definition(replay):
    _, _, path = replay
    if path.suffix == ".bag":
        pytest.skip("of MCAP")
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    schemas = {summary.schemas[c.schema_id].name for c in summary.channels.values()}
    assert schemas == set(TYPES.values())
    assert all(schema.data and schema.encoding == "ros2msg" for schema in summary.schemas.values())
    # A player of ROS 2 refuses files of several serialisations.
    assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
    kept = {c.topic for c in summary.channels.values() if "offered_qos_profiles" in c.metadata}
    assert kept == {"/tf_static"}


def test_scene_types__have_the_fields_of_foxglove():
    messages = pytest.importorskip("foxglove.messages")
    from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet

    described = FileDescriptorSet.FromString(messages.SceneUpdate.get_schema().data)
    known = {m.name: m for f in described.file if f.package == "foxglove" for m in f.message_type}
    for name, text in SCENE_TYPES.items():
        ours = [line.split() for line in text.splitlines()]
        theirs = known[name].field
        assert [field for _, field in ours] == [field.name for field in theirs], name
        for (kind, _), field in zip(ours, theirs, strict=True):
            is_bytes = field.type == FieldDescriptorProto.TYPE_BYTES
            is_many = field.label == FieldDescriptorProto.LABEL_REPEATED
            assert kind.endswith("[]") == (is_many or is_bytes), (name, field.name)
            if field.type == FieldDescriptorProto.TYPE_DOUBLE:
                assert kind == "float64"
            if kind.startswith("foxglove_msgs/"):
                assert field.type_name == f".foxglove.{kind[14:].removesuffix('[]')}"


def test_record_views__another_section_is_shown_as_a_mesh(tmp_path, monkeypatch):
    plain = output_columns.segment_columns

    def with_sections(segments, origin_ns):
        columns = plain(segments, origin_ns)
        section = SECTIONS["i"]
        columns["shape"][0] = "i"
        for name in ("width", "height", "web", "flange"):
            columns[name] = np.full(len(segments), getattr(section, name))
        return columns

    monkeypatch.setattr("beamseg_batch.replay.scene.segment_columns", with_sections)
    flight = flight_of()
    record_views(flight, detections_of(flight), tmp_path / "views.mcap")
    messages = read(tmp_path / "views.mcap")
    kinds = by_kind(messages["/markers"][-1][2])
    assert [*kinds["sections"]] == [0]
    assert 0 not in kinds["cylinders"]
    corners = np.array([vector(point) for point in kinds["sections"][0].points])
    beam = flight.segments[0]
    t = (corners - beam.anchor) @ beam.direction
    np.testing.assert_allclose([t.min(), t.max()], [beam.t_min, beam.t_max], atol=1e-9)
    (entity,) = [e for e in messages["/beams"][-1][2].entities if e.triangles]
    assert len(entity.triangles[0].points) == len(corners)


def test_record_views__a_flight_without_beams(tmp_path):
    flight = replace(build_empty_flight(), scans=flight_of().scans)
    none = (replace(found, segments=()) for found in detections_of(flight_of()))
    assert record_views(flight, none, tmp_path / "views.mcap") == 30
    messages = read(tmp_path / "views.mcap")
    assert len(messages["/markers"]) == 30
    assert [len(array.markers) for _, _, array in messages["/markers"][1:]] == [0] * 29


def test_record_views__only_the_scans_of_the_result(tmp_path):
    flight = flight_of()
    shorter = replace(flight, scans=flight.scans[:4])
    assert record_views(shorter, detections_of(flight), tmp_path / "views.mcap") == 4


def test_record_views__leaves_nothing_half(tmp_path):
    def failing(flight):
        yield next(detections_of(flight))
        raise OSError(28, "No space left on device")

    with pytest.raises(OutputError, match=r"views\.mcap: cannot be written: No space left"):
        record_views(flight_of(), failing(flight_of()), tmp_path / "views.mcap")
    assert list(tmp_path.iterdir()) == []


def test_check_views__refuses(tmp_path):
    with pytest.raises(ConfigError, match=r"end the name of the replay in \.mcap or \.bag"):
        check_views(tmp_path / "views.db3")
    (tmp_path / "views.bag").touch()
    with pytest.raises(OutputError, match="exists already; use --overwrite"):
        check_views(tmp_path / "views.bag")
    check_views(tmp_path / "views.bag", overwrite=True)


@pytest.mark.parametrize(
    ("names", "T_body_sensor", "expected"),
    [
        (("mocap", "world", "tof"), T_BODY_SENSOR, ("mocap", "world", "tof")),
        # Recordings of the original node: one name for the drone and the camera.
        (("mocap", "world", "world"), RigidTransform.identity(), ("mocap", "world", "world")),
        (("mocap", "world", "world"), T_BODY_SENSOR, ("mocap", "world_body", "world")),
        (("", "", ""), T_BODY_SENSOR, ("world", "camera_body", "camera")),
        (("map", "map", "map"), T_BODY_SENSOR, ("map", "map_camera_body", "map_camera")),
    ],
)
def test_view_frames__names_of_the_recording(names, T_body_sensor, expected):
    world, body, sensor = names
    frames = ViewFrames.of(
        make_recording(
            world_frame=world, body_frame=body, sensor_frame=sensor, T_body_sensor=T_body_sensor
        )
    )
    assert (frames.world, frames.body, frames.camera) == expected
    assert frames.has_extrinsic == (frames.body != frames.camera)


def test_view_frames__axes_of_the_recorded_clouds():
    recording = make_recording(T_body_sensor=T_BODY_SENSOR, T_cloud_sensor=T_OPTICAL_SENSOR)
    frames = ViewFrames.of(recording)
    ahead = np.array([1.0, 0.0, 0.0])
    in_cloud = frames.T_camera_sensor.apply(ahead)
    np.testing.assert_allclose(in_cloud, [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(
        frames.T_body_camera.apply(in_cloud), T_BODY_SENSOR.apply(ahead), atol=1e-12
    )
