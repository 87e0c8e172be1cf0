"""The C++ baseline, built on first use when there is a compiler."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

__all__ = ["CppBaseline", "cpp_baseline"]

SOURCE = Path(__file__).with_name("hough.cpp")
FLAGS = ("-O3", "-std=c++17", "-shared", "-fPIC")

_doubles = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")
_labels = np.ctypeslib.ndpointer(np.int32, flags="C_CONTIGUOUS")


@dataclass(frozen=True)
class CppLine:
    """A line of the baseline, with the fields of `HoughLine`."""

    votes: int
    indices: NDArray[np.int64]
    anchor: NDArray[np.float64]
    direction: NDArray[np.float64]
    cell_anchor: NDArray[np.float64]
    cell_direction: NDArray[np.float64]


class CppBaseline:
    """The dense accumulator as a function of a cloud.

    Parameters
    ----------
    library : Path
        The built shared library.
    """

    def __init__(self, library: Path) -> None:
        self._directions: dict[int, NDArray[np.float64]] = {}
        self._library = ctypes.CDLL(str(library))
        self._library.baseline_directions.argtypes = [ctypes.c_int, ctypes.c_void_p]
        self._library.baseline_search.argtypes = [
            _doubles, ctypes.c_int, ctypes.c_double, _doubles, ctypes.c_int,
            ctypes.c_int, ctypes.c_int, _doubles, _labels,
        ]  # fmt: skip

    def directions(self, granularity: int) -> NDArray[np.float64]:
        """(D, 3) float64: the directions, made once as the original node does."""
        if granularity not in self._directions:
            count = self._library.baseline_directions(granularity, None)
            directions = np.empty((count, 3))
            self._library.baseline_directions(granularity, directions.ctypes.data)
            self._directions[granularity] = directions
        return self._directions[granularity]

    def __call__(
        self,
        points: NDArray[np.float64],
        *,
        dx: float | None = None,
        granularity: int = 4,
        minvotes: int = 2,
        nlines: int = 0,
    ) -> list[CppLine]:
        """Find lines; parameters as in `beamseg_batch.detection.iterative_hough`."""
        points = np.ascontiguousarray(points, np.float64)
        directions = self.directions(granularity)
        rows = np.empty((len(points) + 1, 14))
        labels = np.empty(len(points), np.int32)
        count = self._library.baseline_search(
            points, len(points), dx or 0.0, directions, len(directions),
            minvotes, nlines, rows, labels,
        )  # fmt: skip
        return [
            CppLine(int(row[0]), np.flatnonzero(labels == k), *row[2:].reshape(4, 3))
            for k, row in enumerate(rows[:count])
        ]


@cache
def cpp_baseline() -> CppBaseline | None:
    """Build the baseline, once a process; None where there is no ``g++``."""
    compiler = shutil.which("g++")
    if compiler is None:
        return None
    folder = Path(tempfile.mkdtemp(prefix="beamseg-baseline-"))
    library = folder / "hough.so"
    subprocess.run([compiler, *FLAGS, "-o", str(library), str(SOURCE)], check=True)
    baseline = CppBaseline(library)
    shutil.rmtree(folder)
    return baseline
