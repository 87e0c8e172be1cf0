"""Structure to files: tables, summary and report of a run."""

from __future__ import annotations

from beamseg_batch.outputs.folder import OutputFolder, partial_path
from beamseg_batch.outputs.run_folder import (
    Run,
    WrittenRun,
    check_output,
    planned_files,
    read_run,
    write_run,
)
from beamseg_batch.outputs.summary import sensor_text

__all__ = [
    "OutputFolder",
    "Run",
    "WrittenRun",
    "check_output",
    "partial_path",
    "planned_files",
    "read_run",
    "sensor_text",
    "write_run",
]
