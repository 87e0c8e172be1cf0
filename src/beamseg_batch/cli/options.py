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
        "--poses",
        "pose_file",
        metavar="FILE",
        help="Take the poses from this .tum or .csv file beside the recording.",
    ),
    click.option("--world-frame", metavar="FRAME", help="The fixed frame in the transform tree."),
    click.option("--body-frame", metavar="FRAME", help="The drone's frame in the transform tree."),
    click.option(
        "--time-source",
        metavar="header|log",
        help="Stamps to match by: of the message headers (default), or of the recorder.",
    ),
    click.option("--time-offset", metavar="S", help="Seconds to add to the stamps of the clouds."),
    click.option("--start", metavar="S", help="Leave out the first S seconds of the recording."),
    click.option("--duration", metavar="S", help="Use only S seconds from there on."),
    click.option("--every", metavar="N", help="Use every N-th cloud only."),
    click.option("--max-scans", metavar="N", help="Use at most N clouds."),
    click.option("--strict", is_flag=True, help="Refuse a damaged recording."),
    click.option(
        "--sensor",
        "sensor_model",
        metavar="NAME|FILE",
        help="What the camera is known to be, such as voxl_tof; else it is measured.",
    ),
    click.option(
        "--extrinsic",
        metavar="X,Y,Z[,R,P,Y]",
        help="Where the camera sits on the drone: metres, then roll, pitch, yaw in degrees.",
    ),
)

_RECORDING_TEXTS = (
    "cloud_topic", "pose_topic", "pose_file", "world_frame", "body_frame", "time_source",
)  # fmt: skip
"""Options that are keys of the configuration's `recording` branch, and hold text."""
_RECORDING_NUMBERS = {
    "time_offset": "time_offset_s",
    "start": "start_s",
    "duration": "duration_s",
    "every": "every",
    "max_scans": "max_scans",
}
"""Options that hold a number, with their keys."""


@dataclass(frozen=True)
class ConfigOptions:
    """The options of a command that make its configuration."""

    profile: str | None
    config_file: Path | None
    settings: tuple[str, ...]
    cloud_topic: str | None
    pose_topic: str | None
    pose_file: str | None
    world_frame: str | None
    body_frame: str | None
    time_source: str | None
    time_offset: str | None
    start: str | None
    duration: str | None
    every: str | None
    max_scans: str | None
    strict: bool
    sensor_model: str | None
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
        overrides = [
            f"recording.{key}={json.dumps(value)}"
            for key in _RECORDING_TEXTS
            if (value := getattr(self, key)) is not None
        ]
        for option, key in _RECORDING_NUMBERS.items():
            value = getattr(self, option)
            if value is not None:
                overrides.append(f"recording.{key}={_number(option, value)}")
        if self.strict:
            overrides.append("recording.strict=true")
        if self.sensor_model is not None:
            overrides.append(f"sensor.model={json.dumps(self.sensor_model)}")
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


def _number(option: str, text: str) -> str:
    """Text of a number as YAML and JSON write it; its range is the configuration's affair."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ConfigError(f"--{option.replace('_', '-')} {text!r}: is not a number")
    return str(int(number)) if number.is_integer() else repr(number)


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
