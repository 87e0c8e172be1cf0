"""From a line through the visible surface to the beam's axis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from beamseg_batch.cylinder.ray_kernels import fit_axis, near_line
from beamseg_batch.detection.return_kernels import returns_of
from beamseg_batch.model import DepthNoise, Scan, Segment

__all__ = ["Returns", "fit_segment_axis"]

_START = 0.8  # radii behind the line: where the axis is on average
_GATES = np.array([6.0, 6.0, 5.0, 4.0, 3.0, 3.0])  # sigmas
_FEWEST, _ENOUGH = 8, 500
_SLACK_M = 0.02


class Returns:
    """The returns of a scan as rays, in the sensor frame.

    Parameters
    ----------
    scan : Scan
    noise : DepthNoise

    Attributes
    ----------
    points, rays : (N, 3) float64
        Returns, and the unit vectors towards them.
    depths : (N,) float64, metres
        Along the rays.
    sigmas : (N,) float64, metres
        Standard deviation of each depth, along the ray.
    """

    def __init__(self, scan: Scan, noise: DepthNoise) -> None:
        self.points, self.rays, self.depths, self.sigmas = returns_of(
            scan.points, noise.constant, noise.relative
        )
        self.sigma = noise


def fit_segment_axis(segment: Segment, returns: Returns) -> Segment:
    """Move a segment from the surface it was seen by to the axis behind it.

    Parameters
    ----------
    segment : Segment
        Sensor frame.
    returns : Returns
        Of the same scan, not thinned.

    Returns
    -------
    Segment
        The same stretch of the fitted axis; where none can be fitted, the line moved away
        from the camera by 0.8 radius.

    Notes
    -----
    Design, section 7.4. Six iterations of Gauss and Newton with Tukey's weight, of a few
    hundred returns: the rays of all scans will measure the axis.
    """
    a, b = segment.anchor, segment.direction
    away = a - (a @ b) * b
    away /= max(float(np.sqrt(away @ away)), 1e-9)
    start = a + _START * segment.radius * away
    reach = 2.0 * segment.radius + _GATES[0] * returns.sigma.at(float(a[0]))
    near = near_line(returns.points, a, b, segment.t_min - 0.1, segment.t_max + 0.1, reach)
    if len(near) < _FEWEST:
        return replace(segment, anchor=start)
    step = -(-len(near) // _ENOUGH)
    near = near[::step]
    sigmas = returns.sigmas[near]
    typical = float(sigmas.min())
    anchor, direction, count, _ = fit_axis(
        returns.rays[near], returns.depths[near], typical / sigmas,
        start, b, segment.t_min - _SLACK_M, segment.t_max + _SLACK_M,
        segment.radius, _GATES * typical,
    )  # fmt: skip
    moved = anchor - start
    if count < _FEWEST or moved @ moved > 4.0 * segment.radius**2 or abs(direction @ b) < 0.95:
        return replace(segment, anchor=start)
    return replace(segment, anchor=anchor, direction=direction, n_points=count * step)
