"""`beamseg config`: show, check and document the configuration."""

from __future__ import annotations

import json
from pathlib import Path

import click

from beamseg_batch.cli.console import say
from beamseg_batch.cli.options import ConfigOptions, config_options

__all__ = ["command"]


@click.group("config")
def command() -> None:
    """Show, check and document the configuration.

    A configuration file holds only what differs from its profile:

    \b
        profile: precise
        filtering:
          radii: [0.10, 0.05]
    """  # noqa: D301 (click reads the backspace)


@command.command("show")
@config_options
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of YAML.")
def show(options: ConfigOptions, as_json: bool) -> None:
    """Print the configuration that a run with the same options would use."""
    from beamseg_batch.config import config_yaml

    config = options.load()
    if as_json:
        say(json.dumps(config.model_dump(mode="json"), indent=2))
    else:
        say(config_yaml(config).rstrip())


@command.command("check")
@click.argument("file", type=click.Path(readable=False, path_type=Path))
def check(file: Path) -> None:
    """Say whether FILE is valid; exit code 2 when it is not."""
    from beamseg_batch.config import load_config

    config = load_config(file=file)
    say(f"{file}: valid, overlays profile {config.profile!r}")


@command.command("schema")
def schema() -> None:
    """Print the JSON schema: every key with its range and meaning."""
    from beamseg_batch.config import RunConfig

    say(json.dumps(RunConfig.model_json_schema(), indent=2))
