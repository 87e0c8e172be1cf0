"""A whole flight, from a recording that is made up on the spot."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from beamseg_batch import pipeline
from beamseg_batch.config import load_config
from beamseg_batch.errors import ConfigError, NoScansError, RecordingError, ShapeError
from beamseg_batch.geometry import RigidTransform, angle_between_deg, distances_to_line
from beamseg_batch.model import STAGES, PoseJitter, RecordingInfo, Scan, SkippedScan, Trajectory
from beamseg_batch.pipeline import process_flight
from beamseg_batch.recording import open_recording
from tests.rays import pose_at, scan_points

BEAMS = [([1.0, -0.9, 0.9], [1.0, 0.9, 0.9], 0.05), ([1.0, 0.2, 0.35], [1.0, 0.2, 1.8], 0.05)]
CONFIG = load_config("report")
INFO = RecordingInfo(
    paths=(Path("made_up.mcap"),),
    container="made up",
    sha256="0" * 64,
    size_bytes=0,
    start_ns=0,
    end_ns=10**9,
    cloud_topic="/tof_pc",
    pose_topic="/pose",
    sensor_frame="tof",
    body_frame="drone",
    world_frame="mocap",
    T_body_sensor=RigidTransform.identity(),
    extrinsic_source="identity",
)

SAMPLE = Path(__file__).parents[1] / "data" / "samples" / "arena.mcap"


@dataclass
class FakeFlight:
    """A flight that yields what it is given; an exception is raised in its place."""

    items: list
    info: RecordingInfo = INFO
    jitter = PoseJitter()
    recording = SimpleNamespace(name="flight.mcap")

    @property
    def n_clouds(self):
        return len(self.items)

    @property
    def trajectory(self):
        return Trajectory(np.arange(2), np.zeros((2, 3)), np.tile([0.0, 0, 0, 1], (2, 1)))

    def scans(self):
        for item in self.items:
            if isinstance(item, Exception):
                raise item
            yield item


def make_flight_scan(index, beams=BEAMS):
    phase = index / 12
    pose = pose_at([0.15 * np.sin(phase), -0.3 + 0.05 * index, 1.05], yaw_deg=5 * np.cos(phase))
    stamp_ns = 10**9 + index * 10**8
    return Scan(
        index=index,
        stamp_ns=stamp_ns,
        pose_stamp_ns=stamp_ns - 3_000_000,
        T_world_body=pose,
        T_body_sensor=RigidTransform.identity(),
        points=scan_points(pose, beams, np.random.default_rng(index)),
        width=64,
        height=64,
        read_us=10.0,
    )


@pytest.fixture(scope="module")
def scans():
    return [make_flight_scan(index) for index in range(12)]


def skipped(index):
    return SkippedScan(
        index, index, "no_pose_within_gap", f"cloud {index}: nearest pose 0.3 s away"
    )


@dataclass
class Run:
    monkeypatch: pytest.MonkeyPatch

    def __call__(self, items, config=CONFIG, **options):
        self.monkeypatch.setattr(
            pipeline, "open_flight", lambda recording, config: FakeFlight(items)
        )
        return process_flight(None, config, **options)


@pytest.fixture
def run(monkeypatch) -> Callable:
    return Run(monkeypatch)


@dataclass
class Watcher:
    begun: int | None = None
    steps: tuple = ()

    def begin(self, n_clouds):
        assert self.begun is None
        self.begun = n_clouds

    def step(self, n_segments):
        self.steps += (n_segments,)


def content(result):
    """All of a result that must not depend on the clock."""
    return (
        [
            (s.anchor.tolist(), s.direction.tolist(), s.t_min, s.t_max, s.radius, s.n_points,
             s.n_scans, s.pca_coeff, s.pca_eig.tolist(), s.first_seen_ns, s.last_seen_ns)
            for s in result.segments
        ],
        [(i.segment_1, i.segment_2, i.t_1, i.t_2, i.position.tolist(), i.distance, i.angle_deg)
         for i in result.intersections],
        [(s.stamp_ns, s.n_points_raw, s.n_points_filtered, s.n_lines, s.n_segments)
         for s in result.scans],
        result.skipped, result.rejections, result.cloud.tolist(), result.warnings,
    )  # fmt: skip


# --- a flight that goes well ------------------------------------------------------------


def test_process_flight__finds_the_beams_once_and_where_they_cross(run, scans):
    result = run(scans)
    assert len(result.segments) == 2
    found = sorted(result.segments, key=lambda s: abs(s.direction[2]))
    for segment, (start, end, radius) in zip(found, BEAMS, strict=True):
        axis = (np.array(end) - start) / np.linalg.norm(np.array(end) - start)
        assert angle_between_deg(segment.direction, axis) < 4.0
        assert distances_to_line(segment.midpoint[None], np.array(start), axis)[0] < radius + 0.01
        assert segment.n_scans >= 8
        assert 1.1 < segment.length < 1.95
    (touch,) = result.intersections
    np.testing.assert_allclose(touch.position, [0.96, 0.2, 0.9], atol=0.05)
    assert touch.angle_deg == pytest.approx(90.0, abs=5.0)
    (joint,) = result.joints
    assert (joint.segments, touch.joint) == ((0, 1), 0)
    np.testing.assert_allclose(joint.position, touch.position, atol=1e-9)
    assert {0, 1} == {member.segment for member in result.members}
    assert {0, None} == {member.joint_1 for member in result.members}
    assert not result.interrupted
    assert result.warnings == ()
    assert result.recording is INFO
    assert result.config is CONFIG


def test_process_flight__tells_of_every_scan(run, scans):
    result = run(scans)
    assert [record.stamp_ns for record in result.scans] == [scan.stamp_ns for scan in scans]
    walls = [record.wall_us for record in result.scans]
    assert walls == sorted(walls)
    for record in result.scans:
        assert tuple(record.stage_us) == STAGES
        assert record.processing_us == pytest.approx(sum(record.stage_us.values()))
        assert record.stage_us["read"] == 10.0
        assert record.pose_gap_s == pytest.approx(0.003)
        assert record.n_segments in {1, 2}
    assert result.wall_s * 1e6 >= walls[-1]


def test_process_flight__same_flight_twice_gives_the_same(run, scans):
    assert content(run(scans)) == content(run(scans))


def test_process_flight__cloud_is_bounded_and_in_the_world(run, scans):
    config = load_config("report", overrides=["outputs.cloud_points=300"])
    cloud = run(scans, config).cloud
    assert 0 < len(cloud) <= 300
    assert cloud.dtype == np.float32
    np.testing.assert_allclose(cloud[:, 0], 0.97, atol=0.08)
    assert len(run(scans, load_config("report", overrides=["outputs.cloud_points=0"])).cloud) == 0


def test_process_flight__progress_hears_of_every_cloud(run, scans):
    watcher = Watcher()
    run([skipped(0), *scans[:3], skipped(4)], progress=watcher)
    assert watcher.begun == 5
    assert len(watcher.steps) == 5
    assert watcher.steps[0] == 0


# --- scans that cannot be used ----------------------------------------------------------


def test_process_flight__one_missing_pose_does_not_end_processing(run, scans):
    """Fault of the original: the loop returned, and the rest of the flight was lost."""
    whole = run(scans)
    result = run([*scans[:4], skipped(4), *scans[4:]])
    assert result.skipped == {"no_pose_within_gap": 1}
    assert len(result.scans) == len(scans)
    assert content(result)[:2] == content(whole)[:2]
    assert not result.interrupted
    (warning,) = result.warnings
    assert warning == (
        "1 of 13 clouds skipped: 1 no_pose_within_gap; the first: cloud 4: nearest pose 0.3 s away"
    )


def test_process_flight__skips_are_counted_by_reason(run, scans):
    other = SkippedScan(9, 9, "bad_cloud", "no x")
    result = run([skipped(0), other, *scans[:2], skipped(3)])
    assert result.skipped == {"no_pose_within_gap": 2, "bad_cloud": 1}
    assert "3 of 5 clouds skipped: 2 no_pose_within_gap, 1 bad_cloud" in result.warnings[0]


def test_process_flight__raise_when_every_scan_is_skipped(run):
    with pytest.raises(
        NoScansError, match=r"none of 2 clouds is usable: 2 no_pose.*cloud 0: nearest"
    ):
        run([skipped(0), skipped(1)])


def test_process_flight__raise_without_any_cloud(run):
    with pytest.raises(NoScansError, match="/tof_pc"):
        run([])


def test_process_flight__raise_when_all_points_lie_outside_the_window(run, scans):
    config = load_config("report", overrides=["filtering.window.x=[5, 6]"])
    with pytest.raises(NoScansError, match=r"lies in the window x \[5.0, 6.0\].*filtering\.window"):
        run(scans, config)


def test_process_flight__scans_without_a_beam_are_a_result(run, scans):
    """Points in the window but below the floor, or no beam in them, are no error."""
    config = load_config("report", overrides=["filtering.floor_trim_height=9"])
    result = run(scans, config)
    assert result.segments == result.intersections == result.joints == result.members == ()
    assert len(result.scans) == len(scans)


def test_process_flight__scan_of_no_returns_among_others(run, scans):
    blind = replace(scans[3], points=np.full((64, 3), np.nan, np.float32))
    result = run([*scans[:3], blind, *scans[4:]])
    assert len(result.scans) == 12
    assert result.scans[3].n_points_raw == result.scans[3].n_lines == 0
    assert len(result.segments) == 2


# --- interruptions ----------------------------------------------------------------------


def test_process_flight__should_stop_keeps_what_is_known(run, scans):
    asked = []

    def should_stop():
        asked.append(True)
        return len(asked) == 5

    result = run(scans, should_stop=should_stop)
    assert result.interrupted
    assert len(result.scans) == 5
    assert content(result)[:2] == content(run(scans[:5]))[:2]
    assert result.warnings == ("interrupted after 5 of 12 clouds",)


@pytest.mark.parametrize("error", [RecordingError, ConfigError, ShapeError])
def test_process_flight__damage_midway_keeps_what_is_known(run, scans, error):
    result = run([*scans[:6], error("flight.mcap: cut at byte 123"), *scans[6:]])
    assert result.interrupted
    assert len(result.scans) == 6
    assert content(result)[:2] == content(run(scans[:6]))[:2]
    assert result.warnings == ("flight.mcap: cut at byte 123",)


def test_process_flight__damage_before_the_first_scan_is_an_error(run, scans):
    with pytest.raises(RecordingError, match="cut at byte 1"):
        run([skipped(0), RecordingError("cut at byte 1"), *scans])


def test_process_flight__other_errors_are_not_swallowed(run, scans):
    with pytest.raises(ZeroDivisionError):
        run([*scans[:2], ZeroDivisionError("a bug")])


# --- several jobs -----------------------------------------------------------------------


@pytest.mark.parametrize("profile", ["report", "precise"])
def test_process_flight__any_number_of_jobs_gives_the_same(profile):
    config = load_config(profile, overrides=["recording.max_scans=60"])
    watchers = [Watcher(), Watcher(), Watcher()]
    one, *others = (
        process_flight(open_recording(SAMPLE), config, jobs=jobs, progress=watcher)
        for jobs, watcher in zip((1, 2, 3), watchers, strict=True)
    )
    assert len(one.segments) >= 2
    for other in others:
        assert content(other) == content(one)
        assert all(tuple(record.stage_us) == STAGES for record in other.scans)
    assert watchers[0] == watchers[1] == watchers[2]


def test_process_flight__damage_far_on_keeps_the_same_with_several_jobs(run, scans):
    damage = RecordingError("flight.mcap: cannot be read any further")
    assert content(run([*scans[:7], damage], jobs=2)) == content(run([*scans[:7], damage]))


# --- radii that nobody knows -----------------------------------------------------------


def test_process_flight__measures_the_radii(tmp_path):
    settings = ["recording.max_scans=60", "filtering.radii=auto"]
    settings += ["sensor.extrinsic={translation: [0.071, 0.011, 0.04]}"]
    config = load_config(overrides=settings)
    watchers = [Watcher(), Watcher()]
    one, two = (
        process_flight(open_recording(SAMPLE), config, jobs=jobs, progress=watcher)
        for jobs, watcher in zip((1, 2), watchers, strict=True)
    )
    assert len(one.segments) >= 2
    (radius,) = {segment.radius for segment in one.segments}
    assert radius == pytest.approx(0.05, abs=5e-4)
    assert one.config is config
    proposed, measured = one.recording.notes[-2:]
    assert "beams in 60 clouds of the flight seem to have the radii " in proposed
    assert f"the beams have the radii {1e3 * radius:.1f} mm" == measured
    assert content(two) == content(one)
    assert watchers[0] == watchers[1]


def test_process_flight__says_where_no_beam_shows_its_radius():
    empty = SAMPLE.with_name("empty.mcap")
    config = load_config(overrides=["recording.max_scans=20", "filtering.radii=auto"])
    result = process_flight(open_recording(empty), config)
    assert result.segments == ()
    assert result.recording.notes[-2:] == (
        "no beam shows its radius in 20 clouds of the flight: beams of 50.0 mm were looked for",
        "no beam was found",
    )


# --- compiled code ----------------------------------------------------------------------

AFTER_WARM_UP = """
import sys
from beamseg_batch import load_config, open_recording, process_flight
from beamseg_batch.warming import warm_up

def compiled():
    found = {}
    for name, module in list(sys.modules.items()):
        if name.startswith("beamseg_batch") and name.endswith("kernels"):
            for key, value in vars(module).items():
                if hasattr(value, "signatures"):
                    found[name, key] = len(value.signatures)
    return found

config = load_config(sys.argv[2])
warm_up(config)
before = compiled()
process_flight(open_recording(sys.argv[1]), config)
assert compiled() == before, {k: v for k, v in compiled().items() if v != before.get(k)}
assert sum(before.values()) >= 12
"""


@pytest.mark.parametrize("profile", ["report", "precise"])
def test_warm_up__leaves_nothing_to_compile(profile):
    """Otherwise the time of the first scans would be that of the compiler."""
    done = subprocess.run(
        [sys.executable, "-c", AFTER_WARM_UP, str(SAMPLE), profile],
        check=False,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
