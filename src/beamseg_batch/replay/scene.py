"""What is shown of a structure while a flight is replayed: beams, joints and their names."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from beamseg_batch.bars import Bar, beams_of
from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import FlightResult
from beamseg_batch.outputs.columns import segment_columns, time_origin_ns
from beamseg_batch.prisms import mesh_of
from beamseg_batch.recording.pose_arrays import quaternion_from_matrix
from beamseg_batch.recording.writing import MessageWriter

__all__ = ["MARKER_ARRAY", "SCENE_UPDATE", "Scene"]

MARKER_ARRAY = "visualization_msgs/msg/MarkerArray"
SCENE_UPDATE = "foxglove_msgs/msg/SceneUpdate"
_MARKER = "visualization_msgs/msg/Marker"
_STAMP = struct.Struct("<iI")  # seconds and nanoseconds, in ROS 1 and in CDR
_SOME_NS = 2_141_447_582_722_982_121
"""A stamp that no flight has: it is replaced in the bytes of a message."""
_SPHERE, _CYLINDER, _TEXT, _TRIANGLES = 2, 3, 9, 11  # of visualization_msgs/Marker
_ADD, _DELETE_ALL = 0, 3
_BLUE, _RED, _WHITE = (0.27, 0.51, 0.71, 0.9), (0.86, 0.2, 0.18, 1.0), (1.0, 1.0, 1.0, 1.0)
_LABEL_HEIGHT = 0.08
_LEAST_BALL = 0.06
_UNTURNED = np.array([0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class _Thing:
    """Something that is shown from an instant on: its markers and its part of the scene."""

    since_ns: int
    markers: tuple[dict[str, Any], ...]
    entity: dict[str, Any]


class Scene:
    """Markers and scene updates of a structure, scan by scan.

    Parameters
    ----------
    result : FlightResult
    writer : MessageWriter
    frame : str
        Name of the world frame.

    Notes
    -----
    Every message shows all that was seen by then, so that a viewer may jump to any
    instant. Geometry is that of the end: a beam appears where it was finally found.
    """

    def __init__(self, result: FlightResult, writer: MessageWriter, frame: str) -> None:
        self._writer = writer
        self._frame = frame
        self._is_first = True
        self._made: dict[str, tuple[int, bytes]] = {}
        self._marker_defaults = self._defaults()
        self._things = [*self._beams(result), *self._intersections(result)]

    def markers(self, stamp_ns: int) -> bytes:
        """Make the MarkerArray of a scan; the first one removes what a viewer had before."""
        if self._is_first:
            self._is_first = False
            first = self._markers(self._shown(stamp_ns), clear=True)
            return _stamped(self._writer.serialise(MARKER_ARRAY, first), stamp_ns)
        return self._message(MARKER_ARRAY, stamp_ns, self._markers)

    def update(self, stamp_ns: int) -> bytes:
        """Make Foxglove's SceneUpdate of a scan."""
        return self._message(SCENE_UPDATE, stamp_ns, self._update)

    def _message(self, msgtype: str, stamp_ns: int, build: Callable[[list[_Thing]], Any]) -> bytes:
        """Bytes of a message: those of the scan before, with another stamp, if no thing is new."""
        shown = self._shown(stamp_ns)
        count, raw = self._made.get(msgtype, (-1, b""))
        if count != len(shown):
            raw = self._writer.serialise(msgtype, build(shown))
            self._made[msgtype] = len(shown), raw
        return _stamped(raw, stamp_ns)

    def _shown(self, stamp_ns: int) -> list[_Thing]:
        return [thing for thing in self._things if thing.since_ns <= stamp_ns]

    def _markers(self, things: list[_Thing], clear: bool = False) -> Any:
        header = self._writer.header("", _SOME_NS, self._frame)
        clearing = [{"action": _DELETE_ALL}] if clear else []
        shown = [values for thing in things for values in thing.markers]
        fields = [self._marker_defaults | {"header": header} | one for one in [*clearing, *shown]]
        return self._make(MARKER_ARRAY, [self._make(_MARKER, *one.values()) for one in fields])

    def _update(self, things: list[_Thing]) -> Any:
        time = self._make("builtin_interfaces/msg/Time", *divmod(_SOME_NS, 10**9))
        entities = [self._foxglove("SceneEntity", time, *thing.entity.values()) for thing in things]
        return self._foxglove("SceneUpdate", [], entities)

    def _beams(self, result: FlightResult) -> Iterator[_Thing]:
        columns = segment_columns(result.segments, time_origin_ns(result))
        for bar, segment in zip(beams_of(columns), result.segments, strict=True):
            label = f"{bar.number}: {bar.length:.2f} m"
            above = (bar.start + bar.end) / 2.0
            above[2] += segment.radius + _LABEL_HEIGHT
            solid, primitives = self._solid(bar)
            yield _Thing(
                segment.first_seen_ns,
                (solid, self._text(bar.number, above, label)),
                self._entity(
                    f"beam {bar.number}",
                    {"length": f"{bar.length:.4f} m", "radius": f"{bar.radius:.4f} m"},
                    **primitives,
                    texts=[self._label(above, label)],
                ),
            )

    def _solid(self, bar: Bar) -> tuple[dict[str, Any], dict[str, list[Any]]]:
        """Marker and scene primitive of a beam: a cylinder, or a mesh if it is none."""
        if bar.section.shape != "round" or len(bar.nodes) > 2:
            return self._meshed(bar)
        middle = (bar.start + bar.end) / 2.0
        pose = self._writer.pose(middle, quaternion_from_matrix(bar.rotation))
        size = self._vector([2.0 * bar.radius, 2.0 * bar.radius, bar.length])
        marker = {
            "ns": "cylinders", "id": bar.number, "type": _CYLINDER, "pose": pose, "scale": size,
            "color": self._colour(_BLUE),
        }  # fmt: skip
        cylinder = self._foxglove("CylinderPrimitive", pose, size, 1.0, 1.0, self._tint(_BLUE))
        return marker, {"cylinders": [cylinder]}

    def _meshed(self, bar: Bar) -> tuple[dict[str, Any], dict[str, list[Any]]]:
        mesh = mesh_of(bar)
        corners = [self._point(corner) for corner in mesh.vertices[mesh.triangles].reshape(-1, 3)]
        pose = self._writer.pose(np.zeros(3), _UNTURNED)
        marker = {
            "ns": "sections", "id": bar.number, "type": _TRIANGLES, "pose": pose,
            "scale": self._vector([1.0, 1.0, 1.0]), "color": self._colour(_BLUE),
            "points": corners,
        }  # fmt: skip
        none = np.empty(0, dtype=np.uint32)
        triangles = self._foxglove(
            "TriangleListPrimitive", pose, corners, self._tint(_BLUE), [], none
        )
        return marker, {"triangles": [triangles]}

    def _intersections(self, result: FlightResult) -> Iterator[_Thing]:
        for number, meeting in enumerate(result.intersections):
            pair = [result.segments[k] for k in (meeting.segment_1, meeting.segment_2)]
            diameter = max(_LEAST_BALL, *(2.5 * segment.radius for segment in pair))
            pose = self._writer.pose(meeting.position, _UNTURNED)
            size = self._vector([diameter] * 3)
            marker = {
                "ns": "intersections", "id": number, "type": _SPHERE, "pose": pose, "scale": size,
                "color": self._colour(_RED),
            }  # fmt: skip
            ball = self._foxglove("SpherePrimitive", pose, size, self._tint(_RED))
            yield _Thing(
                max(segment.first_seen_ns for segment in pair),
                (marker,),
                self._entity(
                    f"intersection {number}",
                    {"beams": f"{meeting.segment_1}, {meeting.segment_2}"},
                    spheres=[ball],
                ),
            )

    def _text(self, number: int, position: FloatArray, text: str) -> dict[str, Any]:
        return {
            "ns": "labels", "id": number, "type": _TEXT, "text": text,
            "pose": self._writer.pose(position, _UNTURNED),
            "scale": self._vector([0.0, 0.0, _LABEL_HEIGHT]), "color": self._colour(_WHITE),
        }  # fmt: skip

    def _label(self, position: FloatArray, text: str) -> Any:
        pose = self._writer.pose(position, _UNTURNED)
        tint = self._tint(_WHITE)
        return self._foxglove("TextPrimitive", pose, True, _LABEL_HEIGHT, False, tint, text)

    def _entity(self, name: str, metadata: dict[str, str], **primitives: Any) -> dict[str, Any]:
        """Fields of a scene entity after its stamp, in their order."""
        pairs = [self._foxglove("KeyValuePair", key, value) for key, value in metadata.items()]
        kinds = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
        return {
            "frame_id": self._frame,
            "id": name,
            "lifetime": self._make("builtin_interfaces/msg/Duration", 0, 0),
            "frame_locked": False,
            "metadata": pairs,
            **{kind: primitives.get(kind, []) for kind in kinds},
        }

    def _defaults(self) -> dict[str, Any]:
        """Fields of a marker in their order, with what they are unless said otherwise."""
        no_bytes = np.empty(0, dtype=np.uint8)
        blank = self._writer.header("", 0, "")
        values = {
            "header": blank,
            "ns": "",
            "id": 0,
            "type": 0,
            "action": _ADD,
            "pose": self._writer.pose(np.zeros(3), _UNTURNED),
            "scale": self._vector([0.0] * 3),
            "color": self._colour((0.0,) * 4),
            "lifetime": self._make("builtin_interfaces/msg/Duration", 0, 0),
            "frame_locked": False,
            "points": [],
            "colors": [],
            "texture_resource": "",
            "uv_coordinates": [],
            "text": "",
            "mesh_resource": "",
            "mesh_use_embedded_materials": False,
        }
        names = self._writer.fields(_MARKER)
        if "texture" in names:  # of ROS 2
            image = self._make("sensor_msgs/msg/CompressedImage", blank, "", no_bytes)
            values["texture"] = image
            values["mesh_file"] = self._make("visualization_msgs/msg/MeshFile", "", no_bytes)
        return {name: values[name] for name in names}

    def _make(self, msgtype: str, *values: Any) -> Any:
        return self._writer.make(msgtype, *values)

    def _foxglove(self, name: str, *values: Any) -> Any:
        return self._make(f"foxglove_msgs/msg/{name}", *values)

    def _vector(self, values: list[float]) -> Any:
        return self._make("geometry_msgs/msg/Vector3", *values)

    def _point(self, position: FloatArray) -> Any:
        return self._make("geometry_msgs/msg/Point", *position.tolist())

    def _colour(self, rgba: tuple[float, ...]) -> Any:
        return self._make("std_msgs/msg/ColorRGBA", *rgba)

    def _tint(self, rgba: tuple[float, ...]) -> Any:
        return self._foxglove("Color", *rgba)


def _stamped(raw: bytes, stamp_ns: int) -> bytes:
    """Bytes of a message with the stamp of a scan."""
    some, stamp = (_STAMP.pack(*divmod(ns, 10**9)) for ns in (_SOME_NS, stamp_ns))
    return raw.replace(some, stamp)
