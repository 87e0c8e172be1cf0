"""The truth beside a simulated flight: what stands there, and what of it was seen."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import Trajectory
from beamseg_batch.simulation.output import TRUTH_FILES
from beamseg_batch.simulation.seen import SeenPart, SeenRule
from beamseg_batch.simulation.sensor import Sensor
from beamseg_batch.simulation.trajectory import Flight
from beamseg_batch.tables import TRUTH, TRUTH_JOINTS
from beamseg_batch.world.joints import Joint
from beamseg_batch.world.scene import Member, Scene

__all__ = ["FlightTruth", "joints_csv", "truth_csv", "tum_lines"]

MIN_SEEN_M = 0.3
"""Shortest stretch that must have been seen of a member for it to count."""


@dataclass(frozen=True, eq=False)
class FlightTruth:
    """What was true in a simulated flight.

    Attributes
    ----------
    scene : Scene
    seen : tuple of SeenPart
        One for each member, in order.
    joints : tuple of Joint
    poses : Trajectory
        True poses, at the stamps of the recorded ones.
    n_scans : int
    clearance_m : float, optional
        How near the drone came to anything.
    rule : SeenRule
    """

    scene: Scene
    seen: tuple[SeenPart, ...]
    joints: tuple[Joint, ...]
    poses: Trajectory
    n_scans: int
    clearance_m: float | None
    rule: SeenRule

    @property
    def n_counted(self) -> int:
        """Number of members of which enough was seen that a run should know them."""
        return sum(part.length >= MIN_SEEN_M for part in self.seen)

    def files(
        self, flight: Flight, sensor: Sensor, seed: int, duration_s: float
    ) -> dict[str, Iterable[str]]:
        """Content of the files of the truth, by name, in parts."""
        members, scene = self.scene.members, self._scene_json(flight, sensor, seed, duration_s)
        contents: tuple[Iterable[str], ...] = (
            [truth_csv(members, self.seen)],
            [joints_csv(members, self.joints)],
            tum_lines(self.poses),
            [json.dumps(scene, indent=1), "\n"],
        )
        return dict(zip(TRUTH_FILES, contents, strict=True))

    def _scene_json(
        self, flight: Flight, sensor: Sensor, seed: int, duration_s: float
    ) -> dict[str, Any]:
        return {
            "scene": self.scene.name,
            "notes": list(self.scene.notes),
            "seed": seed,
            "seconds": duration_s,
            "scans": self.n_scans,
            "poses": len(self.poses),
            "members": len(self.seen),
            "members_seen_0.3m": self.n_counted,
            "joints": len(self.joints),
            "clearance_m": self.clearance_m,
            "focal_px": sensor.camera.focal_px,
            "sensor": sensor.model_dump(mode="json"),
            "flight": flight.model_dump(mode="json"),
            "seen_rule": asdict(self.rule),
        }


def truth_csv(members: Sequence[Member], parts: Sequence[SeenPart]) -> str:
    """Write ``truth.csv``: a row for each member and what was seen of it, in order."""
    rows = [_row(member, part) for member, part in zip(members, parts, strict=True)]
    return TRUTH.encode({name: [row[name] for row in rows] for name in TRUTH.column_names})


def _row(member: Member, part: SeenPart) -> dict[str, object]:
    section = member.section
    low, high = part.longest or (math.nan, math.nan)
    axis = member.rotation[:, 2]
    seen = sum(end - start for start, end in part.intervals)
    return {
        "id": member.name,
        **_point("", 1, member.start),
        **_point("", 2, member.end),
        "radius": section.radius,
        "shape": section.shape,
        "visible_fraction": seen / member.length,
        **_point("o", 1, member.start + low * axis),
        **_point("o", 2, member.start + high * axis),
        "observed_length": part.length,
        "frames": part.n_scans,
        "intervals": ";".join(f"{start:.2f}:{end:.2f}" for start, end in part.intervals),
        "width": section.width,
        "height": section.height,
        "web": section.web,
        "flange": section.flange,
        "roll_deg": math.degrees(member.roll),
        "bow": member.bow,
    }


def _point(prefix: str, end: int, point: FloatArray) -> dict[str, float]:
    return {
        f"{prefix}{axis}{end}": value for axis, value in zip("xyz", point.tolist(), strict=True)
    }


def joints_csv(members: Sequence[Member], joints: Sequence[Joint]) -> str:
    """Write ``truth_joints.csv``: a row for each place where members meet."""
    x, y, z = np.array([joint.position for joint in joints]).reshape(-1, 3).T
    ids = [";".join(members[number].name for number in joint.members) for joint in joints]
    return TRUTH_JOINTS.encode({"ids": ids, "x": x, "y": y, "z": z})


def tum_lines(trajectory: Trajectory) -> Iterator[str]:
    """Write poses as evaluation tools read them: ``seconds x y z qx qy qz qw``, a line each."""
    positions, quaternions = trajectory.positions, trajectory.quaternions_xyzw
    for stamp, position, quaternion in zip(
        trajectory.stamps_ns, positions, quaternions, strict=True
    ):
        seconds, nanoseconds = divmod(int(stamp), 10**9)
        values = " ".join(f"{value:.9f}" for value in (*position, *quaternion))
        yield f"{seconds}.{nanoseconds:09d} {values}\n"
