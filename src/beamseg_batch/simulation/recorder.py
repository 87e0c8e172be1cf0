"""Clouds, poses and static transforms of a simulated flight -> a recording."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.geometry import FloatArray
from beamseg_batch.recording.writing import (
    FORMATS,
    STATIC_TOPIC,
    MessageWriter,
    RecordingKind,
    choose_kind,
    open_writer,
)

__all__ = ["FORMATS", "Recorder", "RecordingKind", "choose_kind", "open_recorder"]

CLOUD_TOPIC = "/tof_pc"
POSE_TOPIC = "/mavros/local_position/pose"
_POSE = "geometry_msgs/msg/PoseStamped"


@dataclass(frozen=True, eq=False)
class Recorder:
    """Writes the messages of a flight; made by `open_recorder`."""

    writer: MessageWriter

    def cloud(self, log_ns: int, stamp_ns: int, frame: str, points: NDArray[np.float32]) -> None:
        """Write a cloud.

        Parameters
        ----------
        log_ns, stamp_ns : int
            When it was received, and the stamp in its header.
        frame : str
        points : (H, W, 3) float32, metres
            Not finite without return.
        """
        self.writer.cloud(CLOUD_TOPIC, log_ns, stamp_ns, frame, points)

    def pose(
        self, log_ns: int, stamp_ns: int, frame: str, position: FloatArray, quaternion: FloatArray
    ) -> None:
        """Write a pose: `position` (3,) metres, `quaternion` (4,) x, y, z, w."""
        header = self.writer.header(POSE_TOPIC, stamp_ns, frame)
        pose = self.writer.make(_POSE, header, self.writer.pose(position, quaternion))
        self.writer.write(POSE_TOPIC, _POSE, log_ns, pose)

    def static_transform(
        self, log_ns: int, parent: str, child: str, translation: FloatArray, quaternion: FloatArray
    ) -> None:
        """Write a static transform, ``T_parent_child``."""
        frames = (parent, child)
        self.writer.transform(STATIC_TOPIC, log_ns, log_ns, frames, translation, quaternion)


@contextmanager
def open_recorder(path: Path, kind: RecordingKind) -> Iterator[Recorder]:
    """Open a recording to write.

    Parameters
    ----------
    path : Path
        Where nothing is yet.
    kind : RecordingKind

    Yields
    ------
    Recorder
    """
    with open_writer(path, kind) as writer:
        yield Recorder(writer)
