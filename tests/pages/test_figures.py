"""Bodies of the scenes: closed, as large as they are, with sharp edges."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from beamseg_batch.geometry import normalised, section_frame
from beamseg_batch.pages.figures import bar_mesh, thinned
from beamseg_batch.prisms import Prism, outline, round_prism
from tests.export.test_bars import SECTIONS

START, END = np.array([1.0, 2.0, 3.0]), np.array([2.0, 2.5, 4.0])
LENGTH = float(np.linalg.norm(END - START))
FLOAT32 = 1e-6  # metres, a few metres from the origin


def prism(shape, bow=0.0):
    rotation = section_frame(normalised(END - START), 0.6)
    share = np.linspace(0.0, 1.0, 50 if bow else 2)[:, None]
    nodes = START + share * (END - START) + 4.0 * share * (1.0 - share) * bow * rotation[:, 0]
    return Prism(SECTIONS[shape], nodes, rotation)


def welded(mesh):
    """Triangles of a mesh whose vertices at one place are one."""
    _, at = np.unique(np.round(mesh.vertices, 5), axis=0, return_inverse=True)
    return at.reshape(-1)[mesh.triangles]


def area(corners):
    x, y = corners.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


@pytest.mark.parametrize("bow", [0.0, 0.05])
@pytest.mark.parametrize("shape", SECTIONS)
def test_bar_mesh__is_closed_and_as_large_as_the_bar(shape, bow):
    bar = prism(shape, bow)
    mesh = bar_mesh([bar])
    triangles = welded(mesh)
    edges = Counter((int(t[k]), int(t[(k + 1) % 3])) for t in triangles for k in range(3))
    assert set(edges.values()) == {1}
    assert all((b, a) in edges for a, b in edges)
    corners = mesh.vertices[mesh.triangles].astype(float) - START
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx(area(outline(bar.section, 12)) * LENGTH, rel=1e-4)


@pytest.mark.parametrize("bow", [0.0, 0.05])
@pytest.mark.parametrize("shape", SECTIONS)
def test_bar_mesh__follows_the_axis(shape, bow):
    bar = prism(shape, bow)
    local = (bar_mesh([bar]).vertices - START) @ bar.rotation
    share = np.clip(local[:, 2] / LENGTH, 0.0, 1.0)
    assert (share.min(), share.max()) == (0.0, pytest.approx(1.0, abs=FLOAT32))
    local[:, 0] -= 4.0 * share * (1.0 - share) * bow
    corners = outline(bar.section, 12)
    off = np.linalg.norm(local[:, None, :2] - corners, axis=2).min(axis=1)
    assert off.max() < (1e-4 if bow else FLOAT32)  # rings stand between the nodes


@pytest.mark.parametrize("shape", [shape for shape in SECTIONS if shape != "round"])
def test_bar_mesh__no_vertex_is_shared_by_faces_that_meet_in_an_edge(shape):
    mesh = bar_mesh([prism(shape)])
    corners = mesh.vertices[mesh.triangles].astype(float)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    for vertex in range(len(mesh.vertices)):
        around = normals[(mesh.triangles == vertex).any(axis=1)]
        np.testing.assert_allclose(around, around[:1].repeat(len(around), axis=0), atol=1e-3)


def test_bar_mesh__bodies_follow_one_another():
    bars = [prism("i"), round_prism(END, START, 0.04), prism("round", 0.02)]
    mesh = bar_mesh(bars)
    assert mesh.counts.sum() == len(mesh.vertices)
    ends = np.cumsum(mesh.counts)
    for bar, end, count in zip(bars, ends, mesh.counts, strict=True):
        one = bar_mesh([bar])
        np.testing.assert_array_equal(mesh.vertices[end - count : end], one.vertices)
        of = (mesh.triangles[:, 0] >= end - count) & (mesh.triangles[:, 0] < end)
        np.testing.assert_array_equal(mesh.triangles[of] - (end - count), one.triangles)


def test_bar_mesh__a_bar_without_length_is_a_disc():
    mesh = bar_mesh([round_prism(START, START, 0.05)])
    distances = np.linalg.norm(mesh.vertices - START, axis=1)
    np.testing.assert_allclose(distances, 0.05, atol=FLOAT32)


def test_bar_mesh__no_bars():
    mesh = bar_mesh([])
    assert mesh.vertices.shape == mesh.triangles.shape == (0, 3)
    assert len(mesh.counts) == 0


@pytest.mark.parametrize(("size", "limit"), [(0, 5), (5, 5), (6, 5), (200_000, 30_000), (7, 0)])
def test_thinned__is_even_and_within_the_limit(size, limit):
    indices = thinned(size, limit)
    assert len(indices) == min(size, limit)
    assert np.all(np.diff(indices) >= 1)
    if len(indices):
        assert np.diff(indices).max(initial=0) - np.diff(indices).min(initial=10**9) <= 1
        assert indices[0] == 0
        assert indices[-1] < size
