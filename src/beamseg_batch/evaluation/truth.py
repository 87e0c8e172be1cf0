"""What stands there, and what of it a flight saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beamseg_batch.errors import RunError, TruthError
from beamseg_batch.evaluation.files import read_text, require_finite, require_unique, vectors
from beamseg_batch.evaluation.matching import Lines
from beamseg_batch.geometry import FloatArray
from beamseg_batch.tables import TRUTH, TRUTH_JOINTS, ColumnArrays
from beamseg_batch.world.joints import Joint, find_joints
from beamseg_batch.world.scene import Member, Section

__all__ = [
    "JOINT_M",
    "MIN_SEEN_M",
    "OWN_END_M",
    "Truth",
    "load_truth",
]

MIN_SEEN_M = 0.3
"""Shortest stretch that must have been seen of a member for it to count."""
OWN_END_M = 0.03
"""Within this, the end of what was seen is the member's own end."""
JOINT_M = 0.1
"""Within this, a joint is found; and so near must have been seen what meets there."""

_WORLDS = (".yaml", ".yml", ".wbt")
_ENDS = ("x1", "y1", "z1", "x2", "y2", "z2")
_SEEN = tuple(f"o{name}" for name in _ENDS)


@dataclass(frozen=True, eq=False)
class Truth:
    """Members as they stand. Metres, world frame.

    Attributes
    ----------
    source : str
        What it was read from.
    names : tuple of str
    axes : Lines
        M of them, from own end to own end; the chord of a member that is bent.
    seen : (M, 2, 3) float64
        Ends of the longest stretch that was seen, in the direction of the axis; NaN if
        nothing was.
    radii : (M,) float64
        Half the larger extent of a section that is not round.
    shapes : tuple of str
    bows : (M,) float64
        Deviation of the axis from its chord at mid-length, never negative.
    joints : tuple of Joint
    notes : tuple of str
        What a reader of the figures must know.
    bends : (M,) bool, optional
        Members of which it is known which way they are bent, so that `seen` lies on the axis.
    """

    source: str
    names: tuple[str, ...]
    axes: Lines
    seen: FloatArray
    radii: FloatArray
    shapes: tuple[str, ...]
    bows: FloatArray
    joints: tuple[Joint, ...]
    notes: tuple[str, ...] = ()
    bends: NDArray[np.bool_] | None = None

    @cached_property
    def chords(self) -> Lines:
        """What a run can know of the axes: of a bent one, the chord to where the view was cut."""
        if self.bends is None:
            return self.axes
        own = np.stack([self.axes.starts, self.axes.ends], axis=1)
        cut: NDArray[np.bool_] = ~self.own_ends
        cut[~(self.bends & self.counts)] = False
        ends = np.where(cut[:, :, None], self.seen, own)
        chords = Lines.between(ends[:, 0], ends[:, 1])
        is_cut = np.asarray(cut.any(axis=1), np.bool_)
        return Lines(
            ends[:, 0],
            np.where(is_cut[:, None], chords.directions, self.axes.directions),
            np.where(is_cut, chords.lengths, self.axes.lengths),
        )

    @cached_property
    def chord_bows(self) -> FloatArray:
        """(M,) float64, metres: deviation from those chords, halfway along them."""
        along = np.einsum("mk,mk->m", self.chords.ends - self.chords.starts, self.axes.directions)
        return np.asarray(self.bows * (along / self.axes.lengths) ** 2, np.float64)

    @cached_property
    def counts(self) -> NDArray[np.bool_]:
        """(M,) bool: members of which enough was seen that a run should know them."""
        lengths = np.linalg.norm(self.seen[:, 1] - self.seen[:, 0], axis=1)
        # Files hold rounded numbers: what was seen 0.3 m of must not fail by their last digit.
        counts: NDArray[np.bool_] = lengths >= MIN_SEEN_M - 1e-6
        return counts

    @cached_property
    def spans(self) -> FloatArray:
        """(M, 2) float64: what was seen, along the axis; all of a member that does not count."""
        lines = self.chords
        along = np.einsum("mek,mk->me", self.seen - lines.starts[:, None], lines.directions)
        spans: FloatArray = np.where(self.counts[:, None], along, lines.whole)
        return spans

    @cached_property
    def own_ends(self) -> NDArray[np.bool_]:
        """(M, 2) bool: whether the ends of what was seen are those of the member."""
        own = np.stack([self.axes.starts, self.axes.ends], axis=1)
        near: NDArray[np.bool_] = np.linalg.norm(self.seen - own, axis=2) <= OWN_END_M
        return near

    @cached_property
    def joint_counts(self) -> NDArray[np.bool_]:
        """(J,) bool: joints near which at least two members that count were seen."""
        return np.array([self._n_seen_at(joint) >= 2 for joint in self.joints], dtype=bool)

    def _n_seen_at(self, joint: Joint) -> int:
        near = 0
        for member in joint.members:
            low, high = self.spans[member]
            t = (joint.position - self.chords.starts[member]) @ self.chords.directions[member]
            near += bool(self.counts[member] and low - JOINT_M <= t <= high + JOINT_M)
        return near


