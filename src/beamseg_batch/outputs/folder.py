"""An output folder that is whole or absent.

Files are collected in a hidden staging folder and moved to their place at the end. An
existing run is replaced only when asked, and then only the files that its own manifest
lists: what else lies in the folder is the user's.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import secrets
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath
from types import TracebackType

from beamseg_batch.errors import OutputError

__all__ = ["MANIFEST", "OutputFolder", "partial_path"]

MANIFEST = "summary.json"
"""The file whose `files` list says what a run consists of."""

_STAGING_PREFIX = ".beamseg-"


class OutputFolder:
    """A folder that receives all of its files at once.

    Use it as a context manager: leaving it normally puts the files in place, leaving it
    by an exception leaves everything as it was.

    Parameters
    ----------
    path : Path
        The folder. It and its parents are created when they are missing.
    overwrite : bool
        Whether files of an earlier run, as listed by its manifest, are replaced.

    Raises
    ------
    OutputError
        If the folder holds a run or other files and `overwrite` is false, if a file that
        is not of a run has the name of one to be written, or if it cannot be written.

    Notes
    -----
    The staging folder lies in the deepest folder that exists on the way to `path`, which
    is `path` itself once it exists. So it is always on the same file system, and a mount
    point, a link or the working folder will do, whatever its parent allows. A folder that
    does not exist yet appears by one rename; in one that does, the manifest moves last.
    """

    def __init__(self, path: Path, *, overwrite: bool = False) -> None:
        self.path = path
        self.overwrite = overwrite
        self._target = path
        self._staging: Path | None = None
        self._names: list[str] = []

    @staticmethod
    def check(path: Path, *, overwrite: bool = False, names: Iterable[str] = ()) -> None:
        """Say early whether the folder could be written, and leave no trace.

        Parameters
        ----------
        path : Path
        overwrite : bool
        names : iterable of str
            Files that will be written, as far as they are known.

        Raises
        ------
        OutputError
            As the class does.
        """
        target = _resolved(path)
        with _explained(path):
            _refuse(path, target, overwrite, names)
            staging = _make_staging(path, target)
            try:
                base = staging.parent
                (staging / target.relative_to(base)).mkdir(parents=True, exist_ok=True)
            finally:
                shutil.rmtree(staging, ignore_errors=True)

    def __enter__(self) -> OutputFolder:
        self._target = _resolved(self.path)
        with _explained(self.path):
            _refuse(self.path, self._target, self.overwrite, ())
            self._staging = _make_staging(self.path, self._target)
        return self

    @property
    def staging(self) -> Path:
        """Where the files lie until they are put in place.

        Raises
        ------
        ValueError
            If the folder is not open.
        """
        if self._staging is None:
            raise ValueError("the output folder is not open")
        return self._staging

    def write(self, name: str, content: bytes | str) -> None:
        """Add a file.

        Parameters
        ----------
        name : str
            Relative to the folder, with ``/`` between the parts.
        content : bytes or str
            Text is written as UTF-8.

        Raises
        ------
        OutputError
            If the file cannot be written, for example on a full disk.
        ValueError
            If the name leads out of the folder, or the folder is not open.
        """
        file = self.staging / name
        if not _is_safe(name):
            raise ValueError(f"{name!r} is not a name inside the folder")
        with _explained(self.path / name):
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(encoded(content))
        self._names.append(name)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        staging, self._staging = self._staging, None
        assert staging is not None
        try:
            if kind is None:
                with _explained(self.path):
                    self._commit(staging)
        finally:
            shutil.rmtree(staging, ignore_errors=True)

    def _commit(self, staging: Path) -> None:
        if not self._target.exists():
            _rename_whole(staging, self._target)
            return
        _refuse(self.path, self._target, self.overwrite, self._names)
        # The manifest goes first and comes last: half a run is never taken for a run.
        old = sorted(_run_files(self._target), key=lambda name: name != MANIFEST)
        new = sorted(dict.fromkeys(self._names), key=lambda name: name == MANIFEST)
        with _Moves() as moves:
            for name in old:
                moves.move(self._target / name, staging / ".old" / name)
            for name in new:
                moves.move(staging / name, self._target / name)
        _remove_empty_parents(self._target, old)


def encoded(content: bytes | str) -> bytes:
    """Bytes of a file's content.

    Parameters
    ----------
    content : bytes or str

    Returns
    -------
    bytes
        Text as UTF-8. What UTF-8 cannot hold, such as the undecodable bytes of a file
        name, is written as an escape: that is also its escape in JSON.
    """
    if isinstance(content, bytes):
        return content
    return content.encode("utf-8", "backslashreplace")


def partial_path(path: Path) -> Path:
    """Folder beside `path` for what an interrupted run leaves.

    Parameters
    ----------
    path : Path
        The output folder of the run.

    Returns
    -------
    Path
        The same path, ended by ``.partial``.
    """
    named = path if path.name not in ("", "..") else _resolved(path)
    return named.with_name(f"{named.name}.partial")


class _Moves:
    """Moves of files that are undone when one of them fails."""

    def __init__(self) -> None:
        self._done: list[tuple[Path, Path]] = []

    def __enter__(self) -> _Moves:
        return self

    def move(self, source: Path, target: Path) -> None:
        target.parent.mkdir(parents=True, exist_ok=True)
        source.rename(target)
        self._done.append((source, target))

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if kind is None:
            return
        for source, target in reversed(self._done):
            with contextlib.suppress(OSError):
                target.rename(source)


def _rename_whole(staging: Path, target: Path) -> None:
    """Put the staging folder in the place of a folder that does not exist."""
    created = [folder for folder in target.parents if not folder.exists()]
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        staging.rename(target)
    except OSError:
        for folder in created:
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise


def _remove_empty_parents(folder: Path, names: Iterable[str]) -> None:
    """Remove the subfolders that held files of the old run and now hold nothing."""
    parents = {parent for name in names for parent in PurePosixPath(name).parents}
    for parent in sorted(parents - {PurePosixPath(".")}, reverse=True):
        with contextlib.suppress(OSError):
            (folder / parent).rmdir()


def _make_staging(path: Path, target: Path) -> Path:
    base = next(place for place in (target, *target.parents) if place.exists())
    if not base.is_dir():
        raise OutputError(f"{path}: {base} is a file, so nothing can be written below it")
    staging = base / f"{_STAGING_PREFIX}{secrets.token_hex(6)}"
    staging.mkdir()
    return staging


def _refuse(path: Path, target: Path, overwrite: bool, names: Iterable[str]) -> None:
    """Raise when writing would touch what it must not."""
    if not target.exists():
        if os.path.lexists(target):
            raise OutputError(f"{path} is a link that leads in a circle")
        return
    if not target.is_dir():
        raise OutputError(f"{path} is a file, not a folder; choose another place with -o")
    entries = [e.name for e in os.scandir(target) if not e.name.startswith(_STAGING_PREFIX)]
    if not entries:
        return
    if not overwrite:
        raise OutputError(_occupied(path, target))
    owned = _run_files(target)
    for name in names:
        if name not in owned and os.path.lexists(target / name):
            raise OutputError(
                f"{path / name} is in the way and is not of a run that beamseg wrote; "
                "move it away, or choose another place with -o"
            )


def _occupied(path: Path, target: Path) -> str:
    if _run_files(target):
        return f"{path} already holds a run; use --overwrite to replace it, or -o for another place"
    return (
        f"{path} is not empty and holds no run; use --overwrite to add the files to it, "
        "or -o for another place"
    )


def _run_files(folder: Path) -> frozenset[str]:
    """Files of the run in a folder: those its manifest lists that lie inside and exist."""
    try:
        manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        listed = manifest["files"]
    except (OSError, ValueError, RecursionError, KeyError, TypeError):
        return frozenset()
    if not isinstance(listed, list):
        return frozenset()
    names = {name for name in listed if isinstance(name, str)} | {MANIFEST}
    return frozenset(name for name in names if _is_file_inside(folder, name))


def _is_file_inside(folder: Path, name: str) -> bool:
    """Whether a name of a manifest is a file of the folder itself, behind no link."""
    if not _is_safe(name):
        return False
    file = folder / name
    try:
        return file.parent.resolve() == file.parent and (file.is_symlink() or file.is_file())
    except (OSError, RuntimeError):
        return False


def _is_safe(name: str) -> bool:
    """Whether a name is relative, normal and leads nowhere else."""
    pure = PurePosixPath(name)
    return (
        str(pure) == name
        and not pure.is_absolute()
        and bool(pure.parts)
        and ".." not in pure.parts
        and not any(char in name for char in "\\:\0")
    )


def _resolved(path: Path) -> Path:
    """Follow all links, so that what is checked is what is written."""
    try:
        target = path.resolve()
        is_loop = target.is_symlink()  # from Python 3.13 on, resolve leaves a loop as it is
    except (OSError, RuntimeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(f"{path}: cannot be used: {reason}") from error
    if is_loop:
        raise OutputError(f"{path}: cannot be used: {os.strerror(errno.ELOOP)}")
    return target


@contextlib.contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Turn an error of the operating system into one that names the path and the reason."""
    try:
        yield
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
