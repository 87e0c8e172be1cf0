"""Fly the sample flights anew, each with its truth.

    make samples

Every flight is one call of ``beamseg simulate``: the same bytes each time, as long as the
simulator, the libraries and the machine stay the same.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from beamseg_batch.cli.main import beamseg

HERE = Path(__file__).parent
ARENA = ("arena", "--duration", "20", "--extrinsic-in", "none")
FLIGHTS = {
    "arena.mcap": ARENA,
    "arena.bag": (*ARENA, "--compression", "lz4"),
    "tower_panel.mcap": (str(HERE / "tower_panel.yaml"),),
    "empty.mcap": (str(HERE / "empty.yaml"),),
}
"""Recordings, and how they are flown: world and options of ``beamseg simulate``."""


def make_sample(name: str, folder: Path) -> None:
    """Fly one sample into a folder.

    Parameters
    ----------
    name : str
        Of the recording, one of `FLIGHTS`.
    folder : Path
        Must be there. The recording goes into it, and its truth as ``NAME_truth.csv``,
        ``NAME_truth_joints.csv``, ``NAME_true_poses.tum`` and ``NAME_scene.json``.
    """
    with tempfile.TemporaryDirectory(dir=folder, prefix=".flight-") as scratch:
        recording = Path(scratch) / name
        command = ["simulate", *FLIGHTS[name], "--seed", "1", "--quiet", "-o", str(recording)]
        if code := beamseg(command, standalone_mode=False):
            sys.exit(code)
        for file in sorted((recording.parent / "truth").iterdir()):
            file.replace(folder / f"{recording.stem}_{file.name}")
        recording.replace(folder / name)


def main(folder: Path = HERE) -> None:
    """Fly all samples into a folder, and tell their sizes."""
    for name in FLIGHTS:
        make_sample(name, folder)
        print(f"{name:18}{(folder / name).stat().st_size / 1e6:5.1f} MB")


if __name__ == "__main__":
    main()
