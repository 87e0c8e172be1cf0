"""Meshes, by Open3D, and what is said where it is missing."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from beamseg_batch.errors import WorldError
from beamseg_batch.extras import Open3DMissingError
from beamseg_batch.geometry import matrix_from_rpy
from beamseg_batch.simulation.casting import Caster
from beamseg_batch.world.scene import Box, Mesh, Scene
from tests.simulation.conftest import VIEWS, make_member

CUBE = """
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
v 1 0 1
v 1 1 1
v 0 1 1
f 1 4 3 2
f 5 6 7 8
f 1 2 6 5
f 3 4 8 7
f 2 3 7 6
f 1 5 8 4
"""
TURN = matrix_from_rpy(0.2, -0.4, 0.7)
PLACE = np.array([-0.4, -0.3, 0.9])
SIZE = np.array([0.4, 0.5, 0.3])
needs_open3d = pytest.mark.skipif(
    sys.version_info >= (3, 15), reason="Open3D has no wheel for this Python"
)


@pytest.fixture
def cube(tmp_path):
    path = tmp_path / "cube.obj"
    path.write_text(CUBE, encoding="utf-8")
    return Mesh(path, PLACE, TURN, SIZE)


@needs_open3d
def test_mesh_caster__a_cube_is_a_box(cube, camera):
    pytest.importorskip("open3d", exc_type=ImportError)
    box = Box(PLACE + TURN @ (SIZE / 2), SIZE, TURN)
    scenes = [
        Scene("", (make_member(),), meshes=(cube,)),
        Scene("", (make_member(),), boxes=(box,)),
    ]
    mesh, solid = (Caster(scene).cast(VIEWS[0], camera.grid) for scene in scenes)
    np.testing.assert_array_equal(mesh.owners, solid.owners)
    np.testing.assert_allclose(mesh.depths, solid.depths, atol=1e-5)
    np.testing.assert_allclose(mesh.facings, solid.facings, atol=1e-5)
    assert (np.isfinite(mesh.depths) & (mesh.owners < 0)).sum() > 40
    assert (mesh.owners == 0).sum() > 20


@needs_open3d
def test_mesh_caster__file_without_triangles(tmp_path):
    pytest.importorskip("open3d", exc_type=ImportError)
    path = tmp_path / "broken.stl"
    path.write_bytes(b"not a mesh")
    with pytest.raises(WorldError, match=r"broken\.stl: cannot be read as a mesh"):
        Caster(Scene("", meshes=(Mesh(path, np.zeros(3)),)))


def test_caster__says_how_to_get_open3d(cube, monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(Open3DMissingError, match=r"apt-get install .*libgl1"):
        Caster(Scene("", meshes=(cube,)))


def test_caster__without_meshes_needs_no_open3d(camera, monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    assert (Caster(Scene("", (make_member(),))).cast(VIEWS[0], camera.grid).owners == 0).any()
