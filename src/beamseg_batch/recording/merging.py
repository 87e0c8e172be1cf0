"""Several containers as one: in order of time, and without those that cannot be read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from heapq import heappop, heappush, heapreplace
from operator import itemgetter
from typing import TypeAlias

from beamseg_batch.errors import RecordingError
from beamseg_batch.recording.container import (
    Container,
    ContainerIndex,
    Damage,
    DamageLog,
    RawMessage,
)

__all__ = ["in_time_order", "readable_parts"]

Part: TypeAlias = tuple[Container, ContainerIndex]


def readable_parts(containers: Sequence[Container], damage: DamageLog) -> list[Part]:
    """Index containers; one that cannot be read costs no other.

    Parameters
    ----------
    containers : sequence of Container
    damage : DamageLog
        Where those are noted that cannot be read.

    Returns
    -------
    list of (Container, ContainerIndex)

    Raises
    ------
    RecordingError
        If none can be read, or if one cannot and that is not tolerated.
    """
    parts: list[Part] = []
    first_error: RecordingError | None = None
    for container in containers:
        try:
            parts.append((container, container.index()))
        except RecordingError as error:
            first_error = first_error or error
            if len(containers) > 1:
                reason = str(error).removeprefix(f"{container.path}: ")
                damage.add(Damage(container.path, None, f"nothing of it can be read: {reason}"))
    if first_error and not parts:
        raise first_error
    return parts


def in_time_order(
    parts: Sequence[tuple[int, Callable[[], Iterator[RawMessage]]]],
) -> Iterator[RawMessage]:
    """Merge streams of messages by log time.

    Parameters
    ----------
    parts : sequence of (start_ns, callable)
        When a stream begins, and what opens it; none is opened before its time comes.

    Yields
    ------
    RawMessage
    """
    waiting = sorted(parts, key=itemgetter(0), reverse=True)
    heads: list[tuple[int, int, RawMessage, Iterator[RawMessage]]] = []
    while waiting or heads:
        while waiting and (not heads or waiting[-1][0] <= heads[0][0]):
            stream = waiting.pop()[1]()
            if message := next(stream, None):
                heappush(heads, (message.log_time_ns, -len(waiting), message, stream))
        if not heads:
            return
        _, number, message, stream = heads[0]
        yield message
        if following := next(stream, None):
            heapreplace(heads, (following.log_time_ns, number, following, stream))
        else:
            heappop(heads)
