"""Scans built by hand: points on beams, and poses to see them from."""

from __future__ import annotations

import numpy as np

from beamseg_batch.geometry import RigidTransform
from beamseg_batch.model import Scan

LEAF = 0.05 / 1.5
DIAG_VOXEL = np.sqrt(3.0) * LEAF


def make_scan(points, *, pose=None, extrinsic=None, index=0, stamp_ns=1_000):
    points = np.asarray(points)
    return Scan(
        index=index,
        stamp_ns=stamp_ns,
        pose_stamp_ns=stamp_ns,
        T_world_body=pose or RigidTransform.identity(),
        T_body_sensor=extrinsic or RigidTransform.identity(),
        points=points,
        width=len(points),
        height=1,
    )


def lifted(height=1.0, quaternion_xyzw=(0.0, 0.0, 0.0, 1.0)):
    """A pose so high that no floor is in the way."""
    return RigidTransform.from_quaternion(
        np.array([0.0, 0.0, height]), np.array(quaternion_xyzw, dtype=np.float64)
    )


def beam_points(start, end, count, rng, spread=0.02):
    """Points around a line, as what a camera sees of a thin beam."""
    t = np.linspace(0.0, 1.0, count)[:, None]
    line = np.asarray(start) * (1.0 - t) + np.asarray(end) * t
    return line + rng.uniform(-spread, spread, (count, 3))
