"""Which file holds what of a run, and writing it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from beamseg_batch.errors import ConfigError, OutputError
from beamseg_batch.export.content import Content, What
from beamseg_batch.export.geodesy import Origin
from beamseg_batch.geometry import FloatArray
from beamseg_batch.outputs import Run
from beamseg_batch.outputs.single_file import staged_file

__all__ = ["FORMATS", "Exported", "Up", "export_run"]

Up = Literal["z", "y"]
"""Axis of a mesh file that points up."""

_TURNS: Mapping[str, FloatArray] = {
    "z": np.eye(3),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
}


@dataclass(frozen=True)
class Format:
    """A kind of file.

    Attributes
    ----------
    meaning : str
        For people.
    whats : tuple of What
        What it can hold; the first is taken if nothing is asked for.
    is_mesh : bool
        Whether its axes may be turned.
    """

    meaning: str
    whats: tuple[What, ...]
    is_mesh: bool = False


FORMATS: Mapping[str, Format] = {
    ".dxf": Format("CAD drawing: axes, solids on layers by section, joints", ("members", "beams")),
    ".ifc": Format("IFC4 building model with profiles and sigmas", ("members", "beams")),
    ".glb": Format("meshes for viewers (glTF)", ("beams", "members"), True),
    ".obj": Format("meshes (Wavefront)", ("beams", "members"), True),
    ".stl": Format("one mesh, for printing and simulation", ("beams", "members"), True),
    ".ply": Format("one mesh, or points", ("beams", "members", "points"), True),
    ".pcd": Format("points, with the number of their beam", ("points",)),
    ".laz": Format("points, with the number of their beam", ("points",)),
    ".las": Format("the same, not compressed", ("points",)),
    ".geojson": Format("map of members and joints; needs --origin", ("members", "beams")),
    ".parquet": Format("table", ("beams", "members", "joints", "points")),
    ".json": Format("structural graph for frame analysis", ("members",)),
}
"""Files that can be written, by ending."""


@dataclass(frozen=True)
class Exported:
    """What was written.

    Attributes
    ----------
    path : Path
    what : What
    count : int
        How many of them.
    """

    path: Path
    what: What
    count: int


def export_run(
    run: Run,
    path: Path,
    what: What | None = None,
    *,
    origin: Origin | None = None,
    up: Up = "z",
    overwrite: bool = False,
) -> Exported:
    """Write what a run found into a file for another program.

    Parameters
    ----------
    run : Run
        As `beamseg_batch.outputs.read_run` gives it.
    path : Path
        Its ending tells the kind of file, as in `FORMATS`.
    what : What, optional
        The first that the kind of file can hold, without it.
    origin : Origin, optional
        Where the world frame lies on the earth; a map needs it.
    up : Up, optional
        Which axis of a mesh points up. In the world frame, and so in all other files, it
        is z.
    overwrite : bool, optional
        Whether a file of that name is replaced.

    Returns
    -------
    Exported

    Raises
    ------
    ConfigError
        If the ending is of no kind, or the kind cannot hold what is asked for.
    MissingExtraError, Open3DMissingError
        If a library that writes such files is missing.
    RunError
        If a file of the run cannot be read.
    OutputError
        If the file is there already, is one of the run's own, or cannot be written.

    Notes
    -----
    Metres, world frame.
    """
    suffix = path.suffix.lower()
    content = Content(run, _what(path, what, up), origin, _TURNS[up])
    if suffix == ".geojson" and origin is None:
        raise ConfigError(
            f"{path}: a map needs to know where the world frame lies: "
            "--origin LAT,LON[,ALT[,HEADING]]"
        )
    if path.name in run.summary.get("files", ()) and path.parent.resolve() == run.folder.resolve():
        raise OutputError(f"{path} is a file of the run itself; choose another name")
    write = _writer(suffix, content.what)
    with staged_file(path, overwrite=overwrite) as staged:
        count = write(content, staged)
    return Exported(path, content.what, count)


def _what(path: Path, what: What | None, up: Up) -> What:
    suffix = path.suffix.lower()
    format_ = FORMATS.get(suffix)
    if format_ is None:
        raise ConfigError(
            f"{path}: the ending {path.suffix!r} is of no kind that can be written; there are: "
            f"{', '.join(FORMATS)}"
        )
    chosen = what or format_.whats[0]
    if chosen not in format_.whats:
        raise ConfigError(f"a {suffix} file holds {' or '.join(format_.whats)}, not {what}")
    if up != "z" and (not format_.is_mesh or chosen == "points"):
        meshes = ", ".join(name for name, one in FORMATS.items() if one.is_mesh)
        raise ConfigError(f"the axes of meshes alone can be turned ({meshes}); leave --up out")
    return chosen


def _writer(suffix: str, what: What) -> Callable[[Content, Path], int]:
    """Give what writes a kind of file; its libraries are loaded when it does."""
    from beamseg_batch.export import dxf, geojson, graph, ifc, mesh_files, parquet, point_files

    if suffix == ".ply" and what == "points":
        return point_files.write_open3d
    writers: Mapping[str, Callable[[Content, Path], int]] = {
        ".dxf": dxf.write_dxf,
        ".ifc": ifc.write_ifc,
        ".glb": mesh_files.write_scene,
        ".obj": mesh_files.write_scene,
        ".stl": mesh_files.write_mesh,
        ".ply": mesh_files.write_mesh,
        ".pcd": point_files.write_open3d,
        ".laz": point_files.write_las,
        ".las": point_files.write_las,
        ".geojson": geojson.write_geojson,
        ".parquet": parquet.write_parquet,
        ".json": graph.write_graph,
    }
    return writers[suffix]
