"""What became of each candidate: one fate, one reason, counted once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamseg_batch.cylinder.evidence_kernels import FINE
from beamseg_batch.model import RefusedLine
from beamseg_batch.reasons import REASONS
from beamseg_batch.structure.fates import Fates, Refusal, RefusedLines, flank_shares
from beamseg_batch.structure.hypothesis import Sums
from beamseg_batch.structure.refinement import (
    PassRules,
    refined,
    refusal_of,
    without_collisions,
    without_duplicates,
)
from tests.structure.segments import between
from tests.structure.test_refinement import GOOD, NOISE, beam, bent, told

WALL = np.array([[90.0, 10.0], [5.0, 95.0], [0.0, 0.0]])


def a_pass(beams, sums, *, rules=None, competing=True, fates=None):
    """Fates after a pass over numbered beams, and what is left of these."""
    fates = fates or Fates(keep=True)
    numbered = fates.numbered(beams, "scans")
    fates.begin_pass(competing=competing)
    found = refined(numbered, sums, NOISE, rules or PassRules(), fates=fates)
    return fates, found


def rows_of(fates, found=(), gathered=()):
    last = [(one, index, None) for index, one in enumerate(found)]
    return fates.candidates(last, gathered)


# --- each reason ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "reason", "value", "limit"),
    [
        ({"score": 120.0, "hits": 100.0}, "low_score", 120.0, 300.0),
        ({"score": 430.0, "hits": 1000.0}, "low_share", 0.1, 0.15),
        ({"first": -0.08, "last": 0.08}, "evidence_too_short", 0.16, 0.18),
        ({"flanks": WALL}, "not_free", 0.9, 0.45),
        ({"flanks": WALL[[1, 0, 2]]}, "not_free", 0.9, 0.45),
    ],
)
def test_refusal_of__says_what_was_found_and_what_was_needed(change, reason, value, limit):
    refusal = refusal_of(replace(GOOD, **change))
    assert refusal.reason == reason
    assert (refusal.value, refusal.limit) == pytest.approx((value, limit))


def test_refusal_of__a_good_beam_is_none():
    assert refusal_of(GOOD) is None


def test_refined__a_wall_is_refused_for_its_flank():
    sums, hits = Sums([GOOD], flanks=True), told(GOOD, lambda s: np.zeros(2))
    for name in ("likelihood", "hits", "normal", "scatter"):
        getattr(sums.evidence, name)[:] = getattr(hits.evidence, name)
    sums.evidence.flanks[0] = WALL
    fates, found = a_pass([GOOD], sums)
    assert found == []
    assert fates.counts == {"not_free": 1}
    (row,) = rows_of(fates)
    assert row.flanks == pytest.approx((0.9, 0.05))
    assert (row.stage, row.in_pass, row.fate, row.number) == ("pass", 1, "refused", 0)
    np.testing.assert_allclose(row.end_1, [0, 0, 0], atol=0.01)


def test_refined__a_short_piece_is_too_short():
    short = beam([0, 0, 0], [0.15, 0, 0])
    fates, _ = a_pass([short], told(short, lambda s: np.zeros(2), per_bin=80))
    assert fates.counts == {"evidence_too_short": 1}
    (row,) = rows_of(fates)
    assert row.value == pytest.approx(0.15, abs=2 * FINE)


def test_refined__what_rays_see_through_has_no_evidence():
    sums = told(GOOD, lambda s: np.zeros(2))
    likelihood, hits = sums.fine(0)
    likelihood[:], hits[:] = -8.0, 0.0
    likelihood[100:102] = 20.0
    fates, _ = a_pass([GOOD], sums)
    assert fates.counts == {"no_evidence": 1}
    (row,) = rows_of(fates)
    assert (row.value, row.limit) == (40.0, 50.0)
    inside = round(GOOD.length / FINE) - 2
    assert row.seen_through == pytest.approx(2.0 * inside, abs=4.0)


def test_refined__of_nothing_at_all_has_no_evidence_either():
    fates, _ = a_pass([GOOD], Sums([GOOD]), rules=PassRules(drop=False))
    assert fates.counts == {"no_evidence": 1}


def test_refined__what_a_likelier_one_leaves_nothing_is_outdone():
    weaker = beam([0.1, 0.01, 0], [0.9, 0.02, 0], score=900.0, hits=230.0, scans=4)
    beams = [GOOD, weaker]
    both = Sums(beams)
    alone = told(GOOD, lambda s: np.zeros(2))
    for name in ("likelihood", "hits", "normal"):
        part = getattr(alone.evidence, name)
        getattr(both.evidence, name)[: len(part)] = part
    fates, found = a_pass(beams, both)
    assert [one.number for one in found] == [0]
    assert fates.counts == {"outdone": 1}
    row = rows_of(fates, found)[0]
    assert (row.number, row.into, row.segment) == (1, 0, 0)
    assert row.value < row.limit == pytest.approx(found[0].score)
    # Without competition nobody takes its rays.
    fates, _ = a_pass(beams, both, competing=False)
    assert fates.counts == {"no_evidence": 1}


@pytest.mark.parametrize(
    ("start", "end", "reason", "value"),
    [
        ([0.1, 0.011, 0], [0.9, 0.011, 0], "duplicate", 0.011),
        ([1.04, 0.005, 0], [2, 0.005, 0], "merged", 0.005),
    ],
)
def test_without_duplicates__tells_the_same_from_what_goes_on(start, end, reason, value):
    fates = Fates(keep=True)
    pair = fates.numbered([GOOD, beam(start, end, score=400.0)], "scans")
    fates.begin_pass(competing=True)
    found = fates.settled(pair, without_duplicates(pair, fates), lambda *_: False)
    assert fates.counts == {reason: 1}
    row = rows_of(fates, found)[0]
    assert (row.fate, row.number, row.into, row.segment) == ("merged", 1, 0, 0)
    assert row.value == pytest.approx(value)


def test_without_collisions__says_with_whom():
    fates = Fates(keep=True)
    pair = fates.numbered([GOOD, beam([0.1, 0.07, 0], [0.9, 0.09, 0], score=900.0)], "scans")
    fates.begin_pass(competing=True)
    found = fates.settled(pair, without_collisions(pair, fates), lambda *_: False)
    assert fates.counts == {"collision": 1}
    row = rows_of(fates, found)[0]
    assert (row.value, row.limit, row.into) == (pytest.approx(0.08, abs=0.002), 0.1, 0)


# --- one candidate, one fate ----------------------------------------------------------


def test_refined__a_beam_that_waits_has_no_fate_yet():
    weaker = beam([0.1, 0.01, 0], [0.9, 0.02, 0], score=900.0, hits=230.0, scans=4)
    fates, found = a_pass([weaker, GOOD], Sums([weaker, GOOD]))
    assert [one.number for one in found] == [1]
    assert fates.counts.total() == 1
    fates.begin_pass(competing=True)
    assert refined(found, Sums(found), NOISE, PassRules(), fates=fates) == []
    assert fates.counts.total() == 2


def test_refined__the_parts_of_a_split_beam_are_known_as_such():
    fates, found = a_pass([GOOD], told(GOOD, bent(0.0, 5.0), noise=1.0))
    assert sorted(one.number for one in found) == [0, 1]
    assert fates.counts == {}
    rows = {row.number: row for row in rows_of(fates, found)}
    assert (rows[0].origin, rows[0].parent) == ("scans", None)
    assert (rows[1].origin, rows[1].parent) == ("split", 0)


def test_refined__a_part_that_goes_is_no_fate_of_the_whole():
    sums = told(GOOD, lambda s: np.zeros(2))
    likelihood, hits = sums.fine(0)
    places = sums.starts[0] + FINE * (np.arange(len(hits)) + 0.5)
    gap = (places > 0.2) & (places < 0.35)
    likelihood[gap], hits[gap] = -40.0, 0.0
    fates, found = a_pass([GOOD], sums, rules=PassRules(cut=True))
    assert [one.number for one in found] == [0]  # the rest, 0.15 m, is too short
    assert fates.counts == {}


def test_settled__of_several_parts_the_likeliest_tells_why():
    fates = Fates(keep=True)
    (one,) = fates.numbered([GOOD], "scans")
    fates.note(replace(one, score=50.0), Refusal("low_score", 50.0, 300.0))
    fates.note(replace(one, score=500.0), Refusal("evidence_too_short", 0.1, 0.18))
    fates.note(replace(one, score=90.0), Refusal("low_score", 90.0, 300.0))
    fates.note(replace(one, score=999.0), Refusal("duplicate", 0.0, 0.012, one.number))
    assert fates.settled([one], [], lambda *_: False) == []
    assert fates.counts == {"evidence_too_short": 1}


def test_settled__what_vanishes_without_a_word_is_superseded():
    fates = Fates()
    fates.settled(fates.numbered([GOOD], "scans"), [], lambda *_: False)
    assert fates.counts == {"superseded": 1}
    assert rows_of(fates) == ()  # it was not asked to keep any


def test_settled__beams_without_numbers_are_left_alone():
    fates = Fates()
    assert fates.settled([GOOD, GOOD], [GOOD, GOOD], lambda *_: False) == [GOOD, GOOD]
    fates.settled([GOOD], [], lambda *_: False)
    assert fates.counts == {}


def test_candidates__follow_what_gave_way_to_the_segment_in_the_end():
    fates = Fates(keep=True)
    first, second, third = fates.numbered([GOOD, GOOD, GOOD], "leftovers")
    fates.note(first, Refusal("duplicate", 0.0, 0.012, second.number))
    fates.settled([first], [second, third], lambda *_: False)
    fates.note(second, Refusal("collision", 0.0, 0.1, third.number))
    fates.settled([second], [third], lambda *_: False)
    rows = {row.number: row for row in fates.candidates([(third, 7, None)], [])}
    assert [rows[k].segment for k in range(3)] == [7, 7, 7]
    assert [rows[k].fate for k in range(3)] == ["merged", "refused", "kept"]
    assert {row.origin for row in rows.values()} == {"leftovers"}


def test_candidates__before_any_pass_and_in_the_end():
    fates = Fates(keep=True)
    (last,) = fates.numbered([GOOD], "scans")
    seldom = Refusal("too_few_sightings", 2, 3)
    short = Refusal("too_short", 0.2, 0.3)
    early, late = fates.candidates([(last, None, short)], [(replace(GOOD, scans=0), 2, seldom)])
    assert (early.stage, early.number, early.n_lines, early.n_scans) == ("gathering", None, 2, 2)
    assert (late.stage, late.number, late.reason, late.segment) == ("end", 0, "too_short", None)
    assert np.isnan(early.score)
    assert late.score == GOOD.score


@pytest.mark.parametrize(
    ("flanks", "shares"),
    [
        ([[0, 0], [10, 9], [0, 19]], (np.nan, np.nan, np.nan)),
        ([[10, 10], [30, 10], [45, 15]], (0.5, 0.75, 0.75)),
    ],
)
def test_flank_shares__are_told_where_enough_rays_passed(flanks, shares):
    np.testing.assert_equal(flank_shares(np.array(flanks, np.float64)), shares)


# --- refused lines --------------------------------------------------------------------


def line(start, end, *, reason="low_pca_coeff", value=0.9, stamp_ns=0):
    segment = replace(between(start, end), first_seen_ns=stamp_ns, last_seen_ns=stamp_ns)
    return RefusedLine(segment, reason, value, 0.99)


def test_RefusedLines__those_at_one_place_are_one():
    lines = RefusedLines(0.005, "scan")
    for k, value in enumerate((0.9, 0.97, 0.95)):
        lines.add([line([1, 0, 0], [1, 1, 0], value=value, stamp_ns=k)])
    lines.add([line([1, 0, 0], [1, 0.5, 0.001], value=0.5, stamp_ns=2)])
    (row,) = lines.candidates()
    assert (row.n_lines, row.n_scans, row.stage, row.fate) == (4, 3, "scan", "refused")
    assert (row.value, row.limit) == (0.97, 0.99)  # the narrowest
    assert (row.first_seen_ns, row.last_seen_ns) == (0, 2)
    assert row.number is None


def test_RefusedLines__places_and_reasons_are_kept_apart_in_time_order():
    lines = RefusedLines(0.005, "leftovers")
    lines.add([line([3, 0, 0], [3, 1, 0], stamp_ns=5), line([1, 0, 0], [1, 1, 0], stamp_ns=5)])
    lines.add([line([1, 0, 0], [1, 1, 0], reason="gap", stamp_ns=1)])
    rows = lines.candidates()
    assert [row.reason for row in rows] == [
        "leftover_gap",
        "leftover_low_pca_coeff",
        "leftover_low_pca_coeff",
    ]
    assert all(row.reason in REASONS for row in rows)


def test_RefusedLines__memory_stays_bounded():
    lines = RefusedLines(0.005, "scan", most=3)
    for k in range(5):
        lines.add([line([k, 0, 0], [k, 1, 0]), line([0, 0, 0], [0, 1, 0])])
    assert len(lines.candidates()) == 3
    assert lines.n_left_out == 2
    assert sum(row.n_lines for row in lines.candidates()) == 8
