"""Depth images -> points, with the pinhole of their ``sensor_msgs/CameraInfo``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.errors import RecordingError
from beamseg_batch.geometry import FloatArray
from beamseg_batch.recording.clouds import BadCloudError, Cloud, read_header
from beamseg_batch.recording.first import read_first
from beamseg_batch.recording.source import Recording, TopicInfo

__all__ = ["CAMERA_INFO", "IMAGE", "DepthCamera", "find_camera", "is_depth_topic"]

IMAGE = "sensor_msgs/msg/Image"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"

_DEPTHS = {"16UC1": ("u2", 1e-3), "mono16": ("u2", 1e-3), "32FC1": ("f4", 1.0)}
"""Types of a pixel by the image's encoding, and the metres that its unit has."""
_UNDISTORT_STEPS = 20
_RADIAL_TANGENTIAL = ("plumb_bob", "rational_polynomial", "")


@dataclass(frozen=True, eq=False)
class DepthCamera:
    """The pinhole of a depth camera.

    Attributes
    ----------
    topic : str
        Where it was read.
    matrix : tuple of 4 float
        Focal lengths and principal point ``fx, fy, cx, cy`` in pixels.
    distortion : tuple of float
        ``k1, k2, p1, p2, k3`` and, of the rational model, ``k4, k5, k6``; empty for none.
    note : str
        What of the camera is not modelled, else empty.
    """

    topic: str
    matrix: tuple[float, float, float, float]
    distortion: tuple[float, ...]
    note: str = ""

    def read(self, message: Any) -> Cloud:
        """Header and points of a depth image.

        Parameters
        ----------
        message : object
            A ``sensor_msgs/Image`` of depths along the optical axis.

        Returns
        -------
        Cloud
            float32, metres, optical frame: z forward, x right, y down. A pixel without
            depth is NaN.
        """
        header, width, height = read_header(message), int(message.width), int(message.height)
        try:
            depths = _depths(message)
        except BadCloudError as error:
            return Cloud(header, width, height, np.empty((0, 3), dtype=np.float32), str(error))
        points = _rays(height, width, self.matrix, self.distortion) * depths[:, :, None]
        return Cloud(header, width, height, points.reshape(-1, 3))


@lru_cache(maxsize=2)
def _rays(
    height: int,
    width: int,
    matrix: tuple[float, float, float, float],
    distortion: tuple[float, ...],
) -> NDArray[np.float32]:
    """Points at depth 1 m of all pixels, in the optical frame."""
    fx, fy, cx, cy = matrix
    rows, columns = np.mgrid[0:height, 0:width].astype(np.float64)
    x, y = _undistorted((columns - cx) / fx, (rows - cy) / fy, distortion)
    return np.stack([x, y, np.ones_like(x)], axis=-1).astype(np.float32)


def _depths(message: Any) -> NDArray[np.float32]:
    """Depths in metres, NaN where there is none."""
    if message.encoding not in _DEPTHS:
        raise BadCloudError(
            f"the image's encoding is {message.encoding!r}; depths are {' or '.join(_DEPTHS)}"
        )
    kind, unit = _DEPTHS[message.encoding]
    height, width, step = int(message.height), int(message.width), int(message.step)
    pixel = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    if step < width * pixel.itemsize or len(message.data) < height * step:
        raise BadCloudError(
            f"{height} rows of {step} bytes with {width} pixels of {pixel.itemsize} bytes do not "
            f"fit into {len(message.data)} bytes of data"
        )
    if height * width == 0:
        return np.empty((height, width), dtype=np.float32)
    data = np.asarray(message.data)
    values = np.ndarray((height, width), pixel, data, 0, (step, pixel.itemsize))
    depths = values.astype(np.float32) * np.float32(unit)
    depths[~(depths > 0.0)] = np.nan
    return depths


