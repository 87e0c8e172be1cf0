"""What several tests of this folder share."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.errors import WorldError
from beamseg_batch.world import load_scene_file
from beamseg_batch.world.scene import Scene


def written(folder, text, name="world.yaml"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def scene_of(folder, text, name="world.yaml"):
    return load_scene_file(written(folder, text, name)).scene


def refusal_of(folder, text, name="world.yaml"):
    """What is said of a bad world, the folder left out."""
    path = written(folder, text, name)
    with pytest.raises(WorldError) as caught:
        load_scene_file(path)
    assert caught.value.exit_code == 2
    return str(caught.value).replace(f"{folder}/", "")


def outcome(path):
    """Scene of a file, else an empty one, and what is said of it, else its name."""
    try:
        return load_scene_file(path).scene, str(path)
    except WorldError as error:
        return Scene("", ()), str(error)


def axes(members):
    """Ends of members, (N, 2, 3) metres."""
    return np.array([[member.start, member.end] for member in members])


def rodrigues(axis, angle):
    """Rotation matrix by the sum over the axis' cross product: a slow twin."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
