"""`candidates.parquet`: everything that might have been a beam, for `beamseg explain`.

A flight has thousands of these, of which a reader wants a few: a format with columns,
types and nulls, which other programs read, serves better than text.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from beamseg_batch.errors import RunError
from beamseg_batch.extras import load_extra
from beamseg_batch.tables import CANDIDATES, Column, ColumnArrays, Kind

__all__ = ["CANDIDATES_FILE", "candidates_parquet", "check_parquet", "read_candidates"]

CANDIDATES_FILE = CANDIDATES.file_name


def check_parquet() -> None:
    """Say whether Parquet files can be written and read here.

    Raises
    ------
    MissingExtraError
        If the library for it is not installed.
    """
    _pyarrow()


def candidates_parquet(columns: ColumnArrays) -> bytes:
    """Pack the table of candidates.

    Parameters
    ----------
    columns : mapping of str to (N,) array
        Those of `CANDIDATES`.

    Returns
    -------
    bytes
        The same whenever the flight is processed again. The fields' metadata tell unit and
        meaning.

    Raises
    ------
    MissingExtraError
    """
    pyarrow, parquet = _pyarrow()
    types = {
        "int": pyarrow.int64(),
        "float": pyarrow.float64(),
        "text": pyarrow.string(),
        "number": pyarrow.int64(),
        "flag": pyarrow.bool_(),
    }
    fields = [
        pyarrow.field(
            column.name,
            types[column.kind],
            nullable=column.kind in ("number", "flag"),
            metadata={"unit": column.unit, "meaning": column.meaning},
        )
        for column in CANDIDATES.columns
    ]
    values = {column.name: _stored(column, columns) for column in CANDIDATES.columns}
    table = pyarrow.Table.from_pydict(values, schema=pyarrow.schema(fields))
    buffer = io.BytesIO()
    parquet.write_table(table, buffer, compression="zstd")
    return buffer.getvalue()


def read_candidates(file: Path) -> ColumnArrays:
    """Read the table of candidates.

    Parameters
    ----------
    file : Path

    Returns
    -------
    mapping of str to (N,) array
        The declared columns; those of a later version are left out.

    Raises
    ------
    MissingExtraError
    RunError
        If the file cannot be read or lacks a column.
    """
    _, parquet = _pyarrow()
    try:
        table = parquet.read_table(file)
    except Exception as error:  # damage fails in pyarrow in ways of its own
        reason = str(getattr(error, "strerror", None) or error).splitlines()[0]
        raise RunError(f"{file}: cannot be read: {reason}") from error
    missing = [name for name in CANDIDATES.column_names if name not in table.column_names]
    if missing:
        raise RunError(f"{file}: has no column {', '.join(missing)}")
    try:
        return {column.name: _read(column, table) for column in CANDIDATES.columns}
    except (TypeError, ValueError, OverflowError) as error:
        raise RunError(f"{file}: holds values of another kind: {error}") from error


def _stored(column: Column, columns: ColumnArrays) -> list[Any]:
    values: list[Any] = columns[column.name].tolist()
    if column.kind == "number":
        return [None if np.isnan(value) else int(value) for value in values]
    return values


def _read(column: Column, table: Any) -> np.ndarray[Any, np.dtype[Any]]:
    kind: Kind = column.kind
    values = table.column(column.name).to_pylist()
    if kind in ("number", "float"):
        values = [np.nan if value is None else value for value in values]
    return np.array(values, dtype=column.dtype)


def _pyarrow() -> tuple[Any, Any]:
    """Return the two modules, which take a moment to load."""
    pyarrow = load_extra("pyarrow", CANDIDATES_FILE, "parquet")
    return pyarrow, load_extra("pyarrow.parquet", CANDIDATES_FILE, "parquet")
