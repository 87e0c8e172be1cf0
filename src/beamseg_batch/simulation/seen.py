"""Which part of each member a flight saw: the part that counts when a run is judged."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.geometry import FloatArray, RigidTransform
from beamseg_batch.simulation.casting import Caster, Hits, RayGrid
from beamseg_batch.world.scene import Member, Scene

__all__ = ["SeenPart", "SeenParts", "SeenRule", "seen_parts"]


@dataclass(frozen=True)
class SeenRule:
    """When a part of a member counts as seen.

    Attributes
    ----------
    x_max, y_z_max : float, metres
        Window in the cloud's axes: ``0 <= x <= x_max``, ``|y|, |z| <= y_z_max``.
    floor_trim_m : float, metres
        Lowest height in the world frame.
    off_surface_m : float, metres
        Farther in depth from the surface, a return is a mixed pixel and hits nothing.
    min_scans : int
        Scans that must have hit a bin of the axis.
    bin_m, merge_gap_m : float, metres
        Length of a bin; gaps up to `merge_gap_m` between seen stretches are closed.
    """

    x_max: float = 1.5
    y_z_max: float = 1.5
    floor_trim_m: float = 0.3
    off_surface_m: float = 0.05
    min_scans: int = 3
    bin_m: float = 0.02
    merge_gap_m: float = 0.1


@dataclass(frozen=True)
class SeenPart:
    """What a flight saw of a member.

    Attributes
    ----------
    intervals : tuple of (float, float), metres
        Seen stretches, from the member's start along its chord, in order.
    n_scans : int
        Scans that hit the member within the window and above the floor trim.
    """

    intervals: tuple[tuple[float, float], ...]
    n_scans: int

    @property
    def longest(self) -> tuple[float, float] | None:
        """The longest stretch, the part that counts; None if nothing was seen."""
        return max(self.intervals, key=lambda ends: ends[1] - ends[0], default=None)

    @property
    def length(self) -> float:
        """Length of that stretch, metres; 0 if nothing was seen."""
        low, high = self.longest or (0.0, 0.0)
        return high - low


class SeenParts:
    """Counts, scan by scan, where the surface of each member was hit.

    Parameters
    ----------
    members : sequence of Member
    rule : SeenRule
    """

    def __init__(self, members: Sequence[Member], rule: SeenRule) -> None:
        self._rule = rule
        self._lengths = np.array([member.length for member in members])
        self._starts = np.array([member.start for member in members]).reshape(-1, 3)
        self._axes = np.array([member.rotation[:, 2] for member in members]).reshape(-1, 3)
        n_bins = np.maximum(np.ceil(self._lengths / rule.bin_m - 1e-6).astype(np.int64), 1)
        self._first_bins = np.concatenate([[0], np.cumsum(n_bins)])
        self._counts = np.zeros(int(self._first_bins[-1]), dtype=np.int64)
        self._n_scans = np.zeros(len(members), dtype=np.int64)

    def add(
        self,
        hits: Hits,
        depths: FloatArray,
        grid: RayGrid,
        T_world_sensor: RigidTransform,
        T_cloud_sensor: RigidTransform,
    ) -> None:
        """Count where the returns of one scan lie.

        Parameters
        ----------
        hits : Hits
            What the rays truly hit.
        depths : (H, W) float64, metres
            What was measured; not finite without return.
        grid : RayGrid
        T_world_sensor : RigidTransform
        T_cloud_sensor : RigidTransform
            To the frame that the cloud is written in: the window has its axes.
        """
        rule = self._rule
        with np.errstate(invalid="ignore"):  # nothing hit and nothing returned
            on_member = np.abs(depths - hits.depths) <= rule.off_surface_m
        on_member &= hits.owners >= 0
        points = grid.directions[on_member] * depths[on_member][:, None]
        world, cloud = T_world_sensor.apply(points), T_cloud_sensor.apply(points)
        seen = (cloud[:, 0] >= 0.0) & (cloud[:, 0] <= rule.x_max)
        seen &= (np.abs(cloud[:, 1:]) <= rule.y_z_max).all(axis=1)
        seen &= world[:, 2] >= rule.floor_trim_m
        self._count(world[seen], hits.owners[on_member][seen])

    def _count(self, points: FloatArray, owners: NDArray[np.int64]) -> None:
        along = np.einsum("ni,ni->n", points - self._starts[owners], self._axes[owners])
        bins = self._first_bins[owners] + np.floor(along / self._rule.bin_m).astype(np.int64)
        bins = np.clip(bins, self._first_bins[owners], self._first_bins[owners + 1] - 1)
        self._counts[np.unique(bins)] += 1
        self._n_scans[np.unique(owners)] += 1

    @property
    def n_members(self) -> int:
        """Number of members that have been hit."""
        return int(np.count_nonzero(self._n_scans))

    def parts(self) -> list[SeenPart]:
        """What has been seen of each member, in order."""
        return [
            SeenPart(self._intervals(member), int(n_scans))
            for member, n_scans in enumerate(self._n_scans)
        ]

    def _intervals(self, member: int) -> tuple[tuple[float, float], ...]:
        rule = self._rule
        first, last = self._first_bins[member : member + 2]
        bins = np.flatnonzero(self._counts[first:last] >= rule.min_scans)
        if len(bins) == 0:
            return ()
        breaks = np.flatnonzero((np.diff(bins) - 1) * rule.bin_m > rule.merge_gap_m + 1e-9)
        starts, ends = bins[np.append(0, breaks + 1)], bins[np.append(breaks, len(bins) - 1)] + 1
        length = float(self._lengths[member])
        return tuple(
            (float(start * rule.bin_m), min(float(end * rule.bin_m), length))
            for start, end in zip(starts, ends, strict=True)
        )


def seen_parts(
    scene: Scene,
    scans: Iterable[tuple[RigidTransform, FloatArray]],
    grid: RayGrid,
    T_cloud_sensor: RigidTransform | None = None,
    rule: SeenRule | None = None,
) -> list[SeenPart]:
    """Find which part of each member of a known scene a recorded flight saw.

    Parameters
    ----------
    scene : Scene
    scans : iterable of (RigidTransform, (H, W) float64)
        ``T_world_sensor`` and the measured depths of each scan, metres; not finite without
        return.
    grid : RayGrid
    T_cloud_sensor : RigidTransform, optional
        From the sensor frame to the frame that the clouds are written in; the same frame
        without.
    rule : SeenRule, optional

    Returns
    -------
    list of SeenPart
        One for each member, in order.
    """
    seen, caster = SeenParts(scene.members, rule or SeenRule()), Caster(scene)
    for T_world_sensor, depths in scans:
        hits = caster.cast(T_world_sensor, grid)
        seen.add(hits, depths, grid, T_world_sensor, T_cloud_sensor or RigidTransform.identity())
    return seen.parts()
