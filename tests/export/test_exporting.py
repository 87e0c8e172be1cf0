"""What is refused, and that nothing half is left."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from beamseg_batch.errors import ConfigError, MissingExtraError, OutputError, RunError
from beamseg_batch.export import FORMATS, Origin, export_run, mesh_files
from beamseg_batch.extras import Open3DMissingError

ORIGIN = Origin(46.0, 6.0)


@pytest.mark.parametrize(
    ("name", "options", "complaint"),
    [
        ("s.txt", {}, r"the ending '\.txt' is of no kind .*there are: \.dxf, \.ifc,"),
        ("s", {}, "the ending '' is of no kind"),
        ("s.dxf", {"what": "points"}, r"a \.dxf file holds members or beams, not points"),
        ("s.json", {"what": "beams"}, r"a \.json file holds members, not beams"),
        ("s.dxf", {"up": "y"}, r"the axes of meshes alone can be turned \(\.glb,"),
        ("s.ply", {"up": "y", "what": "points"}, "the axes of meshes alone can be turned"),
        ("s.geojson", {}, "where the world frame lies: --origin"),
    ],
)
def test_export_run__refuses_what_cannot_be(run, tmp_path, name, options, complaint):
    with pytest.raises(ConfigError, match=complaint):
        export_run(run, tmp_path / name, **options)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("suffix", "library"),
    [
        (".dxf", "ezdxf"),
        (".ifc", "ifcopenshell"),
        (".glb", "trimesh"),
        (".obj", "trimesh"),
        (".stl", "trimesh"),
        (".ply", "trimesh"),
        (".laz", "laspy"),
        (".laz", "lazrs"),
        (".las", "laspy"),
        (".parquet", "pyarrow"),
    ],
)
def test_export_run__names_the_extra_that_is_missing(run, tmp_path, monkeypatch, suffix, library):
    import laspy  # noqa: F401 (it remembers from its import on whether lazrs is there)

    monkeypatch.setitem(sys.modules, library, None)
    expected = rf"a \{suffix} file needs the library {library}.*'beamseg-batch\[export\]'"
    with pytest.raises(MissingExtraError, match=expected) as caught:
        export_run(run, tmp_path / f"s{suffix}")
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", [".geojson", ".json"])
def test_export_run__some_kinds_need_no_extra(run, tmp_path, monkeypatch, suffix):
    for library in ("ezdxf", "ifcopenshell", "trimesh", "laspy", "lazrs", "pyarrow", "open3d"):
        monkeypatch.setitem(sys.modules, library, None)
    assert export_run(run, tmp_path / f"s{suffix}", origin=ORIGIN).count == 9


def test_export_run__says_how_to_get_open3d(run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(Open3DMissingError, match=r"a \.pcd file of points needs Open3D.*apt-get"):
        export_run(run, tmp_path / "s.pcd")


def test_export_run__replaces_only_when_asked(run, tmp_path):
    path = tmp_path / "s.json"
    path.write_text("mine")
    with pytest.raises(OutputError, match="exists already; use --overwrite"):
        export_run(run, path)
    assert path.read_text() == "mine"
    export_run(run, path, overwrite=True)
    assert path.read_text() != "mine"


def test_export_run__never_replaces_a_file_of_the_run(run):
    before = (run.folder / "summary.json").read_bytes()
    with pytest.raises(OutputError, match="is a file of the run itself"):
        export_run(run, run.folder / "summary.json", overwrite=True)
    assert (run.folder / "summary.json").read_bytes() == before


def test_export_run__leaves_nothing_half(run, tmp_path, monkeypatch):
    def full(bar):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(mesh_files, "mesh_of", full)
    path = tmp_path / "new" / "s.glb"
    with pytest.raises(OutputError, match=r"s\.glb: cannot be written: No space left"):
        export_run(run, path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("table", "column", "value", "complaint"),
    [
        ("members", "segment", 99, "column segment names a row that segments.csv does not have"),
        ("members", "joint_1", 99, "column joint_1 names a row that joints.csv does not have"),
        ("segments", "x1", np.nan, "beam 0 has no ends or no radius"),
        ("segments", "radius", 0.0, "beam 0 has no ends or no radius"),
    ],
)
def test_export_run__tables_that_contradict(run, tmp_path, table, column, value, complaint):
    values = run.columns[table][column].copy()
    values[0] = value
    columns = {**run.columns, table: {**run.columns[table], column: values}}
    broken = replace(run, columns=columns)
    with pytest.raises(RunError, match=complaint):
        export_run(broken, tmp_path / "s.json" if table == "members" else tmp_path / "s.glb")


def test_formats__are_those_of_the_help_and_the_page():
    from pathlib import Path

    from beamseg_batch.cli.export_command import command

    page = (Path(__file__).parents[2] / "docs" / "export.md").read_text(encoding="utf-8")
    for suffix in FORMATS:
        assert suffix in (command.help or "")
        assert f"`{suffix}`" in page
