"""What stands there, and what of it a flight saw."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from beamseg_batch.errors import TruthError
from beamseg_batch.evaluation import evaluate, load_truth
from tests.evaluation.structures import result_of, scattered, truth_of, write_truth

TRUTHS = Path(__file__).parents[1] / "data" / "truths"
SAMPLES = Path(__file__).parents[2] / "data" / "samples"
WORLDS = Path(__file__).parents[2] / "configs" / "worlds"
HEADER = "id,x1,y1,z1,x2,y2,z2,radius"


def members_of(truth, joint):
    return {truth.names[m] for m in joint.members}


# Flights with truth


@pytest.mark.parametrize(
    ("name", "members", "seen", "all_joints"),
    [("tower", 76, 48, 52), ("webots_tests", 7, 2, 2)],
)
def test_load_truth__counts_of_the_flights(name, members, seen, all_joints, tmp_path):
    """Of the tower's 52 joints four stand on the floor, which no flight saw."""
    truth = load_truth(TRUTHS / f"{name}.csv")
    assert truth.counts.sum() == members
    assert truth.joint_counts.sum() == len(truth.joints) == seen
    alone = tmp_path / "truth.csv"
    alone.write_bytes((TRUTHS / f"{name}.csv").read_bytes())
    computed = load_truth(alone)
    assert len(computed.joints) == all_joints
    assert computed.joint_counts.sum() == seen


@pytest.mark.parametrize("name", ["tower", "webots_tests"])
def test_load_truth__computes_the_joints_of_the_flights(name, tmp_path):
    truth = load_truth(TRUTHS / f"{name}.csv")
    alone = tmp_path / "truth.csv"
    alone.write_bytes((TRUTHS / f"{name}.csv").read_bytes())
    computed = load_truth(alone).joints
    for joint in truth.joints:
        near = min(computed, key=lambda other: np.linalg.norm(other.position - joint.position))
        assert np.linalg.norm(near.position - joint.position) < 1e-4
        assert members_of(truth, near) == members_of(truth, joint)


def test_load_truth__shipped_tower_has_the_joints_of_the_flight():
    """Members have other names in the world; their places and how many meet are the same."""
    flight, world = load_truth(TRUTHS / "tower.csv"), load_truth(WORLDS / "lattice_tower.yaml")
    assert len(flight.names) == len(world.names) == 76
    assert len(world.joints) == 52
    for joint in flight.joints:
        near = min(world.joints, key=lambda other: np.linalg.norm(other.position - joint.position))
        assert np.linalg.norm(near.position - joint.position) < 1e-4
        assert len(near.members) == len(joint.members)


def test_load_truth__which_ends_are_the_members_own():
    """The tower's legs stand on the floor, where they are not seen; the fifth member of the
    arena is cut as well."""
    tower = load_truth(TRUTHS / "tower.csv")
    assert tower.own_ends[:4].tolist() == [[False, True]] * 4
    assert tower.own_ends[4:28].all()
    arena = load_truth(TRUTHS / "webots_tests.csv")
    assert np.argwhere(~arena.own_ends).tolist() == [[4, 0]]
    assert np.diff(arena.spans)[4, 0] == pytest.approx(1.86, abs=1e-4)


# Worlds


def test_load_truth__webots_world_has_the_axes_of_the_flight():
    truth, table = (
        load_truth(Path(__file__).parents[1] / "data" / "webots_tests.wbt"),
        load_truth(TRUTHS / "webots_tests.csv"),
    )
    assert len(truth.names) == 7
    for k in range(7):
        distances = [
            np.linalg.norm([truth.axes.starts[k] - one, truth.axes.ends[k] - other], axis=1).max()
            for start, end in zip(table.axes.starts, table.axes.ends, strict=True)
            for one, other in ((start, end), (end, start))
        ]
        assert min(distances) < 1e-3
    assert len(truth.joints) == truth.joint_counts.sum() == 2
    assert "count as seen whole" in truth.notes[-1]


def test_load_truth__world_without_members(tmp_path):
    world = tmp_path / "empty.wbt"
    world.write_text("#VRML_SIM R2021b utf8\nWorldInfo {\n}\n")
    assert load_truth(world).names == ()


def test_evaluate__where_no_member_stands_every_segment_is_false(tmp_path):
    truth = load_truth(write_truth(tmp_path / "t.csv", truth_of(scattered(0))))
    measured = evaluate(truth, result_of(scattered(2)))
    assert measured.metrics["false"] == 2
    assert measured.metrics["precision"] == 0.0
    assert measured.metrics["recall"] is None


# Tables


