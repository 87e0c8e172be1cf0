"""The figures of the report."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from beamseg_batch.bars import bars_of, beams_of
from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import FlightResult, Joint, Member, ScanRecord, Segment
from beamseg_batch.outputs.columns import member_columns, segment_columns, time_origin_ns
from beamseg_batch.outputs.fly_again import FlightPlan, Look
from beamseg_batch.pages.charts import Chart, Limit, Series, envelope, histogram, quartiles
from beamseg_batch.pages.figures import thinned
from beamseg_batch.pages.scenes import Bars, Marks, Path, Points, Scene, Shade
from beamseg_batch.tables import MEMBERS, SEGMENTS, ColumnArrays

__all__ = [
    "MAX_BEAMS",
    "MAX_CLOUD_POINTS",
    "charts",
    "structure_scene",
]

MAX_BEAMS = 2_000
"""Beams, and as many joints and members, that are drawn."""
MAX_CLOUD_POINTS = 30_000
"""Points of the cloud that are drawn."""

_MAX_TRAJECTORY_POINTS = 4_000
_MAX_BOXES = 16
_JOINT_REACH = 2.8  # in radii of the thickest beam, so 1.8 of them stand out
_MEMBER_REACH = 0.04  # of a radius, so that members hide the beams that they are parts of
_PLACE_REACH_M = 0.12

# The page replaces these names by the colours of its light or dark theme.
_BEAM, _JOINT, _PATH, _CLOUD, _AGAIN = "$beam", "$joint", "$path", "$cloud", "$chosen"


def structure_scene(
    result: FlightResult,
    plan: FlightPlan,
    labels: Sequence[str] = (),
    shades: Mapping[str, Shade] = MappingProxyType({}),
) -> Scene:
    """Draw beams, joints, members, trajectory, a thinned cloud and where to fly again.

    Parameters
    ----------
    result : FlightResult
    plan : FlightPlan
    labels : sequence of str
        Of the beams that are drawn, HTML.
    shades : mapping of str to Shade
        Ways to colour them; the first is that of the still pictures.

    Returns
    -------
    Scene
        Metres, world frame.
    """
    segments = result.segments[:MAX_BEAMS]
    members = [member for member in result.members if member.segment < MAX_BEAMS]
    tables = {
        SEGMENTS.name: segment_columns(segments, time_origin_ns(result)),
        MEMBERS.name: member_columns(members[:MAX_BEAMS], segments),
    }
    beams = beams_of(tables[SEGMENTS.name])
    places = result.trajectory.positions
    cloud = result.cloud[np.isfinite(result.cloud).all(axis=1)]
    parts = (
        Points("cloud", _CLOUD, cloud[thinned(len(cloud), MAX_CLOUD_POINTS)]),
        Path("trajectory", _PATH, places[thinned(len(places), _MAX_TRAJECTORY_POINTS)]),
        Bars(
            "beams",
            _BEAM,
            beams,
            labels,
            shades,
            named=[str(beam.number) for beam in beams],
        ),
        _members(members, tables),
        _joints(result),
        _places([look for look in plan.looks if look.place is not None][:MAX_BEAMS]),
    )
    ends = [end for beam in result.segments for end in (beam.end_1, beam.end_2)]
    bends = [beam.nodes for beam in beams if len(beam.nodes) > 2]
    shown = np.concatenate([np.reshape(ends, (-1, 3)), *bends, places, cloud])
    count = f"{len(result.segments)} beams, {len(result.joints)} joints"
    return Scene(parts, shown, f"the structure: {count}, and the path that was flown")


def charts(result: FlightResult, interval_ms: float | None) -> dict[str, tuple[str, Chart]]:
    """Draw what a flight took and gave, scan by scan.

    Parameters
    ----------
    result : FlightResult
    interval_ms : float or None
        Time between two clouds, drawn as the limit of real time.

    Returns
    -------
    mapping of str to (title, chart)
        Only those for which there are numbers.
    """
    if not result.scans:
        return {}
    made = {
        "processing": ("Processing time of every scan", _processing(result, interval_ms)),
        "by-lines": ("Processing time by number of lines", _times_by_lines(result.scans)),
        "points": ("Points of every scan", _points(result)),
        "lines": ("Lines of every scan", _lines(result)),
        "size": ("Beams over the flight", _size(result)),
        "gaps": ("From every scan to its nearest pose", _gaps(result)),
    }
    return made | _sigmas(result.segments)


def _processing(result: FlightResult, interval_ms: float | None) -> Chart:
    times_ms = _each(result.scans, lambda scan: scan.processing_us * 1e-3)
    top = _upper_limit(times_ms)
    limit = None
    if interval_ms is not None and interval_ms <= 3 * top:
        top = max(top, 1.1 * interval_ms)
        limit = Limit("y", interval_ms, "time between two clouds")
    series = _over_time(result, "scan", _BEAM, times_ms)
    description = f"processing time of every scan; median {np.median(times_ms):.1f} ms"
    return Chart("flight time [s]", "processing time [ms]", (series,), description, top, limit)


def _times_by_lines(scans: Sequence[ScanRecord]) -> Chart:
    """Figures 14a and 14b of the report, which shows a tenth of the true seconds.

    Its plots divide microseconds by 10⁷.
    """
    times_ms = _each(scans, lambda scan: scan.processing_us * 1e-3)
    lines = _each(scans, lambda scan: scan.n_lines).astype(np.int64)
    lines = np.minimum(lines, _MAX_BOXES)
    groups = {"all": times_ms} | {_count_name(n): times_ms[lines == n] for n in np.unique(lines)}
    boxes = np.array([quartiles(times) for times in groups.values()])
    series = Series(
        "boxes", "scans", _BEAM, np.arange(len(groups), dtype=np.float64), boxes, tuple(groups)
    )
    return Chart(
        "lines found in the scan",
        "processing time [ms]",
        (series,),
        "distribution of the processing time, for all scans and by number of lines",
    )


def _count_name(count: int) -> str:
    return f"≥{count}" if count >= _MAX_BOXES else str(count)


def _points(result: FlightResult) -> Chart:
    raw = _each(result.scans, lambda scan: scan.n_points_raw)
    filtered = _each(result.scans, lambda scan: scan.n_points_filtered)
    series = (
        _over_time(result, "returns", _CLOUD, raw),
        _over_time(result, "searched", _BEAM, filtered),
    )
    description = (
        f"points of every scan; median {np.median(raw):.0f} returns, "
        f"{np.median(filtered):.0f} searched"
    )
    return Chart("flight time [s]", "points", series, description)


def _lines(result: FlightResult) -> Chart:
    lines = _each(result.scans, lambda scan: scan.n_lines)
    series = _over_time(result, "lines", _BEAM, lines)
    description = f"lines found in every scan; {lines.mean():.1f} on average"
    return Chart("flight time [s]", "lines found", (series,), description)


def _size(result: FlightResult) -> Chart:
    sizes = _each(result.scans, lambda scan: scan.n_segments)
    series = _over_time(result, "beams", _PATH, sizes, steps=True)
    description = f"beams known after every scan; {sizes[-1]:.0f} after the last"
    return Chart("flight time [s]", "beams in the structure", (series,), description)


def _gaps(result: FlightResult) -> Chart:
    gaps_ms = _each(result.scans, lambda scan: scan.pose_gap_s * 1e3)
    limit_ms = 1e3 * result.config.matching.max_gap_s
    limit = Limit("x", limit_ms, "limit") if limit_ms <= 3 * gaps_ms.max() else None
    series = Series("bars", "scans", _PATH, *histogram(gaps_ms))
    description = f"time from every scan to its nearest pose; at most {gaps_ms.max():.1f} ms"
    return Chart("time to the nearest pose [ms]", "scans", (series,), description, limit=limit)


def _sigmas(beams: Sequence[Segment]) -> dict[str, tuple[str, Chart]]:
    """Histograms of the standard deviations, as far as they are known."""
    kinds = {
        "sigma-offset": ("axis across", "mm", [1e3 * beam.sigma_offset for beam in beams]),
        "sigma-angle": ("direction", "°", [beam.sigma_angle_deg for beam in beams]),
        "sigma-end": ("ends", "mm", [1e3 * sigma for beam in beams for sigma in beam.sigma_ends]),
    }
    made = {}
    for name, (what, unit, values) in kinds.items():
        known = np.array(values)[np.isfinite(values)]
        if len(known):
            series = Series("bars", "beams", _BEAM, *histogram(known, 16))
            description = f"standard deviations, {what}; median {np.median(known):.2g} {unit}"
            chart = Chart(f"σ, {what} [{unit}]", "number", (series,), description)
            made[name] = (f"Standard deviation: {what}", chart)
    return made


def _each(scans: Sequence[ScanRecord], value: Callable[[ScanRecord], float]) -> FloatArray:
    return np.array([value(scan) for scan in scans], dtype=np.float64)


def _over_time(
    result: FlightResult, name: str, colour: str, values: FloatArray, *, steps: bool = False
) -> Series:
    origin = time_origin_ns(result)
    times_s = _each(result.scans, lambda scan: (scan.stamp_ns - origin) / 1e9)
    return Series("steps" if steps else "line", name, colour, *envelope(times_s, values))


def _members(members: Sequence[Member], tables: Mapping[str, ColumnArrays]) -> Bars:
    """Draw the parts between joints, apart from one another where a beam has several."""
    bars = bars_of(tables, "members")
    around = [
        replace(bar, section=bar.section.grown(_MEMBER_REACH * bar.section.radius)) for bar in bars
    ]
    labels = [_member_label(bar.number, members[bar.number]) for bar in bars]
    return Bars("members", _PATH, around, labels, hidden=True)


def _member_label(number: int, member: Member) -> str:
    ends = [
        "a free end" if joint is None else f"joint {joint}"
        for joint in (member.joint_1, member.joint_2)
    ]
    return (
        f"<b>member {number}</b><br>{member.length:.3f} m of beam {member.segment}"
        f"<br>from {ends[0]} to {ends[1]}"
    )


def _joints(result: FlightResult) -> Marks:
    joints = result.joints[:MAX_BEAMS]
    centres = np.array([joint.position for joint in joints]).reshape(-1, 3)
    radii = [max(result.segments[k].radius for k in joint.segments) for joint in joints]
    labels = [_joint_label(number, joint) for number, joint in enumerate(joints)]
    return Marks("joints", _JOINT, centres, _JOINT_REACH * np.array(radii), labels)


def _joint_label(number: int, joint: Joint) -> str:
    return (
        f"<b>joint {number}</b><br>beams {', '.join(map(str, joint.segments))}"
        f"<br>axes within {joint.residual * 1e3:.1f} mm"
    )


def _places(looks: Sequence[Look]) -> Marks:
    centres = np.array([look.place for look in looks]).reshape(-1, 3)
    labels = [
        f"<b>fly here again</b><br>beam {look.beam}: {', '.join(look.reasons)}" for look in looks
    ]
    return Marks("fly again", _AGAIN, centres, np.full(len(looks), _PLACE_REACH_M), labels)


def _upper_limit(times_ms: FloatArray) -> float:
    """Top of a time axis: a single slow scan, such as the first, must not flatten the rest."""
    usual, largest = np.percentile(times_ms, (98, 100))
    return float(1.1 * largest if largest <= 4 * usual else 2 * usual) or 1.0
