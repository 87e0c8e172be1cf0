"""`beamseg info`: what a recording holds and how it would be used."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from beamseg_batch.cli.console import begin_work, say
from beamseg_batch.cli.options import ConfigOptions, config_options, recording_argument

if TYPE_CHECKING:
    from beamseg_batch.config import RunConfig
    from beamseg_batch.recording import Recording
    from beamseg_batch.recording.inspection import (
        CloudLayout,
        MatchSummary,
        RecordingSummary,
        StampSummary,
        TopicChoiceSummary,
    )
    from beamseg_batch.recording.time_offset import TimeOffset

__all__ = ["command"]

_MOST_PLACES = 10


@click.command("info")
@recording_argument
@config_options
@click.option("--json", "as_json", is_flag=True, help="Print JSON for machines.")
@click.option("--suggest", is_flag=True, help="Print a configuration that fits the recording.")
@click.option(
    "--estimate-time-offset",
    "estimate",
    is_flag=True,
    help="Measure how far the clock of the clouds is from that of the poses.",
)
def command(
    recording: tuple[Path, ...],
    options: ConfigOptions,
    as_json: bool,
    suggest: bool,
    estimate: bool,
) -> None:
    """Show what a recording holds and how it would be used.

    Lists topics with types, counts and rates, the topics and frames that a run with the
    same options would use and why, the extrinsic, gaps in the stamps, and how well poses
    and clouds match. Nothing is written. What would stop a run is listed as a problem.

    \b
    Examples:
      beamseg info flight.mcap
      beamseg info flight.bag --json | jq .match
      beamseg info flight.bag --suggest > site.yaml
      beamseg info flight.bag --estimate-time-offset
    """  # noqa: D301 (click reads the backspace)
    from dataclasses import asdict

    from beamseg_batch.recording import inspect_recording, open_recording

    config = options.load()
    begin_work()
    opened = open_recording(list(recording), config.recording)
    offset = _measured_offset(opened, config) if estimate else None
    if suggest:
        if as_json:
            raise click.UsageError("--suggest prints YAML; leave out --json")
        say(_suggestion(opened, config, offset).rstrip())
        return
    summary = inspect_recording(opened, config)
    if as_json:
        measured = {} if offset is None else {"time_offset": asdict(offset)}
        say(json.dumps({**summary.to_json(), **measured}, indent=2))
    else:
        say("\n".join([*_lines(summary), *_offset_lines(offset)]))


def _measured_offset(recording: Recording, config: RunConfig) -> TimeOffset:
    from beamseg_batch.recording import open_flight
    from beamseg_batch.recording.time_offset import estimate_time_offset

    return estimate_time_offset(open_flight(recording, config))


def _suggestion(recording: Recording, config: RunConfig, offset: TimeOffset | None) -> str:
    from beamseg_batch.recording.suggestion import suggest_config

    if offset is not None:
        measured = {"time_offset_s": round(offset.offset_s, 4)}
        branch = config.recording.model_copy(update=measured)
        config = config.model_copy(update={"recording": branch})
    return suggest_config(recording, config)


def _offset_lines(offset: TimeOffset | None) -> Iterator[str]:
    if offset is not None:
        yield (
            f"time offset   {offset.offset_s:.4f} s, give or take {offset.sigma_s:.4f} s, from "
            f"{offset.n_scans} scans: run with --time-offset {offset.offset_s:.4f}"
        )


def _lines(summary: RecordingSummary) -> Iterator[str]:
    """Write a summary for people, a line each."""
    yield f"recording     {', '.join(summary.paths)}"
    yield (
        f"              {summary.container}, {summary.size_bytes / 1e6:.1f} MB, "
        f"{summary.duration_s:.1f} s"
    )
    yield ""
    yield from _table(
        ("topic", "type", "messages", "rate"),
        (
            (topic.name, topic.msgtype, str(topic.count), _rate(topic.rate_hz))
            for topic in summary.topics
        ),
    )
    yield ""
    yield f"clouds        {_choice(summary.cloud_topic)}"
    yield from _stamps(summary.clouds)
    if summary.first_cloud:
        yield f"              {_layout(summary.first_cloud)}"
    yield f"poses         {_choice(summary.pose_topic)}"
    yield from _stamps(summary.poses)
    if summary.match:
        yield f"match         {_match(summary.match)}"
    for role, frame in summary.frames.items():
        yield f"{role + ' frame':14}{frame.name or '(no name)'}: {frame.reason}"
    if summary.extrinsic:
        x, y, z = summary.extrinsic.translation
        roll, pitch, yaw = summary.extrinsic.rotation_rpy_deg
        yield (
            f"extrinsic     {x:g}, {y:g}, {z:g} m, "
            f"roll {roll:.2f}, pitch {pitch:.2f}, yaw {yaw:.2f} degrees "
            f"(from: {summary.extrinsic.source})"
        )
    for text in summary.notes:
        yield f"note          {text}"
    yield from _damage(summary.damage)
    for text in summary.problems:
        yield f"problem       {text}"


def _damage(places: Sequence[str]) -> Iterator[str]:
    """List the first damaged places: a file may have thousands."""
    for text in places[:_MOST_PLACES]:
        yield f"damage        {text}"
    if len(places) > _MOST_PLACES:
        yield f"              and {len(places) - _MOST_PLACES} further places"


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> Iterator[str]:
    table = [head, *rows]
    widths = [max(len(row[column]) for row in table) for column in range(len(head))]
    for row in table:
        yield "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()


def _rate(rate_hz: float | None) -> str:
    return "" if rate_hz is None else f"{rate_hz:.1f} Hz"


def _choice(choice: TopicChoiceSummary) -> str:
    return f"{choice.topic}: {choice.reason}" if choice.topic else "none, see the problem below"


def _stamps(stamps: StampSummary | None) -> Iterator[str]:
    if stamps is None or stamps.largest_gap_s is None:
        return
    yield (
        f"              {stamps.count} stamps, {_rate(stamps.rate_hz)}, largest gap "
        f"{stamps.largest_gap_s:.3f} s at {stamps.largest_gap_at_s:.1f} s"
    )


def _layout(cloud: CloudLayout) -> str:
    fields = ", ".join(f"{field.name} {field.datatype}" for field in cloud.fields)
    returns = cloud.problem or f"{cloud.n_returns} returns"
    return f"first cloud: {cloud.width} x {cloud.height} pixels, {returns}, fields {fields}"


def _match(match: MatchSummary) -> str:
    return (
        f"{match.share_within_gap:.1%} of clouds have a pose within {match.max_gap_s:g} s; "
        f"median {match.median_dt_s * 1e3:.2f} ms, largest {match.max_dt_s * 1e3:.2f} ms"
    )
