"""Truths and results for tests: made of arrays, moved about, written to files."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from beamseg_batch.evaluation.matching import Lines
from beamseg_batch.evaluation.results import Result
from beamseg_batch.evaluation.truth import Truth
from beamseg_batch.geometry import RigidTransform, matrix_from_rpy
from beamseg_batch.tables import SEGMENTS, TRUTH, TRUTH_JOINTS
from beamseg_batch.world.joints import Joint, find_joints

RADIUS = 0.05
SPACING = 1.0  # between the members of `scattered`: none can be taken for another


def scattered(n, seed=0, length=(0.8, 2.0)):
    """Ends, (n, 2, 3), of members of any direction that stand well apart."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(n, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    middles = np.stack([np.arange(n) * (length[1] + SPACING), rng.uniform(-1, 1, n), np.ones(n)], 1)
    half = rng.uniform(*length, n)[:, None] / 2.0 * directions
    return np.stack([middles - half, middles + half], axis=1)


def truth_of(ends, seen=None, radii=RADIUS, shapes=None, bows=0.0, joints=None):
    """Build a truth; seen whole, and joined where the members meet, unless told."""
    ends = np.asarray(ends, dtype=np.float64)
    n = len(ends)
    axes = Lines.between(ends[:, 0], ends[:, 1])
    radii = np.broadcast_to(np.asarray(radii, dtype=np.float64), n).copy()
    return Truth(
        source="truth",
        names=tuple(str(i + 1) for i in range(n)),
        axes=axes,
        seen=ends if seen is None else np.asarray(seen, dtype=np.float64),
        radii=radii,
        shapes=tuple(shapes or ["round"] * n),
        bows=np.broadcast_to(np.asarray(bows, dtype=np.float64), n).copy(),
        joints=find_joints(ends, radii) if joints is None else tuple(joints),
    )


def result_of(ends, radii=RADIUS, joints=(), **more):
    """Build a result; `more` are further attributes."""
    ends = np.asarray(ends, dtype=np.float64).reshape(-1, 2, 3)
    n = len(ends)
    result = Result(
        source="run",
        numbers=np.arange(n),
        axes=Lines.between(ends[:, 0], ends[:, 1]),
        radii=np.broadcast_to(np.asarray(radii, dtype=np.float64), n).copy(),
        shapes=None,
        bows=None,
        measured_radii=None,
        sigmas={},
        touching=None,
        joints=None if joints is None else np.asarray(joints, dtype=np.float64).reshape(-1, 3),
    )
    return dataclasses.replace(result, **more)


def own_result(truth):
    """Give what was seen of a truth as a run that is perfect."""
    seen = truth.counts
    joints = [truth.joints[k].position for k in np.flatnonzero(truth.joint_counts)]
    return result_of(
        truth.seen[seen],
        truth.radii[seen],
        joints,
        shapes=tuple(np.array(truth.shapes)[seen]),
        bows=truth.bows[seen],
    )


def noisy(ends, seed, offset=0.01):
    """Move both ends of each line by up to `offset` per axis, and some of the lines away."""
    rng = np.random.default_rng(seed)
    return ends + rng.uniform(-offset, offset, ends.shape)


def any_transform(seed):
    rng = np.random.default_rng(seed)
    return RigidTransform(matrix_from_rpy(*rng.uniform(-3, 3, 3)), rng.uniform(-5, 5, 3))


def moved_truth(truth, transform):
    return dataclasses.replace(
        truth,
        axes=moved_lines(truth.axes, transform),
        seen=transform.apply(truth.seen.reshape(-1, 3)).reshape(-1, 2, 3),
        joints=tuple(
            Joint(transform.apply(joint.position), joint.members) for joint in truth.joints
        ),
    )


def moved_result(result, transform):
    joints = None if result.joints is None else transform.apply(result.joints)
    return dataclasses.replace(result, axes=moved_lines(result.axes, transform), joints=joints)


def moved_lines(lines, transform):
    return Lines(transform.apply(lines.starts), transform.rotate(lines.directions), lines.lengths)


def swapped(lines, which):
    """Swap the ends of some lines."""
    which = np.asarray(which)[:, None]
    return Lines(
        np.where(which, lines.ends, lines.starts),
        np.where(which, -lines.directions, lines.directions),
        lines.lengths,
    )


# Files


def write_truth(path: Path, truth, joints: bool = True) -> Path:
    """Write a truth as `truth.csv` and `truth_joints.csv`."""
    n = len(truth.names)
    own = np.concatenate([truth.axes.starts, truth.axes.ends], axis=1)
    seen = truth.seen.reshape(n, 6)
    names = ("x1", "y1", "z1", "x2", "y2", "z2")
    columns = {name: np.zeros(n) for name in TRUTH.column_names}
    columns |= {name: own[:, k] for k, name in enumerate(names)}
    columns |= {f"o{name}": seen[:, k] for k, name in enumerate(names)}
    columns |= {"id": truth.names, "radius": truth.radii, "shape": truth.shapes}
    columns |= {
        "bow": truth.bows,
        "roll_deg": np.full(n, np.nan),
        "intervals": [""] * n,
        "frames": [3] * n,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(TRUTH.encode(columns))
    if joints:
        positions = np.array([joint.position for joint in truth.joints]).reshape(-1, 3)
        ids = [";".join(truth.names[m] for m in joint.members) for joint in truth.joints]
        rows = {"ids": ids} | {axis: positions[:, k] for k, axis in enumerate("xyz")}
        path.with_name(f"{path.stem}_joints.csv").write_text(TRUTH_JOINTS.encode(rows))
    return path


def write_run(folder: Path, ends, intersections="", original=False, radii=RADIUS, **more) -> Path:
    """Write a run: all columns, or those of the original node; `more` are further columns."""
    ends = np.asarray(ends, dtype=np.float64).reshape(-1, 2, 3)
    n = len(ends)
    lines = Lines.between(ends[:, 0], ends[:, 1])
    columns = {column.name: [0] * n for column in SEGMENTS.columns}
    unknown = [name for name in columns if name.startswith(("sigma_", "end_", "bow"))]
    columns |= dict.fromkeys(unknown, [""] * n)
    columns |= {"segment": range(n), "t_min": [0.0] * n, "t_max": lines.lengths}
    columns |= {f"a_{axis}": lines.starts[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"b_{axis}": lines.directions[:, k] for k, axis in enumerate("xyz")}
    columns |= {"radius": np.broadcast_to(radii, n), "shape": ["round"] * n} | more
    names = SEGMENTS.column_names[:9] if original else tuple(columns)
    rows = [names, *zip(*(columns[name] for name in names), strict=True)]
    folder.mkdir(parents=True, exist_ok=True)
    text = "".join(",".join(str(value) for value in row) + "\n" for row in rows)
    (folder / "segments.csv").write_text(text)
    if intersections is not None:
        (folder / "intersections.csv").write_text(f"seg1,t1,seg2,t2\n{intersections}")
    return folder
