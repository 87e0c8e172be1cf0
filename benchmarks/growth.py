"""What a scan costs, by how many beams are known: it must not grow with the structure.

python -m benchmarks.growth [--beams 20,200,2000] [FLIGHT]

Beams are added far away from those that the flight sees, as on a long bridge. The first
pass finds and fuses; a further one asks all rays, and then makes the next hypothesis,
once a pass, in a time that grows with the beams and not with the scans.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from beamseg_batch.config import RunConfig, load_config
from beamseg_batch.cylinder.evidence_kernels import COARSE, FINE
from beamseg_batch.detection import Detector
from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import Detections, Segment
from beamseg_batch.noise import DEFAULT_NOISE
from beamseg_batch.structure import EvidenceStructure, Structure
from beamseg_batch.structure.hypothesis import Sums
from beamseg_batch.structure.questions import AxisQuestion
from benchmarks.flight import read_scans

_FLIGHT = Path("data/samples/arena.mcap")
_ROUNDS = 3


def main() -> None:
    """Print milliseconds a scan, for each number of beams."""
    arguments = _arguments()
    names = ("known beams", "report: fuse", "precise: fuse", "precise: ask", "renew, a beam")
    print("".join(f"{name:>16}" for name in names), " ms a scan")
    rows = [_row(number, arguments.flight) for number in arguments.beams]
    for number, row in zip(arguments.beams, rows, strict=True):
        print(f"{number:>16}" + "".join(f"{value:>16.3f}" for value in row))
    print(
        f"{'growth':>16}"
        + "".join(f"{b / a:>15.2f}x" for a, b in zip(rows[0], rows[-1], strict=True))
    )


def _row(number: int, flight: Path) -> list[float]:
    return [
        _fusing(load_config("report"), number, flight),
        _fusing(load_config("precise"), number, flight),
        *_asking(load_config("precise"), number, flight),
    ]


def _fusing(config: RunConfig, number: int, flight: Path) -> float:
    """Milliseconds of detection and fusion a scan; the least of some rounds."""
    scans, detect = read_scans(flight), Detector(config)
    spent = []
    for _ in range(_ROUNDS):
        structure = _with_far_beams(config, number, detect(scans[0]))
        start = time.process_time()
        for scan in scans:
            structure.update(detect(scan))
        spent.append(time.process_time() - start)
    return 1e3 * min(spent) / len(scans)


def _asking(config: RunConfig, number: int, flight: Path) -> tuple[float, float]:
    """Milliseconds of a pass over the rays a scan, and of the next hypothesis a beam."""
    scans, detect = read_scans(flight), Detector(config)
    structure = _with_far_beams(config, number, detect(scans[0]))
    assert isinstance(structure, EvidenceStructure)
    for scan in scans:
        structure.update(detect(scan))
    question = structure.question()
    sums = question.sums()
    spent = []
    for _ in range(_ROUNDS):
        start = time.process_time()
        sums = question.sums()
        sums.add(question.ask(scans))
        spent.append(time.process_time() - start)
    _tell_of_far_beams(question, sums)
    start = time.process_time()
    structure.renew(sums)
    renewing = time.process_time() - start
    assert len(structure) >= number
    return 1e3 * min(spent) / len(scans), 1e3 * renewing / len(question.beams)


def _with_far_beams(
    config: RunConfig, number: int, like: Detections
) -> Structure | EvidenceStructure:
    structure: Structure | EvidenceStructure = (
        EvidenceStructure(config, DEFAULT_NOISE)
        if config.structure.fusion == "evidence"
        else Structure(config)
    )
    far = tuple(_post(np.array([20.0 + k % 50, k // 50, 0.0]), like) for k in range(number))
    for _ in range(config.structure.min_scans):
        structure.update(replace(like, segments=far))
    return structure


def _tell_of_far_beams(question: AxisQuestion, sums: Sums) -> None:
    """Make up the evidence of an earlier flight, so that the beams out of view are kept."""
    evidence = sums.evidence
    for index in np.flatnonzero(evidence.asked == 0):
        beam = question.beams[index]
        fine = slice(*evidence.fine_at[index : index + 2])
        places = sums.starts[index] + FINE * np.arange(fine.stop - fine.start)
        inside = (places >= beam.first) & (places < beam.last)
        evidence.likelihood[fine] = np.where(inside, 16.0, -4.0)
        evidence.hits[fine] = np.where(inside, 4.0, 0.0)
        coarse = slice(*evidence.coarse_at[index : index + 2])
        s = sums.starts[index] + COARSE * (np.arange(coarse.stop - coarse.start) + 0.5)
        rows = evidence.normal[coarse]
        rows[:, [0, 2]] = 1e5
        rows[:, [3, 5]] = 1e5 * s[:, None]
        rows[:, [6, 8]] = 1e5 * s[:, None] ** 2
        rows[:, [13, 14, 15, 20]] = 20.0, 20.0, 20.0, 1e5
        evidence.scans[index] = 20
        evidence.asked[index] = 1


def _post(foot: FloatArray, like: Detections) -> Segment:
    """One upright beam, seen once."""
    heights = np.linspace(0.5, 1.5, 40)
    points = foot + heights[:, None] * [0.0, 0.0, 1.0]
    return Segment(
        anchor=points.mean(axis=0),
        direction=np.array([0.0, 0.0, 1.0]),
        t_min=-0.5,
        t_max=0.5,
        radius=0.05,
        n_points=len(points),
        pca_coeff=1.0,
        pca_eig=np.array([0.08, 0.0, 0.0]),
        points=points,
        first_seen_ns=like.scan.stamp_ns,
        last_seen_ns=like.scan.stamp_ns,
    )


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.growth", description=__doc__)
    parser.add_argument("flight", type=Path, nargs="?", default=_FLIGHT)
    parser.add_argument(
        "--beams", type=lambda text: [int(n) for n in text.split(",")], default=[20, 200, 2000]
    )
    return parser.parse_args()


if __name__ == "__main__":
    main()
