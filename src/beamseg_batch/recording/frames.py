"""Which frame is the sensor, the body and the world, and where the sensor sits on the body.

Roles come from the pose topic and the transform tree, never from names: the original
node's logs call the moving drone frame ``world`` and the fixed one ``mocap``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from beamseg_batch.config import RecordingConfig, SensorConfig
from beamseg_batch.errors import AmbiguousTopicError
from beamseg_batch.geometry import RigidTransform, matrix_from_rpy
from beamseg_batch.recording.poses import Edge, read_tracks, usable_poses
from beamseg_batch.recording.source import Recording
from beamseg_batch.recording.topics import is_static_tf

__all__ = [
    "Extrinsic",
    "FrameRoles",
    "TransformTree",
    "choose_track_edge",
    "find_extrinsic",
    "find_roles",
    "lineage",
    "listed_edges",
    "named_edges",
    "read_static_tree",
    "tree_of",
]


class TransformTree:
    """Static transforms: each child frame with its parent frame.

    Parameters
    ----------
    transforms : mapping of str to (str, RigidTransform)
        By child frame: the parent's name and ``T_parent_child``.
    """

    def __init__(self, transforms: Mapping[str, tuple[str, RigidTransform]]) -> None:
        self._transforms = dict(transforms)

    @property
    def parents(self) -> dict[str, str]:
        """Parent of each child frame."""
        return {child: parent for child, (parent, _) in self._transforms.items()}

    def transform(self, target: str, source: str) -> RigidTransform | None:
        """Transform between two frames, along the tree in any direction.

        Parameters
        ----------
        target, source : str

        Returns
        -------
        RigidTransform or None
            ``T_target_source``; None when the tree does not link the frames.
        """
        up_source, up_target = (lineage(frame, self.parents) for frame in (source, target))
        common = next((frame for frame in up_source if frame in up_target), None)
        if common is None:
            return None
        return self._up(target, common).inverse() @ self._up(source, common)

    def grown(self, more: TransformTree) -> TransformTree:
        """Tree with the transforms of another one, whose word counts where both have one."""
        return TransformTree({**self._transforms, **more._transforms})

    def _up(self, frame: str, ancestor: str) -> RigidTransform:
        """``T_ancestor_frame``."""
        chain = RigidTransform.identity()
        while frame != ancestor:
            frame, step = self._transforms[frame]
            chain = step @ chain
        return chain


def lineage(frame: str, parents: Mapping[str, str]) -> list[str]:
    """Frame, its parent, and so on to the root; a loop ends where it closes."""
    frames = [frame]
    while (parent := parents.get(frames[-1])) is not None and parent not in frames:
        frames.append(parent)
    return frames


def read_static_tree(recording: Recording) -> TransformTree:
    """Read the static transforms of a recording; of a repeated one the last counts.

    Parameters
    ----------
    recording : Recording

    Returns
    -------
    TransformTree
        Empty when there are none.

    Raises
    ------
    RecordingError
        If the file cannot be read.
    """
    poses: dict[Edge, Sequence[float]] = {}
    for topic in recording.topics:
        if is_static_tf(topic) and topic.count:
            tracks = read_tracks(recording, topic)[0]
            poses |= {edge: track.values[-7:] for edge, track in tracks.items()}
    return tree_of(poses)


def tree_of(poses: Mapping[Edge, Sequence[float]]) -> TransformTree:
    """Make a tree of single poses; those that cannot be used are left out.

    Parameters
    ----------
    poses : mapping of Edge to sequence of 7 float
        Position and quaternion, as in `PoseRecord`.

    Returns
    -------
    TransformTree
    """
    transforms: dict[str, tuple[str, RigidTransform]] = {}
    for (parent, child), values in poses.items():
        pose = np.array(values)
        if parent != child and usable_poses(pose[None]).all():
            transforms[child] = (parent, RigidTransform.from_quaternion(pose[:3], pose[3:]))
    return TransformTree(transforms)


@dataclass(frozen=True)
class FrameRoles:
    """Names of the frames, as they stand in the recording; empty when it names none.

    Attributes
    ----------
    sensor, body, world : str
    reasons : mapping of str to str
        Why each frame has its role, by role.
    """

    sensor: str
    body: str
    world: str
    reasons: Mapping[str, str]


def find_roles(edge: Edge, sensor: str, tree: TransformTree, config: RecordingConfig) -> FrameRoles:
    """Assign the roles of the frames.

    Parameters
    ----------
    edge : Edge
        Header frame and child frame of the poses.
    sensor : str
        Header frame of the clouds.
    tree : TransformTree
    config : RecordingConfig

    Returns
    -------
    FrameRoles
    """
    header, child = edge
    world, why_world = header, "the frame of the poses"
    if config.world_frame is not None:
        world, why_world = config.world_frame.lstrip("/"), "named by recording.world_frame"
    if config.body_frame is not None:
        body, why_body = config.body_frame.lstrip("/"), "named by recording.body_frame"
    elif child:
        body, why_body = child, "the child frame of the poses"
    else:
        body, why_body = _carrier(sensor, tree, {header, world})
    reasons = {"sensor": "the frame of the clouds", "body": why_body, "world": why_world}
    return FrameRoles(sensor, body, world, reasons)


def _carrier(sensor: str, tree: TransformTree, fixed: Collection[str]) -> tuple[str, str]:
    """Frame that carries the sensor: the highest one above it that is not fixed."""
    above = lineage(sensor, tree.parents)
    moving = [frame for frame in above[1:] if frame not in fixed]
    if moving:
        return moving[-1], f"the root above {sensor!r} in /tf_static"
    return sensor, "the sensor's frame: nothing names another"


@dataclass(frozen=True)
class Extrinsic:
    """Where the camera sits on the drone.

    Attributes
    ----------
    T_body_sensor : RigidTransform
    source : str
        ``configuration``, ``tf_static`` or ``identity``.
    notes : tuple of str
    """

    T_body_sensor: RigidTransform
    source: str
    notes: tuple[str, ...] = ()


def find_extrinsic(config: SensorConfig, tree: TransformTree, roles: FrameRoles) -> Extrinsic:
    """Find ``T_body_sensor``: configured, else from the static transforms, else identity.

    Parameters
    ----------
    config : SensorConfig
    tree : TransformTree
    roles : FrameRoles

    Returns
    -------
    Extrinsic
    """
    if config.extrinsic is not None:
        rotation = matrix_from_rpy(*np.radians(config.extrinsic.rotation_rpy_deg))
        translation = np.array(config.extrinsic.translation, dtype=np.float64)
        return Extrinsic(RigidTransform(rotation, translation), "configuration")
    if roles.sensor == roles.body:
        note = (
            "the recording does not say where the camera sits on the drone: it is taken to sit "
            "at its origin; see sensor.extrinsic"
        )
        return Extrinsic(RigidTransform.identity(), "identity", (note,))
    linked = tree.transform(roles.body, roles.sensor)
    if linked is None:
        note = (
            f"no transform links the cloud's frame {roles.sensor!r} and the body frame "
            f"{roles.body!r}: the camera is taken to sit at the body's origin"
        )
        return Extrinsic(RigidTransform.identity(), "identity", (note,))
    if config.extrinsic_from_tf:
        return Extrinsic(linked, "tf_static")
    note = (
        f"/tf_static places the camera at {_rounded(linked.translation)} m on "
        f"{roles.body!r}; it is not used, since sensor.extrinsic_from_tf is false"
    )
    return Extrinsic(RigidTransform.identity(), "identity", (note,))


def _rounded(values: np.typing.NDArray[np.float64]) -> str:
    return "(" + ", ".join(f"{value:.3f}" for value in values) + ")"


def choose_track_edge(edges: Collection[Edge], config: RecordingConfig, where: str) -> Edge:
    """Choose whose poses to use, when a topic mixes those of several frames.

    Parameters
    ----------
    edges : collection of Edge
        At least one.
    config : RecordingConfig
    where : str
        Recording and topic, for the message.

    Returns
    -------
    Edge

    Raises
    ------
    AmbiguousTopicError
        If the configuration does not single out one of several.
    """
    if len(edges) == 1:
        return next(iter(edges))
    fitting = list(named_edges(edges, config))
    if len(fitting) == 1:
        return fitting[0]
    raise AmbiguousTopicError(
        f"{where}: poses of several frames: {listed_edges(edges)}; choose with "
        "recording.body_frame and recording.world_frame"
    )


def named_edges(edges: Collection[Edge], config: RecordingConfig) -> Iterator[Edge]:
    """Edges that do not contradict the frames of the configuration."""
    world, body = (name and name.lstrip("/") for name in (config.world_frame, config.body_frame))
    for parent, child in edges:
        if world in (None, parent) and body in (None, child):
            yield parent, child


def listed_edges(edges: Collection[Edge]) -> str:
    """Write edges for people."""
    return ", ".join(
        f"{parent!r} -> {child!r}" if child else repr(parent) for parent, child in edges
    )
