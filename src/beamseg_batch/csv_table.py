"""A table in a file: its columns, declared once, to write, read and document it.

A `Table` writes its CSV text, reads it back and documents it, so the three cannot
disagree. Text goes in and out: files are the business of `beamseg_batch.outputs`.

Numbers round-trip. Most are written as the shortest decimal that reads back as the
same float64; a column with a fixed number of decimals is rounded to them, and reads
back as what was written. Negative zero is written as zero, a missing value as nothing.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.errors import RunError, ShapeError

__all__ = ["Column", "ColumnArrays", "Kind", "Table"]

ColumnArrays: TypeAlias = dict[str, NDArray[Any]]
"""Values by column name, all of the same length: int64, float64 or objects."""

_STORED = {
    "int": "int64",
    "float": "float64",
    "text": "string",
    "number": "int64 or null",
    "flag": "bool or null",
}  # in a Parquet file, which needs no text

Kind: TypeAlias = Literal["int", "float", "text", "number", "flag"]
_Row: TypeAlias = tuple[int, list[str]]  # the line of the file on which it ends, and its texts

_DTYPES: Mapping[Kind, type] = {
    "int": np.int64,
    "float": np.float64,
    "text": object,
    "number": np.float64,
    "flag": object,
}
_FLAGS: Mapping[str, bool | None] = {
    "true": True, "1": True, "false": False, "0": False, "": None,
}  # fmt: skip


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Attributes
    ----------
    name : str
    unit : str
        As it stands in the documentation; empty when the values have none.
    meaning : str
        One sentence, without its full stop.
    kind : {'int', 'float', 'text', 'number', 'flag'}
        What the values are: int64, float64, str, the number of a thing that may be missing
        (float64, then NaN, as pandas reads it), or a bool that may be missing (then None).
    spec : str
        Format specification of a number; empty for the shortest text that reads back
        as the same value.
    """

    name: str
    unit: str
    meaning: str
    kind: Kind = "float"
    spec: str = ""

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the array that reading gives."""
        return np.dtype(_DTYPES[self.kind])

    @property
    def format(self) -> str:
        """How the values are written, for people."""
        if self.kind == "float":
            decimals = self.spec[1:-1]
            plural = "" if decimals == "1" else "s"
            return f"{decimals} decimal{plural}" if decimals else "shortest exact"
        return {
            "int": "integer",
            "text": "text",
            "number": "integer or empty",
            "flag": "`true`, `false` or empty",
        }[self.kind]

    def encode(self, value: Any) -> str:
        """Write one value.

        Parameters
        ----------
        value : int, float, str, bool or None

        Returns
        -------
        str
            Empty for what is missing: not a number, or a flag that is None.
        """
        if self.kind == "text":
            return str(value)
        if self.kind == "flag":
            return "" if value is None else str(bool(value)).lower()
        if self.kind == "int":
            return str(int(value))
        number = float(value)
        if math.isnan(number):
            return ""
        if self.kind == "number":
            return str(int(number))
        text = format(number, self.spec)
        # Rounding can leave a sign on nothing, and "-0.000" differs from "0.000" in bytes.
        return format(0.0, self.spec) if float(text) == 0.0 else text

    def decode(self, texts: Sequence[str]) -> NDArray[Any]:
        """Read the values of the column.

        Parameters
        ----------
        texts : sequence of str

        Returns
        -------
        (N,) int64, float64 or object (str, bool or None)

        Raises
        ------
        ValueError
            If a text is not a value of the column's kind.
        """
        if self.kind == "int":
            return np.array([int(text) for text in texts], dtype=np.int64)
        if self.kind == "float":
            return np.array([float(text or "nan") for text in texts], dtype=np.float64)
        if self.kind == "number":
            return np.array([int(text) if text else np.nan for text in texts], dtype=np.float64)
        if self.kind == "flag":
            return np.array([_flag(text) for text in texts], dtype=object)
        return np.array(texts, dtype=object)


@dataclass(frozen=True)
class Table:
    """One file of a run or of a truth: CSV, or Parquet by its name.

    Attributes
    ----------
    file_name : str
    meaning : str
        What a row is, for the documentation.
    columns : tuple of Column
        In the order in which they are written.
    deterministic : bool
        Whether the same flight and configuration give the same bytes again.
    repeated : str
        What "again" is, for the documentation.
    """

    file_name: str
    meaning: str
    columns: tuple[Column, ...]
    deterministic: bool
    repeated: str = "the same flight is processed again"

    @property
    def name(self) -> str:
        """File name without its extension."""
        return self.file_name.rpartition(".")[0]

    @property
    def column_names(self) -> tuple[str, ...]:
        """Names of the columns, in order."""
        return tuple(column.name for column in self.columns)

    def encode(self, values: Mapping[str, Iterable[Any]]) -> str:
        """Write the table as CSV text.

        Parameters
        ----------
        values : mapping of str to sequence
            The values of every column, by name, all of the same length.

        Returns
        -------
        str
            A header and one line per row, each ended by a line feed.

        Raises
        ------
        ShapeError
            If a column is missing, unknown or of another length than the first.
        """
        if set(values) != set(self.column_names):
            wrong = ", ".join(sorted(set(values) ^ set(self.column_names)))
            raise ShapeError(f"{self.file_name}: missing or unknown columns: {wrong}")
        texts = [[column.encode(v) for v in values[column.name]] for column in self.columns]
        if len({len(column) for column in texts}) > 1:
            raise ShapeError(f"{self.file_name}: the columns differ in length")
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(self.column_names)
        writer.writerows(zip(*texts, strict=True))
        return buffer.getvalue()

    def decode(
        self, text: str, where: str | None = None, required: Iterable[str] | None = None
    ) -> ColumnArrays:
        """Read the table from CSV text.

        Parameters
        ----------
        text : str
        where : str, optional
            What to call the text in an error; the file name without it.
        required : iterable of str, optional
            Columns that must be there; all that are declared without it.

        Returns
        -------
        mapping of str to (N,) array
            The declared columns that are there, in their order. Columns that are not
            declared, such as those of a later version, are left out.

        Raises
        ------
        RunError
            If a required column is missing or a value is not of its kind.
        """
        where = where or self.file_name
        header, rows = _split_rows(text, where)
        required = self.column_names if required is None else required
        missing = [name for name in required if name not in header]
        if missing:
            raise RunError(f"{where}: has no column {', '.join(missing)}")
        return {
            column.name: _decode_column(column, header.index(column.name), rows, where)
            for column in self.columns
            if column.name in header
        }

    def documentation(self) -> str:
        """Describe the table for people.

        Returns
        -------
        str
            Markdown: the meaning, then a table with a row per column.
        """
        is_text = self.file_name.endswith(".csv")
        stability = "The same bytes" if self.deterministic else "Other numbers"
        lines = [
            f"{self.meaning} {stability} when {self.repeated}.",
            "",
            f"| column | unit | {'written as' if is_text else 'type'} | meaning |",
            "|---|---|---|---|",
        ]
        lines += [
            f"| `{column.name}` | {column.unit or '–'} | "
            f"{column.format if is_text else _STORED[column.kind]} | {column.meaning} |"
            for column in self.columns
        ]
        return "\n".join(lines) + "\n"


def _flag(text: str) -> bool | None:
    """Read true, false or nothing; other programs write them in capitals, or as 1 and 0."""
    if text.lower() not in _FLAGS:
        raise ValueError(f"{text!r} is neither true nor false")
    return _FLAGS[text.lower()]


def _split_rows(text: str, where: str) -> tuple[list[str], list[_Row]]:
    """Header and rows of CSV text, every row as long as the header."""
    reader = csv.reader(io.StringIO(text), strict=True)
    try:
        lines = [(reader.line_num, row) for row in reader]
    except csv.Error as error:
        raise RunError(f"{where}: is not a CSV table: line {reader.line_num}: {error}") from error
    if not lines:
        raise RunError(f"{where}: is empty, not even a header")
    header, rows = lines[0][1], [(line, row) for line, row in lines[1:] if row]
    for number, (line, row) in enumerate(rows, start=1):
        if len(row) != len(header):
            raise RunError(
                f"{where}: row {number} has {len(row)} values, the header {len(header)}; "
                f"it ends on line {line}"
            )
    return header, rows


def _decode_column(column: Column, place: int, rows: Sequence[_Row], where: str) -> NDArray[Any]:
    """Values of a column; an error names the line."""
    try:
        return column.decode([row[place] for _, row in rows])
    except (ValueError, OverflowError):
        for line, row in rows:
            try:
                column.decode([row[place]])
            except (ValueError, OverflowError) as error:
                raise RunError(f"{where}: column {column.name}: line {line}: {error}") from error
        raise
