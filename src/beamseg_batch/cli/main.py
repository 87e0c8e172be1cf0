"""The command `beamseg`."""

from __future__ import annotations

import errno
import gc
import importlib
import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import click

from beamseg_batch.cli.console import FAILED, INTERRUPTED, complain, note
from beamseg_batch.errors import BeamsegError

__all__ = ["beamseg", "main"]

COMMANDS: Mapping[str, str] = {
    "run": "Turn a recorded flight into a measured model of the structure.",
    "info": "Show what a recording holds and how it would be used.",
    "config": "Show, check and document the configuration.",
    "simulate": "Fly a camera through a known world: a recording with its truth.",
    "evaluate": "Measure a run against the truth.",
    "explain": "Say why there is, or is not, a beam at a place.",
    "compare": "Hold two runs against each other.",
    "export": "Write a run as CAD, BIM, meshes, points, a map or a table.",
    "view": "Look at a run in 3-D.",
}
"""Commands, in the order of `--help`, with the line it shows for each."""


class _Commands(click.Group):
    """Imports a command only when it is called, so that `--help` is quick."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"beamseg_batch.cli.{cmd_name}_command")
        command: click.Command = module.command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and not args[0].startswith("-") and args[0] not in COMMANDS:
            raise click.UsageError(
                f"no such command {args[0]!r}; there are: {', '.join(COMMANDS)}", ctx
            )
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except BeamsegError as error:
            complain(error)
            ctx.exit(error.exit_code)
        except OSError as error:
            if error.errno == errno.EPIPE:  # the reader of stdout has gone; click ends quietly
                raise
            where = f"{error.filename}: " if error.filename else ""
            complain(f"{where}{error.strerror or error}")
            ctx.exit(FAILED)
        except KeyboardInterrupt:
            note("interrupted")
            ctx.exit(INTERRUPTED)


def _print_version(ctx: click.Context, _parameter: click.Parameter, value: bool) -> None:
    if value:
        from beamseg_batch import __version__

        click.echo(f"beamseg {__version__}")
        ctx.exit()


@click.group(
    cls=_Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_version,
    help="Show the version and exit.",
)
def beamseg() -> None:
    """Turn recorded drone flights into measured models of steel structures.

    A flight is a ROS 1 bag, a ROS 2 bag or an MCAP file that holds the point clouds of a
    time-of-flight camera and the poses of the drone. The quickest start:

    \b
        beamseg info flight.mcap      # is everything there?
        beamseg run flight.mcap       # beams, intersections and a report

    Exit codes: 0 done, 1 the data cannot be processed, 2 wrong usage or configuration,
    3 a gate failed, 130 interrupted.
    """  # noqa: D301 (click reads the backspace)


def main() -> None:
    """Run the command line; the entry point of the installed command."""
    gc.disable()  # until a command works: there is nothing to collect among fresh imports
    try:
        beamseg(prog_name="beamseg")
    except SystemExit as leaving:
        _leave(leaving.code if isinstance(leaving.code, int) else FAILED)


def _leave(code: int) -> None:
    """Leave without taking the interpreter apart, which takes as long as many scans do."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # its reader has gone, or it is closed
            if stream is not None:
                stream.flush()
    os._exit(code)
