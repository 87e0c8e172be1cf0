"""A run on disk: written from a flight's result, and read back."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamseg_batch.config import RunConfig, config_yaml
from beamseg_batch.errors import RunError
from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import FlightResult, Intersection, Joint, Member, Segment
from beamseg_batch.outputs.candidates_file import (
    CANDIDATES_FILE,
    candidates_parquet,
    check_parquet,
    read_candidates,
)
from beamseg_batch.outputs.columns import (
    candidate_columns,
    intersection_columns,
    intersections_from_columns,
    joint_columns,
    joints_from_columns,
    member_columns,
    members_from_columns,
    processing_time_columns,
    segment_columns,
    segments_from_columns,
    time_origin_ns,
)
from beamseg_batch.outputs.fly_again import FlightPlan, fly_again_columns, plan_flight
from beamseg_batch.outputs.folder import MANIFEST, OutputFolder, encoded
from beamseg_batch.outputs.structure_file import (
    STRUCTURE_FILE,
    Arrays,
    read_structure,
    structure_arrays,
    structure_npz,
)
from beamseg_batch.outputs.summary import (
    SCHEMA_VERSION,
    results_sha256,
    summarise,
    summary_json,
)
from beamseg_batch.tables import (
    FLY_AGAIN,
    INTERSECTIONS,
    JOINTS,
    MEMBERS,
    PROCESSING_TIME,
    SEGMENTS,
    TABLES,
    ColumnArrays,
    Table,
)

if TYPE_CHECKING:
    import pandas as pd

    from beamseg_batch.pages.rendering import Section

__all__ = ["Run", "WrittenRun", "check_output", "planned_files", "read_run", "write_run"]

CONFIG_FILE = "config.yaml"
REPORT_FILE = "report.html"


@dataclass(frozen=True)
class WrittenRun:
    """What `write_run` left on disk.

    Attributes
    ----------
    folder : Path
        As it was given.
    files : tuple of str
        Names of the files, sorted.
    summary : mapping
        The content of `summary.json`.
    """

    folder: Path
    files: tuple[str, ...]
    summary: Mapping[str, Any]

    @property
    def report(self) -> Path | None:
        """Path of the report, or None when none was asked for."""
        return self.folder / REPORT_FILE if REPORT_FILE in self.files else None


@dataclass(frozen=True, eq=False)
class Run:
    """A finished run, read from its folder.

    Attributes
    ----------
    folder : Path
    summary : dict
        The content of `summary.json`.
    columns : mapping of str to columns
        The tables as arrays by column name, under `segments`, `intersections`, `joints`,
        `members` and `processing_time`.

    Notes
    -----
    `structure.npz` is read when it is first asked for: by `structure`, or for the
    covariances of `segments` and `joints`. `RunError` says what is wrong with it.
    """

    folder: Path
    summary: dict[str, Any]
    columns: Mapping[str, ColumnArrays]

    @cached_property
    def segments(self) -> tuple[Segment, ...]:
        """The beams as objects, without their points."""
        origin = int(self.summary["recording"]["time_origin_ns"])
        covariances = self._covariances("segment_covariance", SEGMENTS)
        return segments_from_columns(self.columns[SEGMENTS.name], origin, covariances)

    @cached_property
    def intersections(self) -> tuple[Intersection, ...]:
        """The intersections as objects."""
        return intersections_from_columns(self.columns[INTERSECTIONS.name])

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """The joints as objects."""
        covariances = self._covariances("joint_covariance", JOINTS)
        try:
            return joints_from_columns(self.columns[JOINTS.name], self.segments, covariances)
        except (ValueError, IndexError) as error:
            file = self.folder / JOINTS.file_name
            raise RunError(
                f"{file}: column segments does not name segments of {SEGMENTS.file_name}: {error}"
            ) from error

    @cached_property
    def members(self) -> tuple[Member, ...]:
        """The members as objects."""
        return members_from_columns(self.columns[MEMBERS.name])

    @cached_property
    def structure(self) -> Arrays:
        """The arrays of `structure.npz`, by name."""
        return read_structure(self.folder / STRUCTURE_FILE)

    @cached_property
    def candidates(self) -> ColumnArrays | None:
        """What might have been a beam, as arrays by column name; None where it was not kept."""
        file = self.folder / CANDIDATES_FILE
        return read_candidates(file) if CANDIDATES_FILE in self._files else None

    @property
    def _files(self) -> list[str]:
        files = self.summary.get("files")
        return files if isinstance(files, list) else []

    def _covariances(self, name: str, table: Table) -> FloatArray:
        """Covariances of the rows of a table."""
        covariances: FloatArray = self.structure[name]
        rows = len(self.columns[table.name][table.column_names[0]])
        if len(covariances) != rows:
            raise RunError(
                f"{self.folder / STRUCTURE_FILE}: {name} has {len(covariances)} entries, but "
                f"{table.file_name} {rows} rows: the two are not of the same run"
            )
        return covariances

    @cached_property
    def tables(self) -> dict[str, pd.DataFrame]:
        """The tables as DataFrames, by the name of the file without `.csv`."""
        import pandas as pd

        return {name: pd.DataFrame(columns) for name, columns in self.columns.items()}


def planned_files(config: RunConfig) -> tuple[str, ...]:
    """Names of the files that a run with this configuration may write, sorted.

    Parameters
    ----------
    config : RunConfig

    Returns
    -------
    tuple of str
    """
    tables = (*TABLES, FLY_AGAIN)
    names = [*(table.file_name for table in tables), STRUCTURE_FILE, CONFIG_FILE, MANIFEST]
    names += [REPORT_FILE] * config.outputs.report + [CANDIDATES_FILE] * config.outputs.candidates
    return tuple(sorted(names))


def check_output(path: Path, config: RunConfig, *, overwrite: bool = False) -> None:
    """Say whether a run could be written, before the flight is processed.

    Parameters
    ----------
    path : Path
        The output folder.
    config : RunConfig
    overwrite : bool

    Raises
    ------
    OutputError
        As `write_run` would, except for what changes until then.
    MissingExtraError
        If candidates are to be kept and the library for it is not installed.
    """
    if config.outputs.candidates:
        check_parquet()
    OutputFolder.check(path, overwrite=overwrite, names=planned_files(config))


def write_run(
    result: FlightResult,
    path: Path,
    *,
    overwrite: bool = False,
    more: Callable[[Path], Sequence[Section]] = lambda _: (),
) -> WrittenRun:
    """Write all files of a run, or none.

    Parameters
    ----------
    result : FlightResult
    path : Path
        The output folder; it and its parents are created when they are missing.
    overwrite : bool
        Whether the files of an earlier run are replaced.
    more : callable, optional
        Given the folder in which the tables stand before they are put in place, it returns
        what else is to be told in the report.

    Returns
    -------
    WrittenRun

    Raises
    ------
    OutputError
        If the folder is occupied or cannot be written.
    MissingExtraError
        If candidates are to be kept and the library for it is not installed.
    """
    plan = plan_flight(result)
    contents = _table_files(result, plan)
    contents[STRUCTURE_FILE] = structure_npz(structure_arrays(result))
    contents[CONFIG_FILE] = encoded(config_yaml(result.config))
    if result.config.outputs.candidates:
        contents[CANDIDATES_FILE] = candidates_parquet(candidate_columns(result.candidates or ()))
    left_out = {FLY_AGAIN.file_name} - set(contents)
    files = tuple(name for name in planned_files(result.config) if name not in left_out)
    summary = summarise(result, files, results_sha256(contents))
    contents[MANIFEST] = encoded(summary_json(summary))
    with OutputFolder(path, overwrite=overwrite) as folder:
        for name, content in contents.items():
            folder.write(name, content)
        if result.config.outputs.report:
            from beamseg_batch.outputs.report import render_report

            report = render_report(result, summary, plan, more(folder.staging))
            folder.write(REPORT_FILE, encoded(report))
    return WrittenRun(path, files, summary)


def read_run(folder: Path) -> Run:
    """Read a finished run.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    Run

    Raises
    ------
    RunError
        If the folder holds no run, or one that cannot be read.
    """
    summary = _read_summary(Path(folder))
    columns = {table.name: _read_table(Path(folder), table) for table in TABLES}
    return Run(Path(folder), summary, columns)


def _table_files(result: FlightResult, plan: FlightPlan) -> dict[str, bytes]:
    columns = {
        SEGMENTS: segment_columns(result.segments, time_origin_ns(result)),
        INTERSECTIONS: intersection_columns(result.intersections),
        JOINTS: joint_columns(result.joints),
        MEMBERS: member_columns(result.members, result.segments),
        PROCESSING_TIME: processing_time_columns(result.scans),
    }
    if len(plan.waypoints):
        columns[FLY_AGAIN] = fly_again_columns(plan)
    return {table.file_name: encoded(table.encode(values)) for table, values in columns.items()}


def _read_summary(folder: Path) -> dict[str, Any]:
    file = folder / MANIFEST
    if not file.is_file():
        what = "holds no run" if folder.is_dir() else "is no folder of a run"
        raise RunError(f"{folder} {what}: there is no {MANIFEST}")
    try:
        summary = json.loads(_read_text(file))
    except (ValueError, RecursionError) as error:
        raise RunError(f"{file}: is not valid JSON: {error}") from error
    version = summary.get("schema_version") if isinstance(summary, dict) else None
    if not isinstance(version, int):
        raise RunError(f"{file}: is not the summary of a run: it has no schema_version")
    if version > SCHEMA_VERSION:
        raise RunError(
            f"{file}: has schema_version {version}, this version reads up to {SCHEMA_VERSION}; "
            "update beamseg-batch"
        )
    if not isinstance(_nested(summary, "recording", "time_origin_ns"), int):
        raise RunError(f"{file}: has no recording.time_origin_ns")
    assert isinstance(summary, dict)
    return summary


def _nested(tree: Any, *keys: str) -> Any:
    for key in keys:
        tree = tree.get(key) if isinstance(tree, dict) else None
    return tree


def _read_table(folder: Path, table: Table) -> ColumnArrays:
    file = folder / table.file_name
    return table.decode(_read_text(file), where=str(file))


def _read_text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except OSError as error:
        raise RunError(f"{file}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise RunError(f"{file}: is not UTF-8 text: {error.reason}") from error
