"""A tiny simulator: a pinhole camera that looks along x at round beams."""

from __future__ import annotations

import numpy as np

from beamseg_batch.geometry import RigidTransform, matrix_from_rpy


def camera_rays(width=64, height=64, fov_deg=90.0):
    """Unit rays in the sensor frame, x forward, in rows from top to bottom."""
    half = np.tan(np.radians(fov_deg) / 2)
    z, y = np.meshgrid(
        np.linspace(half, -half, height), np.linspace(half, -half, width), indexing="ij"
    )
    rays = np.stack([np.ones_like(y), y, z], axis=-1).reshape(-1, 3)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def seen_depths(origin, rays, start, end, radius):
    """Distance at which each ray enters a cylinder; infinite where it misses."""
    axis = (end - start) / np.linalg.norm(end - start)
    offset = origin - start
    w, o = rays - np.outer(rays @ axis, axis), offset - (offset @ axis) * axis
    a, b, c = np.sum(w * w, axis=1), w @ o, o @ o - radius * radius
    root = b * b - a * c
    with np.errstate(invalid="ignore", divide="ignore"):
        depth = (-b - np.sqrt(root)) / a
    t = (offset + depth[:, None] * rays) @ axis
    hit = (root > 0) & (depth > 0) & (t >= 0) & (t <= np.linalg.norm(end - start))
    return np.where(hit, depth, np.inf)


def scan_points(T_world_sensor, beams, rng, noise=0.005, **camera):
    """Cloud in the sensor frame; pixels without return are NaN."""
    rays = camera_rays(**camera)
    turned = T_world_sensor.rotate(rays)
    depths = np.min(
        [
            seen_depths(T_world_sensor.translation, turned, np.array(start), np.array(end), radius)
            for start, end, radius in beams
        ],
        axis=0,
    )
    depths = np.where(np.isfinite(depths), depths + rng.normal(0, noise, len(depths)), np.nan)
    return (rays * depths[:, None]).astype(np.float32)


def pose_at(position, yaw_deg=0.0, pitch_deg=0.0, roll_deg=0.0):
    roll, pitch, yaw = np.radians([roll_deg, pitch_deg, yaw_deg])
    return RigidTransform(matrix_from_rpy(roll, pitch, yaw), np.asarray(position, dtype=np.float64))
