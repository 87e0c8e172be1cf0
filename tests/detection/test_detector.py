"""One scan as a whole: several radii, limits, floor, frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamseg_batch.config import load_config
from beamseg_batch.detection import Detector
from beamseg_batch.geometry import RigidTransform, angle_between_deg, distances_to_line
from tests import naive
from tests.detection.scans import beam_points, lifted, make_scan
from tests.rays import pose_at, scan_points

REPORT = load_config("report")


def detect(scan, *overrides):
    return Detector(load_config("report", overrides=overrides))(scan)


def seen(beams, pose=None, seed=0, extrinsic=None, **camera):
    pose, extrinsic = pose or pose_at([0, 0, 1]), extrinsic or RigidTransform.identity()
    points = scan_points(pose @ extrinsic, beams, np.random.default_rng(seed), **camera)
    return make_scan(points, pose=pose, extrinsic=extrinsic)


# The coefficient of a beam as thick as these passes 0.99 only beyond a metre.
SHORT_BEAMS = "detection.screening.min_pca_coeff=0.95"
CROSS = [([1.0, -0.6, 0.7], [1.0, 0.6, 0.7], 0.05), ([0.9, 0.1, 0.4], [0.9, 0.1, 1.7], 0.05)]


def assert_on_beam(segment, beam, offset=0.06, angle_deg=5.0):
    """The report's line runs up to a radius in front of the true axis."""
    start, end = np.array(beam[0]), np.array(beam[1])
    axis = (end - start) / np.linalg.norm(end - start)
    assert angle_between_deg(segment.direction, axis) < angle_deg
    assert distances_to_line(segment.midpoint[None], start, axis)[0] < offset


def test_detector__finds_two_crossing_beams_in_the_world():
    found = detect(seen(CROSS), SHORT_BEAMS)
    assert len(found.segments) == 2
    segments = sorted(found.segments, key=lambda s: abs(s.direction[2]))
    for segment, beam in zip(segments, CROSS, strict=True):
        assert_on_beam(segment, beam)
        assert segment.length > 0.6
        assert (segment.first_seen_ns, segment.last_seen_ns) == (1_000, 1_000)
        assert segment.n_points == len(segment.points) >= 12
        assert np.linalg.norm(segment.direction) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(
    ("pose", "extrinsic"),
    [
        (pose_at([0, 0, 1], 10, 5, 20), RigidTransform.identity()),
        (pose_at([0.1, 0.1, 1.1], 0, -10, 170), pose_at([0.07, 0.01, 0.04], 2, -3, 5)),
    ],
)
def test_detector__result_is_in_the_world_whatever_the_pose(pose, extrinsic):
    found = detect(seen(CROSS, pose, extrinsic=extrinsic), SHORT_BEAMS)
    assert len(found.segments) == 2
    for segment, beam in zip(
        sorted(found.segments, key=lambda s: abs(s.direction[2])), CROSS, strict=True
    ):
        assert_on_beam(segment, beam)
        assert (
            np.abs(distances_to_line(segment.points, segment.anchor, segment.direction)).max()
            < 0.06
        )


def test_detector__frames_agree_with_the_quaternion_twin():
    quaternion, position = np.array([0.1, -0.2, 0.3, 0.9]), np.array([0.3, -0.4, 2.0])
    points = beam_points([0.6, -0.5, -0.3], [1.1, 0.6, 0.4], 400, np.random.default_rng(1))
    here = detect(make_scan(points, pose=lifted(10.0)), "filtering.floor_trim=none").segments[0]
    there = detect(
        make_scan(points, pose=RigidTransform.from_quaternion(position, quaternion)),
        "filtering.floor_trim=none",
    ).segments[0]
    sensor_end = here.end_1 - [0, 0, 10]
    np.testing.assert_allclose(
        there.end_1, naive.rotated(quaternion, sensor_end) + position, atol=1e-9
    )
    np.testing.assert_allclose(
        there.direction, naive.rotated(quaternion, here.direction), atol=1e-9
    )


def test_detector__is_stateless():
    detector, scan = Detector(REPORT), seen(CROSS)
    one, _, other = detector(scan), detector(seen(CROSS, pose_at([0.2, 0, 1]), 5)), detector(scan)
    assert [s.end_1.tolist() for s in one.segments] == [s.end_1.tolist() for s in other.segments]
    assert one.rejections == other.rejections


