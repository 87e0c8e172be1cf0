"""Messages that differ from a decoded one in a few fields of known place.

The messages of a topic repeat nearly all their bytes: frame names, fields, sizes. What
was learnt by decoding one of them holds for every other that has the same bytes there,
so only its stamp and its numbers are read. Anything else is decoded as usual.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.geometry import FloatArray
from beamseg_batch.recording.clouds import (
    BadCloudError,
    Cloud,
    CloudHeader,
    CloudMessage,
    Confidence,
    PointLayout,
    point_layout,
    read_header,
)
from beamseg_batch.recording.codec import CDR, ROS1

__all__ = [
    "HEADER_BYTES",
    "HEADER_FIRST",
    "STAMP_AT",
    "CloudTemplate",
    "PoseTemplate",
    "cloud_template",
    "header_stamp_ns",
    "is_templated",
    "pose_values_at",
]

STAMP_AT = 4
"""Where a header's stamp lies: behind the CDR preamble, or behind the ROS 1 sequence number."""

HEADER_BYTES = 12
"""Fewest bytes of a message with a header: up to the end of its stamp."""
HEADER_FIRST = (
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/PointCloud",
    "sensor_msgs/msg/Image",
)
"""Types of clouds that begin with a header."""

_STAMP_BYTES = 8
_VALUES_BYTES = 56
_LITTLE_ENDIAN_CDR = b"\x00\x01"
_ONE_FRAME = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped")
_TWO_FRAMES = ("geometry_msgs/msg/TransformStamped", "nav_msgs/msg/Odometry")


def is_templated(raw: bytes, encoding: str) -> bool:
    """Whether a message is of an encoding whose places are known here.

    Parameters
    ----------
    raw : bytes
    encoding : str
        `ROS1` or `CDR`.

    Returns
    -------
    bool
    """
    return encoding == ROS1 or (encoding == CDR and raw[:2] == _LITTLE_ENDIAN_CDR)


def header_stamp_ns(raw: bytes) -> int:
    """Stamp of a message that begins with a header and `is_templated`.

    Parameters
    ----------
    raw : bytes

    Returns
    -------
    int, nanoseconds
    """
    seconds, nanoseconds = struct.unpack_from("<iI", raw, STAMP_AT)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def pose_values_at(raw: bytes, msgtype: str, encoding: str) -> int | None:
    """Where the seven numbers of a pose lie in a message.

    Parameters
    ----------
    raw : bytes
    msgtype : str
        Named as ROS 2 does.
    encoding : str
        `ROS1` or `CDR`.

    Returns
    -------
    int or None
        Offset of position x; None for a message of another kind.
    """
    n_names = 1 if msgtype in _ONE_FRAME else 2 if msgtype in _TWO_FRAMES else 0
    if n_names == 0 or not is_templated(raw, encoding):
        return None
    preamble, alignment = (0, 1) if encoding == ROS1 else (4, 4)
    at = STAMP_AT + _STAMP_BYTES
    for _ in range(n_names):
        at += (preamble - at) % alignment
        if at + 4 > len(raw):
            return None
        at += 4 + int(struct.unpack_from("<I", raw, at)[0])
    if encoding == CDR:
        at += (preamble - at) % 8
    return at if at + _VALUES_BYTES <= len(raw) else None


@dataclass(frozen=True, eq=False)
class PoseTemplate:
    """A pose message, and the places in which others may differ from it.

    Attributes
    ----------
    raw : bytes
        The message.
    values_at : int
        Where its seven numbers lie.
    """

    raw: bytes
    values_at: int

    def parse(self, batch: Sequence[bytes]) -> tuple[NDArray[np.int64], FloatArray] | None:
        """Read the stamps and numbers of many messages at once.

        Parameters
        ----------
        batch : sequence of bytes

        Returns
        -------
        stamps_ns : (N,) int64
        values : (N, 7) float64
            Position in metres, then quaternion x, y, z, w.

        None is returned when a message of the batch is laid out in another way.
        """
        size = len(self.raw)
        if any(len(raw) != size for raw in batch):
            return None
        table = np.frombuffer(b"".join(batch), np.uint8).reshape(-1, size)
        names = slice(STAMP_AT + _STAMP_BYTES, self.values_at)
        if (table[:, names] != np.frombuffer(self.raw[names], np.uint8)).any():
            return None
        stamps = table[:, STAMP_AT : STAMP_AT + _STAMP_BYTES].copy().view("<u4").astype(np.int64)
        values = table[:, self.values_at : self.values_at + _VALUES_BYTES].copy().view("<f8")
        return stamps[:, 0] * 1_000_000_000 + stamps[:, 1], values.astype(np.float64, copy=False)


@dataclass(frozen=True, eq=False)
class CloudTemplate:
    """A cloud message, and how the points of others like it are found.

    Attributes
    ----------
    raw : bytes
        The message.
    data_at, data_bytes : int
        Where its points lie, and how much room they take.
    frame : str
    layout : PointLayout
    """

    raw: bytes
    data_at: int
    data_bytes: int
    frame: str
    layout: PointLayout

    def read(self, raw: bytes) -> Cloud | None:
        """Read a cloud that differs in stamp and points alone.

        Parameters
        ----------
        raw : bytes

        Returns
        -------
        Cloud or None
            None when the message differs in more.
        """
        fields = slice(STAMP_AT + _STAMP_BYTES, self.data_at)
        if len(raw) != len(self.raw) or raw[fields] != self.raw[fields]:
            return None
        data = np.frombuffer(raw, np.uint8, self.data_bytes, self.data_at)
        header = CloudHeader(self.frame, header_stamp_ns(raw))
        return Cloud(header, self.layout.width, self.layout.height, self.layout.points(data))


def cloud_template(
    raw: bytes, message: CloudMessage, encoding: str, confidence: Confidence | None = None
) -> CloudTemplate | None:
    """Make a template of a decoded cloud.

    Parameters
    ----------
    raw : bytes
    message : CloudMessage
        The same, decoded.
    encoding : str
        `ROS1` or `CDR`.
    confidence : Confidence, optional
        Which points are believed.

    Returns
    -------
    CloudTemplate or None
        None when the points do not lie where they are looked for, or cannot be read.
    """
    header, data = read_header(message), np.asarray(message.data)
    data_at = len(raw) - 1 - len(data)  # one byte, whether it is dense, stands behind
    if data_at < STAMP_AT + _STAMP_BYTES or not is_templated(raw, encoding):
        return None
    found = np.frombuffer(raw, np.uint8, len(data), data_at)
    if header.stamp_ns != header_stamp_ns(raw) or not np.array_equal(found, data):
        return None
    try:
        layout = point_layout(message, confidence)
        return CloudTemplate(raw, data_at, len(data), header.frame, layout)
    except BadCloudError:
        return None
