"""PX4's pose messages for tests."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from rosbags.typesys import get_types_from_msg

from beamseg_batch.geometry import matrix_from_quaternion
from tests.recordings import CDR, STORES, message

ODOMETRY, LOCAL_POSITION, ATTITUDE = (
    f"px4_msgs/msg/Vehicle{name}" for name in ("Odometry", "LocalPosition", "Attitude")
)
TYPES = {
    ODOMETRY: "uint64 timestamp\nuint64 timestamp_sample\nuint8 pose_frame\n"
    "float32[3] position\nfloat32[4] q\n",
    LOCAL_POSITION: "uint64 timestamp\nuint64 timestamp_sample\nbool xy_valid\nbool z_valid\n"
    "float32 x\nfloat32 y\nfloat32 z\nfloat32 heading\n",
    ATTITUDE: "uint64 timestamp\nuint64 timestamp_sample\nfloat32[4] q\n",
}
"""The fields that matter of PX4's messages, as version 1.14 has them."""
for name, text in TYPES.items():
    STORES[CDR].register(get_types_from_msg(text, name))

NED_ENU = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
FRD_FLU = np.diag([1.0, -1.0, -1.0])
FRAMES = {"ned": (1, NED_ENU), "frd": (2, FRD_FLU)}


def px4_of(position, quaternion_xyzw, world):
    """Position and quaternion w, x, y, z of FRD in a PX4 world, from FLU in a ROS world."""
    matrix = world.T @ matrix_from_quaternion(np.array(quaternion_xyzw)) @ FRD_FLU
    w = 0.5 * np.sqrt(max(1.0 + np.trace(matrix), 0.0))
    if w < 1e-3:
        raise AssertionError("half a turn: choose other poses")
    x, y, z = (
        matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]
    )  # fmt: skip
    return world.T @ np.array(position), np.array([w, x / (4 * w), y / (4 * w), z / (4 * w)])


def px4_poses(
    msgtype: str, poses: Sequence[tuple[int, Any, Any]], frame: str = "ned"
) -> Iterator[tuple[int, Any]]:
    """Messages of one type: their stamps and contents.

    Parameters
    ----------
    msgtype : str
    poses : sequence of (stamp_ns, position, quaternion_xyzw)
        FLU in ENU; metres.
    frame : str
        Of the odometry: ``ned`` or ``frd``.

    Yields
    ------
    int
    object
    """
    code, world = FRAMES[frame]
    for stamp, position, quaternion in poses:
        place, wxyz = px4_of(position, quaternion, world)
        if msgtype == LOCAL_POSITION:
            forward = world.T @ matrix_from_quaternion(np.array(quaternion))[:, 0]
            values = dict(zip("xyz", map(float, place), strict=True))
            values["heading"] = float(np.arctan2(forward[1], forward[0]))
            values.update(xy_valid=True, z_valid=True)
        else:
            values = {"q": wxyz.astype(np.float32)}
        if msgtype == ODOMETRY:
            values.update(pose_frame=code, position=place.astype(np.float32))
        yield stamp, message("mcap", msgtype, timestamp_sample=stamp // 1000, **values)
