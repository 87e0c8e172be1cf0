"""Poses by the state of their clock: stamps that come again after a reset are not the same time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from beamseg_batch.model import Trajectory
from beamseg_batch.recording.clocks import clock_groups
from beamseg_batch.recording.cloud_stamps import CloudStamps

__all__ = ["PoseClocks", "PoseEpoch", "joined", "nearest_epoch"]


@dataclass(frozen=True, eq=False)
class PoseEpoch:
    """Poses between which their clock was not set anew, or was set back to what it was.

    Attributes
    ----------
    trajectory : Trajectory
    ahead_s : float or None
        How far their stamps are ahead of the log, seconds; None when they were not logged.
    """

    trajectory: Trajectory
    ahead_s: float | None


def joined(epochs: Sequence[PoseEpoch]) -> Trajectory:
    """All poses in order of their stamps; of equal stamps that of the earlier epoch.

    Parameters
    ----------
    epochs : sequence of PoseEpoch
        At least one.

    Returns
    -------
    Trajectory
    """
    parts = [epoch.trajectory for epoch in epochs]
    if len(parts) == 1:
        return parts[0]
    stamps, first = np.unique(np.concatenate([p.stamps_ns for p in parts]), return_index=True)
    return Trajectory(
        stamps,
        np.concatenate([part.positions for part in parts])[first],
        np.concatenate([part.quaternions_xyzw for part in parts])[first],
    )


def nearest_epoch(epochs: Sequence[PoseEpoch], ahead_s: float | None) -> PoseEpoch:
    """Epoch whose clock stood nearest to another one.

    Parameters
    ----------
    epochs : sequence of PoseEpoch
        At least one.
    ahead_s : float or None
        How far the other one is ahead of the log; None takes the first epoch.

    Returns
    -------
    PoseEpoch
    """
    if ahead_s is None:
        return epochs[0]
    return min(epochs, key=lambda e: np.inf if e.ahead_s is None else abs(e.ahead_s - ahead_s))


class PoseClocks:
    """Tells which poses a cloud may be matched with: those whose clock stood as that of the cloud.

    The recorder's clock tells: whatever is logged at one time was stamped at one time, give or
    take what messages need to arrive. While no clock is set anew, the stamps alone count.

    Parameters
    ----------
    epochs : sequence of PoseEpoch
        At least one.
    read_clouds : callable
        Reads the stamps of all clouds; called once, and only when a clock was set anew.
    """

    def __init__(self, epochs: Sequence[PoseEpoch], read_clouds: Callable[[], CloudStamps]) -> None:
        self._epochs = epochs
        self._read_clouds = read_clouds
        self._has_decided = False
        self._states: dict[int, float] = {}  # of the clouds by index; none when one state is all
        self._usual_s, self._reach_s = 0.0, np.inf

    def poses_of(self, index: int, jumped: bool) -> Trajectory | None:
        """Find the poses that a cloud may be matched with.

        Parameters
        ----------
        index : int
            Of the cloud in the recording.
        jumped : bool
            Whether its clock may have been set since the cloud before.

        Returns
        -------
        Trajectory or None
            None when its clock stood as that of no pose.
        """
        if not self._has_decided and (jumped or len(self._epochs) > 1):
            self._decide()
        state = self._states.get(index)
        if state is None:
            return self._epochs[0].trajectory
        epoch = nearest_epoch(self._epochs, state)
        fits = epoch.ahead_s is not None and abs(state - epoch.ahead_s) <= self._reach_s
        # Poses of one state went with the clouds as these were at first.
        fits |= len(self._epochs) == 1 and abs(state - self._usual_s) <= self._reach_s
        return epoch.trajectory if fits else None

    def _decide(self) -> None:
        """Group the clouds by the state of their clock."""
        self._has_decided = True
        clouds = self._read_clouds()
        groups = clock_groups(clouds.used_ns, clouds.log_times_ns)
        if len(groups) == len(self._epochs) == 1 or not len(clouds.indices):
            return
        self._usual_s = groups[0][0]
        of_poses = [epoch.ahead_s for epoch in self._epochs if epoch.ahead_s is not None]
        steps = [_smallest_step([state for state, _ in groups]), _smallest_step(of_poses)]
        self._reach_s = 0.5 * min(steps)
        for state, members in groups:
            self._states.update(dict.fromkeys(clouds.indices[members].tolist(), state))


def _smallest_step(states: list[float]) -> float:
    return min((after - before for before, after in pairwise(sorted(states))), default=np.inf)
