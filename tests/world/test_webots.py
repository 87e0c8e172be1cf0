"""Webots worlds: the original's own, nested and scaled nodes, releases, and bad files."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamseg_batch.errors import WorldError
from beamseg_batch.world.webots import load_webots
from tests.world.worlds import axes, outcome, refusal_of, rodrigues, scene_of, written

ARENA = Path(__file__).parents[1] / "data" / "webots_tests.wbt"

TRUE_ENDS = [
    [[0.00520, 0.75070, 2.27384], [0.27671, 0.13832, 0.38936]],
    [[0.35863, -0.64674, 2.23545], [0.24260, 0.21929, 0.43641]],
    [[0.11791, -0.79565, 2.40592], [0.26742, -0.91168, 0.41490]],
    [[0.28422, 0.89519, 2.53107], [0.25821, -1.10137, 2.64547]],
    [[0.14862, 1.56485, 0.42217], [0.02451, 0.23512, 1.91093]],
    [[-0.46208, 0.60865, 1.61407], [0.10452, -1.12203, 0.78719]],
    [[0.18303, 1.25138, 1.46069], [-0.39485, 0.15680, 3.03167]],
]
"""Ends of the arena's beams, metres, as the truth of the original's flight in it has them."""

CYLINDER = "children [ Shape { geometry Cylinder { height 2 radius 0.05 } } ]"


def wbt(body, release="R2023b"):
    return f"#VRML_SIM {release} utf8\n{body}\n"


def scene(folder, body, release="R2023b"):
    return scene_of(folder, wbt(body, release), "world.wbt")


def refusal(folder, body):
    return refusal_of(folder, wbt(body), "world.wbt")


def shape(geometry):
    return f"Shape {{ geometry {geometry} }}"


# --- the original's world -------------------------------------------------------------


def test_load_webots__arena_of_the_original():
    arena = load_webots(ARENA).scene
    assert [member.name for member in arena.members] == [f"SEG{i}" for i in range(1, 8)]
    np.testing.assert_allclose(axes(arena.members), TRUE_ENDS, atol=1e-5)
    assert {(m.section.shape, m.section.radius) for m in arena.members} == {("round", 0.05)}
    assert [plate.centre[2] for plate in arena.rectangles] == [0.0, 6.89]
    assert [plate.size.tolist() for plate in arena.rectangles] == [[6, 6], [6, 6]]
    assert (arena.boxes, arena.spheres, arena.meshes, arena.notes) == ((), (), (), ())
    assert arena.name == "webots_tests"


def test_load_webots__has_no_flight_or_document():
    world = load_webots(ARENA)
    assert (world.flight, world.sensor, world.document) == (None, None, None)


# --- geometries and their defaults ----------------------------------------------------


def test_load_webots__default_sizes(tmp_path):
    found = scene(
        tmp_path,
        " ".join(shape(kind + " { }") for kind in ("Cylinder", "Box", "Sphere", "Plane"))
        + "Floor { } RectangleArena { }",
    )
    (member,) = found.members
    np.testing.assert_array_equal(axes([member]), [[[0, 0, -1], [0, 0, 1]]])
    assert (member.name, member.section.radius) == ("cylinder", 1.0)
    assert found.boxes[0].size.tolist() == [2, 2, 2]
    assert found.spheres[0].radius == 1.0
    sizes = [rectangle.size.tolist() for rectangle in found.rectangles]
    assert sizes == [[1, 1], [10, 10], [1, 1]]
    assert len(found.boxes) == 1 + 4


def test_load_webots__rectangle_arena_has_walls_around_its_floor(tmp_path):
    found = scene(
        tmp_path,
        "RectangleArena { translation 0 0 1 floorSize 4 2 wallThickness 0.1 wallHeight 0.5 }",
    )
    low = np.array([box.centre - box.size / 2 for box in found.boxes])
    high = np.array([box.centre + box.size / 2 for box in found.boxes])
    np.testing.assert_allclose(low.min(axis=0), [-2.1, -1.1, 1.0])
    np.testing.assert_allclose(high.max(axis=0), [2.1, 1.1, 1.5])
    inside = np.array([1.99, 0.99, 1.2])
    assert not ((low < inside) & (inside < high)).all(axis=1).any()


def test_load_webots__def_and_use(tmp_path):
    found = scene(
        tmp_path,
        """
        DEF POST Solid { children [ DEF BAR Shape { geometry DEF CYL Cylinder { radius 0.1 } } ] }
        Solid { translation 1 0 0 name "other" children [ USE BAR ] boundingObject USE CYL }
        Solid { translation 2 0 0 name "other" children [ Shape { geometry USE CYL } ] }
        DEF POST Pose { children [ USE BAR USE BAR ] }
        """,
    )
    names = [member.name for member in found.members]
    assert names == ["POST", "other", "other 2", "POST 2", "POST 3"]
    assert [member.start[0] for member in found.members] == [0, 1, 2, 0, 0]
    assert {member.section.radius for member in found.members} == {0.1}


def test_load_webots__nearest_def_before_counts(tmp_path):
    found = scene(
        tmp_path,
        shape("DEF C Cylinder { radius 1 }")
        + shape("DEF C Cylinder { radius 2 }")
        + shape("USE C"),
    )
    assert [member.section.radius for member in found.members] == [1, 2, 2]


def test_load_webots__bounding_objects_do_not_stand_there(tmp_path):
    found = scene(tmp_path, "Solid { boundingObject Group { children [ Box { } Cylinder { } ] } }")
    assert (found.members, found.boxes, found.notes) == ((), (), ())


def test_load_webots__comments_commas_and_texts(tmp_path):
    found = scene(
        tmp_path,
        """# Solid { is a comment
        Solid { translation 1, 2, 3 # } not the end
          name "a \\"quoted\\" } # text" children [ Shape { geometry Cylinder { }, } ] }""",
    )
    assert found.members[0].name == 'a "quoted" } # text'
    np.testing.assert_array_equal(found.members[0].start, [1, 2, 2])


# --- transforms -----------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_load_webots__nested_transforms_agree_with_a_slow_product(tmp_path_factory, seed):
    rng = np.random.default_rng(seed)
    body, product = shape("Cylinder { height 3 radius 0.2 }"), np.eye(4)
    kinds = rng.choice(["Pose", "Transform", "Solid", "Group"], rng.integers(1, 5))
    for kind in kinds:
        translation, scale = rng.normal(size=3), rng.choice([-1, 1]) * rng.uniform(0.5, 2)
        rotation = np.array([*rng.normal(size=3), rng.uniform(-4, 4)])
        fields, matrix = "", np.eye(4)
        if kind != "Group":
            fields = f"translation {translation} rotation {rotation} ".translate({91: "", 93: ""})
            matrix[:3, :3], matrix[:3, 3] = rodrigues(rotation[:3], rotation[3]), translation
        if kind == "Transform":
            fields += f"scale {scale} {scale} {scale} "
            matrix[:3, :3] *= scale
        body, product = f"{kind} {{ {fields} children [ {body} ] }}", matrix @ product
    (member,) = scene(tmp_path_factory.getbasetemp(), body).members
    ends = (product @ np.array([[0, 0, -1.5, 1], [0, 0, 1.5, 1]]).T).T[:, :3]
    np.testing.assert_allclose(axes([member])[0], ends, atol=1e-5)
    scale = np.cbrt(abs(np.linalg.det(product[:3, :3])))
    assert member.section.radius == pytest.approx(0.2 * scale, rel=1e-6)


def test_load_webots__cylinder_scaled_along_and_across(tmp_path):
    found = scene(tmp_path, f"Transform {{ scale 2 2 3 {CYLINDER} }}")
    np.testing.assert_allclose(axes(found.members), [[[0, 0, -3], [0, 0, 3]]])
    assert found.members[0].section.radius == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("kind", "scale", "message"),
    [
        ("Cylinder { }", "1 2 1", "Cylinder is scaled so that it is not round any more"),
        ("Sphere { }", "1 1 2", "Sphere is scaled so that it is not round any more"),
        ("Box { }", "1 0 1", "Box is scaled so that it is no box any more"),
        ("Plane { }", "0 1 1", "Plane is scaled so that it is askew"),
    ],
)
def test_load_webots__scale_that_cannot_be_kept_is_noted(tmp_path, kind, scale, message):
    found = scene(tmp_path, f"Transform {{\n scale {scale} children [ {shape(kind)} ] }}")
    assert found.notes == (f"{tmp_path}/world.wbt:3: {message}; it is skipped",)
    assert (found.members, found.boxes, found.spheres, found.rectangles) == ((), (), (), ())


def test_load_webots__shear_is_noted(tmp_path):
    turned = f"Pose {{ rotation 1 0 0 0.5 {CYLINDER} }}"
    found = scene(tmp_path, f"Transform {{ scale 1 2 1 children [ {turned} ] }}")
    assert found.members == ()
    assert "not round any more" in found.notes[0]


def test_load_webots__box_and_sphere_scaled_and_mirrored(tmp_path):
    found = scene(
        tmp_path,
        "Transform { rotation 0 0 1 0.5 scale -1 2 3 children [ Shape { geometry Box { } } ] }"
        "Transform { scale -2 -2 -2 children [ Shape { geometry Sphere { radius 0.1 } } ] }",
    )
    assert found.boxes[0].size.tolist() == pytest.approx([2, 4, 6])
    assert np.linalg.det(found.boxes[0].rotation) == pytest.approx(1.0)
    assert found.spheres[0].radius == pytest.approx(0.2)


# --- releases -------------------------------------------------------------------------

OLD = f"""
WorldInfo {{ coordinateSystem "NUE" }}
DEF POST Solid {{ translation 1 3 2 {CYLINDER} }}
Floor {{ translation 0 0.5 0 size 4 2 }}
RectangleArena {{ floorSize 4 2 wallThickness 0.1 wallHeight 0.5 }}
Solid {{ translation 0 1 0 children [ Shape {{ geometry Box {{ size 1 2 3 }} }} ] }}
"""


@pytest.mark.parametrize("release", ["R2020b", "R2021a", "R2021b"])
def test_load_webots__old_release_has_y_for_z(tmp_path, release):
    found = scene(tmp_path, OLD, release)
    np.testing.assert_allclose(axes(found.members), [[[1, -2, 2], [1, -2, 4]]], atol=1e-12)
    floor, arena = found.rectangles
    np.testing.assert_allclose(floor.centre, [0, 0, 0.5], atol=1e-12)
    np.testing.assert_allclose(np.abs(floor.rotation) @ [4, 2, 0], [4, 2, 0], atol=1e-12)
    assert arena.centre.tolist() == [0, 0, 0]
    *walls, box = found.boxes
    assert {round(float(wall.centre[2]), 9) for wall in walls} == {0.25}
    np.testing.assert_allclose(box.centre, [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(np.abs(box.rotation) @ box.size, [1, 3, 2], atol=1e-12)
    assert found.notes == (f"{tmp_path}/world.wbt: its y axis is up; it is turned so that z is",)


def test_load_webots__old_release_with_z_up(tmp_path):
    body = f'WorldInfo {{ coordinateSystem "ENU" }} Solid {{ {CYLINDER} }}'
    found = scene(tmp_path, body, "R2021b")
    np.testing.assert_allclose(axes(found.members), [[[0, -1, 0], [0, 1, 0]]], atol=1e-12)
    assert found.notes == ()


@pytest.mark.parametrize(
    ("release", "end"),
    [("R2021b", [0, 0, 1]), ("R2022a", [0, 0, 1]), ("R2022b", [0, 0, 1]), ("R2025a", [0, 0, 1])],
)
def test_load_webots__upright_cylinder_stays_upright(tmp_path, release, end):
    """In each release's own conventions a cylinder without rotation stands."""
    (member,) = scene(tmp_path, f"Solid {{ {CYLINDER} }}", release).members
    np.testing.assert_allclose(member.end, end, atol=1e-12)


