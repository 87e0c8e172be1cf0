"""Files of poses beside a recording: TUM text, and CSV with a header."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Iterator, Mapping
from decimal import Decimal
from pathlib import Path

from beamseg_batch.errors import PoseFileError
from beamseg_batch.recording.poses import PoseRecord, PoseTrack

__all__ = ["read_pose_file"]

_VALUES = ("x", "y", "z", "qx", "qy", "qz", "qw")
_STAMPS: Mapping[str, int] = {"stamp_ns": 1, "t": 1_000_000_000}
"""Columns that hold the stamp of a CSV file, and the nanoseconds of their unit."""


def read_pose_file(path: Path) -> PoseTrack:
    """Read the poses of a file.

    Parameters
    ----------
    path : Path
        ``.tum``: lines of ``t x y z qx qy qz qw``, seconds and metres, ``#`` for comments.
        ``.csv``: a header that names stamp_ns (integer nanoseconds) or t (seconds) and
        x, y, z, qx, qy, qz, qw, in any order among other columns.

    Returns
    -------
    PoseTrack
        ``T_world_body``; the file names no frames.

    Raises
    ------
    PoseFileError
        If the file cannot be read, or a line of it is not a pose.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise PoseFileError(f"{path}: a file of poses ends in {' or '.join(_READERS)}")
    track = PoseTrack(("", ""), from_log=True)
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            for line, stamp, unit, values in reader(stream):
                stamp_ns = _stamp_ns(line, stamp, unit)
                track.add(PoseRecord(stamp_ns, track.edge, _numbers(line, values)), stamp_ns)
    except OSError as error:
        raise PoseFileError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise PoseFileError(f"{path}: is not text in UTF-8") from error
    except _LineError as error:
        raise PoseFileError(f"{path}:{error.line}: {error}") from None
    except csv.Error as error:
        raise PoseFileError(f"{path}: is not CSV: {error}") from error
    return track


class _LineError(Exception):
    """A line has not the form that it should have."""

    def __init__(self, line: int, reason: str) -> None:
        super().__init__(reason)
        self.line = line


Row = tuple[int, str, int, list[str]]
"""Line, stamp, nanoseconds of the stamp's unit, and the seven values."""


def _stamp_ns(line: int, text: str, unit: int) -> int:
    """Whole nanoseconds of a stamp; a float would round those of our days to 200 ns."""
    try:
        return int(Decimal(text) * unit)
    except (ArithmeticError, ValueError):
        raise _LineError(line, f"{text!r} is not a stamp") from None


def _numbers(
    line: int, values: list[str]
) -> tuple[float, float, float, float, float, float, float]:
    try:
        x, y, z, qx, qy, qz, qw = (float(value) for value in values)
    except ValueError as error:
        raise _LineError(line, f"{error}") from None
    return x, y, z, qx, qy, qz, qw


def _tum_rows(lines: Iterable[str]) -> Iterator[Row]:
    for number, line in enumerate(lines, start=1):
        words = line.partition("#")[0].split()
        if words and len(words) != 8:
            raise _LineError(number, f"{len(words)} values; 8 are needed: t x y z qx qy qz qw")
        if words:
            yield number, words[0], 1_000_000_000, words[1:]


def _csv_rows(lines: Iterable[str]) -> Iterator[Row]:
    rows = csv.reader(lines)
    header = [name.strip().lstrip("#\ufeff ") for name in next(rows, [])]
    stamp = next((name for name in _STAMPS if name in header), None)
    missing = [name for name in _VALUES if name not in header]
    if stamp is None or missing:
        raise _LineError(
            1,
            "the header must name stamp_ns or t, and x, y, z, qx, qy, qz, qw; it is: "
            f"{', '.join(header) or 'empty'}",
        )
    columns = [header.index(name) for name in _VALUES]
    for row in rows:
        if not row:
            continue
        if len(row) != len(header):
            raise _LineError(rows.line_num, f"{len(row)} values under {len(header)} names")
        yield (
            rows.line_num,
            row[header.index(stamp)],
            _STAMPS[stamp],
            [row[column] for column in columns],
        )


_READERS: Mapping[str, Callable[[Iterable[str]], Iterator[Row]]] = {
    ".tum": _tum_rows,
    ".csv": _csv_rows,
}
