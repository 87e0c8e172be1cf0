"""A run on disk says what the result said."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from beamseg_batch import section as outlines
from beamseg_batch.config import OutputConfig, RunConfig, load_config
from beamseg_batch.errors import OutputError, RunError
from beamseg_batch.model import CrossSection, across_of
from beamseg_batch.outputs import check_output, planned_files, read_run, write_run
from beamseg_batch.pages.rendering import Html, Section
from beamseg_batch.tables import TABLES


def assert_same(read, written):
    assert len(read) == len(written)
    for one, other in zip(read, written, strict=True):
        for name, value in vars(other).items():
            if isinstance(value, CrossSection):
                assert_same_section(getattr(one, name), value)
            else:
                np.testing.assert_array_equal(getattr(one, name), value, err_msg=name)


def assert_same_section(one, other):
    assert (one.shape, one.size, one.name) == (other.shape, other.size, other.name)
    np.testing.assert_array_equal(one.confidence, other.confidence)
    np.testing.assert_allclose(one.across, other.across, atol=1e-12)


def test_write_run__writes_what_was_planned(tmp_path, flight):
    run = write_run(flight, tmp_path / "out")
    files = [
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
    ]
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == files
    assert list(run.files) == list(planned_files(flight.config)) == run.summary["files"] == files
    assert run.report == tmp_path / "out" / "report.html"


def test_write_run__no_waypoints_where_nothing_is_to_be_flown_again(tmp_path, make_flight):
    run = write_run(make_flight(n_segments=0), tmp_path / "out")
    assert "fly_again.csv" not in run.files
    assert run.summary["files"] == list(run.files)
    assert not (tmp_path / "out" / "fly_again.csv").exists()


def test_write_run__more_sections_are_made_from_the_tables(tmp_path, flight):
    def more(tables):
        assert (tables / "segments.csv").is_file()
        assert not (tmp_path / "out").exists()
        return [Section("more", "More of it", Html(""), {})]

    run = write_run(flight, tmp_path / "out", more=more)
    assert "More of it" in run.report.read_text()


def test_write_run__without_report(tmp_path, flight_without_report):
    run = write_run(flight_without_report, tmp_path / "out")
    assert run.report is None
    assert not (tmp_path / "out" / "report.html").exists()


def test_write_run__configuration_loads_again(tmp_path, flight_without_report):
    write_run(flight_without_report, tmp_path / "out")
    assert load_config(file=tmp_path / "out" / "config.yaml") == flight_without_report.config


def test_write_run__deterministic_tables_have_the_same_bytes(tmp_path, make_flight):
    config = RunConfig(outputs=OutputConfig(report=False))
    summaries = [
        write_run(make_flight(config=config, wall_s=wall_s), tmp_path / str(wall_s)).summary
        for wall_s in (1.0, 2.0)
    ]
    assert summaries[0]["results_sha256"] == summaries[1]["results_sha256"]
    for file in (*(table.file_name for table in TABLES), "structure.npz"):
        first, second = (tmp_path / name / file for name in ("1.0", "2.0"))
        assert first.read_bytes() == second.read_bytes()


def test_write_run__existing_run(tmp_path, flight_without_report):
    write_run(flight_without_report, tmp_path / "out")
    with pytest.raises(OutputError, match="already holds a run"):
        check_output(tmp_path / "out", flight_without_report.config)
    with pytest.raises(OutputError, match="already holds a run"):
        write_run(flight_without_report, tmp_path / "out")
    check_output(tmp_path / "out", flight_without_report.config, overwrite=True)
    write_run(flight_without_report, tmp_path / "out", overwrite=True)


def test_check_output__report_of_the_users_own(tmp_path):
    (tmp_path / "report.html").write_text("mine")
    with pytest.raises(OutputError, match=r"report\.html is in the way"):
        check_output(tmp_path, RunConfig(), overwrite=True)
    check_output(tmp_path, RunConfig(outputs=OutputConfig(report=False)), overwrite=True)


def test_read_run__equals_what_was_written(tmp_path, flight_without_report):
    written = write_run(flight_without_report, tmp_path / "out")
    run = read_run(tmp_path / "out")
    assert run.summary == written.summary
    assert_same(run.segments, flight_without_report.segments)
    assert_same(run.intersections, flight_without_report.intersections)
    assert_same(run.joints, flight_without_report.joints)
    assert run.members == flight_without_report.members
    assert {name: len(table) for name, table in run.tables.items()} == {
        "segments": 7,
        "intersections": 2,
        "joints": 2,
        "members": 9,
        "processing_time": 30,
    }
    scan = run.tables["processing_time"].iloc[3]
    assert scan["stamp_ns"] == flight_without_report.scans[3].stamp_ns
    assert scan["wall_time"] == round(flight_without_report.scans[3].wall_us)


def test_read_run__empty(tmp_path, empty_flight):
    write_run(empty_flight, tmp_path / "out")
    run = read_run(tmp_path / "out")
    assert run.segments == run.intersections == run.joints == run.members == ()
    assert run.tables["segments"].empty


def test_read_run__stamps_of_another_clock(tmp_path, make_flight, describe_recording):
    recording = describe_recording(start_ns=5 * 10**9, end_ns=25 * 10**9)
    flight = make_flight(recording=recording, config=RunConfig(outputs=OutputConfig(report=False)))
    write_run(flight, tmp_path / "out")
    run = read_run(tmp_path / "out")
    assert run.summary["recording"]["time_origin_ns"] == flight.scans[0].stamp_ns
    assert run.tables["segments"]["first_seen_s"].between(0.0, 1.0).all()
    assert_same(run.segments, flight.segments)


def test_tables__script_for_the_original_files(tmp_path, flight_without_report):
    write_run(flight_without_report, tmp_path / "out")
    segments = pd.read_csv(tmp_path / "out" / "segments.csv")
    intersections = pd.read_csv(tmp_path / "out" / "intersections.csv")
    times = pd.read_csv(tmp_path / "out" / "processing_time.csv")

    anchors = segments[["a_x", "a_y", "a_z"]].to_numpy()
    directions = segments[["b_x", "b_y", "b_z"]].to_numpy()
    first = anchors + segments[["t_min"]].to_numpy() * directions
    last = anchors + segments[["t_max"]].to_numpy() * directions
    np.testing.assert_allclose(first, segments[["x1", "y1", "z1"]].to_numpy(), atol=1e-12)
    np.testing.assert_allclose(last, segments[["x2", "y2", "z2"]].to_numpy(), atol=1e-12)

    beam = segments.set_index("segment").loc[intersections["seg1"].iloc[1]]
    assert beam["t_min"] <= intersections["t1"].iloc[1] <= beam["t_max"]
    assert set(intersections["seg2"]) <= set(segments["segment"])

    by_lines = times.groupby("nblines")["processing_time"].median() / 1e6
    assert by_lines.between(0.0005, 0.01).all()
    assert times["wall_time"].is_monotonic_increasing
    assert times[["wall_time", "processing_time", "seg_vec_size"]].dtypes.eq("int64").all()


def test_read_run__no_run(tmp_path):
    with pytest.raises(RunError, match=r"holds no run: there is no summary\.json") as caught:
        read_run(tmp_path)
    assert caught.value.exit_code == 1
    with pytest.raises(RunError, match="is no folder of a run"):
        read_run(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("summary.json", b"{", "is not valid JSON"),
        ("summary.json", b"[]", "is not the summary of a run"),
        ("summary.json", b'{"schema_version": 99}', "has schema_version 99"),
        ("summary.json", b'{"schema_version": 1, "recording": 7}', "has no recording"),
        ("summary.json", b"\xff", "is not UTF-8 text"),
        ("segments.csv", b"segment\n", "has no column a_x"),
        ("processing_time.csv", b"", "is empty"),
        ("intersections.csv", None, "cannot be read"),
        ("joints.csv", b"joint,x\n", "has no column y"),
        ("members.csv", None, "cannot be read"),
    ],
)
def test_read_run__damaged(tmp_path, flight_without_report, name, content, reason):
    folder = write_run(flight_without_report, tmp_path / "out").folder
    (folder / name).unlink()
    if content is not None:
        (folder / name).write_bytes(content)
    with pytest.raises(RunError, match=f"{name}: {reason}"):
        read_run(folder)


def test_read_run__what_is_not_known_stays_unknown(tmp_path, make_flight):
    flight = make_flight(config=RunConfig(outputs=OutputConfig(report=False)))
    unknown = dict.fromkeys(("measured_radius", "sigma_radius", "sigma_bow"), np.nan)
    unknown["covariance"] = np.full((6, 6), np.nan)
    segments = tuple(
        replace(
            one,
            **unknown,
            sigma_ends=np.full(2, np.nan),
            ends_seen=None,
            bow_vector=np.full(3, np.nan),
        )
        for one in flight.segments
    )
    joints = tuple(replace(one, covariance=np.full((3, 3), np.nan)) for one in flight.joints)
    folder = write_run(replace(flight, segments=segments, joints=joints), tmp_path / "out").folder
    run = read_run(folder)
    assert_same(run.segments, segments)
    assert_same(run.joints, joints)
    sigmas = [name for name in run.tables["segments"] if name.startswith(("sigma", "end_"))]
    assert len(sigmas) == 8
    assert run.tables["segments"][sigmas].isna().all(axis=None)


def test_read_run__sections_come_back(tmp_path, flight_without_report):
    first, second, *rest = flight_without_report.segments
    size = outlines.Section("i", 0.1, 0.12, 0.008, 0.01)
    angle = CrossSection("i", size, across_of(35.0, first.direction), "My I", 0.99)
    segments = (
        replace(first, cross_section=angle),
        replace(second, cross_section=CrossSection("unknown", confidence=0.7)),
        *rest,
    )
    written = replace(flight_without_report, segments=segments)
    read = read_run(write_run(written, tmp_path / "out").folder)
    assert_same(read.segments, segments)
    assert read.tables["segments"]["roll_deg"][0] == pytest.approx(35.0)
    assert read.tables["members"]["shape"][0] == "i"


def test_tables__are_what_pandas_reads(tmp_path, flight_without_report):
    run = read_run(write_run(flight_without_report, tmp_path / "out").folder)
    for name, table in run.tables.items():
        read = pd.read_csv(tmp_path / "out" / f"{name}.csv")
        if "section" in read:  # no text is no number to pandas
            read["section"] = read["section"].astype("object").where(read["section"].notna(), "")
        pd.testing.assert_frame_equal(table, read, check_dtype=False)
    members = run.tables["members"]
    assert members["joint_1"].isna().any()
    assert (members["length"] == members["t2"] - members["t1"]).all()


def test_run__joint_of_a_segment_that_is_not_there(tmp_path, flight_without_report):
    folder = write_run(flight_without_report, tmp_path / "out").folder
    file = folder / "joints.csv"
    for wrong in ("0;99", "0;x"):
        text = (folder / "joints.csv").read_text().replace("0;1", wrong)
        (tmp_path / "joints.csv").write_text(file.read_text())
        file.write_text(text)
        with pytest.raises(RunError, match=r"joints\.csv: column segments does not name segments"):
            _ = read_run(folder).joints
        file.write_text((tmp_path / "joints.csv").read_text())


def test_run__structure_of_another_run(tmp_path, make_flight):
    config = RunConfig(outputs=OutputConfig(report=False))
    folder = write_run(make_flight(config=config), tmp_path / "out").folder
    other = write_run(make_flight(config=config, n_segments=4), tmp_path / "other").folder
    (folder / "structure.npz").write_bytes((other / "structure.npz").read_bytes())
    with pytest.raises(RunError, match=r"has 4 entries, but segments\.csv 7 rows"):
        _ = read_run(folder).segments


def test_write_run__file_name_that_is_not_unicode(tmp_path, make_flight, describe_recording):
    path = tmp_path / "flight\udcff.bag"
    flight = make_flight(recording=describe_recording(paths=(path,)))
    folder = write_run(flight, tmp_path / "out").folder
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert summary["recording"]["files"] == ["flight\udcff.bag"]
