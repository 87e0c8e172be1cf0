"""The samples, from file to tables: what the project promises of its `report` profile."""

from __future__ import annotations

import runpy
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from beamseg_batch import load_config, open_recording, process_flight, read_run, write_run
from beamseg_batch.cli.main import beamseg
from beamseg_batch.recording import open_flight
from tests.truth import ends_of, match_beams, read_beams, read_joints

SAMPLES = Path(__file__).parents[1] / "data" / "samples"
BEAMS = read_beams(SAMPLES / "arena_truth.csv")
JOINTS = read_joints(SAMPLES / "arena_truth_joints.csv")
CAMERA = ("--extrinsic", "0.071,0.011,0.04")
NO_REPORT = ("--set", "outputs.report=false")
DETERMINISTIC = ("segments.csv", "intersections.csv", "joints.csv", "members.csv")

RECORDINGS = ("arena.mcap", "arena.bag", "tower_panel.mcap", "empty.mcap")
TRUTH = ("truth.csv", "truth_joints.csv", "true_poses.tum", "scene.json")
make_sample = runpy.run_path(str(SAMPLES / "make_samples.py"))["make_sample"]

Run = Callable[..., Path]


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Process a sample by the command line, once for the same arguments; give the folder."""
    base = tmp_path_factory.mktemp("samples")
    done: dict[tuple[str, ...], Path] = {}

    def processed(*arguments: str, sample: str = "arena.mcap") -> Path:
        key = (sample, *arguments)
        if key not in done:
            folder = base / f"run{len(done)}"
            command = ["run", str(SAMPLES / sample), "-o", str(folder), "-q", *arguments]
            result = CliRunner().invoke(beamseg, command)
            assert result.exit_code == 0, result.output
            assert result.output == ""
            done[key] = folder
        return done[key]

    return processed


@pytest.fixture(scope="session")
def placed(run: Run) -> Path:
    """Give the run that knows where the camera sits on the drone."""
    return run("--profile", "report", *CAMERA)


@pytest.fixture(scope="session")
def unplaced(run: Run) -> Path:
    """Give the run that takes the drone's place for the camera's, as the report does."""
    return run("--profile", "report", *NO_REPORT)


def segments_of(folder: Path) -> np.ndarray:
    return ends_of(pd.read_csv(folder / "segments.csv"))


def test_sample__finds_every_beam_once_and_nothing_else(placed):
    segments = segments_of(placed)
    assert len(segments) == len(BEAMS) == 7
    assert [match.beam for match in match_beams(BEAMS, segments)] == list(range(7))


def test_sample__axes_are_where_the_beams_are(placed):
    matches = match_beams(BEAMS, segments_of(placed))
    assert max(match.offset_m for match in matches) <= 0.05
    assert max(match.angle_deg for match in matches) <= 1.0
    assert min(match.overlap for match in matches) >= 0.9


@pytest.mark.parametrize("name", ["joints", "intersections"])
def test_sample__finds_both_joints_and_no_other(placed, name):
    found = pd.read_csv(placed / f"{name}.csv")
    distances = np.linalg.norm(found[["x", "y", "z"]].to_numpy()[:, None] - JOINTS[None, :], axis=2)
    assert distances.shape == (2, 2)
    assert distances.min(axis=0).max() <= 0.1
    assert distances.min(axis=1).max() <= 0.1


NOT_OF_ALL = ("sigma_", "measured_", "end_", "joint_", "bow", "section", "width", "height", "web",
              "flange", "roll_")  # fmt: skip


def test_sample__has_no_gaps_in_its_tables(placed):
    """Other than what the profile `report` does not know, free ends, and sizes of sections."""
    for name in ("segments", "intersections", "joints", "members", "processing_time"):
        table = pd.read_csv(placed / f"{name}.csv")
        table = table[[column for column in table if not column.startswith(NOT_OF_ALL)]]
        assert not table.isna().to_numpy().any()
        assert np.isfinite(table.select_dtypes("number").to_numpy()).all()


def test_sample__uses_every_scan(placed):
    counts = read_run(placed).summary["counts"]
    assert (counts["clouds"], counts["processed"], counts["skipped"]) == (100, 100, 0)


def test_sample__without_the_cameras_place_axes_are_off_by_it(unplaced):
    """The report's figure 13 has 0.098 to 0.137 m."""
    matches = match_beams(BEAMS, segments_of(unplaced))
    assert len(matches) == len(segments_of(unplaced)) == 7
    offsets = [match.offset_m for match in matches]
    assert min(offsets) >= 0.09
    assert max(offsets) <= 0.14
    assert np.median(offsets) == pytest.approx(0.11, abs=0.01)


def test_sample__precise_profile(run):
    segments = segments_of(run("--profile", "precise", *CAMERA, *NO_REPORT))
    assert len(segments) == 7
    matches = match_beams(BEAMS, segments)
    assert len(matches) == 7
    assert max(match.offset_m for match in matches) <= 0.05


def test_sample__ros1_and_ros2_give_the_same_tables(run, placed):
    other = run("--profile", "report", *CAMERA, *NO_REPORT, sample="arena.bag")
    for name in DETERMINISTIC:
        assert (placed / name).read_bytes() == (other / name).read_bytes()
    one, two = read_run(placed).summary, read_run(other).summary
    assert one["results_sha256"] == two["results_sha256"]
    assert one["recording"]["container"] != two["recording"]["container"]


