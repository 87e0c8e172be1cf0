"""The one decorator that compiles kernels.

A kernel takes and returns plain arrays and numbers; its caller checks shapes once.
"""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar, overload

import numba

__all__ = ["kernel"]

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
    reorder sums, and a NaN is an answer. The compiled code lies beside the source or,
    where that cannot be written, in the user's cache folder; where neither can, it goes
    to the system's temporary folder rather than fail.
    """
    if function is None:
        return lambda decorated: _compiled(decorated, {"contract"} if contract else False)
    return _compiled(function, False)


def _compiled(function: Callable[P, R], fastmath: set[str] | bool) -> Callable[P, R]:
    def compile_() -> Callable[P, R]:
        decorator = numba.njit(cache=True, fastmath=fastmath, error_model="numpy", nogil=True)
        compiled: Callable[P, R] = decorator(function)
        return compiled

    try:
        return compile_()
    except RuntimeError:  # no folder to keep compiled code in
        os.environ["NUMBA_CACHE_DIR"] = _fallback_cache()
        numba.core.config.reload_config()
        return compile_()


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
