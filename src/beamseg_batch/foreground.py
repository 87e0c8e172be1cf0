"""Which returns of a cloud come from something thin that stands free."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.bearings import bearing_image
from beamseg_batch.foreground_kernels import free_pixels, row_pitch, surveyed, without_others
from beamseg_batch.model import DepthNoise, Scan

__all__ = ["thin_foreground"]

_WIDEST = 2.2  # radii
_LEAST_JUMP_M = 0.06
_JUMP_SIGMAS = 5.0
_PITCH_ROWS = 8


def thin_foreground(
    scan: Scan,
    radius: float,
    reach: float,
    noise: DepthNoise,
    floor: float = -np.inf,
    *,
    beyond: bool = False,
) -> Scan:
    """Drop the returns of floor, walls and all else that is wider than a beam.

    Parameters
    ----------
    scan : Scan
    radius : float, metres
        Of the thickest beam that is looked for.
    reach : float, metres
        Returns beyond this forward depth are of no interest.
    noise : DepthNoise
    floor : float, metres
        So are those below this height in the world frame.
    beyond : bool
        Whether the view is taken to go on further back beyond the border of the image, so
        that a beam along it, or that is cut by it, is kept.

    Returns
    -------
    Scan
        The same, where a return is not finite unless along a row, a column or a diagonal of
        the image the view goes on further back on both sides of it, within the width of a
        beam. A scan that is not organised is put into an image of bearings for that.

    Notes
    -----
    A beam nearer to a wall than 6 cm, or 5 standard deviations of the depth, is lost with
    the wall.
    """
    if scan.height > 1 and len(scan.points) != scan.width * scan.height:
        return scan
    limits = (_WIDEST * radius, reach, noise, floor, beyond)
    if scan.height > 1:
        free = _free(scan, *limits)
    else:
        image = bearing_image(scan.points)
        seen = replace(scan, points=image.points, width=image.width, height=image.height)
        depths, nearest = (np.linalg.norm(points, axis=1) for points in (scan.points, image.points))
        there = image.cells >= 0
        cells = image.cells[there]
        free = np.zeros(len(scan.points), np.bool_)
        # Behind a beam its cell may hold some of the wall.
        free[there] = _free(seen, *limits)[cells] & (
            depths[there] <= nearest[cells] + _LEAST_JUMP_M
        )
    kept = without_others(scan.points, free)
    kept.flags.writeable = False  # as all points of a recording
    return scan.with_points(kept)


def _free(
    scan: Scan, width: float, reach: float, noise: DepthNoise, floor: float, beyond: bool
) -> NDArray[np.bool_]:
    """Pixels of an image that show something thin that stands free."""
    if scan.height < 3 or scan.width < 3:
        return np.ones(len(scan.points), np.bool_)
    shape = (scan.height, scan.width)
    points = scan.points.reshape(*shape, 3)
    pitch = row_pitch(points, max(len(points) // _PITCH_ROWS, 1))
    if not pitch > 0.0:
        return np.ones(len(scan.points), np.bool_)
    pose = scan.T_world_sensor
    depths, wanted, jump = surveyed(
        points, reach, pose.rotation[2].copy(), floor - float(pose.translation[2]),
        _LEAST_JUMP_M, _JUMP_SIGMAS * noise.constant, _JUMP_SIGMAS * noise.relative,
    )  # fmt: skip
    return free_pixels(depths, wanted, pitch, width, jump, beyond).ravel()
