"""Worlds of the Webots simulator (``.wbt``, R2020b to R2025a).

What a release changed, and how it is read: up to R2021b cylinders stand along their y
axis, planes lie across it, and the world's y is up unless it says ENU; since R2022a all
that is z (Webots' guide "How to adapt your world or PROTO to Webots R2022a").
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from beamseg_batch.errors import WorldError
from beamseg_batch.geometry import FloatArray
from beamseg_batch.world.models import MIN_LENGTH
from beamseg_batch.world.placement import matrix_from_axis_angle, rotation_and_scale
from beamseg_batch.world.scene import Box, Member, Mesh, Rectangle, Scene, Section, Sphere
from beamseg_batch.world.vrml import VrmlNode, VrmlWorld, parse_vrml
from beamseg_batch.world.yaml_world import MESH_SUFFIXES, World, mesh_problem

__all__ = ["load_webots"]

IGNORED = frozenset(
    {
        "Background",
        "DirectionalLight",
        "Fog",
        "PointLight",
        "Robot",
        "SpotLight",
        "TexturedBackground",
        "TexturedBackgroundLight",
        "Viewpoint",
        "WorldInfo",
        "starling",
    }
)
"""Nodes that are nothing a camera could measure, and the robots that carry it."""

FARTHEST = 1e6
"""Largest number of a world, metres: far beyond any structure, it keeps all others finite."""

Z_UP_SINCE = (2022, "a")
TURN_Y_TO_Z = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation that raises the y axis to z."""


@dataclass(frozen=True, eq=False)
class _Place:
    """Where a node stands: ``p_world = linear @ p_node + translation``; and its name."""

    linear: FloatArray
    translation: FloatArray
    name: str | None = None

    def inside(self, linear: FloatArray, translation: FloatArray, name: str | None) -> _Place:
        """Place of a node that stands so in this one."""
        return _Place(self.linear @ linear, self.apply(translation), name or self.name)

    def apply(self, point: FloatArray) -> FloatArray:
        """Move a point of the node to the world."""
        moved: FloatArray = self.linear @ point + self.translation
        return moved


def load_webots(path: Path) -> World:
    """Read a Webots world.

    Parameters
    ----------
    path : Path

    Returns
    -------
    World
        Its cylinders as members, everything else that is known as clutter, and notes of
        what is not known.

    Raises
    ------
    WorldError
        With file and line, if the file cannot be read, is not a Webots world, or holds a
        size that cannot be.
    """
    reader = _Reader(path, parse_vrml(path))
    try:
        return World(reader.scene())
    except RecursionError:
        raise WorldError(f"{path}: its nodes nest too deep") from None


