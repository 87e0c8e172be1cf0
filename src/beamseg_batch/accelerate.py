"""The one decorator that compiles kernels.

A kernel takes and returns plain arrays and numbers; its caller checks shapes once.
"""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar

import numba

__all__ = ["kernel"]

P = ParamSpec("P")
R = TypeVar("R")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function to machine code on its first call, and keep it on disk.

    Parameters
    ----------
    function : callable
        Plain arrays and numbers in and out; no Python objects.

    Returns
    -------
    callable
        The compiled function; the original stays reachable as ``py_func``.

    Notes
    -----
    ``fastmath`` is off: the search is exact, so the compiler must neither reorder
    sums nor fuse multiplications with additions. The compiled code lies beside the
    source or, where that cannot be written, in the user's cache folder; where neither
    can, it goes to the system's temporary folder rather than fail.
    """
    try:
        compiled = numba.njit(cache=True, fastmath=False, error_model="numpy", nogil=True)(function)
    except RuntimeError:
        os.environ["NUMBA_CACHE_DIR"] = _fallback_cache()
        numba.core.config.reload_config()
        compiled = numba.njit(cache=True, fastmath=False, error_model="numpy", nogil=True)(function)
    result: Callable[P, R] = compiled
    return result


def _fallback_cache() -> str:
    """Return a folder that this user alone can write, since code is loaded from it."""
    user = os.getuid() if hasattr(os, "getuid") else os.environ.get("USERNAME", "user")
    folder = Path(tempfile.gettempdir()) / f"beamseg-cache-{user}"
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    mine = not hasattr(os, "getuid") or status.st_uid == os.getuid()
    if mine and stat.S_ISDIR(status.st_mode) and not status.st_mode & 0o022:
        return str(folder)
    return tempfile.mkdtemp(prefix="beamseg-cache-")
