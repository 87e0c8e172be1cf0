"""Worlds written in YAML: what they hold, their defaults, and what is said of bad ones."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from beamseg_batch.world.models import MemberConfig
from beamseg_batch.world.scene import Section
from beamseg_batch.world.yaml_world import load_world
from tests.world.worlds import axes, outcome, refusal_of, rodrigues, scene_of, written

ENDS = "ends: [[0, 0, 1], [2, 0, 1]]"
coordinates = st.floats(-5, 5, allow_nan=False)
vectors = st.tuples(coordinates, coordinates, coordinates)


def member_of(folder, text):
    (member,) = scene_of(folder, f"members:\n  - {{{text}}}\n").members
    return member


def section_of(folder, text):
    return member_of(folder, f"{ENDS}, {text}").section


# --- members --------------------------------------------------------------------------


def test_load_world__member_by_ends(tmp_path):
    member = member_of(tmp_path, f"{ENDS}, radius: 0.03, roll_deg: 90, bow: 0.01, name: rail")
    np.testing.assert_array_equal(axes([member]), [[[0, 0, 1], [2, 0, 1]]])
    assert member.section == Section("round", 0.06, 0.06)
    assert (member.name, member.bow, member.roll) == ("rail", 0.01, math.pi / 2)
    assert member.start.dtype == np.float64


def test_load_world__member_by_pose(tmp_path):
    pose = "pose: {translation: [1, 2, 3], rotation_rpy_deg: [0, 90, 0]}, length: 2"
    member = member_of(tmp_path, f"{pose}, shape: square, width: 0.1")
    np.testing.assert_allclose(axes([member]), [[[0, 2, 3], [2, 2, 3]]], atol=1e-12)
    turn = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    np.testing.assert_allclose(member.rotation, turn, atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(vectors, vectors, st.floats(-180, 180), st.floats(0.1, 5))
def test_member__pose_and_ends_are_the_same(middle, rpy, roll, length):
    """A member by its pose is the one by the ends and the roll that follow from the pose."""
    pose = {"translation": middle, "rotation_rpy_deg": [60 * angle for angle in rpy]}
    by_pose = MemberConfig(pose=pose, length=length, shape="l", width=0.1, roll_deg=roll)
    by_pose = by_pose.member("")
    r, p, y = np.radians(pose["rotation_rpy_deg"])
    turn = rodrigues([0, 0, 1], y) @ rodrigues([0, 1, 0], p) @ rodrigues([1, 0, 0], r)
    np.testing.assert_allclose(by_pose.start, middle - turn[:, 2] * length / 2, atol=1e-9)
    np.testing.assert_allclose(by_pose.end, middle + turn[:, 2] * length / 2, atol=1e-9)
    rolled = turn @ rodrigues([0, 0, 1], np.radians(roll))
    np.testing.assert_allclose(by_pose.rotation, rolled, atol=1e-8)

    ends = [tuple(by_pose.start), tuple(by_pose.end)]
    by_ends = MemberConfig(ends=ends, shape="l", width=0.1, roll_deg=np.degrees(by_pose.roll))
    np.testing.assert_allclose(by_ends.member("").rotation, by_pose.rotation, atol=1e-8)


@settings(max_examples=30, deadline=None)
@given(vectors.filter(lambda axis: np.linalg.norm(axis) > 0.1), st.floats(-7, 7))
def test_member__both_ways_to_turn_agree(axis, angle):
    turn = rodrigues(axis, angle)
    pitch = math.asin(np.clip(-turn[2, 0], -1, 1))
    roll, yaw = math.atan2(turn[2, 1], turn[2, 2]), math.atan2(turn[1, 0], turn[0, 0])
    rpy = np.degrees([roll, pitch, yaw]).tolist()
    by_rpy, by_axis = (
        MemberConfig(pose=pose, length=2.0).member("")
        for pose in ({"rotation_rpy_deg": rpy}, {"rotation_axis_angle": [*axis, angle]})
    )
    np.testing.assert_allclose(by_rpy.rotation, by_axis.rotation, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "section"),
    [
        ("radius: 0.1", Section("round", 0.2, 0.2)),
        ("shape: round", Section("round", 0.1, 0.1)),
        ("shape: square, width: 0.1", Section("square", 0.1, 0.1, 0.01, 0.01)),
        ("shape: square, width: 0.1, thickness: 0.005", Section("square", 0.1, 0.1, 0.005, 0.005)),
        ("shape: i, width: 0.1, height: 0.2", Section("i", 0.1, 0.2, 0.01, 0.01)),
        (
            "shape: h, width: 0.1, height: 0.2, web: 0.02, flange: 0.03",
            Section("i", 0.1, 0.2, 0.02, 0.03),
        ),
        (
            "shape: l, width: 0.1, height: 0.2, thickness: 0.02, web: 0.03",
            Section("l", 0.1, 0.2, 0.03, 0.02),
        ),
        ("shape: c, width: 0.3, height: 0.2", Section("c", 0.3, 0.2, 0.02, 0.02)),
    ],
)
def test_load_world__sections_and_their_defaults(tmp_path, text, section):
    found = section_of(tmp_path, text)
    assert found.shape == section.shape
    np.testing.assert_allclose(
        [found.width, found.height, found.web, found.flange],
        [section.width, section.height, section.web, section.flange],
    )


def test_load_world__names_are_numbers_where_there_are_none(tmp_path):
    scene = scene_of(tmp_path, f"members: [{{{ENDS}}}, {{{ENDS}, name: rail}}, {{{ENDS}}}]\n")
    assert [member.name for member in scene.members] == ["member 1", "rail", "member 3"]


# --- generated structures -------------------------------------------------------------


def test_load_world__generated_structures_are_named_and_placed(tmp_path):
    scene = scene_of(
        tmp_path,
        """\
