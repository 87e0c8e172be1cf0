"""Tables and points as Parquet, by pyarrow."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from beamseg_batch.export.content import Content
from beamseg_batch.extras import load_extra
from beamseg_batch.tables import JOINTS, MEMBERS, SEGMENTS, Column

__all__ = ["write_parquet"]

_TABLES = {"beams": SEGMENTS, "members": MEMBERS, "joints": JOINTS}


def write_parquet(content: Content, path: Path) -> int:
    """Write a table as it stands, units and meanings in the metadata of its columns."""
    purpose = f"a {path.suffix} file"
    arrow = load_extra("pyarrow", purpose)
    table = _points(arrow, content) if content.what == "points" else _table(arrow, content)
    load_extra("pyarrow.parquet", purpose).write_table(table, path)
    return int(table.num_rows)


def _table(arrow: Any, content: Content) -> Any:
    table = _TABLES[content.what]
    values = content.tables[table.name]
    columns = [column for column in table.columns if column.name in values]
    arrays = [_array(arrow, column, values[column.name]) for column in columns]
    described = [
        arrow.field(c.name, array.type, metadata={"unit": c.unit, "meaning": c.meaning})
        for c, array in zip(columns, arrays, strict=True)
    ]
    return arrow.table(arrays, schema=arrow.schema(described))


def _array(arrow: Any, column: Column, values: Any) -> Any:
    """Values of a column; what is missing is null, and the number of a thing an integer."""
    kinds = {"int": "int64", "float": "float64", "text": "string", "number": "int64",
             "flag": "bool_"}  # fmt: skip
    as_kind = getattr(arrow, kinds[column.kind])()
    if column.kind == "number":
        values = [None if math.isnan(value) else int(value) for value in values.tolist()]
    return arrow.array(values, type=as_kind, from_pandas=True)


def _points(arrow: Any, content: Content) -> Any:
    points = content.points
    columns = dict(zip("xyz", points.positions.T.copy(), strict=True))
    return arrow.table({**columns, "beam": points.beams})
