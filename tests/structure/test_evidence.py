"""Beams of a few synthetic scans, from first sightings to measured axes and ends."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from beamseg_batch.config import load_config
from beamseg_batch.geometry import angle_between_deg, distances_to_line, normalised
from beamseg_batch.model import DepthNoise, PoseJitter
from beamseg_batch.structure import questions
from beamseg_batch.structure.evidence import EvidenceStructure
from beamseg_batch.structure.hypothesis import Beam
from beamseg_batch.structure.pixel_rays import PixelRays
from beamseg_batch.structure.questions import Leftovers
from beamseg_batch.structure.refinement import refit
from tests.detection.scans import make_scan
from tests.rays import camera_rays, pose_at, seen_depths
from tests.structure.segments import between, detections, jittered

NOISE = DepthNoise(0.004)
SIZE = 96
POSES = [
    pose_at([0, y, 1.0 + z], 8 * z, -10 * y) for y in (-0.3, -0.1, 0.1, 0.3) for z in (-0.2, 0, 0.2)
]
RAIL = ((0.95, -0.4, 1.05), (1.0, 0.45, 0.95), 0.05)
POST = ((0.8, 0.12, 0.55), (0.8, 0.12, 1.5), 0.05)
NOTHING_LEFT = Leftovers(np.zeros((0, 3)), np.zeros(0, np.bool_), np.array([0.0, 0.1, 1.0]), 7)


def look(pose, beams, rng, *, wall=np.inf, rows=True, stamp_ns=0):
    """Scan of some beams and a wall that stands square to the world's x axis."""
    rays = camera_rays(SIZE, SIZE, 70.0)
    turned = pose.rotate(rays)
    depths = np.full(len(rays), np.inf)
    for start, end, radius in beams:
        ends = (np.array(start), np.array(end))
        depths = np.minimum(depths, seen_depths(pose.translation, turned, *ends, radius))
    depths = np.minimum(depths, (wall - pose.translation[0]) / turned[:, 0])
    seen = np.isfinite(depths)
    depths[seen] += rng.normal(0.0, NOISE.constant, seen.sum()) / rays[seen, 0]
    points = (rays * np.where(seen, depths, np.nan)[:, None]).astype(np.float32)
    points.flags.writeable = False
    width, height = (SIZE, SIZE) if rows else (len(points), 1)
    scan = make_scan(points, pose=pose, stamp_ns=stamp_ns)
    return replace(scan, width=width, height=height)


def refine(structure, scans):
    """Ask all scans once; whether another pass would change anything."""
    question = structure.question()
    sums = question.sums()
    sums.add(question.ask(scans))
    return structure.renew(sums)


def flown(beams, sightings, *, passes=8, seed=0, config=None, **seen):
    """Structure after all passes over scans in which these segments were found, roughly."""
    rng = np.random.default_rng(seed)
    scans = [look(pose, beams, rng, stamp_ns=k, **seen) for k, pose in enumerate(POSES)]
    structure = EvidenceStructure(config or load_config("precise"), NOISE)
    for scan in scans:
        found = [replace(jittered(s, rng, 0.006), first_seen_ns=scan.stamp_ns) for s in sightings]
        structure.update(replace(detections(*found, stamp_ns=scan.stamp_ns), scan=scan))
    for _ in range(passes):
        refine(structure, scans)
    return structure, scans


def shortened(beam, share=0.1):
    """What a scan shows of a beam: not all of it."""
    start, end = (np.array(point) for point in beam[:2])
    return between(start + share * (end - start), end - share * (end - start))


def offset_from(segment, beam):
    return distances_to_line(np.array([beam[0]]), segment.anchor, segment.direction)[0]


def hypothesis_of(beam):
    start, end = np.array(beam[0]), np.array(beam[1])
    half = 0.5 * np.linalg.norm(end - start)
    return Beam(0.5 * (start + end), normalised(end - start), -half, half, beam[2])


def assert_measured(segment, beam, *, axis_m=5e-4, ends_m=5e-3):
    start, end, _ = (np.array(part) for part in beam)
    way = normalised(end - start)
    along = np.sort([(point - start) @ way for point in (segment.end_1, segment.end_2)])
    apart = distances_to_line(np.array([start, end]), segment.anchor, segment.direction)
    assert apart.max() < axis_m
    np.testing.assert_allclose(along, [0.0, np.linalg.norm(end - start)], atol=ends_m)


@pytest.mark.parametrize("seed", range(2))
def test_EvidenceStructure__measures_axis_and_ends(seed):
    structure, _ = flown([RAIL], [shortened(RAIL)], seed=seed)
    (segment,) = structure.segments()
    assert_measured(segment, RAIL)
    assert segment.n_scans == len(POSES)
    assert segment.first_seen_ns == 0
    assert structure.rejections().total() == 0


