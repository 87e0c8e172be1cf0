"""Members of every shape, and a camera that looks at them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamseg_batch.geometry import RigidTransform, matrix_from_rpy
from beamseg_batch.simulation.sensor import Camera
from beamseg_batch.world.scene import Member, Section

SECTIONS = {
    "round": Section("round", 0.1, 0.1),
    "square": Section("square", 0.1, 0.08),
    "i": Section("i", 0.1, 0.14, 0.012, 0.016),
    "l": Section("l", 0.12, 0.09, 0.01, 0.014),
    "c": Section("c", 0.08, 0.15, 0.01, 0.012),
}
BOWS = {"straight": 0.0, "bent": 0.05}
CASES = [(shape, bow) for shape in SECTIONS for bow in BOWS]


def make_member(
    shape="round",
    bow="straight",
    start=(-0.2, -0.8, 0.9),
    end=(0.1, 0.7, 1.4),
    name="",
    **section,
):
    return Member(
        name=name or f"{bow} {shape}",
        start=np.array(start, dtype=float),
        end=np.array(end, dtype=float),
        section=replace(SECTIONS[shape], **section),
        roll=0.0 if shape == "round" and bow == "straight" else 0.6,
        bow=BOWS[bow],
    )


@pytest.fixture(params=CASES, ids="-".join)
def member(request):
    return make_member(*request.param)


@pytest.fixture
def camera():
    return Camera(width=32, height=28, horizontal_fov=1.2)


def looking(x, y, z, yaw_deg, pitch_deg=0.0, roll_deg=0.0):
    """Pose of a camera."""
    turn = matrix_from_rpy(*np.radians([roll_deg, pitch_deg, yaw_deg]))
    return RigidTransform(turn, np.array([x, y, z], dtype=float))


def looking_at(target, x, y, z, roll_deg=0.0):
    """Pose of a camera at x, y, z that has a point in the middle of its image."""
    dx, dy, dz = np.array(target) - (x, y, z)
    yaw, pitch = np.arctan2(dy, dx), -np.arctan2(dz, np.hypot(dx, dy))
    return looking(x, y, z, *np.degrees([yaw, pitch]), roll_deg)


VIEWS = [
    looking_at((-0.05, -0.05, 1.15), 0.8, 0.0, 1.1),
    looking_at((-0.1, -0.3, 1.05), -0.7, 0.3, 0.7, -40),
    looking_at((0.1, 0.6, 1.4), 0.35, 1.1, 1.5),  # at an end
]
