"""Figures as people read them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from beamseg_batch.evaluation.measures import Measure, Metrics

__all__ = ["SpreadRow", "number", "percent", "spread_rows"]

_SHOWN_AS = {"m": ("mm", 1e3), "rad": ("mrad", 1e3)}


@dataclass(frozen=True)
class SpreadRow:
    """A measure in a table: its `name`, its figures as text, the `unit` they are in."""

    name: str
    figures: tuple[str, ...]
    unit: str
    meaning: str


def spread_rows(measures: Iterable[Measure], metrics: Metrics) -> list[SpreadRow]:
    """Write the spreads that have a value.

    Parameters
    ----------
    measures : iterable of Measure
    metrics : Metrics

    Returns
    -------
    list of SpreadRow
        Median, 95th percentile and maximum each; metres and radians in thousandths.
    """
    rows = []
    for measure in measures:
        values = [metrics[name] for name in measure.metric_names]
        if measure.is_spread and None not in values:
            unit, factor = _SHOWN_AS.get(measure.unit, (measure.unit, 1.0))
            figures = tuple(number(value, factor) for value in values)
            rows.append(SpreadRow(measure.name, figures, unit, measure.meaning))
    return rows


def number(value: float | None, factor: float = 1.0) -> str:
    """Write a number with three significant digits, and all before the point; or a dash."""
    if value is None or math.isnan(value):
        return "–"
    scaled = value * factor
    decimals = next((d for d, low in ((0, 100.0), (1, 10.0), (2, 1.0)) if abs(scaled) >= low), 3)
    return f"{scaled:.{decimals}f}"


def percent(value: float | None) -> str:
    """Write a share; or a dash."""
    return "–" if value is None else f"{100.0 * value:.1f} %"
