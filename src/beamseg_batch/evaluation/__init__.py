"""A run against truth, and a run against another."""

from __future__ import annotations

from beamseg_batch.evaluation.comparison import COMPARED, Comparison, Tolerances, compare
from beamseg_batch.evaluation.gates import Check, Gate, check_gates, load_gates
from beamseg_batch.evaluation.measures import (
    MEASURES,
    Evaluation,
    Measure,
    Metrics,
    evaluate,
    metric_names,
)
from beamseg_batch.evaluation.results import Result, load_result
from beamseg_batch.evaluation.truth import Truth, load_truth

__all__ = [
    "COMPARED",
    "MEASURES",
    "Check",
    "Comparison",
    "Evaluation",
    "Gate",
    "Measure",
    "Metrics",
    "Result",
    "Tolerances",
    "Truth",
    "check_gates",
    "compare",
    "evaluate",
    "load_gates",
    "load_result",
    "load_truth",
    "metric_names",
]
