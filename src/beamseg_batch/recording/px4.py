"""Poses as PX4 writes them: north-east-down and forward-right-down, w first.

ROS has its world x east, y north, z up (ENU) and its bodies x forward, y left, z up (FLU).
PX4's world is NED, its bodies FRD. Turning a world from NED to ENU swaps x and y and flips
z, which is half a turn about the axis between x and y; turning a body from FRD to FLU is
half a turn about x. See the PX4 guide, "Reference frames and ROS".
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, TypeAlias

__all__ = ["ATTITUDE", "LOCAL_POSITION", "ODOMETRY", "px4_values", "sample_ns"]

ODOMETRY = "px4_msgs/msg/VehicleOdometry"
LOCAL_POSITION = "px4_msgs/msg/VehicleLocalPosition"
ATTITUDE = "px4_msgs/msg/VehicleAttitude"

Values: TypeAlias = tuple[float, float, float, float, float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]

_HALF = math.sqrt(0.5)
_NED_FRAMES: Mapping[str, int] = {"pose_frame": 1, "local_frame": 0}
"""What stands for NED in each field that names the frame, of newer and of older versions."""


def sample_ns(message: Any) -> int:
    """When the pose was true, in nanoseconds: PX4 counts microseconds.

    Parameters
    ----------
    message : object

    Returns
    -------
    int, nanoseconds
        The time of the sample, else that of the message; 0 when neither is set.
    """
    sampled = getattr(message, "timestamp_sample", 0) or message.timestamp
    return int(sampled) * 1000


def px4_values(message: Any) -> Values:
    """Pose of a ``VehicleOdometry`` or ``VehicleLocalPosition``, or attitude alone.

    Parameters
    ----------
    message : object

    Returns
    -------
    tuple of 7 float
        Position x, y, z in metres, then quaternion x, y, z, w: FLU in ENU, or in the FLU
        world of an odometry that does not know north. NaN where the message says that a
        value does not hold; the position of an attitude is zero.
    """
    if hasattr(message, "heading"):
        return _local_position(message)
    if not hasattr(message, "position") and not hasattr(message, "x"):
        return (0.0, 0.0, 0.0, *_enu_flu(_wxyz(message)))
    north = message.position if hasattr(message, "position") else (message.x, message.y, message.z)
    x, y, z = map(float, north)
    if _is_ned(message):
        return (y, x, -z, *_enu_flu(_wxyz(message)))
    return (x, -y, -z, *_flu_flu(_wxyz(message)))


def _local_position(message: Any) -> Values:
    """Position and heading, without roll and pitch, which this type does not hold."""
    x, y, z = (float(value) for value in (message.x, message.y, message.z))
    if not (getattr(message, "xy_valid", True) and getattr(message, "z_valid", True)):
        x = math.nan
    half = 0.5 * float(message.heading)
    return (y, x, -z, *_enu_flu((math.cos(half), 0.0, 0.0, math.sin(half))))


def _is_ned(message: Any) -> bool:
    for name, value in _NED_FRAMES.items():
        if hasattr(message, name):
            return int(getattr(message, name)) == value
    return True


def _wxyz(message: Any) -> Quaternion:
    w, x, y, z = map(float, message.q)
    return w, x, y, z


def _enu_flu(wxyz: Quaternion) -> Quaternion:
    """Attitude of FLU in ENU, x, y, z, w, from that of FRD in NED."""
    w, x, y, z = wxyz
    # (0, 1, 1, 0)/sqrt(2) * q * (0, 1, 0, 0), multiplied out.
    return (_HALF * (x + y), _HALF * (x - y), _HALF * (w - z), _HALF * (w + z))


def _flu_flu(wxyz: Quaternion) -> Quaternion:
    """Attitude of FLU in an FLU world, x, y, z, w, from that of FRD in an FRD world."""
    w, x, y, z = wxyz
    return (x, -y, -z, w)
