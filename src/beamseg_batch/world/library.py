"""Worlds by their file, or by the name under which they are shipped."""

from __future__ import annotations

from pathlib import Path

from beamseg_batch.config import config_folder
from beamseg_batch.errors import WorldError
from beamseg_batch.schema import nearest
from beamseg_batch.world.webots import load_webots
from beamseg_batch.world.yaml_world import World, load_world

__all__ = ["load_scene_file", "world_names"]

_READERS = {".wbt": load_webots, ".yaml": load_world, ".yml": load_world}


def world_names() -> tuple[str, ...]:
    """Names of the shipped worlds, sorted."""
    return tuple(sorted(path.stem for path in _folder().glob("*.yaml")))


def load_scene_file(path: Path | str) -> World:
    """Read a world of any kind.

    Parameters
    ----------
    path : Path or str
        A Webots world (``.wbt``), a world in YAML (``.yaml``, ``.yml``), or the bare name of
        a shipped one (``arena``).

    Returns
    -------
    World

    Raises
    ------
    WorldError
        If it is neither, or the file is not a world.
    """
    path = Path(path)
    if read := _READERS.get(path.suffix.lower()):
        return read(path)
    if str(path) in world_names():
        return load_world(_folder() / f"{path}.yaml")
    suffixes = ", ".join(_READERS)
    raise WorldError(
        f"{path}: is no world file ({suffixes}) and no shipped world"
        f"{nearest(str(path), world_names())}; there are: {', '.join(world_names())}"
    )


def _folder() -> Path:
    return config_folder() / "worlds"
