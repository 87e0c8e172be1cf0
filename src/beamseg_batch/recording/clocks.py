"""Stamps against log times: clocks that jump, and clocks that never meet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["StampWatch", "clock_groups", "clock_notes", "duration_text", "stamp_jumps"]

_SMALLEST_JUMP_S = 1.0
_MOST_RESETS = 20
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
    return [
        (float(logged[k + 1] - logged[0]) * _S, float(steps[k] - passed[k]))
        for k in _jumps(stamps, logged).tolist()
    ]


def _jumps(stamps_ns: NDArray[np.int64], log_times_ns: NDArray[np.int64]) -> NDArray[np.intp]:
    """Messages after which the clock was set anew."""
    steps = np.diff(stamps_ns) * _S
    # A recorder that stalls lets its own clock run ahead of the stamps, which then catch up.
    ahead = (stamps_ns - log_times_ns) * _S
    leaps = ahead[1:] - np.maximum.accumulate(ahead)[:-1] > _SMALLEST_JUMP_S
    jumps: NDArray[np.intp] = np.flatnonzero((steps < -_SMALLEST_JUMP_S) | leaps)
    return jumps


def clock_groups(
    stamps_ns: Sequence[int] | NDArray[np.int64], log_times_ns: Sequence[int]
) -> list[tuple[float, NDArray[np.intp]]]:
    """Group messages by how far their clock was ahead of the recorder's.

    Parameters
    ----------
    stamps_ns, log_times_ns : sequence or array of int
        Of the same messages, in order of the file.

    Returns
    -------
    list of (float, (N,) int)
        Seconds ahead, the median, and the messages, in order of the file. One group when the
        clock was never set anew, or so often that the messages are merely out of order.
    """
    stamps, logged = np.asarray(stamps_ns, np.int64), np.asarray(log_times_ns, np.int64)
    ahead = (stamps.astype(np.float64) - logged.astype(np.float64)) * _S
    jumps = _jumps(stamps, logged) + 1
    groups: list[tuple[float, NDArray[np.intp]]] = []
    for part in np.split(np.arange(len(stamps)), jumps if len(jumps) <= _MOST_RESETS else []):
        state = float(np.median(ahead[part])) if len(part) else 0.0
        for k, (other, members) in enumerate(groups):
            if abs(state - other) <= _SMALLEST_JUMP_S:
                groups[k] = other, np.concatenate([members, part])
                break
        else:
            groups.append((state, part))
    return groups


class StampWatch:
    """Watches stamps in order of log time for a clock that is set anew, as `stamp_jumps` does."""

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._most_ahead_ns = 0

    def sees_jump(self, stamp_ns: int, log_time_ns: int) -> bool:
        """Take note of a stamp; say whether the clock was set since the one before."""
        ahead_ns = stamp_ns - log_time_ns
        last_ns, most_ns = self._last_ns, self._most_ahead_ns
        is_first = last_ns is None
        self._most_ahead_ns = ahead_ns if is_first else max(most_ns, ahead_ns)
        self._last_ns = stamp_ns
        if last_ns is None:
            return False
        return max(last_ns - stamp_ns, ahead_ns - most_ns) * _S > _SMALLEST_JUMP_S


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
        f"{when_s:.1f} s after the first{more}; a cloud is matched with poses of the same clock "
        "alone; --time-source log uses the recorder's clock"
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