generate:
  - lattice_tower: {panels: 2, height: 2, legs: {shape: l, width: 0.1}}
  - star_joint:
      name: star
      count: 3
      pose: {translation: [5, 0, 1], rotation_rpy_deg: [180, 0, 0]}
  - angle_pairs:
  - parallel_pairs: {distances: [0.15], section: {radius: 0.02}}
  - bridge_truss: {panels: 3}
""",
    )
    names = [member.name for member in scene.members]
    assert len(names) == 28 + 3 + 6 + 2 + 38
    assert names[0] == "lattice tower leg 1"
    assert names[28:31] == ["star arm 1", "star arm 2", "star arm 3"]
    assert scene.members[0].section.shape == "l"
    assert scene.members[37].section.width == 0.04
    for arm in scene.members[28:31]:
        np.testing.assert_allclose(arm.start, [5, 0, 1])
        assert arm.end[2] < 1


# --- clutter, floor and ceiling -------------------------------------------------------


def test_load_world__clutter(tmp_path):
    written(tmp_path, "", "rock.STL")
    scene = scene_of(
        tmp_path,
        """\
clutter:
  - plane: {size: [2, 3], translation: [1, 0, 0], rotation_rpy_deg: [90, 0, 0]}
  - plane:
  - box: {size: [1, 2, 3], rotation_axis_angle: [0, 0, 2, 1.5707963267948966]}
  - sphere: {centre: [1, 2, 3], radius: 0.5}
  - mesh: {file: rock.STL, scale: 0.001, translation: [0, 0, 4]}
  - mesh: {file: ./rock.STL, scale: [1, 2, 3]}
