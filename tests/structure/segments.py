"""Segments and detections built by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from beamseg_batch.geometry import RigidTransform, normalised
from beamseg_batch.model import Detections, Scan, Segment

DIAG_VOXEL = np.sqrt(3.0) * 0.05 / 1.5
EPSILON = 2 * DIAG_VOXEL + 0.1
"""Threshold of solution 3 for two beams of radius 0.05 m: 0.2155 m."""


def between(start, end, *, n_points=100, radius=0.05, pca_coeff=0.995, stamp_ns=0, anchor=0.5):
    """Segment from start to end, its anchor that share of the way along."""
    start, end = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    length = float(np.linalg.norm(end - start))
    return Segment(
        anchor=start + anchor * (end - start),
        direction=normalised(end - start),
        t_min=-anchor * length,
        t_max=(1.0 - anchor) * length,
        radius=radius,
        n_points=n_points,
        pca_coeff=pca_coeff,
        pca_eig=np.array([0.1, 2e-4, 1e-4]),
        points=np.array([start, end]),
        first_seen_ns=stamp_ns,
        last_seen_ns=stamp_ns,
    )


def turned(segment):
    """The same segment, described the other way round."""
    return replace(
        segment, direction=-segment.direction, t_min=-segment.t_max, t_max=-segment.t_min
    )


def random_segment(rng, *, size=2.0, shortest=0.3):
    start = rng.uniform(-size, size, 3)
    length = rng.uniform(shortest, size)
    return between(
        start,
        start + length * normalised(rng.normal(size=3)),
        n_points=int(rng.integers(12, 400)),
        pca_coeff=rng.uniform(0.99, 1.0),
        anchor=rng.uniform(0.1, 0.9),
    )


def jittered(segment, rng, noise):
    """The same beam, seen again: its ends moved a little and perhaps swapped."""
    start, end = segment.end_1 + rng.normal(0, noise, 3), segment.end_2 + rng.normal(0, noise, 3)
    if rng.uniform() < 0.5:
        start, end = end, start
    return between(start, end, n_points=int(rng.integers(12, 400)), anchor=rng.uniform(0.1, 0.9))


def detections(*segments, stamp_ns=0):
    scan = Scan(
        index=0,
        stamp_ns=stamp_ns,
        pose_stamp_ns=stamp_ns,
        T_world_body=RigidTransform.identity(),
        T_body_sensor=RigidTransform.identity(),
        points=np.empty((0, 3), np.float32),
        width=0,
        height=1,
    )
    return Detections(
        scan=scan,
        segments=segments,
        n_points_raw=0,
        n_points_window=0,
        n_points_filtered=0,
        n_lines=len(segments),
        rejections={},
        cloud=np.empty((0, 3), np.float32),
        stage_us={},
    )


def known(segment, sigma, slope=0.0):
    """The same segment, its axis known by so many metres and radians in each normal direction."""
    across = np.eye(3) - np.outer(segment.direction, segment.direction)
    covariance = np.zeros((6, 6))
    covariance[:3, :3], covariance[3:, 3:] = sigma**2 * across, slope**2 * across
    return replace(segment, covariance=covariance)
