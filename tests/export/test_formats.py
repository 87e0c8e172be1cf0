"""Every kind of file, read back: its geometry is that of the tables."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from beamseg_batch.bars import beams_of
from beamseg_batch.errors import RunError
from beamseg_batch.export import FORMATS, Origin, export_run
from beamseg_batch.export.graph import schema
from beamseg_batch.prisms import mesh_of
from tests.export.conftest import OFF_AXIS
from tests.export.test_bars import SECTIONS, columns_of

EXACT = 1e-6  # metres
ORIGIN = Origin(46.5191, 6.5668, 400.0, 30.0)


def ends(run, table, numbers=slice(None)) -> np.ndarray:
    """(N, 2, 3): ends of the rows of a table."""
    columns = run.columns[table]
    names = [[f"{axis}{k}" for axis in "xyz"] for k in (1, 2)]
    stacked = np.array([[columns[name] for name in end] for end in names])
    return np.moveaxis(stacked, 2, 0)[numbers]


def joints(run) -> np.ndarray:
    return np.column_stack([run.columns["joints"][axis] for axis in "xyz"])


def off_axis(vertices, pair) -> tuple[np.ndarray, np.ndarray]:
    """Distance of vertices from an axis, and their share of its length."""
    start, end = pair
    length = np.linalg.norm(end - start)
    along = (vertices - start) @ (end - start) / length
    foot = start + along[:, None] * (end - start) / length
    return np.linalg.norm(vertices - foot, axis=1), along / length


def assert_is_cylinder(vertices, pair, radius) -> None:
    distances, shares = off_axis(np.asarray(vertices), pair)
    length = np.linalg.norm(pair[1] - pair[0])
    np.testing.assert_allclose(distances, radius, atol=EXACT)
    assert np.minimum(abs(shares), abs(shares - 1.0)).max() * length < EXACT
    assert {0, 1} == set(np.round(shares).astype(int).tolist())


def exported(run, path: Path, *arguments, **options) -> Path:
    export_run(run, path, *arguments, **options)
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]
    return path


@pytest.mark.parametrize("what", ["members", "beams"])
def test_dxf__lines_meshes_and_points_are_those_of_the_tables(run, tmp_path, what):
    import ezdxf

    drawing = ezdxf.readfile(exported(run, tmp_path / "s.dxf", what))
    assert drawing.units == ezdxf.units.M
    assert not drawing.audit().has_errors
    space = drawing.modelspace()
    lines = np.array([[*map(tuple, (e.dxf.start, e.dxf.end))] for e in space.query("LINE")])
    expected = ends(run, "members" if what == "members" else "segments")
    np.testing.assert_allclose(lines, expected, atol=EXACT)
    solids = list(space.query("MESH"))
    assert {solid.dxf.layer for solid in solids} == {"SECTION-ROUND-D100"}
    for solid, pair in zip(solids, expected, strict=True):
        assert_is_cylinder(np.array([tuple(v) for v in solid.vertices]), pair, 0.05)
    points = [tuple(point.dxf.location) for point in space.query("POINT")]
    np.testing.assert_allclose(points, joints(run), atol=EXACT)


def test_ifc__validates_and_stands_where_the_tables_say(run, tmp_path):
    import ifcopenshell
    import ifcopenshell.util.element
    import ifcopenshell.util.placement
    import ifcopenshell.validate

    model = ifcopenshell.open(exported(run, tmp_path / "s.ifc"))
    logger = ifcopenshell.validate.json_logger()
    ifcopenshell.validate.validate(model, logger)
    assert logger.statements == []
    members = model.by_type("IfcMember")
    columns = run.columns["segments"]
    for number, (member, pair) in enumerate(zip(members, ends(run, "members"), strict=True)):
        body = member.Representation.Representations[1].Items[0]
        T = ifcopenshell.util.placement.get_local_placement(member.ObjectPlacement)
        np.testing.assert_allclose(T[:3, 3], pair[0], atol=EXACT)
        np.testing.assert_allclose(T[:3, 3] + body.Depth * T[:3, 2], pair[1], atol=EXACT)
        assert body.SweptArea.Radius == pytest.approx(0.05, abs=EXACT)
        beam = run.columns["members"]["segment"][number]
        known = ifcopenshell.util.element.get_psets(member)["Beamseg_Measurement"]
        assert known["beam"] == beam
        assert known["sigma_offset"] == pytest.approx(columns["sigma_offset"][beam])
        assert known["end_1_seen"] is columns["end_1_seen"][beam]
    meet = {connection.Name for connection in model.by_type("IfcRelConnectsElements")}
    assert meet == {f"joint {number}" for number in range(len(joints(run)))}


def test_ifc__the_same_identities_again(run, tmp_path):
    import ifcopenshell

    found = [
        [root.GlobalId for root in ifcopenshell.open(export_run(run, path).path).by_type("IfcRoot")]
        for path in (tmp_path / "one.ifc", tmp_path / "two.ifc")
    ]
    assert found[0] == found[1]
    assert len(set(found[0])) == len(found[0])


@pytest.mark.parametrize("bow", [0.0, 0.005])
@pytest.mark.parametrize("shape", SECTIONS)
def test_ifc__profiles_fill_the_same_space_as_the_mesh(content, tmp_path, shape, bow):
    import ifcopenshell
    import ifcopenshell.geom
    import ifcopenshell.validate

    from beamseg_batch.export.ifc import _Model

    section = SECTIONS[shape]
    (bar,) = beams_of(columns_of(section, bow=bow))
    model = _Model(ifcopenshell, content)
    model.add(bar)
    model.finish("s.ifc")
    logger = ifcopenshell.validate.json_logger()
    ifcopenshell.validate.validate(model.file, logger)
    assert logger.statements == []
    settings = ifcopenshell.geom.settings()
    settings.set("use-world-coords", True)
    shape_made = ifcopenshell.geom.create_shape(settings, model.file.by_type("IfcMember")[0])
    vertices = np.array(shape_made.geometry.verts).reshape(-1, 3)
    mesh = mesh_of(bar)
    along = vertices @ bar.rotation
    expected = mesh.vertices @ bar.rotation
    # A bowed bar is mitred by its mesh and not by its pieces; a circle is cut as each likes.
    loose = 2e-3 if bow or shape == "round" else EXACT
    np.testing.assert_allclose(along.min(axis=0), expected.min(axis=0), atol=loose)
    np.testing.assert_allclose(along.max(axis=0), expected.max(axis=0), atol=loose)


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".stl", ".ply"])
def test_meshes__stand_where_the_tables_say(run, tmp_path, suffix):
    import trimesh

    scene = trimesh.load_scene(exported(run, tmp_path / f"s{suffix}"))
    bodies = scene.to_mesh().split(only_watertight=False)
    expected = ends(run, "segments")
    assert len(bodies) == len(expected)
    middles = expected.mean(axis=1)
    for body in bodies:
        nearest = np.argmin(np.linalg.norm(middles - body.bounds.mean(axis=0), axis=1))
        assert_is_cylinder(body.vertices, expected[nearest], 0.05)


def test_glb__a_named_mesh_for_each_beam_and_exact_far_from_the_origin(run, tmp_path):
    import trimesh

    scene = trimesh.load_scene(exported(run, tmp_path / "s.glb"))
    assert set(scene.geometry) == {f"beam_{number}" for number in range(7)}
    for number, pair in enumerate(ends(run, "segments")):
        placed = scene.geometry[f"beam_{number}"].copy()
        placed.apply_transform(scene.graph[f"beam_{number}"][0])
        assert_is_cylinder(placed.vertices, pair, 0.05)


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".stl", ".ply"])
def test_meshes__can_be_turned_so_that_y_points_up(run, tmp_path, suffix):
    import trimesh

    plain = trimesh.load_scene(export_run(run, tmp_path / f"z{suffix}").path).to_mesh()
    turned = trimesh.load_scene(export_run(run, tmp_path / f"y{suffix}", up="y").path).to_mesh()
    low, high = plain.bounds
    expected = [[low[0], low[2], -high[1]], [high[0], high[2], -low[1]]]
    np.testing.assert_allclose(turned.bounds, expected, atol=EXACT)
    assert turned.volume == pytest.approx(plain.volume, rel=1e-4)


def assert_are_points_of_beams(run, points, beams) -> None:
    assert len(points) == 70
    axes = ends(run, "segments")
    for number, axis in enumerate(axes):
        distances, _ = off_axis(np.asarray(points)[np.asarray(beams) == number], axis)
        np.testing.assert_allclose(distances, OFF_AXIS, atol=EXACT)


@pytest.mark.parametrize("name", ["p.pcd", "p.ply"])
def test_points__by_open3d(run, tmp_path, name):
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    path = exported(run, tmp_path / name, "points")
    cloud = open3d.t.io.read_point_cloud(str(path))
    beams = cloud.point["beam"].numpy().ravel()
    assert_are_points_of_beams(run, cloud.point.positions.numpy().astype(float), beams)


@pytest.mark.parametrize("name", ["p.laz", "p.las"])
def test_points__by_laspy(run, tmp_path, name):
    import laspy

    las = laspy.read(exported(run, tmp_path / name))
    assert_are_points_of_beams(run, np.asarray(las.xyz), las["beam"])


def earth_from(longitude, latitude, height) -> np.ndarray:
    """Point in the earth's frame, WGS 84, from its textbook."""
    lon, lat = np.radians([longitude, latitude])
    a, e2 = 6378137.0, 0.00669437999014132
    normal = a / np.sqrt(1 - e2 * np.sin(lat) ** 2)
    across = (normal + height) * np.cos(lat)
    z = (normal * (1 - e2) + height) * np.sin(lat)
    return np.array([across * np.cos(lon), across * np.sin(lon), z])


