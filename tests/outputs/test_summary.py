"""The summary: strict JSON with stable keys."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import pytest

from beamseg_batch.model import DepthNoise, PoseJitter, SensorModel
from beamseg_batch.outputs.summary import results_sha256, sensor_text, summarise, summary_json


def refuse(literal):
    raise AssertionError(f"{literal} is not JSON")


def strictly_read(text):
    return json.loads(text, parse_constant=refuse)


def keys(tree, prefix=""):
    if not isinstance(tree, dict):
        return set()
    paths = {prefix + key for key in tree}
    return paths.union(*(keys(value, f"{prefix}{key}.") for key, value in tree.items()))


def test_summary_json__reads_back(flight):
    summary = summarise(flight, ["b", "a"], "hash")
    assert strictly_read(summary_json(summary)) == summary
    assert summary["schema_version"] == 1
    assert summary["files"] == ["a", "b"]
    assert summary["results_sha256"] == "hash"


def test_summary_json__is_the_same_again(make_flight):
    first, second = (summary_json(summarise(make_flight(), (), "")) for _ in range(2))
    assert first == second


def test_summarise__counts(flight):
    counts = summarise(flight, (), "")["counts"]
    assert counts == {
        "clouds": 35,
        "processed": 30,
        "skipped": 5,
        "skipped_by_reason": {"no_points_in_window": 2, "no_pose_within_gap": 3},
        "lines": sum(scan.n_lines for scan in flight.scans),
        "rejected": 15,
        "rejected_by_criterion": {"gap": 4, "n_points": 11},
        "segments": 7,
        "intersections": 2,
        "joints": 2,
        "members": 9,
    }


def test_summarise__recording_is_named_without_its_folder(flight):
    summary = summarise(flight, (), "")
    assert summary["recording"]["files"] == ["arena.mcap"]
    assert "/somewhere" not in summary_json(summary)
    assert summary["recording"]["extrinsic"]["translation_m"] == [0.071, 0.011, 0.04]


def test_summarise__warnings_and_notes_name_files_without_their_folder(
    make_flight, describe_recording
):
    # The second path begins with the first.
    paths = (Path("/home/jo/flight.bag"), Path("/home/jo/flight.bag.2"))
    recording = describe_recording(paths=paths, notes=(f"{paths[1]}: a note",))
    flight = make_flight(recording=recording, warnings=(f"{paths[0]}: damaged", "of 3 clouds"))
    summary = summarise(flight, (), "")
    assert summary["warnings"] == ["flight.bag: damaged", "of 3 clouds"]
    assert summary["recording"]["notes"] == ["flight.bag.2: a note"]
    assert "/home/jo" not in summary_json(summary)


def test_summarise__recording_in_the_working_folder(make_flight, describe_recording):
    flight = make_flight(recording=describe_recording(paths=(Path(),)))
    assert summarise(flight, (), "")["recording"]["files"] == ["."]


def test_summarise__times_are_milliseconds(make_flight):
    flight = make_flight(n_scans=5)
    scans = tuple(
        dataclasses.replace(scan, processing_us=1000.0 * (k + 1))
        for k, scan in enumerate(flight.scans)
    )
    summary = summarise(dataclasses.replace(flight, scans=scans), (), "")
    assert summary["processing"]["p50_ms"] == pytest.approx(3.0)
    assert summary["processing"]["max_ms"] == pytest.approx(5.0)
    assert summary["processing"]["mean_ms"] == pytest.approx(3.0)
    assert summary["real_time"] == {
        "kept_up": True,
        "cloud_interval_ms": pytest.approx(100.0),
        "load": pytest.approx(0.03),
        "share_of_scans_late": 0.0,
    }


def test_summarise__too_slow_for_real_time(make_flight):
    flight = make_flight(n_scans=4)
    scans = tuple(dataclasses.replace(scan, processing_us=150_000.0) for scan in flight.scans)
    real_time = summarise(dataclasses.replace(flight, scans=scans), (), "")["real_time"]
    assert real_time["kept_up"] is False
    assert real_time["load"] == pytest.approx(1.5)
    assert real_time["share_of_scans_late"] == 1.0


@pytest.mark.parametrize("n_scans", [0, 1, 2])
def test_summarise__keys_do_not_depend_on_the_flight(make_flight, n_scans):
    usual = keys(summarise(make_flight(), (), ""))
    assert keys(summarise(make_flight(n_scans=n_scans, n_segments=0), (), "")) == usual


def test_summarise__empty(empty_flight):
    summary = strictly_read(summary_json(summarise(empty_flight, (), "")))
    assert summary["processing"]["p50_ms"] is None
    assert summary["real_time"]["kept_up"] is None
    assert summary["totals"]["beam_length_m"] == 0.0


def test_summarise__not_a_number_becomes_null(make_flight):
    flight = make_flight(wall_s=float("nan"))
    text = summary_json(summarise(flight, (), ""))
    assert strictly_read(text)["totals"]["wall_s"] is None


def test_results_sha256__counts_deterministic_tables_only():
    contents = {"segments.csv": b"1", "intersections.csv": b"2", "processing_time.csv": b"3"}
    expected = results_sha256(contents)
    assert results_sha256(contents | {"processing_time.csv": b"4", "report.html": b""}) == expected
    assert results_sha256(contents | {"segments.csv": b"12"}) != expected
    assert results_sha256({"segments.csv": b"2", "intersections.csv": b"1"}) != expected


def test_summarise__tells_the_sensor_with_where_each_value_is_from(make_flight):
    noise = DepthNoise(0.003, 0.007, mixed=True, source="measured", mixed_source="configured")
    jitter = PoseJitter(
        0.003, math.radians(0.15), 0.0007, math.radians(0.05), 0.7, *["measured"] * 2
    )
    sensor = SensorModel(noise, jitter, pitch_rad=0.0107)
    told = summarise(make_flight(sensor=sensor), (), "")["sensor"]
    assert told["noise_m"] == {"value": 0.003, "source": "measured"}
    assert told["noise_relative"] == {"value": 0.007, "source": "measured"}
    assert told["mixed_pixels"] == {"value": True, "source": "configured"}
    assert told["pixel_pitch_rad"] == {"value": 0.0107, "source": "measured"}
    assert told["pose_jitter_m"] == {"value": 0.003, "source": "measured"}
    assert told["pose_jitter_deg"]["value"] == pytest.approx(0.15)
    assert told["poses_smoothed"] is True
    assert told["pose_jitter_left_m"] == 0.0007
    assert told["pose_jitter_left_deg"] == pytest.approx(0.05)
    assert sensor_text(sensor) == (
        "noise 3 mm + 0.7 % of the depth (measured), 10.7 mrad a pixel, mixed at edges; poses "
        "jitter by 3.00 mm, 0.150° (measured), smoothed to 0.70 mm, 0.050°"
    )


def test_summarise__of_an_unknown_sensor(flight):
    told = summarise(flight, (), "")["sensor"]
    assert told["noise_m"] == {"value": 0.01, "source": "default"}
    assert told["pixel_pitch_rad"] == {"value": None, "source": "default"}
    assert told["pose_jitter_m"] == {"value": 0.0, "source": "default"}
    assert sensor_text(flight.sensor) == "noise 10 mm (default)"
