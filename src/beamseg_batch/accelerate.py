"""The one decorator that compiles kernels.

A kernel takes and returns plain arrays and numbers; its caller checks shapes once.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, overload

import numba
import platformdirs

__all__ = ["cache_folder", "kernel"]

_KEPT_S = 30 * 86400.0

P = ParamSpec("P")
R = TypeVar("R")


@overload
def kernel(function: Callable[P, R]) -> Callable[P, R]: ...


@overload
def kernel(*, contract: bool) -> Callable[[Callable[P, R]], Callable[P, R]]: ...


def kernel(
    function: Callable[P, R] | None = None, *, contract: bool = False
) -> Callable[P, R] | Callable[[Callable[P, R]], Callable[P, R]]:
    """Compile a function to machine code on its first call, and keep it on disk.

    Parameters
    ----------
    function : callable
        Plain arrays and numbers in and out; no Python objects.
    contract : bool
        Whether a product and a sum may be fused into one rounding. Only for a kernel
        whose result is a bound that holds for either.

    Returns
    -------
    callable
        The compiled function; the original stays reachable as ``py_func``.

    Notes
    -----
    No other ``fastmath`` flag is ever on: the search is exact, so the compiler must not
    reorder sums, and a NaN is an answer. The compiled code is kept in `cache_folder`.
    """
    if function is None:
        return lambda decorated: _compiled(decorated, {"contract"} if contract else False)
    return _compiled(function, False)


def _compiled(function: Callable[P, R], fastmath: set[str] | bool) -> Callable[P, R]:
    settings: Any = numba.config
    before = settings.CACHE_DIR
    # It is read while the function is decorated, and others may use numba, too.
    settings.CACHE_DIR = before or cache_folder()
    try:
        decorator = numba.njit(cache=True, fastmath=fastmath, error_model="numpy", nogil=True)
        compiled: Callable[P, R] = decorator(function)
    finally:
        settings.CACHE_DIR = before
    return compiled


@cache
def cache_folder() -> str:
    """Folder of the compiled code: the user's own, for this very source code.

    Returns
    -------
    str
        In the user's cache folder, so that it works for an installation that cannot be
        written and for several users of one; where that cannot be written either, in the
        system's temporary folder. ``NUMBA_CACHE_DIR`` overrides it.

    Notes
    -----
    Compiled code holds copies of the kernels that it calls. It is looked up by the time
    of change of the calling file alone, so the folder is named after all files that hold
    kernels: one that changes makes a new folder. Folders that were not made within a
    month go when a new one comes.
    """
    folder = platformdirs.user_cache_path("beamseg-batch", appauthor=False)
    named = folder / f"kernels-{_digest_of_kernels()}"
    if not named.is_dir():
        try:
            named.mkdir(parents=True)
        except OSError:
            return _temporary_cache()
        _remove_old(folder)
    return str(named) if os.access(named, os.W_OK) else _temporary_cache()


def _digest_of_kernels() -> str:
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*_kernels.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _remove_old(folder: Path) -> None:
    for other in folder.glob("kernels-*"):
        with suppress(OSError):
            if time.time() - other.stat().st_mtime > _KEPT_S:
                shutil.rmtree(other, ignore_errors=True)


def _temporary_cache() -> str:
    """Return a folder that this user alone can write, since code is loaded from it."""
    user = os.getuid() if hasattr(os, "getuid") else os.environ.get("USERNAME", "user")
    folder = Path(tempfile.gettempdir()) / f"beamseg-cache-{user}-{_digest_of_kernels()}"
    with suppress(OSError):
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
        mine = not hasattr(os, "getuid") or status.st_uid == os.getuid()
        if mine and stat.S_ISDIR(status.st_mode) and not status.st_mode & 0o022:
            return str(folder)
    return tempfile.mkdtemp(prefix="beamseg-cache-")
