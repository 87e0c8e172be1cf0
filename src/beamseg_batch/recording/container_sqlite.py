"""ROS 2 bags in SQLite files (``.db3``), of any version, finished or not."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import Any

from beamseg_batch.errors import RecordingError
from beamseg_batch.recording.codec import CDR, Definition, ros2_name
from beamseg_batch.recording.container import (
    Channel,
    ContainerIndex,
    Damage,
    DamageLog,
    RawMessage,
    ReadLimits,
    Span,
    readable,
)

__all__ = ["SQLITE_MAGIC", "SqliteFile"]

SQLITE_MAGIC = b"SQLite format 3\0"
"""What an SQLite file begins with."""

_LANGUAGES = {"ros2msg": "msg", "ros2idl": "idl"}
_SIDECARS = ("-wal", "-journal")
_LARGEST_SKIP = 1 << 16
_SELECT = "SELECT id, topic_id, timestamp, data FROM messages"
_IN_SPAN = "timestamp BETWEEN ? AND ?"


class SqliteFile:
    """A ROS 2 bag in one SQLite file.

    Parameters
    ----------
    path : Path
    limits : ReadLimits
    """

    def __init__(self, path: Path, limits: ReadLimits) -> None:
        self.path = path
        self._damage = DamageLog(limits.strict)
        self._channels: dict[int, Channel] = {}
        self._damaged = False

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What has been found to be damaged so far."""
        return self._damage.places

    def files(self) -> tuple[Path, ...]:
        """The file."""
        return (self.path,)

    def label(self, index: ContainerIndex) -> str:
        """Kind of file, for people."""
        return "ROS 2 bag file (sqlite3)"

    def index(self) -> ContainerIndex:
        """List the topics and the time span.

        Returns
        -------
        ContainerIndex

        Raises
        ------
        RecordingError
            If the file cannot be read, or is damaged and that is not tolerated.
        """
        with self._opened() as database:
            self._channels = self._read_channels(database)
            try:
                counts, first, last = _span(database)
            except sqlite3.DatabaseError as error:
                self._damaged = True
                counts, first, last = self._salvaged_span(database, error)
        channels = tuple(
            Channel(c.topic, c.msgtype, c.definition, counts[key])
            for key, c in self._channels.items()
        )
        return ContainerIndex(channels, first, last, self.path.stat().st_size)

    def messages(self, topics: Collection[str], span: Span) -> Iterator[RawMessage]:
        """Stream the messages of some topics in order of log time; of a damaged file in file order.

        Parameters
        ----------
        topics : collection of str
        span : Span
            Of a damaged file, all messages are read all the same.

        Yields
        ------
        RawMessage

        Raises
        ------
        RecordingError
            If the file cannot be read, or is damaged and that is not tolerated.
        """
        wanted = {key: c for key, c in self._channels.items() if c.topic in topics}
        with self._opened() as database:
            damaged = self._damaged
            rows = self._salvaged(database) if damaged else self._rows(database, wanted, span)
            for _, key, log_time_ns, data in rows:
                channel = wanted.get(key)
                if channel is not None:
                    yield RawMessage(channel.topic, log_time_ns, channel.msgtype, data)

    def n_left_out(self, topic: str, msgtype: str, span: Span) -> int:
        """Count the messages of a topic and type before a span; none of a damaged file."""
        keys = [k for k, c in self._channels.items() if (c.topic, c.msgtype) == (topic, msgtype)]
        places = ",".join("?" * len(keys))
        query = f"SELECT COUNT(*) FROM messages WHERE topic_id IN ({places}) AND timestamp < ?"
        with self._opened() as database:
            if not self._damaged:
                with suppress(sqlite3.DatabaseError):
                    (count,) = database.execute(query, (*keys, span.first_ns)).fetchone()
                    return int(count)
        return 0

    @contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        """Open the file without ever writing to it or beside it.

        What a recorder that was killed left beside the file belongs to it: SQLite takes
        it in, but into the file itself, so that this is done in a copy.
        """
        path = self.path
        sidecars = [path.with_name(path.name + ending) for ending in _SIDECARS]
        with readable(self.path), ExitStack() as stack:
            sidecars = [file for file in sidecars if file.exists() and file.stat().st_size]
            if sidecars:
                folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="beamseg-"))
                for file in (path, *sidecars):
                    shutil.copy(file, folder)
                path = Path(folder, path.name)
            mode = "mode=rwc" if sidecars else "mode=ro&immutable=1"
            uri = f"{path.absolute().as_uri()}?{mode}"
            with closing(sqlite3.connect(uri, uri=True, isolation_level=None)) as database:
                database.text_factory = lambda text: text.decode(errors="replace")
                # So that a file that was cut can be opened at all; nothing is written.
                database.execute("PRAGMA writable_schema=ON")
                yield database

    def _read_channels(self, database: sqlite3.Connection) -> dict[int, Channel]:
        try:
            _check_tables(database)
            topics = database.execute("SELECT id, name, type, serialization_format FROM topics")
            rows = topics.fetchall()
        except sqlite3.DatabaseError as error:
            raise RecordingError(
                f"{self.path}: an SQLite file, but no ROS 2 bag that can be read: {error}"
            ) from error
        texts = _definitions(database)
        channels = {}
        for key, name, msgtype, encoding in rows:
            language, text = texts.get(msgtype, ("", ""))
            definition = Definition(encoding or CDR, language, text)
            channels[key] = Channel(str(name), ros2_name(str(msgtype)), definition, 0)
        return channels

    def _rows(
        self, database: sqlite3.Connection, wanted: Collection[int], span: Span
    ) -> Iterator[Any]:
        """Rows by time; from the first that cannot be read on, whatever else can be read."""
        places = ",".join("?" * len(wanted))
        query = f"{_SELECT} WHERE topic_id IN ({places}) AND {_IN_SPAN} ORDER BY timestamp"
        given: set[int] = set()
        try:
            for row in database.execute(query, (*wanted, *span)):
                _check_order(row[0] not in given)
                given.add(row[0])
                if _is_sound(row):
                    yield row
        except sqlite3.DatabaseError as error:
            self._damaged = True
            self._note(error)
            yield from (row for row in self._salvaged(database) if row[0] not in given)

    def _salvaged(self, database: sqlite3.Connection) -> Iterator[Any]:
        """Rows by number; where one cannot be read, the search goes on behind it.

        Each further row in a row that cannot be read doubles the step.
        """
        after, skip = 0, 1
        while skip <= _LARGEST_SKIP:
            try:
                for row in database.execute(f"{_SELECT} WHERE id > ? ORDER BY id", (after,)):
                    _check_order(row[0] > after)
                    after, skip = row[0], 1
                    if _is_sound(row):
                        yield row
            except sqlite3.DatabaseError as error:
                self._note(error)
                after, skip = after + skip, 2 * skip
            else:
                return

    def _salvaged_span(
        self, database: sqlite3.Connection, error: Exception
    ) -> tuple[Counter[int], int, int]:
        self._note(error)
        counts: Counter[int] = Counter()
        first, last = 2**63, 0
        for _, key, log_time_ns, _ in self._salvaged(database):
            counts[key] += 1
            first, last = min(first, log_time_ns), max(last, log_time_ns)
        return counts, first if counts else 0, last

    def _note(self, error: Exception) -> None:
        problem = f"some messages cannot be read ({error})"
        self._damage.add(Damage(self.path, None, problem))


