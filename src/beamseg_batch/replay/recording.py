"""Writing what a flight's viewers show: markers, clouds and transforms."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.errors import ConfigError
from beamseg_batch.geometry import FloatArray, RigidTransform
from beamseg_batch.model import Detections, FlightResult
from beamseg_batch.outputs.single_file import check_file, staged_file
from beamseg_batch.recording.pose_arrays import quaternion_from_matrix
from beamseg_batch.recording.writing import (
    STATIC_TOPIC,
    MessageWriter,
    RecordingKind,
    open_writer,
)
from beamseg_batch.replay.foxglove import SCENE_TYPES
from beamseg_batch.replay.frames import ViewFrames
from beamseg_batch.replay.scene import MARKER_ARRAY, SCENE_UPDATE, Scene

__all__ = ["FILTERED", "HOUGH", "MARKERS", "SCENE", "TRANSFORMS", "check_views", "record_views"]

MARKERS, FILTERED, HOUGH = "/markers", "/filtered_pointcloud", "/hough_pointcloud"
"""Topics of the original node."""
TRANSFORMS = "/tf"
SCENE = "/beams"
"""Topic of Foxglove's scene; in MCAP only."""

_KINDS = {".mcap": RecordingKind("mcap", "zstd"), ".bag": RecordingKind("bag", "lz4")}


def check_views(path: Path, *, overwrite: bool = False) -> None:
    """Say early whether a replay could be written.

    Parameters
    ----------
    path : Path
    overwrite : bool

    Raises
    ------
    ConfigError
        If its ending is neither ``.mcap`` nor ``.bag``.
    OutputError
        If the file is there already, or cannot be written.
    """
    _kind(path)
    check_file(path, overwrite=overwrite)


def record_views(
    result: FlightResult, detections: Iterable[Detections], path: Path, *, overwrite: bool = False
) -> int:
    """Write a recording that shows a processed flight in RViz and Foxglove.

    Parameters
    ----------
    result : FlightResult
    detections : iterable of Detections
        Of every scan of the result, in order, as `pipeline.search_scans` gives them. Only
        one is held at a time.
    path : Path
        An MCAP file (ROS 2) or a ROS 1 bag, by its ending. It is whole or absent.
    overwrite : bool, optional

    Returns
    -------
    int
        Number of scans: of the messages of each topic but ``/tf_static``.

    Raises
    ------
    ConfigError
        If the ending is neither.
    OutputError
        If the file is there already, or cannot be written.

    Notes
    -----
    Headers hold the stamps of the scans; messages are logged when their cloud was.
    """
    kind = _kind(path)
    count = 0
    with staged_file(path, overwrite=overwrite) as staged, open_writer(staged, kind) as writer:
        for name, text in SCENE_TYPES.items():
            writer.register(f"foxglove_msgs/msg/{name}", text)
        views = _Views(writer, result, has_scene=kind.format == "mcap")
        for found in islice(detections, len(result.scans)):
            views.write(found)
            count += 1
    return count


def _kind(path: Path) -> RecordingKind:
    kind = _KINDS.get(path.suffix.lower())
    if kind is None:
        raise ConfigError(f"{path}: end the name of the replay in {' or '.join(_KINDS)}")
    return kind


class _Views:
    """Writes the messages of one scan after the other."""

    def __init__(self, writer: MessageWriter, result: FlightResult, has_scene: bool) -> None:
        self._writer = writer
        self._frames = ViewFrames.of(result.recording)
        self._scene = Scene(result, writer, self._frames.world)
        self._has_scene = has_scene
        self._is_first = True

    def write(self, found: Detections) -> None:
        """Write what a scan gave, transforms first."""
        scan, frames = found.scan, self._frames
        log_ns = scan.stamp_ns if scan.log_ns is None else scan.log_ns
        stamp_ns = scan.stamp_ns
        if self._is_first and frames.has_extrinsic:
            pair = (frames.body, frames.camera)
            self._transform(STATIC_TOPIC, log_ns, stamp_ns, pair, frames.T_body_camera)
        self._is_first = False
        pair = (frames.world, frames.body)
        self._transform(TRANSFORMS, log_ns, stamp_ns, pair, scan.T_world_body)

        T_camera_world = frames.T_camera_sensor @ scan.T_world_sensor.inverse()
        points = [segment.points for segment in found.segments]
        on_lines = np.concatenate(points) if points else np.empty((0, 3))
        for topic, cloud in ((FILTERED, found.cloud), (HOUGH, on_lines)):
            seen = _cloud(T_camera_world.apply(cloud.astype(np.float64)))
            self._writer.cloud(topic, log_ns, stamp_ns, frames.camera, seen)

        self._writer.write(MARKERS, MARKER_ARRAY, log_ns, self._scene.markers(stamp_ns))
        if self._has_scene:
            self._writer.write(SCENE, SCENE_UPDATE, log_ns, self._scene.update(stamp_ns))

    def _transform(
        self,
        topic: str,
        log_ns: int,
        stamp_ns: int,
        frames: tuple[str, str],
        transform: RigidTransform,
    ) -> None:
        quaternion = quaternion_from_matrix(transform.rotation)
        self._writer.transform(topic, log_ns, stamp_ns, frames, transform.translation, quaternion)


def _cloud(points: FloatArray) -> NDArray[np.float32]:
    """Points (N, 3) as a cloud of one row."""
    return points.astype(np.float32)[None]
