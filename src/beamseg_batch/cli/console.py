"""What a command prints: data on stdout, progress and notes on stderr."""

from __future__ import annotations

import contextlib
import errno
import gc
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import TYPE_CHECKING, Any

import click

from beamseg_batch.errors import BeamsegError, OutputError

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress

__all__ = [
    "FAILED",
    "GATE_FAILED",
    "INTERRUPTED",
    "ScanProgress",
    "begin_work",
    "complain",
    "note",
    "say",
    "stop_on_interrupt",
    "warn",
]

FAILED = 1
GATE_FAILED = 3
INTERRUPTED = 130

_PATIENCE_S = 2.0
_PREPARING = "still preparing: reading the poses and, on the first run, compiling the search"


def say(text: str) -> None:
    """Print what a command was asked for, on stdout.

    Parameters
    ----------
    text : str
        What UTF-8 cannot hold, such as the undecodable bytes of a file name, is escaped.

    Raises
    ------
    OutputError
        If stdout cannot be written, for example on a full disk.
    """
    try:
        click.echo(text.encode("utf-8", "backslashreplace").decode("utf-8"))
    except OSError as error:
        if error.errno == errno.EPIPE:
            raise
        sys.stdout = None  # what it still holds cannot be written at exit either
        raise OutputError(f"stdout: cannot be written: {error.strerror or error}") from error


def note(text: str) -> None:
    """Tell a person something that went well, on stderr."""
    # Nobody hears it when stderr is full or gone, and the work goes on.
    with contextlib.suppress(OSError):
        click.echo(f"beamseg: {_on_one_line(text)}", err=True)


def warn(text: str) -> None:
    """Tell a person something to look at, on stderr."""
    note(f"warning: {text}")


def complain(error: BeamsegError | str) -> None:
    """Tell a person why the command fails, on stderr: a line for each problem."""
    for problem in error.problems if isinstance(error, BeamsegError) else (error,):
        note(f"error: {problem}")


def _on_one_line(text: str) -> str:
    """Escape what would break a line or steer a terminal: file and topic names may hold it."""
    return "".join(
        char if char.isprintable() else char.encode("unicode_escape").decode("ascii")
        for char in text
    )


class ScanProgress:
    """Progress bar over the scans of a flight; silent where nobody watches.

    Parameters
    ----------
    enabled : bool
        The bar also needs a terminal on stderr.
    """

    def __init__(self, *, enabled: bool) -> None:
        self._shown = enabled and sys.stderr is not None and sys.stderr.isatty()
        self._bar: RichProgress | None = None
        self._task: Any = None
        self._preparing = threading.Timer(_PATIENCE_S, note, [_PREPARING])
        self._preparing.daemon = True

    def __enter__(self) -> ScanProgress:
        if self._shown:
            self._preparing.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._preparing.cancel()
        if self._bar is not None:
            self._bar.stop()

    def begin(self, n_clouds: int) -> None:
        """Show the bar."""
        self._preparing.cancel()
        if not self._shown:
            return
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
        from rich.progress import TimeRemainingColumn as TimeLeft

        self._bar = Progress(
            TextColumn("scans"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TextColumn("{task.fields[beams]} beams"),
            TimeLeft(),
            TextColumn("left"),
            console=Console(stderr=True),
            transient=True,
        )
        self._task = self._bar.add_task("scans", total=n_clouds, beams=0, rate="")
        self._bar.start()

    def step(self, n_segments: int) -> None:
        """Move the bar by one scan."""
        if self._bar is None:
            return
        task = self._bar.tasks[self._task]
        rate = _per_second(task.speed)
        self._bar.update(self._task, advance=1, beams=n_segments, rate=rate)


def _per_second(speed: float | None) -> str:
    """Rate of scans in two digits or more; nothing before it is known."""
    if not speed:
        return ""
    return f"{speed:.0f} scans/s" if speed >= 10 else f"{speed:.1f} scans/s"


def begin_work() -> None:
    """Collect garbage from here on, but not among what was imported so far."""
    gc.freeze()
    gc.enable()


@contextlib.contextmanager
def stop_on_interrupt() -> Iterator[Callable[[], bool]]:
    """Turn the first Ctrl-C into a wish to stop; the second one stops at once.

    Yields
    ------
    callable
        True once a stop was asked for.
    """
    asked = False

    def ask(_number: int, _frame: FrameType | None) -> None:
        nonlocal asked
        asked = True
        signal.signal(signal.SIGINT, signal.default_int_handler)
        note("stopping after this scan; press Ctrl-C again to stop at once")

    try:
        previous = signal.signal(signal.SIGINT, ask)
    except ValueError:  # not the main thread, so no signal can arrive
        yield lambda: asked
        return
    try:
        yield lambda: asked
    finally:
        signal.signal(signal.SIGINT, previous)
