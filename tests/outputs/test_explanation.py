"""Explanations of places in a run that is built by hand."""

from __future__ import annotations

import json
from dataclasses import fields

import numpy as np
import pytest

from beamseg_batch import read_run, write_run
from beamseg_batch.config import OutputConfig, RunConfig
from beamseg_batch.geometry import RigidTransform
from beamseg_batch.model import Trajectory
from beamseg_batch.outputs.explanation import (
    Explanation,
    NearCandidate,
    NearSegment,
    explain,
    explanation_document,
)
from tests.outputs.conftest import (
    START_NS,
    make_candidate,
    make_recording,
    make_scan,
    make_segment,
)

LIGHT = OutputConfig(report=False)
KEEPING = OutputConfig(report=False, candidates=True)
WALL = make_candidate()  # x = 8, y 0 to 1, z = 1
HERE = (8.0, 0.5, 1.1)


def lines(reason="low_pca_coeff", **changes):
    values = {
        "stage": "scan",
        "number": None,
        "in_pass": None,
        "n_lines": 14,
        "reason": reason,
        "value": 0.981,
        "limit": 0.99,
        "score": np.nan,
    }
    return make_candidate(**(values | changes))


@pytest.fixture
def told(make_flight, tmp_path):
    """Explain a place of a run with one beam, x = 0, y -1 to 1, z = 1, seen from x = -1."""

    def explained(at, candidates=None, within=0.2, **changes):
        rng = np.random.default_rng(0)
        beam = make_segment(
            rng, anchor=np.array([0.0, 0.0, 1.0]), direction=np.array([0.0, 1.0, 0.0]),
            t_min=-1.0, t_max=1.0, n_points=4321, n_scans=30,
        )  # fmt: skip
        scans = tuple(make_scan(rng, index) for index in range(4))
        stamps = np.array([scan.pose_stamp_ns for scan in scans])
        positions = np.array([[-1.0, y, 1.0] for y in (0.0, 0.1, 5.0, 9.0)])
        quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (4, 1))
        values = {
            "segments": (beam,),
            "intersections": (),
            "joints": (),
            "members": (),
            "scans": scans,
            "trajectory": Trajectory(stamps, positions, quaternions),
            "cloud": np.array([[-0.05, 0.1 * k, 1.0] for k in range(-9, 10)], np.float32),
            "recording": make_recording(T_body_sensor=RigidTransform.identity()),
            "config": RunConfig(outputs=LIGHT if candidates is None else KEEPING),
            "candidates": candidates,
        }
        write_run(make_flight(**(values | changes)), tmp_path / "out", overwrite=True)
        return explain(read_run(tmp_path / "out"), at, within)

    return explained


# --- segments, scans and points ---------------------------------------------------------


def test_explain__names_the_beam_that_is_there(told):
    found = told((0.03, 0.2, 1.0), ())
    (segment,) = found.segments
    assert (segment.segment, segment.distance) == (0, 0.0)
    assert (segment.n_points, segment.n_scans, segment.length) == (4321, 30, 2.0)
    assert found.conclusion == "There is a beam: segment 0."
    assert found.nearest is None


@pytest.mark.parametrize(
    ("at", "distance"),
    [((0.0, 0.0, 1.15), 0.1), ((0.0, 1.1, 1.0), 0.05), ((0.0, 0.0, 1.3), None)],
)
def test_explain__distances_are_to_the_surface(told, at, distance):
    segments = told(at, ()).segments
    assert [one.distance for one in segments] == ([] if distance is None else [approx(distance)])


def approx(value):
    return pytest.approx(value, abs=1e-9)


def test_explain__counts_the_scans_whose_window_held_the_place(told):
    found = told((0.0, 0.0, 1.0), ())
    assert (found.n_scans_aimed, found.n_scans) == (2, 4)
    assert found.aimed_s == (approx(0.0), approx(0.1))


def test_explain__follows_the_camera_where_it_sits_and_looks(told, describe_recording):
    turned = RigidTransform(np.diag([-1.0, -1.0, 1.0]), np.array([0.0, 0.0, 0.5]))
    recording = describe_recording(T_body_sensor=turned)
    assert told((0.0, 0.0, 1.0), (), recording=recording).n_scans_aimed == 0
    assert told((-2.0, 0.0, 2.9), (), recording=recording).n_scans_aimed == 2
    assert told((-2.0, 0.0, 3.1), (), recording=recording).n_scans_aimed == 0


def test_explain__counts_the_points_of_the_cloud(told):
    assert told((0.0, 0.0, 1.0), ()).n_cloud_points == 3
    assert told((0.0, 0.0, 1.0), (), within=0.3).n_cloud_points == 5


# --- candidates -------------------------------------------------------------------------


def test_explain__says_why_a_candidate_is_no_beam(told):
    found = told(HERE, (WALL,))
    (candidate,) = found.candidates
    assert candidate.distance == approx(0.05)
    assert (candidate.reason, candidate.value, candidate.limit) == ("not_free", 0.9, 0.45)
    assert (candidate.flank_left, candidate.flank_right) == (0.9, None)
    assert candidate.first_seen_s == approx(2.0)
    assert candidate.setting == "refinement.drop"
    assert candidate.text.startswith("candidate 5 (1.00 m long): 90% of the rays")
    assert found.conclusion == (
        f"No beam is here. What came nearest to one is {candidate.text}. "
        "What decides: refinement.drop."
    )


