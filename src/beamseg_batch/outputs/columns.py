"""Between the objects of a flight and the columns of its tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import STAGES, FlightResult, Intersection, ScanRecord, Segment
from beamseg_batch.tables import ColumnArrays

__all__ = [
    "intersection_columns",
    "intersections_from_columns",
    "processing_time_columns",
    "segment_columns",
    "segments_from_columns",
    "time_origin_ns",
]

_CLOCK_SLACK_NS = 60 * 10**9


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
    for name in ("t_min", "t_max", "radius", "length", "pca_coeff"):
        columns[name] = np.array([getattr(s, name) for s in segments], dtype=np.float64)
    columns |= _vectors(("x1", "y1", "z1"), [s.end_1 for s in segments])
    columns |= _vectors(("x2", "y2", "z2"), [s.end_2 for s in segments])
    columns["shape"] = np.full(len(segments), "round", dtype=object)
    columns["n_points"] = np.array([s.n_points for s in segments], dtype=np.int64)
    columns["n_scans"] = np.array([s.n_scans for s in segments], dtype=np.int64)
    columns |= _vectors(("pca_eig_0", "pca_eig_1", "pca_eig_2"), [s.pca_eig for s in segments])
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
    }
    return columns | _vectors(("x", "y", "z"), [i.position for i in intersections])


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


def segments_from_columns(columns: ColumnArrays, origin_ns: int) -> tuple[Segment, ...]:
    """Segments of the columns of `segments.csv`, without their points.

    Parameters
    ----------
    columns : mapping of str to (N,) array
    origin_ns : int
        Instant from which seconds are counted.

    Returns
    -------
    tuple of Segment
    """
    anchors = _rows(columns, ("a_x", "a_y", "a_z"))
    directions = _rows(columns, ("b_x", "b_y", "b_z"))
    eigenvalues = _rows(columns, ("pca_eig_0", "pca_eig_1", "pca_eig_2"))
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
        )
        for i in range(len(positions))
    )


def _vectors(names: tuple[str, str, str], vectors: Sequence[FloatArray]) -> ColumnArrays:
    stacked = np.array(vectors, dtype=np.float64).reshape(-1, 3)
    return {name: stacked[:, axis] for axis, name in enumerate(names)}


def _rows(columns: ColumnArrays, names: tuple[str, str, str]) -> FloatArray:
    return np.stack([columns[name] for name in names], axis=1)


def _seconds_since(origin_ns: int, stamps_ns: Sequence[int]) -> FloatArray:
    # The difference is taken in integers: a stamp of today has no nanoseconds as a float.
    return np.array([(stamp - origin_ns) / 1e9 for stamp in stamps_ns], dtype=np.float64)