def from_map(places) -> np.ndarray:
    """(N, 3), metres, world frame: where a map of `ORIGIN` has its places."""
    lon, lat, turn = np.radians([ORIGIN.longitude, ORIGIN.latitude, ORIGIN.heading])
    centre = earth_from(ORIGIN.longitude, ORIGIN.latitude, ORIGIN.altitude)
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    north = np.cross(up, east)
    x = np.cos(turn) * east - np.sin(turn) * north
    T = np.array([x, np.cross(up, x), up])
    return np.array([T @ (earth_from(*place) - centre) for place in places])


def test_geojson__distances_and_directions_are_those_of_the_tables(run, tmp_path):
    document = json.loads(exported(run, tmp_path / "s.geojson", origin=ORIGIN).read_text())
    lines = [f for f in document["features"] if f["geometry"]["type"] == "LineString"]
    points = [f for f in document["features"] if f["geometry"]["type"] == "Point"]
    for feature, pair in zip(lines, ends(run, "members"), strict=True):
        found = from_map(feature["geometry"]["coordinates"])
        np.testing.assert_allclose(found, pair, atol=2 * EXACT)
    found = from_map(feature["geometry"]["coordinates"] for feature in points)
    np.testing.assert_allclose(found, joints(run), atol=2 * EXACT)


