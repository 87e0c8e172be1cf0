"""Which clouds of a recording are used: told by their log time and count, before decoding."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from beamseg_batch.config import RecordingConfig
from beamseg_batch.recording.container import Span
from beamseg_batch.recording.containers import RawMessage
from beamseg_batch.recording.matching import seconds_to_ns
from beamseg_batch.recording.source import Recording, TopicInfo

__all__ = ["Selection"]

_MOST_DISORDER_NS = 5_000_000_000
"""How much later than its neighbours a message without an index may stand in the file."""


@dataclass(frozen=True)
class Selection:
    """A range of log time, and how many of the clouds in it.

    Attributes
    ----------
    start_ns, stop_ns : int or None
        Log times from which and up to which, this one excluded; None is no bound.
    every : int
        Of those in the range every so manieth, the first included.
    most : int or None
        Of those the first so many.
    """

    start_ns: int | None
    stop_ns: int | None
    every: int
    most: int | None

    @classmethod
    def of(cls, config: RecordingConfig, recording: Recording) -> Selection:
        """Selection that a configuration asks for."""
        start_ns = recording.start_ns + seconds_to_ns(config.start_s)
        return cls(
            start_ns if config.start_s else None,
            None if config.duration_s is None else start_ns + seconds_to_ns(config.duration_s),
            config.every,
            config.max_scans,
        )

    @property
    def is_timed(self) -> bool:
        """Whether the range of time has a bound."""
        return self.start_ns is not None or self.stop_ns is not None

    def span(self, margin_ns: int = _MOST_DISORDER_NS) -> Span:
        """Range of log time in which what is used is found, and a margin on both sides."""
        first_ns, last_ns = Span()
        if self.start_ns is not None:
            first_ns = self.start_ns - margin_ns
        return Span(first_ns, last_ns if self.stop_ns is None else self.stop_ns + margin_ns)

    def messages(self, recording: Recording, topic: TopicInfo) -> Iterator[tuple[int, RawMessage]]:
        """Stream the messages that are used; what lies before them is not read.

        Parameters
        ----------
        recording : Recording
        topic : TopicInfo

        Yields
        ------
        int
            Position among all messages of the topic, from 0.
        RawMessage

        Raises
        ------
        RecordingError
            If a file cannot be read any further.
        """
        part = recording.within(self.span())
        first = part.n_left_out(topic) if self.start_ns is not None else 0
        return self._picked(enumerate(part.topic_messages(topic), first))

    def _picked(
        self, messages: Iterator[tuple[int, RawMessage]]
    ) -> Iterator[tuple[int, RawMessage]]:
        """Pick the messages that are used out of those of one topic, in order of log time.

        Yields
        ------
        int
            Position among all messages of the topic, from 0.
        RawMessage
        """
        n_inside = n_picked = 0
        for index, raw in messages:
            if self.most is not None and n_picked >= self.most:
                return
            if self.stop_ns is not None and raw.log_time_ns >= self.stop_ns:
                if raw.log_time_ns >= self.stop_ns + _MOST_DISORDER_NS:
                    return
                continue
            if self.start_ns is not None and raw.log_time_ns < self.start_ns:
                continue
            n_inside += 1
            if (n_inside - 1) % self.every == 0:
                n_picked += 1
                yield index, raw

    def count(self, recording: Recording, topic: TopicInfo) -> int:
        """Count the messages of a topic that are used; a range of time costs a pass over them.

        Parameters
        ----------
        recording : Recording
        topic : TopicInfo

        Returns
        -------
        int
        """
        if self.is_timed:
            return sum(1 for _ in self.messages(recording, topic))
        picked = -(-topic.count // self.every)
        return picked if self.most is None else min(picked, self.most)
