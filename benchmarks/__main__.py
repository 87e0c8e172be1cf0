"""Run all benchmarks, print a table, and keep the figures as dated JSON.

make bench                        # on the sample flight
make bench FLIGHT=folder          # also on folder/flight.mcap and folder/flight.bag
"""

from __future__ import annotations

import argparse
import json
import platform
from collections.abc import Iterator
from dataclasses import asdict
from datetime import datetime, timezone
from importlib.metadata import version
from pathlib import Path

from beamseg_batch.detection.filtering import crop_scan, voxel_grid
from benchmarks.flight import (
    CONFIG,
    measure_command,
    measure_reading,
    measure_stages,
    read_scans,
)
from benchmarks.search import RADIUS, measure_search
from benchmarks.timing import Measurement

ROOT = Path(__file__).parents[1]
SAMPLES = [ROOT / "data/samples/arena.mcap", ROOT / "data/samples/arena.bag"]


def main() -> None:
    """Measure, print and keep."""
    arguments = _arguments()
    recordings = _recordings(arguments.flight)
    measurements = []
    print(f"{'group':16}{'what':44}{'value':>14}  {'baseline':38}{'ratio':>7}")
    for measurement in _measure(recordings, quick=arguments.quick):
        measurements.append(measurement)
        print(_row(measurement), flush=True)
    print(f"kept in {_keep(measurements, arguments.output)}")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--flight", type=Path, help="folder with flight.mcap and flight.bag")
    parser.add_argument("--quick", action="store_true", help="fewer scans and repetitions")
    parser.add_argument("--output", type=Path, default=ROOT / "benchmarks/results")
    return parser.parse_args()


def _recordings(flight: Path | None) -> list[Path]:
    """Recordings of the flight to measure, else the samples."""
    if flight is None:
        return SAMPLES
    return [path for name in ("mcap", "bag") if (path := flight / f"flight.{name}").exists()]


def _measure(recordings: list[Path], *, quick: bool) -> Iterator[Measurement]:
    scans = read_scans(recordings[0])
    leaf_size = CONFIG.filtering.leaf_size(RADIUS)
    clouds = [voxel_grid(crop_scan(scan, CONFIG.filtering).points, leaf_size) for scan in scans]
    yield from measure_search(clouds, quick=quick)
    yield from measure_stages(recordings[0], scans)
    yield from measure_reading(recordings)
    yield from measure_command(recordings, repeats=2 if quick else 5)


def _row(m: Measurement) -> str:
    baseline = ratio = ""
    if m.baseline_value is not None:
        baseline = f"{m.baseline} {m.baseline_value:.3f} {m.unit}"
    if m.ratio is not None:
        ratio = f"{m.ratio:.1f}"
    return f"{m.group:16}{m.name:44}{m.value:>10.3f} {m.unit:7}  {baseline:34}{ratio:>7}"


def _keep(measurements: list[Measurement], folder: Path) -> Path:
    now = datetime.now(timezone.utc)
    content = {
        "date": now.isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "machine": platform.machine(),
        "versions": {
            name: version(name) for name in ("beamseg-batch", "numpy", "numba", "rosbags")
        },
        "measurements": [asdict(measurement) for measurement in measurements],
    }
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{now:%Y-%m-%d-%H%M%S}.json"
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    return path


if __name__ == "__main__":
    main()
