"""What a run claims."""

from __future__ import annotations

import json

import numpy as np
import pytest

from beamseg_batch.errors import ConfigError, RunError
from beamseg_batch.evaluation import evaluate
from beamseg_batch.evaluation.documents import evaluation_json
from beamseg_batch.evaluation.results import SIGMAS, Timing, load_result, read_timing
from beamseg_batch.world.joints import Joint
from tests.evaluation.structures import scattered, truth_of, write_run

ORIGINAL = "segment,a_x,a_y,a_z,b_x,b_y,b_z,t_min,t_max"
CROSS = np.array([[[-1, 0, 0], [1, 0, 0]], [[0, -1, 0.02], [0, 1, 0.02]]], dtype=float)


def write_segments(folder, rows, header=ORIGINAL):
    folder.mkdir(exist_ok=True)
    (folder / "segments.csv").write_text("\n".join([header, *rows]) + "\n")
    return folder


def ends_of(result):
    return np.stack([result.axes.starts, result.axes.ends], axis=1)


def test_load_result__reads_the_ends(tmp_path):
    ends = scattered(4)
    result = load_result(write_run(tmp_path, ends))
    np.testing.assert_allclose(ends_of(result), ends, atol=1e-12)
    assert result.radii.tolist() == [0.05] * 4
    assert result.shapes == ("round",) * 4
    assert np.isnan(result.bows).all()
    assert result.sigmas == {}


def test_load_result__columns_of_the_original_alone(tmp_path):
    folder = write_run(tmp_path, scattered(2), original=True)
    result = load_result(folder, 0.03)
    assert result.radii.tolist() == [0.03, 0.03]
    assert result.shapes is None
    with pytest.raises(ConfigError, match=r"segments\.csv: has no column radius.*--radius 0\.05"):
        load_result(folder)


def test_load_result__the_tables_radius_comes_first(tmp_path):
    assert load_result(write_run(tmp_path, scattered(1)), 0.03).radii.tolist() == [0.05]


def test_load_result__direction_of_any_length(tmp_path):
    """The original does not normalise what it fuses; its ends are `a + t * b` all the same."""
    folder = write_segments(tmp_path, ["7,0,0,1,0,0,2,0.5,1.5", "9,0,0,1,0,0,2,1.5,0.5"])
    result = load_result(folder, 0.05)
    np.testing.assert_allclose(ends_of(result)[0], [[0, 0, 2], [0, 0, 4]])
    np.testing.assert_allclose(ends_of(result)[1], [[0, 0, 4], [0, 0, 2]])
    np.testing.assert_allclose(result.axes.directions, [[0, 0, 1], [0, 0, -1]])
    assert result.numbers.tolist() == [7, 9]


def test_load_result__no_segments(tmp_path):
    result = load_result(write_run(tmp_path, []))
    assert len(result.axes) == len(result.radii) == len(result.joints) == 0


def test_load_result__columns_of_later_versions(tmp_path):
    more = {"sigma_offset": [0.001, ""], "sigma_end_1": [0.002, 0.003], "bow": [-0.01, 0.02]}
    result = load_result(write_run(tmp_path, scattered(2), **more))
    assert set(result.sigmas) == {"offset", "end_1"}
    np.testing.assert_array_equal(result.sigmas["offset"], [0.001, np.nan])
    np.testing.assert_array_equal(result.bows, [0.01, 0.02])


LATER = {
    "section": ["", "i 100x140"],
    "shape": ["round", "unknown"],
    **{f"sigma_{name}": [0.001, ""] for name in ("offset", "angle_deg", "radius", "bow")},
    **{f"sigma_end_{k}": ["", 0.002] for k in (1, 2)},
    **{f"end_{k}_seen": [1, 0] for k in (1, 2)},
    "bow": [-0.01, ""],
}


