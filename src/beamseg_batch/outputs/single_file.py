"""One output file that is whole or absent."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from beamseg_batch.errors import BeamsegError, OutputError

__all__ = ["check_file", "staged_file"]


def check_file(path: Path, *, overwrite: bool = False) -> None:
    """Say early whether a file could be written, and leave no trace.

    Parameters
    ----------
    path : Path
    overwrite : bool
        Whether a file of that name may be replaced.

    Raises
    ------
    OutputError
        If there is something of that name that may not be replaced, or if its folder
        cannot be written.
    """
    if not path.name:
        raise OutputError(f"{path}: names no file")
    if path.is_dir():
        raise OutputError(f"{path} is a folder, not a file; choose another name")
    if os.path.lexists(path) and not overwrite:
        raise OutputError(f"{path} exists already; use --overwrite to replace it")
    nearest = next(folder for folder in path.absolute().parents if os.path.lexists(folder))
    if not nearest.is_dir():
        raise OutputError(f"{path}: {nearest} is a file, so nothing can be written below it")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise OutputError(f"{path}: cannot be written: {nearest} permits no new file")


@contextmanager
def staged_file(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Write a file that appears when it is finished, or not at all.

    Parameters
    ----------
    path : Path
        Folders on the way are created.
    overwrite : bool
        Whether a file of that name is replaced.

    Yields
    ------
    Path
        Where to write it: of the same name, in a hidden folder beside it.

    Raises
    ------
    OutputError
        As `check_file` does, or if it cannot be written.
    """
    check_file(path, overwrite=overwrite)
    created = [folder for folder in path.absolute().parents if not folder.exists()]
    staging = path.parent / f".beamseg-{secrets.token_hex(6)}"
    done = False
    try:
        staging.mkdir(parents=True)
        yield staging / path.name
        (staging / path.name).replace(path)
        done = True
    except BeamsegError:
        raise
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(staging, ignore_errors=True)
        for folder in [] if done else created:
            with suppress(OSError):  # another program may use it by now
                folder.rmdir()