def test_load_truth__reads_what_the_tables_write(tmp_path):
    ends = scattered(5)
    seen = ends + 0.1 * (ends[:, ::-1] - ends)
    truth = truth_of(ends, seen, radii=[0.05, 0.1, 0.03, 0.05, 0.05], bows=0.02)
    back = load_truth(write_truth(tmp_path / "truth.csv", truth))
    np.testing.assert_allclose(back.axes.starts, truth.axes.starts, atol=1e-6)
    np.testing.assert_allclose(back.seen, truth.seen, atol=1e-6)
    np.testing.assert_allclose(back.radii, truth.radii)
    np.testing.assert_allclose(back.bows, 0.02)
    assert back.names == truth.names
    assert back.notes == ()


def test_load_truth__from_its_folder(tmp_path):
    write_truth(tmp_path / "truth" / "truth.csv", truth_of(scattered(2)))
    assert len(load_truth(tmp_path / "truth").names) == 2


def test_load_truth__seen_ends_in_the_other_order(tmp_path):
    ends = scattered(3)
    truth = load_truth(write_truth(tmp_path / "t.csv", truth_of(ends, seen=ends[:, ::-1])))
    np.testing.assert_allclose(truth.seen, ends, atol=1e-6)
    assert truth.own_ends.all()


def test_load_truth__members_hardly_seen(tmp_path):
    """0.3 m counts, as the file rounds it; less, and nothing at all, does not."""
    ends = np.array([[[0.0, k, 1.0], [2.0, k, 1.0]] for k in range(3)])
    seen = ends.copy()
    seen[0, 1, 0], seen[1, 1, 0], seen[2] = 0.3, 0.29, np.nan
    truth = load_truth(write_truth(tmp_path / "t.csv", truth_of(ends, seen)))
    assert truth.counts.tolist() == [True, False, False]
    assert truth.spans.tolist() == [[0.0, 0.3], [0.0, 2.0], [0.0, 2.0]]


def test_load_truth__table_without_what_was_seen(tmp_path):
    table = pd.read_csv(SAMPLES / "arena_truth.csv")
    table[HEADER.split(",")].to_csv(tmp_path / "t.csv", index=False)
    truth = load_truth(tmp_path / "t.csv")
    assert truth.own_ends.all()
    assert [members_of(truth, joint) for joint in truth.joints] == [
        {"SEG1", "SEG2"},
        {"SEG1", "SEG5"},
    ]
    assert "does not tell what was seen" in truth.notes[0]


def test_load_truth__joints_file_comes_before_the_axes(tmp_path):
    table = write_truth(tmp_path / "t.csv", truth_of(scattered(2)))
    (tmp_path / "t_joints.csv").write_text("ids,x,y,z\n1;2,9,8,7\n")
    assert load_truth(table).joints[0].position.tolist() == [9.0, 8.0, 7.0]


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        (["1,0,0,0,1,0,0,0.05", "2,0,0,nan,1,0,0,0.05"], "row 2: z1 is nan, not a number"),
        (["1,0,0,0,1,0,0,"], "row 1: radius is nan, not a number"),
        (["1,0,0,0,1,0,inf,0.05"], "row 1: z2 is inf"),
        (["1,0,0,0,1,0,0,0"], "row 1: radius 0 must be above 0"),
        (["1,0,0,0,1,0,0,0.05", "7,1,1,1,1,1,1,0.05"], "row 2: member '7' has no length"),
        (["1,0,0,0,1,0,0,0.05"] * 2, "row 2: member '1' is in row 1 already"),
        (["1,0,0,0,1,0,0"], "row 1 has 7 values, the header 8; it ends on line 2"),
        (["1,0,0,0,1,0,0,0.05", "", "2,0,0,0,1,0,O,0.05"], "column z2: line 4: could not convert"),
    ],
)
def test_load_truth__broken_rows(tmp_path, rows, reason):
    file = tmp_path / "truth.csv"
    file.write_text("\n".join([HEADER, *rows]) + "\n")
    with pytest.raises(TruthError, match=f"truth.csv: {reason}"):
        load_truth(file)


@pytest.mark.parametrize(
    ("header", "reason"),
    [
        ("", "is empty"),
        ("a,b", "has no column id, x1, y1, z1, x2, y2, z2, radius"),
        (f"{HEADER},ox1,oy1", "has no column oz1, ox2, oy2, oz2"),
    ],
)
def test_load_truth__missing_columns(tmp_path, header, reason):
    file = tmp_path / "truth.csv"
    row = ",".join(str(k) for k in range(len(header.split(","))))
    file.write_text(f"{header}\n{row}\n" if header else "")
    with pytest.raises(TruthError, match=reason):
        load_truth(file)