def _undistorted(
    x: FloatArray, y: FloatArray, distortion: tuple[float, ...]
) -> tuple[FloatArray, FloatArray]:
    """Where pixels would lie without distortion, by fixed-point iteration."""
    if not any(distortion):
        return x, y
    k1, k2, p1, p2, k3, k4, k5, k6 = (*distortion, *(8 * [0.0]))[:8]
    x_free, y_free = x, y
    for _ in range(_UNDISTORT_STEPS):
        r2 = x_free**2 + y_free**2
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        shift_x = 2 * p1 * x_free * y_free + p2 * (r2 + 2 * x_free**2)
        shift_y = p1 * (r2 + 2 * y_free**2) + 2 * p2 * x_free * y_free
        x_free, y_free = (x - shift_x) / radial, (y - shift_y) / radial
    return x_free, y_free


def is_depth_topic(recording: Recording, topic: TopicInfo) -> bool:
    """Whether a topic holds images of depths: its first message tells.

    Parameters
    ----------
    recording : Recording
    topic : TopicInfo

    Returns
    -------
    bool
    """
    if topic.msgtype != IMAGE:
        return False
    return read_first(recording, topic, lambda message: message.encoding) in _DEPTHS


def find_camera(recording: Recording, topic: TopicInfo) -> DepthCamera:
    """Find the camera of a topic of depth images.

    Parameters
    ----------
    recording : Recording
    topic : TopicInfo
        Of type ``sensor_msgs/Image``.

    Returns
    -------
    DepthCamera
        Of the ``camera_info`` topic beside it, else of the only one in its frame.

    Raises
    ------
    RecordingError
        If no camera, or no usable one, belongs to the topic.
    """
    infos = [t for t in recording.topics if t.msgtype == CAMERA_INFO and t.count]
    beside = f"{topic.name.rpartition('/')[0]}/camera_info"
    chosen = [info for info in infos if info.name == beside]
    if not chosen:
        frame = read_first(recording, topic, read_header)
        chosen = [
            info
            for info in infos
            if frame and (own := read_first(recording, info, read_header)) and own[0] == frame[0]
        ]
    where = f"{recording.name}: {topic.name}"
    if len(chosen) != 1:
        listed = ", ".join(info.name for info in infos) or "none"
        raise RecordingError(
            f"{where}: a depth image needs its camera: no topic {beside} of type {CAMERA_INFO}, "
            f"and not one alone in its frame; there are: {listed}"
        )
    # The projection of a rectified image, which has no distortion, is another matrix.
    rectified = "rect" in topic.name.rpartition("/")[2]
    camera = read_first(recording, chosen[0], lambda m: _camera(chosen[0].name, m, rectified))
    if camera is None or not min(camera.matrix[:2]) > 0.0:
        raise RecordingError(f"{where}: {chosen[0].name} holds no focal length: {camera}")
    return camera


def _camera(name: str, message: Any, rectified: bool) -> DepthCamera:
    """Read a camera; ROS 1 writes the names of its matrices in capitals."""
    matrix = _either(message, "k")
    projection = _either(message, "p")
    if rectified and projection[0] > 0.0:
        places = (projection[0], projection[5], projection[2], projection[6])
        return DepthCamera(name, tuple(map(float, places)), ())  # type: ignore[arg-type]
    places = (matrix[0], matrix[4], matrix[2], matrix[5])
    distortion = tuple(map(float, _either(message, "d")))
    note = ""
    if any(distortion) and message.distortion_model not in _RADIAL_TANGENTIAL:
        note = (
            f"the lens of {name} is of the model {message.distortion_model!r}, which is not "
            "known: its distortion is left as it is; rectify the images for exact points"
        )
        distortion = ()
    return DepthCamera(name, tuple(map(float, places)), distortion, note)  # type: ignore[arg-type]


def _either(message: Any, name: str) -> Any:
    value = getattr(message, name, None)
    return getattr(message, name.upper()) if value is None else value