def test_load_webots__new_release_with_y_up(tmp_path):
    body = f'WorldInfo {{ coordinateSystem "NUE" }} Solid {{ translation 0 5 0 {CYLINDER} }}'
    (member,) = scene(tmp_path, body).members
    np.testing.assert_allclose(axes([member]), [[[0, 1, 5], [0, -1, 5]]], atol=1e-12)


# --- what has no truth ----------------------------------------------------------------


def test_load_webots__mesh_is_clutter_and_said_to_have_no_axis(tmp_path):
    (tmp_path / "meshes").mkdir()
    written(tmp_path, "", "meshes/girder.obj")
    found = scene(
        tmp_path,
        """DEF GIRDER Transform { translation 1 2 3 rotation 0 0 1 1 scale 0.5 1 -2 children [
          Shape { geometry Mesh { url [ "meshes/girder.obj" ] } } ] }
        CadShape { url "./meshes/girder.obj" }""",
    )
    mesh, cad = found.meshes
    assert mesh.path == tmp_path / "meshes" / "girder.obj"
    expected = rodrigues([0, 0, 1], 1) * [0.5, 1, -2]
    np.testing.assert_allclose(mesh.rotation * mesh.scale, expected, atol=1e-12)
    np.testing.assert_allclose(mesh.translation, [1, 2, 3])
    np.testing.assert_allclose(cad.scale, [1, 1, 1])
    assert found.members == ()
    said = "is a mesh: its axis is not known, so it is clutter, no member"
    assert found.notes == (
        f"{tmp_path}/world.wbt:3: GIRDER {said}",
        f"{tmp_path}/world.wbt:4: CadShape {said}",
    )


