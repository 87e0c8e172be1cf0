"""What a camera sees of a scene: the first hit of every ray."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.geometry import FloatArray, RigidTransform
from beamseg_batch.simulation.solids import CLUTTER, Solids, solids_of
from beamseg_batch.world.scene import Scene

__all__ = ["Caster", "Hits", "RayGrid"]


@dataclass(frozen=True, eq=False)
class RayGrid:
    """Rays of a pinhole camera in rows from top to bottom, each from left to right.

    Ray (v, u) has the direction ``(1, -right[u], -down[v])`` in the sensor frame: x
    forward, y left, z up. Its parameter is the depth, the distance from the camera's plane.

    Attributes
    ----------
    right : (W,) float64
    down : (H,) float64
        Both increasing.
    """

    right: FloatArray
    down: FloatArray

    @cached_property
    def directions(self) -> FloatArray:
        """Directions of the rays, sensor frame, (H, W, 3)."""
        rays = np.ones((len(self.down), len(self.right), 3))
        rays[..., 1] = -self.right
        rays[..., 2] = -self.down[:, None]
        return rays


@dataclass(frozen=True, eq=False)
class Hits:
    """What the rays of a grid hit.

    Attributes
    ----------
    depths : (H, W) float64, metres
        Infinite where nothing was hit.
    owners : (H, W) int64
        Number of the member that was hit, or `CLUTTER`, also where nothing was.
    facings : (H, W) float64
        Sine of the angle between ray and surface; 0 where nothing was hit.
    """

    depths: FloatArray
    owners: NDArray[np.int64]
    facings: FloatArray


class Caster:
    """Casts rays into a scene.

    Parameters
    ----------
    scene : Scene
    farthest : float, metres
        Depth beyond which nothing needs to be found.

    Raises
    ------
    WorldError
        If a mesh cannot be read.
    Open3DMissingError
        If the scene has meshes and Open3D is missing.
    """

    def __init__(self, scene: Scene, farthest: float = np.inf) -> None:
        self._solids = solids_of(scene)
        self._owners = np.append(self._solids.owners, CLUTTER)  # the last one is of no solid
        self._farthest = farthest
        self._meshes = None
        if scene.meshes:
            from beamseg_batch.simulation.meshes import MeshCaster

            self._meshes = MeshCaster(scene.meshes)

    @property
    def solids(self) -> Solids:
        """Solids of the scene."""
        return self._solids

    def cast(self, T_world_sensor: RigidTransform, grid: RayGrid) -> Hits:
        """Find the first hit of every ray.

        Parameters
        ----------
        T_world_sensor : RigidTransform
        grid : RayGrid

        Returns
        -------
        Hits
        """
        from beamseg_batch.simulation.casting_kernels import cast_rays

        shape = (len(grid.down), len(grid.right))
        depths, facings = np.full(shape, np.inf), np.zeros(shape)
        hits = np.full(shape, -1)
        if self._meshes is not None:
            self._meshes.cast(T_world_sensor, grid.directions, depths, facings)
        solids, turn = self._solids, T_world_sensor.rotation
        cast_rays(
            solids.kinds,
            (solids.centres - T_world_sensor.translation) @ turn,
            np.ascontiguousarray(turn.T @ solids.rotations),
            solids.halves,
            grid.right,
            grid.down,
            self._farthest,
            depths,
            hits,
            facings,
        )
        return Hits(depths, self._owners[hits], facings)
