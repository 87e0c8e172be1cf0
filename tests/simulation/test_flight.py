"""Whole flights: a recording and its truth, read back."""

from __future__ import annotations

import json

import numpy as np
import pytest

from beamseg_batch.config import load_config
from beamseg_batch.geometry import matrix_from_quaternion
from beamseg_batch.recording import open_flight, open_recording
from beamseg_batch.simulation import (
    FlightOutput,
    RecordingKind,
    SeenRule,
    Simulation,
    choose_kind,
    load_sensor,
    seen_parts,
)
from beamseg_batch.simulation.pose_stream import START_NS
from beamseg_batch.simulation.trajectory import Orbit, Waypoint, Waypoints, Wobble
from beamseg_batch.tables import TRUTH, TRUTH_JOINTS
from beamseg_batch.world.scene import Box, Rectangle, Scene, Sphere
from tests.simulation.conftest import make_member
from tests.simulation.fields import to_member

FLOOR = Rectangle(np.zeros(3), np.array([6.0, 6.0]))
CROSSING = (
    make_member(start=(0, -0.6, 1.2), end=(0, 0.6, 1.2), name="rail"),
    make_member(start=(0, 0, 0.4), end=(0, 0, 2.0), name="post", width=0.06, height=0.06),
    make_member("i", start=(0.1, 0.3, 0.6), end=(0, 0.3, 1.7), name="stanchion"),
)
SCENE = Scene("crossing", CROSSING, rectangles=(FLOOR,), notes=("a note",))
ORBIT = Orbit(centre=(0, 0, 1.2), radius=1.1, turns=1, speed=1.2)
FAST = ["camera.width=32", "camera.height=32"]


def simulation(scene=SCENE, flight=ORBIT, seed=0, sensor="webots_range_finder", settings=(), **kw):
    return Simulation(scene, flight, load_sensor(sensor, [*FAST, *settings]), seed, **kw)


def fly(path, *arguments, kind=None, **options):
    """Simulate, and give the truth that was returned."""
    output = FlightOutput(path, overwrite=True)
    return simulation(*arguments, **options).write(output, kind or choose_kind(path))


def read(path, **overrides):
    settings = [f"{key.replace('__', '.')}={value}" for key, value in overrides.items()]
    return open_flight(open_recording(path), load_config(overrides=settings))


def truth_files(folder):
    return {path.name: path.read_bytes() for path in (folder / "truth").iterdir()}


def test_write__truth_tables(tmp_path):
    truth = fly(tmp_path / "f.mcap")
    table = TRUTH.decode((tmp_path / "truth" / "truth.csv").read_text())
    assert table["id"].tolist() == ["rail", "post", "stanchion"]
    assert table["radius"].tolist() == [0.05, 0.03, 0.07]
    assert table["web"].tolist() == [0.0, 0.0, 0.012]
    assert table["roll_deg"][2] == pytest.approx(np.degrees(0.6), abs=1e-3)
    assert table["frames"].tolist() == [part.n_scans for part in truth.seen]
    starts = np.column_stack([table[name] for name in ("x1", "y1", "z1")])
    np.testing.assert_allclose(starts, [member.start for member in CROSSING], atol=1e-6)
    seen = np.column_stack([table[name] for name in ("ox1", "oy1", "oz1")])
    ends = np.column_stack([table[name] for name in ("ox2", "oy2", "oz2")])
    lengths = np.linalg.norm(ends - seen, axis=1)
    np.testing.assert_allclose(lengths, table["observed_length"], atol=1e-4)
    assert (lengths > 0.7).all()
    joints = TRUTH_JOINTS.decode((tmp_path / "truth" / "truth_joints.csv").read_text())
    assert joints["ids"].tolist()[0] == "rail;post"
    assert (joints["x"][0], joints["y"][0], joints["z"][0]) == pytest.approx((0, 0, 1.2))


def test_write__member_that_was_not_seen(tmp_path):
    far = make_member(start=(9, 9, 1), end=(9, 9, 2))
    fly(tmp_path / "f.mcap", Scene("", (CROSSING[0], far)))
    table = TRUTH.decode((tmp_path / "truth" / "truth.csv").read_text())
    assert table["observed_length"][1] == table["visible_fraction"][1] == 0.0
    assert np.isnan(table["ox1"][1])
    assert table["intervals"].tolist()[1] == ""


