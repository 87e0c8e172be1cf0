"""`structure.npz`: the structure as arrays, for what the tables have no room for.

Each array is declared once, and written, checked and documented by that. A reader takes
the arrays that it knows and leaves others, so that more can be added, such as binned sums
of the evidence along each beam, without a new `SCHEMA_VERSION`.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.errors import RunError
from beamseg_batch.model import FlightResult

__all__ = [
    "ARRAYS",
    "STRUCTURE_FILE",
    "Arrays",
    "documentation",
    "read_structure",
    "structure_arrays",
    "structure_npz",
]

Arrays: TypeAlias = dict[str, NDArray[Any]]

STRUCTURE_FILE = "structure.npz"
SCHEMA_VERSION = 1
"""Raised when an array changes its name or its meaning."""


@dataclass(frozen=True)
class Array:
    """One array of the file.

    Attributes
    ----------
    name, unit, meaning : str
        As in the documentation.
    shape : tuple of int or str
        A letter stands for a length that is the same wherever it stands.
    dtype : str
    """

    name: str
    shape: tuple[int | str, ...]
    dtype: str
    unit: str
    meaning: str


ARRAYS = (
    Array("schema_version", (), "int64", "", "Version of these arrays"),
    Array("segment_anchor", ("S", 3), "float64", "m", "A point of the axis of each beam"),
    Array("segment_direction", ("S", 3), "float64", "", "Unit direction of the axis"),
    Array("segment_t", ("S", 2), "float64", "m", "Both ends: `anchor + t * direction`"),
    Array("segment_radius", ("S",), "float64", "m", "Radius"),
    Array(
        "segment_covariance",
        ("S", 6, 6),
        "float64",
        "m, rad",
        "Of anchor and direction, which is only across the axis; NaN where it is not known",
    ),
    Array("segment_measured_radius", ("S",), "float64", "m", "`measured_radius` of the table"),
    Array("segment_sigma_radius", ("S",), "float64", "m", "`sigma_radius` of the table"),
    Array("segment_sigma_ends", ("S", 2), "float64", "m", "`sigma_end_1` and `sigma_end_2`"),
    Array(
        "segment_ends_seen",
        ("S", 2),
        "float64",
        "",
        "`end_1_seen` and `end_2_seen`: 1, 0, or NaN where it was not asked",
    ),
    Array("joint_position", ("J", 3), "float64", "m", "The point closest to all axes of a joint"),
    Array(
        "joint_covariance",
        ("J", 3, 3),
        "float64",
        "m²",
        "Of that point; NaN where that of an axis is not known",
    ),
    Array("trajectory_stamp_ns", ("P",), "int64", "ns", "Stamps of the drone's poses"),
    Array("trajectory_position", ("P", 3), "float64", "m", "Where the drone was"),
    Array(
        "trajectory_quaternion_xyzw",
        ("P", 4),
        "float64",
        "",
        "How it was turned, `T_world_body`; unit quaternions",
    ),
    Array("cloud", ("C", 3), "float32", "m", "A thinned cloud of the whole flight"),
)
"""Every array of the file, in the order in which they are written."""


def structure_arrays(result: FlightResult) -> Arrays:
    """Collect the arrays of a flight.

    Parameters
    ----------
    result : FlightResult

    Returns
    -------
    mapping of str to array
        Those of `ARRAYS`. World frame.
    """
    segments, joints, trajectory = result.segments, result.joints, result.trajectory
    unknown = (np.nan, np.nan)
    values: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "segment_anchor": [s.anchor for s in segments],
        "segment_direction": [s.direction for s in segments],
        "segment_t": [(s.t_min, s.t_max) for s in segments],
        "segment_radius": [s.radius for s in segments],
        "segment_covariance": [s.covariance for s in segments],
        "segment_measured_radius": [s.measured_radius for s in segments],
        "segment_sigma_radius": [s.sigma_radius for s in segments],
        "segment_sigma_ends": [s.sigma_ends for s in segments],
        "segment_ends_seen": [s.ends_seen or unknown for s in segments],
        "joint_position": [joint.position for joint in joints],
        "joint_covariance": [joint.covariance for joint in joints],
        "trajectory_stamp_ns": trajectory.stamps_ns,
        "trajectory_position": trajectory.positions,
        "trajectory_quaternion_xyzw": trajectory.quaternions_xyzw,
        "cloud": result.cloud,
    }
    return {array.name: _shaped(values[array.name], array) for array in ARRAYS}


def structure_npz(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Pack arrays as numpy does, but into the same bytes whenever it is done.

    Parameters
    ----------
    arrays : mapping of str to array
        Numbers only.

    Returns
    -------
    bytes
        A compressed ``.npz`` file.
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy")  # of 1980: no clock is asked
            entry.compress_type = zipfile.ZIP_DEFLATED
            with archive.open(entry, "w", force_zip64=True) as file:
                np.lib.format.write_array(file, np.asarray(array), allow_pickle=False)
    return buffer.getvalue()


def read_structure(file: Path) -> Arrays:
    """Read the arrays of a run.

    Parameters
    ----------
    file : Path

    Returns
    -------
    mapping of str to array
        Those of `ARRAYS`, and no others.

    Raises
    ------
    RunError
        If the file cannot be read, is of a later version, or lacks an array.
    """
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            found = {array.name: archive[array.name] for array in ARRAYS if array.name in archive}
    except OSError as error:
        raise RunError(f"{file}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # damage fails in zipfile, zlib and numpy, in ways of their own
        raise RunError(f"{file}: holds no arrays: {error}") from error
    _check(found, str(file))
    return found


def documentation() -> str:
    """Describe the file for people: Markdown, a table with a row per array."""
    rows = [
        f"| `{a.name}` | {_shape_text(a.shape)} | {a.dtype} | {a.unit or '–'} | {a.meaning} |"
        for a in ARRAYS
    ]
    head = ["| array | shape | type | unit | meaning |", "|---|---|---|---|---|"]
    return "\n".join([*head, *rows]) + "\n"


def _shaped(values: Any, array: Array) -> NDArray[Any]:
    """Values of an array, with its shape even when there are none."""
    made = np.asarray(values, dtype=array.dtype)
    return made.reshape([-1 if isinstance(n, str) else n for n in array.shape])


def _check(arrays: Arrays, where: str) -> None:
    missing = [array.name for array in ARRAYS if array.name not in arrays]
    if missing:
        raise RunError(f"{where}: has no array {', '.join(missing)}")
    if np.any(arrays["schema_version"] > SCHEMA_VERSION):
        raise RunError(
            f"{where}: has schema_version {arrays['schema_version']}, this version reads up to "
            f"{SCHEMA_VERSION}; update beamseg-batch"
        )
    lengths: dict[int | str, int] = {}
    for array in ARRAYS:
        shape = arrays[array.name].shape
        lengths = {**dict(zip(array.shape, shape, strict=False)), **lengths}
        wanted = tuple(n if isinstance(n, int) else lengths.get(n, 0) for n in array.shape)
        if shape != wanted:
            raise RunError(f"{where}: {array.name} has shape {shape}, not {wanted}")


def _shape_text(shape: tuple[int | str, ...]) -> str:
    return f"({', '.join(map(str, shape))}{',' if len(shape) == 1 else ''})"