@dataclass(eq=False)
class _Reader:
    """Walks over the nodes and collects what stands in the world."""

    path: Path
    world: VrmlWorld
    members: dict[str, Member] = field(default_factory=dict)
    boxes: list[Box] = field(default_factory=list)
    spheres: list[Sphere] = field(default_factory=list)
    rectangles: list[Rectangle] = field(default_factory=list)
    meshes: list[Mesh] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def scene(self) -> Scene:
        place = _Place(TURN_Y_TO_Z if self._is_y_up() else np.eye(3), np.zeros(3))
        for node in self.world.nodes:
            self._add(node, place)
        return Scene(
            self.path.stem,
            tuple(self.members.values()),
            tuple(self.boxes),
            tuple(self.spheres),
            tuple(self.rectangles),
            tuple(self.meshes),
            tuple(self.notes),
        )

    @property
    def _is_old(self) -> bool:
        return self.world.release < Z_UP_SINCE

    def _is_y_up(self) -> bool:
        system = "NUE" if self._is_old else "ENU"
        for node in self.world.nodes:
            if node.kind == "WorldInfo":
                system = "".join(node.texts("coordinateSystem")) or system
        if system != "ENU":
            self.notes.append(f"{self.path}: its y axis is up; it is turned so that z is")
        return system != "ENU"

    def _add(self, node: VrmlNode, place: _Place) -> None:
        if node.kind in {"Group", "Pose", "Solid", "Transform"}:
            inside = self._inside(node, place)
            for child in node.nodes("children"):
                self._add(child, inside)
        elif node.kind == "Shape":
            for geometry in node.nodes("geometry"):
                self._add_geometry(geometry, place)
        elif node.kind == "CadShape":
            self._add_mesh(node, place)
        elif node.kind in {"Floor", "RectangleArena"}:
            self._add_floor(node, self._inside(node, place))
        elif node.kind not in IGNORED:
            self._note(node, f"{node.kind} is not known; it is skipped with all that it holds")

    def _inside(self, node: VrmlNode, place: _Place) -> _Place:
        rotation = self._numbers(node, "rotation", (0.0, 0.0, 1.0, 0.0))
        if not rotation[:3].any():
            raise self._error(node, "rotation", "the axis must not be 0, 0, 0")
        linear = matrix_from_axis_angle(rotation[:3], float(rotation[3]))
        linear = linear * self._numbers(node, "scale", (1.0, 1.0, 1.0))
        name = node.name or "".join(node.texts("name")) or None
        inside = place.inside(linear, self._numbers(node, "translation", (0.0, 0.0, 0.0)), name)
        if max(np.abs(inside.linear).max(), np.abs(inside.translation).max()) > FARTHEST:
            raise self._error(node, "translation", f"it stands or reaches beyond {FARTHEST:g} m")
        return inside

    def _add_geometry(self, node: VrmlNode, place: _Place) -> None:
        if node.kind == "Cylinder":
            self._add_cylinder(node, place)
        elif node.kind == "Box":
            self._add_box(node, place, np.zeros(3), self._sizes(node, "size", (2.0, 2.0, 2.0)))
        elif node.kind == "Sphere":
            self._add_sphere(node, place)
        elif node.kind == "Plane":
            self._add_rectangle(node, place, self._sizes(node, "size", (1.0, 1.0)))
        elif node.kind == "Mesh":
            self._add_mesh(node, place)
        else:
            self._note(node, f"{node.kind} is not known; it is skipped")

    def _add_cylinder(self, node: VrmlNode, place: _Place) -> None:
        (height,) = self._sizes(node, "height", (2.0,))
        (radius,) = self._sizes(node, "radius", (1.0,))
        place = self._upright(place)
        parts = rotation_and_scale(place.linear)
        if parts is None or not _alike(parts[1][:2]):
            self._note(node, "Cylinder is scaled so that it is not round any more; it is skipped")
            return
        half = np.array([0.0, 0.0, height / 2.0])
        start, end = place.apply(-half), place.apply(half)
        if (length := float(np.linalg.norm(end - start))) < MIN_LENGTH:
            raise self._error(node, "height", f"a member of {length:g} m is too short")
        diameter = float(2.0 * radius * abs(parts[1][0]))
        name = self._free_name(place.name or "cylinder")
        self.members[name] = Member(name, start, end, Section("round", diameter, diameter))

    def _free_name(self, name: str) -> str:
        number, free = 1, name
        while free in self.members:
            number += 1
            free = f"{name} {number}"
        return free

    def _add_box(self, node: VrmlNode, place: _Place, centre: FloatArray, size: FloatArray) -> None:
        parts = rotation_and_scale(place.linear)
        if parts is None:
            self._note(node, f"{node.kind} is scaled so that it is no box any more; it is skipped")
            return
        self.boxes.append(Box(place.apply(centre), size * np.abs(parts[1]), parts[0]))

    def _add_sphere(self, node: VrmlNode, place: _Place) -> None:
        (radius,) = self._sizes(node, "radius", (1.0,))
        parts = rotation_and_scale(place.linear)
        if parts is None or not _alike(parts[1]):
            self._note(node, "Sphere is scaled so that it is not round any more; it is skipped")
            return
        self.spheres.append(Sphere(place.translation, float(radius * abs(parts[1][0]))))

    def _add_rectangle(self, node: VrmlNode, place: _Place, size: FloatArray) -> None:
        place = self._upright(place)
        parts = rotation_and_scale(place.linear)
        if parts is None:
            self._note(node, f"{node.kind} is scaled so that it is askew; it is skipped")
            return
        self.rectangles.append(Rectangle(place.translation, size * np.abs(parts[1][:2]), parts[0]))

    def _add_floor(self, node: VrmlNode, place: _Place) -> None:
        if node.kind == "Floor":
            self._add_rectangle(node, place, self._sizes(node, "size", (10.0, 10.0)))
            return
        size = self._sizes(node, "floorSize", (1.0, 1.0))
        (thickness,) = self._sizes(node, "wallThickness", (0.01,))
        (height,) = self._sizes(node, "wallHeight", (0.1,))
        self._add_rectangle(node, place, size)
        place = self._upright(place)
        x, y = (size + thickness) / 2.0
        for across in (-x, x):
            wall = np.array([thickness, size[1], height])
            self._add_box(node, place, np.array([across, 0.0, height / 2.0]), wall)
        for across in (-y, y):
            wall = np.array([size[0] + 2.0 * thickness, thickness, height])
            self._add_box(node, place, np.array([0.0, across, height / 2.0]), wall)

    def _add_mesh(self, node: VrmlNode, place: _Place) -> None:
        name = place.name or node.kind
        for url in node.texts("url"):
            path = self.path.parent / url
            parts = rotation_and_scale(place.linear)
            if "://" in url or path.suffix.lower() not in MESH_SUFFIXES:
                kinds = ", ".join(MESH_SUFFIXES)
                self._note(node, f"{name}: {url} is no local {kinds} file; it is skipped")
            elif problem := mesh_problem(path):
                raise self._error(node, "url", problem)
            elif parts is None:
                self._note(node, f"{name}: its mesh is scaled askew; it is skipped")
            else:
                self.meshes.append(Mesh(path, place.translation, *parts))
                self._note(
                    node, f"{name} is a mesh: its axis is not known, so it is clutter, no member"
                )

    def _upright(self, place: _Place) -> _Place:
        """Turn a place so that z is the axis of its geometry, as it is since R2022a."""
        return place.inside(TURN_Y_TO_Z.T, np.zeros(3), None) if self._is_old else place

    def _numbers(self, node: VrmlNode, name: str, default: tuple[float, ...]) -> FloatArray:
        """Numbers of a field, as many as its default has."""
        if name not in node.fields:
            return np.array(default)
        values = [v for v in node.fields[name].values if isinstance(v, float)]
        if len(values) != len(default) or not all(abs(v) <= FARTHEST for v in values):
            raise self._error(
                node, name, f"must hold {len(default)} numbers, none above {FARTHEST:g}"
            )
        return np.array(values)

    def _sizes(self, node: VrmlNode, name: str, default: tuple[float, ...]) -> FloatArray:
        sizes = self._numbers(node, name, default)
        if not (sizes > 0.0).all():
            raise self._error(node, name, f"must be above 0, not {sizes.min():g}")
        return sizes

    def _error(self, node: VrmlNode, name: str, message: str) -> WorldError:
        line = node.fields[name].line if name in node.fields else node.line
        return WorldError(f"{self.path}:{line}: {node.kind}.{name}: {message}")

    def _note(self, node: VrmlNode, message: str) -> None:
        self.notes.append(f"{self.path}:{node.line}: {message}")


def _alike(scale: FloatArray) -> bool:
    """Whether all scales are the same, but for signs and the digits that a file cuts off."""
    sizes = np.abs(scale)
    return bool(sizes.max() - sizes.min() <= 1e-6 * sizes.max())