def test_write__true_poses_are_those_of_the_flight(tmp_path):
    fly(tmp_path / "f.mcap", settings=["poses.walk_position=0.01", "poses.rate_hz=50"])
    lines = (tmp_path / "truth" / "true_poses.tum").read_text().splitlines()
    values = np.array([line.split() for line in lines], dtype=float)
    recorded = read(tmp_path / "f.mcap").trajectory
    assert len(values) == len(recorded)
    assert lines[1].split()[0] == "1700000000.020000000"
    path = simulation().path
    times = (recorded.stamps_ns - START_NS) * 1e-9
    positions, quaternions = path.poses(times)
    np.testing.assert_allclose(values[:, 1:4], positions, atol=1e-8)
    np.testing.assert_allclose(values[:, 4:], quaternions, atol=1e-8)
    drift = np.linalg.norm(recorded.positions - positions, axis=1)
    assert drift[0] == 0.0
    assert drift.max() > 0.02


def test_write__scene_json(tmp_path):
    fly(tmp_path / "f.mcap", seed=5)
    scene = json.loads((tmp_path / "truth" / "scene.json").read_text())
    assert (scene["scene"], scene["seed"], scene["notes"]) == ("crossing", 5, ["a note"])
    assert scene["scans"] == simulation().duration_s // 0.2
    assert scene["sensor"]["camera"]["horizontal_fov"] == 2.04
    assert scene["flight"]["kind"] == "orbit"
    assert 0.3 < scene["clearance_m"] < 1.1
    assert (scene["members"], scene["members_seen_0.3m"]) == (3, 3)


def test_write__recorded_points_lie_on_the_true_surfaces(tmp_path):
    fly(tmp_path / "f.mcap", settings=["camera.noise=0"])
    n_points = 0
    for scan in read(tmp_path / "f.mcap").scans():
        points = scan.points[np.isfinite(scan.points).all(axis=1)].astype(float)
        world = scan.T_world_sensor.apply(points)
        distances = np.abs([world[:, 2], *(to_member(world, member) for member in CROSSING)])
        # Between two poses, 8 ms apart, a run goes straight.
        assert distances.min(axis=0).max() < 1e-4
        n_points += len(points)
    assert n_points > 3000


def test_write__seen_parts_found_again_from_the_recording(tmp_path):
    truth = fly(tmp_path / "f.mcap")
    camera = load_sensor("webots_range_finder", FAST).camera
    scans = [
        (scan.T_world_sensor, scan.points[:, 0].reshape(scan.height, scan.width).astype(float))
        for scan in read(tmp_path / "f.mcap").scans()
    ]
    parts = seen_parts(SCENE, scans, camera.grid, rule=SeenRule())
    assert [part.n_scans for part in parts] == [part.n_scans for part in truth.seen]
    for part, true in zip(parts, truth.seen, strict=True):
        np.testing.assert_allclose(part.longest, true.longest, atol=0.021)


def test_write__same_seed_same_bytes(tmp_path):
    settings = ["poses.jitter_position=0.01", "camera.dropout=0.1"]
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        fly(tmp_path / name / "f.mcap", seed=seed, settings=settings)
    first, same, other = (
        (*truth_files(tmp_path / name).items(), (tmp_path / name / "f.mcap").read_bytes())
        for name in "abc"
    )
    assert first == same
    assert first[-1] != other[-1]


def test_write__every_format_holds_the_same_scans(tmp_path):
    flights = []
    for name in ("mcap", "bag", "mcap-ros1", "ros2", "ros2-mcap", "db3"):
        path = tmp_path / name / "f"
        fly(path, kind=RecordingKind(name, "none"), limit_s=1.5)
        flights.append(read(path))
    scans = [list(flight.scans()) for flight in flights]
    for k, scan in enumerate(scans[0]):
        for others in scans[1:]:
            assert others[k].stamp_ns == scan.stamp_ns
            np.testing.assert_array_equal(others[k].points, scan.points)
            np.testing.assert_array_equal(
                others[k].T_world_sensor.rotation, scan.T_world_sensor.rotation
            )
    assert len(scans[0]) == 7
    assert {len(others) for others in scans} == {7}


def test_write__extrinsic_gives_the_same_world_wherever_it_is_written(tmp_path):
    extrinsic = "extrinsic={translation: [0.07, 0.01, 0.04], rotation_rpy_deg: [5, 20, -15]}"
    clouds = {}
    for place in ("tf", "cloud", "none"):
        path = tmp_path / place / "f.mcap"
        fly(path, settings=[extrinsic, f"extrinsic_in={place}"], limit_s=1.5)
        told = {"sensor__extrinsic": extrinsic.partition("=")[2]} if place == "none" else {}
        flight = read(path, **told)
        scan = list(flight.scans())[3]
        finite = np.isfinite(scan.points).all(axis=1)
        clouds[place] = scan.T_world_sensor.apply(scan.points[finite].astype(float))
    assert len(clouds["tf"]) > 100
    np.testing.assert_allclose(clouds["cloud"], clouds["tf"], atol=1e-6)
    np.testing.assert_allclose(clouds["none"], clouds["tf"], atol=1e-12)


