"""`candidates.parquet`: written, read back, and refused when it is no such file."""

from __future__ import annotations

import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from beamseg_batch import read_run, write_run
from beamseg_batch.config import OutputConfig, RunConfig
from beamseg_batch.errors import MissingExtraError, RunError
from beamseg_batch.outputs.candidates_file import candidates_parquet, read_candidates
from beamseg_batch.outputs.columns import candidate_columns
from beamseg_batch.outputs.run_folder import check_output, planned_files
from beamseg_batch.tables import CANDIDATES
from tests.outputs.conftest import make_candidate

KEEPING = RunConfig(outputs=OutputConfig(report=False, candidates=True))
LINE = make_candidate(
    stage="scan", number=None, in_pass=None, n_lines=4, score=np.nan, flanks=(np.nan, np.nan),
    reason="gap", into=None,
)  # fmt: skip
KEPT = make_candidate(fate="kept", reason="", value=np.nan, limit=np.nan, segment=2, stage="end")
MERGED = make_candidate(fate="merged", reason="duplicate", into=7, segment=2, parent=1)


@pytest.mark.parametrize("candidates", [(), (LINE,), (LINE, KEPT, MERGED)])
def test_candidates_parquet__reads_back(tmp_path, candidates):
    columns = candidate_columns(candidates)
    file = tmp_path / "candidates.parquet"
    file.write_bytes(candidates_parquet(columns))
    found = read_candidates(file)
    assert tuple(found) == CANDIDATES.column_names
    for column in CANDIDATES.columns:
        assert found[column.name].dtype == column.dtype
        np.testing.assert_array_equal(found[column.name], columns[column.name])


def test_candidates_parquet__types_and_meanings_are_those_declared(tmp_path):
    file = tmp_path / "candidates.parquet"
    file.write_bytes(candidates_parquet(candidate_columns([LINE, MERGED])))
    table = pq.read_table(file)
    assert table.column("candidate").to_pylist() == [None, 5]
    assert table.column("into").to_pylist() == [None, 7]
    for column in CANDIDATES.columns:
        field = table.schema.field(column.name)
        assert field.metadata == {
            b"unit": column.unit.encode(),
            b"meaning": column.meaning.encode(),
        }
        wanted = {"text": "string", "float": "double"}.get(column.kind, "int64")
        assert str(field.type) == wanted
        assert field.nullable == (column.kind == "number")


def test_candidates_parquet__is_the_same_again():
    first, second = (candidates_parquet(candidate_columns([LINE, KEPT])) for _ in range(2))
    assert first == second


def test_read_candidates__without_a_column(tmp_path):
    file = tmp_path / "candidates.parquet"
    pq.write_table(pa.table({"stage": ["scan"]}), file)
    with pytest.raises(RunError, match="has no column pass, candidate"):
        read_candidates(file)


def test_read_candidates__values_of_another_kind(tmp_path):
    file = tmp_path / "candidates.parquet"
    pq.write_table(pa.table({name: ["?"] for name in CANDIDATES.column_names}), file)
    with pytest.raises(RunError, match="values of another kind"):
        read_candidates(file)


@pytest.mark.parametrize("content", [b"", b"PAR1 nonsense PAR1", None])
def test_read_candidates__damaged_or_missing(tmp_path, content):
    file = tmp_path / "candidates.parquet"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(RunError, match=r"candidates\.parquet: cannot be read"):
        read_candidates(file)


def test_write_run__lists_and_reads_candidates(make_flight, tmp_path):
    flight = make_flight(config=KEEPING, candidates=(LINE, KEPT, MERGED))
    written = write_run(flight, tmp_path / "out")
    assert "candidates.parquet" in written.files == planned_files(KEEPING)
    run = read_run(tmp_path / "out")
    assert run.candidates["fate"].tolist() == ["refused", "kept", "merged"]
    again = write_run(make_flight(), tmp_path / "out", overwrite=True)
    assert "candidates.parquet" not in again.files
    assert not (tmp_path / "out" / "candidates.parquet").exists()
    assert read_run(tmp_path / "out").candidates is None


def test_check_output__says_early_that_the_extra_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    check_output(tmp_path / "out", RunConfig())
    with pytest.raises(MissingExtraError, match=r"pip install 'beamseg-batch\[parquet\]'") as error:
        check_output(tmp_path / "out", KEEPING)
    assert error.value.exit_code == 2
    assert list(tmp_path.iterdir()) == []
