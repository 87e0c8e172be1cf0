"""`beamseg run`: what it writes, where, and what it says."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from beamseg_batch import read_run
from tests.cli.conftest import LIGHT
from tests.evaluation.structures import truth_of, write_truth

FILES = {
    "config.yaml",
    "fly_again.csv",
    "intersections.csv",
    "joints.csv",
    "members.csv",
    "processing_time.csv",
    "report.html",
    "segments.csv",
    "structure.npz",
    "summary.json",
}


def names_in(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_run__writes_all_files(ok, flight, here):
    ok("run", flight, "-o", "out")
    assert names_in(here) == {"out"}
    assert names_in(here / "out") == FILES


def test_run__finds_the_beam(ok, flight):
    ok("run", flight, "-o", "out", *LIGHT)
    (beam,) = read_run(Path("out")).segments
    assert beam.length == pytest.approx(1.6, abs=0.05)
    assert abs(beam.direction[1]) == pytest.approx(1.0, abs=1e-3)
    assert beam.midpoint == pytest.approx([1.0, 0.0, 1.0], abs=0.05)
    assert beam.n_scans == 6


def test_run__any_number_of_jobs_writes_the_same(ok, flight):
    for jobs in (1, 2):
        ok("run", flight, "-o", f"out{jobs}", "--jobs", jobs, *LIGHT)
    one, two = (read_run(Path(f"out{jobs}")) for jobs in (1, 2))
    assert one.summary["results_sha256"] == two.summary["results_sha256"]
    for name in ("segments.csv", "intersections.csv", "config.yaml"):
        assert (one.folder / name).read_bytes() == (two.folder / name).read_bytes()


def test_run__sums_up_on_stdout_and_logs_on_stderr(ok, flight):
    result = ok("run", flight, "-o", "out")
    assert [line.split()[0] for line in result.stdout.splitlines()] == [
        "beams",
        "joints",
        "scans",
        "time",
        "report",
    ]
    assert "6 used, 0 skipped" in result.stdout
    assert "out/report.html" in result.stdout
    reading, note, rows = result.stderr.splitlines()
    assert reading == f"beamseg: reading {flight} (MCAP (ROS 2))"
    assert note.startswith("beamseg: the recording does not say where the camera sits")
    assert rows.startswith("beamseg: the clouds have no rows and columns")


def test_run__truth_is_told_of_in_the_report(ok, flight, here):
    beam = np.array([[[1.05, -0.8, 1.0], [1.05, 0.8, 1.0]]])
    truth = write_truth(here / "truth.csv", truth_of(beam))
    result = ok("run", flight, "-o", "out", "--truth", truth)
    page = (here / "out" / "report.html").read_text()
    assert "Against the truth" in page
    assert "1 of 1 members" in page
    assert len(result.stdout.splitlines()) == 5
    assert "Against the truth" not in (here / "out" / "summary.json").read_text()


def test_run__broken_truth_is_found_before_the_work(call, flight, here):
    (here / "truth.csv").write_text("id,x1\n")
    result = call("run", flight, "-o", "out", "--truth", "truth.csv")
    assert result.exit_code != 0
    assert "truth.csv: has no column" in result.stderr
    assert not (here / "out").exists()


def test_run__names_the_waypoints_where_something_is_to_be_flown_again(ok, flight, here):
    result = ok(
        "run", flight, "-o", "out", "--set", "outputs.fly_again.max_sigma_offset=1e-9", *LIGHT
    )
    assert result.stdout.splitlines()[0].endswith("; to fly again: fly_again.csv")
    assert (here / "out" / "fly_again.csv").read_text().startswith("x,y,z,yaw,duration\n")


def test_run__names_the_folder_when_there_is_no_report(ok, flight):
    result = ok("run", flight, "-o", "out", "--set", "outputs.report=false")
    assert result.stdout.splitlines()[-1].split() == ["report", "out"]
    assert names_in(Path("out")) == FILES - {"report.html"}


def test_run__quiet_says_nothing(ok, flight):
    result = ok("run", flight, "-o", "out", "-q", *LIGHT)
    assert result.output == ""


def test_run__verbosity_of_the_configuration(ok, flight):
    assert ok("run", flight, "-o", "a", "--set", "outputs.verbosity=0", *LIGHT).output == ""
    detailed = ok("run", flight, "-o", "b", "--set", "outputs.verbosity=2", *LIGHT)
    assert detailed.stderr.count("beamseg: scan ") == 6


def test_run__verbose_tells_of_every_scan(ok, flight):
    assert ok("run", flight, "-o", "out", "-v", *LIGHT).stderr.count("beamseg: scan ") == 6


@pytest.mark.parametrize("extra", [[], ["-q"], ["-v"]])
def test_run__json_is_all_there_is_on_stdout(ok, flight, extra):
    result = ok("run", flight, "-o", "out", "--json", *extra, *LIGHT)
    assert json.loads(result.stdout) == json.loads(Path("out/summary.json").read_bytes())


def test_run__default_folder_is_named_after_the_file(ok, flight, here):
    ok("run", flight, *LIGHT)
    assert names_in(here) == {"flight"}


def test_run__default_folder_is_not_the_ros2_bag(ok, ros2_bag, here):
    shutil.copytree(ros2_bag, "flight")
    before = names_in(here / "flight")
    ok("run", "flight/", *LIGHT)
    assert names_in(here) == {"flight", "flight_beams"}
    assert names_in(here / "flight") == before


def test_run__default_folder_is_not_the_folder_of_the_file(ok, ros2_bag, here):
    shutil.copytree(ros2_bag, "flight")
    before = names_in(here / "flight")
    ok("run", "flight/flight.db3", *LIGHT)
    assert names_in(here) == {"flight", "flight_beams"}
    assert names_in(here / "flight") == before


def test_run__default_folder_of_a_file_without_suffix(ok, flight, here):
    shutil.copy(flight, "log")
    ok("run", "log", *LIGHT)
    assert names_in(here) == {"log", "log_beams"}


def test_run__default_folder_of_a_ros2_bag_elsewhere(ok, ros2_bag, here):
    ok("run", ros2_bag, *LIGHT)
    assert names_in(here) == {"flight"}


def test_run__working_folder_is_elsewhere(ok, flight, here, monkeypatch):
    (here / "a" / "b").mkdir(parents=True)
    shutil.copy(flight, here / "a" / "log.mcap")
    monkeypatch.chdir(here / "a" / "b")
    ok("run", "../log.mcap", *LIGHT)
    ok("run", "../log.mcap", "-o", "../out", *LIGHT)
    assert names_in(here / "a") == {"b", "log.mcap", "out"}
    assert names_in(here / "a" / "b") == {"log"}


def test_run__output_folder_of_the_configuration(ok, flight, here):
    Path("c.yaml").write_text("outputs: {path: results/one}\n", encoding="utf-8")
    ok("run", flight, "-c", "c.yaml")
    assert names_in(here / "results" / "one") == FILES
    ok("run", flight, "-c", "c.yaml", "-o", "two")
    assert names_in(here) == {"c.yaml", "results", "two"}


def test_run__tilde_in_the_configuration_is_a_name(ok, flight, here):
    ok("run", flight, "--set", "outputs.path=~/out")
    assert names_in(here / "~" / "out") == FILES


def test_run__configuration_of_the_original_node(ok, flight, here):
    original = Path(__file__).parents[1] / "data" / "original_config.yaml"
    result = ok("run", flight, "-c", original, "--json", "--set", "granularity=4")
    summary = json.loads(result.stdout)
    assert summary["profile"] == "report"
    assert summary["configuration"]["detection"]["screening"]["min_pca_coeff"] == 0.995
    assert names_in(here) == {summary["configuration"]["outputs"]["path"]}


@pytest.mark.parametrize(
    "name", ["two words.mcap", "Übung №1 日本.mcap", "-dash.mcap", "a'b\"c.mcap"]
)
def test_run__odd_file_names(ok, flight, here, name):
    shutil.copy(flight, here / name)
    result = ok("run", "-o", f"out of {name}", "--", name)
    assert f"out of {name}/report.html" in result.stdout
    assert name in result.stderr
    summary = json.loads((here / f"out of {name}" / "summary.json").read_bytes())
    assert summary["recording"]["files"] == [name]


def test_run__default_folder_of_an_odd_file_name(ok, flight, here):
    shutil.copy(flight, "Übung 1.2.mcap")
    ok("run", "Übung 1.2.mcap", *LIGHT)
    assert names_in(here) == {"Übung 1.2.mcap", "Übung 1.2"}


def test_run__several_paths_are_one_flight(ok, flight, ros2_bag):
    one = json.loads(ok("run", flight, "-o", "one", "--json", *LIGHT).stdout)
    two = json.loads(ok("run", flight, ros2_bag, "-o", "two", "--json", *LIGHT).stdout)
    assert two["counts"]["clouds"] == 2 * one["counts"]["clouds"]
    assert two["recording"]["files"] == ["flight.mcap", "flight"]


def test_run__extrinsic_moves_the_beam(ok, flight):
    ok("run", flight, "-o", "a", *LIGHT)
    ok("run", flight, "-o", "b", "--extrinsic", "0.25, -0.5, 0.125", *LIGHT)
    ok("run", flight, "-o", "c", "--extrinsic", "0,0,0,0,0,90", *LIGHT)
    (plain,), (moved,), (turned,) = (read_run(Path(name)).segments for name in "abc")
    assert moved.midpoint - plain.midpoint == pytest.approx([0.25, -0.5, 0.125], abs=1e-6)
    assert abs(turned.direction[0]) == pytest.approx(1.0, abs=1e-3)


def test_run__effective_configuration_can_be_used_again(ok, flight):
    ok("run", flight, "-o", "a", "--profile", "report", "--set", "filtering.radii=[0.06, 0.04]")
    ok("run", flight, "-o", "b", "-c", "a/config.yaml")
    for name in ("config.yaml", "segments.csv", "intersections.csv"):
        assert Path("a", name).read_bytes() == Path("b", name).read_bytes()


def test_run__skipped_clouds_are_a_warning(ok, flight):
    result = ok(
        "run",
        flight,
        "-o",
        "out",
        "--set",
        "matching.max_gap_s=0.01",
        "--set",
        "recording.time_offset_s=0.485",
    )
    assert "beamseg: warning: " in result.stderr
    assert "of 6 clouds skipped: " in result.stderr
    assert "matching.max_gap_s" in result.stderr


def test_run__damage_further_on_leaves_a_partial_run(call, flight, here, monkeypatch):
    from beamseg_batch.errors import RecordingError
    from beamseg_batch.recording import Flight

    scans = Flight.scans

    def broken(self):
        for scan in scans(self):
            if scan.index == 3:
                raise RecordingError("flight.mcap: cannot be read any further")
            yield scan

    monkeypatch.setattr(Flight, "scans", broken)
    result = call("run", flight, "-o", "out")
    assert result.exit_code == 1
    assert "warning: incomplete: flight.mcap: cannot be read any further" in result.stderr
    assert "out.partial" in result.stderr
    assert names_in(here) == {"out.partial"}
    assert read_run(here / "out.partial").summary["counts"]["processed"] == 3