@pytest.mark.parametrize("url", ["girder.dae", "https://example.org/girder.stl", "girder"])
def test_load_webots__mesh_of_another_kind_is_noted(tmp_path, url):
    found = scene(
        tmp_path,
        f"DEF G Pose {{ children [ {shape(f'Mesh {{ url {url!r} }}')} ] }}".replace("'", '"'),
    )
    assert found.meshes == ()
    assert found.notes == (
        f"{tmp_path}/world.wbt:2: G: {url} is no local .stl, .obj, .ply file; it is skipped",
    )


def test_load_webots__unknown_nodes_are_noted_with_their_line(tmp_path):
    found = scene(
        tmp_path,
        f"Tree {{ }}\nSolid {{ children [\n HingeJoint {{ endPoint Solid {{ {CYLINDER} }} }}\n"
        f" {shape('Cone { }')} ] }}\nViewpoint {{ }} PointLight {{ }} Robot {{ {CYLINDER} }}",
    )
    assert [note.removeprefix(f"{tmp_path}/") for note in found.notes] == [
        "world.wbt:2: Tree is not known; it is skipped with all that it holds",
        "world.wbt:4: HingeJoint is not known; it is skipped with all that it holds",
        "world.wbt:5: Cone is not known; it is skipped",
    ]
    assert found.members == ()