@pytest.mark.parametrize(
    "points",
    [
        np.empty((0, 3), np.float32),
        np.full((100, 3), np.nan, np.float32),
        np.full((100, 3), 9.0, np.float32),
        np.full((100, 3), 0.5, np.float32),
        np.array([[0.5, 0.0, 0.0]], np.float32),
    ],
)
def test_detector__scan_without_anything(points):
    found = detect(make_scan(points, pose=lifted()))
    assert found.segments == ()
    assert found.n_lines == 0
    assert found.cloud.dtype == np.float32
    assert len(found.cloud) == found.n_points_filtered <= 1


def test_detector__counts_points_and_lines():
    scan = seen(CROSS)
    outside = np.array([[5.0, 0, 0], [np.nan, 0, 0], [0.5, 0.0, -0.9]], np.float32)
    scan = replace(scan, points=np.concatenate([scan.points, outside]))
    found = detect(scan)
    returns = np.isfinite(scan.points).all(axis=1)
    assert found.n_points_raw == returns.sum()
    assert found.n_points_window == returns.sum() - 1, "the floor does not count against it"
    assert found.n_points_filtered == len(found.cloud) < found.n_points_window
    assert found.n_lines == len(found.segments) + sum(found.rejections.values())
    assert set(found.stage_us) == {"read", "filter", "search", "screen"}


# --- nlines ---------------------------------------------------------------------------


def ball_and_beam():
    """A solid ball that has more votes than the beam beside it, and is no beam."""
    rng = np.random.default_rng(2)
    ball = rng.normal(size=(40_000, 3))
    ball *= 0.25 * rng.uniform(0, 1, (40_000, 1)) ** (1 / 3) / np.linalg.norm(ball, axis=1)[:, None]
    beam = beam_points([1.016, 0.816, -0.5], [1.016, 0.816, 0.5], 300, rng, spread=0.01)
    return make_scan(np.concatenate([ball + np.array([0.8, -0.8, 0.0]), beam]), pose=lifted(5.0))


def test_detector__refused_lines_do_not_count_towards_nlines():
    """Fault of the original: walls and floor used up the limit before the beams came."""
    found = detect(ball_and_beam(), "detection.hough.nlines=1")
    assert sum(found.rejections.values()) >= 1
    (segment,) = found.segments
    assert angle_between_deg(segment.direction, np.array([0.0, 0, 1])) < 3.0
    assert segment.midpoint[1] == pytest.approx(0.8, abs=0.02)


@pytest.mark.parametrize(("nlines", "expected"), [(1, 1), (2, 2), (3, 2), (0, 2)])
def test_detector__nlines_limits_the_segments(nlines, expected):
    found = detect(seen(CROSS), SHORT_BEAMS, f"detection.hough.nlines={nlines}")
    assert len(found.segments) == expected


# --- gap and floor, literal readings ----------------------------------------------------


def interrupted_beam():
    points = beam_points([1.0, -0.8, 0.0], [1.0, 0.8, 0.0], 900, np.random.default_rng(3), 0.015)
    return make_scan(points[(points[:, 1] < -0.1) | (points[:, 1] > 0.1)], pose=lifted())


def test_detector__gap_reject_refuses_what_longest_run_cuts():
    kept = detect(interrupted_beam())
    assert len(kept.segments) == 1
    assert kept.segments[0].length == pytest.approx(0.7, abs=0.05)
    refused = detect(interrupted_beam(), "detection.screening.gap=reject")
    assert refused.segments == ()
    assert refused.rejections == {"gap": 1}
    assert refused.refused == ()  # kept only where that is asked


def test_detector__keeps_refused_lines_in_the_world_frame():
    asked = ("detection.screening.gap=reject", "outputs.candidates=true")
    found = detect(interrupted_beam(), *asked)
    (line,) = found.refused
    assert line.reason == "gap"
    assert line.value == pytest.approx(0.2, abs=0.03)
    assert line.limit < line.value
    assert line.segment.length == pytest.approx(1.6, abs=0.05)
    assert line.segment.midpoint == pytest.approx([1.0, 0.0, lifted().translation[2]], abs=0.05)
    assert line.segment.first_seen_ns == line.segment.last_seen_ns == found.scan.stamp_ns
    assert len(line.segment.points) == 0


