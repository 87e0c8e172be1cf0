"""Worlds written in YAML."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from beamseg_batch.world.document import Document, Key, load_document, validate
from beamseg_batch.world.models import (
    BoxConfig,
    MeshConfig,
    SphereConfig,
    StructureConfig,
    WorldConfig,
)
from beamseg_batch.world.placement import placed
from beamseg_batch.world.scene import Box, Member, Mesh, Rectangle, Scene, Sphere

__all__ = ["MESH_SUFFIXES", "World", "load_world", "mesh_problem"]

MESH_SUFFIXES = (".stl", ".obj", ".ply")


@dataclass(frozen=True, eq=False)
class World:
    """What a world file describes.

    Attributes
    ----------
    scene : Scene
        What stands in it.
    flight : mapping, optional
        How to fly through it unless something else is asked for, as written.
    sensor : str, optional
        Name of a preset, or file, of the camera to fly with, as written.
    document : Document, optional
        The file, if it is a YAML file.
    """

    scene: Scene
    flight: Mapping[str, Any] | None = None
    sensor: str | None = None
    document: Document | None = None


def load_world(path: Path) -> World:
    """Read a world written in YAML.

    Parameters
    ----------
    path : Path

    Returns
    -------
    World

    Raises
    ------
    WorldError
        With file and line, if the file is not a world.
    """
    document = load_document(path)
    config = validate(WorldConfig, document)
    return World(_scene(config, document), config.flight, config.sensor, document)


def _scene(config: WorldConfig, document: Document) -> Scene:
    clutter = [
        _clutter(item.content(), document, ("clutter", number, item.kind()))
        for number, item in enumerate(config.clutter)
    ]
    levels = [level.rectangle() for level in (config.floor, config.ceiling) if level is not None]
    return Scene(
        name=config.name or document.path.stem,
        members=_members(config, document),
        boxes=tuple(item for item in clutter if isinstance(item, Box)),
        spheres=tuple(item for item in clutter if isinstance(item, Sphere)),
        rectangles=(*levels, *(item for item in clutter if isinstance(item, Rectangle))),
        meshes=tuple(item for item in clutter if isinstance(item, Mesh)),
    )


def _members(config: WorldConfig, document: Document) -> tuple[Member, ...]:
    """Return all members, each with a name of its own."""
    named: dict[str, Member] = {}
    for key, member in _keyed_members(config):
        if member.name in named:
            raise document.error(key, f"a member is called {member.name!r} already; name this")
        named[member.name] = member
    return tuple(named.values())


def _keyed_members(config: WorldConfig) -> Iterator[tuple[Key, Member]]:
    for number, member in enumerate(config.members):
        yield ("members", number), member.member(f"member {number + 1}")
    for number, item in enumerate(config.generate):
        structure: StructureConfig = item.content()
        prefix = f"{structure.name or item.kind().replace('_', ' ')} "
        for each in placed(structure.members(), structure.pose.transform(), prefix):
            yield ("generate", number), each


def _clutter(item: Any, document: Document, key: Key) -> Box | Sphere | Rectangle | Mesh:
    if isinstance(item, SphereConfig):
        return Sphere(np.array(item.centre), item.radius)
    T = item.transform()
    if isinstance(item, MeshConfig):
        path = document.path.parent / item.file
        if problem := mesh_problem(path):
            raise document.error((*key, "file"), problem)
        return Mesh(path, T.translation, T.rotation, np.array(item.scale))
    kind = Box if isinstance(item, BoxConfig) else Rectangle
    return kind(T.translation, np.array(item.size), T.rotation)


def mesh_problem(path: Path) -> str | None:
    """Say why a file cannot be a mesh, if it cannot; its triangles are not read here."""
    if path.suffix.lower() not in MESH_SUFFIXES:
        return f"{path}: a mesh is one of {', '.join(MESH_SUFFIXES)}"
    return None if path.is_file() else f"{path}: no such file"
