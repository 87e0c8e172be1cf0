"""``sensor_msgs/PointCloud2`` -> points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.errors import RecordingError

__all__ = [
    "BadCloudError",
    "Cloud",
    "CloudHeader",
    "CloudMessage",
    "PointLayout",
    "point_layout",
    "points_from_cloud",
    "read_cloud",
    "read_header",
]

_FLOAT_TYPES: Mapping[int, str] = {7: "f4", 8: "f8"}
"""Codes of sensor_msgs/PointField that a coordinate may have."""
_TYPE_NAMES = {
    1: "int8", 2: "uint8", 3: "int16", 4: "uint16", 5: "int32", 6: "uint32",
}  # fmt: skip


class BadCloudError(RecordingError):
    """A cloud's fields or sizes contradict its data."""


class CloudMessage(Protocol):
    """The fields of ``sensor_msgs/PointCloud2`` that are read here."""

    header: Any
    height: int
    width: int
    fields: list[Any]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Cloud:
    """What is needed of one cloud message.

    Attributes
    ----------
    header : CloudHeader
    width, height : int
    points : (height * width, 3) float32 or float64, metres, sensor frame
        As `points_from_cloud` gives them; empty when there is a problem.
    problem : str
        Why the points cannot be read, else empty.
    """

    header: CloudHeader
    width: int
    height: int
    points: NDArray[np.floating]
    problem: str = ""


class CloudHeader(NamedTuple):
    """Frame and stamp of a cloud.

    Attributes
    ----------
    frame : str
        Without the leading slash that ROS 1 allowed.
    stamp_ns : int
        0 when it was not set.
    """

    frame: str
    stamp_ns: int


def read_header(message: CloudMessage) -> CloudHeader:
    """Frame and stamp of a cloud message.

    Parameters
    ----------
    message : CloudMessage

    Returns
    -------
    CloudHeader
    """
    stamp = message.header.stamp
    return CloudHeader(
        message.header.frame_id.lstrip("/"), stamp.sec * 1_000_000_000 + stamp.nanosec
    )


def read_cloud(message: CloudMessage) -> Cloud:
    """Header and points of a cloud message.

    Parameters
    ----------
    message : CloudMessage

    Returns
    -------
    Cloud
        With its `problem` told when the points cannot be read.
    """
    header, width, height = read_header(message), int(message.width), int(message.height)
    try:
        return Cloud(header, width, height, points_from_cloud(message))
    except BadCloudError as error:
        return Cloud(header, width, height, np.empty((0, 3), dtype=np.float32), str(error))


def points_from_cloud(message: CloudMessage) -> NDArray[np.floating]:
    """Coordinates of a cloud's points, in the order of the message.

    Parameters
    ----------
    message : CloudMessage
        Any order, offsets and padding of fields, either byte order, 32 or 64 bits,
        organised or not, rows padded or not.

    Returns
    -------
    (height * width, 3) float32 or float64, metres, sensor frame
        In native byte order. No-returns stay as they are, NaN or infinite. A read-only
        view of the message where x, y and z lie side by side, aligned and in native
        byte order, else a copy.

    Raises
    ------
    BadCloudError
        If x, y or z is missing or not a float, or if the data is shorter than the
        sizes claim.
    """
    return point_layout(message).points(np.asarray(message.data))


@dataclass(frozen=True)
class PointLayout:
    """Where the coordinates of a cloud lie in its data.

    Attributes
    ----------
    height, width : int
        Pixels.
    row_step : int
        Bytes from row to row.
    pixel : numpy dtype
        One pixel, with the fields x, y and z only.
    """

    height: int
    width: int
    row_step: int
    pixel: np.dtype[Any]

    def points(self, data: NDArray[np.uint8]) -> NDArray[np.floating]:
        """Coordinates in the data of a cloud, as `points_from_cloud` gives them.

        Parameters
        ----------
        data : (M,) uint8
            At least ``height * row_step`` bytes.

        Returns
        -------
        (height * width, 3) float32 or float64, metres, sensor frame
        """
        if self.height * self.width == 0:
            return np.empty((0, 3), dtype=np.float32)
        strides = (self.row_step, self.pixel.itemsize)
        pixels = np.ndarray((self.height, self.width), self.pixel, data, 0, strides)
        points = _side_by_side(pixels, self.pixel)
        if points is None:
            # A signalling NaN in one field is no error when it becomes a NaN of another type.
            with np.errstate(invalid="ignore"):
                points = np.stack([pixels["x"], pixels["y"], pixels["z"]], axis=-1)
        points = points.reshape(-1, 3)
        if points.flags.aligned and points.dtype.isnative:
            return points
        with np.errstate(invalid="ignore"):
            return points.astype(points.dtype.newbyteorder("="))


def point_layout(message: CloudMessage) -> PointLayout:
    """Where the coordinates of a cloud lie.

    Parameters
    ----------
    message : CloudMessage

    Returns
    -------
    PointLayout

    Raises
    ------
    BadCloudError
        As `points_from_cloud` does.
    """
    height, width = int(message.height), int(message.width)
    if height * width == 0:
        return PointLayout(height, width, 0, np.dtype([]))
    row_step = _checked_row_step(message, height, width)
    return PointLayout(height, width, row_step, _coordinate_layout(message))


def _checked_row_step(message: CloudMessage, height: int, width: int) -> int:
    """Bytes from row to row; the sizes must agree with one another and with the data."""
    # Some drivers leave row_step 0 in clouds that are not organised.
    row_step = int(message.row_step) or width * int(message.point_step)
    if row_step < width * message.point_step:
        raise BadCloudError(
            f"row_step {row_step} is less than {width} points of {message.point_step} bytes"
        )
    if len(message.data) < height * row_step:
        raise BadCloudError(
            f"the data has {len(message.data)} bytes, but {height} rows of {row_step} bytes "
            f"need {height * row_step}"
        )
    return row_step


def _coordinate_layout(message: CloudMessage) -> np.dtype[Any]:
    """Build the structured dtype of one point, with x, y and z only."""
    order = ">" if message.is_bigendian else "<"
    formats, offsets = [], []
    for name in "xyz":
        field = next((field for field in message.fields if field.name == name), None)
        if field is None:
            present = ", ".join(field.name for field in message.fields) or "none"
            raise BadCloudError(f"the cloud has no field {name!r}; its fields are: {present}")
        if field.datatype not in _FLOAT_TYPES:
            kind = _TYPE_NAMES.get(field.datatype, f"type {field.datatype}")
            raise BadCloudError(f"field {name!r} is {kind}; float32 or float64 is needed")
        formats.append(order + _FLOAT_TYPES[field.datatype])
        offsets.append(int(field.offset))
        if field.offset + np.dtype(formats[-1]).itemsize > message.point_step:
            raise BadCloudError(
                f"field {name!r} at byte {field.offset} does not fit into a point of "
                f"{message.point_step} bytes"
            )
    return np.dtype(
        {
            "names": ["x", "y", "z"],
            "formats": formats,
            "offsets": offsets,
            "itemsize": int(message.point_step),
        }
    )


def _side_by_side(pixels: NDArray[Any], layout: np.dtype[Any]) -> NDArray[Any] | None:
    """View x, y and z as one axis when they share a type and follow one another."""
    assert layout.fields is not None
    (kind, offset), *others = (layout.fields[name][:2] for name in "xyz")
    if others != [(kind, offset + kind.itemsize), (kind, offset + 2 * kind.itemsize)]:
        return None
    first = pixels["x"]
    return np.lib.stride_tricks.as_strided(
        first, (*first.shape, 3), (*first.strides, kind.itemsize), writeable=False
    )