def test_load_truth__half_of_what_was_seen(tmp_path):
    file = tmp_path / "truth.csv"
    file.write_text(f"{HEADER},ox1,oy1,oz1,ox2,oy2,oz2\n1,0,0,0,1,0,0,0.05,0,0,0,,,\n")
    with pytest.raises(TruthError, match="row 1: ox1 to oz2 must be numbers, or all empty"):
        load_truth(file)


def test_load_truth__joint_of_an_unknown_member(tmp_path):
    table = write_truth(tmp_path / "t.csv", truth_of(scattered(2)))
    (tmp_path / "t_joints.csv").write_text("ids,x,y,z\n1;2,0,0,0\n1;9,0,0,0\n")
    with pytest.raises(TruthError, match=r"t_joints\.csv: row 2: the truth has no member '9'"):
        load_truth(table)


def test_load_truth__folder_without_a_table(tmp_path):
    with pytest.raises(TruthError, match=r"truth\.csv: cannot be read"):
        load_truth(tmp_path)


def test_load_truth__not_text(tmp_path):
    (tmp_path / "truth.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TruthError, match="is not UTF-8 text"):
        load_truth(tmp_path)


# Joints


def test_load_truth__bent_member_meets_where_it_is(tmp_path):
    """Its chord passes the post 0.2 m off; without the way of the bow there is only a chord."""
    file = tmp_path / "truth.csv"
    rows = ["a,-1,0,1,1,0,1,0.05,round,0.2,{}", "b,0,0,1.2,0,0,2,0.05,round,0,0"]
    header = f"{HEADER},shape,bow,roll_deg\n"
    file.write_text(header + "\n".join(rows).format("0") + "\n")
    (joint,) = load_truth(file).joints
    np.testing.assert_allclose(joint.position, [0.0, 0.0, 1.2], atol=1e-3)
    file.write_text(header + "\n".join(rows).format("90") + "\n")
    assert load_truth(file).joints == ()
    file.write_text(header + "\n".join(rows).format("") + "\n")
    assert load_truth(file).joints == ()


def test_load_truth__chord_of_a_bent_member_ends_where_the_view_was_cut(tmp_path):
    """What a run can know of an arc of which it saw a half: that half's chord and bow."""
    file = tmp_path / "truth.csv"
    header = f"{HEADER},shape,bow,roll_deg,ox1,oy1,oz1,ox2,oy2,oz2\n"
    rows = [
        "half,-1,0,1,1,0,1,0.05,round,0.04,0,0,0,1,0.99,0,1",
        "whole,-1,0,3,1,0,3,0.05,round,0.04,0,-0.98,0,3,1,0,3",
        "unseen,-1,0,5,1,0,5,0.05,round,0.04,0,,,,,,",
        "straight,-1,0,7,1,0,7,0.05,round,0,0,0,0,7,1,0,7",
    ]
    file.write_text(header + "\n".join(rows) + "\n")
    truth = load_truth(file)
    starts, ends = truth.chords.starts, truth.chords.ends
    np.testing.assert_allclose(truth.axes.starts, [[-1, 0, z] for z in (1, 3, 5, 7)])
    np.testing.assert_allclose(starts[:, 0], [0.0, -1.0, -1.0, -1.0])
    np.testing.assert_allclose(starts[0], [0.0, 0.0, 1.04], atol=1e-12)
    np.testing.assert_allclose(ends, [[1, 0, z] for z in (1, 3, 5, 7)], atol=1e-12)
    np.testing.assert_allclose(truth.chord_bows, [0.01, 0.04, 0.04, 0.0], atol=1e-4)
    assert truth.own_ends[:2].tolist() == [[False, True], [True, True]]
    np.testing.assert_allclose(truth.seen[0, 0], [0.0, 0.0, 1.04], atol=1e-12)
    np.testing.assert_allclose(truth.seen[3], [[0, 0, 7], [1, 0, 7]], atol=1e-12)
    assert truth.counts.tolist() == [True, True, False, True]


def test_joint_counts__two_members_must_be_seen_there():
    ends = np.array([[[0, 0, 0], [2, 0, 0]], [[0, 0, 0], [0, 2, 0]]], dtype=float)
    seen = ends.copy()
    assert truth_of(ends, seen).joint_counts.tolist() == [True]
    seen[1, 0, 1] = 0.09
    assert truth_of(ends, seen).joint_counts.tolist() == [True]
    seen[1, 0, 1] = 0.2
    assert truth_of(ends, seen).joint_counts.tolist() == [False]
