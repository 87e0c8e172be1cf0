"""Where the drone flies, and the files that say so."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.errors import WorldError
from beamseg_batch.geometry import matrix_from_quaternion
from beamseg_batch.simulation.trajectory import (
    FigureEight,
    Lawnmower,
    Orbit,
    Spiral,
    TruePath,
    Waypoint,
    Waypoints,
    Wobble,
    load_flight,
    read_waypoints,
)

# As their users write them: a line without values, blanks, no line feed at the end.
ORIGINAL = """x,y,z,yaw,duration

1.0, 0.0, 0.3, 3.14, 5
1.0, 0.0, 2.0, 3.14, 15
1.0, 0.0, 0.1, 3.14, 100"""


@pytest.fixture
def write(tmp_path):
    def write_text(text, name="flight.yaml"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write_text


def test_read_waypoints__as_users_have_them(write):
    points = read_waypoints(write(ORIGINAL, "wp.csv"))
    assert [(p.z, p.duration) for p in points] == [(0.3, 5.0), (2.0, 15.0), (0.1, 100.0)]
    assert points[0] == Waypoint(x=1.0, y=0.0, z=0.3, yaw=3.14, duration=5.0)


def test_read_waypoints__columns_in_any_order(write):
    path = write("duration,name,yaw,z,y,x\r\n4,far,0.5,3,2,1\r\n", "wp.csv")
    assert read_waypoints(path) == (Waypoint(x=1, y=2, z=3, yaw=0.5, duration=4),)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("\nx,y,z,duration\n1,0,1,5", "wp.csv:2: has no column yaw; the first line must be"),
        ("x,y\n1,0", "wp.csv:1: has no column z, yaw, duration;"),
        (f"{ORIGINAL}\n1,0,1,3", "wp.csv:6: has 4 values, the first line 5"),
        (ORIGINAL.replace("15", "soon"), "wp.csv:4: duration: .*, not 'soon'"),
        (ORIGINAL.replace("15", "0"), "wp.csv:4: duration: must be above 0, not '0'"),
        (ORIGINAL.replace("2.0", "nan"), "wp.csv:4: z: must be finite, not 'nan'"),
        ("x,y,z,yaw,duration\n\n", "wp.csv:1: no waypoint follows"),
        ("\n\n", "wp.csv: is empty; the first line must be x,y,z,yaw,duration"),
    ],
)
def test_read_waypoints__errors_name_file_and_line(write, text, complaint):
    with pytest.raises(WorldError, match=complaint):
        read_waypoints(write(text, "wp.csv"))


def test_read_waypoints__unreadable(tmp_path):
    with pytest.raises(WorldError, match="cannot be read: No such file"):
        read_waypoints(tmp_path / "wp.csv")
    (tmp_path / "wp.csv").write_bytes(b"x,\xff")
    with pytest.raises(WorldError, match="is not UTF-8 text"):
        read_waypoints(tmp_path / "wp.csv")


def test_waypoints__times_and_places(write):
    flight = Waypoints(points=read_waypoints(write(ORIGINAL, "wp.csv")))
    assert flight.duration_s == 120.0
    positions, yaws = flight.along(np.array([0.0, 2.5, 5.0, 12.5, 20.0, 120.0, 130.0]))
    np.testing.assert_allclose(
        positions[:, 2], [0.037, 0.1685, 0.3, 1.15, 2.0, 0.1, 0.1], atol=1e-9
    )
    np.testing.assert_allclose(positions[:, :2], [[1.0, 0.0]] * 7)
    np.testing.assert_allclose(yaws, 3.14)


def test_waypoints__at_rest_in_each(write):
    flight = Waypoints(points=read_waypoints(write(ORIGINAL, "wp.csv")))
    step = 1e-3
    for arrival in (0.0, 5.0, 20.0, 120.0):
        around, _ = flight.along(np.array([arrival - step, arrival, arrival + step]))
        assert np.abs(np.diff(around, axis=0)).max() < 1e-7


def test_waypoints__turns_the_shorter_way():
    first = Waypoint(x=0, y=0, z=1, yaw=3.0, duration=1)
    flight = Waypoints(points=(first, first.model_copy(update={"yaw": -3.0})))
    _, yaws = flight.along(np.linspace(1.0, 2.0, 20))
    assert yaws.max() - yaws.min() == pytest.approx(2 * np.pi - 6.0)


def test_waypoints__start():
    point = Waypoint(x=1, y=2, z=3, yaw=0, duration=1)
    start = Waypoints(points=(point,), start=(4, 5, 6)).along(np.zeros(1))[0]
    np.testing.assert_allclose(start, [[4, 5, 6]])


CURVES = [
    Orbit(centre=(1, 2, 3), radius=1.5, turns=1.5, start_angle_deg=90),
    Spiral(centre=(1, 2), radius=1.5, heights=(0.5, 4.0), turns=3, speed=0.5),
    FigureEight(centre=(2, 0, 1.5), yaw_deg=180, width=2, height=1, loops=2),
]
ALL = [*CURVES, Lawnmower(start=(2, -1, 0.5), yaw_deg=180, width=3, height=1.2)]


@pytest.mark.parametrize("flight", ALL, ids=lambda flight: flight.kind)
def test_flight__speed_is_smooth_and_zero_at_its_ends(flight):
    step = 0.01
    times = np.arange(0.0, flight.duration_s + step, step)
    speeds = np.linalg.norm(np.diff(flight.along(times)[0], axis=0), axis=1) / step
    assert speeds[0] < 0.02
    assert speeds[-1] < 0.02
    assert np.abs(np.diff(speeds)).max() < 0.02  # an acceleration of 2 m/s²
    assert speeds.mean() == pytest.approx(flight.speed, rel=0.01)


@pytest.mark.parametrize("flight", CURVES[:2], ids=lambda flight: flight.kind)
def test_flight__circles_with_the_camera_inwards(flight):
    positions, yaws = flight.along(np.linspace(0.0, flight.duration_s, 50))
    inwards = np.array([1.0, 2.0]) - positions[:, :2]
    np.testing.assert_allclose(np.linalg.norm(inwards, axis=1), 1.5)
    looks = np.column_stack([np.cos(yaws), np.sin(yaws)])
    np.testing.assert_allclose(inwards / 1.5, looks, atol=1e-12)


def test_orbit__starts_and_ends_where_it_says():
    positions, _ = CURVES[0].along(np.array([0.0, CURVES[0].duration_s]))
    np.testing.assert_allclose(positions, [[1.0, 3.5, 3.0], [1.0, 0.5, 3.0]], atol=1e-9)


def test_spiral__climbs():
    heights = CURVES[1].along(np.linspace(0.0, CURVES[1].duration_s, 50))[0][:, 2]
    assert heights[[0, -1]].tolist() == pytest.approx([0.5, 4.0])
    assert (np.diff(heights) >= 0).all()


def test_lawnmower__covers_the_facade_in_rows():
    flight = Lawnmower(start=(2, -1, 0.5), yaw_deg=180, width=3, height=1.2, spacing=0.5)
    positions, yaws = flight.along(np.linspace(0.0, flight.duration_s, 5000))
    np.testing.assert_allclose(yaws, np.pi)
    np.testing.assert_allclose(positions[:, 0], 2.0)
    # The camera looks along -x, so its right is +y.
    assert (positions[:, 1].min(), positions[:, 1].max()) == pytest.approx((-1.0, 2.0))
    rows = np.unique(positions[np.abs(positions[:, 1] - 0.5) < 0.2, 2].round(6))
    np.testing.assert_allclose(rows, [0.5, 0.9, 1.3, 1.7])


def test_lawnmower__downwards():
    flight = Lawnmower(start=(2, -1, 1.7), yaw_deg=0, width=1, height=-0.4)
    positions, _ = flight.along(np.array([0.0, flight.duration_s]))
    np.testing.assert_allclose(positions[:, 2], [1.7, 1.3])


def test_figure_eight__extent():
    positions, _ = CURVES[2].along(np.linspace(0.0, CURVES[2].duration_s, 5000))
    np.testing.assert_allclose(positions.min(axis=0), [2.0, -1.0, 1.0], atol=1e-3)
    np.testing.assert_allclose(positions.max(axis=0), [2.0, 1.0, 2.0], atol=1e-3)


def test_true_path__wobble_has_the_deviations_asked_for():
    orbit = Orbit(centre=(0, 0, 1), radius=1, turns=100, wobble=Wobble(attitude_deg=2.0))
    times = np.linspace(0.0, orbit.duration_s, 40_000)
    still = TruePath(orbit.model_copy(update={"wobble": Wobble(position=0, attitude_deg=0)}), 3)
    path = TruePath(orbit, 3)
    swayed, quaternions = path.poses(times)
    sway = swayed - still.poses(times)[0]
    np.testing.assert_allclose(sway.std(axis=0), 0.01, rtol=0.02)
    np.testing.assert_allclose(sway.mean(axis=0), 0.0, atol=5e-4)
    pitches = [-np.arcsin(matrix_from_quaternion(q)[2, 0]) for q in quaternions[::20]]
    assert np.degrees(np.std(pitches)) == pytest.approx(2.0, rel=0.05)


def test_true_path__wobble_is_smooth_and_seeded():
    times = np.arange(0.0, 20.0, 0.01)
    places = [TruePath(ALL[0], seed).poses(times)[0] for seed in (1, 1, 2)]
    np.testing.assert_array_equal(places[0], places[1])
    assert np.abs(places[0] - places[2]).max() > 0.01
    assert np.abs(np.diff(places[0], n=2, axis=0)).max() / 0.01**2 < 2.0


def test_load_flight__every_kind(write):
    for flight in ALL:
        text = "\n".join(f"{key}: {value}" for key, value in flight.model_dump().items())
        text = text.replace("(", "[").replace(")", "]").replace("None", "null")
        assert load_flight(write(text)) == flight


def test_load_flight__waypoint_file_beside_it(write, tmp_path):
    write(ORIGINAL, "wp.csv")
    flight = load_flight(write("kind: waypoints\nfile: wp.csv\nstart: [0, 0, 1]\n"))
    assert flight == Waypoints(points=read_waypoints(tmp_path / "wp.csv"), start=(0, 0, 1))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("radius: 1\n", "flight.yaml: kind: must be one of waypoints, orbit"),
        ("radius: 1\nkind: orbt\n", "flight.yaml:2: kind: .*did you mean 'orbit'"),
        ("kind: orbit\nradius: -1\ncentre: [0, 0, 1]\n", "flight.yaml:2: radius: .*above 0"),
        ("kind: orbit\nradius: 1\n", "centre: is missing"),
        ("kind: orbit\nradius: 1\ncentre: [0, 0, 1]\nsped: 2\n", "flight.yaml:4: sped: unknown"),
        ("kind: waypoints\n", "needs either points or file"),
        ("kind: waypoints\nfile: none.csv\n", "none.csv: cannot be read"),
        ("kind: waypoints\nfile: a\npoints: [{x: 1, y: 1, z: 1, yaw: 0, duration: 1}]\n", "either"),
    ],
)
def test_load_flight__errors_name_file_and_line(write, text, complaint):
    with pytest.raises(WorldError, match=complaint):
        load_flight(write(text))
