"""Tables: text that reads back, columns that are documented."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beamseg_batch.errors import RunError, ShapeError
from beamseg_batch.model import STAGES
from beamseg_batch.tables import (
    INTERSECTIONS,
    PROCESSING_TIME,
    SEGMENTS,
    TABLES,
    TRUTH,
    TRUTH_TABLES,
    Column,
    Table,
)

SMALL = Table(
    "small.csv",
    "One row per thing.",
    (
        Column("number", "", "Number of the thing", kind="int"),
        Column("place", "m", "Where it is"),
        Column("time_s", "s", "When it was", spec=".3f"),
        Column("name", "", "What it is called", kind="text"),
    ),
    deterministic=True,
)
OPEN = Table(
    "open.csv",
    "One row per thing of which little is known.",
    (
        Column("other", "", "Number of the other thing", kind="number"),
        Column("seen", "", "Whether it was seen", kind="flag"),
    ),
    deterministic=True,
)


def small(numbers=(), places=(), times=(), names=()):
    return {"number": numbers, "place": places, "time_s": times, "name": names}


@given(st.lists(st.floats()))
def test_encode__floats_read_back_exactly(values):
    n = len(values)
    text = SMALL.encode(small(range(n), values, [0.0] * n, ["x"] * n))
    np.testing.assert_array_equal(SMALL.decode(text)["place"], np.array(values, dtype=float))


@given(st.lists(st.floats(-1e6, 1e6)))
def test_encode__what_was_written_is_written_again(values):
    n = len(values)
    text = SMALL.encode(small(range(n), values, values, ["x"] * n))
    assert SMALL.encode(SMALL.decode(text)) == text


@given(st.lists(st.integers(-(2**63), 2**63 - 1)))
def test_encode__integers_read_back_exactly(values):
    n = len(values)
    read = SMALL.decode(SMALL.encode(small(values, [0.0] * n, [0.0] * n, ["x"] * n)))
    assert read["number"].tolist() == values


@given(st.text(st.characters(exclude_categories=("Cs",), exclude_characters="\r\n\0"), min_size=1))
def test_encode__text_reads_back_exactly(name):
    read = SMALL.decode(SMALL.encode(small([1], [0.0], [0.0], [name])))
    assert read["name"].tolist() == [name]


@pytest.mark.parametrize("value", [-0.0, -1e-9])
def test_encode__has_no_negative_zero(value):
    assert Column("t", "s", "", spec=".3f").encode(value) == "0.000"
    assert Column("t", "s", "").encode(-0.0) == "0.0"


def test_encode__missing_value_is_empty():
    assert Column("t", "s", "").encode(math.nan) == ""


def test_encode__numbers_and_flags_that_may_be_missing():
    values = {"other": [3.0, math.nan, 0], "seen": [True, None, np.False_]}
    text = OPEN.encode(values)
    assert text == "other,seen\n3,true\n,\n0,false\n"
    read = OPEN.decode(text)
    np.testing.assert_array_equal(read["other"], [3.0, math.nan, 0.0])
    assert read["seen"].tolist() == [True, None, False]
    assert OPEN.decode("other,seen\n1,TRUE\n,0\n")["seen"].tolist() == [True, False]


def test_encode__a_numpy_scalar_is_written_as_a_plain_number():
    assert Column("t", "m", "").encode(np.float64(0.1)) == "0.1"
    assert Column("t", "m", "", kind="int").encode(np.int64(7)) == "7"


def test_encode__no_rows_is_a_header():
    text = SMALL.encode(small())
    assert text == "number,place,time_s,name\n"
    assert {name: array.dtype for name, array in SMALL.decode(text).items()} == {
        "number": np.dtype(np.int64),
        "place": np.dtype(np.float64),
        "time_s": np.dtype(np.float64),
        "name": np.dtype(object),
    }


def test_encode__unknown_and_missing_columns():
    with pytest.raises(ShapeError, match=r"small\.csv: missing or unknown columns: colour, name"):
        SMALL.encode({"number": [], "place": [], "time_s": [], "colour": []})


def test_encode__columns_of_different_length():
    with pytest.raises(ShapeError, match="differ in length"):
        SMALL.encode(small([1], [1.0], [1.0, 2.0], ["x"]))


def test_decode__columns_of_a_later_version_are_left_out():
    read = SMALL.decode("name,later,time_s,place,number\nx,9,1.0,2.0,3\n")
    assert list(read) == ["number", "place", "time_s", "name"]
    assert read["number"].tolist() == [3]


def test_decode__only_what_is_required_must_be_there():
    read = SMALL.decode("name,number\nx,3\n", required=("number",))
    assert list(read) == ["number", "name"]
    with pytest.raises(RunError, match=r"small\.csv: has no column place$"):
        SMALL.decode("name,number\nx,3\n", required=("number", "place"))


def test_decode__an_error_names_the_line():
    with pytest.raises(RunError, match="column place: line 5: could not convert"):
        SMALL.decode('number,place,time_s,name\n1,2,3,"a\nb"\n\n2,two,3,x\n')
    with pytest.raises(RunError, match="row 2 has 1 values, the header 4; it ends on line 4"):
        SMALL.decode("number,place,time_s,name\n1,2,3,x\n\n9\n")


def test_decode__lines_of_another_system():
    assert SMALL.decode("number,place,time_s,name\r\n1,2.5,3.0,x\r\n")["place"].tolist() == [2.5]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "is empty"),
        ("number,place\n1,2\n", "has no column time_s, name"),
        ("number,place,time_s,name\n1,2\n", "row 1 has 2 values, the header 4"),
        ("number,place,time_s,name\n1.5,2,3,x\n", "column number: "),
        ("number,place,time_s,name\n1,two,3,x\n", "column place: "),
        (f"number,place,time_s,name\n{10**30},2,3,x\n", "column number: "),
        ('number,place,time_s,name\n1,2,3,"x\n', "is not a CSV table"),
    ],
)
def test_decode__unreadable(text, reason):
    with pytest.raises(RunError, match=f"here: {reason}"):
        SMALL.decode(text, where="here")


@pytest.mark.parametrize("table", TABLES + TRUTH_TABLES, ids=lambda table: table.name)
def test_documentation__names_every_column_once(table):
    cells = [line.split(" | ")[0] for line in table.documentation().splitlines() if "`" in line]
    assert cells == [f"| `{name}`" for name in table.column_names]
    assert len(set(table.column_names)) == len(table.columns)


@pytest.mark.parametrize("table", TABLES + TRUTH_TABLES, ids=lambda table: table.name)
def test_documentation__every_column_has_a_meaning(table):
    for column in table.columns:
        assert column.meaning
        assert not column.meaning.endswith(".")
        assert "|" not in column.meaning


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("1.5,\n", "column other: line 2: "),
        ("1,maybe\n", "column seen: line 2: 'maybe' is neither"),
    ],
)
def test_decode__neither_missing_nor_a_value(text, reason):
    with pytest.raises(RunError, match=f"open\\.csv: {reason}"):
        OPEN.decode("other,seen\n" + text)


def test_documentation__says_what_may_be_missing():
    assert "| `other` | – | integer or empty |" in OPEN.documentation()
    assert "| `seen` | – | `true`, `false` or empty |" in OPEN.documentation()


def test_tables__segments_have_their_deviations_where_they_belong():
    names = SEGMENTS.column_names
    first = names.index("sigma_offset")
    assert ",".join(names[first - 1 :]) == (
        "pca_eig_2,sigma_offset,sigma_angle_deg,measured_radius,sigma_radius,"
        "bow,sigma_bow,bow_x,bow_y,bow_z,sigma_end_1,sigma_end_2,"
        "end_1_seen,end_2_seen,first_seen_s,last_seen_s"
    )


def test_documentation__is_a_markdown_table():
    assert SMALL.documentation() == (
        "One row per thing. The same bytes when the same flight is processed again.\n\n"
        "| column | unit | written as | meaning |\n"
        "|---|---|---|---|\n"
        "| `number` | – | integer | Number of the thing |\n"
        "| `place` | m | shortest exact | Where it is |\n"
        "| `time_s` | s | 3 decimals | When it was |\n"
        "| `name` | – | text | What it is called |\n"
    )


def test_tables__begin_with_the_columns_of_the_original():
    original = "segment,a_x,a_y,a_z,b_x,b_y,b_z,t_min,t_max"
    assert ",".join(SEGMENTS.column_names).startswith(original + ",")
    assert INTERSECTIONS.column_names[:4] == ("seg1", "t1", "seg2", "t2")
    assert PROCESSING_TIME.column_names[:4] == (
        "wall_time",
        "processing_time",
        "seg_vec_size",
        "nblines",
    )


def test_tables__truth_begins_with_the_columns_of_the_flights_that_have_one():
    flights = Path(__file__).parent / "data" / "truths"
    for name in ("tower", "webots_tests"):
        columns = (flights / f"{name}.csv").read_text().splitlines()[0].split(",")
        assert list(TRUTH.column_names[: len(columns)]) == columns


def test_tables__every_stage_has_its_column():
    stages = [name for name in PROCESSING_TIME.column_names if name.endswith("_us")]
    assert stages == [f"{stage}_us" for stage in STAGES]


def test_tables__only_times_differ_from_run_to_run():
    assert [table.name for table in TABLES if not table.deterministic] == ["processing_time"]


def test_encode__is_what_the_csv_module_reads():
    text = SMALL.encode(small([1], [0.5], [0.25], ['a "b", c']))
    assert list(csv.reader(io.StringIO(text)))[1] == ["1", "0.5", "0.250", 'a "b", c']
