"""Beams out of recorded drone flights with a ToF camera.

The method in three lines::

    from beamseg_batch import load_config, open_recording, process_flight, write_run
    result = process_flight(open_recording("flight.mcap"), load_config("precise"))
    write_run(result, Path("out"))

Importing this package costs nothing: each name is loaded when it is first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from beamseg_batch.config import load_config
    from beamseg_batch.outputs import read_run, write_run
    from beamseg_batch.pipeline import process_flight
    from beamseg_batch.recording import open_flight, open_recording

    __version__: str

__all__ = [
    "__version__",
    "load_config",
    "open_flight",
    "open_recording",
    "process_flight",
    "read_run",
    "write_run",
]

_HOMES = {
    "load_config": "beamseg_batch.config",
    "open_flight": "beamseg_batch.recording",
    "open_recording": "beamseg_batch.recording",
    "process_flight": "beamseg_batch.pipeline",
    "read_run": "beamseg_batch.outputs",
    "write_run": "beamseg_batch.outputs",
}
"""Where each public name lives."""


def __getattr__(name: str) -> Any:
    if name == "__version__":
        value: Any = _installed_version()
    elif name in _HOMES:
        value = getattr(importlib.import_module(_HOMES[name]), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def _installed_version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("beamseg-batch")
    except PackageNotFoundError:  # a source folder on the path, not an installation
        return "0+unknown"
