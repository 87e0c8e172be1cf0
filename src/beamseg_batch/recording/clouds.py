"""Packed clouds, such as ``sensor_msgs/PointCloud2`` -> points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.errors import RecordingError

__all__ = [
    "FIELD_TYPES",
    "BadCloudError",
    "Cloud",
    "CloudHeader",
    "CloudMessage",
    "Confidence",
    "PointLayout",
    "first_named",
    "point_layout",
    "points_from_cloud",
    "read_cloud",
    "read_header",
    "stamp_ns_of",
]

FIELD_TYPES: Mapping[int, str] = {
    1: "int8", 2: "uint8", 3: "int16", 4: "uint16", 5: "int32", 6: "uint32",
    7: "float32", 8: "float64",
}  # fmt: skip
"""Types of a field by their code in sensor_msgs/PointField."""


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


class Confidence(NamedTuple):
    """Which points of a cloud are believed.

    Attributes
    ----------
    names : tuple of str
        Names that the field may have; the first one that a cloud has counts.
    least : float
        Points with less, or with NaN, become no-returns.
    """

    names: tuple[str, ...]
    least: float


def stamp_ns_of(stamp: Any) -> int:
    """Time of a stamp of ROS, or of one of Foxglove's.

    Parameters
    ----------
    stamp : object
        With ``sec``, and ``nanosec`` or ``nsec``.

    Returns
    -------
    int, nanoseconds
    """
    nanoseconds = stamp.nanosec if hasattr(stamp, "nanosec") else stamp.nsec
    return int(stamp.sec) * 1_000_000_000 + int(nanoseconds)


def read_header(message: Any) -> CloudHeader:
    """Frame and stamp of a message with a header, or of one of Foxglove's.

    Parameters
    ----------
    message : object

    Returns
    -------
    CloudHeader
    """
    header = getattr(message, "header", None)
    if header is None:
        return CloudHeader(message.frame_id.lstrip("/"), stamp_ns_of(message.timestamp))
    return CloudHeader(header.frame_id.lstrip("/"), stamp_ns_of(header.stamp))


def read_cloud(message: CloudMessage, confidence: Confidence | None = None) -> Cloud:
    """Header and points of a cloud message.

    Parameters
    ----------
    message : CloudMessage
    confidence : Confidence, optional
        Which points are believed; without it all are.

    Returns
    -------
    Cloud
        With its `problem` told when the points cannot be read.
    """
    header, width, height = read_header(message), int(message.width), int(message.height)
    try:
        return Cloud(header, width, height, points_from_cloud(message, confidence))
    except BadCloudError as error:
        return Cloud(header, width, height, np.empty((0, 3), dtype=np.float32), str(error))


def points_from_cloud(
    message: CloudMessage, confidence: Confidence | None = None
) -> NDArray[np.floating]:
    """Coordinates of a cloud's points, in the order of the message.

    Parameters
    ----------
    message : CloudMessage
        Any order, type, offsets and padding of fields, either byte order, organised or
        not, rows padded or not.
    confidence : Confidence, optional
        Which points are believed; the others become NaN.

    Returns
    -------
    (height * width, 3) float32 or float64, metres, sensor frame
        In native byte order; integers as the floats that hold them. No-returns stay as
        they are, NaN or infinite. A read-only view of the message where x, y and z lie
        side by side as floats, aligned and in native byte order, else a copy.

    Raises
    ------
    BadCloudError
        If x, y, z or the confidence is missing or of no known type, or if the data is
        shorter than the sizes claim.
    """
    return point_layout(message, confidence).points(np.asarray(message.data))


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
        One pixel, with the fields x, y and z only, and with `least` also confidence.
    least : float, optional
        Points with less confidence become NaN.
    """

    height: int
    width: int
    row_step: int
    pixel: np.dtype[Any]
    least: float | None = None

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
                axes = [_as_floats(pixels[name]) for name in "xyz"]
                points = np.stack(axes, axis=-1)
        points = _as_floats(points.reshape(-1, 3))
        if self.least is None:
            return points
        believed = (pixels["confidence"] >= self.least).reshape(-1, 1)
        return np.where(believed, points, points.dtype.type(np.nan))


def _as_floats(points: NDArray[Any]) -> NDArray[np.floating]:
    """Make values floats that are aligned and in native byte order, if they are not."""
    if points.dtype.kind != "f":
        return points.astype(np.result_type(points.dtype.newbyteorder("="), np.float32))
    if points.flags.aligned and points.dtype.isnative:
        return points
    with np.errstate(invalid="ignore"):
        return points.astype(points.dtype.newbyteorder("="))


def point_layout(message: CloudMessage, confidence: Confidence | None = None) -> PointLayout:
    """Where the coordinates of a cloud lie.

    Parameters
    ----------
    message : CloudMessage
    confidence : Confidence, optional

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
    wanted = {name: name for name in "xyz"}
    if confidence is not None:
        present = [field.name for field in message.fields]
        wanted[first_named(confidence.names, present)] = "confidence"
    pixel = _pixel(message, wanted)
    return PointLayout(height, width, row_step, pixel, confidence and confidence.least)


def first_named(names: Sequence[str], present: Sequence[str]) -> str:
    """First of the names of a confidence field that a cloud has; BadCloudError without any."""
    for name in names:
        if name in present:
            return name
    raise BadCloudError(
        f"the cloud has no field {' or '.join(map(repr, names))}, which sensor.min_confidence "
        f"asks for; its fields are: {', '.join(present) or 'none'}; see sensor.confidence_fields"
    )


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


def _pixel(message: CloudMessage, wanted: Mapping[str, str]) -> np.dtype[Any]:
    """Build the structured dtype of one point, with the wanted fields under new names."""
    order: Literal["<", ">"] = ">" if message.is_bigendian else "<"
    formats, offsets = [], []
    for name in wanted:
        field = next((field for field in message.fields if field.name == name), None)
        if field is None:
            present = ", ".join(field.name for field in message.fields) or "none"
            raise BadCloudError(f"the cloud has no field {name!r}; its fields are: {present}")
        if field.datatype not in FIELD_TYPES:
            raise BadCloudError(
                f"field {name!r} is of type {field.datatype}, which is none; types are 1 (int8) "
                "to 8 (float64)"
            )
        formats.append(np.dtype(FIELD_TYPES[field.datatype]).newbyteorder(order))
        offsets.append(int(field.offset))
        if field.offset + formats[-1].itemsize > message.point_step:
            raise BadCloudError(
                f"field {name!r} at byte {field.offset} does not fit into a point of "
                f"{message.point_step} bytes"
            )
    return np.dtype(
        {
            "names": list(wanted.values()),
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