def test_evaluate__columns_and_joints_of_later_versions(tmp_path):
    """Those that are known are measured, empty values claim nothing, and the rest is left."""
    ends = scattered(2)
    folder = write_run(tmp_path / "run", ends, **LATER)
    (folder / "joints.csv").write_text("joint,x,y,z,segments,residual\n0,1,2,3,0;1,0.001\n")
    result = load_result(folder)
    assert set(result.sigmas) == set(SIGMAS)
    np.testing.assert_array_equal(result.joints, [[1.0, 2.0, 3.0]])
    truth = truth_of(ends, joints=[Joint(np.array([1.0, 2.0, 3.05]), (0, 1))])
    evaluation = evaluate(truth, result)
    assert evaluation.metrics["matched"] == 2
    assert evaluation.metrics["bow_error.max"] == pytest.approx(0.01)
    assert evaluation.metrics["honesty.offset"] == evaluation.metrics["honesty.ends"] == 1.0
    json.loads(evaluation_json(evaluation))


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        ({"sigma_offset": [0.001, "inf"]}, "row 2: sigma_offset is inf, not a number"),
        ({"sigma_end_1": [-0.5, ""]}, "row 1: sigma_end_1 is -0.5, but must not be negative"),
        ({"bow": [1e9, 0]}, r"row 1: bow is 1e\+09, beyond the limit 1e\+06"),
        ({"segment": [4, 4]}, "row 2: segment 4 is in row 1 already"),
        ({"radius": [0.05, -0.05]}, r"row 2: radius -0\.05 must be above 0"),
        ({"a_x": [0, 1e300]}, r"row 2: a_x is 1e\+300, beyond the limit"),
    ],
)
def test_load_result__values_that_cannot_be(tmp_path, more, reason):
    with pytest.raises(RunError, match=rf"segments\.csv: {reason}"):
        load_result(write_run(tmp_path, scattered(2), **more))


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        (["0,0,0,0,0,0,1,0"], "row 1 has 8 values, the header 9; it ends on line 2"),
        (["0,0,0,0,0,0,1,0,1", "1,0,0,nan,0,0,1,0,1"], "row 2: a_z is nan, not a number"),
        (["0,0,0,0,0,0,1,0,"], "row 1: t_max is nan"),
        (["0,0,0,0,0,0,1,-inf,1"], "row 1: t_min is -inf"),
        (["0,0,0,0,0,0,0,0,1"], "row 1: the direction b_x, b_y, b_z is zero"),
        (["0,0,0,0,0,0,1,0,1", "x,0,0,0,0,0,1,0,1"], "column segment: line 3: invalid literal"),
        (['0,0,0,0,0,0,1,0,"1'], "is not a CSV table: line 2"),
    ],
)
def test_load_result__broken_segments(tmp_path, rows, reason):
    with pytest.raises(RunError, match=rf"segments\.csv: {reason}"):
        load_result(write_segments(tmp_path, rows), 0.05)


def test_load_result__broken_radius(tmp_path):
    folder = write_segments(tmp_path, ["0,0,0,0,0,0,1,0,1,nan"], f"{ORIGINAL},radius")
    with pytest.raises(RunError, match="row 1: radius is nan"):
        load_result(folder)


def test_load_result__missing(tmp_path):
    with pytest.raises(RunError, match=r"has no segments\.csv"):
        load_result(tmp_path)
    with pytest.raises(RunError, match=r"nowhere is no folder with a segments\.csv"):
        load_result(tmp_path / "nowhere")
    with pytest.raises(RunError, match="has no column segment, a_x"):
        load_result(write_segments(tmp_path, ["1"], "a"))


# Joints


def test_load_result__intersections_of_the_original(tmp_path):
    result = load_result(write_run(tmp_path, CROSS, intersections="0,1.0,1,1.0\n"))
    np.testing.assert_allclose(result.joints, [[0.0, 0.0, 0.01]], atol=1e-12)
    assert result.touching.tolist() == [[0, 1]]


def test_load_result__intersections_with_their_place(tmp_path):
    folder = write_run(tmp_path, CROSS, intersections=None)
    (folder / "intersections.csv").write_text("seg1,t1,seg2,t2,x,y,z\n1,0,0,0,4,5,6\n")
    result = load_result(folder)
    assert result.joints.tolist() == [[4.0, 5.0, 6.0]]
    assert result.touching.tolist() == [[0, 1]]


