"""Which axis of a cloud looks ahead: x as on bodies, or z as in optical frames."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.config import SensorConfig
from beamseg_batch.geometry import FloatArray, RigidTransform

__all__ = ["T_OPTICAL_SENSOR", "AheadAxis", "AheadCounts", "choose_axis", "turned_ahead"]

T_OPTICAL_SENSOR = RigidTransform(
    np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]), np.zeros(3)
)
"""From the sensor's axes, x forward and z up, to the optical ones, z forward and y down."""

_ENOUGH_RETURNS = 1000
_FEWEST_RETURNS = 100
_ALL, _NOT_ALL = 0.999, 0.98
"""Shares of returns from which an axis looks ahead, and up to which it does not."""
_ALONG = 0.9


@dataclass(frozen=True)
class AheadAxis:
    """The axis that looks ahead.

    Attributes
    ----------
    is_z : bool
        Else it is x.
    reason : str
    note : str
        A sentence when the choice is worth telling, else empty.
    """

    is_z: bool
    reason: str
    note: str = ""


@dataclass
class AheadCounts:
    """How many returns lie ahead along either axis: what a camera sees is before it."""

    n: int = 0
    n_x: int = 0
    n_z: int = 0

    def add(self, points: NDArray[np.floating]) -> None:
        """Count the returns of a cloud, (N, 3), in its own axes."""
        finite = np.isfinite(points).all(axis=1)
        self.n += int(finite.sum())
        self.n_x += int((points[finite, 0] > 0.0).sum())
        self.n_z += int((points[finite, 2] > 0.0).sum())

    @classmethod
    def of(cls, clouds: Iterable[NDArray[np.floating]]) -> AheadCounts:
        """Count until the returns are enough and an axis stands out, or no cloud is left."""
        counts = cls()
        for points in clouds:
            counts.add(points)
            if counts.n >= _ENOUGH_RETURNS and not (counts._all_x and counts._all_z):
                break
        return counts

    @property
    def _all_x(self) -> bool:
        return self.n_x >= _ALL * self.n

    @property
    def _all_z(self) -> bool:
        return self.n_z >= _ALL * self.n

    def is_z(self) -> bool | None:
        """Whether z looks ahead and x does not; None when the returns do not tell."""
        if self.n < _FEWEST_RETURNS:
            return None
        if self._all_z and self.n_x <= _NOT_ALL * self.n:
            return True
        if self._all_x and self.n_z <= _NOT_ALL * self.n:
            return False
        return None


def choose_axis(
    config: SensorConfig, frame: str, counts: AheadCounts, rotation: FloatArray | None
) -> AheadAxis:
    """Choose the axis that looks ahead: configured, else by the data, the name, the tree.

    Parameters
    ----------
    config : SensorConfig
    frame : str
        Header frame of the clouds.
    counts : AheadCounts
    rotation : (3, 3) float64 or None
        Of ``T_body_sensor``, where the transform tree has it.

    Returns
    -------
    AheadAxis
    """
    if config.axes != "auto":
        return AheadAxis(config.axes == "z_forward", "sensor.axes")
    optical = "optical" in frame.lower()
    is_z = counts.is_z()
    if is_z is not None:
        if is_z:
            return _z_ahead(frame, "all their returns have z above 0, but not x")
        note = (
            f"the clouds' frame {frame!r} has an optical name, but all their returns have x above "
            "0 and not z: x is taken as forward; see sensor.axes"
        )
        return AheadAxis(False, "all returns have x above 0", note if optical else "")
    if optical:
        return _z_ahead(frame, "their frame has an optical name")
    if rotation is not None and rotation[0, 2] > _ALONG and rotation[2, 1] < -_ALONG:
        return _z_ahead(frame, "the transform tree turns their z axis ahead and their y axis down")
    return AheadAxis(False, "nothing says otherwise")


def _z_ahead(frame: str, reason: str) -> AheadAxis:
    note = (
        f"the clouds' frame {frame!r} looks along z, since {reason}: they are turned to x "
        "forward; see sensor.axes"
    )
    return AheadAxis(True, reason, note)


def turned_ahead(points: NDArray[np.floating]) -> NDArray[np.floating]:
    """Points of an optical frame in the sensor's axes: nothing is rounded.

    Parameters
    ----------
    points : (N, 3) float32 or float64
        z forward, x right, y down.

    Returns
    -------
    (N, 3) of the same type
        x forward, y left, z up.
    """
    turned = np.empty_like(points, order="C")
    turned[:, 0] = points[:, 2]
    np.negative(points[:, 0], out=turned[:, 1])
    np.negative(points[:, 1], out=turned[:, 2])
    return turned
