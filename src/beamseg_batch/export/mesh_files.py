"""Bars as meshes: GLB, OBJ, STL and PLY, by trimesh."""

from __future__ import annotations

from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np

from beamseg_batch.export.content import Content
from beamseg_batch.extras import load_extra
from beamseg_batch.prisms import Mesh, mesh_of

__all__ = ["joined", "write_mesh", "write_scene"]

_DIGITS = 9  # of a coordinate in an OBJ file


def write_scene(content: Content, path: Path) -> int:
    """Write a mesh for each bar, named after it.

    Each stands about its own middle and is moved to its place, since the numbers of a GLB
    file are single precision.
    """
    content.refuse_none(len(content.bars), path)
    trimesh = load_extra("trimesh", f"a {path.suffix} file")
    scene = trimesh.Scene()
    for bar in content.bars:
        mesh = mesh_of(bar)
        place = np.eye(4)
        place[:3, :3] = content.turn
        middle = (bar.start + bar.end) / 2.0
        place[:3, 3] = content.turn @ middle
        name = f"{content.what.removesuffix('s')}_{bar.number}"
        solid = _trimesh(trimesh, Mesh(mesh.vertices - middle, mesh.triangles))
        scene.add_geometry(solid, node_name=name, geom_name=name, transform=place)
    options = {"digits": _DIGITS} if path.suffix.lower() == ".obj" else {}
    path.write_bytes(_encoded(scene.export(file_type=path.suffix[1:].lower(), **options)))
    return len(content.bars)


def write_mesh(content: Content, path: Path) -> int:
    """Write all bars as one mesh."""
    content.refuse_none(len(content.bars), path)
    trimesh = load_extra("trimesh", f"a {path.suffix} file")
    mesh = joined([mesh_of(bar) for bar in content.bars])
    turned = Mesh(mesh.vertices @ content.turn.T, mesh.triangles)
    solid = _trimesh(trimesh, turned)
    path.write_bytes(_encoded(solid.export(file_type=path.suffix[1:].lower())))
    return len(content.bars)


def joined(meshes: list[Mesh]) -> Mesh:
    """Put meshes side by side into one."""
    counts = [len(mesh.vertices) for mesh in meshes]
    shifts = accumulate(counts, initial=0)
    vertices = [np.empty((0, 3)), *(mesh.vertices for mesh in meshes)]
    triangles = [mesh.triangles + shift for mesh, shift in zip(meshes, shifts, strict=False)]
    none = np.empty((0, 3), dtype=np.int64)
    return Mesh(np.concatenate(vertices), np.concatenate([none, *triangles]))


def _trimesh(trimesh: Any, mesh: Mesh) -> Any:
    return trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)


def _encoded(content: bytes | str) -> bytes:
    return content if isinstance(content, bytes) else content.encode()