def test_detector__of_a_line_with_too_few_points_the_stretch_that_was_judged_is_kept():
    """The longest run has fewer than `minvotes` points; the line went on beyond a gap."""
    points = np.tile([1.0, 0.0, 0.0], (20, 1))
    points[:11, 1] = np.linspace(-0.8, -0.3, 11)
    points[11:, 1] = np.linspace(0.5, 0.9, 9)
    found = detect(
        make_scan(points, pose=lifted()), "detection.hough.minvotes=12", "outputs.candidates=true"
    )
    (line,) = found.refused
    assert found.rejections == {"too_few_points": 1}
    assert (line.value, line.limit) == (11, 12)
    assert line.segment.n_points == 11
    assert line.segment.length == pytest.approx(0.5, abs=0.01)


def leg():
    """A leg that stands on the floor, seen from 1 m above it."""
    points = beam_points([1.0, 0.0, -1.0], [1.0, 0.0, 0.2], 900, np.random.default_rng(4), 0.015)
    return make_scan(points, pose=lifted(1.0))


def test_detector__floor_trim_points_keeps_a_leg():
    (segment,) = detect(leg()).segments
    low, high = sorted([segment.end_1[2], segment.end_2[2]])
    assert low == pytest.approx(0.3, abs=0.03)
    assert high == pytest.approx(1.2, abs=0.03)


def test_detector__floor_trim_segment_refuses_when_either_end_is_low():
    """Fault of the original: it kept a segment when either end was high."""
    found = detect(leg(), "filtering.floor_trim=segment")
    assert found.segments == ()
    assert found.rejections == {"below_floor": 1}
    kept = detect(leg(), "filtering.floor_trim=segment", "outputs.candidates=true")
    (line,) = kept.refused
    assert (line.reason, line.limit) == ("below_floor", 0.3)
    assert line.value == pytest.approx(0.0, abs=0.03)
    assert len(detect(leg(), "filtering.floor_trim=segment",
                      "filtering.floor_trim_height=-0.5").segments) == 1  # fmt: skip
    assert len(detect(leg(), "filtering.floor_trim=none").segments) == 1


# --- several radii --------------------------------------------------------------------


def test_detector__several_radii():
    """Fault of the original: only the largest could match."""
    rng = np.random.default_rng(5)
    thick = beam_points([1.0, -0.7, -0.4], [1.0, -0.7, 0.6], 2000, rng, 0.07)
    thin = beam_points([0.6, 0.3, -0.4], [0.6, 0.3, 0.6], 2000, rng, 0.012)
    scan = make_scan(np.concatenate([thick, thin]), pose=lifted(5.0))
    found = detect(scan, "filtering.radii=[0.03, 0.1]", "detection.screening.min_pca_coeff=0.9")
    by_place = {round(float(s.midpoint[1]), 1): s.radius for s in found.segments}
    assert by_place[-0.7] == 0.1
    assert 0.3 in by_place
    assert len(found.segments) == 2


def test_detector__one_thick_beam_gives_no_thin_ones_beside_it():
    """What is left of a thick beam's outline must not be taken for thin beams."""
    beam = ([0.9, 0.0, 0.4], [0.9, 0.0, 1.6], 0.1)
    for seed in range(3):
        found = detect(
            seen([beam], seed=seed, width=128, height=128),
            "filtering.radii=[0.1, 0.03]",
            SHORT_BEAMS,
        )
        assert [s.radius for s in found.segments] == [0.1]


def test_detector__only_the_thick_beam_claims_its_points():
    """The search for the next radius goes on without the points that are claimed."""
    beam = ([1.0, -0.6, 0.9], [1.0, 0.6, 0.9], 0.05)
    one = detect(seen([beam]), "filtering.radii=[0.05]")
    two = detect(seen([beam]), "filtering.radii=[0.05, 0.04]")
    assert [s.radius for s in one.segments] == [s.radius for s in two.segments] == [0.05]


def test_detector__of_several_radii_thick_beams_may_be_short():
    stub = ([0.9, 0.0, 0.78], [0.9, 0.0, 1.22], 0.1)
    scan = seen([stub])

    def radii_found(half_round, radii):
        found = detect(
            scan, f"detection.screening.half_round={half_round}", f"filtering.radii={radii}"
        )
        return {segment.radius for segment in found.segments}

    assert radii_found("thicker", [0.1, 0.05]) == {0.1}
    assert 0.1 not in radii_found("none", [0.1, 0.05])
    assert radii_found("thicker", [0.1]) == set()
    assert radii_found("all", [0.1]) == {0.1}
