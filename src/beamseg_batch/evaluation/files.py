"""Files in and out: text, columns of tables, and writing that leaves all or nothing."""

from __future__ import annotations

import contextlib
import secrets
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from beamseg_batch.errors import OutputError, RunError
from beamseg_batch.geometry import FloatArray
from beamseg_batch.tables import ColumnArrays

__all__ = ["read_text", "require_finite", "require_unique", "vectors", "write_text"]

_LIMIT = 1e6
"""Largest size of a number: far beyond any structure, and its square is still one."""


def read_text(path: Path) -> str:
    """Read a file as UTF-8, with or without a byte order mark; `RunError` if that fails."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise RunError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise RunError(f"{path}: is not UTF-8 text: {error.reason}") from error


def write_text(path: Path, text: str) -> None:
    """Write a file, or leave what is there.

    Parameters
    ----------
    path : Path
        A file of that name is replaced; folders on the way are created.
    text : str

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(text, encoding="utf-8", newline="\n")
        part.replace(path)
    except FileExistsError as error:
        raise OutputError(f"{path}: cannot be written: {path.parent} is no folder") from error
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def vectors(columns: ColumnArrays, names: Sequence[str]) -> FloatArray:
    """Stack columns side by side: (N, len(names)) float64."""
    return np.stack([columns[name].astype(np.float64) for name in names], axis=1)


def require_finite(columns: ColumnArrays, names: Iterable[str], where: str) -> None:
    """Refuse columns that hold no number somewhere, or one beyond 1e6.

    Parameters
    ----------
    columns : mapping of str to (N,) array
    names : iterable of str
        Columns to look at.
    where : str
        The file, for the error.

    Raises
    ------
    RunError
        If a value is missing, NaN, infinite or too large; it names the first such row.
    """
    for name in names:
        wrong = np.flatnonzero(~np.isfinite(columns[name]))
        if len(wrong):
            value = columns[name][wrong[0]]
            raise RunError(f"{where}: row {wrong[0] + 1}: {name} is {value}, not a number")
        beyond = np.flatnonzero(np.abs(columns[name]) > _LIMIT)
        if len(beyond):
            value = columns[name][beyond[0]]
            raise RunError(
                f"{where}: row {beyond[0] + 1}: {name} is {value:g}, beyond the limit {_LIMIT:g}"
            )


def require_unique(names: Iterable[object], what: str, where: str) -> None:
    """Refuse a name that stands in two rows.

    Parameters
    ----------
    names : iterable
        Of the rows, in order.
    what : str
        What they name, for the error: ``member``.
    where : str
        The file, likewise.

    Raises
    ------
    RunError
        It names both rows.
    """
    rows: dict[object, int] = {}
    for row, name in enumerate(names, start=1):
        if rows.setdefault(name, row) != row:
            raise RunError(f"{where}: row {row}: {what} {name!r} is in row {rows[name]} already")
