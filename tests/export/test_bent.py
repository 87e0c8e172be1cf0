"""Beams that are bent by 50 mm: every kind of file follows the bow as the tables have it."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from beamseg_batch.config import OutputConfig, RunConfig
from beamseg_batch.export import export_run
from beamseg_batch.geometry import section_frame
from beamseg_batch.model import CrossSection, Member
from beamseg_batch.outputs import read_run, write_run
from beamseg_batch.prisms import outline
from beamseg_batch.section import Section
from tests.export.test_formats import EXACT, ORIGIN, from_map
from tests.outputs.conftest import build_flight, make_joint, make_segment

BOW, RADIUS = 0.05, 0.03  # metres: the middle of the surface is further off than the chord's
ROLL = 0.7
I_BEAM = Section("i", 0.1, 0.16, 0.01, 0.015)


def bent(rng, place, **changes):
    """Build a beam that is bent towards something between its section's u and v."""
    direction = np.array([0.48, 0.6, 0.64])
    frame = section_frame(direction)
    bow = BOW * (0.6 * frame[:, 0] + 0.8 * frame[:, 1])
    values = {"anchor": np.array([0.0, place, 2.0]), "direction": direction, "t_min": -0.9}
    values |= {"t_max": 1.3, "radius": RADIUS, "bow_vector": bow, "sigma_bow": 0.001}
    return make_segment(rng, **(values | changes))


@pytest.fixture(scope="module")
def beams():
    rng = np.random.default_rng(5)
    across = section_frame(np.array([0.48, 0.6, 0.64]), ROLL)[:, 0]
    return bent(rng, 0.0), bent(rng, 1.0, cross_section=CrossSection("i", I_BEAM, across))


@pytest.fixture(scope="module")
def run(beams, tmp_path_factory):
    """Both beams, the first of them cut by a joint at t = 0.2, with points on their surface."""
    flight = build_flight(n_segments=0, config=RunConfig(outputs=OutputConfig(report=False)))
    joint = make_joint(np.random.default_rng(6), beams, (0, 1))
    t = np.linspace(-0.9, 1.3, 40)
    outside = RADIUS / BOW * beams[0].bow_vector
    flight = dataclasses.replace(
        flight,
        segments=beams,
        joints=(dataclasses.replace(joint, position=beams[0].points_at(np.array([0.2]))[0]),),
        members=(
            Member(0, -0.9, 0.2, None, 0),
            Member(0, 0.2, 1.3, 0, None),
            Member(1, -0.9, 1.3, None, None),
        ),
        cloud=(beams[0].points_at(t) + outside).astype(np.float32),
    )
    folder = tmp_path_factory.mktemp("bent") / "out"
    write_run(flight, folder)
    return read_run(folder)


def axis_of(run, number):
    """Give the function from `t` to the axis of a beam, (N, 3), as its table has it."""
    row = {name: values[number] for name, values in run.columns["segments"].items()}
    a, b, bow = (
        np.array([row[f"{name}_{axis}"] for axis in "xyz"], float) for name in ("a", "b", "bow")
    )

    def place(t):
        share = ((np.asarray(t) - row["t_min"]) / row["length"])[:, None]
        return a + np.asarray(t)[:, None] * b + 4.0 * share * (1.0 - share) * bow

    return place, lambda points: (np.asarray(points) - a) @ b


def members(run):
    """Beam, first and last `t` of every member."""
    columns = run.columns["members"]
    return list(zip(*(columns[name].tolist() for name in ("segment", "t1", "t2")), strict=True))


def assert_follows(run, number, nodes, first, last):
    """Check that a chain of nodes lies on an axis, and reaches from one end to the other."""
    place, along = axis_of(run, number)
    t = along(nodes)
    np.testing.assert_allclose(nodes, place(t), atol=EXACT)
    np.testing.assert_allclose(t[[0, -1]], [first, last], atol=EXACT)
    assert np.all(np.diff(t) > 0.0)
    pieces = 0.5 * (np.asarray(nodes)[1:] + np.asarray(nodes)[:-1])
    np.testing.assert_allclose(pieces, place(0.5 * (t[1:] + t[:-1])), atol=1.01e-5)


def assert_is_around(run, number, vertices, first, last):
    """Check that the vertices of a body stand at the corners of its section about the axis."""
    place, along = axis_of(run, number)
    vertices = np.asarray(vertices, dtype=float)
    t = along(vertices)
    np.testing.assert_allclose([t.min(), t.max()], [first, last], atol=EXACT)
    off = vertices - place(t)
    if number == 0:
        np.testing.assert_allclose(np.linalg.norm(off, axis=1), RADIUS, atol=EXACT)
    else:
        turned = off @ section_frame(run.segments[1].direction, ROLL)[:, :2]
        apart = np.linalg.norm(turned[:, None] - outline(I_BEAM), axis=2).min(axis=1)
        np.testing.assert_allclose(apart, 0.0, atol=EXACT)


