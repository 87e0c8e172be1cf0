"""The drone's pose out of a transform tree: chains of moving and of static transforms."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise

from beamseg_batch.config import RecordingConfig
from beamseg_batch.errors import RecordingError
from beamseg_batch.model import Trajectory
from beamseg_batch.recording.frames import TransformTree, lineage, listed_edges, named_edges
from beamseg_batch.recording.pose_arrays import chained, constant, resampled, reversed_poses
from beamseg_batch.recording.poses import Edge, EdgeKind

__all__ = ["Chain", "find_chain"]


@dataclass(frozen=True)
class Chain:
    """The transforms that lead from the world to the body.

    Attributes
    ----------
    world, body : str
    edges : tuple of Edge
        From the world on; each as the tree has it, parent and child.
    moving : frozenset of Edge
        Those whose poses change.
    """

    world: str
    body: str
    edges: tuple[Edge, ...]
    moving: frozenset[Edge]

    def follow(self, tracks: Mapping[Edge, Trajectory], tree: TransformTree) -> Trajectory:
        """Multiply the transforms along the chain.

        Parameters
        ----------
        tracks : mapping of Edge to Trajectory
            Of the moving transforms, none of them empty.
        tree : TransformTree
            With the static ones.

        Returns
        -------
        Trajectory
            ``T_world_body`` at the stamps of the transform that is told most often, where
            all others are known; these are interpolated.
        """
        if len(self.edges) == 1 and self.moving and self.edges[0] == (self.world, self.body):
            return tracks[self.edges[0]]
        stamps = max(tracks.values(), key=len).stamps_ns
        for track in tracks.values():
            stamps = resampled(track, stamps).stamps_ns
        steps, frame = [], self.world
        for edge in self.edges:
            parent, child = edge
            if edge in self.moving:
                step = resampled(tracks[edge], stamps)
            else:
                fixed = tree.transform(parent, child)
                assert fixed is not None, f"{edge} is an edge of the tree"
                step = constant(fixed, stamps)
            steps.append(step if frame == parent else reversed_poses(step))
            frame = child if frame == parent else parent
        return reduce(chained, steps)


def find_chain(
    moving: Mapping[Edge, EdgeKind],
    tree: TransformTree,
    sensor: str,
    config: RecordingConfig,
    where: str,
) -> Chain:
    """Find the chain of transforms that is the drone's pose.

    Parameters
    ----------
    moving : mapping of Edge to EdgeKind
        Transforms of the pose topic.
    tree : TransformTree
        Static transforms.
    sensor : str
        Header frame of the clouds.
    config : RecordingConfig
    where : str
        Recording and topic, for the message.

    Returns
    -------
    Chain
        Between the frames that the configuration names. Else the body is the frame below
        the last moving transform on the way down to the sensor, and the world the one
        above the first.

    Raises
    ------
    RecordingError
        If the frames cannot be told, or nothing links them.
    """
    changing = {edge for edge, kind in moving.items() if kind.moves}
    parents = {**tree.parents, **{child: parent for parent, child in moving}}
    body = _name(config.body_frame) or _body(sensor, parents, changing, moving, config)
    if body is None:
        raise RecordingError(
            f"{where}: which transform is the drone's pose is not clear: the cloud's frame is "
            f"{sensor!r} and no moving transform leads to it; set recording.body_frame (and "
            f"recording.world_frame) to one of: {listed_edges(moving)}"
        )
    world = _name(config.world_frame) or _world(body, parents, changing, moving)
    edges = None if world is None else _path(world, body, parents)
    if world is None or not edges:
        raise RecordingError(
            f"{where}: no chain of transforms leads from {world or 'any world'!r} to {body!r}; "
            f"there are: {listed_edges(moving)}; see --world-frame and --body-frame"
        )
    on_topic = [edge for edge in edges if edge in moving]
    if not on_topic:
        raise RecordingError(
            f"{where}: {body!r} does not move in {world!r}: the transforms between them are "
            f"static; there are: {listed_edges(moving)}; see --world-frame and --body-frame"
        )
    # What never changes may have been told once: it holds all the time, unless nothing moves.
    moves = frozenset(edge for edge in on_topic if edge in changing) or frozenset(on_topic)
    return Chain(world, body, tuple(edges), moves)


def _name(frame: str | None) -> str | None:
    return frame.lstrip("/") if frame else None


def _body(
    sensor: str,
    parents: Mapping[str, str],
    changing: Collection[Edge],
    moving: Collection[Edge],
    config: RecordingConfig,
) -> str | None:
    """Child of the moving transform next to the sensor, else of the only moving one."""
    above = [(parent, child) for child, parent in pairwise(lineage(sensor, parents))]
    for candidates in (changing, moving):
        nearest = next((child for parent, child in above if (parent, child) in candidates), None)
        if nearest is not None:
            return nearest
    named = list(named_edges(moving, config))
    return named[0][1] if len(named) == 1 else None


def _world(
    body: str, parents: Mapping[str, str], changing: Collection[Edge], moving: Collection[Edge]
) -> str | None:
    """Parent of the topmost moving transform above the body."""
    above = [(parent, child) for child, parent in pairwise(lineage(body, parents))]
    for candidates in (changing, moving):
        there = [parent for parent, child in above if (parent, child) in candidates]
        if there:
            return there[-1]
    return None


def _path(world: str, body: str, parents: Mapping[str, str]) -> list[Edge] | None:
    """Edges from the world up to the common ancestor and down to the body."""
    up_world, up_body = lineage(world, parents), lineage(body, parents)
    common = next((frame for frame in up_world if frame in up_body), None)
    if common is None:
        return None
    climb = up_world[: up_world.index(common) + 1]
    descent = up_body[: up_body.index(common) + 1][::-1]
    upwards = [(parent, child) for child, parent in pairwise(climb)]
    return upwards + list(pairwise(descent))
