"""Beams and members of a run as bars: an axis, and a cross-section along it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np

from beamseg_batch.geometry import FloatArray, section_frame
from beamseg_batch.model import BENT_M, BENT_SIGMAS
from beamseg_batch.prisms import Prism
from beamseg_batch.section import Section, Shape
from beamseg_batch.tables import MEMBERS, SEGMENTS, ColumnArrays

__all__ = ["Bar", "Parts", "bars_of", "beams_of", "section_name"]

Parts = Literal["beams", "members"]
"""Whole beams, or their parts between joints."""

_CHORD_ERROR = 1e-5  # of the straight pieces of a bowed axis, metres


@dataclass(frozen=True, eq=False, kw_only=True)
class Bar(Prism):
    """A beam, or the part of one between two joints or ends.

    Its section is round where the table knows no other shape.

    Attributes
    ----------
    number : int
        Row of its table: of `segments.csv` for a beam, of `members.csv` for a member.
    beam : int
        Number of the beam that it is, or is part of.
    radius : float, metres
        As the table has it.
    roll_deg : float, degrees
        Turn of the section about the axis.
    bow : (3,) float64, metres
        By how much its axis leaves its chord, midway; zero if it is straight.
    """

    number: int
    beam: int
    radius: float
    roll_deg: float = 0.0
    bow: FloatArray = field(default_factory=lambda: np.zeros(3))


def bars_of(tables: Mapping[str, ColumnArrays], parts: Parts) -> list[Bar]:
    """Bars of a run.

    Parameters
    ----------
    tables : mapping of str to columns
        Those of `segments` and `members`, by name.
    parts : Parts

    Returns
    -------
    list of Bar
        A row of the table each, in order; beams and members without length are left out.
    """
    beams = beams_of(tables[SEGMENTS.name])
    if parts == "beams":
        return [beam for beam in beams if beam.length != 0.0]
    columns, segments = tables[MEMBERS.name], tables[SEGMENTS.name]
    bars = []
    for i, beam_number in enumerate(columns["segment"].tolist()):
        beam = beams[beam_number]
        if beam.length == 0.0 or columns["t2"][i] <= columns["t1"][i]:
            continue
        if beam.bow.any():
            t_min, length = segments["t_min"][beam_number], segments["length"][beam_number]
            first, last = ((columns[name][i] - t_min) / length for name in ("t1", "t2"))
            nodes = _bowed(beam.start, beam.end, beam.bow, first, last)
        else:
            first, last = 0.0, 1.0
            nodes = np.array([_point(columns, i, 1), _point(columns, i, 2)])
        bars.append(replace(beam, number=i, nodes=nodes, bow=beam.bow * (last - first) ** 2))
    return bars


def beams_of(columns: ColumnArrays) -> list[Bar]:
    """Every beam of the columns of `segments.csv`, in order."""
    return [_beam(columns, i) for i in range(len(columns["segment"]))]


def section_name(section: Section) -> str:
    """Name of a cross-section, with its size in millimetres: ``ROUND-D100``, ``I-80x120``."""
    sizes = (section.width, section.height)
    width, height = (f"{1e3 * size:.1f}".removesuffix(".0") for size in sizes)
    if section.shape == "round":
        return f"ROUND-D{width}"
    return f"{section.shape.upper()}-{width}x{height}"


def _beam(columns: ColumnArrays, i: int) -> Bar:
    start, end = _point(columns, i, 1), _point(columns, i, 2)
    radius = float(columns["radius"][i])
    section = _section(columns, i, radius)
    roll_deg, bow = _number(columns, "roll_deg", i), _bow(columns, i)
    chord, rotation = end - start, np.eye(3)
    if chord.any():
        rotation = section_frame(chord / np.linalg.norm(chord), math.radians(roll_deg))
    nodes = _bowed(start, end, bow) if bow.any() else np.array([start, end])
    return Bar(
        section, nodes, rotation, number=i, beam=i, radius=radius, roll_deg=roll_deg, bow=bow
    )


def _bow(columns: ColumnArrays, i: int) -> FloatArray:
    """Deviation of a beam from its chord, where it is too large for a straight one."""
    bow = np.array([_number(columns, f"bow_{axis}", i) for axis in "xyz"])
    size = float(np.linalg.norm(bow))
    is_bent = size > max(BENT_M, BENT_SIGMAS * _number(columns, "sigma_bow", i))
    return bow if is_bent else np.zeros(3)


def _section(columns: ColumnArrays, i: int, radius: float) -> Section:
    """Cross-section of a beam; round where it is not known what else."""
    shape: Any = columns["shape"][i]
    sizes = [_number(columns, name, i) for name in ("width", "height", "web", "flange")]
    needed = sizes[:2] if shape == "square" else sizes
    if shape not in get_args(Shape) or shape == "round" or min(needed) <= 0.0:
        return Section("round", 2.0 * radius, 2.0 * radius)
    return Section(shape, *sizes)


def _bowed(
    start: FloatArray, end: FloatArray, bow: FloatArray, first: float = 0.0, last: float = 1.0
) -> FloatArray:
    """Nodes of a parabola over a chord, between two shares of it; `bow` is its rise."""
    rise = float(np.linalg.norm(bow)) * (last - first) ** 2
    n_pieces = max(1, math.ceil(math.sqrt(rise / _CHORD_ERROR)))
    share = np.linspace(first, last, n_pieces + 1)[:, None]
    nodes: FloatArray = start + share * (end - start) + 4.0 * share * (1.0 - share) * bow
    return nodes


def _point(columns: ColumnArrays, i: int, end: int) -> FloatArray:
    return np.array([columns[f"{axis}{end}"][i] for axis in "xyz"], dtype=np.float64)


def _number(columns: ColumnArrays, name: str, i: int) -> float:
    """Value of a column; zero where it is missing or empty."""
    value = float(columns[name][i]) if name in columns else 0.0
    return value if math.isfinite(value) else 0.0
