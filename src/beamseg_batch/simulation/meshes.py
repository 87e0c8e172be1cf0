"""Rays against the triangles of mesh files, by Open3D."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from beamseg_batch.errors import WorldError
from beamseg_batch.extras import load_open3d
from beamseg_batch.geometry import FloatArray, RigidTransform
from beamseg_batch.world.scene import Mesh

__all__ = ["MeshCaster"]


class MeshCaster:
    """Casts rays at meshes.

    Parameters
    ----------
    meshes : iterable of Mesh

    Raises
    ------
    Open3DMissingError
        If Open3D cannot be loaded.
    WorldError
        If a file holds no mesh.
    """

    def __init__(self, meshes: Iterable[Mesh]) -> None:
        self._open3d = load_open3d("a world with meshes")
        self._scene = self._open3d.t.geometry.RaycastingScene()
        for mesh in meshes:
            vertices, triangles = _read(self._open3d, mesh)
            placed = (vertices * mesh.scale) @ mesh.rotation.T + mesh.translation
            self._scene.add_triangles(placed.astype(np.float32), triangles.astype(np.uint32))

    def cast(
        self,
        T_world_sensor: RigidTransform,
        directions: FloatArray,
        depths: FloatArray,
        facings: FloatArray,
    ) -> None:
        """Find where rays from the camera hit a mesh first.

        Parameters
        ----------
        T_world_sensor : RigidTransform
        directions : (H, W, 3) float64
            Sensor frame, of depth 1.
        depths : (H, W) float64, metres
            Out: depth of the hit, where there is one.
        facings : (H, W) float64
            Out: sine of the angle between ray and surface, where there is a hit.
        """
        rays = np.empty((*depths.shape, 6), dtype=np.float32)
        rays[..., :3] = T_world_sensor.translation
        rays[..., 3:] = T_world_sensor.rotate(directions)
        found = self._scene.cast_rays(self._open3d.core.Tensor(rays))
        t_hit = found["t_hit"].numpy()
        hit = np.isfinite(t_hit)
        normals = found["primitive_normals"].numpy()[hit].astype(np.float64)
        towards = rays[hit][:, 3:].astype(np.float64)
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        depths[hit] = t_hit[hit]
        facings[hit] = np.abs(np.einsum("ni,ni->n", normals, towards))


def _read(open3d: Any, mesh: Mesh) -> tuple[FloatArray, Any]:
    """Vertices (N, 3) as they stand in the file, and triangles (M, 3)."""
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        try:
            # The tensor reader: the other one passes over faces of more than three corners.
            loaded = open3d.t.io.read_triangle_mesh(str(mesh.path))
            vertices = loaded.vertex.positions.numpy().astype(np.float64)
            return vertices, loaded.triangle.indices.numpy()
        except (RuntimeError, IndexError, KeyError) as error:  # an empty mesh has no such parts
            raise WorldError(
                f"{mesh.path}: cannot be read as a mesh: no triangle was found in it"
            ) from error
