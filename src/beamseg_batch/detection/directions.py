"""The directions of the Hough space: half a sphere of icosahedron vertices."""

from __future__ import annotations

from functools import cache

import numpy as np

from beamseg_batch.geometry import FloatArray

__all__ = ["hemisphere_directions"]

# Faces of the icosahedron as indices into `_icosahedron()`. Their order, and that of
# the corners in each, fixes the order of the directions, which breaks ties of votes.
_FACES = (
    (0, 1, 2), (0, 1, 3), (0, 2, 4), (0, 4, 6), (0, 3, 6), (1, 2, 5), (1, 3, 7),
    (1, 5, 7), (2, 4, 8), (2, 5, 8), (3, 6, 9), (3, 7, 9), (4, 8, 10), (8, 10, 11),
    (5, 8, 11), (5, 7, 11), (7, 9, 11), (9, 10, 11), (6, 9, 10), (4, 6, 10),
)  # fmt: skip

_Vertex = tuple[float, float, float]
_Face = tuple[int, int, int]


@cache
def hemisphere_directions(granularity: int) -> FloatArray:
    """Directions of an icosahedron subdivided `granularity` times, one of each pair.

    Parameters
    ----------
    granularity : int
        0 to 6, giving 6, 21, 81, 321, 1281, 5121 or 20481 directions.

    Returns
    -------
    (D, 3) float64, unit vectors with z >= 0, read-only

    Notes
    -----
    Jeltsch, Dalitz and Pohle-Fröhlich, VISAPP 2016. Values and order are those of the
    published program, whose golden ratio is single precision: the order decides which
    of two equally voted lines wins.
    """
    vertices, faces = _icosahedron(), list(_FACES)
    for _ in range(granularity):
        faces = _subdivided(vertices, faces)
    directions = np.array([vertex for vertex in vertices if _is_kept(vertex)])
    directions.flags.writeable = False
    return directions


def _icosahedron() -> list[_Vertex]:
    """Return the twelve corners, from a golden ratio in single precision."""
    ratio = np.float32(1.61803399)
    norm = np.sqrt(np.float32(1) + ratio * ratio)
    short, long = float(np.float32(1) / norm), float(ratio / norm)
    return [
        (-short, long, 0.0), (short, long, 0.0), (0.0, short, -long), (0.0, short, long),
        (-long, 0.0, -short), (long, 0.0, -short), (-long, 0.0, short), (long, 0.0, short),
        (0.0, -short, -long), (0.0, -short, long), (-short, -long, 0.0), (short, -long, 0.0),
    ]  # fmt: skip


def _subdivided(vertices: list[_Vertex], faces: list[_Face]) -> list[_Face]:
    """Split each face into four; new vertices are appended in order of first use."""
    index_of: dict[_Vertex, int] = {}

    def midpoint(first: int, second: int) -> int:
        x, y, z = (p + q for p, q in zip(vertices[first], vertices[second], strict=True))
        norm = float(np.sqrt(x * x + y * y + z * z))
        vertex = (x / norm, y / norm, z / norm)
        if vertex not in index_of:
            index_of[vertex] = len(vertices)
            vertices.append(vertex)
        return index_of[vertex]

    smaller: list[_Face] = []
    for a, b, c in faces:
        ab, bc, ca = midpoint(a, b), midpoint(b, c), midpoint(c, a)
        smaller += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ca, ab, bc)]
    return smaller


def _is_kept(vertex: _Vertex) -> bool:
    """Whether a vertex, and not its opposite, stands for their common line."""
    x, y, z = vertex
    if z != 0:
        return z > 0
    return x > 0 or (x == 0 and y != -1)
