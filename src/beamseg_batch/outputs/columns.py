"""Between the objects of a flight and the columns of its tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beamseg_batch.geometry import FloatArray, line_parameters
from beamseg_batch.model import (
    STAGES,
    Candidate,
    CrossSection,
    FlightResult,
    Intersection,
    Joint,
    Member,
    ScanRecord,
    Segment,
    across_of,
)
from beamseg_batch.section import SHAPES, Section
from beamseg_batch.tables import ColumnArrays

__all__ = [
    "candidate_columns",
    "intersection_columns",
    "intersections_from_columns",
    "joint_columns",
    "joints_from_columns",
    "member_columns",
    "members_from_columns",
    "processing_time_columns",
    "segment_columns",
    "segments_from_columns",
    "time_origin_ns",
]

_CLOCK_SLACK_NS = 60 * 10**9
_BOW = ("bow_x", "bow_y", "bow_z")
_SIZES = ("width", "height", "web", "flange")
_SEPARATOR = ";"  # between the numbers of a joint's beams


def time_origin_ns(result: FlightResult) -> int:
    """Instant from which the tables and the report count seconds.

    Parameters
    ----------
    result : FlightResult

    Returns
    -------
    int, nanoseconds
        The start of the recording. When the stamps of the clouds come from another clock,
        such as a simulation's, so that none lies within a minute of the recording: the
        stamp of the first scan.
    """
    recording = result.recording
    if not result.scans:
        return recording.start_ns
    first = result.scans[0].stamp_ns
    early, late = recording.start_ns - _CLOCK_SLACK_NS, recording.end_ns + _CLOCK_SLACK_NS
    return recording.start_ns if early <= first <= late else first


def segment_columns(segments: Sequence[Segment], origin_ns: int) -> ColumnArrays:
    """Columns of `segments.csv`.

    Parameters
    ----------
    segments : sequence of Segment
        World frame.
    origin_ns : int
        Instant from which seconds are counted.

    Returns
    -------
    mapping of str to (N,) array
    """
    columns: ColumnArrays = {"segment": np.arange(len(segments), dtype=np.int64)}
    columns |= _vectors(("a_x", "a_y", "a_z"), [s.anchor for s in segments])
    columns |= _vectors(("b_x", "b_y", "b_z"), [s.direction for s in segments])
    for name in (
        "t_min",
        "t_max",
        "radius",
        "length",
        "pca_coeff",
        "sigma_offset",
        "sigma_angle_deg",
        "measured_radius",
        "sigma_radius",
        "bow",
        "sigma_bow",
    ):
        columns[name] = np.array([getattr(s, name) for s in segments], dtype=np.float64)
    columns |= _vectors(("x1", "y1", "z1"), [s.end_1 for s in segments])
    columns |= _vectors(("x2", "y2", "z2"), [s.end_2 for s in segments])
    columns |= _vectors(_BOW, [s.bow_vector for s in segments])
    columns |= _section_columns(segments)
    columns["n_points"] = np.array([s.n_points for s in segments], dtype=np.int64)
    columns["n_scans"] = np.array([s.n_scans for s in segments], dtype=np.int64)
    columns |= _vectors(("pca_eig_0", "pca_eig_1", "pca_eig_2"), [s.pca_eig for s in segments])
    for k in (0, 1):
        columns[f"sigma_end_{k + 1}"] = np.array([s.sigma_ends[k] for s in segments], np.float64)
        seen = [s.ends_seen[k] if s.ends_seen else None for s in segments]
        columns[f"end_{k + 1}_seen"] = np.array(seen, dtype=object)
    columns["first_seen_s"] = _seconds_since(origin_ns, [s.first_seen_ns for s in segments])
    columns["last_seen_s"] = _seconds_since(origin_ns, [s.last_seen_ns for s in segments])
    return columns


def intersection_columns(intersections: Sequence[Intersection]) -> ColumnArrays:
    """Columns of `intersections.csv`.

    Parameters
    ----------
    intersections : sequence of Intersection

    Returns
    -------
    mapping of str to (N,) array
    """
    columns: ColumnArrays = {
        "seg1": np.array([i.segment_1 for i in intersections], dtype=np.int64),
        "seg2": np.array([i.segment_2 for i in intersections], dtype=np.int64),
        "t1": np.array([i.t_1 for i in intersections], dtype=np.float64),
        "t2": np.array([i.t_2 for i in intersections], dtype=np.float64),
        "distance": np.array([i.distance for i in intersections], dtype=np.float64),
        "angle_deg": np.array([i.angle_deg for i in intersections], dtype=np.float64),
        "joint": _numbers([i.joint for i in intersections]),
    }
    return columns | _vectors(("x", "y", "z"), [i.position for i in intersections])


def joint_columns(joints: Sequence[Joint]) -> ColumnArrays:
    """Columns of `joints.csv`.

    Parameters
    ----------
    joints : sequence of Joint

    Returns
    -------
    mapping of str to (N,) array
    """
    sigmas = [np.sqrt(joint.covariance.diagonal()) for joint in joints]
    named = [_SEPARATOR.join(map(str, joint.segments)) for joint in joints]
    columns: ColumnArrays = {
        "joint": np.arange(len(joints), dtype=np.int64),
        "n_segments": np.array([len(joint.segments) for joint in joints], dtype=np.int64),
        "segments": np.array(named, dtype=object),
        "residual": np.array([joint.residual for joint in joints], dtype=np.float64),
    }
    columns |= _vectors(("x", "y", "z"), [joint.position for joint in joints])
    return columns | _vectors(("sigma_x", "sigma_y", "sigma_z"), sigmas)


def member_columns(members: Sequence[Member], segments: Sequence[Segment]) -> ColumnArrays:
    """Columns of `members.csv`.

    Parameters
    ----------
    members : sequence of Member
    segments : sequence of Segment
        That they are parts of.

    Returns
    -------
    mapping of str to (N,) array
    """
    beams = [segments[member.segment] for member in members]
    ends = [
        beam.points_at(np.array([member.t_1, member.t_2]))
        for member, beam in zip(members, beams, strict=True)
    ]
    columns: ColumnArrays = {
        "member": np.arange(len(members), dtype=np.int64),
        "segment": np.array([member.segment for member in members], dtype=np.int64),
        "t1": np.array([member.t_1 for member in members], dtype=np.float64),
        "t2": np.array([member.t_2 for member in members], dtype=np.float64),
        "length": np.array([member.length for member in members], dtype=np.float64),
        "joint_1": _numbers([member.joint_1 for member in members]),
        "joint_2": _numbers([member.joint_2 for member in members]),
        "radius": np.array([beam.radius for beam in beams], dtype=np.float64),
        "shape": np.array([beam.cross_section.shape for beam in beams], dtype=object),
    }
    columns |= _vectors(("x1", "y1", "z1"), [one for one, _ in ends])
    return columns | _vectors(("x2", "y2", "z2"), [other for _, other in ends])


def processing_time_columns(scans: Sequence[ScanRecord]) -> ColumnArrays:
    """Columns of `processing_time.csv`.

    Parameters
    ----------
    scans : sequence of ScanRecord

    Returns
    -------
    mapping of str to (N,) array
    """
    columns: ColumnArrays = {
        "wall_time": np.array([round(s.wall_us) for s in scans], dtype=np.int64),
        "processing_time": np.array([round(s.processing_us) for s in scans], dtype=np.int64),
        "seg_vec_size": np.array([s.n_segments for s in scans], dtype=np.int64),
        "nblines": np.array([s.n_lines for s in scans], dtype=np.int64),
        "pose_gap_s": np.array([s.pose_gap_s for s in scans], dtype=np.float64),
    }
    for name in ("stamp_ns", "pose_stamp_ns", "n_points_raw", "n_points_filtered"):
        columns[name] = np.array([getattr(s, name) for s in scans], dtype=np.int64)
    for stage in STAGES:
        times = [s.stage_us.get(stage, 0.0) for s in scans]
        columns[f"{stage}_us"] = np.array(times, dtype=np.float64)
    return columns


def candidate_columns(candidates: Sequence[Candidate]) -> ColumnArrays:
    """Columns of `candidates.parquet`.

    Parameters
    ----------
    candidates : sequence of Candidate

    Returns
    -------
    mapping of str to (N,) array
    """
    columns: ColumnArrays = {
        name: np.array([getattr(one, name) for one in candidates], dtype=object)
        for name in ("stage", "origin", "fate", "reason")
    }
    for name, attribute in (
        ("pass", "in_pass"),
        ("candidate", "number"),
        ("parent", "parent"),
        ("n_lines", "n_lines"),
        ("into", "into"),
        ("segment", "segment"),
    ):
        columns[name] = _numbers([getattr(one, attribute) for one in candidates])
    for name in ("radius", "score", "seen_through", "reduced_chi2", "value", "limit"):
        columns[name] = np.array([getattr(one, name) for one in candidates], dtype=np.float64)
    for name in ("n_scans", "n_points"):
        columns[name] = np.array([getattr(one, name) for one in candidates], dtype=np.int64)
    for k, name in enumerate(("flank_left", "flank_right")):
        columns[name] = np.array([one.flanks[k] for one in candidates], dtype=np.float64)
    for name in ("first", "last"):
        stamps = [getattr(one, f"{name}_seen_ns") for one in candidates]
        columns[f"{name}_stamp_ns"] = np.array(stamps, dtype=np.int64)
    columns |= _vectors(("x1", "y1", "z1"), [one.end_1 for one in candidates])
    return columns | _vectors(("x2", "y2", "z2"), [one.end_2 for one in candidates])


def segments_from_columns(
    columns: ColumnArrays, origin_ns: int, covariances: FloatArray
) -> tuple[Segment, ...]:
    """Segments of the columns of `segments.csv`, without their points.

    Parameters
    ----------
    columns : mapping of str to (N,) array
    origin_ns : int
        Instant from which seconds are counted.
    covariances : (N, 6, 6) float64
        Of anchors and directions, which the table does not hold.

    Returns
    -------
    tuple of Segment
    """
    anchors = _rows(columns, ("a_x", "a_y", "a_z"))
    directions = _rows(columns, ("b_x", "b_y", "b_z"))
    eigenvalues = _rows(columns, ("pca_eig_0", "pca_eig_1", "pca_eig_2"))
    sigma_ends = _rows(columns, ("sigma_end_1", "sigma_end_2"))
    bows = _rows(columns, _BOW)
    return tuple(
        Segment(
            anchor=anchors[i],
            direction=directions[i],
            t_min=float(columns["t_min"][i]),
            t_max=float(columns["t_max"][i]),
            radius=float(columns["radius"][i]),
            n_points=int(columns["n_points"][i]),
            pca_coeff=float(columns["pca_coeff"][i]),
            pca_eig=eigenvalues[i],
            n_scans=int(columns["n_scans"][i]),
            first_seen_ns=origin_ns + round(float(columns["first_seen_s"][i]) * 1e9),
            last_seen_ns=origin_ns + round(float(columns["last_seen_s"][i]) * 1e9),
            covariance=covariances[i],
            measured_radius=float(columns["measured_radius"][i]),
            sigma_radius=float(columns["sigma_radius"][i]),
            sigma_ends=sigma_ends[i],
            ends_seen=_both(columns["end_1_seen"][i], columns["end_2_seen"][i]),
            bow_vector=bows[i],
            sigma_bow=float(columns["sigma_bow"][i]),
            cross_section=_cross_section(columns, i, directions[i]),
        )
        for i in range(len(anchors))
    )


def intersections_from_columns(columns: ColumnArrays) -> tuple[Intersection, ...]:
    """Intersections of the columns of `intersections.csv`.

    Parameters
    ----------
    columns : mapping of str to (N,) array

    Returns
    -------
    tuple of Intersection
    """
    positions = _rows(columns, ("x", "y", "z"))
    return tuple(
        Intersection(
            segment_1=int(columns["seg1"][i]),
            segment_2=int(columns["seg2"][i]),
            t_1=float(columns["t1"][i]),
            t_2=float(columns["t2"][i]),
            position=positions[i],
            distance=float(columns["distance"][i]),
            angle_deg=float(columns["angle_deg"][i]),
            joint=_index(columns["joint"][i]),
        )
        for i in range(len(positions))
    )


def joints_from_columns(
    columns: ColumnArrays, segments: Sequence[Segment], covariances: FloatArray
) -> tuple[Joint, ...]:
    """Joints of the columns of `joints.csv`.

    Parameters
    ----------
    columns : mapping of str to (N,) array
    segments : sequence of Segment
        That meet there.
    covariances : (N, 3, 3) float64, square metres
        Of the positions, whose diagonals alone the table holds.

    Returns
    -------
    tuple of Joint

    Raises
    ------
    ValueError
        If one names its segments by what is not a number.
    IndexError
        If there is no segment of that number.
    """
    joints = []
    for i, position in enumerate(_rows(columns, ("x", "y", "z"))):
        numbers = tuple(map(int, columns["segments"][i].split(_SEPARATOR)))
        axes = [(segments[k].anchor, segments[k].direction) for k in numbers]
        joints.append(
            Joint(
                position=position,
                covariance=covariances[i],
                residual=float(columns["residual"][i]),
                segments=numbers,
                t=tuple(float(line_parameters(position[None], *axis)[0]) for axis in axes),
            )
        )
    return tuple(joints)


def members_from_columns(columns: ColumnArrays) -> tuple[Member, ...]:
    """Members of the columns of `members.csv`.

    Parameters
    ----------
    columns : mapping of str to (N,) array

    Returns
    -------
    tuple of Member
    """
    return tuple(
        Member(
            segment=int(columns["segment"][i]),
            t_1=float(columns["t1"][i]),
            t_2=float(columns["t2"][i]),
            joint_1=_index(columns["joint_1"][i]),
            joint_2=_index(columns["joint_2"][i]),
        )
        for i in range(len(columns["member"]))
    )


def _section_columns(segments: Sequence[Segment]) -> ColumnArrays:
    sections = [segment.cross_section for segment in segments]
    columns: ColumnArrays = {
        "shape": np.array([section.shape for section in sections], dtype=object),
        "section": np.array([section.name for section in sections], dtype=object),
        "section_confidence": np.array([s.confidence for s in sections], np.float64),
        "roll_deg": np.array([s.cross_section.roll_deg(s.direction) for s in segments], np.float64),
    }
    for name in _SIZES:
        sizes = [getattr(section.size, name, 0.0) or np.nan for section in sections]
        columns[name] = np.array(sizes, dtype=np.float64)
    return columns


def _cross_section(columns: ColumnArrays, row: int, direction: FloatArray) -> CrossSection:
    shape = str(columns["shape"][row])
    known = next((kind for kind in SHAPES if kind == shape and kind != "round"), None)
    sizes = [float(np.nan_to_num(columns[name][row])) for name in _SIZES]
    return CrossSection(
        shape,
        Section(known, *sizes) if known else None,
        across_of(float(columns["roll_deg"][row]), direction),
        str(columns["section"][row]),
        float(columns["section_confidence"][row]),
    )


def _numbers(numbers: Sequence[int | None]) -> FloatArray:
    """Numbers of things, of which some are missing."""
    return np.array([np.nan if n is None else n for n in numbers], dtype=np.float64)


def _index(number: float) -> int | None:
    return None if np.isnan(number) else int(number)


def _both(one: bool | None, other: bool | None) -> tuple[bool, bool] | None:
    return None if one is None or other is None else (one, other)


def _vectors(names: tuple[str, str, str], vectors: Sequence[FloatArray]) -> ColumnArrays:
    stacked = np.array(vectors, dtype=np.float64).reshape(-1, 3)
    return {name: stacked[:, axis] for axis, name in enumerate(names)}


def _rows(columns: ColumnArrays, names: tuple[str, ...]) -> FloatArray:
    return np.stack([columns[name] for name in names], axis=1)


def _seconds_since(origin_ns: int, stamps_ns: Sequence[int]) -> FloatArray:
    # The difference is taken in integers: a stamp of today has no nanoseconds as a float.
    return np.array([(stamp - origin_ns) / 1e9 for stamp in stamps_ns], dtype=np.float64)
