"""The files of a recording: which kind each is.

Kinds are told by the first bytes, never by the name's ending; a new kind is one more
entry in `_KINDS` and one more class with the methods of `Container`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from beamseg_batch.errors import RecordingError, RecordingNotFoundError
from beamseg_batch.recording.container import (
    Channel,
    Container,
    ContainerIndex,
    Damage,
    DamageLog,
    RawMessage,
    ReadLimits,
    readable,
)
from beamseg_batch.recording.container_folder import METADATA, FolderContainer, listed_files
from beamseg_batch.recording.container_mcap import MCAP_MAGIC, McapFile
from beamseg_batch.recording.container_rosbag import ROSBAG_MAGIC, RosbagFile
from beamseg_batch.recording.container_sqlite import SQLITE_MAGIC, SqliteFile
from beamseg_batch.recording.container_zstd import ZSTD_MAGIC, ZstdFile

__all__ = [
    "Channel",
    "Container",
    "ContainerIndex",
    "Damage",
    "RawMessage",
    "ReadLimits",
    "open_containers",
]

_STORAGE_SUFFIXES = (".db3", ".mcap")
_BAG_SUFFIXES = (".bag", ".bag.active")
_COMPRESSED_SUFFIXES = (".zstd", ".zst")


def open_containers(path: Path, limits: ReadLimits, damage: DamageLog) -> list[Container]:
    """Find the containers behind a path.

    Parameters
    ----------
    path : Path
        A ROS 1 bag, a ROS 2 folder, its ``metadata.yaml`` or a storage file, an MCAP
        file, any of these files compressed with zstd, or a folder of such files, which
        gives one container per file.
    limits : ReadLimits
    damage : DamageLog
        Where files of a folder are noted that are no recordings.

    Returns
    -------
    list of Container

    Raises
    ------
    RecordingNotFoundError
        If there is nothing at the path.
    RecordingError
        If it cannot be read, is empty, or is none of these kinds.
    """
    if not path.exists():
        raise RecordingNotFoundError(f"{path}: no such file or folder")
    with readable(path):
        if path.is_dir():
            return _open_folder(path, limits, damage)
        if path.name == METADATA:
            return _open_folder(path.parent, limits, damage)
        return [_open_file(path, limits)]


def _open_folder(path: Path, limits: ReadLimits, damage: DamageLog) -> list[Container]:
    storage = _files(path, _STORAGE_SUFFIXES)
    if (path / METADATA).exists():
        listed = listed_files(path, storage, damage)
        return [FolderContainer(path, _open_parts(listed, limits, damage), limits)]
    files = storage + _files(path, _BAG_SUFFIXES)
    if not files:
        raise RecordingError(
            f"{path}: a folder without metadata.yaml, .db3, .mcap or .bag files is no recording; "
            "name the recording's own file"
        )
    return _open_parts(files, limits, damage)


def _open_parts(files: list[Path], limits: ReadLimits, damage: DamageLog) -> list[Container]:
    """Open the files of a folder; one that is no recording costs no other."""
    containers: list[Container] = []
    errors = []
    for file in files:
        try:
            containers.append(_open_file(file, limits))
        except RecordingError as error:
            errors.append(error)
            damage.add(Damage(file, None, str(error).removeprefix(f"{file}: ")))
    if errors and not containers:
        raise errors[0]
    return containers


def _files(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    """Files of a folder with one of some endings, compressed ones included, sorted by name."""
    return sorted(file for file in folder.iterdir() if _plain_name(file).endswith(suffixes))


def _plain_name(file: Path) -> str:
    name = file.name
    for suffix in _COMPRESSED_SUFFIXES:
        name = name.removesuffix(suffix)
    return name


def _open_file(path: Path, limits: ReadLimits) -> Container:
    if not path.is_file():
        raise RecordingError(f"{path}: not a regular file")
    with path.open("rb") as stream:
        start = stream.read(16)
    if not start:
        raise RecordingError(f"{path}: the file is empty (0 bytes)")
    for magic, kind in _KINDS.items():
        if start.startswith(magic):
            return kind(path, limits)
    raise RecordingError(
        f"{path}: not a ROS 1 bag, ROS 2 bag or MCAP file: it starts with {start!r}"
    )


_KINDS: Mapping[bytes, Callable[[Path, ReadLimits], Container]] = {
    ROSBAG_MAGIC: RosbagFile,
    MCAP_MAGIC: McapFile,
    SQLITE_MAGIC: SqliteFile,
    ZSTD_MAGIC: lambda path, limits: ZstdFile(path, limits, _open_file),
}
"""Kinds of files by the bytes they start with."""
