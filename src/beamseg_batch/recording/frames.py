"""Which frame is the sensor, the body and the world, and where the sensor sits on the body.

Roles come from the pose topic and the transform tree, never from names: the original
node's logs call the moving drone frame ``world`` and the fixed one ``mocap``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from beamseg_batch.config import RecordingConfig, SensorConfig
from beamseg_batch.errors import AmbiguousTopicError, RecordingError
from beamseg_batch.geometry import RigidTransform, matrix_from_rpy
from beamseg_batch.recording.poses import Edge, read_tracks, usable_poses
from beamseg_batch.recording.source import Recording
from beamseg_batch.recording.topics import is_static_tf

__all__ = [
    "Extrinsic",
    "FrameRoles",
    "TransformTree",
    "choose_tf_edge",
    "choose_track_edge",
    "find_extrinsic",
    "find_roles",
    "read_static_tree",
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
        up_source, up_target = (_lineage(frame, self.parents) for frame in (source, target))
        common = next((frame for frame in up_source if frame in up_target), None)
        if common is None:
            return None
        return self._up(target, common).inverse() @ self._up(source, common)

    def _up(self, frame: str, ancestor: str) -> RigidTransform:
        """``T_ancestor_frame``."""
        chain = RigidTransform.identity()
        while frame != ancestor:
            frame, step = self._transforms[frame]
            chain = step @ chain
        return chain


def _lineage(frame: str, parents: Mapping[str, str]) -> list[str]:
    """Frame, its parent, and so on to the root; a loop ends where it closes."""
    lineage = [frame]
    while (parent := parents.get(lineage[-1])) is not None and parent not in lineage:
        lineage.append(parent)
    return lineage


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
    transforms: dict[str, tuple[str, RigidTransform]] = {}
    for topic in recording.topics:
        if not is_static_tf(topic) or not topic.count:
            continue
        for (parent, child), track in read_tracks(recording, topic)[0].items():
            last = np.array(track.values[-7:])
            if parent != child and usable_poses(last[None]).all():
                pose = RigidTransform.from_quaternion(last[:3], last[3:])
                transforms[child] = (parent, pose)
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
    lineage = _lineage(sensor, tree.parents)
    moving = [frame for frame in lineage[1:] if frame not in fixed]
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
    fitting = list(_named_edges(edges, config))
    if len(fitting) == 1:
        return fitting[0]
    raise AmbiguousTopicError(
        f"{where}: poses of several frames: {_listed(edges)}; choose with "
        "recording.body_frame and recording.world_frame"
    )


def choose_tf_edge(
    moving: Collection[Edge],
    tree: TransformTree,
    sensor: str,
    config: RecordingConfig,
    where: str,
) -> Edge:
    """Choose the moving transform that is the drone's pose.

    Parameters
    ----------
    moving : collection of Edge
        Transforms of the pose topic.
    tree : TransformTree
    sensor : str
        Header frame of the clouds.
    config : RecordingConfig
    where : str
        Recording and topic, for the message.

    Returns
    -------
    Edge
        World frame and body frame. The frames that the configuration names; else the
        one moving transform between the sensor's frame and the root above it.

    Raises
    ------
    RecordingError
        If that is not one transform.
    """
    named = list(_named_edges(moving, config))
    if config.world_frame is not None and config.body_frame is not None:
        if named:
            return named[0]
        raise RecordingError(
            f"{where}: no transform from {config.world_frame!r} to {config.body_frame!r}; there "
            f"are: {_listed(moving)}. A chain of moving transforms cannot be followed yet"
        )
    parents = {**tree.parents, **{child: parent for parent, child in moving}}
    lineage = _lineage(sensor, parents)
    above = [(parent, child) for child, parent in pairwise(lineage) if (parent, child) in named]
    if len(above) == 1:
        return above[0]
    if len(named) == 1 and not above:
        return named[0]
    problem = (
        "a chain of moving transforms leads to it, which cannot be followed yet"
        if above
        else "no moving transform leads to it"
    )
    raise RecordingError(
        f"{where}: which transform is the drone's pose is not clear: the cloud's frame is "
        f"{sensor!r} and {problem}; set recording.body_frame (and recording.world_frame) to "
        f"one of: {_listed(moving)}"
    )


def _named_edges(edges: Collection[Edge], config: RecordingConfig) -> Iterator[Edge]:
    """Edges that do not contradict the frames of the configuration."""
    world, body = (name and name.lstrip("/") for name in (config.world_frame, config.body_frame))
    for parent, child in edges:
        if world in (None, parent) and body in (None, child):
            yield parent, child


def _listed(edges: Collection[Edge]) -> str:
    return ", ".join(
        f"{parent!r} -> {child!r}" if child else repr(parent) for parent, child in edges
    )