# --- bad files ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("Solid {", "2: Solid has no closing brace"),
        ("Solid {\n children [\n Shape { }", "3: children has no closing bracket"),
        ("Solid }", "2: '{' is expected after Solid, not '}'"),
        ("Solid { translation }", "2: translation has no value"),
        ("Solid { [ ] }", "2: a field or a closing brace is expected, not '['"),
        ("\n\n]", "4: a node is expected, not ']'"),
        ("USE A", "2: USE A: no DEF A stands before it"),
        ("DEF A Solid {\n children [ USE A ] }", "3: USE A: no DEF A stands before it"),
        ("EXTERNPROTO Solid", "2: the address of a PROTO is expected, not 'Solid'"),
        ('Solid { name "open', "2: a text has no closing quote"),
        (
            "Solid {\n translation 1 2 }",
            "3: Solid.translation: must hold 3 numbers, none above 1e+06",
        ),
        ("Solid { translation 1 2 nan }", "2: Solid.translation: must hold 3 numbers, none"),
        ("Solid { translation 1 2 -1e7 }", "2: Solid.translation: must hold 3 numbers, none"),
        (
            "Transform {\n scale 1e5 1e5 1e5 children [\n" * 100 + "] }" * 100,
            "4: Transform.translation: it stands or reaches beyond 1e+06 m",
        ),
        ("Solid { rotation 0 0 0 1 }", "2: Solid.rotation: the axis must not be 0, 0, 0"),
        (
            shape("Cylinder {\n radius -0.05 }"),
            "3: Cylinder.radius: must be above 0, not -0.05",
        ),
        (shape("Cylinder { height 0 }"), "2: Cylinder.height: must be above 0, not 0"),
        (
            f"Transform {{ scale 1e-6 1e-6 1e-6 {CYLINDER} }}",
            "2: Cylinder.height: a member of 2e-06 m is too short",
        ),
        (shape("Box { size 1 2 0 }"), "2: Box.size: must be above 0, not 0"),
        (shape('Mesh { url "none.stl" }'), "2: Mesh.url: none.stl: no such file"),
        ("Solid { children [ " * 200, "2: nodes nest deeper than 100"),
    ],
)
def test_load_webots__bad_world(tmp_path, body, message):
    assert refusal(tmp_path, body).startswith(f"world.wbt:{message}")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "1: is not a Webots world"),
        (b"Solid { }", "1: is not a Webots world"),
        (b"#VRML V2.0 utf8\n", "1: is not a Webots world"),
        (b"#VRML_SIM R2023b utf8\n\xff\xfe", " is not UTF-8 text"),
    ],
)
def test_load_webots__no_webots_world(tmp_path, content, message):
    path = tmp_path / "world.wbt"
    path.write_bytes(content)
    with pytest.raises(WorldError) as caught:
        load_webots(path)
    assert str(caught.value).startswith(f"{path}:{message}")


