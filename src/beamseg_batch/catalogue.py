"""Standard sizes of rolled and hollow sections, as a catalogue in CSV lists them."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

from beamseg_batch.config import config_folder
from beamseg_batch.errors import ConfigError
from beamseg_batch.schema import nearest
from beamseg_batch.section import SHAPES, Section

__all__ = ["StandardSection", "load_catalogue"]

_COLUMNS = ("name", "shape", "width_mm", "height_mm", "web_mm", "flange_mm")
_SIZES = _COLUMNS[2:]


@dataclass(frozen=True)
class StandardSection:
    """A size that is made.

    Attributes
    ----------
    name : str
        Such as ``IPE 120``.
    section : Section
        The plates of a hollow section are not known: its outside alone can be seen.
    """

    name: str
    section: Section


def load_catalogue(path: Path | None = None) -> tuple[StandardSection, ...]:
    """Read a catalogue of standard sizes.

    Parameters
    ----------
    path : Path, optional
        CSV file with the columns ``name, shape, width_mm, height_mm, web_mm, flange_mm``, in
        any order, beside others; the shipped one without.

    Returns
    -------
    tuple of StandardSection
        In the order of the file.

    Raises
    ------
    ConfigError
        If the file cannot be read, lacks a column, or a value in it is not valid.
    """
    path = path or config_folder() / "sections.csv"
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = csv.DictReader(file, strict=True)
            missing = [name for name in _COLUMNS if name not in (rows.fieldnames or ())]
            if missing:
                raise ConfigError(
                    f"{path}: has no column {', '.join(missing)}; see structure.shapes.catalogue"
                )
            return tuple(_entry(row, f"{path}:{rows.line_num}") for row in rows)
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be read: {error.strerror}; see structure.shapes.catalogue"
        ) from error
    except (csv.Error, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: is not a CSV table: {error}") from error


def _entry(row: dict[str, str | None], where: str) -> StandardSection:
    name, shape = (row["name"] or "").strip(), (row["shape"] or "").strip()
    if not name:
        raise ConfigError(f"{where}: has no name")
    kinds = [kind for kind in SHAPES if kind != "round"]
    if shape not in kinds:
        raise ConfigError(
            f"{where}: shape {shape!r} of {name}{nearest(shape, kinds)} must be one of "
            f"{', '.join(kinds)}"
        )
    hollow = shape == "square"
    sizes = [_metres(row, column, where, hollow and column in _SIZES[2:]) for column in _SIZES]
    width, height, web, flange = sizes
    if not hollow and (web >= width or flange >= height / (1.0 if shape == "l" else 2.0)):
        raise ConfigError(f"{where}: web and flange of {name} do not fit its width and height")
    kind = next(kind for kind in kinds if kind == shape)
    return StandardSection(name, Section(kind, width, height, web, flange))


def _metres(row: dict[str, str | None], column: str, where: str, may_be_empty: bool) -> float:
    text = (row[column] or "").strip()
    if not text and may_be_empty:
        return 0.0
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < 1e4:
        raise ConfigError(f"{where}: {column} is {text!r}, but must be millimetres above 0")
    return value / 1000.0
