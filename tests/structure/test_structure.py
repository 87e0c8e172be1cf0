"""A structure over time: fusing, merging, renumbering, and intersections that hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamseg_batch.config import RunConfig, load_config
from beamseg_batch.structure import Structure
from tests import naive
from tests.structure.segments import between, detections, jittered, random_segment, turned

REPORT = load_config("report")


def configured(**structure):
    return RunConfig.model_validate({"structure": {"min_scans": 1, "min_length": 0.0, **structure}})


def build(*scans, config=REPORT):
    """Structure after scans, each a list of segments; the stamp is the number of the scan."""
    structure = Structure(config)
    for number, scan in enumerate(scans):
        seen = [replace(s, first_seen_ns=number, last_seen_ns=number) for s in scan]
        structure.update(detections(*seen, stamp_ns=number))
    return structure


def pairs(structure):
    return [(i.segment_1, i.segment_2) for i in structure.intersections()]


def assert_consistent(structure):
    """Every stored intersection is what the present segments give, and none is missing."""
    segments = structure.segments()
    wanted = {}
    for i, one in enumerate(segments):
        for j in range(i + 1, len(segments)):
            solved = naive.intersection(one, segments[j], one.radius + segments[j].radius)
            if solved:
                wanted[i, j] = solved
    got = {(i.segment_1, i.segment_2): i for i in structure.intersections()}
    assert list(got) == sorted(got)
    assert got.keys() == wanted.keys()
    for pair, (t1, t2, point, distance) in wanted.items():
        assert got[pair].t_1 == pytest.approx(t1, abs=1e-8)
        assert got[pair].t_2 == pytest.approx(t2, abs=1e-8)
        assert got[pair].distance == pytest.approx(distance, abs=1e-8)
        np.testing.assert_allclose(got[pair].position, point, atol=1e-8)


# --- fusing and merging ---------------------------------------------------------------


def test_structure__empty():
    structure = Structure(REPORT)
    structure.update(detections())
    assert (len(structure), structure.segments(), structure.intersections()) == (0, (), ())


def test_update__same_beam_again_is_fused():
    beam = between([0, 0, 1], [2, 0, 1])
    structure = build([beam], [turned(beam)], [beam])
    (segment,) = structure.segments()
    assert (segment.n_scans, segment.n_points) == (3, 300)
    np.testing.assert_allclose(sorted([segment.end_1[0], segment.end_2[0]]), [0, 2], atol=1e-12)


def test_update__two_pieces_become_one_when_bridged():
    """Fault of the original: segments once stored were never merged or dropped."""
    one, two = between([0, 0, 1], [1, 0, 1]), between([2, 0, 1], [3, 0, 1])
    assert len(build([one, two])) == 2
    structure = build([one, two], [between([0.8, 0, 1], [2.2, 0, 1])])
    (segment,) = structure.segments()
    np.testing.assert_allclose(sorted([segment.end_1[0], segment.end_2[0]]), [0, 3], atol=1e-9)
    assert segment.n_points == 300
    assert (segment.first_seen_ns, segment.last_seen_ns) == (0, 1)


def test_update__chain_of_pieces_becomes_one():
    pieces = [between([2.0 * k, 0, 1], [2.0 * k + 1, 0, 1]) for k in range(5)]
    bridges = [between([2.0 * k + 0.9, 0, 1], [2.0 * k + 2.1, 0, 1]) for k in range(4)]
    (segment,) = build(pieces, bridges).segments()
    assert segment.n_points == 900
    assert segment.length == pytest.approx(9.0)


def test_update__best_similar_segment_wins_and_not_the_first():
    """Fault of the original: it took the first in the list."""
    beams = [between([0, y, 1], [2, y, 1], n_points=1000) for y in (0.0, 0.25)]
    assert len(build(beams)) == 2
    structure = build(beams, [between([0, 0.2, 1], [2, 0.2, 1], n_points=10)])
    assert [segment.n_scans for segment in structure.segments()] == [1, 2]


def test_update__next_best_is_taken_when_the_best_does_not_overlap():
    near, far = between([0, 0, 1], [1, 0, 1]), between([1.5, 0.3, 1], [3, 0.3, 1])
    new = between([2, 0.14, 1], [3, 0.14, 1], n_points=10)
    structure = build([near, far], [new])
    assert [segment.n_scans for segment in structure.segments()] == [1, 2]


def test_update__new_beams_of_one_scan_keep_their_order():
    beams = [between([0, 3.0 * k, 1], [1, 3.0 * k, 1]) for k in range(5)]
    found = build(beams[:3], beams[3:]).segments()
    assert [segment.anchor[1] for segment in found] == [0.0, 3.0, 6.0, 9.0, 12.0]
    assert [segment.first_seen_ns for segment in found] == [0, 0, 0, 1, 1]
    assert all(len(segment.points) == 0 for segment in found)


def test_update__several_radii_are_several_beams():
    """Fault of the original: of several radii only the largest could match."""
    thick, thin = (
        between([0, 0, 1], [2, 0, 1], radius=0.1),
        between([0, 1, 1], [2, 1, 1], radius=0.03),
    )
    structure = build([thick, thin], [thin, thick], [thin])
    assert [(s.radius, s.n_scans) for s in structure.segments()] == [(0.1, 2), (0.03, 3)]
    assert len(build([thick], [between([0, 0, 1], [2, 0, 1], radius=0.03)])) == 2


@pytest.mark.parametrize("similarity", ["parameters", "midpoint", "projection"])
@pytest.mark.parametrize("fusion", ["mean", "weighted"])
def test_update__all_solutions_find_two_beams_in_noise(similarity, fusion):
    rng = np.random.default_rng(11)
    config = configured(similarity=similarity, fusion=fusion)
    beams = [between([0, 0, 1], [2, 0, 1]), between([1, -1, 1.02], [1, 1, 1.02])]
    structure = Structure(config)
    for _ in range(30):
        structure.update(
            detections(
                *(
                    between(b.end_1 + rng.normal(0, 0.005, 3), b.end_2 + rng.normal(0, 0.005, 3))
                    for b in beams
                )
            )
        )
    assert len(structure) == 2
    assert pairs(structure) == [(0, 1)]
    assert_consistent(structure)


@pytest.mark.parametrize("first", ["long", "short"])
def test_update__order_of_a_long_and_a_short_view_does_not_matter(first):
    """A short view of a beam is off by a few degrees. Its own axis misses the far ends of
    the long one, but both its ends lie on the long one: they are the same beam.
    """
    long = between([0, 0, 1], [4, 0, 1], n_points=500)
    short = between([0.2, 0, 0.98], [0.6, 0, 1.03], n_points=20)
    scans = [[long], [short]] if first == "long" else [[short], [long]]
    assert len(build(*scans)) == 1


def test_update__beams_that_have_grown_together_are_merged_whichever_changed():
    """As above, when the long one comes to reach over the short one only later."""
    short = between([2.2, 0, 0.98], [2.6, 0, 1.03], n_points=20)
    structure = build([short], [between([0, 0, 1], [2, 0, 1])], [between([0.5, 0, 1], [4, 0, 1])])
    assert len(structure) == 1


@pytest.mark.parametrize("slope", [0.0, 1e-3, 0.02, 0.1])
@pytest.mark.parametrize("fusion", ["mean", "weighted"])
def test_update__piece_of_a_crossing_beam_does_not_turn_the_beam(slope, fusion):
    """Both ends of a 0.3 m piece of a crossing beam lie within epsilon of the axis.

    The report's formula takes the direction from the feet of the new ends alone, which
    lie close together here, so that a piece with one hundredth of the say decides it.
    """
    beam = between([0, 0, 1], [3, 0, 1], n_points=4000)
    piece = between([1.5, -0.15, 1], [1.5 + 0.3 * slope, 0.15, 1], n_points=20)
    structure = build([beam], [piece], config=configured(fusion=fusion))
    longest = max(structure.segments(), key=lambda segment: segment.length)
    assert longest.length == pytest.approx(3.0, abs=0.05)
    assert abs(longest.direction[0]) > 0.98


# --- what is given out ----------------------------------------------------------------


def test_segments__seen_too_rarely_or_too_short_are_left_out():
    config = configured(min_scans=2, min_length=0.5)
    often, once = between([0, 0, 1], [2, 0, 1]), between([1, -1, 1], [1, 1, 1])
    short = between([0, 5, 1], [0.3, 5, 1])
    third = between([1.5, -1, 1], [1.5, 1, 1])
    structure = build([once, often, short, third], [often, short, third], config=config)
    assert [s.n_scans for s in structure.segments()] == [2, 2]
    assert structure.rejections() == {"too_few_scans": 1, "too_short": 1}
    rows = structure.candidates()
    assert [row.segment for row in rows if row.fate == "kept"] == [0, 1]
    assert [row.number for row in rows] == [0, 1, 2, 3]
    assert {row.reason: (row.value, row.limit) for row in rows if row.reason} == {
        "too_few_scans": (1, 2),
        "too_short": (pytest.approx(0.3), 0.5),
    }
    assert pairs(structure) == [(0, 1)], "numbers are those of the segments given out"
    assert structure.intersections()[0].position[0] == pytest.approx(1.5)
    assert len(structure) == 4


# --- intersections over time ----------------------------------------------------------


def test_update__crossing_beams_intersect_at_the_right_place():
    structure = build(
        [between([0, 0, 1], [4, 0, 1], anchor=0.1)], [between([3, -1, 1.04], [3, 2, 1.04])]
    )
    (touch,) = structure.intersections()
    one, two = structure.segments()
    np.testing.assert_allclose(one.anchor + touch.t_1 * one.direction, [3, 0, 1], atol=1e-9)
    np.testing.assert_allclose(two.anchor + touch.t_2 * two.direction, [3, 0, 1.04], atol=1e-9)
    np.testing.assert_allclose(touch.position, [3, 0, 1.02], atol=1e-9)


def test_update__index_of_a_new_segment_is_its_own():
    """Fault of the original: it was off by one, so intersections were missed."""
    structure = build(
        [between([0, 0, 1], [2, 0, 1]), between([0, 5, 1], [2, 5, 1])],
        [between([1, -1, 1], [1, 1, 1])],
        [between([1.5, 4, 1], [1.5, 6, 1])],
    )
    assert pairs(structure) == [(0, 2), (1, 3)]


def test_update__intersection_that_no_longer_holds_is_removed():
    """Fault of the original: it stayed for ever."""
    beam, crossing = between([0, 0, 1], [2, 0, 1]), between([1, -1, 1.09], [1, 1, 1.09])
    moved = between([1, -1, 1.29], [1, 1, 1.29], n_points=900)
    assert pairs(build([beam, crossing])) == [(0, 1)]
    structure = build([beam, crossing], [moved])
    assert len(structure) == 2
    assert structure.intersections() == ()


def test_update__intersection_follows_the_axes():
    """Fault of the original: stored t referred to axes that had since moved."""
    beam, crossing = between([0, 0, 1], [2, 0, 1]), between([1, -1, 1], [1, 1, 1])
    again = between([-1, 0.02, 1.01], [1.7, -0.02, 1.02], anchor=0.9, n_points=700)
    structure = build([beam, crossing], [again])
    assert not np.allclose(structure.segments()[0].anchor, beam.anchor, atol=0.1)
    assert pairs(structure) == [(0, 1)]
    assert_consistent(structure)


def test_update__dropping_a_duplicate_renumbers():
    left, right = between([0, 0, 1], [1, 0, 1]), between([2, 0, 1], [3, 0, 1])
    others = [between([x, -1, 1], [x, 1, 1]) for x in (0.5, 2.5)]
    last = between([2, -0.8, 1], [3, -0.8, 1])
    structure = build([left, others[0], right, others[1], last])
    assert pairs(structure) == [(0, 1), (2, 3), (3, 4)]
    structure.update(detections(between([0.9, 0, 1], [2.1, 0, 1])))
    assert len(structure) == 4
    assert pairs(structure) == [(0, 1), (0, 2), (2, 3)]
    assert_consistent(structure)


@settings(derandomize=True, deadline=None, max_examples=60, database=None)
@given(seed=st.integers(0, 2**32 - 1), noise=st.sampled_from([0.0, 0.01, 0.05, 0.15]))
def test_update__intersections_always_hold_for_the_present_segments(seed, noise):
    rng = np.random.default_rng(seed)
    world = [random_segment(rng, size=1.0) for _ in range(int(rng.integers(2, 9)))]
    structure = Structure(REPORT)
    for _ in range(8):
        seen = [beam for beam in world if rng.uniform() < 0.6]
        structure.update(detections(*(jittered(beam, rng, noise) for beam in seen)))
        assert_consistent(structure)


@settings(derandomize=True, deadline=None, max_examples=30, database=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_update__nothing_is_lost_or_counted_twice(seed):
    rng = np.random.default_rng(seed)
    world = [random_segment(rng, size=0.8) for _ in range(6)]
    structure, n_points = Structure(REPORT), 0
    for _ in range(6):
        seen = [jittered(beam, rng, 0.05) for beam in world]
        n_points += sum(segment.n_points for segment in seen)
        structure.update(detections(*seen))
    found = structure.segments()
    assert sum(segment.n_points for segment in found) == n_points
    for segment in found:
        assert np.isfinite([*segment.anchor, *segment.direction, segment.t_min]).all()
        assert np.linalg.norm(segment.direction) == pytest.approx(1.0, abs=1e-12)
        assert segment.t_min <= segment.t_max


def test_update__n_scans_counts_scans():
    """Two pieces of one beam in one scan are one sighting of it."""
    pieces = [between([0, 0, 1], [1.1, 0, 1]), between([1, 0, 1], [2, 0, 1])]
    (segment,) = build(pieces, pieces).segments()
    assert segment.n_scans == 2


def test_update__n_scans_of_merged_segments_is_that_of_the_flight():
    """Two pieces seen together in ten scans, bridged in the eleventh."""
    pieces = [between([0, 0, 1], [1, 0, 1]), between([2, 0, 1], [3, 0, 1])]
    structure = build(*[pieces] * 10, [between([0.8, 0, 1], [2.2, 0, 1])])
    (segment,) = structure.segments()
    assert segment.n_scans == 11


def test_update__same_scans_give_the_same_structure():
    def run():
        rng = np.random.default_rng(12)
        world = [random_segment(rng, size=1.0) for _ in range(8)]
        scans = [[jittered(beam, rng, 0.02) for beam in world] for _ in range(10)]
        structure = build(*scans)
        return [(s.anchor.tolist(), s.direction.tolist(), s.t_min, s.t_max, s.n_points)
                for s in structure.segments()], pairs(structure)  # fmt: skip

    assert run() == run()
