"""What to fly again: what is in doubt, where to look from, and the way there."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beamseg_batch.config import FilteringConfig, RunConfig
from beamseg_batch.geometry import RigidTransform, matrix_from_rpy
from beamseg_batch.model import Segment, Trajectory
from beamseg_batch.outputs.fly_again import fly_again_columns, plan_flight
from beamseg_batch.outputs.quality import bent, doubts_of, grade
from beamseg_batch.simulation import read_waypoints
from beamseg_batch.tables import FLY_AGAIN
from tests.outputs.conftest import START_NS, build_flight, make_recording

CLEARANCE = RunConfig().outputs.fly_again.clearance
CONFIG = RunConfig()


def beam(start, end, *, seen=(True, True), sigma=0.0002, sigma_ends=(0.001, 0.001), radius=0.05):
    start, end = np.array(start, dtype=float), np.array(end, dtype=float)
    length = float(np.linalg.norm(end - start))
    covariance = np.diag([sigma**2 / 3] * 3 + [1e-8] * 3)
    return Segment(
        anchor=start,
        direction=(end - start) / length,
        t_min=0.0,
        t_max=length,
        radius=radius,
        n_points=1000,
        pca_coeff=1.0,
        pca_eig=np.array([0.3, 0.001, 0.001]),
        covariance=covariance,
        sigma_ends=np.array(sigma_ends),
        ends_seen=seen,
    )


def flight_of(*beams, path=((-2.0, -1.5, 1.0), (-2.0, 1.5, 1.0)), camera=None, config=CONFIG):
    """Build a flight along a straight path, at most 5 cm from point to point."""
    ends = np.array(path, dtype=float)
    places = ends[0] + np.linspace(0, 1, 80)[:, None] * (ends[1] - ends[0])
    trajectory = Trajectory(
        START_NS + np.arange(80, dtype=np.int64) * 10**8,
        places,
        np.tile([0.0, 0.0, 0.0, 1.0], (80, 1)),
    )
    recording = make_recording(T_body_sensor=camera or RigidTransform.identity())
    flight = build_flight(n_segments=0, n_scans=5, n_cloud=5)
    return dataclasses.replace(
        flight, segments=beams, trajectory=trajectory, recording=recording, config=config
    )


def distances(points, segment):
    """Distances of points from the axis between its ends."""
    t = np.clip((points - segment.anchor) @ segment.direction, segment.t_min, segment.t_max)
    return np.linalg.norm(points - segment.anchor - t[:, None] * segment.direction, axis=1)


POST = beam([-1.0, 0.0, 0.5], [-1.0, 0.0, 2.5], seen=(True, False))


def test_doubts_of__names_what_is_not_good_enough():
    limits = CONFIG.outputs.fly_again
    cases = {
        (): beam([0, 0, 1], [0, 0, 2]),
        ("end 1 not seen",): beam([0, 0, 1], [0, 0, 2], seen=(False, True)),
        ("end 2 uncertain by 30 mm",): beam([0, 0, 1], [0, 0, 2], sigma_ends=(0.001, 0.03)),
        ("axis uncertain by 4.0 mm",): beam(
            [0, 0, 1], [0, 0, 2], sigma=2 * limits.max_sigma_offset
        ),
    }
    for expected, segment in cases.items():
        assert tuple(doubt.text for doubt in doubts_of(segment, CONFIG)) == expected


def test_doubts_of__an_uncertain_direction():
    loose = dataclasses.replace(
        beam([0, 0, 1], [0, 0, 2]),
        anchor=np.array([0.0, 0.0, 1.5]),
        t_min=-0.5,
        t_max=0.5,
        covariance=np.diag([1e-9] * 3 + [1e-4] * 3),
    )
    (doubt,) = doubts_of(loose, CONFIG)
    assert doubt.kind == "axis"
    assert doubt.text == "direction uncertain by 0.99°"


def test_doubts_of__an_end_at_the_floor_trim_is_no_reason_to_fly():
    post = beam([0, 0, 0.31], [0, 0, 2], seen=(False, True))
    (doubt,) = doubts_of(post, CONFIG)
    assert doubt.cut
    assert plan_flight(flight_of(post)).looks == ()
    untrimmed = CONFIG.model_copy(update={"filtering": FilteringConfig(floor_trim="none")})
    assert not doubts_of(post, untrimmed)[0].cut


def test_grade__by_what_is_in_doubt():
    unknown = dataclasses.replace(POST, covariance=np.full((6, 6), np.nan), ends_seen=None)
    unknown = dataclasses.replace(unknown, sigma_ends=np.full(2, np.nan))
    cases = {
        "good": beam([0, 0, 1], [0, 0, 2]),
        "fair": POST,
        "poor": beam([0, 0, 1], [0, 0, 2], sigma=0.01, seen=(False, True)),
        "not judged": unknown,
    }
    for expected, segment in cases.items():
        assert grade(segment, doubts_of(segment, CONFIG)) == expected
    assert grade(beam([0, 0, 0.3], [0, 0, 2], seen=(False, True)), ()) == "good"


@pytest.mark.parametrize(
    ("length", "bow", "sigma", "expected"),
    [
        (2.0, 0.006, 0.001, True),
        (2.0, -0.006, 0.001, True),
        (2.0, 0.006, 0.0021, False),  # within three deviations
        (3.0, 0.0049, 0.001, False),  # below 5 mm and 1/500
        (1.0, 0.003, 0.0005, True),  # above 1/500
        (2.0, 0.02, np.nan, True),
        (2.0, np.nan, 0.001, False),
    ],
)
def test_bent__beyond_doubt_and_more_than_a_builder_accepts(length, bow, sigma, expected):
    columns = {"length": [length], "bow": [bow], "sigma_bow": [sigma]}
    assert bent({name: np.array(values) for name, values in columns.items()}) == [expected]


def test_bent__without_columns_of_the_bow():
    assert bent({"length": np.array([1.0, 2.0])}) == [False, False]


def test_plan_flight__nothing_in_doubt():
    plan = plan_flight(flight_of(beam([0, 0, 1], [0, 0, 2])))
    assert plan.looks == ()
    assert plan.waypoints.shape == (0, 5)
    assert plan.duration_s == 0.0


@pytest.mark.parametrize(
    "camera",
    [
        RigidTransform.identity(),
        RigidTransform(np.eye(3), np.array([0.071, 0.011, 0.04])),
        RigidTransform(matrix_from_rpy(0.0, 0.0, np.pi / 2), np.array([0.0, 0.1, 0.0])),
        RigidTransform(matrix_from_rpy(0.0, 0.35, 0.0), np.zeros(3)),  # looks down
    ],
)
def test_plan_flight__the_end_is_in_the_window_of_the_camera(camera):
    (look,) = plan_flight(flight_of(POST, camera=camera)).looks
    T_world_body = RigidTransform(matrix_from_rpy(0.0, 0.0, look.yaw), look.place)
    T_world_sensor = T_world_body @ camera
    x, y, z = T_world_sensor.rotation.T @ (POST.end_2 - T_world_sensor.translation)
    assert look.reasons == ("end 2 not seen",)
    assert 0.6 < x < 1.5
    assert abs(y) < 1e-9
    assert abs(z) <= 0.3 * x
    np.testing.assert_allclose(look.target, POST.end_2)


def test_plan_flight__an_uncertain_axis_is_seen_at_both_ends_and_between():
    loose = beam([0.0, -1.0, 1.2], [0.0, 1.0, 1.2], sigma=0.01)
    plan = plan_flight(flight_of(loose))
    targets = sorted(look.target.tolist() for look in plan.looks)
    np.testing.assert_allclose(targets, [[0, -1, 1.2], [0, 0, 1.2], [0, 1, 1.2]], atol=1e-12)
    for look in plan.looks:
        view = np.array([np.cos(look.yaw), np.sin(look.yaw), 0.0])
        assert abs(view @ loose.direction) <= 0.8


def clutter():
    rng = np.random.default_rng(7)
    starts = rng.uniform([-1.5, -2.0, 0.5], [1.0, 2.0, 2.5], (20, 3))
    steps = rng.normal(size=(20, 3))
    steps *= (rng.uniform(0.5, 1.5, 20) / np.linalg.norm(steps, axis=1))[:, None]
    return [
        beam(start, start + step, seen=(number % 3 > 0, True))
        for number, (start, step) in enumerate(zip(starts, steps, strict=True))
    ]


def test_plan_flight__keeps_its_distance_and_flies_clear_ways():
    beams = clutter()
    flight = flight_of(*beams, path=((-2.6, -2.5, 1.2), (-2.6, 2.5, 1.2)))
    plan = plan_flight(flight)
    placed = [look for look in plan.looks if look.place is not None]
    assert len(placed) >= 2
    for look in placed:
        for segment in beams:
            gap = distances(look.place[None], segment)[0] - segment.radius
            assert gap >= CLEARANCE - 1e-9
    here = flight.trajectory.positions[0]
    for place in plan.waypoints[:, :3]:
        way = here + np.linspace(0, 1, 200)[:, None] * (place - here)
        for segment in beams:
            # Sampled every 20 cm, so that a way may pass a little closer.
            assert (distances(way, segment) - segment.radius).min() >= CLEARANCE - 0.02
        here = place


def test_plan_flight__a_target_without_a_free_place_is_listed_last():
    cage = [
        beam([x, y, 0.2], [x, y, 3.0])
        for x in np.arange(-3.0, 3.1, 0.5)
        for y in np.arange(-3.0, 3.1, 0.5)
    ]
    plan = plan_flight(flight_of(POST, *cage))
    assert [look.place for look in plan.looks] == [None]
    assert len(plan.waypoints) == 0


def test_plan_flight__no_more_than_can_be_flown(monkeypatch):
    monkeypatch.setattr("beamseg_batch.outputs.fly_again.MAX_LOOKS", 2)
    posts = [beam([-1, y, 0.6], [-1, y, 2], seen=(True, False)) for y in (-1.0, 0.0, 1.0)]
    plan = plan_flight(flight_of(*posts))
    assert len(plan.looks) == 2
    assert plan.total == 3


def test_plan_flight__looks_from_nearby_whatever_the_window():
    window = FilteringConfig.model_validate({"window": {"x": [-1e6, 1e6]}}).window
    filtering = CONFIG.filtering.model_copy(update={"window": window})
    config = CONFIG.model_copy(update={"filtering": filtering})
    (look,) = plan_flight(flight_of(POST, config=config)).looks
    assert np.linalg.norm(look.place - POST.end_2) < 2.5


def test_plan_flight__does_not_look_along_ways_without_end():
    (look,) = plan_flight(flight_of(POST, path=((-1e7, 0, 1), (1e7, 5e6, 1)))).looks
    assert look.place is None


def test_plan_flight__without_a_path():
    none = Trajectory(np.empty(0, dtype=np.int64), np.empty((0, 3)), np.empty((0, 4)))
    plan = plan_flight(dataclasses.replace(flight_of(POST), trajectory=none))
    assert len(plan.looks) == 1


def test_plan_flight__stays_at_each_place():
    limits = CONFIG.outputs.fly_again
    plan = plan_flight(flight_of(POST))
    last, before = plan.waypoints[-1], plan.waypoints[-2]
    np.testing.assert_allclose(last[:4], before[:4])
    assert last[4] == limits.stay_s
    assert plan.duration_s == pytest.approx(plan.waypoints[:, 4].sum())


def test_fly_again_columns__simulate_reads_them(tmp_path):
    plan = plan_flight(flight_of(POST))
    file = tmp_path / "fly_again.csv"
    file.write_text(FLY_AGAIN.encode(fly_again_columns(plan)))
    assert file.read_text().startswith("x,y,z,yaw,duration\n")
    read = [[p.x, p.y, p.z, p.yaw, p.duration] for p in read_waypoints(file)]
    np.testing.assert_allclose(read, plan.waypoints, atol=0.051)
