"""The search beside the C++ and the numpy baseline, and how it grows with the cloud."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.detection import iterative_hough
from benchmarks.baseline.cpp import cpp_baseline
from benchmarks.baseline.dense import dense_numpy
from benchmarks.timing import Measurement, in_turns, median_ms

__all__ = ["measure_search"]

Cloud = NDArray[np.float64]

RADIUS, RATIO = 0.05, 1.5
DX = np.sqrt(3.0) * RADIUS / RATIO
PARAMETERS = {"dx": DX, "minvotes": 12, "nlines": 10}
SIZES = (300, 1000, 3000, 10_000)


def measure_search(clouds: list[Cloud], *, quick: bool) -> Iterator[Measurement]:
    """Measure the search on the filtered scans of a flight and on clouds of many sizes.

    Parameters
    ----------
    clouds : list of (N, 3) float64, metres
        Filtered scans, floor trimmed.
    quick : bool
        Fewer scans and repetitions.

    Yields
    ------
    Measurement
    """
    for granularity, every in ((4, 1), (5, 4), (6, 10)):
        scans = clouds[:: every * (4 if quick else 1)]
        yield from _beside_cpp(scans, granularity)
    yield _beside_numpy(clouds[:: len(clouds) // 4])
    yield from _scaling(quick)


def _search(cloud: Cloud, granularity: int) -> object:
    return list(iterative_hough(cloud, granularity=granularity, **PARAMETERS))


def _beside_cpp(scans: list[Cloud], granularity: int) -> Iterator[Measurement]:
    _search(scans[0], granularity)
    ours = [partial(_search, cloud, granularity) for cloud in scans]
    name = f"granularity {granularity}, {len(scans)} scans"
    baseline = cpp_baseline()
    if baseline is None:
        yield Measurement("search", name, median_ms(ours, repeats=3), "ms")
        return
    _check_same_lines(scans, granularity)
    theirs = [partial(baseline, cloud, granularity=granularity, **PARAMETERS) for cloud in scans]
    yield in_turns("search", name, ours, "C++ -O3", theirs, repeats=2)


def _check_same_lines(scans: list[Cloud], granularity: int) -> None:
    """A ratio between two searches means nothing unless they find the same."""
    baseline = cpp_baseline()
    assert baseline is not None
    for cloud in scans[:: max(len(scans) // 10, 1)]:
        ours = list(iterative_hough(cloud, granularity=granularity, **PARAMETERS))
        theirs = baseline(cloud, granularity=granularity, **PARAMETERS)
        same = len(ours) == len(theirs) and all(
            one.votes == other.votes and np.array_equal(one.indices, other.indices)
            for one, other in zip(ours, theirs, strict=True)
        )
        if not same:
            raise AssertionError("the search and its baseline found different lines")


def _beside_numpy(scans: list[Cloud]) -> Measurement:
    ours = [partial(_search, cloud, 4) for cloud in scans]
    theirs = [partial(dense_numpy, cloud, granularity=4, **PARAMETERS) for cloud in scans]
    name = f"granularity 4, {len(scans)} scans"
    return in_turns("search", name, ours, "dense numpy", theirs)


def _scaling(quick: bool) -> Iterator[Measurement]:
    """Clouds of beams in clutter, from 300 to 10,000 points, and the exponent of growth."""
    times = []
    for size in SIZES:
        cloud = _synthetic(size)
        task = partial(_search, cloud, 4)
        times.append(median_ms([task] * (3 if quick else 9)))
        yield Measurement("search by size", f"{size} points, granularity 4", times[-1], "ms")
    exponent = float(np.polyfit(np.log(SIZES), np.log(times), 1)[0])
    yield Measurement("search by size", "exponent of growth", exponent, "")


def _synthetic(size: int) -> Cloud:
    """Eight beams seen from one side, and a fifth of clutter, in a window of 3 m."""
    rng = np.random.default_rng(size)
    per_beam = size // 10
    parts = [rng.uniform(-1.5, 1.5, (size - 8 * per_beam, 3))]
    for _ in range(8):
        start, end = rng.uniform(-1.5, 1.5, (2, 3))
        along = rng.uniform(0.0, 1.0, (per_beam, 1))
        parts.append(start + along * (end - start) + rng.normal(0.0, 0.02, (per_beam, 3)))
    return np.concatenate(parts)