def _check_tables(database: sqlite3.Connection) -> None:
    """Refuse views in place of tables: they could compute rows without end."""
    kinds = dict(database.execute("SELECT name, type FROM sqlite_master").fetchall())
    for name in ("topics", "messages"):
        if kinds.get(name) != "table":
            raise sqlite3.DatabaseError(f"no such table: {name}")


def _definitions(database: sqlite3.Connection) -> dict[str, tuple[str, str]]:
    """Language and text of the definitions, which bags before 2023 do not hold."""
    query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
    try:
        rows = database.execute(query).fetchall()
    except sqlite3.DatabaseError:
        return {}
    return {
        msgtype: (_LANGUAGES[encoding], str(text))
        for msgtype, encoding, text in rows
        if encoding in _LANGUAGES
    }


def _span(database: sqlite3.Connection) -> tuple[Counter[int], int, int]:
    """Number of messages by topic, and the log times of the first and the last."""
    query = "SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp) FROM messages GROUP BY 1"
    rows = database.execute(query).fetchall()
    counts = Counter({key: count for key, count, _, _ in rows})
    times = [time for _, _, *span in rows for time in span if isinstance(time, int)]
    return counts, min(times, default=0), max(times, default=0)


def _check_order(holds: bool) -> None:
    """Refuse rows that come again: a damaged tree may have no end."""
    if not holds:
        raise sqlite3.DatabaseError("rows are out of order")


def _is_sound(row: tuple[object, ...]) -> bool:
    """Whether the columns of a row have the types that they should have."""
    *numbers, data = row
    return isinstance(data, bytes) and all(isinstance(number, int) for number in numbers)
