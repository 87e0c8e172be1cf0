"""What a run claims: its folder, or any folder with the original node's columns."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.errors import ConfigError, RunError
from beamseg_batch.evaluation.files import read_text, require_finite, require_unique, vectors
from beamseg_batch.evaluation.matching import Lines
from beamseg_batch.geometry import FloatArray, clusters
from beamseg_batch.tables import (
    INTERSECTIONS,
    JOINTS,
    PROCESSING_TIME,
    SEGMENTS,
    Column,
    ColumnArrays,
    Table,
)

__all__ = ["SIGMAS", "Result", "Timing", "load_result", "read_timing"]

SIGMAS = ("offset", "angle_deg", "radius", "end_1", "end_2", "bow")
"""Standard deviations that a run may claim, in columns ``sigma_…``."""

_ANCHOR, _DIRECTION = ("a_x", "a_y", "a_z"), ("b_x", "b_y", "b_z")
_ORIGINAL = ("segment", *_ANCHOR, *_DIRECTION, "t_min", "t_max")
_MAY_BE_THERE = ("bow", "measured_radius", *(f"sigma_{name}" for name in SIGMAS))
# All that is needed of joints: a table of another program may name the rest as it likes.
_JOINT_PLACES = replace(
    JOINTS, columns=tuple(column for column in JOINTS.columns if column.name in "xyz")
)


def _with_optional(table: Table, names: tuple[str, ...]) -> Table:
    """Let a table read columns that not every run has."""
    more = (Column(name, "", name) for name in names if name not in table.column_names)
    return Table(table.file_name, table.meaning, (*table.columns, *more), table.deterministic)


@dataclass(frozen=True, eq=False)
class Result:
    """Segments and joints that a run claims. Metres, world frame.

    Attributes
    ----------
    source : str
        The folder.
    numbers : (S,) int64
        Numbers of the segments, as their table has them.
    axes : Lines
        S of them, from the end at `t_min` to that at `t_max`.
    radii : (S,) float64
    shapes : tuple of str, or None
    bows : (S,) float64, or None
        Never negative.
    measured_radii : (S,) float64, metres, or None
        Radii that were measured freely, where the run tells them.
    sigmas : mapping of str to (S,) float64
        Those of `SIGMAS` that the run claims; NaN where it does not.
    touching : (K, 2) int64, or None
        Pairs of segments that intersect, by row of their table, the lower first.
    joints : (J, 3) float64, or None
        None if the run says nothing of joints or intersections.
    notes : tuple of str
    """

    source: str
    numbers: NDArray[np.int64]
    axes: Lines
    radii: FloatArray
    shapes: tuple[str, ...] | None
    bows: FloatArray | None
    measured_radii: FloatArray | None
    sigmas: Mapping[str, FloatArray]
    touching: NDArray[np.int64] | None
    joints: FloatArray | None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Timing:
    """What a run took: milliseconds per scan, the median; seconds in all. None: not known."""

    median_ms: float | None
    wall_s: float | None


def load_result(folder: Path, radius: float | None = None) -> Result:
    """Read what a run claims.

    Parameters
    ----------
    folder : Path
        With ``segments.csv``, of which the original columns are needed. Joints are those of
        ``joints.csv``, else ``intersections.csv`` gathered to joints.
    radius : float, optional
        Radius of all segments, metres, if the table has none.

    Returns
    -------
    Result

    Raises
    ------
    RunError
        If the folder holds no such tables, or broken ones.
    ConfigError
        If the table has no radius and none is given.
    """
    file = folder / SEGMENTS.file_name
    if not file.is_file():
        what = "has no" if folder.is_dir() else "is no folder with a"
        raise RunError(f"{folder} {what} {SEGMENTS.file_name}")
    table = _with_optional(SEGMENTS, _MAY_BE_THERE)
    columns = table.decode(read_text(file), str(file), _ORIGINAL)
    require_finite(columns, _ORIGINAL[1:], str(file))
    require_unique(columns["segment"].tolist(), "segment", str(file))
    _require_sound_claims(columns, str(file))
    axes = _axes(columns, str(file))
    radii = _radii(columns, radius, str(file))
    touching, joints = _joints(folder, columns, radii)
    bows = columns.get("bow")
    return Result(
        source=str(folder),
        numbers=columns["segment"],
        axes=axes,
        radii=radii,
        shapes=tuple(columns["shape"].tolist()) if "shape" in columns else None,
        bows=None if bows is None else np.abs(bows),
        measured_radii=_claimed(columns, "measured_radius"),
        sigmas=_sigmas(columns),
        touching=touching,
        joints=joints,
        notes=() if joints is not None else (f"{folder} says nothing of joints",),
    )


def _sigmas(columns: ColumnArrays) -> dict[str, FloatArray]:
    """Deviations that are claimed: a column that is empty throughout claims nothing."""
    sigmas = {name: _claimed(columns, f"sigma_{name}") for name in SIGMAS}
    return {name: values for name, values in sigmas.items() if values is not None}


def _claimed(columns: ColumnArrays, name: str) -> FloatArray | None:
    """Return a column, unless it is missing or empty throughout."""
    values = columns.get(name)
    return values if values is not None and np.isfinite(values).any() else None


def _require_sound_claims(columns: ColumnArrays, where: str) -> None:
    """Refuse deviations that are none; an empty one claims nothing."""
    for name in (name for name in _MAY_BE_THERE if name in columns):
        values = np.nan_to_num(columns[name], nan=0.0, posinf=np.inf, neginf=-np.inf)
        require_finite({name: values}, (name,), where)
        if name.startswith("sigma_") and (values < 0.0).any():
            row = int(np.argmax(values < 0.0))
            raise RunError(
                f"{where}: row {row + 1}: {name} is {values[row]:g}, but must not be negative"
            )


def read_timing(folder: Path) -> Timing:
    """Read what a run took, as far as its folder tells.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    Timing
        From ``processing_time.csv``; the whole time rather from ``summary.json``.

    Raises
    ------
    RunError
        If one of the files is broken.
    """
    file = folder / PROCESSING_TIME.file_name
    median_ms = wall_s = None
    if file.is_file():
        columns = PROCESSING_TIME.decode(
            read_text(file), str(file), ("wall_time", "processing_time")
        )
        if len(columns["wall_time"]):
            median_ms = float(np.median(columns["processing_time"])) / 1e3
            wall_s = float(columns["wall_time"][-1]) / 1e6
    return Timing(median_ms, _summary_wall_s(folder / "summary.json", wall_s))


def _summary_wall_s(file: Path, otherwise: float | None) -> float | None:
    if not file.is_file():
        return otherwise
    try:
        wall_s = float(json.loads(read_text(file))["totals"]["wall_s"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise RunError(f"{file}: has no totals.wall_s: {error}") from error
    if not math.isfinite(wall_s):
        raise RunError(f"{file}: totals.wall_s is {wall_s}, not a number")
    return wall_s


def _axes(columns: ColumnArrays, where: str) -> Lines:
    """Axes between the ends, whatever the length of the direction that the table has."""
    anchors, directions = vectors(columns, _ANCHOR), vectors(columns, _DIRECTION)
    norms = np.linalg.norm(directions, axis=1)
    if not (norms > 0.0).all():
        row = int(np.argmin(norms > 0.0))
        raise RunError(f"{where}: row {row + 1}: the direction b_x, b_y, b_z is zero")
    reach = columns["t_max"] - columns["t_min"]
    forward = np.where(reach < 0.0, -1.0, 1.0)
    starts = anchors + columns["t_min"][:, None] * directions
    return Lines(starts, directions * (forward / norms)[:, None], np.abs(reach) * norms)


def _radii(columns: ColumnArrays, radius: float | None, where: str) -> FloatArray:
    if "radius" in columns:
        require_finite(columns, ("radius",), where)
        radii: FloatArray = columns["radius"]
        if not (radii > 0.0).all():
            row = int(np.argmin(radii > 0.0))
            raise RunError(f"{where}: row {row + 1}: radius {radii[row]:g} must be above 0")
        return radii
    if radius is None:
        raise ConfigError(f"{where}: has no column radius; give it, such as --radius 0.05")
    return np.full(len(columns["segment"]), radius)


def _joints(
    folder: Path, segments: ColumnArrays, radii: FloatArray
) -> tuple[NDArray[np.int64] | None, FloatArray | None]:
    """Segments that touch, and joints: of the run, or its intersections gathered."""
    touching = joints = None
    file = folder / INTERSECTIONS.file_name
    if file.is_file():
        columns = INTERSECTIONS.decode(read_text(file), str(file), INTERSECTIONS.column_names[:4])
        touching = _rows_of(columns, segments, str(file))
        positions = _positions(columns, touching, segments, str(file))
        groups = clusters(positions, radii[touching].sum(axis=1))
        joints = np.array([positions[group].mean(axis=0) for group in groups]).reshape(-1, 3)
        touching = np.sort(touching, axis=1)
    file = folder / JOINTS.file_name
    if file.is_file():
        columns = _JOINT_PLACES.decode(read_text(file), str(file))
        require_finite(columns, "xyz", str(file))
        joints = vectors(columns, "xyz")
    return touching, joints


def _rows_of(columns: ColumnArrays, segments: ColumnArrays, where: str) -> NDArray[np.int64]:
    rows = {int(number): row for row, number in enumerate(segments["segment"])}
    touching = np.stack([columns["seg1"], columns["seg2"]], axis=1)
    for row, number in ((r, int(n)) for r, pair in enumerate(touching) for n in pair):
        if number not in rows:
            raise RunError(
                f"{where}: row {row + 1}: there is no segment {number} in {SEGMENTS.file_name}"
            )
    found = [[rows[int(number)] for number in pair] for pair in touching]
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def _positions(
    columns: ColumnArrays, touching: NDArray[np.int64], segments: ColumnArrays, where: str
) -> FloatArray:
    """Where intersections are: as the table says, else halfway between the two axes."""
    if all(axis in columns for axis in "xyz"):
        require_finite(columns, "xyz", where)
        return vectors(columns, "xyz")
    require_finite(columns, ("t1", "t2"), where)
    anchors, directions = vectors(segments, _ANCHOR), vectors(segments, _DIRECTION)
    on_axes = [
        anchors[touching[:, k]] + columns[f"t{k + 1}"][:, None] * directions[touching[:, k]]
        for k in (0, 1)
    ]
    return (on_axes[0] + on_axes[1]) / 2.0
