"""A short run of what ``make fuzz`` does at length."""

from __future__ import annotations

import pytest

from tests.fuzz import KINDS, fuzz, mutated


@pytest.mark.parametrize(("command", "count"), [("info", 70), ("run", 7)])
def test_fuzz__no_promise_is_broken(tmp_path, command, count):
    codes = fuzz(tmp_path, command, count, seed=20)
    assert codes.total() == count
    assert {kind for kind, _ in codes} == set(KINDS)


def test_mutated__is_the_same_for_the_same_seed():
    content = bytes(range(256)) * 20
    assert mutated(content, 3) == mutated(content, 3) != content