def test_members__end_on_the_bent_axis(run):
    columns = run.columns["members"]
    for k, (number, *limits) in enumerate(members(run)):
        ends = [[columns[f"{axis}{end}"][k] for axis in "xyz"] for end in (1, 2)]
        np.testing.assert_allclose(ends, axis_of(run, number)[0](limits), atol=EXACT)
    joint = [run.columns["joints"][axis][0] for axis in "xyz"]
    np.testing.assert_allclose([columns[f"{axis}2"][0] for axis in "xyz"], joint, atol=EXACT)


def test_dxf__axes_and_solids_are_bent(run, tmp_path):
    import ezdxf

    space = ezdxf.readfile(export_run(run, tmp_path / "s.dxf").path).modelspace()
    axes = [[tuple(v.dxf.location) for v in line.vertices] for line in space.query("POLYLINE")]
    solids = [[tuple(v) for v in solid.vertices] for solid in space.query("MESH")]
    for member, axis, solid in zip(members(run), axes, solids, strict=True):
        number, first, last = member
        assert_follows(run, number, np.array(axis), first, last)
        assert_is_around(run, number, solid, first, last)


def test_ifc__axes_and_bodies_are_bent(run, tmp_path):
    import ifcopenshell
    from ifcopenshell.util import placement

    model = ifcopenshell.open(export_run(run, tmp_path / "s.ifc").path)
    for (number, first, last), entity in zip(members(run), model.by_type("IfcMember"), strict=True):
        T = placement.get_local_placement(entity.ObjectPlacement)
        axis, body = entity.Representation.Representations
        (line,) = axis.Items
        nodes = np.array([point.Coordinates for point in line.Points]) @ T[:3, :3].T + T[:3, 3]
        assert_follows(run, number, nodes, first, last)
        for solid, one, other in zip(body.Items, nodes[:-1], nodes[1:], strict=True):
            piece = T @ placement.get_axis2placement(solid.Position)
            np.testing.assert_allclose(piece[:3, 3], one, atol=EXACT)
            np.testing.assert_allclose(piece[:3, 3] + solid.Depth * piece[:3, 2], other, atol=EXACT)


@pytest.mark.parametrize("what", ["beams", "members"])
def test_glb__bodies_are_bent(run, tmp_path, what):
    import trimesh

    scene = trimesh.load_scene(export_run(run, tmp_path / "s.glb", what).path)
    bodies = [(0, -0.9, 1.3), (1, -0.9, 1.3)] if what == "beams" else members(run)
    assert len(scene.geometry) == len(bodies)
    for k, body in enumerate(bodies):
        name = f"{what.removesuffix('s')}_{k}"
        placed = scene.geometry[name].copy()
        placed.apply_transform(scene.graph[name][0])
        assert_is_around(run, body[0], placed.vertices, *body[1:])


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".ply"])
def test_meshes__bodies_are_bent(run, tmp_path, suffix):
    import trimesh

    whole = trimesh.load(export_run(run, tmp_path / f"s{suffix}").path, force="mesh")
    bodies = sorted(whole.split(only_watertight=False), key=lambda body: body.bounds[0, 1])
    for number, body in enumerate(bodies):
        assert_is_around(run, number, body.vertices, -0.9, 1.3)
    assert len(bodies) == 2


def test_geojson__lines_are_bent(run, tmp_path):
    path = export_run(run, tmp_path / "s.geojson", origin=ORIGIN).path
    features = json.loads(path.read_text())["features"]
    lines = [f for f in features if f["geometry"]["type"] == "LineString"]
    for (number, *limits), feature in zip(members(run), lines, strict=True):
        found = from_map(feature["geometry"]["coordinates"])
        place, along = axis_of(run, number)
        assert len(found) > 20
        np.testing.assert_allclose(found, place(along(found)), atol=2 * EXACT)
        np.testing.assert_allclose(along(found)[[0, -1]], limits, atol=2 * EXACT)


def test_graph__ends_and_bow_give_the_axis(run, tmp_path):
    graph = json.loads(export_run(run, tmp_path / "s.json").path.read_text())
    share = np.linspace(0.0, 1.0, 9)[:, None]
    for (number, first, last), member in zip(members(run), graph["members"], strict=True):
        one, other, bow = (np.array(member[name]) for name in ("end_1", "end_2", "bow"))
        found = one + share * (other - one) + 4.0 * share * (1.0 - share) * bow
        place, _ = axis_of(run, number)
        np.testing.assert_allclose(found, place(first + share[:, 0] * (last - first)), atol=EXACT)
    joint = graph["nodes"][0]["position"]
    np.testing.assert_allclose(graph["members"][0]["end_2"], joint, atol=EXACT)


def test_points__on_the_outside_of_a_bend_belong_to_their_beam(run, tmp_path):
    import laspy

    las = laspy.read(export_run(run, tmp_path / "p.las").path)
    assert las["beam"].tolist() == [0] * 40
