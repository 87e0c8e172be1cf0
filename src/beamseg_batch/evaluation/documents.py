"""Evaluations and comparisons as JSON, for machines."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from beamseg_batch.evaluation.comparison import Comparison, Move
from beamseg_batch.evaluation.gates import Check
from beamseg_batch.evaluation.measures import EndError, Evaluation, Match

__all__ = ["SCHEMA_VERSION", "comparison_json", "evaluation_json"]

SCHEMA_VERSION = 1
"""Raised when a key changes its name or its meaning."""


def evaluation_json(evaluation: Evaluation, checks: Sequence[Check] = ()) -> str:
    """Write an evaluation as strict JSON.

    Parameters
    ----------
    evaluation : Evaluation
    checks : sequence of Check
        Outcomes of its gates.

    Returns
    -------
    str
        The keys are always the same. Metres and degrees; what is not known is null.
    """
    truth, result = evaluation.truth, evaluation.result
    joints = evaluation.joints
    return _document(
        {
            "run": result.source,
            "truth": truth.source,
            "notes": list(evaluation.notes),
            "metrics": dict(evaluation.metrics),
            "gates": [asdict(check) for check in checks],
            "matches": [_match(evaluation, match) for match in evaluation.matches],
            "missed": [truth.names[member] for member in evaluation.missed],
            "segments": [
                {
                    "segment": int(number),
                    "verdict": verdict,
                    "member": None if member is None else truth.names[member],
                }
                for number, verdict, member in zip(
                    result.numbers, evaluation.verdicts, evaluation.nearest, strict=True
                )
            ],
            "joints_missed": [
                {
                    "members": [truth.names[m] for m in truth.joints[joint].members],
                    "position": truth.joints[joint].position.tolist(),
                }
                for joint in (joints.missed if joints else ())
            ],
            "joints_invented": [
                result.joints[joint].tolist()
                for joint in (joints.invented if joints else ())
                if result.joints is not None
            ],
            "shapes": {true: dict(claimed) for true, claimed in evaluation.shapes.items()},
        }
    )


def comparison_json(comparison: Comparison, checks: Sequence[Check]) -> str:
    """Write a comparison as strict JSON.

    Parameters
    ----------
    comparison : Comparison
    checks : sequence of Check

    Returns
    -------
    str
        The keys are always the same. Metres and degrees; what is not known is null.
    """
    a, b = comparison.a, comparison.b
    return _document(
        {
            "a": a.source,
            "b": b.source,
            "tolerances": asdict(comparison.tolerances),
            "metrics": dict(comparison.metrics),
            "checks": [asdict(check) for check in checks],
            "tables": comparison.tables,
            "vanished": [int(a.numbers[segment]) for segment in comparison.vanished],
            "appeared": [int(b.numbers[segment]) for segment in comparison.appeared],
            "moved": [_move(comparison, move) for move in comparison.moved],
            "intersections_vanished": [
                [int(a.numbers[segment]) for segment in pair]
                for pair in comparison.touching_vanished
            ],
            "intersections_appeared": [
                [int(b.numbers[segment]) for segment in pair]
                for pair in comparison.touching_appeared
            ],
            "joints_vanished": _places(a.joints, comparison.joints_vanished),
            "joints_appeared": _places(b.joints, comparison.joints_appeared),
        }
    )


def _document(content: Mapping[str, Any]) -> str:
    return json.dumps({"schema_version": SCHEMA_VERSION, **content}, indent=2, allow_nan=False)


def _match(evaluation: Evaluation, match: Match) -> dict[str, Any]:
    truth, result = evaluation.truth, evaluation.result
    return {
        "member": truth.names[match.member],
        "segment": int(result.numbers[match.segment]),
        "axis_offset": match.axis_offset,
        "angle_deg": match.angle_deg,
        "coverage": match.coverage,
        "midpoint_distance": match.midpoint_distance,
        "radius_error": _number(match.radius_error),
        "measured_radius_error": _number(match.measured_radius_error),
        "bow_error": _number(match.bow_error),
        "ends": [_end(end) for end in match.ends],
    }


def _end(end: EndError) -> dict[str, Any]:
    return {
        "error": end.distance,
        "along": end.along,
        "member_error": end.member_distance,
        "member_along": end.member_along,
        "own": end.own,
    }


def _move(comparison: Comparison, move: Move) -> dict[str, Any]:
    return asdict(move) | {
        "a": int(comparison.a.numbers[move.a]),
        "b": int(comparison.b.numbers[move.b]),
    }


def _places(joints: Any, which: Sequence[int]) -> list[list[float]]:
    return [joints[joint].tolist() for joint in which]


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
