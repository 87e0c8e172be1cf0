"""The first message of a topic, which tells what the others are like."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

from beamseg_batch.recording.codec import UndecodableMessageError
from beamseg_batch.recording.source import Recording, TopicInfo

__all__ = ["read_first"]

T = TypeVar("T")


def read_first(recording: Recording, topic: TopicInfo, extract: Callable[[Any], T]) -> T | None:
    """Read the first message of a topic that can be decoded.

    Parameters
    ----------
    recording : Recording
    topic : TopicInfo
    extract : callable
        From the message object to the result.

    Returns
    -------
    object or None
        What `extract` returns; None when no message can be decoded.

    Raises
    ------
    RecordingError
        If the file cannot be read.
    """
    for raw in recording.topic_messages(topic):
        with suppress(UndecodableMessageError):
            return recording.read(raw, extract)
    return None
