"""ROS 2 bag folders: storage files with a ``metadata.yaml`` that lists them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from functools import partial
from pathlib import Path, PurePath

from beamseg_batch.errors import RecordingError
from beamseg_batch.recording.container import (
    Container,
    ContainerIndex,
    Damage,
    DamageLog,
    RawMessage,
    ReadLimits,
    Span,
)
from beamseg_batch.recording.merging import Part, in_time_order, readable_parts

__all__ = ["METADATA", "FolderContainer", "listed_files"]

METADATA = "metadata.yaml"
"""File that makes a folder a ROS 2 bag."""


class FolderContainer:
    """The storage files of a ROS 2 bag as one container.

    Parameters
    ----------
    path : Path
    containers : sequence of Container
        One for each storage file.
    limits : ReadLimits
    """

    def __init__(self, path: Path, containers: Sequence[Container], limits: ReadLimits) -> None:
        self.path = path
        self._containers = containers
        self._damage = DamageLog(limits.strict)
        self._parts: list[Part] = []

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What has been found to be damaged so far."""
        inside = (place for container in self._containers for place in container.damage)
        return (*self._damage.places, *inside)

    def files(self) -> tuple[Path, ...]:
        """Files that hold the messages, sorted by name."""
        return tuple(file for container in self._containers for file in container.files())

    def label(self, index: ContainerIndex) -> str:
        """Kind of container, for people."""
        mcap = any(".mcap" in file.name for file in self.files())
        return f"ROS 2 bag folder ({'mcap' if mcap else 'sqlite3'})"

    def index(self) -> ContainerIndex:
        """List the topics and the time span of all files."""
        self._parts = readable_parts(self._containers, self._damage)
        indexes = [index for _, index in self._parts]
        told = [index for index in indexes if index.count]
        return ContainerIndex(
            tuple(channel for index in indexes for channel in index.channels),
            min((index.start_ns for index in told), default=0),
            max((index.end_ns for index in told), default=0),
            sum(index.content_bytes for index in indexes),
        )

    def messages(self, topics: Collection[str], span: Span) -> Iterator[RawMessage]:
        """Stream the messages of some topics in order of log time."""
        return in_time_order(
            [(index.start_ns, partial(c.messages, topics, span)) for c, index in self._parts]
        )

    def n_left_out(self, topic: str, msgtype: str, span: Span) -> int:
        """Count the messages of a topic and type that are left out before a span."""
        return sum(c.n_left_out(topic, msgtype, span) for c, _ in self._parts)


def listed_files(folder: Path, there: Sequence[Path], damage: DamageLog) -> list[Path]:
    """Storage files of a ROS 2 bag, as its ``metadata.yaml`` lists them.

    Parameters
    ----------
    folder : Path
    there : sequence of Path
        Storage files in the folder.
    damage : DamageLog
        Where it is noted when list and folder disagree.

    Returns
    -------
    list of Path
        Those that are there; all of the folder when the list cannot be read.

    Raises
    ------
    RecordingError
        If none of them is there, or if damage is not tolerated.
    """
    names = _listed_names(folder / METADATA)
    if names is None:
        if not there:
            raise RecordingError(
                f"{folder}: its {METADATA} cannot be read, and no storage file is there"
            )
        damage.add(Damage(folder / METADATA, None, "cannot be read: all storage files are used"))
        return list(there)
    missing = [name for name in names if not (folder / name).is_file()]
    if names and len(missing) == len(names):
        raise RecordingError(
            f"{folder}: the storage files that {METADATA} lists are missing: {', '.join(missing)}"
        )
    for name in missing:
        damage.add(Damage(folder / name, None, f"is listed in {METADATA}, but is missing"))
    return [folder / name for name in names if name not in missing] or list(there)


def _listed_names(path: Path) -> list[str] | None:
    from ruamel.yaml import YAML

    try:
        tree = YAML(typ="safe").load(path.read_text(encoding="utf-8"))
        listed = tree["rosbag2_bagfile_information"]["relative_file_paths"]
        return [PurePath(name).name for name in listed]
    except Exception:  # whatever is wrong with it, its list is of no use
        return None
