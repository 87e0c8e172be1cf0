"""Stamps against log times: clocks that jump, and clocks that never meet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

__all__ = ["clock_notes", "duration_text", "stamp_jumps"]

_SMALLEST_JUMP_S = 1.0
_S = 1e-9


def stamp_jumps(stamps_ns: Sequence[int], log_times_ns: Sequence[int]) -> list[tuple[float, float]]:
    """Find where the clock behind the stamps was set anew.

    Parameters
    ----------
    stamps_ns, log_times_ns : sequence of int
        Of the same messages, in order of the file.

    Returns
    -------
    list of (float, float)
        Seconds of log time since the first message, and seconds that the stamps jump: back
        by more than messages get out of order, or ahead of what the recorder saw pass.
    """
    stamps, logged = np.asarray(stamps_ns, np.int64), np.asarray(log_times_ns, np.int64)
    steps, passed = np.diff(stamps) * _S, np.diff(logged) * _S
    # A recorder that stalls lets its own clock run ahead of the stamps, which then catch up.
    ahead = (stamps - logged) * _S
    leaps = ahead[1:] - np.maximum.accumulate(ahead)[:-1] > _SMALLEST_JUMP_S
    jumps = np.flatnonzero((steps < -_SMALLEST_JUMP_S) | leaps)
    return [
        (float(logged[k + 1] - logged[0]) * _S, float(steps[k] - passed[k])) for k in jumps.tolist()
    ]


def clock_notes(what: str, stamps_ns: Sequence[int], log_times_ns: Sequence[int]) -> list[str]:
    """Say that a clock jumps, if it does.

    Parameters
    ----------
    what : str
        Whose clock it is, such as ``poses``.
    stamps_ns, log_times_ns : sequence of int
        As `stamp_jumps` takes them.

    Returns
    -------
    list of str
    """
    jumps = stamp_jumps(stamps_ns, log_times_ns)
    if not jumps:
        return []
    when_s, by_s = jumps[0]
    more = "" if len(jumps) == 1 else f", and {len(jumps) - 1} times more"
    return [
        f"the clock of the {what} was reset: their stamps jump by {by_s:+.3f} s "
        f"{when_s:.1f} s after the first{more}; --time-source log uses the recorder's clock, or "
        "use the part before or after it with --start and --duration"
    ]


def duration_text(seconds: float) -> str:
    """Write a duration as people say it: in seconds, and from two days on in days.

    Parameters
    ----------
    seconds : float

    Returns
    -------
    str
    """
    days = seconds / 86400.0
    return f"{days:,.0f} days" if days >= 2.0 else f"{seconds:.3f} s"