def load_truth(path: Path) -> Truth:
    """Read a truth.

    Parameters
    ----------
    path : Path
        ``truth.csv``, its folder, or a world (``.yaml``, ``.yml``, ``.wbt``).

    Returns
    -------
    Truth
        The joints are those of the file ``…_joints.csv`` or ``…_intersections.csv`` beside
        the table, and else where the members meet. A world, and a table without the
        columns of what was seen, count as seen whole; a note says so.

    Raises
    ------
    TruthError
        If the file is no truth.
    WorldError
        If the world cannot be read.
    """
    path = path / TRUTH.file_name if path.is_dir() else path
    if path.suffix.lower() in _WORLDS:
        return _from_world(path)
    try:
        return _from_table(path)
    except RunError as error:
        raise TruthError(str(error)) from error


def _from_world(path: Path) -> Truth:
    from beamseg_batch.world import load_scene_file

    scene = load_scene_file(path).scene
    axes = Lines.between(
        np.array([member.start for member in scene.members], np.float64).reshape(-1, 3),
        np.array([member.end for member in scene.members], np.float64).reshape(-1, 3),
    )
    return Truth(
        source=str(path),
        names=tuple(member.name for member in scene.members),
        axes=axes,
        seen=_whole(axes),
        radii=np.array([member.section.radius for member in scene.members]),
        shapes=tuple(member.section.shape for member in scene.members),
        bows=np.abs([member.bow for member in scene.members]),
        joints=scene.joints,
        notes=(*scene.notes, "a world does not tell what was seen: members count as seen whole"),
    )


def _from_table(path: Path) -> Truth:
    where = str(path)
    required = ("id", *_ENDS, "radius")
    columns = TRUTH.decode(read_text(path), where, required)
    n = len(columns["id"])
    require_finite(columns, (*_ENDS, "radius"), where)
    names = tuple(columns["id"].tolist())
    require_unique(names, "member", where)
    axes = _axes(columns, where)
    radii = columns["radius"]
    if not (radii > 0.0).all():
        row = int(np.argmin(radii > 0.0))
        raise TruthError(f"{where}: row {row + 1}: radius {radii[row]:g} must be above 0")
    seen, notes = _seen(columns, axes, where)
    vectors = _bow_vectors(columns)
    shapes = columns.get("shape", np.full(n, "round", dtype=object))
    return Truth(
        source=where,
        names=names,
        axes=axes,
        seen=_on_axes(axes, seen, vectors),
        radii=radii,
        shapes=tuple(shapes.tolist()),
        bows=np.nan_to_num(np.abs(columns.get("bow", np.zeros(n)))),
        joints=_joints(path, names, columns),
        notes=notes,
        bends=np.asarray(vectors.any(axis=1), np.bool_),
    )


def _axes(columns: ColumnArrays, where: str) -> Lines:
    starts, ends = vectors(columns, _ENDS[:3]), vectors(columns, _ENDS[3:])
    lengths = np.linalg.norm(ends - starts, axis=1)
    if not (lengths > 0.0).all():
        row = int(np.argmin(lengths > 0.0))
        raise TruthError(f"{where}: row {row + 1}: member {columns['id'][row]!r} has no length")
    return Lines.between(starts, ends)