def test_sample__api_and_command_line_give_the_same_tables(placed, tmp_path):
    """So does the same flight twice: these are two runs."""
    config = load_config(
        "report", overrides=["sensor.extrinsic={translation: [0.071, 0.011, 0.04]}"]
    )
    recording = open_recording(SAMPLES / "arena.mcap")
    result = process_flight(recording, config)
    assert (len(result.segments), len(result.intersections)) == (7, 2)
    assert not result.interrupted
    write_run(result, tmp_path / "run")
    for name in (*DETERMINISTIC, "config.yaml"):
        assert (tmp_path / "run" / name).read_bytes() == (placed / name).read_bytes()
    back = read_run(tmp_path / "run")
    assert back.tables["segments"]["length"].sum() == pytest.approx(
        sum(segment.length for segment in result.segments)
    )


@pytest.mark.parametrize(
    "setting", ["detection.screening.gap=reject", "filtering.floor_trim=segment"]
)
def test_sample__literal_reading_of_the_report(run, setting):
    segments = segments_of(run("--profile", "report", *CAMERA, *NO_REPORT, "--set", setting))
    matches = match_beams(BEAMS, segments)
    assert 6 <= len(matches) == len(segments)
    assert max(match.offset_m for match in matches) <= 0.05


def test_sample__script_for_the_original_nodes_files(placed):
    """What a script does that was written for the files of the original node."""
    segments = pd.read_csv(placed / "segments.csv")
    assert segments.columns[:9].tolist() == [
        "segment", "a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "t_min", "t_max",
    ]  # fmt: skip
    anchor = segments[["a_x", "a_y", "a_z"]].to_numpy()
    direction = segments[["b_x", "b_y", "b_z"]].to_numpy()
    start = anchor + segments[["t_min"]].to_numpy() * direction
    end = anchor + segments[["t_max"]].to_numpy() * direction
    ends = np.stack([start, end], axis=1)
    assert np.linalg.norm(direction, axis=1) == pytest.approx(1.0)
    assert ends == pytest.approx(ends_of(segments))
    assert len(match_beams(BEAMS, ends)) == 7

    intersections = pd.read_csv(placed / "intersections.csv")
    assert intersections.columns[:4].tolist() == ["seg1", "t1", "seg2", "t2"]
    for row in intersections.itertuples():
        first = anchor[row.seg1] + row.t1 * direction[row.seg1]
        second = anchor[row.seg2] + row.t2 * direction[row.seg2]
        assert np.linalg.norm(first - second) == pytest.approx(row.distance)
        assert (first + second) / 2 == pytest.approx(np.array([row.x, row.y, row.z]))

    times = pd.read_csv(placed / "processing_time.csv")
    names = ["wall_time", "processing_time", "seg_vec_size", "nblines"]
    assert times.columns[:4].tolist() == names
    assert all(pd.api.types.is_integer_dtype(times[name]) for name in names)
    assert times["wall_time"].is_monotonic_increasing
    assert times["seg_vec_size"].iloc[-1] == 7
    wall_us = read_run(placed).summary["totals"]["wall_s"] * 1e6
    assert times["processing_time"].sum() <= times["wall_time"].iloc[-1] <= wall_us


def test_sample__report_opens_offline(placed):
    page = (placed / "report.html").read_text(encoding="utf-8")
    assert len(page) < 8e6
    assert "<script src=" not in page
    assert "arena.mcap" in page


# How the samples are made


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fly all samples anew."""
    folder = tmp_path_factory.mktemp("flown")
    for name in RECORDINGS:
        make_sample(name, folder)
    return folder


def scans_of(recording: Path) -> list:
    return list(open_flight(open_recording(recording), load_config("report")).scans())


def test_samples__take_up_less_than_12_mb():
    assert sum(file.stat().st_size for file in SAMPLES.rglob("*") if file.is_file()) < 12e6


def test_samples__whole_with_their_truth(flown):
    beside = {f"{Path(name).stem}_{truth}" for name in RECORDINGS for truth in TRUTH}
    made = {file.name for file in flown.iterdir()}
    assert made == {*RECORDINGS, *beside}
    assert made <= {file.name for file in SAMPLES.iterdir()}


@pytest.mark.parametrize("name", RECORDINGS)
def test_make_sample__flies_what_is_here(flown, name):
    """To the last bits, which another mathematical library may round otherwise."""
    ours, theirs = scans_of(SAMPLES / name), scans_of(flown / name)
    assert len(ours) == len(theirs) > 50
    for one, other in zip(ours, theirs, strict=True):
        assert (one.stamp_ns, one.pose_stamp_ns) == (other.stamp_ns, other.pose_stamp_ns)
        np.testing.assert_allclose(one.points, other.points, atol=1e-5)
        np.testing.assert_allclose(
            one.T_world_body.translation, other.T_world_body.translation, atol=1e-9
        )


@pytest.mark.parametrize("table", ["truth.csv", "truth_joints.csv"])
@pytest.mark.parametrize("sample", ["arena", "tower_panel", "empty"])
def test_make_sample__knows_the_truth_that_is_here(flown, sample, table):
    ours, theirs = (pd.read_csv(folder / f"{sample}_{table}") for folder in (SAMPLES, flown))
    pd.testing.assert_frame_equal(ours, theirs, check_exact=False, atol=2e-6)


@pytest.mark.parametrize("name", ["arena.bag", "empty.mcap"])
def test_make_sample__the_same_bytes_again(flown, tmp_path, name):
    make_sample(name, tmp_path)
    for file in tmp_path.iterdir():
        assert file.read_bytes() == (flown / file.name).read_bytes(), file.name
