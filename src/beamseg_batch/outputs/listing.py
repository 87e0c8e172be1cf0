"""Tables of the report: what they show of the columns of a file, and in which units."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from beamseg_batch.tables import Column, ColumnArrays, Table

__all__ = ["Heading", "Listing", "Row", "listing"]

_MISSING = "–"
_LABELS: Mapping[str, str] = {
    "segment": "beam",
    "sigma_offset": "σ axis",
    "sigma_angle_deg": "σ angle",
    "sigma_end_1": "σ end 1",
    "sigma_end_2": "σ end 2",
    "sigma_bow": "σ bow",
    "sigma_radius": "σ radius",
    "section_confidence": "confidence",
    "measured_radius": "measured radius",
    "sigma_x": "σ x",
    "sigma_y": "σ y",
    "sigma_z": "σ z",
    "n_scans": "scans",
    "n_points": "points",
    "n_segments": "number of beams",
    "segments": "beams",
    "seg1": "beam 1",
    "seg2": "beam 2",
    "joint_1": "from joint",
    "joint_2": "to joint",
    "angle_deg": "angle",
    "first_seen_s": "first seen",
    "last_seen_s": "last seen",
}
_IN_MILLIMETRES = ("sigma_", "radius", "measured_radius", "bow", "distance", "residual")
_DECIMALS: Mapping[str, str] = {"m": ".3f", "mm": ".2f", "°": ".2f", "s": ".2f", "": ".4f"}


@dataclass(frozen=True)
class Heading:
    """Head of a column.

    Attributes
    ----------
    name : str
        As it stands in the file.
    unit : str
    meaning : str
    label : str
        The name for people; as in the file where it is empty.
    is_text : bool
        Whether its values are no numbers.
    is_detail : bool
        Whether it is shown only when all columns are asked for.
    """

    name: str
    unit: str
    meaning: str
    label: str = ""
    is_text: bool = False
    is_detail: bool = False

    @property
    def kind(self) -> str:
        """Classes of its cells in the page."""
        return " ".join("t" * self.is_text + "m" * self.is_detail)


@dataclass(frozen=True)
class Row:
    """Cells of a row, in HTML or as text, and the number of the beam that it is about."""

    cells: tuple[str, ...]
    beam: int | None = None


@dataclass(frozen=True)
class Listing:
    """A table of a page.

    Attributes
    ----------
    name : str
    caption : str
        What a row is.
    headings : tuple of Heading
    rows : tuple of Row
    total : int
        Rows that there are, of which `rows` are the first.
    file : str
        Where all of them are.
    """

    name: str
    caption: str
    headings: tuple[Heading, ...]
    rows: tuple[Row, ...]
    total: int
    file: str


def listing(
    table: Table,
    columns: ColumnArrays,
    shown: Collection[str],
    beam_column: str | None,
    max_rows: int,
) -> Listing:
    """Show a table of a run.

    Parameters
    ----------
    table : Table
    columns : mapping of str to (N,) array
        Its values.
    shown : collection of str
        Columns that are shown at once, unless they are empty; the others on demand.
    beam_column : str, optional
        The column that holds the number of a beam, which a row then is about.
    max_rows : int

    Returns
    -------
    Listing
    """
    headings, texts = [], []
    for column in table.columns:
        values = columns[column.name][:max_rows]
        unit = _unit(column)
        texts.append([_text(column, unit, value) for value in values])
        is_empty = all(text == _MISSING for text in texts[-1])
        headings.append(
            Heading(
                column.name,
                unit,
                column.meaning,
                _LABELS.get(column.name, ""),
                column.kind in ("text", "flag"),
                column.name not in shown or is_empty,
            )
        )
    rows = tuple(
        Row(cells, int(columns[beam_column][number]) if beam_column else None)
        for number, cells in enumerate(zip(*texts, strict=True))
    )
    total = len(columns[table.column_names[0]])
    name = table.name.replace("_", "-")
    return Listing(name, table.meaning, tuple(headings), rows, total, table.file_name)


def _unit(column: Column) -> str:
    return "mm" if column.unit == "m" and column.name.startswith(_IN_MILLIMETRES) else column.unit


def _text(column: Column, unit: str, value: Any) -> str:
    """Value of a cell for people."""
    if value is None or value == "":
        return _MISSING
    if column.kind == "flag":
        return "yes" if value else "no"
    if column.kind in ("text", "int"):
        return str(value)
    number = float(value)
    if math.isnan(number):
        return _MISSING
    if column.kind == "number":
        return str(int(number))
    if unit == "m²":
        return f"{number:.2e}"
    text = format(1e3 * number if unit == "mm" else number, _DECIMALS.get(unit, ".4g"))
    return text.removeprefix("-") if float(text) == 0.0 else text