def _seen(columns: ColumnArrays, axes: Lines, where: str) -> tuple[FloatArray, tuple[str, ...]]:
    """Ends of what was seen, in the direction of the axis, and what to say about them."""
    missing = [name for name in _SEEN if name not in columns]
    if len(missing) == len(_SEEN):
        note = f"{where} does not tell what was seen: members count as seen whole"
        return _whole(axes), (note,)
    if missing:
        raise TruthError(f"{where}: has no column {', '.join(missing)}")
    seen = np.stack([vectors(columns, _SEEN[:3]), vectors(columns, _SEEN[3:])], axis=1)
    for row in np.flatnonzero(~np.isfinite(seen).all(axis=(1, 2))):
        if not np.isnan(seen[row]).all():
            raise TruthError(
                f"{where}: row {row + 1}: {_SEEN[0]} to {_SEEN[-1]} must be numbers, or all empty"
            )
    along = np.einsum("mek,mk->me", seen, axes.directions)
    turned = along[:, 0] > along[:, 1]
    seen[turned] = seen[turned][:, ::-1]
    return seen, ()


def _whole(axes: Lines) -> FloatArray:
    return np.stack([axes.starts, axes.ends], axis=1)


def _joints(path: Path, names: Sequence[str], columns: ColumnArrays) -> tuple[Joint, ...]:
    """Joints of the file beside the truth, else those of the axes."""
    for ending in ("joints", "intersections"):
        beside = path.with_name(f"{path.stem}_{ending}.csv")
        if beside.is_file():
            return _joints_from_table(beside, names)
    return find_joints(_nodes(columns), columns["radius"])


def _on_axes(axes: Lines, seen: FloatArray, vectors: FloatArray) -> FloatArray:
    """Lay what was seen of bent members, which is told along their chords, on their axes."""
    share = np.einsum("mek,mk->me", seen - axes.starts[:, None], axes.directions)
    share = share / axes.lengths[:, None]
    lifted: FloatArray = seen + 4.0 * (share * (1.0 - share))[:, :, None] * vectors[:, None]
    return lifted


def _bow_vectors(columns: ColumnArrays) -> FloatArray:
    """By how much the axes leave their chords halfway, (M, 3); zero where that is not known."""
    vectors = [
        member.bow * member.rotation[:, 1] if member.bow else np.zeros(3)
        for member in _members(columns)
    ]
    return np.array(vectors, np.float64).reshape(-1, 3)


def _nodes(columns: ColumnArrays) -> list[FloatArray]:
    """Nodes of the axes: bent where the table tells by how much and which way."""
    return [member.nodes for member in _members(columns)]


def _members(columns: ColumnArrays) -> list[Member]:
    """Axes of the members, without their sections."""
    starts, ends = vectors(columns, _ENDS[:3]), vectors(columns, _ENDS[3:])
    unknown = np.full(len(starts), np.nan)
    bows, rolls = (columns.get(name, unknown) for name in ("bow", "roll_deg"))
    bows = np.where(np.isfinite(bows + rolls), bows, 0.0)
    section = Section("round", 0.0, 0.0)  # an axis has none
    return [
        Member("", start, end, section, np.radians(roll), bow)
        for start, end, roll, bow in zip(starts, ends, np.nan_to_num(rolls), bows, strict=True)
    ]


def _joints_from_table(path: Path, names: Sequence[str]) -> tuple[Joint, ...]:
    where = str(path)
    columns = TRUTH_JOINTS.decode(read_text(path), where)
    require_finite(columns, ("x", "y", "z"), where)
    places = {name: index for index, name in enumerate(names)}
    joints = []
    for row, position in enumerate(vectors(columns, ("x", "y", "z"))):
        met = columns["ids"][row].split(";")
        unknown = [name for name in met if name not in places]
        if unknown:
            raise TruthError(f"{where}: row {row + 1}: the truth has no member {unknown[0]!r}")
        joints.append(Joint(position, tuple(places[name] for name in met)))
    return tuple(joints)