def test_origin__north_and_east_as_a_map_has_them():
    origin = Origin(46.0, 6.0)
    (here, north, east, above) = origin.geographic(
        np.array([[0.0, 0, 0], [0, 100, 0], [100, 0, 0], [0, 0, 100]])
    )
    np.testing.assert_allclose(here, [6.0, 46.0, 0.0], atol=1e-8)
    assert north[1] > here[1]
    assert north[0] == pytest.approx(6.0)
    assert east[0] > here[0]
    np.testing.assert_allclose(above, [6.0, 46.0, 100.0], atol=1e-8)


def test_origin__at_a_pole():
    (place,) = Origin(90.0, 0.0, 10.0).geographic(np.zeros((1, 3)))
    np.testing.assert_allclose(place[1:], [90.0, 10.0], atol=1e-8)


@pytest.mark.parametrize(("what", "table"), [("beams", "segments"), ("members", "members"),
                                             ("joints", "joints")])  # fmt: skip
def test_parquet__the_table_as_it_stands(run, tmp_path, what, table):
    import pyarrow.parquet

    found = pyarrow.parquet.read_table(exported(run, tmp_path / "t.parquet", what))
    columns = run.columns[table]
    assert found.column_names == list(columns)
    for name, values in columns.items():
        got = found[name].to_pylist()
        wanted = [None if pd.isna(value) else value for value in values.tolist()]
        assert got == wanted, name
    assert found.schema.field(found.column_names[1]).metadata[b"unit"] in (b"m", b"")


def test_parquet__points(run, tmp_path):
    import pyarrow.parquet

    found = pyarrow.parquet.read_table(exported(run, tmp_path / "p.parquet", "points"))
    points = np.column_stack([found[axis].to_numpy() for axis in "xyz"])
    assert_are_points_of_beams(run, points.astype(float), found["beam"].to_numpy())


def test_graph__fulfils_its_schema_and_holds_the_tables(run, tmp_path):
    import jsonschema

    graph = json.loads(exported(run, tmp_path / "s.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema())
    jsonschema.validate(graph, schema())
    nodes = {node["id"]: node for node in graph["nodes"]}
    sections = {section["id"]: section for section in graph["sections"]}
    assert len(nodes) == len(graph["nodes"])
    columns = run.columns["members"]
    for number, (member, pair) in enumerate(
        zip(graph["members"], ends(run, "members"), strict=True)
    ):
        np.testing.assert_allclose([member["end_1"], member["end_2"]], pair, atol=EXACT)
        assert sections[member["section"]]["radius"] == 0.05
        for k in (1, 2):
            joint, node = columns[f"joint_{k}"][number], nodes[member[f"node_{k}"]]
            if np.isnan(joint):
                assert node["kind"] == "free_end"
                assert node["position"] == member[f"end_{k}"]
            else:
                assert node["id"] == f"J{joint:.0f}"
                assert node["position"] == joints(run)[int(joint)].tolist()


@pytest.mark.parametrize("suffix", [*FORMATS])
def test_export_run__a_run_without_beams(tmp_path, suffix):
    from beamseg_batch.outputs import read_run, write_run
    from tests.outputs.conftest import build_empty_flight

    write_run(build_empty_flight(), tmp_path / "out")
    path = tmp_path / f"s{suffix}"
    if suffix in (".glb", ".obj", ".stl", ".ply", ".pcd"):
        if suffix == ".pcd":
            pytest.importorskip("open3d", exc_type=ImportError)
        with pytest.raises(RunError, match=rf"holds no (beams|points), and a {suffix} file"):
            export_run(read_run(tmp_path / "out"), path)
        assert not path.exists()
    else:
        assert export_run(read_run(tmp_path / "out"), path, origin=ORIGIN).count == 0
        assert path.is_file()