floor: false
""",
    )
    wall, plate = scene.rectangles
    np.testing.assert_allclose(wall.rotation[:, 2], [0, -1, 0], atol=1e-12)
    assert wall.size.tolist() == [2, 3]
    assert plate.size.tolist() == [10, 10]
    (box,) = scene.boxes
    np.testing.assert_allclose(box.rotation, rodrigues([0, 0, 1], np.pi / 2), atol=1e-12)
    (sphere,) = scene.spheres
    assert (sphere.centre.tolist(), sphere.radius) == ([1, 2, 3], 0.5)
    small, long = scene.meshes
    assert small.path == tmp_path / "rock.STL"
    assert (small.scale.tolist(), small.translation.tolist()) == ([0.001] * 3, [0, 0, 4])
    assert long.scale.tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    ("text", "heights"),
    [
        ("{}", [0.0]),
        ("floor: true", [0.0]),
        ("floor: false", []),
        ("floor: {z: -1}\nceiling: true", [-1.0, 4.0]),
        ("floor:\n  size: [2, 3]\n  centre: [1, 1]\nceiling: {z: 6.89}", [0.0, 6.89]),
    ],
)
def test_load_world__floor_and_ceiling(tmp_path, text, heights):
    assert [r.centre[2] for r in scene_of(tmp_path, text).rectangles] == heights


def test_load_world__floor_has_a_size_and_a_place(tmp_path):
    (floor,) = scene_of(tmp_path, "floor: {z: 1, size: [2, 3], centre: [4, 5]}").rectangles
    assert (floor.centre.tolist(), floor.size.tolist()) == ([4, 5, 1], [2, 3])


# --- the rest -------------------------------------------------------------------------


def test_load_world__hands_on_flight_and_sensor(tmp_path):
    text = "flight: {kind: anything, values: [1, {a: b}]}\nsensor: some_camera\n"
    path = written(tmp_path, text)
    world = load_world(path)
    assert world.flight == {"kind": "anything", "values": [1, {"a": "b"}]}
    assert world.sensor == "some_camera"
    assert world.document.line_of(("flight", "values")) == 1
    assert world.document.path == path


def test_load_world__has_no_flight_or_sensor_of_its_own(tmp_path):
    world = load_world(written(tmp_path, "name: hall\n"))
    assert (world.flight, world.sensor, world.scene.name) == (None, None, "hall")
    assert load_world(written(tmp_path, "{}", "yard.yaml")).scene.name == "yard"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"  - {{{ENDS}, shape: hexagon}}", ".shape: must be 'round', 'square', 'i', 'h', 'l' or"),
        (f"  - {{{ENDS}, radius: -0.05}}", ".radius: must be above 0, not -0.05"),
        (f"  - {{{ENDS}, raduis: 0.05}}", ".raduis: unknown key; did you mean 'radius'?"),
        (
            "  - {ends: [[1, 2, 3], [1, 2, 3]]}",
            ".ends: are 0 m apart; a member is at least 0.001 m long",
        ),
        ("  - {pose: {}, length: 0}", ".length: must be at least 0.001, not 0"),
        ("  - {radius: 1}", ": needs either ends or a pose"),
        (f"  - {{{ENDS}, pose: {{}}, length: 1}}", ": needs either ends or a pose"),
        ("  - {pose: {}}", ": a pose and a length go together"),
        (f"  - {{{ENDS}, length: 1}}", ": a pose and a length go together"),
        (
            f"  - {{{ENDS}, bow: 0.6}}",
            ": bow must be at most a quarter of the length, 0.5, not 0.6",
        ),
        (f"  - {{{ENDS}, shape: square}}", ": shape 'square' needs a width"),
        (f"  - {{{ENDS}, shape: i, radius: 1}}", ".radius: shape 'i' has width and height"),
        (f"  - {{{ENDS}, width: 1}}", ".width: shape 'round' has a radius alone; name the shape"),
        (
            f"  - {{{ENDS}, shape: i, width: 0.1, web: 0.2}}",
            ".web: must be below 0.1 in a section of 0.1 by 0.1, not 0.2",
        ),
        (
            f"  - {{{ENDS}, shape: c, width: 0.1, height: 0.2, flange: 0.1}}",
            ".flange: must be below 0.1 in a section of 0.1 by 0.2, not 0.1",
        ),
        (
            f"  - {{{ENDS}, shape: square, width: 0.1, height: 0.2, thickness: 0.05}}",
            ".thickness: must be below 0.05 in a section of 0.1 by 0.2, not 0.05",
        ),
        (
            "  - {length: 1, pose: {rotation_axis_angle: [0, 0, 0, 1]}}",
            ".pose.rotation_axis_angle: the axis must not be 0, 0, 0",
        ),
        (
            "  - pose: {rotation_axis_angle: [0, 0, 1, 1], rotation_rpy_deg: [0, 0, 1]}",
            ".pose: give rotation_rpy_deg or rotation_axis_angle, not both",
        ),
        ("  - {ends: [[0, 0, 0], [.inf, 0, 0]]}", ".ends[1][0]: must be finite, not inf"),
        ("  - {ends: [[0, 0, 0]]}", ".ends[1]: is missing"),
        ("  - beam", ": must be a mapping of keys to values, not 'beam'"),
    ],
)
def test_load_world__bad_member(tmp_path, text, message):
    said = refusal_of(tmp_path, f"members:\n  - {{{ENDS}}}\n\n{text}\n")
    assert said.startswith(f"world.yaml:4: members[1]{message}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("clutter: [{cone: {}}]", "1: clutter[0].cone: unknown key; there are: plane, box, sphere"),
        ("clutter: [{}]", "1: clutter[0]: must hold one of these keys: plane, box, sphere, mesh"),
        ("clutter:\n- box:\n- plane:", "2: clutter[0].box.size: is missing"),
        (
            "clutter: [{box: {size: [1, 1, 0]}}]",
            "1: clutter[0].box.size[2]: must be above 0, not 0",
        ),
        (
            "clutter:\n- mesh: {file: a.stl}\n",
            "2: clutter[0].mesh.file: a.stl: no such file",
        ),
        (
            "clutter:\n- mesh:\n    file: a.dae\n",
            "3: clutter[0].mesh.file: a.dae: a mesh is one of .stl, .obj, .ply",
        ),
        (
            "generate: [{tower: {}}]",
            "1: generate[0].tower: unknown key; there are: lattice_tower, ",
        ),
        (
            "generate: [{lattice_towr: {}}]",
            "1: generate[0].lattice_towr: unknown key; did you mean 'lattice_tower'?",
        ),
        (
            "generate:\n- lattice_tower:\n    panels: 0\n",
            "3: generate[0].lattice_tower.panels: must be at least 1, not 0",
        ),
        (
            "generate:\n- lattice_tower:\n    legs: {radius: -1}\n",
            "3: generate[0].lattice_tower.legs.radius: must be above 0, not -1",
        ),
        (
            "generate:\n- star_joint: {}\n- star_joint: {}\n",
            "3: generate[1]: a member is called 'star joint arm 1' already; name this",
        ),
        ("floor: 1", "1: floor: must be a mapping of keys to values, not 1"),
        ("ceiling: {z: x}", "1: ceiling.z: must be a number, not 'x'"),
        ("flight: orbit", "1: flight: must be a mapping of keys to values, not 'orbit'"),
        ("sensor: [a]", "1: sensor: must be text, not ['a']"),
        ("lights: on", "1: lights: unknown key; did you mean 'flight'?"),
    ],
)
def test_load_world__bad_world(tmp_path, text, message):
    assert refusal_of(tmp_path, text).startswith(f"world.yaml:{message}")


def test_load_world__anchor_that_is_used_again(tmp_path):
    text = "members:\n- {ends: [&p [0, 0, 1], &p [0, 0, 2]], radius: 0.05}\n"
    assert len(scene_of(tmp_path, text).members) == 1


def test_load_world__two_members_of_one_name(tmp_path):
    text = f"members:\n- {{{ENDS}, name: a}}\n- {{{ENDS}, name: a}}\n"
    said = refusal_of(tmp_path, text)
    assert said == "world.yaml:3: members[1]: a member is called 'a' already; name this"


def test_member_config__is_closed_and_frozen():
    member = MemberConfig(ends=((0, 0, 0), (1, 0, 0)))
    with pytest.raises(ValidationError, match="frozen"):
        member.radius = 1.0


MUTATED = """\
members:
  - {name: a, ends: [[0, 0, 0], [1, 0, 0]], radius: 0.05}
  - name: b
    pose: {translation: [0, 0, 1], rotation_rpy_deg: [0, 90, 0]}
    length: 2.0
    shape: i
    width: 0.1
generate:
  - star_joint: {count: 3}
clutter:
  - sphere: {centre: [1, 1, 1], radius: 0.2}
floor: true
"""
PIECES = [
    *"{}[]-:&*#,|>!'\"\n\t ~",
    ": ",
    "- ",
    "<<: *a",
    "&a ",
    "!!set ",
    "!!float ",
    ".nan",
    "1e999",
]


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_load_world__survives_any_damage(tmp_path_factory, data):
    text = MUTATED
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        end = start + data.draw(st.integers(0, 8))
        text = text[:start] + data.draw(st.sampled_from(["", *PIECES])) + text[end:]
    path = written(tmp_path_factory.getbasetemp(), text, "damaged.yaml")
    scene, said = outcome(path)
    assert said.startswith(str(path))
    assert all(a.name != b.name for a, b in combinations(scene.members, 2))
