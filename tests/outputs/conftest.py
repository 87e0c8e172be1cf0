"""Small flights, built by hand, and fixtures that give them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beamseg_batch.config import OutputConfig, RunConfig
from beamseg_batch.geometry import RigidTransform, line_parameters, normalised
from beamseg_batch.model import (
    STAGES,
    Candidate,
    FlightResult,
    Intersection,
    Joint,
    Member,
    RecordingInfo,
    ScanRecord,
    Segment,
    Trajectory,
)

START_NS = 1_700_000_000_123_456_789


def make_segment(rng: np.random.Generator, **changes: Any) -> Segment:
    """Build a beam somewhere in an arena."""
    values: dict[str, Any] = {
        "anchor": rng.uniform(-5.0, 5.0, 3),
        "direction": normalised(rng.normal(size=3)),
        "t_min": -rng.uniform(0.2, 1.5),
        "t_max": rng.uniform(0.2, 1.5),
        "radius": 0.05,
        "n_points": int(rng.integers(20, 5000)),
        "pca_coeff": rng.uniform(0.99, 1.0),
        "pca_eig": np.sort(rng.uniform(0.0, 0.4, 3))[::-1],
        "n_scans": int(rng.integers(1, 200)),
        "first_seen_ns": START_NS + int(rng.integers(0, 10**9)),
        "last_seen_ns": START_NS + int(rng.integers(10**9, 10**10)),
        "covariance": make_covariance(rng, 6),
        "measured_radius": 0.0507,
        "sigma_radius": rng.uniform(0.0001, 0.002),
        "bow_vector": rng.normal(0.0, 0.0003, 3),
        "sigma_bow": rng.uniform(0.0001, 0.01),
        "sigma_ends": rng.uniform(0.0001, 0.01, 2),
        "ends_seen": (bool(rng.integers(2)), bool(rng.integers(2))),
    }
    return Segment(**(values | changes))


def make_covariance(rng: np.random.Generator, size: int) -> np.ndarray:
    """Build a covariance of some millimetres."""
    root = rng.normal(0.0, 0.001, (size, size))
    return root @ root.T


def make_joint(rng: np.random.Generator, segments: tuple[Segment, ...], pair: tuple) -> Joint:
    """Build a joint in the middle of the first of its beams."""
    position = segments[pair[0]].midpoint
    axes = [(segments[k].anchor, segments[k].direction) for k in pair]
    return Joint(
        position=position,
        covariance=make_covariance(rng, 3),
        residual=0.0155,
        segments=pair,
        t=tuple(float(line_parameters(position[None], *axis)[0]) for axis in axes),
    )


def make_members(segments: tuple[Segment, ...], joints: tuple[Joint, ...]) -> tuple[Member, ...]:
    """Cut the first beam of each joint there; the others are whole, and end there."""
    members = []
    for number, segment in enumerate(segments):
        joint = next((j for j, one in enumerate(joints) if number in one.segments), None)
        if joint is not None and joints[joint].segments[0] == number:
            t = joints[joint].t[0]
            members.append(Member(number, segment.t_min, t, None, joint))
            members.append(Member(number, t, segment.t_max, joint, None))
        else:
            members.append(Member(number, segment.t_min, segment.t_max, joint, None))
    return tuple(members)


def make_scan(rng: np.random.Generator, index: int) -> ScanRecord:
    """Build the record of a scan, 100 ms after the one before."""
    stages = {stage: float(rng.uniform(10.0, 900.0)) for stage in STAGES}
    stamp_ns = START_NS + index * 100_000_000
    return ScanRecord(
        stamp_ns=stamp_ns,
        pose_stamp_ns=stamp_ns - 12_345_678,
        pose_gap_s=0.012345678,
        n_points_raw=3000,
        n_points_filtered=700,
        n_lines=int(rng.integers(0, 6)),
        n_segments=min(index, 9),
        wall_us=(index + 1) * 3000.4,
        processing_us=sum(stages.values()),
        stage_us=stages,
    )


def make_recording(**changes: Any) -> RecordingInfo:
    """Build the description of a recording."""
    values: dict[str, Any] = {
        "paths": (Path("/somewhere/flights/arena.mcap"),),
        "container": "ROS 2 MCAP",
        "sha256": "0123456789abcdef" * 4,
        "size_bytes": 12_345_678,
        "start_ns": START_NS,
        "end_ns": START_NS + 20 * 10**9,
        "cloud_topic": "/tof_pc",
        "pose_topic": "/mavros/local_position/pose",
        "sensor_frame": "pico_zense_depth_frame",
        "body_frame": "world",
        "world_frame": "mocap",
        "T_body_sensor": RigidTransform(np.eye(3), np.array([0.071, 0.011, 0.04])),
        "extrinsic_source": "tf_static",
        "notes": ("cloud topic /tof_pc taken: the only one of its type",),
    }
    return RecordingInfo(**(values | changes))


def make_trajectory(size: int) -> Trajectory:
    """Build a circle flown at a height that swings."""
    phase = np.linspace(0.0, 2.0 * np.pi, size)
    positions = np.stack([4 * np.cos(phase), 4 * np.sin(phase), 1 + 0.5 * np.sin(3 * phase)], 1)
    quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (size, 1))
    stamps = START_NS + np.arange(size, dtype=np.int64) * 20_000_000
    return Trajectory(stamps, positions, quaternions)


def build_flight(
    *, n_segments: int = 7, n_scans: int = 30, n_cloud: int = 500, **changes: Any
) -> FlightResult:
    """Build the result of a flight, the same for the same arguments."""
    rng = np.random.default_rng(20240229)
    segments = tuple(make_segment(rng) for _ in range(n_segments))
    pairs = [(i, i + 1) for i in range(0, n_segments - 1, 3)]
    intersections = tuple(
        Intersection(i, j, 0.25, -0.125, segments[i].midpoint, 0.031, 87.5, joint)
        for joint, (i, j) in enumerate(pairs)
    )
    joints = tuple(make_joint(rng, segments, pair) for pair in pairs)
    values: dict[str, Any] = {
        "segments": segments,
        "intersections": intersections,
        "joints": joints,
        "members": make_members(segments, joints),
        "scans": tuple(make_scan(rng, index) for index in range(n_scans)),
        "skipped": Counter({"no_pose_within_gap": 3, "no_points_in_window": 2}),
        "rejections": Counter({"gap": 4, "n_points": 11}),
        "trajectory": make_trajectory(max(n_scans, 0) * 5),
        "cloud": rng.uniform(-5.0, 5.0, (n_cloud, 3)).astype(np.float32),
        "recording": make_recording(),
        "config": RunConfig(),
        "wall_s": 1.25,
        "warnings": ("3 clouds have no pose within 0.05 s; see matching.max_gap_s",),
        "interrupted": False,
    }
    return FlightResult(**(values | changes))


def make_candidate(**changes: Any) -> Candidate:
    """Build a candidate that part of a wall was."""
    values: dict[str, Any] = {
        "stage": "pass",
        "number": 5,
        "in_pass": 3,
        "end_1": np.array([8.0, 0.0, 1.0]),
        "end_2": np.array([8.0, 1.0, 1.0]),
        "radius": 0.05,
        "n_scans": 12,
        "n_points": 345,
        "score": 900.5,
        "seen_through": 3.25,
        "flanks": (0.9, np.nan),
        "reduced_chi2": 1.25,
        "first_seen_ns": START_NS + 2 * 10**9,
        "last_seen_ns": START_NS + 4 * 10**9,
        "fate": "refused",
        "reason": "not_free",
        "value": 0.9,
        "limit": 0.45,
    }
    return Candidate(**(values | changes))


def build_empty_flight(**changes: Any) -> FlightResult:
    """Build the result of a flight of which no scan could be used."""
    values: dict[str, Any] = {
        "rejections": Counter(),
        "warnings": (),
        "cloud": np.empty((0, 3), dtype=np.float32),
    }
    return build_flight(n_segments=0, n_scans=0, n_cloud=0, **(values | changes))


@pytest.fixture
def make_flight() -> Callable[..., FlightResult]:
    """Give `build_flight`."""
    return build_flight


@pytest.fixture
def make_empty_flight() -> Callable[..., FlightResult]:
    """Give `build_empty_flight`."""
    return build_empty_flight


@pytest.fixture
def describe_recording() -> Callable[..., RecordingInfo]:
    """Give `make_recording`."""
    return make_recording


@pytest.fixture
def flight() -> FlightResult:
    """Seven beams, thirty scans."""
    return build_flight()


@pytest.fixture
def flight_without_report() -> FlightResult:
    """Give the same flight, to be written without its report."""
    return build_flight(config=RunConfig(outputs=OutputConfig(report=False)))


@pytest.fixture
def empty_flight() -> FlightResult:
    """No scan, no beam, no cloud."""
    return build_empty_flight()
