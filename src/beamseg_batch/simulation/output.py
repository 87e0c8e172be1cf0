"""Where a simulated flight goes: the recording, and the truth in a folder beside it."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from beamseg_batch.errors import BeamsegError, OutputError

__all__ = ["TRUTH_FILES", "FlightOutput", "write_files"]

TRUTH_FILES = ("truth.csv", "truth_joints.csv", "true_poses.tum", "scene.json")
"""Names of the files in the folder ``truth``."""

_STARTS = (b"\x89MCAP", b"#ROSBAG", b"SQLite format 3\0")
"""First bytes of the recordings that are files."""


@dataclass(frozen=True)
class FlightOutput:
    """Paths of a flight that is written.

    Attributes
    ----------
    recording : Path
        The file, or the folder of a ROS 2 bag.
    overwrite : bool
        Whether an earlier flight there may be replaced. Only its recording and its truth
        are, never another file.
    """

    recording: Path
    overwrite: bool = False

    @property
    def truth(self) -> Path:
        """Folder of the truth, beside the recording."""
        return self.recording.parent / "truth"

    def check(self) -> None:
        """Make sure that the flight can be written, before hours go into it.

        Raises
        ------
        OutputError
            If something is in the way.
        """
        if not self.recording.name:
            raise OutputError(f"{self.recording}: names no file; choose another place with -o")
        if self.recording == self.truth:
            raise OutputError(f"{self.truth} is where the truth goes; choose another name with -o")
        if not self.overwrite:
            for path in (self.recording, self.truth):
                if os.path.lexists(path):
                    raise OutputError(
                        f"{path} exists already; use --overwrite to replace it, or -o for a file "
                        "in another folder"
                    )
        with _explained(self.recording):
            in_the_way = os.path.lexists(self.recording) and not _is_recording(self.recording)
        if in_the_way:
            raise OutputError(f"{self.recording} is no recording: it stays as it is")
        if self.truth.exists() and not self.truth.is_dir():
            raise OutputError(f"{self.truth} is a file, so the truth cannot be written into it")

    @contextmanager
    def staged(self) -> Iterator[tuple[Path, Path]]:
        """Write a flight that is either whole or absent.

        Yields
        ------
        recording, truth : Path
            Where to write the recording, which is not there yet, and the files of the
            truth, into a folder that is. They are moved to their places at the end, or
            removed if there is an error.

        Raises
        ------
        OutputError
            If they cannot be written.
        """
        self.check()
        staging = self.recording.parent / f".beamseg-{secrets.token_hex(6)}"
        with _explained(self.recording):
            created = [folder for folder in staging.parents if not folder.exists()]
            for name in ("recording", "truth", "old"):
                (staging / name).mkdir(parents=True)
        done = False
        try:
            with _explained(self.recording):
                yield staging / "recording" / self.recording.name, staging / "truth"
                self._move(staging)
            done = True
        finally:
            shutil.rmtree(staging, ignore_errors=True)
            for folder in [] if done else created:
                with contextlib.suppress(OSError):  # another program may use it by now
                    folder.rmdir()

    def _move(self, staging: Path) -> None:
        """Put everything in its place; if something cannot be, what was there comes back."""
        moves = {
            staging / "recording" / self.recording.name: self.recording,
            **{staging / "truth" / name: self.truth / name for name in TRUTH_FILES},
        }
        self.truth.mkdir(exist_ok=True)
        with contextlib.ExitStack() as undo:
            for number, (new, target) in enumerate(moves.items()):
                old = staging / "old" / str(number)
                if os.path.lexists(target):
                    target.rename(old)
                    undo.callback(old.rename, target)
                new.rename(target)
                undo.callback(target.rename, new)
            undo.pop_all()


def _is_recording(path: Path) -> bool:
    """Whether a path is a ROS 2 bag, or a file that begins as a recording does, or is empty."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    if not path.is_file():  # a device, or a link that leads nowhere
        return False
    with path.open("rb") as stream:
        start = stream.read(16)
    return not start or start.startswith(_STARTS)


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Turn an error of the operating system into one that names the path and the reason."""
    try:
        yield
    except BeamsegError:
        raise
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error


def write_files(folder: Path, files: Mapping[str, Iterable[str]]) -> None:
    """Write text files as UTF-8, each from its parts; OutputError if one cannot be."""
    for name, parts in files.items():
        with _explained(folder / name), (folder / name).open("wb") as stream:
            stream.writelines(part.encode("utf-8", "backslashreplace") for part in parts)
