"""The search finds the lines of the C++ baseline, on whatever cloud."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from benchmarks.baseline.cpp import cpp_baseline
from benchmarks.baseline.dense import dense_numpy
from benchmarks.clouds import KINDS, random_cloud
from benchmarks.identity import same_lines

from beamseg_batch.detection.directions import hemisphere_directions

needs_compiler = pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed")


@needs_compiler
@pytest.mark.parametrize("kind", range(len(KINDS)), ids=list(KINDS))
def test_iterative_hough__as_the_baseline(kind):
    for seed in range(kind, 40 * len(KINDS), len(KINDS)):
        name, cloud, parameters = random_cloud(seed)
        assert name == list(KINDS)[kind]
        assert same_lines(cloud, parameters), f"seed {seed}"


@needs_compiler
@pytest.mark.parametrize("granularity", range(5))
def test_hemisphere_directions__as_the_baseline(granularity):
    theirs = cpp_baseline().directions(granularity)
    np.testing.assert_array_equal(hemisphere_directions(granularity), theirs)


@needs_compiler
@pytest.mark.parametrize("seed", [1, 9, 17])
def test_dense_numpy__as_the_baseline(seed):
    _, cloud, _ = random_cloud(seed)
    parameters = {"dx": float(np.ptp(cloud, axis=0).max()) / 20, "minvotes": 3, "nlines": 4}
    theirs = cpp_baseline()(cloud, granularity=2, **parameters)
    ours = dense_numpy(cloud, granularity=2, **parameters)
    assert [list(line) for line in ours] == [list(line.indices) for line in theirs]
