"""Where along an axis a beam is: dynamic programming beside trying everything."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamseg_batch.structure.interval_kernels import best_intervals, densest_part

# Quarters add up without rounding, so equal sums are equal.
QUARTERS = st.integers(-20, 20).map(lambda number: number / 4.0)


def rows(stretches):
    return [tuple(map(int, stretch)) for stretch in stretches]


def worth(likelihood, stretches, cost):
    return sum(likelihood[first:last].sum() - cost for first, last in stretches)


def best_worth(likelihood, cost):
    """Largest worth of all ways to mark bins as inside."""
    best = 0.0
    for marks in itertools.product([False, True], repeat=len(likelihood)):
        edges = np.flatnonzero(np.diff([0, *map(int, marks), 0])).reshape(-1, 2)
        best = max(best, worth(likelihood, edges, cost))
    return best


@given(st.lists(QUARTERS, max_size=9), st.sampled_from([0.25, 1.0, 3.0, 8.0]))
@settings(deadline=None, max_examples=60)
def test_best_intervals__agrees_with_trying_all(values, cost):
    likelihood = np.array(values, np.float64)
    stretches = rows(best_intervals(likelihood, cost))
    assert worth(likelihood, stretches, cost) == best_worth(likelihood, cost)
    flat = list(itertools.chain(*stretches))
    assert flat == sorted(set(flat))
    assert all(0 <= first < last <= len(values) for first, last in stretches)


@given(st.lists(QUARTERS, max_size=30), st.sampled_from([0.25, 1.0, 3.0]))
@settings(deadline=None, max_examples=60)
def test_best_intervals__is_worth_the_same_from_either_side(values, cost):
    likelihood = np.array(values, np.float64)
    turned = likelihood[::-1].copy()
    one, other = (worth(v, best_intervals(v, cost), cost) for v in (likelihood, turned))
    assert one == other


@pytest.mark.parametrize(
    ("values", "found"),
    [
        ([], []),
        ([-1.0, -1.0], []),
        ([1.0, 1.0], []),
        ([3.0, 3.0], [(0, 2)]),
        ([6.0, -1.0, 6.0], [(0, 3)]),
        ([6.0, -9.0, 6.0], [(0, 1), (2, 3)]),
        ([-1.0, 9.0, 0.5, -1.0], [(1, 3)]),
        ([-1.0, 9.0], [(1, 2)]),
    ],
)
def test_best_intervals__by_hand(values, found):
    assert rows(best_intervals(np.array(values, np.float64), 4.0)) == found


@given(st.lists(QUARTERS, max_size=25))
@settings(deadline=None, max_examples=100)
def test_densest_part__agrees_with_trying_all(values):
    first, last = densest_part(np.array(values, np.float64))
    sums = [
        sum(values[low:high])
        for low in range(len(values) + 1)
        for high in range(low, len(values) + 1)
    ]
    assert sum(values[first:last]) == max(sums)
    assert (first == last) == (max(sums) == 0.0)


def test_densest_part__of_nothing():
    assert densest_part(np.zeros(0)) == (0, 0)
    assert densest_part(np.array([-1.0, 0.0])) == (0, 0)
