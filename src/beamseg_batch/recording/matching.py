"""Which pose belongs to a stamp: pure functions on stamps.

Mirrors ``closestDronePose`` of the original node: a scan takes the pose message
nearest in time, and none when that lies too far away.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.config import MatchingConfig
from beamseg_batch.errors import ShapeError
from beamseg_batch.geometry import RigidTransform, interpolate_quaternion
from beamseg_batch.model import Trajectory

__all__ = [
    "PoseMatch",
    "interpolated_pose",
    "match_pose",
    "nearest_gaps",
    "nearest_index",
    "pose_at",
    "seconds_to_ns",
    "within_int64",
]

_JITTER_NS = 1_000_000
"""How much wider than twice the largest gap a pair of neighbours may be, nanoseconds."""


@dataclass(frozen=True)
class PoseMatch:
    """The pose found for a stamp.

    Attributes
    ----------
    stamp_ns : int
        Stamp of the nearest pose message.
    gap_ns : int
        Time from it to the stamp asked for, never negative.
    T_world_body : RigidTransform or None
        None when the gap is larger than allowed.
    """

    stamp_ns: int
    gap_ns: int
    T_world_body: RigidTransform | None


def seconds_to_ns(seconds: float) -> int:
    """Whole nanoseconds nearest to a time in seconds."""
    return round(seconds * 1e9)


def within_int64(stamp_ns: int) -> int:
    """Stamp that fits the arrays: a damaged file or an odd offset may claim any time."""
    return min(max(stamp_ns, -(2**63)), 2**63 - 1)


def nearest_index(stamps_ns: NDArray[np.int64], stamp_ns: int) -> int:
    """Index of the stamp nearest to another one.

    Parameters
    ----------
    stamps_ns : (N,) int64
        Increasing.
    stamp_ns : int

    Returns
    -------
    int
        The earlier one of two that are equally near.

    Raises
    ------
    ShapeError
        If there are no stamps.
    """
    if len(stamps_ns) == 0:
        raise ShapeError("no stamps to choose from")
    after = int(np.searchsorted(stamps_ns, stamp_ns))
    if after == 0:
        return 0
    if after == len(stamps_ns):
        return after - 1
    to_earlier = stamp_ns - int(stamps_ns[after - 1])
    to_later = int(stamps_ns[after]) - stamp_ns
    return after - 1 if to_earlier <= to_later else after


def nearest_gaps(
    pose_stamps_ns: NDArray[np.int64], stamps_ns: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Time from each stamp to the nearest of others.

    Parameters
    ----------
    pose_stamps_ns : (N,) int64
        Increasing, at least one.
    stamps_ns : (M,) int64

    Returns
    -------
    (M,) int64, nanoseconds, never negative
    """
    after = np.searchsorted(pose_stamps_ns, stamps_ns)
    last = len(pose_stamps_ns) - 1
    to_later = np.abs(pose_stamps_ns[np.minimum(after, last)] - stamps_ns)
    to_earlier = np.abs(stamps_ns - pose_stamps_ns[np.maximum(after - 1, 0)])
    gaps: NDArray[np.int64] = np.minimum(to_later, to_earlier)
    return gaps


def pose_at(trajectory: Trajectory, index: int) -> RigidTransform:
    """``T_world_body`` of one pose of the trajectory."""
    return RigidTransform.from_quaternion(
        trajectory.positions[index], trajectory.quaternions_xyzw[index]
    )


def interpolated_pose(
    trajectory: Trajectory, stamp_ns: int, widest_ns: int
) -> RigidTransform | None:
    """Pose at a stamp, between the two poses around it.

    Parameters
    ----------
    trajectory : Trajectory
    stamp_ns : int
    widest_ns : int
        Most time that may lie between the two poses.

    Returns
    -------
    RigidTransform or None
        ``T_world_body``, position linear and rotation spherical; None when the stamp
        lies outside the trajectory or in a wider gap.
    """
    after = int(np.searchsorted(trajectory.stamps_ns, stamp_ns, side="right"))
    if after == 0 or after == len(trajectory):
        return None
    first, last = int(trajectory.stamps_ns[after - 1]), int(trajectory.stamps_ns[after])
    if last - first > widest_ns:
        return None
    share = (stamp_ns - first) / (last - first)
    positions, quaternions = trajectory.positions, trajectory.quaternions_xyzw
    return RigidTransform.from_quaternion(
        (1.0 - share) * positions[after - 1] + share * positions[after],
        interpolate_quaternion(quaternions[after - 1], quaternions[after], share),
    )


def match_pose(trajectory: Trajectory, stamp_ns: int, config: MatchingConfig) -> PoseMatch:
    """Find the pose of a stamp.

    Parameters
    ----------
    trajectory : Trajectory
    stamp_ns : int
    config : MatchingConfig

    Returns
    -------
    PoseMatch
        Stamp and gap are those of the nearest message, whatever the method.

    Raises
    ------
    ShapeError
        If the trajectory is empty.
    """
    index = nearest_index(trajectory.stamps_ns, stamp_ns)
    pose_ns = int(trajectory.stamps_ns[index])
    gap_ns, limit_ns = abs(stamp_ns - pose_ns), seconds_to_ns(config.max_gap_s)
    pose: RigidTransform | None = None
    if gap_ns <= limit_ns:
        if config.method == "interpolate":
            pose = interpolated_pose(trajectory, stamp_ns, 2 * limit_ns + _JITTER_NS)
        pose = pose or pose_at(trajectory, index)
    return PoseMatch(pose_ns, gap_ns, pose)
