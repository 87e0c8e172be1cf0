"""Stages of a scan, reading by format, the whole command, and its memory."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter

from beamseg_batch.config import load_config
from beamseg_batch.detection import Detector
from beamseg_batch.model import STAGES, Scan
from beamseg_batch.recording import open_flight, open_recording
from beamseg_batch.structure import Structure
from benchmarks.memory import peak_mb
from benchmarks.timing import Measurement, in_turns

__all__ = ["measure_command", "measure_reading", "measure_stages", "read_scans"]

CONFIG = load_config("report")


def read_scans(path: Path) -> list[Scan]:
    """All usable scans of a recording."""
    flight = open_flight(open_recording(path), CONFIG)
    return [scan for scan in flight.scans() if isinstance(scan, Scan)]


def measure_stages(path: Path, scans: list[Scan]) -> Iterator[Measurement]:
    """Median microseconds of each stage of a scan, granularity 4.

    Parameters
    ----------
    path : Path
        The recording, for its name.
    scans : list of Scan
        Its scans.

    Yields
    ------
    Measurement
    """
    detect, structure = Detector(CONFIG), Structure(CONFIG)
    for scan in scans[:5]:
        detect(scan)
    stage_us = []
    for scan in scans:
        detections = detect(scan)
        start = time.perf_counter()
        structure.update(detections)
        fuse_us = (time.perf_counter() - start) * 1e6
        stage_us.append([{**detections.stage_us, "fuse": fuse_us}[stage] for stage in STAGES])
    for stage, median in zip(STAGES, np.median(stage_us, axis=0), strict=True):
        yield Measurement("stages", f"{stage}, {path.name}", float(median) / 1e3, "ms")


def measure_reading(recordings: list[Path]) -> Iterator[Measurement]:
    """Reading and decoding of whole recordings beside the library's bare iteration.

    Parameters
    ----------
    recordings : list of Path
        The same flight in several formats; a ROS 2 folder is written besides.

    Yields
    ------
    Measurement
        Milliseconds a scan.
    """
    with tempfile.TemporaryDirectory() as folder:
        sqlite = Path(folder) / "sqlite"
        _write_folder(recordings[0], sqlite)
        for path in [*recordings, sqlite]:
            n_scans = len(read_scans(path))
            one = in_turns(
                "reading",
                f"{path.name}, {n_scans} scans",
                [partial(read_scans, path)] * 5,
                "bare library iteration",
                [partial(_iterate, path)] * 5,
            )
            assert one.baseline_value is not None
            yield Measurement(
                one.group,
                one.name,
                one.value / n_scans,
                "ms/scan",
                one.baseline,
                one.baseline_value / n_scans,
                one.ratio,
            )


def _iterate(path: Path) -> int:
    """Read every message of a recording with the library alone, without decoding."""
    with AnyReader([path]) as reader:
        return sum(len(raw) for _, _, raw in reader.messages())


def _write_folder(source: Path, target: Path) -> None:
    with (
        AnyReader([source]) as reader,
        FolderWriter(target, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer,
    ):
        connections = {
            c.id: writer.add_connection(c.topic, c.msgtype, typestore=reader.typestore)
            for c in reader.connections
        }
        for connection, stamp_ns, raw in reader.messages():
            writer.write(connections[connection.id], stamp_ns, raw)


def measure_command(recordings: list[Path], *, repeats: int) -> Iterator[Measurement]:
    """`beamseg run` and `beamseg --help` as processes: time and peak memory, warm.

    Parameters
    ----------
    recordings : list of Path
    repeats : int

    Yields
    ------
    Measurement
    """
    yield Measurement("command", "beamseg --help", _command_s(["--help"], repeats), "s")
    with tempfile.TemporaryDirectory() as folder:
        for path in recordings:
            run = [
                "run",
                str(path),
                "--profile",
                "report",
                "-q",
                "--overwrite",
                "-o",
                folder + "/out",
            ]
            yield Measurement("command", f"beamseg run {path.name}", _command_s(run, repeats), "s")
            yield Measurement("memory", f"peak of beamseg run {path.name}", peak_mb(run), "MB")


def _command_s(arguments: list[str], repeats: int) -> float:
    """Median seconds of a command as a whole process, after one that warms up."""
    times = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "beamseg_batch", *arguments], check=True, capture_output=True
        )
        times.append(time.perf_counter() - start)
    return float(np.median(times[1:]))