def test_EvidenceStructure__asks_all_pixels_of_a_large_image_at_the_end(monkeypatch):
    monkeypatch.setattr(questions, "_ENOUGH_PIXELS", SIZE * SIZE // 4)
    asked = []
    ask = questions.AxisQuestion.ask
    monkeypatch.setattr(
        questions.AxisQuestion, "ask", lambda q, scans: asked.append(q.stride) or ask(q, scans)
    )
    config = load_config("precise", None, ["refinement.leftovers=false"])
    beams = [RAIL, POST]
    structure, _ = flown(beams, [shortened(beam) for beam in beams], passes=12, config=config)
    assert asked[0] == 2
    assert asked[-1] == 1
    assert sorted(asked, reverse=True) == asked
    for segment in structure.segments():
        assert_measured(segment, min(beams, key=lambda beam: offset_from(segment, beam)))


def test_view__every_other_row_and_column_is_the_same_image():
    scan = look(POSES[0], [RAIL, POST], np.random.default_rng(0))
    pixels = PixelRays()
    pixels.learn(scan)
    camera = questions.Camera(load_config("precise").filtering, NOISE, pixels)
    whole, part = camera.view(scan), camera.view(scan, 3)
    rows = np.arange(SIZE * SIZE).reshape(SIZE, SIZE)[::3, ::3].ravel()
    np.testing.assert_array_equal(part.points, whole.points[rows])
    np.testing.assert_array_equal(part.rays, whole.rays[rows])
    assert part.width == SIZE // 3
    u, v = part.image[0] + 31 * part.image[1], part.image[2] + 31 * part.image[3]
    assert u == pytest.approx(whole.image[0] + 93 * whole.image[1])
    assert v == pytest.approx(whole.image[2] + 93 * whole.image[3])


def test_view__a_beam_that_jitter_smears_is_as_thick_as_it_is():
    mixed, beam = replace(NOISE, mixed=True), hypothesis_of(POST)

    def thickness(aside, told):
        rng, places = np.random.default_rng(3), np.array([[0.0, aside, 0.0], [0.0, -aside, 0.0]])
        scans = [
            replace(look(replace(pose, translation=at), [POST], rng), T_world_body=pose)
            for pose in POSES
            for at in pose.translation + places
        ]
        pixels, jitter = PixelRays(), PoseJitter(left_position=told, memory_s=1.0)
        pixels.learn(scans[0])
        camera = questions.Camera(load_config("precise").filtering, mixed, pixels, jitter)
        question = questions.AxisQuestion(
            [beam], camera, competitors="all", tukey=4.0, flanks=False
        )
        sums = question.sums()
        sums.add(question.ask(scans))
        return refit(beam, 0, beam.first, beam.last, sums).free_radius

    still, smeared, known = thickness(0.0, 0.0), thickness(0.003, 0.0), thickness(0.003, 0.003)
    assert smeared < still - 1e-4
    assert abs(known - still) < 0.8 * abs(smeared - still)


def test_ask__pixels_that_are_partly_on_what_stands_before_tell_nothing():
    rng, bar, nearer = np.random.default_rng(3), ((0.6, -0.4, 1.0), (0.6, 0.5, 1.05), 0.03), []
    scans, beams = [], [hypothesis_of(beam) for beam in (POST, bar)]
    for pose in POSES:
        scan, alone = look(pose, [POST, bar], rng), look(pose, [bar], rng)
        on_bar = np.isfinite(alone.points[:, 0]).reshape(SIZE, SIZE)
        beside = np.zeros_like(on_bar)
        beside[1:] |= on_bar[:-1]
        beside[:-1] |= on_bar[1:]
        mixed = (beside & ~on_bar).ravel()[:, None]
        scans.append(scan.with_points(np.where(mixed, 0.992 * scan.points, scan.points)))
    for noise in (NOISE, replace(NOISE, mixed=True)):
        pixels = PixelRays()
        pixels.learn(scans[0])
        camera = questions.Camera(load_config("precise").filtering, noise, pixels)
        question = questions.AxisQuestion(beams, camera, competitors="all", tukey=4.0, flanks=True)
        sums = question.sums()
        sums.add(question.ask(scans))
        crossing = sums.coarse(0)[np.abs(sums.middles(0)) < 0.1].sum(axis=0)
        nearer.append(crossing[21] / crossing[20])  # as if the beam were so much thicker there
    assert nearer[0] > 2e-4
    assert nearer[1] < 0.6 * nearer[0]


def test_ask__beams_that_are_out_of_reach_change_nothing():
    rng = np.random.default_rng(0)
    scans = [look(pose, [RAIL, POST], rng) for pose in POSES]
    pixels = PixelRays()
    pixels.learn(scans[0])
    camera = questions.Camera(load_config("precise").filtering, NOISE, pixels)
    seen = [hypothesis_of(beam) for beam in (RAIL, POST)]
    away = np.array([0.0, 0.0, 20.0])
    far = [replace(seen[0], anchor=seen[0].anchor + k * away) for k in range(1, 6)]
    few, many = (
        questions.AxisQuestion(beams, camera, competitors="all", tukey=4.0, flanks=True)
        for beams in (seen, [far[0], seen[0], *far[1:], seen[1]])
    )
    alone, among = few.ask(scans), many.ask(scans)
    assert alone.beams.tolist() == [0, 1]
    assert among.beams.tolist() == [1, 6]
    for name, values in alone.sums.items():
        np.testing.assert_array_equal(among.sums[name], values)


@pytest.mark.parametrize("flanks", [False, True])
def test_ask__scans_that_no_beam_is_in_reach_of_add_nothing(flanks):
    scans = [look(POSES[0], [RAIL], np.random.default_rng(0))]
    pixels = PixelRays()
    pixels.learn(scans[0])
    camera = questions.Camera(load_config("precise").filtering, NOISE, pixels)
    rail = hypothesis_of(RAIL)
    far = replace(rail, anchor=rail.anchor + np.array([0.0, 0.0, 20.0]))
    question = questions.AxisQuestion([far], camera, competitors="all", tukey=4.0, flanks=flanks)
    sums, answer = question.sums(), question.ask(scans)
    sums.add(answer)
    assert answer.beams.tolist() == []
    assert not any(sums_of.any() for sums_of in (sums.evidence.hits, sums.evidence.flanks))


def test_PixelRays__pixels_that_return_late_are_learned_all_the_same():
    scan = look(POSES[0], [RAIL], np.random.default_rng(0))
    full = look(POSES[0], [RAIL], np.random.default_rng(0), wall=2.0)
    pixels = PixelRays()
    for _ in range(60):
        pixels.learn(scan)
    unknown = ~pixels.of(scan)[0].any(axis=1)
    assert unknown.any()
    pixels.learn(full)
    rays = pixels.of(scan)[0]
    wanted = full.points / np.linalg.norm(full.points, axis=1)[:, None]
    np.testing.assert_allclose(rays[unknown], wanted[unknown], atol=1e-6)


def test_EvidenceStructure__measures_clouds_without_rows():
    structure, _ = flown([RAIL], [shortened(RAIL)], rows=False, wall=1.45)
    (segment,) = structure.segments()
    assert_measured(segment, RAIL)


def test_EvidenceStructure__measures_beams_that_hide_one_another():
    structure, _ = flown([RAIL, POST], [shortened(RAIL), shortened(POST)])
    assert len(structure.segments()) == 2
    upright = [abs(segment.direction[2]) for segment in structure.segments()]
    assert_measured(structure.segments()[int(np.argmax(upright))], POST, ends_m=0.01)
    assert_measured(structure.segments()[int(np.argmin(upright))], RAIL, ends_m=0.01)
    assert structure.intersections() == ()


def test_EvidenceStructure__finds_nothing_in_a_wall():
    on_wall = [
        between([1.0, -0.3, 1.0], [1.0, 0.3, 1.0]),
        between([1.03, 0.1, 0.8], [1.03, 0.1, 1.3]),
    ]
    structure, _ = flown([], on_wall, wall=1.0)
    assert structure.segments() == ()


def test_EvidenceStructure__finds_nothing_in_the_air():
    structure, _ = flown([RAIL], [between([0.7, -0.3, 0.7], [0.7, 0.3, 0.7])])
    assert structure.segments() == ()
    assert len(structure) == 0


def test_EvidenceStructure__keeps_apart_beams_that_are_bent():
    half = np.radians(5.0)
    way = np.array([np.sin(half), np.cos(half), 0.0])
    left = ((1.0, 0.0, 1.0), tuple(np.array([1.0, 0.0, 1.0]) + 0.4 * way * (1, -1, 1)), 0.05)
    right = ((1.0, 0.0, 1.0), tuple(np.array([1.0, 0.0, 1.0]) + 0.4 * way), 0.05)
    structure, _ = flown([left, right], [between(left[1], right[1])])
    one, other = structure.segments()
    assert angle_between_deg(one.direction, other.direction) == pytest.approx(10.0, abs=0.7)
    (joint,) = structure.intersections()
    np.testing.assert_allclose(joint.position, [1.0, 0.0, 1.0], atol=0.01)


@pytest.mark.parametrize("sagitta", [0.02, 0.05])
@pytest.mark.parametrize("pieces", [1, 2])
def test_EvidenceStructure__finds_a_bent_beam_whole(sagitta, pieces):
    y = np.linspace(-0.5, 0.5, 25)
    places = np.stack([1.0 + sagitta * (1 - 4 * y**2), y, np.full(25, 1.0)], axis=1)
    chain = [(a, b, 0.05) for a, b in pairwise(places)]
    cuts = np.linspace(2, 22, pieces + 1).astype(int)
    seen = [between(places[a], places[b]) for a, b in pairwise(cuts)]
    structure, _ = flown(chain, seen, passes=10)
    (segment,) = structure.segments()
    assert segment.bow == pytest.approx(sagitta, abs=1e-3)
    assert segment.bow_vector[0] == pytest.approx(sagitta, abs=1e-3)
    assert segment.is_bent
    assert_measured(segment, (places[0], places[-1], 0.05), axis_m=2e-3)


def test_EvidenceStructure__takes_no_beam_for_bent_where_none_may_be():
    y = np.linspace(-0.5, 0.5, 25)
    places = np.stack([1.0 + 0.05 * (1 - 4 * y**2), y, np.full(25, 1.0)], axis=1)
    chain = [(a, b, 0.05) for a, b in pairwise(places)]
    settings = ["refinement.bow=false"]
    structure, _ = flown(
        chain, [between(places[2], places[22])], config=load_config("precise", overrides=settings)
    )
    assert len(structure.segments()) == 2


def test_EvidenceStructure__before_any_pass_holds_the_candidates():
    structure, _ = flown([RAIL], [shortened(RAIL)], passes=0)
    assert len(structure) == 1
    (segment,) = structure.segments()
    assert angle_between_deg(segment.direction, np.subtract(*RAIL[:2])) < 2.0


@pytest.mark.parametrize(
    ("setting", "reason"),
    [("structure.min_scans=13", "too_few_scans"), ("structure.min_length=1.0", "too_short")],
)
def test_rejections__say_why_a_beam_is_left_out(setting, reason):
    structure, _ = flown([RAIL], [shortened(RAIL)], passes=4)
    structure.config = load_config("precise", overrides=[setting])
    assert structure.segments() == ()
    assert structure.rejections() == {reason: 1}


KEPT = load_config("precise", overrides=["outputs.candidates=true"])


def test_candidates__tell_the_fate_of_every_sighting():
    on_wall = between([1.35, -0.3, 0.7], [1.35, 0.3, 0.7])  # the axis, behind the surface
    in_air = between([0.7, -0.3, 0.7], [0.7, 0.3, 0.7])
    structure, _ = flown([RAIL], [shortened(RAIL), on_wall, in_air], wall=1.3, config=KEPT)
    rows = structure.candidates()
    assert sorted(row.number for row in rows) == [0, 1, 2]
    (kept,) = (row for row in rows if row.fate == "kept")
    assert (kept.stage, kept.segment, kept.reason) == ("end", 0, "")
    (segment,) = structure.segments()
    np.testing.assert_allclose([kept.end_1, kept.end_2], [segment.end_1, segment.end_2])
    refused = {row.reason: row for row in rows if row.fate == "refused"}
    assert structure.rejections() == dict.fromkeys(refused, 1)
    np.testing.assert_allclose(refused["not_free"].end_1[0], 1.35, atol=0.1)
    assert max(refused["not_free"].flanks) > 0.45
    assert refused["no_evidence"].seen_through > 100.0
    assert refused["no_evidence"].in_pass == 1


def test_candidates__found_in_too_few_scans():
    structure, scans = flown([RAIL], [shortened(RAIL)], passes=0, config=KEPT)
    once = between([0.8, 0.12, 0.6], [0.8, 0.12, 1.4])
    structure.update(replace(detections(once, stamp_ns=99), scan=scans[0]))
    refine(structure, scans)
    assert structure.rejections() == {"too_few_sightings": 1}
    seldom = structure.candidates()[0]
    assert (seldom.stage, seldom.number, seldom.value, seldom.limit) == ("gathering", None, 1, 3)


def test_candidates__are_the_same_before_any_pass():
    structure, _ = flown([RAIL], [shortened(RAIL)], passes=0, config=KEPT)
    (row,) = structure.candidates()
    assert (row.fate, row.segment) == ("kept", 0)
    assert np.isnan(row.score)


@pytest.mark.parametrize("beams", [[RAIL], []])
def test_candidates__keeping_them_changes_nothing(beams):
    sightings = [shortened(RAIL)]
    one, _ = flown(beams, sightings, wall=1.3, config=KEPT)
    other, _ = flown(beams, sightings, wall=1.3)
    assert one.rejections() == other.rejections()
    for a, b in zip(one.segments(), other.segments(), strict=True):
        np.testing.assert_array_equal([a.end_1, a.end_2], [b.end_1, b.end_2])


def test_leftovers__are_what_no_beam_explains():
    structure, scans = flown([RAIL, POST], [shortened(RAIL)], passes=3)
    left = structure.leftover_question().ask(scans)
    off_post = distances_to_line(left.points, np.array(POST[0]), np.array([0.0, 0.0, 1.0]))
    assert len(left.points) > 300
    assert np.mean(off_post < 0.05 + 5 * NOISE.constant) > 0.97
    assert left.stamp_ns == scans[-1].stamp_ns
    np.testing.assert_allclose(left.seen_from, [0.0, 0.0, 1.0], atol=1e-9)


def test_propose__adds_beams_that_are_measured_like_the_others():
    structure, scans = flown([RAIL, POST], [shortened(RAIL)], passes=3)
    seen = shortened(POST)
    on_surface = replace(seen, anchor=seen.anchor - [0.04, 0.0, 0.0])
    assert structure.wants_leftovers
    structure.propose([(on_surface, NOTHING_LEFT)])
    assert len(structure) == 2
    assert not structure.wants_leftovers
    while refine(structure, scans):
        if structure.wants_leftovers:  # again, since the last search brought one
            structure.propose([])
    (post,) = (s for s in structure.segments() if abs(s.direction[2]) > 0.9)
    assert_measured(post, POST)
    assert post.first_seen_ns == 7


@pytest.mark.parametrize("step", ["competition", "split", "drop", "merge", "cut", "snap"])
def test_question__every_step_can_be_left_out(step):
    structure = EvidenceStructure(load_config("precise", None, [f"refinement.{step}=false"]), NOISE)
    kinds = [structure._next_pass()]
    while structure._waiting:
        structure._waiting = structure._waiting[1:]
        kinds.append(structure._next_pass())
    if step == "competition":
        assert {kind.competitors for kind in kinds} == {"none"}
    else:
        assert not any(getattr(kind.rules, step) for kind in kinds)
        others = {"split", "drop", "merge", "cut", "snap"} - {step}
        assert all(any(getattr(kind.rules, other) for kind in kinds) for other in others)


def test_leftovers__tell_what_stands_free():
    structure, scans = flown([RAIL, POST], [shortened(RAIL)], passes=3, wall=1.3)
    left = structure.leftover_question().ask(scans)
    off_post = distances_to_line(left.points, np.array(POST[0]), np.array([0.0, 0.0, 1.0]))
    assert 300 < left.is_free.sum() < 0.1 * len(left.points)
    assert np.mean(off_post[left.is_free] < 0.05 + 5 * NOISE.constant) > 0.9
    structure._camera.thin = False
    assert structure.leftover_question().ask(scans).is_free.all()


def test_propose__surfaces_are_no_excuse_for_one_another():
    structure, scans = flown([RAIL, POST], [shortened(RAIL)], passes=3, wall=1.3)
    post = between([0.76, 0.12, 0.6], [0.76, 0.12, 1.4])
    planks = [between([1.31, y, 0.7], [1.31, y, 1.3]) for y in np.arange(-0.3, 0.35, 0.1)]
    structure.propose([(one, NOTHING_LEFT) for one in (post, *planks)])
    assert sum(beam.doubtful for beam in structure._hypothesis()) == 1 + len(planks)
    for _ in range(3):
        refine(structure, scans)
    assert len(structure.segments()) == 2
    assert structure.rejections().total() == len(planks)
    assert structure._still_aside() == []


def test_Beams__what_is_doubtful_and_was_not_asked_about_is_no_excuse():
    rail = hypothesis_of(RAIL)
    fresh = replace(rail, doubtful=True, score=9.0)
    beams = questions.Beams([fresh, rail, replace(fresh, beside=0.1, score=5.0)], "all")
    excuses = [(beams.ranks <= limit).tolist() for limit in beams.excused]
    assert excuses == [[False, True, True]] * 3


def test_wants_leftovers__not_where_they_are_left_out():
    config = load_config("precise", None, ["refinement.leftovers=false"])
    structure = EvidenceStructure(config, NOISE)
    while structure._waiting:
        refine(structure, [])
    assert not structure.wants_leftovers
