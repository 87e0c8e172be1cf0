"""`beamseg run`: a recorded flight -> a folder of results."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import click

from beamseg_batch.cli.console import (
    FAILED,
    INTERRUPTED,
    ScanProgress,
    begin_work,
    note,
    say,
    stop_on_interrupt,
    warn,
)
from beamseg_batch.cli.options import (
    ConfigOptions,
    config_options,
    recording_argument,
    verbosity_options,
)
from beamseg_batch.errors import BeamsegError, OutputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from beamseg_batch.config import RunConfig
    from beamseg_batch.model import FlightResult
    from beamseg_batch.outputs import WrittenRun
    from beamseg_batch.pages.rendering import Section
    from beamseg_batch.recording import Recording

    _More: TypeAlias = Callable[[Path], list[Section]]

__all__ = ["command"]

FLY_AGAIN_FILE = "fly_again.csv"


@click.command("run")
@recording_argument
@click.option(
    "-o",
    "--output",
    metavar="FOLDER",
    type=click.Path(readable=False, path_type=Path),
    help="Where the results go; by default a folder named after the flight.",
)
@click.option("--overwrite", is_flag=True, help="Replace the files of an earlier run there.")
@click.option(
    "-j",
    "--jobs",
    metavar="N",
    type=click.IntRange(0, 256),
    default=1,
    help="Processes that share the work; 0 for all cores. The results are the same.",
)
@click.option(
    "--keep-candidates",
    "keep",
    is_flag=True,
    help="Write candidates.parquet too, for 'beamseg explain'.",
)
@click.option(
    "--record",
    metavar="FILE",
    type=click.Path(readable=False, path_type=Path),
    help="Also write a replay for RViz and Foxglove: FILE.mcap (ROS 2) or FILE.bag (ROS 1).",
)
@click.option(
    "--truth",
    metavar="PATH",
    type=click.Path(exists=True, path_type=Path),
    help="Measure the run against truth.csv, its folder or a world; the report tells how it went.",
)
@config_options
@click.option("--json", "as_json", is_flag=True, help="Print summary.json on stdout.")
@verbosity_options
def command(
    recording: tuple[Path, ...],
    output: Path | None,
    overwrite: bool,
    jobs: int,
    keep: bool,
    record: Path | None,
    truth: Path | None,
    options: ConfigOptions,
    as_json: bool,
    verbose: bool,
    quiet: bool,
) -> None:
    """Turn a recorded flight into a measured model of the structure.

    RECORDING is a ROS 1 bag, a ROS 2 bag (folder or file) or an MCAP file; several paths
    are the parts of one flight. The output folder then holds segments.csv (the beams),
    joints.csv, members.csv, intersections.csv, processing_time.csv, structure.npz,
    summary.json, config.yaml and report.html; fly_again.csv too, if some beams should be.

    \b
    Examples:
      beamseg run flight.mcap
      beamseg run flight.bag -o out --profile report
      beamseg run flight.mcap --jobs 4
      beamseg run sim/flight.mcap --truth sim/truth
      beamseg run flight.mcap --extrinsic 0.071,0.011,0.04 --set filtering.radii=[0.1]
      beamseg run flight.mcap --record views.mcap

    A replay holds the beams as markers, the filtered clouds and the transforms, with the
    flight's own stamps, to be opened beside the recording (docs/export.md).
    Ctrl-C finishes the scan in hand and leaves what is known in FOLDER.partial.
    """  # noqa: D301 (click reads the backspace)
    from beamseg_batch.parallel import load_ahead, one_thread_each

    one_thread_each()
    config = _configuration(options, keep)
    if jobs != 1:
        load_ahead()

    from beamseg_batch.outputs import check_output
    from beamseg_batch.recording import open_recording

    level = 0 if quiet else 2 if verbose else config.outputs.verbosity
    opened = open_recording(list(recording), config.recording)
    folder = _output_folder(recording, output, config)
    check_output(folder, config, overwrite=overwrite)
    if record is not None:
        _check_record(record, recording, overwrite=overwrite)
    more = _nothing if truth is None else _comparison(truth)
    if level >= 1:
        note(f"reading {', '.join(map(str, recording))} ({opened.container})")

    result, asked_to_stop = _process(opened, config, jobs, shown=level >= 1)
    _tell(result, level)
    written = _write(result, folder, overwrite, more)
    if record is not None and not asked_to_stop:
        _record(opened, result, record, jobs=jobs, overwrite=overwrite)
        if level >= 1:
            note(f"replay of {len(result.scans)} scans in {record}")
    if as_json:
        say(json.dumps(written.summary, indent=2))
    elif level >= 1:
        say(_five_lines(result, written))
    if result.interrupted:
        warn(f"incomplete: {result.warnings[-1]}; what is known is in {written.folder}")
        click.get_current_context().exit(INTERRUPTED if asked_to_stop else FAILED)


def _configuration(options: ConfigOptions, keep: bool) -> RunConfig:
    if keep:
        settings = (*options.settings, "outputs.candidates=true")
        options = dataclasses.replace(options, settings=settings)
    return options.load()


def _check_record(record: Path, recording: tuple[Path, ...], *, overwrite: bool) -> None:
    """Refuse a place for the replay before any work is done."""
    from beamseg_batch.replay import check_views

    if any(_are_same(path, place) for path in recording for place in (record, record.parent)):
        raise OutputError(f"{record} would replace or change the recording; choose another name")
    check_views(record, overwrite=overwrite)


def _process(
    recording: Recording, config: RunConfig, jobs: int, *, shown: bool
) -> tuple[FlightResult, bool]:
    """Process the flight; whether it was asked to stop, too."""
    from beamseg_batch.pipeline import process_flight

    begin_work()
    with stop_on_interrupt() as stop_asked, ScanProgress(enabled=shown) as progress:
        result = process_flight(
            recording, config, jobs=jobs, progress=progress, should_stop=stop_asked
        )
        return result, stop_asked()


def _output_folder(recording: tuple[Path, ...], output: Path | None, config: RunConfig) -> Path:
    """Folder of the results: as asked, or named after the flight.

    Results do not belong into a ROS 2 bag, which is a folder of that very name.
    """
    asked = Path(config.outputs.path) if output is None and config.outputs.path else output
    if asked is not None:
        if any(path.is_dir() and _are_same(path, asked) for path in recording):
            raise OutputError(f"{asked} is the recording itself; choose another place with -o")
        return asked
    first = recording[0].resolve()
    named = Path(first.name if first.is_dir() else first.stem)
    if named.resolve() in (first, *first.parents):
        return named.with_name(f"{named.name}_beams")
    return named


def _are_same(path: Path, other: Path) -> bool:
    try:
        return path.samefile(other)
    except (OSError, ValueError):  # there is nothing at the other path, or it is no path
        return False


def _write(result: FlightResult, folder: Path, overwrite: bool, more: _More) -> WrittenRun:
    from beamseg_batch.outputs import partial_path, write_run

    if result.interrupted:
        return write_run(result, partial_path(folder), overwrite=True, more=more)
    return write_run(result, folder, overwrite=overwrite, more=more)


def _nothing(_: Path) -> list[Section]:
    return []


def _comparison(path: Path) -> _More:
    """Read a truth at once, so that a mistake in it costs no time; compare when all is done."""
    from beamseg_batch.evaluation import evaluate, load_result, load_truth

    truth = load_truth(path)

    def compare(tables: Path) -> list[Section]:
        from beamseg_batch.evaluation.page import evaluation_section

        try:
            evaluation = evaluate(truth, load_result(tables))
        except BeamsegError as error:  # the run itself is whole
            warn(f"not measured against {path}: {error}")
            return []
        for text in evaluation.notes:
            note(text)
        return [evaluation_section(evaluation)]

    return compare


def _record(
    recording: Recording, result: FlightResult, path: Path, *, jobs: int, overwrite: bool
) -> None:
    """Write the replay in a further pass over the scans: what stands where is known now."""
    from beamseg_batch.pipeline import search_scans
    from beamseg_batch.replay import record_views

    detections = search_scans(recording, result, jobs=jobs)
    record_views(result, detections, path, overwrite=overwrite)


def _tell(result: FlightResult, level: int) -> None:
    if level >= 1:
        for text in result.recording.notes:
            note(text)
        # Why a run is incomplete stands last, and is told at the end.
        for text in result.warnings[: -1 if result.interrupted else None]:
            warn(text)
    if level >= 2:
        from beamseg_batch.outputs import sensor_text
        from beamseg_batch.reasons import in_words

        note(f"sensor: {sensor_text(result.sensor)}")
        note(
            f"not beams: {in_words(result.rejections, 'candidates') or 'no candidate was refused'}"
        )
        for scan in result.scans:
            note(
                f"scan {scan.stamp_ns}: {scan.n_points_filtered} points, {scan.n_lines} lines, "
                f"{scan.n_segments} segments known, {scan.processing_us / 1e3:.2f} ms"
            )


def _five_lines(result: FlightResult, written: WrittenRun) -> str:
    """Sum a run up for the person who started it."""
    length = sum(segment.length for segment in result.segments)
    median_ms = written.summary["processing"]["p50_ms"]
    pace = "" if median_ms is None else f", {median_ms:.1f} ms a scan (median)"
    longest = max(result.segments, key=lambda s: s.length, default=None)
    again = f"; to fly again: {FLY_AGAIN_FILE}" if FLY_AGAIN_FILE in written.files else ""
    return "\n".join(
        [
            f"beams          {len(result.segments)}, {length:.2f} m in all"
            + (f", the longest {longest.length:.2f} m" if longest else "")
            + again,
            f"joints         {len(result.joints)}, "
            f"{len(result.intersections)} pairs of beams touch",
            f"scans          {len(result.scans)} used, {result.skipped.total()} skipped, "
            f"{result.recording.duration_s:.1f} s of flight",
            f"time           {result.wall_s:.1f} s{pace}",
            f"report         {written.report or written.folder}",
        ]
    )
