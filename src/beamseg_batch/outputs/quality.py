"""How well beams are known, and what is still in doubt of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from beamseg_batch.config import RunConfig
from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import Segment
from beamseg_batch.tables import ColumnArrays

__all__ = ["GRADES", "Doubt", "Grade", "bent", "doubts_of", "grade"]

_Kind: TypeAlias = Literal["axis", "end 1", "end 2"]

Grade: TypeAlias = Literal["good", "fair", "poor", "not judged"]

GRADES: dict[Grade, str] = {
    "good": "axis and both ends are known well",
    "fair": "the axis is known well, an end is not",
    "poor": "the axis is uncertain",
    "not judged": "the profile tells no deviations",
}
"""What the grades of a beam mean, best first."""

_BEND_SIGMAS, _BEND_M, _BEND_SHARE = 3.0, 0.005, 1.0 / 500.0
_TRIM_REACH_M = 0.1
_ENDS: tuple[_Kind, ...] = ("end 1", "end 2")


@dataclass(frozen=True)
class Doubt:
    """Something about a beam that another look would settle.

    Attributes
    ----------
    kind : {'axis', 'end 1', 'end 2'}
    text : str
        For people.
    cut : bool
        Whether the floor trim ends the beam there, so that no look would help.
    """

    kind: _Kind
    text: str
    cut: bool = False


def doubts_of(beam: Segment, config: RunConfig) -> tuple[Doubt, ...]:
    """List what is in doubt of a beam.

    Parameters
    ----------
    beam : Segment
    config : RunConfig
        Whose limits say what is good enough.

    Returns
    -------
    tuple of Doubt
        Nothing where nothing is known of how sure the beam is.
    """
    limits, found = config.outputs.fly_again, []
    if beam.sigma_offset > limits.max_sigma_offset:
        found.append(Doubt("axis", f"axis uncertain by {1e3 * beam.sigma_offset:.1f} mm"))
    elif beam.sigma_angle_deg > limits.max_sigma_angle_deg:
        found.append(Doubt("axis", f"direction uncertain by {beam.sigma_angle_deg:.2f}°"))
    for k, kind in enumerate(_ENDS):
        if beam.ends_seen is not None and not beam.ends_seen[k]:
            cut = _is_trimmed((beam.end_1, beam.end_2)[k], config)
            text = f"{kind} at the floor trim" if cut else f"{kind} not seen"
            found.append(Doubt(kind, text, cut))
        elif beam.sigma_ends[k] > limits.max_sigma_end:
            found.append(Doubt(kind, f"{kind} uncertain by {1e3 * beam.sigma_ends[k]:.0f} mm"))
    return tuple(found)


def grade(beam: Segment, doubts: Sequence[Doubt]) -> Grade:
    """Say in a word how well a beam is known.

    Parameters
    ----------
    beam : Segment
    doubts : sequence of Doubt
        Of this beam.

    Returns
    -------
    {'good', 'fair', 'poor', 'not judged'}
    """
    if np.isnan(beam.sigma_offset) and beam.ends_seen is None:
        return "not judged"
    if any(doubt.kind == "axis" for doubt in doubts):
        return "poor"
    return "fair" if any(not doubt.cut for doubt in doubts) else "good"


def bent(columns: ColumnArrays) -> list[bool]:
    """Say which beams are bent beyond doubt, and by more than a builder accepts.

    Parameters
    ----------
    columns : mapping of str to (N,) array
        Of `segments.csv`; without columns of the bow no beam is bent.

    Returns
    -------
    list of bool
        Per beam: bow above three of its deviations, and above 5 mm or 1/500 of the length.
    """
    length = columns["length"]
    none = np.zeros(len(length))
    bow: FloatArray = np.abs(columns.get("bow", none))
    sigma: FloatArray = np.nan_to_num(columns.get("sigma_bow", none))
    beyond_doubt = bow > _BEND_SIGMAS * sigma
    matters = (bow > _BEND_M) | (bow > _BEND_SHARE * length)
    return [bool(both) for both in beyond_doubt & matters]


def _is_trimmed(end: FloatArray, config: RunConfig) -> bool:
    """Whether a beam ends where the floor is cut off, below which nothing is a beam."""
    filtering = config.filtering
    low = float(end[2]) < filtering.floor_trim_height + _TRIM_REACH_M
    return filtering.floor_trim != "none" and low
