"""Reasons: one list for counters, texts and documentation."""

from __future__ import annotations

import math

import pytest

from beamseg_batch.config import RunConfig
from beamseg_batch.reasons import KINDS, REASONS, documentation, in_words


@pytest.mark.parametrize("reason", REASONS.values(), ids=lambda reason: reason.name)
def test_reason__tells_in_words_what_was_found_and_needed(reason):
    text = reason.tell(0.25, 0.5, "candidate 3")
    assert text
    assert "{" not in text
    assert not text.endswith(".")
    assert reason.tell(math.nan, math.nan)
    assert reason.kind in KINDS


@pytest.mark.parametrize("reason", REASONS.values(), ids=lambda reason: reason.name)
def test_reason__names_settings_that_exist(reason):
    for setting in filter(None, reason.setting.split(", ")):
        value = RunConfig()
        for key in setting.split("."):
            value = getattr(value, key)


def test_REASONS__line_reasons_come_again_for_what_no_beam_explains():
    lines = {name for name, reason in REASONS.items() if reason.kind == "lines"}
    left = {name for name, reason in REASONS.items() if reason.kind == "leftover_lines"}
    assert left == {f"leftover_{name}" for name in lines - {"below_floor"}}


def test_in_words__names_the_most_frequent_and_sums_up_the_rest():
    counts = {"duplicate": 2, "too_short": 9, "not_free": 4, "low_score": 1, "gap": 50}
    assert in_words(counts, "candidates", most=2) == (
        "16 candidates: 9 too short, 4 part of a surface, 3 for other reasons"
    )
    assert in_words(counts, "lines") == "50 lines: 50 with a gap"
    assert in_words({"duplicate": 1}, "candidates") == "1 candidate: 1 the same as another"


def test_in_words__of_nothing_is_nothing():
    assert in_words({}, "candidates") == ""
    assert in_words({"gap": 3, "too_short": 0}, "candidates") == ""


def test_documentation__has_a_row_for_each():
    rows = documentation().splitlines()[2:]
    assert [row.split("`")[1] for row in rows] == list(REASONS)
