"""Clouds of other types than ``sensor_msgs/PointCloud2`` -> points."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.geometry import RigidTransform
from beamseg_batch.recording.clouds import (
    BadCloudError,
    Cloud,
    CloudMessage,
    Confidence,
    first_named,
    read_cloud,
    read_header,
)
from beamseg_batch.recording.poses import xyz, xyzw

__all__ = ["CLOUD_READERS", "FOXGLOVE_CLOUDS", "packed_cloud"]

CloudFunction: TypeAlias = Callable[[Any, Confidence | None], Cloud]

FOXGLOVE_CLOUDS = ("foxglove.PointCloud", "foxglove_msgs/msg/PointCloud")

_SWAPPED_TYPES = {1: 2, 2: 1, 3: 4, 4: 3, 5: 6, 6: 5}
"""Foxglove's codes of integer types, which name the unsigned one first, as those of ROS."""
_NO_RETURN = np.float32(np.nan)


def read_point_list(message: Any, confidence: Confidence | None = None) -> Cloud:
    """Header and points of a ``sensor_msgs/PointCloud``, the type before PointCloud2.

    Parameters
    ----------
    message : object
    confidence : Confidence, optional
        Taken from the channel of that name.

    Returns
    -------
    Cloud
    """
    rows = [(point.x, point.y, point.z) for point in message.points]
    points = np.array(rows, dtype=np.float32).reshape(-1, 3)
    header = read_header(message)
    if confidence is not None and len(points):
        channels = {channel.name: np.asarray(channel.values) for channel in message.channels}
        try:
            values = channels[first_named(confidence.names, list(channels))]
            points = _believed(points, values, confidence.least)
        except BadCloudError as error:
            return Cloud(header, len(points), 1, points[:0], str(error))
    return Cloud(header, len(points), 1, points)


def _believed(
    points: NDArray[np.float32], values: NDArray[Any], least: float
) -> NDArray[np.float32]:
    if len(values) != len(points):
        raise BadCloudError(f"its {len(points)} points have {len(values)} values of confidence")
    return np.where((values >= least)[:, None], points, _NO_RETURN)


def read_foxglove_cloud(message: Any, confidence: Confidence | None = None) -> Cloud:
    """Header and points of a ``foxglove.PointCloud``.

    Parameters
    ----------
    message : object
    confidence : Confidence, optional

    Returns
    -------
    Cloud
        Its points in the message's frame: the cloud's own pose in it is applied.
    """
    cloud = read_cloud(packed_cloud(message), confidence)
    pose = _pose_of(message)
    if pose is None or cloud.problem:
        return cloud
    points = pose.apply(cloud.points.astype(np.float64)).astype(cloud.points.dtype)
    return Cloud(cloud.header, cloud.width, cloud.height, points)


def packed_cloud(message: Any) -> CloudMessage:
    """Write a ``foxglove.PointCloud`` as a PointCloud2 of one row.

    Parameters
    ----------
    message : object

    Returns
    -------
    CloudMessage
    """
    data = message.data
    if isinstance(data, str):  # as JSON holds bytes
        data = base64.b64decode(data)
    data = np.frombuffer(data, np.uint8)
    stride = int(message.point_stride)
    width = len(data) // stride if stride > 0 else 0
    frame, stamp_ns = read_header(message)
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return SimpleNamespace(
        header=SimpleNamespace(
            frame_id=frame, stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds)
        ),
        height=1,
        width=width,
        fields=[
            SimpleNamespace(
                name=field.name,
                offset=int(field.offset),
                datatype=_SWAPPED_TYPES.get(int(field.type), int(field.type)),
            )
            for field in message.fields
        ],
        is_bigendian=False,
        point_step=stride,
        row_step=width * stride,
        data=data,
    )


def _pose_of(message: Any) -> RigidTransform | None:
    """Where the cloud lies in its frame; None when that is where the frame itself lies."""
    pose = getattr(message, "pose", None)
    if pose is None:
        return None
    position, quaternion = np.array(xyz(pose.position)), np.array(xyzw(pose.orientation))
    turned = np.any(quaternion[:3]) and np.all(np.isfinite(quaternion))
    if not turned and not np.any(position):
        return None
    if not np.any(quaternion):  # left out
        quaternion = np.array([0.0, 0.0, 0.0, 1.0])
    return RigidTransform.from_quaternion(position, quaternion / np.linalg.norm(quaternion))


CLOUD_READERS: Mapping[str, CloudFunction] = {
    "sensor_msgs/msg/PointCloud2": read_cloud,
    "sensor_msgs/msg/PointCloud": read_point_list,
    **dict.fromkeys(FOXGLOVE_CLOUDS, read_foxglove_cloud),
}
"""How the clouds of each type are read."""