def test_write__extrinsic_that_nobody_knows_is_not_there(tmp_path):
    fly(tmp_path / "f.mcap", settings=["extrinsic_in=none"], limit_s=1.0)
    assert read(tmp_path / "f.mcap").extrinsic.source == "identity"


def test_write__clock_offset_and_gaps(tmp_path):
    settings = ["poses.clock_offset_s=0.5", "poses.gaps=[[1, 0.7]]", "camera.stamp_jitter_s=0"]
    fly(tmp_path / "f.mcap", settings=settings, limit_s=3.0)
    flight = read(tmp_path / "f.mcap")
    stamps = np.array([scan.stamp_ns for scan in flight.scans()])
    np.testing.assert_allclose((stamps - START_NS)[:2] * 1e-9, [0.6, 0.8])
    gaps = np.diff(flight.trajectory.stamps_ns) * 1e-9
    assert gaps.max() == pytest.approx(0.708, abs=0.009)
    right = read(tmp_path / "f.mcap", recording__time_offset_s=-0.5)
    assert len([scan for scan in right.scans() if hasattr(scan, "points")]) == 12


def test_write__messages_are_in_order_of_their_log_times(tmp_path):
    fly(tmp_path / "f.mcap", limit_s=2.0)
    recording = open_recording(tmp_path / "f.mcap")
    topics = {topic.name: topic for topic in recording.topics}
    times = {
        name: [raw.log_time_ns for raw in recording.topic_messages(topic)]
        for name, topic in topics.items()
    }
    assert all(times[name] == sorted(times[name]) for name in times)
    assert times["/tf_static"] == [START_NS]
    assert len(times["/mavros/local_position/pose"]) == 251


class Counter:
    def __init__(self):
        self.said = []

    def begin(self, n_clouds):
        self.said.append(n_clouds)

    def step(self, n_segments):
        self.said.append(n_segments)


def test_write__tells_how_far_it_is(tmp_path):
    counter = Counter()
    output = FlightOutput(tmp_path / "f.mcap")
    simulation(limit_s=1.0).write(output, choose_kind(output.recording), counter)
    assert counter.said[0] == 5
    assert len(counter.said) == 6
    assert counter.said[-1] == 3


def straight_past(y):
    """Fly along x, beside the upright member at the origin."""
    still = Wobble(position=0, attitude_deg=0)
    point = Waypoint(x=2, y=y, z=1, yaw=0, duration=8)
    return Waypoints(points=(point,), start=(-2, y, 1), wobble=still)


@pytest.mark.parametrize(("y", "distance"), [(0.5, 0.45), (0.06, 0.01), (0.0, 0.0)])
def test_clearance__of_a_member(y, distance):
    far = make_member(start=(0, 3, 0), end=(0, 3, 2))
    post = make_member(start=(0, 0, 0.4), end=(0, 0, 2.0), name="post")
    scene = Scene("", (far, post), rectangles=(FLOOR,))
    nearest = simulation(scene, straight_past(y)).clearance
    assert nearest.distance_m == pytest.approx(distance, abs=2e-3)
    assert nearest.what == "member 'post'"
    assert nearest.time_s == pytest.approx(4.0, abs=0.2)


def test_clearance__of_clutter():
    box = Box(np.array([0.0, 0.8, 1.0]), np.array([0.4, 0.4, 0.4]))
    nearest = simulation(Scene("", boxes=(box,)), straight_past(0.0)).clearance
    assert (nearest.what, nearest.distance_m) == ("clutter", pytest.approx(0.6))
    ball = Sphere(np.array([0.0, 0.8, 1.0]), 0.2)
    nearest = simulation(Scene("", spheres=(ball,)), straight_past(0.0)).clearance
    assert nearest.distance_m == pytest.approx(0.6, abs=1e-3)


def test_clearance__nothing_there():
    assert simulation(Scene("", rectangles=(FLOOR,))).clearance is None


def test_duration__of_the_flight_or_shorter():
    assert simulation().duration_s == ORBIT.duration_s
    assert simulation(limit_s=2.0).duration_s == 2.0
    assert simulation(limit_s=1e6).duration_s == ORBIT.duration_s


def test_write__attitude_of_recorded_poses_is_that_of_the_flight(tmp_path):
    fly(tmp_path / "f.mcap", limit_s=1.0)
    trajectory = read(tmp_path / "f.mcap").trajectory
    rotation = matrix_from_quaternion(trajectory.quaternions_xyzw[0])
    # At the start of the orbit the drone stands at +x and looks back at the centre.
    assert rotation[:, 0] == pytest.approx([-1, 0, 0], abs=0.1)