def test_load_webots__missing_file(tmp_path):
    with pytest.raises(WorldError, match=r"none\.wbt: cannot be read: No such file"):
        load_webots(tmp_path / "none.wbt")


def test_load_webots__nodes_that_use_nodes_that_use_nodes(tmp_path):
    body, used = "DEF N0 Group { }", "USE N0"
    for level in range(1, 20):
        body += f"\nDEF N{level} " + "Group { children [ " * 90 + used + " ] }" * 90
        used = f"USE N{level}"
    assert refusal(tmp_path, body) == "world.wbt: its nodes nest too deep"


PIECES = [
    *'{}[]"#,\n\\',
    "DEF A",
    "USE A",
    "NULL",
    "TRUE",
    "Solid {",
    "children [",
    "nan",
    "-1",
    "0",
]


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_load_webots__survives_any_damage(tmp_path_factory, data):
    text = ARENA.read_text(encoding="utf-8")[:3000]
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        end = start + data.draw(st.integers(0, 30))
        text = text[:start] + data.draw(st.sampled_from(["", *PIECES])) + text[end:]
    path = written(tmp_path_factory.getbasetemp(), text, "damaged.wbt")
    scene, said = outcome(path)
    assert said.startswith(str(path))
    assert all(member.length > 0 for member in scene.members)


def test_load_webots__a_copy_reads_the_same(tmp_path):
    copy = shutil.copy(ARENA, tmp_path / "copy.wbt")
    np.testing.assert_array_equal(
        axes(load_webots(copy).scene.members), axes(load_webots(ARENA).scene.members)
    )
