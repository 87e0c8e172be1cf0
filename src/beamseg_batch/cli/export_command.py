"""`beamseg export`: a finished run -> a file for another program."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from beamseg_batch.cli.console import begin_work, say
from beamseg_batch.cli.measuring import run_path

if TYPE_CHECKING:
    from beamseg_batch.export import Origin
    from beamseg_batch.export.content import What
    from beamseg_batch.export.exporting import Up

__all__ = ["command"]

_WHATS = ("beams", "members", "joints", "points")


@click.command("export")
@click.argument("run", type=run_path)
@click.option(
    "--to",
    "path",
    metavar="FILE",
    required=True,
    type=click.Path(readable=False, path_type=Path),
    help="The file; its ending tells the kind.",
)
@click.option(
    "--what",
    type=click.Choice(_WHATS),
    help="Whole beams, members (their parts between joints), joints, or the points on the beams; "
    "what the kind of file is mostly used for, without it.",
)
@click.option(
    "--origin",
    metavar="LAT,LON[,ALT[,HEADING]]",
    help="Where the world frame lies: degrees, metres above the ellipsoid, and the degrees by "
    "which its y axis is turned from north, clockwise. For .geojson.",
)
@click.option(
    "--up",
    type=click.Choice(("z", "y")),
    default="z",
    show_default=True,
    help="Axis of a mesh that points up: z as in the world frame, y as most viewers of .glb and "
    ".obj take it.",
)
@click.option("--overwrite", is_flag=True, help="Replace a file of that name.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")
def command(
    run: Path,
    path: Path,
    what: What | None,
    origin: str | None,
    up: Up,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Write a run as CAD, BIM, meshes, points, a map or a table.

    RUN is a folder that 'beamseg run' wrote. All coordinates are metres in the world frame,
    z up, but those of a map.

    \b
      .dxf      CAD: axes as lines, solids on layers by section, joints as points
      .ifc      BIM: IFC4 members with profiles, and how well each is known
      .json     structural graph, for frame analysis: nodes, sections, members
      .glb .obj .stl .ply        meshes of the beams
      .pcd .laz .las .ply        points on the beams (.ply: with --what points)
      .geojson  map of members and joints; needs --origin
      .parquet  the table of the beams, members, joints or points

    A CAD or BIM file holds members, cut at the joints, as a structural engineer needs them;
    --what beams writes each beam in one piece.

    \b
    Examples:
      beamseg export out --to structure.dxf
      beamseg export out --to structure.ifc --what beams
      beamseg export out --to structure.glb --up y
      beamseg export out --to points.ply --what points
      beamseg export out --to map.geojson --origin 46.5191,6.5668,400,12.5

    Most kinds need libraries of the extra 'export': pip install 'beamseg-batch[export]'
    """  # noqa: D301 (click reads the backspace)
    place = None if origin is None else parse_origin(origin)

    from beamseg_batch.export import export_run
    from beamseg_batch.outputs import read_run

    begin_work()
    written = export_run(read_run(run), path, what, origin=place, up=up, overwrite=overwrite)
    if not quiet:
        say(f"{written.count} {written.what} in {written.path}")


def parse_origin(text: str) -> Origin:
    """Read LAT,LON[,ALT[,HEADING]].

    Parameters
    ----------
    text : str

    Returns
    -------
    Origin

    Raises
    ------
    ConfigError
        If it is not of that form, or no place on the earth.
    """
    from beamseg_batch.errors import ConfigError
    from beamseg_batch.export import Origin

    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if not 2 <= len(numbers) <= 4 or not all(map(math.isfinite, numbers)):
        raise ConfigError(
            f"--origin {text!r}: write LAT,LON[,ALT[,HEADING]], for example 46.5191,6.5668,400,12.5"
        )
    if abs(numbers[0]) > 90.0 or abs(numbers[1]) > 360.0:
        raise ConfigError(
            f"--origin {text!r}: the latitude is at most 90 degrees, the longitude at most 360"
        )
    return Origin(*numbers)
