"""Timing that a noisy machine cannot fool: in turns, medians, ratios pair by pair."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["Measurement", "in_turns", "median_ms"]


@dataclass(frozen=True)
class Measurement:
    """One line of the results.

    Attributes
    ----------
    group, name : str
    value : float
    unit : str
    baseline : str
        What it is held against; empty for nothing.
    baseline_value : float or None
        In the same unit.
    ratio : float or None
        Baseline over value, as the median of the pairs: how many times less it takes.
    """

    group: str
    name: str
    value: float
    unit: str
    baseline: str = ""
    baseline_value: float | None = None
    ratio: float | None = None


def in_turns(
    group: str,
    name: str,
    ours: Sequence[Callable[[], object]],
    baseline_name: str,
    theirs: Sequence[Callable[[], object]],
    *,
    repeats: int = 1,
) -> Measurement:
    """Time two ways of doing the same tasks, task by task in turns.

    Parameters
    ----------
    group, name, baseline_name : str
    ours, theirs : sequence of callables
        One per task.
    repeats : int
        Times each task is done; the fastest counts.

    Returns
    -------
    Measurement
        Milliseconds a task.
    """
    pairs = np.array(
        [
            (_fastest_ms(one, repeats), _fastest_ms(other, repeats))
            for one, other in zip(ours, theirs, strict=True)
        ]
    )
    value, baseline = np.median(pairs, axis=0)
    ratio = float(np.median(pairs[:, 1] / pairs[:, 0]))
    return Measurement(group, name, float(value), "ms", baseline_name, float(baseline), ratio)


def median_ms(tasks: Sequence[Callable[[], object]], *, repeats: int = 1) -> float:
    """Median time of tasks in milliseconds, the fastest of `repeats` each."""
    return float(np.median([_fastest_ms(task, repeats) for task in tasks]))


def _fastest_ms(task: Callable[[], object], repeats: int) -> float:
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        task()
        times.append(time.perf_counter() - start)
    return min(times) * 1e3
