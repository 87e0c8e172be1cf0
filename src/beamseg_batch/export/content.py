"""What of a run goes into a file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.bars import Bar, bars_of
from beamseg_batch.errors import RunError
from beamseg_batch.export.geodesy import Origin
from beamseg_batch.geometry import FloatArray, line_parameters
from beamseg_batch.outputs import Run
from beamseg_batch.tables import JOINTS, MEMBERS, SEGMENTS, ColumnArrays, Table

__all__ = ["Content", "Points", "What"]

What = Literal["beams", "members", "joints", "points"]
"""What can be exported: whole beams, their parts between joints, joints, supporting points."""


@dataclass(frozen=True, eq=False)
class Points:
    """Points on the beams, each with the number of its beam.

    Attributes
    ----------
    positions : (N, 3) float32, metres, world frame
    beams : (N,) int32
    """

    positions: NDArray[np.float32]
    beams: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Content:
    """A run, and which part of it is asked for.

    Attributes
    ----------
    run : Run
    what : What
    origin : Origin or None
        Where the world frame lies on the earth.
    turn : (3, 3) float64
        Rotation from the world frame to the axes of a mesh file.
    """

    run: Run
    what: What
    origin: Origin | None
    turn: FloatArray

    @cached_property
    def bars(self) -> list[Bar]:
        """Whole beams if they are asked for, else members."""
        self._check(MEMBERS, "segment", SEGMENTS)
        self._check(MEMBERS, "joint_1", JOINTS)
        self._check(MEMBERS, "joint_2", JOINTS)
        bars = bars_of(self.tables, "beams" if self.what == "beams" else "members")
        for bar in bars:
            if not (np.isfinite(bar.nodes).all() and bar.section.radius > 0.0):
                raise RunError(
                    f"{self.run.folder}: beam {bar.beam} has no ends or no radius; run the flight "
                    "again"
                )
        return bars

    def refuse_none(self, count: int, path: Path) -> None:
        """Refuse to write nothing into a file that must hold something."""
        if not count:
            raise RunError(
                f"{self.run.folder}: holds no {self.what}, and a {path.suffix} file cannot be empty"
            )

    def _check(self, table: Table, column: str, of: Table) -> None:
        """Refuse numbers of things that are not there."""
        numbers = self.tables[table.name][column]
        count = len(self.tables[of.name][of.column_names[0]])
        if np.any((numbers < 0) | (numbers >= count)):
            file = self.run.folder / table.file_name
            raise RunError(f"{file}: column {column} names a row that {of.file_name} does not have")

    @property
    def tables(self) -> dict[str, ColumnArrays]:
        """Columns of the run's tables, by name."""
        return dict(self.run.columns)

    @property
    def joints(self) -> FloatArray:
        """(J, 3) float64, metres, world frame: positions of the joints."""
        columns = self.tables[JOINTS.name]
        return np.column_stack([columns[axis] for axis in "xyz"]).reshape(-1, 3)

    @cached_property
    def points(self) -> Points:
        """Points of the run's thinned cloud that lie on a beam."""
        cloud = self.run.structure["cloud"]
        nearest = np.full(len(cloud), np.inf)
        beams = np.full(len(cloud), -1, dtype=np.int32)
        where = cloud.astype(np.float64)
        for number, beam in enumerate(self.run.segments):
            reach = 2.0 * beam.radius  # the surface, whether the axis is behind it or on it
            t = line_parameters(where, beam.anchor, beam.direction)
            close = np.flatnonzero((t >= beam.t_min - reach) & (t <= beam.t_max + reach))
            off = np.linalg.norm(where[close] - beam.points_at(t[close]), axis=1)
            closer = (off <= reach) & (off < nearest[close])
            nearest[close[closer]], beams[close[closer]] = off[closer], number
        on_beam = beams >= 0
        return Points(cloud[on_beam], beams[on_beam])
