"""From a local frame to longitude, latitude and height on the earth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from beamseg_batch.geometry import FloatArray

__all__ = ["Origin"]

_EQUATOR_RADIUS = 6378137.0  # WGS 84, metres
_FLATTENING = 1.0 / 298.257223563
_ECCENTRICITY2 = _FLATTENING * (2.0 - _FLATTENING)
_ROUNDS = 6
"""Rounds of the iteration for the latitude; each gains more than two digits."""


@dataclass(frozen=True)
class Origin:
    """Where the world frame lies on the earth (WGS 84).

    Attributes
    ----------
    latitude, longitude : float, degrees
        Of the frame's origin, north and east positive.
    altitude : float, metres
        Above the ellipsoid.
    heading : float, degrees
        By which the frame's y axis is turned from north, clockwise seen from above; at 0
        x points east and y north. z points up.
    """

    latitude: float
    longitude: float
    altitude: float = 0.0
    heading: float = 0.0

    def geographic(self, points: FloatArray) -> FloatArray:
        """Longitude, latitude and height of points.

        Parameters
        ----------
        points : (N, 3) float64, metres, world frame

        Returns
        -------
        (N, 3) float64
            Degrees, degrees, metres above the ellipsoid.
        """
        lat, lon, turn = (math.radians(a) for a in (self.latitude, self.longitude, self.heading))
        sin_lat, cos_lat, sin_lon, cos_lon = (
            math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon),
        )  # fmt: skip
        east = points[:, 0] * math.cos(turn) + points[:, 1] * math.sin(turn)
        north = points[:, 1] * math.cos(turn) - points[:, 0] * math.sin(turn)
        T = np.array(
            [
                [-sin_lon, -sin_lat * cos_lon, cos_lat * cos_lon],
                [cos_lon, -sin_lat * sin_lon, cos_lat * sin_lon],
                [0.0, cos_lat, sin_lat],
            ]
        )
        normal = _EQUATOR_RADIUS / math.sqrt(1.0 - _ECCENTRICITY2 * sin_lat**2)
        centre = np.array([0.0, 0.0, -normal * _ECCENTRICITY2 * sin_lat])
        up = (normal + self.altitude) * T[:, 2]
        return _geographic(np.column_stack([east, north, points[:, 2]]) @ T.T + up + centre)


def _geographic(earth: FloatArray) -> FloatArray:
    """Longitude, latitude and height of points (N, 3) in the earth's frame.

    The latitude is iterated: the height above the ellipsoid follows from it, and it from
    the height; what is left of the error shrinks by the squared eccentricity, 0.0067.
    """
    x, y, z = earth.T
    across = np.hypot(x, y)
    latitude = np.arctan2(z, across * (1.0 - _ECCENTRICITY2))
    for _ in range(_ROUNDS):
        sine = np.sin(latitude)
        normal = _EQUATOR_RADIUS / np.sqrt(1.0 - _ECCENTRICITY2 * sine**2)
        latitude = np.arctan2(z + _ECCENTRICITY2 * normal * sine, across)
    sine, cosine = np.sin(latitude), np.cos(latitude)
    # This form of the height holds at the poles too.
    height = across * cosine + z * sine - _EQUATOR_RADIUS * np.sqrt(1.0 - _ECCENTRICITY2 * sine**2)
    return np.column_stack([np.degrees(np.arctan2(y, x)), np.degrees(latitude), height])