def test_explain__tells_of_candidates_in_time_order(told):
    rows = (
        WALL,
        make_candidate(number=6, in_pass=1, reason="low_score", value=20.0, limit=300.0),
        lines(first_seen_ns=START_NS + 5 * 10**9),
        lines(first_seen_ns=START_NS + 10**9),
        make_candidate(number=7, stage="end", in_pass=None, reason="too_short"),
        make_candidate(end_1=np.array([8.0, 3.0, 1.0]), end_2=np.array([8.0, 4.0, 1.0])),
        make_candidate(stage="gathering", in_pass=None, reason="too_few_sightings"),
    )
    found = told(HERE, rows)
    assert [(one.stage, one.in_pass) for one in found.candidates] == [
        ("scan", None), ("scan", None), ("gathering", None), ("pass", 1), ("pass", 3),
        ("end", None),
    ]  # fmt: skip
    assert found.candidates[0].first_seen_s < found.candidates[1].first_seen_s
    assert "candidate 7" in found.conclusion  # came furthest
    assert "structure.min_length" in found.conclusion


def test_explain__of_lines_alone_tells_the_narrowest(told):
    found = told(HERE, (lines(), lines(n_lines=1, value=0.5)))
    many, one = (candidate.text for candidate in found.candidates)
    assert many.startswith("14 lines, 1.00 m long, refused, the best of them: 98.100%")
    assert one.startswith("1 line, 1.00 m long, refused: 50.000%")
    assert "14 lines" in found.conclusion
    assert "detection.screening.min_pca_coeff" in found.conclusion


def test_explain__follows_what_was_merged_to_its_segment(told):
    gone = make_candidate(fate="merged", reason="duplicate", into=3, segment=0, value=0.004)
    found = told(HERE, (gone,))
    assert "the same beam as candidate 3 (now segment 0)" in found.candidates[0].text


def test_explain__says_what_was_nearer_than_the_nearest_beam(told):
    beside = make_candidate(
        end_1=np.array([0.0, -1.0, 1.2]), end_2=np.array([0.0, 1.0, 1.2]), number=9
    )
    found = told((0.0, 0.0, 1.2), (beside,))
    assert found.conclusion.startswith("There is a beam: segment 0, 0.15 m from the place. Nearer")
    assert "candidate 9" in found.conclusion


def test_explain__a_reason_of_a_later_version_is_told_by_its_name(told):
    found = told(HERE, (make_candidate(reason="too_blue", stage="judgement"),))
    assert "was refused: too_blue" in found.conclusion


# --- nothing there ----------------------------------------------------------------------


def test_explain__without_candidates_says_how_to_get_them(told):
    found = told((-0.05, 0.0, 1.3), within=0.4, segments=())
    assert found.candidates is None
    assert found.conclusion.startswith("No beam is here, but something returned rays.")
    assert "--keep-candidates" in found.conclusion


def test_explain__points_in_which_no_line_was_found(told):
    found = told((-0.05, 0.0, 1.3), (), within=0.4, segments=())
    assert "the search found no line in it" in found.conclusion


def test_explain__a_place_that_scans_saw_empty(told):
    found = told((-0.4, 0.0, 1.5), ())
    assert "in the window of 2 scans" in found.conclusion
    assert found.nearest.what == "segment 0"
    assert found.nearest.place == (approx(0.0), approx(0.0), approx(1.0))


def test_explain__far_from_everything_names_the_nearest_thing(told):
    found = told((-50.0, 0.0, 1.0), ())
    assert "in the window of no scan" in found.conclusion
    assert found.nearest.what == "the drone's trajectory"
    assert found.nearest.distance == approx(49.0)
    assert "49.00 m away at -1.00,0.00,1.00" in found.conclusion


def test_explain__below_the_floor_trim(told):
    found = told((0.0, 0.0, 0.1), ())
    assert found.below_floor
    assert "filtering.floor_trim_height" in found.conclusion


def test_explain__a_run_that_holds_nothing(told, make_empty_flight, tmp_path):
    flight = make_empty_flight(config=RunConfig(outputs=LIGHT))
    write_run(flight, tmp_path / "none")
    found = explain(read_run(tmp_path / "none"), (1.0, 2.0, 3.0), 0.2)
    assert (found.nearest, found.n_scans, found.segments) == (None, 0, ())
    assert found.conclusion.startswith("Nothing was seen here")


def test_explain__a_summary_without_the_camera(told, tmp_path):
    told((0.0, 0.0, 1.0))
    file = tmp_path / "out" / "summary.json"
    summary = json.loads(file.read_text(encoding="utf-8"))
    del summary["recording"]["extrinsic"], summary["configuration"]
    file.write_text(json.dumps(summary), encoding="utf-8")
    found = explain(read_run(tmp_path / "out"), (0.0, 0.5, 3.0), 0.2)
    assert found.n_scans_aimed is None
    assert found.conclusion.startswith("Nothing was seen here.")


# --- for machines -----------------------------------------------------------------------


def test_explanation_document__has_the_same_keys_always(told):
    documents = [
        explanation_document(told(at, rows))
        for at, rows in ((HERE, (WALL, lines())), ((0.0, 0.0, 1.0), ()), ((90.0, 0, 0), None))
    ]
    keys = ["schema_version", *(field.name for field in fields(Explanation))]
    assert all(list(document) == keys for document in documents)
    for document in documents:
        assert json.loads(json.dumps(document, allow_nan=False))["schema_version"] == 1
    candidate = documents[0]["candidates"][0]
    assert list(candidate) == [field.name for field in fields(NearCandidate)]
    assert list(documents[1]["segments"][0]) == [field.name for field in fields(NearSegment)]
