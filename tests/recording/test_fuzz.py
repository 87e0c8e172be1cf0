"""A short run of what ``make fuzz`` does at length."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from tests.fuzz import KINDS, mutated


@pytest.mark.parametrize(("command", "count"), [("info", 70), ("run", 7)])
def test_fuzz__no_promise_is_broken(command, count):
    counts = {"info": 0, "run": 0} | {command: count}
    options = [f"--{name}={value}" for name, value in counts.items()]
    # A program of its own: the peak memory of this one is that of the tests before.
    done = subprocess.run(
        [sys.executable, "-m", "tests.fuzz", "--seed=20", *options],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    codes = re.findall(rf"^{command} +(\S+) +exit \d: (\d+)$", done.stdout, re.MULTILINE)
    assert {kind for kind, _ in codes} == set(KINDS)
    assert sum(int(number) for _, number in codes) == count


def test_mutated__is_the_same_for_the_same_seed():
    content = bytes(range(256)) * 20
    assert mutated(content, 3) == mutated(content, 3) != content
