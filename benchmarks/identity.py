"""Whether the search finds the baseline's lines, on flights and on random clouds.

python -m benchmarks.identity --clouds 10000 --flight flight.mcap
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from beamseg_batch.detection import iterative_hough
from beamseg_batch.detection.filtering import crop_scan, voxel_grid
from benchmarks.baseline.cpp import cpp_baseline
from benchmarks.clouds import Cloud, random_cloud
from benchmarks.flight import CONFIG, read_scans
from benchmarks.search import PARAMETERS, RADIUS

__all__ = ["same_lines"]


def same_lines(cloud: Cloud, parameters: dict[str, Any]) -> bool:
    """Whether the search and the C++ baseline find the same lines in a cloud.

    Parameters
    ----------
    cloud : (N, 3) float64
    parameters : dict
        Keyword arguments of both.

    Returns
    -------
    bool
        Same votes, winning cells and points; anchors and directions to rounding.

    Raises
    ------
    RuntimeError
        If there is no compiler to build the baseline with.
    """
    baseline = cpp_baseline()
    if baseline is None:
        raise RuntimeError("g++ is needed to build the baseline")
    ours, theirs = list(iterative_hough(cloud, **parameters)), baseline(cloud, **parameters)
    scale = float(np.abs(cloud).max())
    return len(ours) == len(theirs) and all(
        one.votes == other.votes
        and np.array_equal(one.indices, other.indices)
        and np.array_equal(one.cell_direction, other.cell_direction)
        and np.allclose(one.cell_anchor, other.cell_anchor, rtol=0, atol=1e-12 * scale)
        and np.allclose(one.anchor, other.anchor, rtol=0, atol=1e-12 * scale)
        for one, other in zip(ours, theirs, strict=True)
    )


def _random(count: int) -> Iterator[tuple[str, Cloud, dict[str, Any]]]:
    return (random_cloud(seed) for seed in range(count))


def _scans(path: Path) -> Iterator[tuple[str, Cloud, dict[str, Any]]]:
    leaf_size = CONFIG.filtering.leaf_size(RADIUS)
    for scan in read_scans(path):
        cloud = voxel_grid(crop_scan(scan, CONFIG.filtering).points, leaf_size)
        yield str(path), cloud, dict(PARAMETERS, granularity=4)


def _compare(
    clouds: Iterable[tuple[str, Cloud, dict[str, Any]]], tell: Callable[[str], None]
) -> int:
    seen: Counter[str] = Counter()
    differ: Counter[str] = Counter()
    for kind, cloud, parameters in clouds:
        seen[kind] += 1
        if not same_lines(cloud, parameters):
            differ[kind] += 1
    for kind, count in seen.items():
        tell(f"{kind:40}{count:8} clouds{differ[kind]:8} differ")
    return differ.total()


def main() -> None:
    """Compare, print, and end with exit code 1 when anything differs."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.identity", description=__doc__)
    parser.add_argument("--clouds", type=int, default=10_000, help="number of random clouds")
    parser.add_argument("--flight", type=Path, action="append", default=[], help="a recording")
    arguments = parser.parse_args()
    differ = _compare(_random(arguments.clouds), print)
    for path in arguments.flight:
        differ += _compare(_scans(path), print)
    sys.exit(differ > 0)


if __name__ == "__main__":
    main()
