"""Options that several commands share, and the configuration they make."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from beamseg_batch.errors import ConfigError

if TYPE_CHECKING:
    from beamseg_batch.config import RunConfig

__all__ = [
    "ConfigOptions",
    "config_options",
    "parse_extrinsic",
    "recording_argument",
    "verbosity_options",
]

F = TypeVar("F", bound=Callable[..., Any])

recording_argument = click.argument(
    "recording", nargs=-1, required=True, type=click.Path(readable=False, path_type=Path)
)

_CONFIG_OPTIONS = (
    click.option(
        "--profile",
        metavar="NAME",
        help="Configuration to start from: 'precise' (default) or 'report', the published method.",
    ),
    click.option(
        "-c",
        "--config",
        "config_file",
        metavar="FILE",
        type=click.Path(readable=False, path_type=Path),
        help="YAML file that overlays the profile; the original node's files work too.",
    ),
    click.option(
        "--set",
        "settings",
        metavar="KEY=VALUE",
        multiple=True,
        help="Override one value, such as detection.hough.granularity=5. Repeatable.",
    ),
    click.option("--cloud-topic", metavar="TOPIC", help="Topic of the point clouds."),
    click.option("--pose-topic", metavar="TOPIC", help="Topic of the drone's poses."),
    click.option(
        "--extrinsic",
        metavar="X,Y,Z[,R,P,Y]",
        help="Where the camera sits on the drone: metres, then roll, pitch, yaw in degrees.",
    ),
)


@dataclass(frozen=True)
class ConfigOptions:
    """The options of a command that make its configuration."""

    profile: str | None
    config_file: Path | None
    settings: tuple[str, ...]
    cloud_topic: str | None
    pose_topic: str | None
    extrinsic: str | None

    def load(self) -> RunConfig:
        """Load the configuration: profile, file, settings, then the named options.

        Returns
        -------
        RunConfig

        Raises
        ------
        ConfigError
            If anything of it is not valid.
        """
        from beamseg_batch.config import load_config

        return load_config(self.profile, self.config_file, [*self.settings, *self._overrides()])

    def _overrides(self) -> list[str]:
        overrides = []
        if self.cloud_topic is not None:
            overrides.append(f"recording.cloud_topic={json.dumps(self.cloud_topic)}")
        if self.pose_topic is not None:
            overrides.append(f"recording.pose_topic={json.dumps(self.pose_topic)}")
        if self.extrinsic is not None:
            overrides.append(f"sensor.extrinsic={json.dumps(parse_extrinsic(self.extrinsic))}")
        return overrides


def config_options(function: F) -> F:
    """Give a command the options of `ConfigOptions`, passed to it as `options`."""
    import functools

    @functools.wraps(function)
    def wrapped(**arguments: Any) -> Any:
        names = ConfigOptions.__dataclass_fields__
        options = ConfigOptions(**{name: arguments.pop(name) for name in names})
        return function(options=options, **arguments)

    result: Any = wrapped
    for option in reversed(_CONFIG_OPTIONS):
        result = option(result)
    decorated: F = result
    return decorated


def verbosity_options(function: F) -> F:
    """Give a command ``-v`` and ``-q``, passed to it as `verbose` and `quiet`."""
    function = click.option("-q", "--quiet", is_flag=True, help="Show errors only.")(function)
    return click.option("-v", "--verbose", is_flag=True, help="Show details.")(function)


def parse_extrinsic(text: str) -> dict[str, Sequence[float]]:
    """Read where the camera sits, as ``--extrinsic`` takes it; ConfigError if it is not so."""
    parts = text.split(",")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) not in (3, 6) or not all(map(math.isfinite, numbers)):
        raise ConfigError(
            f"--extrinsic {text!r}: write 3 or 6 numbers, x,y,z in metres and roll,pitch,yaw "
            "in degrees, for example 0.071,0.011,0.04"
        )
    return {"translation": numbers[:3], "rotation_rpy_deg": numbers[3:] or [0.0, 0.0, 0.0]}
