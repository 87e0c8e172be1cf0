"""Worlds by file or name, and the shipped ones."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from beamseg_batch.errors import WorldError
from beamseg_batch.geometry import angle_between_deg
from beamseg_batch.world import load_scene_file, world_names
from tests.world.test_webots import ARENA, TRUE_ENDS
from tests.world.worlds import axes, written

NAMES = (
    "arena",
    "bent",
    "bridge_truss",
    "clutter",
    "flat_angles",
    "joints",
    "lattice_tower",
    "parallels",
    "radii",
    "sections",
)


def shipped(name):
    return load_scene_file(name).scene


# --- finding them ---------------------------------------------------------------------


def test_world_names__are_sorted():
    assert world_names() == NAMES


@pytest.mark.parametrize("name", ["a.yaml", "b.YML", "c.wbt"])
def test_load_scene_file__by_suffix(tmp_path, name):
    path = written(tmp_path, "#VRML_SIM R2023b utf8\n" if "wbt" in name else "{}", name)
    assert load_scene_file(path).scene.name == path.stem
    assert load_scene_file(str(path)).scene.name == path.stem


def test_load_scene_file__file_with_the_name_of_a_shipped_world(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written(tmp_path, "name: mine\n", "arena.yaml")
    assert load_scene_file("arena.yaml").scene.name == "mine"
    assert load_scene_file("arena").scene.name == "arena"


@pytest.mark.parametrize(
    ("name", "suggestion"),
    [("arina", "; did you mean 'arena'?"), ("xyzzy", ""), ("world.sdf", "")],
)
def test_load_scene_file__raise_on_another(name, suggestion):
    with pytest.raises(WorldError) as caught:
        load_scene_file(name)
    assert str(caught.value) == (
        f"{name}: is no world file (.wbt, .yaml, .yml) and no shipped world{suggestion}; "
        f"there are: {', '.join(NAMES)}"
    )


# --- the shipped worlds ---------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_shipped_world__is_sound(name):
    world = load_scene_file(name)
    scene = world.scene
    assert scene.name == name
    assert scene.notes == ()
    assert world.sensor == "webots_range_finder"
    assert {"kind"} < set(world.flight)
    assert len({member.name for member in scene.members}) == len(scene.members)
    for member in scene.members:
        assert member.length > 0.3
        assert 0.0 < member.section.radius <= 0.1
        assert min(member.start[2], member.end[2]) >= 0.0
        assert np.isfinite(member.rotation).all()
    assert scene.rectangles[0].centre[2] == 0.0


def test_shipped_world__arena_is_that_of_webots():
    arena, original = shipped("arena"), load_scene_file(ARENA).scene
    np.testing.assert_allclose(axes(arena.members), TRUE_ENDS, atol=1e-5)
    np.testing.assert_allclose(axes(arena.members), axes(original.members), atol=1e-12)
    assert [m.name for m in arena.members] == [m.name for m in original.members]
    for ours, theirs in zip(arena.rectangles, original.rectangles, strict=True):
        np.testing.assert_allclose(ours.centre, theirs.centre, atol=1e-12)
        np.testing.assert_allclose(ours.size, theirs.size)


def test_shipped_world__flat_angles():
    members = shipped("flat_angles").members
    bends = [
        angle_between_deg(lower.rotation[:, 2], upper.rotation[:, 2])
        for lower, upper in zip(members[::2], members[1::2], strict=True)
    ]
    assert bends == pytest.approx([6.0, 10.0, 15.0])


def test_shipped_world__joints_of_three_to_five():
    places = [tuple(np.round(member.start, 9)) for member in shipped("joints").members]
    assert sorted(places.count(place) for place in set(places)) == [3, 4, 5]


def test_shipped_world__parallels_are_as_far_apart_as_they_say():
    members = shipped("parallels").members
    for left, right in zip(members[::2], members[1::2], strict=True):
        assert np.linalg.norm(left.start - right.start) == pytest.approx(0.15)
        assert np.linalg.norm(left.end - right.end) == pytest.approx(0.15)


def test_shipped_world__what_the_others_hold():
    assert {m.section.radius for m in shipped("radii").members} == {0.1, 0.05, 0.03}
    shapes = [m.section.shape for m in shipped("sections").members]
    assert {shape: shapes.count(shape) for shape in shapes} == dict.fromkeys(
        ("round", "square", "i", "l", "c"), 2
    )
    assert {abs(m.bow) for m in shipped("bent").members} == {0.0, 0.01, 0.02, 0.05}
    assert len(shipped("lattice_tower").members) == 76
    assert len(shipped("bridge_truss").members) == 208
    clutter = shipped("clutter")
    assert clutter.members == ()
    assert clutter.boxes
    assert clutter.spheres
    assert len(clutter.rectangles) > 2


@pytest.mark.parametrize("name", NAMES)
def test_shipped_world__is_a_file_that_can_be_copied_and_changed(tmp_path, name):
    document = load_scene_file(name).document
    copy = shutil.copy(document.path, tmp_path / "mine.yaml")
    np.testing.assert_array_equal(
        axes(load_scene_file(copy).scene.members), axes(load_scene_file(name).scene.members)
    )
