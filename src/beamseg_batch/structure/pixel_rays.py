"""Directions of the pixels of an organised camera, learned from its returns."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import Scan

__all__ = ["PixelRays", "every"]

T = TypeVar("T", bound=np.generic)

_ENOUGH_SCANS = 50


def every(pixels: NDArray[T], width: int, stride: int) -> NDArray[T]:
    """Take every so manieth row and column of an image.

    Parameters
    ----------
    pixels : (R, 3)
    width, stride : int

    Returns
    -------
    (S, 3) of the same kind
    """
    return pixels.reshape(-1, width, 3)[::stride, ::stride].reshape(-1, 3)


class PixelRays:
    """Direction of each pixel of an organised camera, learned from its returns.

    A pixel without return has no direction of its own, yet it saw through whatever is
    said to stand there.
    """

    def __init__(self) -> None:
        self._sum: FloatArray | None = None
        self._rays: FloatArray | None = None
        self._unknown = np.zeros(0, np.int64)
        self._taken = 0
        self._width = 0
        self._image_width = 0
        self._image = np.zeros(4)
        self._strided: dict[int, FloatArray] = {}

    @property
    def count(self) -> int:
        """Pixels of a scan; 0 where it is not known to be an image."""
        return 0 if self._sum is None else len(self._sum)

    def learn(self, scan: Scan) -> None:
        """Take in a scan; one of another size than the first is left out.

        Parameters
        ----------
        scan : Scan
        """
        if scan.height < 2 or scan.width < 2 or len(scan.points) != scan.width * scan.height:
            return
        if self._sum is None:
            self._sum, self._width = np.zeros((len(scan.points), 3)), scan.width
        if len(scan.points) != len(self._sum) or scan.width != self._width:
            return
        self._taken += 1
        # Later on only pixels that did not return anything so far have something to add.
        enough = self._taken > _ENOUGH_SCANS
        asked = self._unknown if enough else np.arange(len(self._sum))
        asked = asked[np.isfinite(scan.points[asked]).all(axis=1)]
        if len(asked):
            self._sum[asked] += scan.points[asked]
            self._unknown = np.flatnonzero(~self._sum.any(axis=1))
            self._rays = None

    def of(self, scan: Scan, stride: int = 1) -> tuple[FloatArray, int, FloatArray]:
        """Directions of a scan's pixels.

        Parameters
        ----------
        scan : Scan
        stride : int
            Every so manieth row and column of an image.

        Returns
        -------
        rays : (N, 3) float64, unit vectors
            Sensor frame; zero where nothing is known of a pixel.
        width : int
            Pixels of a row; 0 unless the camera is a pinhole camera.
        image : (4,) float64
            ``y / x`` of the first column and its step to the next, ``z / x`` of the first
            row and its step.
        """
        known = self._directions()
        if known is None or len(known) != len(scan.points) or scan.width != self._width:
            return np.zeros((len(scan.points), 3)), 0, self._image
        if stride == 1 or not self._image_width:
            return known, self._image_width, self._image
        if stride not in self._strided:
            self._strided[stride] = every(known, self._width, stride)
        image = self._image * [1.0, stride, 1.0, stride]
        return self._strided[stride], -(-self._width // stride), image

    @property
    def pitch_rad(self) -> float | None:
        """Angle between neighbouring pixels straight ahead, radians; None without an image."""
        known = self._directions() is not None and self._image_width > 0
        return abs(float(self._image[1])) if known else None

    def _directions(self) -> FloatArray | None:
        if self._sum is None:
            return None
        if self._rays is None:
            lengths = np.linalg.norm(self._sum, axis=1)
            self._strided.clear()
            self._rays = self._sum / np.where(lengths > 0.0, lengths, np.inf)[:, None]
            self._image_width = self._fit_image(self._rays)
        return self._rays

    def _fit_image(self, rays: FloatArray) -> int:
        """Find the scale of a pinhole image; the width, or 0 if it is none."""
        seen = np.flatnonzero(rays[:, 0] > 1e-3)
        rows, columns = np.divmod(seen, self._width)
        if len(np.unique(rows)) < 2 or len(np.unique(columns)) < 2:
            return 0
        for part, (index, axis) in enumerate(((columns, 1), (rows, 2))):
            slope = rays[seen, axis] / rays[seen, 0]
            step, first = np.polyfit(index, slope, 1)
            if step == 0.0 or np.abs(slope - first - step * index).max() > 0.5 * abs(step):
                return 0
            self._image[2 * part : 2 * part + 2] = first, step
        return self._width