def test_load_result__intersections_become_joints(tmp_path):
    """Three segments at one place meet in pairs; a fourth meets the first further on."""
    meeting = [[[0, 0, 0], d] for d in ([2.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0])]
    ends = [*meeting, [[1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]]
    pairs = "0,0.0,1,0.05\n0,0.02,2,0\n1,0,2,0.03\n0,1.0,3,0\n"
    result = load_result(write_run(tmp_path, ends, intersections=pairs))
    assert len(result.joints) == 2
    np.testing.assert_allclose(result.joints[0], [0.01 / 3, 0.025 / 3, 0.015 / 3], atol=1e-12)
    np.testing.assert_allclose(result.joints[1], [1.0, 0.0, 0.0], atol=1e-12)
    assert len(result.touching) == 4


def test_load_result__joints_table_comes_before_intersections(tmp_path):
    folder = write_run(tmp_path, CROSS, intersections="0,1.0,1,1.0\n")
    (folder / "joints.csv").write_text("joint,x,y,z,segments\n0,1,2,3,0;1\n1,4,5,6,0;1\n")
    assert load_result(folder).joints.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]


def test_load_result__nothing_about_joints(tmp_path):
    result = load_result(write_run(tmp_path, CROSS, intersections=None))
    assert result.joints is None
    assert "says nothing of joints" in result.notes[0]


def test_load_result__no_intersections(tmp_path):
    result = load_result(write_run(tmp_path, CROSS, intersections=""))
    assert result.joints.shape == (0, 3)
    assert result.touching.shape == (0, 2)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("seg1,t1,seg2\n", "has no column t2"),
        ("seg1,t1,seg2,t2\n0,0,8,0\n", r"row 1: there is no segment 8 in segments\.csv"),
        ("seg1,t1,seg2,t2\n0,0,1,nan\n", "row 1: t2 is nan"),
        ("seg1,t1,seg2,t2,x,y,z\n0,0,1,0,1,,1\n", "row 1: y is nan"),
    ],
)
def test_load_result__broken_intersections(tmp_path, text, reason):
    folder = write_run(tmp_path, CROSS, intersections=None)
    (folder / "intersections.csv").write_text(text)
    with pytest.raises(RunError, match=rf"intersections\.csv: {reason}"):
        load_result(folder)


def test_load_result__broken_joints(tmp_path):
    folder = write_run(tmp_path, CROSS)
    (folder / "joints.csv").write_text("x,y,z\n1,2,inf\n")
    with pytest.raises(RunError, match=r"joints\.csv: row 1: z is inf"):
        load_result(folder)


# Times


def test_read_timing__of_the_original(tmp_path):
    rows = ["wall_time,processing_time,seg_vec_size,nblines", "5000,1000,1,1", "9000,4000,1,1"]
    (tmp_path / "processing_time.csv").write_text("\n".join([*rows, "20000,2000,2,1"]) + "\n")
    assert read_timing(tmp_path) == Timing(median_ms=2.0, wall_s=0.02)
    (tmp_path / "summary.json").write_text('{"totals": {"wall_s": 1.5}}')
    assert read_timing(tmp_path) == Timing(median_ms=2.0, wall_s=1.5)


def test_read_timing__nothing_to_read(tmp_path):
    assert read_timing(tmp_path) == Timing(None, None)
    (tmp_path / "processing_time.csv").write_text("wall_time,processing_time\n")
    assert read_timing(tmp_path) == Timing(None, None)


@pytest.mark.parametrize("text", ["{", "[]", '{"totals": {}}', '{"totals": {"wall_s": null}}'])
def test_read_timing__broken_summary(tmp_path, text):
    (tmp_path / "summary.json").write_text(text)
    with pytest.raises(RunError, match=r"summary\.json: has no totals\.wall_s"):
        read_timing(tmp_path)


def test_read_timing__time_that_is_none(tmp_path):
    (tmp_path / "summary.json").write_text('{"totals": {"wall_s": NaN}}')
    with pytest.raises(RunError, match=r"summary\.json: totals\.wall_s is nan, not a number"):
        read_timing(tmp_path)
