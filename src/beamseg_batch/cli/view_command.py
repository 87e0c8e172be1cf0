"""`beamseg view`: a finished run in 3-D."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from beamseg_batch.cli.console import note, say
from beamseg_batch.cli.measuring import run_path
from beamseg_batch.errors import RunError

if TYPE_CHECKING:
    from beamseg_batch.outputs import Run

__all__ = ["command"]


@click.command("view")
@click.argument("run", type=run_path)
@click.option(
    "--screenshot",
    metavar="FILE",
    type=click.Path(readable=False, path_type=Path),
    help="Save a picture, FILE.png, instead of opening a window; no display is needed.",
)
@click.option("--overwrite", is_flag=True, help="Replace a picture of that name.")
def command(run: Path, screenshot: Path | None, overwrite: bool) -> None:
    """Look at a run in 3-D: beams, joints, the thinned cloud and the drone's path.

    RUN is a folder that 'beamseg run' wrote. Beams are coloured by their cross-section,
    joints are red. In the window: drag to turn, scroll to zoom, H for all keys, Q to leave.
    Where no window can open, the report is opened instead.

    \b
    Examples:
      beamseg view out
      beamseg view out --screenshot structure.png
    """  # noqa: D301 (click reads the backspace)
    from beamseg_batch.extras import Open3DMissingError
    from beamseg_batch.outputs import read_run
    from beamseg_batch.viewing import NoPictureError, has_display, save_picture, show_window

    found = read_run(run)
    if screenshot is not None:
        save_picture(found, screenshot, overwrite=overwrite)
        say(str(screenshot))
        return
    if not has_display():
        _open_report(found, "there is no display to open a window on")
        return
    try:
        show_window(found)
    except (NoPictureError, Open3DMissingError) as error:
        _open_report(found, str(error))


def _open_report(run: Run, why: str) -> None:
    """Show the report, which needs nothing but a browser; tell where it is in any case."""
    from beamseg_batch.outputs.run_folder import REPORT_FILE
    from beamseg_batch.viewing import has_display

    report = run.folder / REPORT_FILE
    if not report.is_file():
        raise RunError(f"{why}; {run.folder} holds no {REPORT_FILE} either")
    note(f"{why}; the report shows the structure too")
    if has_display() or os.environ.get("BROWSER"):
        click.launch(str(report))
    say(str(report))
