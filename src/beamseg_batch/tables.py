"""Every column of every table of a run or of a truth, declared once."""

from __future__ import annotations

from beamseg_batch.csv_table import Column, ColumnArrays, Kind, Table

__all__ = [
    "CANDIDATES",
    "FLY_AGAIN",
    "INTERSECTIONS",
    "JOINTS",
    "MEMBERS",
    "PROCESSING_TIME",
    "SEGMENTS",
    "TABLES",
    "TRUTH",
    "TRUTH_JOINTS",
    "TRUTH_TABLES",
    "Column",
    "ColumnArrays",
    "Kind",
    "Table",
]


def _count(name: str, meaning: str, unit: str = "") -> Column:
    return Column(name, unit, meaning, kind="int")


def _flag_column(name: str, meaning: str) -> Column:
    return Column(name, "", meaning, kind="flag")


def _number(name: str, meaning: str) -> Column:
    return Column(name, "", meaning, kind="number")


def _metres(name: str, meaning: str) -> Column:
    return Column(name, "m", meaning)


def _true_metres(name: str, meaning: str) -> Column:
    return Column(name, "m", meaning, spec=".6f")


def _seconds(name: str, meaning: str) -> Column:
    return Column(name, "s", meaning, spec=".9f")


def _stage(name: str, meaning: str) -> Column:
    return Column(f"{name}_us", "µs", meaning, spec=".1f")


SEGMENTS = Table(
    "segments.csv",
    "One row per beam, in the world frame, in order of first detection.",
    (
        _count("segment", "Number of the beam, from 0"),
        _metres("a_x", "A point of the axis, x"),
        _metres("a_y", "A point of the axis, y"),
        _metres("a_z", "A point of the axis, z"),
        Column("b_x", "", "Unit direction of the axis, x"),
        Column("b_y", "", "Unit direction of the axis, y"),
        Column("b_z", "", "Unit direction of the axis, z"),
        _metres("t_min", "First end: `a + t_min * b`"),
        _metres("t_max", "Second end: `a + t_max * b`"),
        _metres("radius", "Radius of the beam"),
        _metres("length", "Distance between the ends"),
        _metres("x1", "First end, x"),
        _metres("y1", "First end, y"),
        _metres("z1", "First end, z"),
        _metres("x2", "Second end, x"),
        _metres("y2", "Second end, y"),
        _metres("z2", "Second end, z"),
        Column(
            "shape",
            "",
            "Cross-section: `round`, `square` (a tube, also oblong), `i`, `l` (angle), `c` "
            "(channel), or `unknown`: not round, but nothing else for sure. If it is neither round "
            "nor unknown, the axis runs through its centre of area, and `radius` is that of the "
            "cylinder by which the beam was found",
            kind="text",
        ),
        Column("section", "", "Standard size of the section; empty if it has none", kind="text"),
        Column(
            "section_confidence",
            "",
            "Probability that no other shape is the likelier one, 0 to 1; empty where none had to "
            "be tried",
        ),
        _metres(
            "width",
            "Extent of the section along its own u; this and the next four are empty where the "
            "shape is round or unknown",
        ),
        _metres("height", "Extent of the section along its own v"),
        _metres("web", "Thickness of its parts along v; empty for a tube"),
        _metres("flange", "Thickness of its parts along u; empty for a tube"),
        Column(
            "roll_deg",
            "°",
            "Turn of u about the axis, from the horizontal; from the world's x if that is vertical",
        ),
        _count(
            "n_points",
            "Filtered points that support the beam, over all scans; rays that it alone explains, "
            "with `structure.fusion: evidence`",
        ),
        _count("n_scans", "Scans in which the beam was found"),
        Column(
            "pca_coeff",
            "",
            "Largest share of the points' variance along one axis, 0 to 1; this and the next three "
            "are those of a full cylinder, with `structure.fusion: evidence`",
        ),
        Column("pca_eig_0", "m²", "Largest eigenvalue of the points' covariance"),
        Column("pca_eig_1", "m²", "Second eigenvalue of the points' covariance"),
        Column("pca_eig_2", "m²", "Smallest eigenvalue of the points' covariance"),
        _metres(
            "sigma_offset",
            "Standard deviation of the axis across its direction, halfway between the ends; this "
            "and the next ten are empty where they are not known",
        ),
        Column("sigma_angle_deg", "°", "Standard deviation of the direction"),
        _metres("measured_radius", "Radius that fits the rays best, whatever `radius` is"),
        _metres("sigma_radius", "Standard deviation of the measured radius"),
        _metres("bow", "Largest deviation of the axis from the line between its ends"),
        _metres("sigma_bow", "Standard deviation of the bow"),
        _metres("bow_x", "Which way the axis deviates, x: from that line's middle to the axis"),
        _metres("bow_y", "Which way the axis deviates, y"),
        _metres("bow_z", "Which way the axis deviates, z"),
        _metres("sigma_end_1", "Standard deviation of the first end along the axis"),
        _metres("sigma_end_2", "Standard deviation of the second end along the axis"),
        _flag_column(
            "end_1_seen",
            "Whether the camera saw past the first end, or what the beam ends in; empty where it "
            "was not asked",
        ),
        _flag_column("end_2_seen", "Likewise of the second end"),
        _seconds("first_seen_s", "First scan with the beam, from the start of the recording"),
        _seconds("last_seen_s", "Last scan with the beam, from the start of the recording"),
    ),
    deterministic=True,
)
"""The beams of the structure."""

INTERSECTIONS = Table(
    "intersections.csv",
    "One row per pair of beams that touch.",
    (
        _count("seg1", "Number of the first beam, the smaller of the two"),
        _metres("t1", "Where on the first beam: `a + t1 * b`"),
        _count("seg2", "Number of the second beam"),
        _metres("t2", "Where on the second beam: `a + t2 * b`"),
        _metres("x", "Halfway between the two axes, world frame, x"),
        _metres("y", "Halfway between the two axes, world frame, y"),
        _metres("z", "Halfway between the two axes, world frame, z"),
        _metres("distance", "Distance between the two axes"),
        Column("angle_deg", "°", "Angle between the two axes, 0 to 90"),
        _number("joint", "Number of the joint that it is part of"),
    ),
    deterministic=True,
)
"""Where beams touch."""

JOINTS = Table(
    "joints.csv",
    "One row per place where beams meet, in the world frame, in order of its beams.",
    (
        _count("joint", "Number of the joint, from 0"),
        _metres("x", "The point closest to all axes that meet there, x"),
        _metres("y", "The point closest to all axes that meet there, y"),
        _metres("z", "The point closest to all axes that meet there, z"),
        _count("n_segments", "Number of beams that meet there"),
        Column("segments", "", "Numbers of these beams, joined by `;`", kind="text"),
        _metres("residual", "Root mean square of the distances of their axes from the point"),
        _metres(
            "sigma_x",
            "Standard deviation of x; this and the next two are empty where that of an axis is "
            "not known",
        ),
        _metres("sigma_y", "Standard deviation of y"),
        _metres("sigma_z", "Standard deviation of z"),
    ),
    deterministic=True,
)
"""Where any number of beams meet."""

MEMBERS = Table(
    "members.csv",
    "One row per part of a beam between two consecutive joints or ends, in the world frame, in "
    "order of its beam, then along it.",
    (
        _count("member", "Number of the member, from 0"),
        _count("segment", "Number of the beam that it is part of"),
        _metres("t1", "Where on the beam it begins: `a + t1 * b`"),
        _metres("t2", "Where on the beam it ends: `a + t2 * b`"),
        _metres("length", "Distance between the two"),
        _number("joint_1", "Number of the joint where it begins; empty at a free end"),
        _number("joint_2", "Number of the joint where it ends; empty at a free end"),
        _metres("x1", "Where it begins, x; if the beam is bent, on its axis"),
        _metres("y1", "Where it begins, y"),
        _metres("z1", "Where it begins, z"),
        _metres("x2", "Where it ends, x; if the beam is bent, on its axis"),
        _metres("y2", "Where it ends, y"),
        _metres("z2", "Where it ends, z"),
        _metres("radius", "Radius of the beam"),
        Column("shape", "", "Cross-section of the beam", kind="text"),
    ),
    deterministic=True,
)
"""The beams between their joints."""

PROCESSING_TIME = Table(
    "processing_time.csv",
    "One row per processed scan, in time order.",
    (
        _count("wall_time", "From the start of processing to the end of this scan", "µs"),
        _count("processing_time", "Spent on this scan, reading included", "µs"),
        _count("seg_vec_size", "Beams in the structure after this scan"),
        _count("nblines", "Lines found in this scan, before screening"),
        _count("stamp_ns", "Stamp of the cloud", "ns"),
        _count("pose_stamp_ns", "Stamp of the pose nearest in time", "ns"),
        _seconds("pose_gap_s", "Time between the two stamps"),
        _count("n_points_raw", "Returns of the cloud"),
        _count("n_points_filtered", "Points given to the line search"),
        _stage("read", "Reading and decoding the scan"),
        _stage("filter", "Window, floor trim and voxel grid"),
        _stage("search", "Iterative Hough transform"),
        _stage("screen", "Screening of the lines, and the change to the world frame"),
        _stage("fuse", "Fusing the segments into the structure"),
    ),
    deterministic=False,
)
"""Times of every scan. The first four columns are those of the original node."""

CANDIDATES = Table(
    "candidates.parquet",
    "One row per thing that was or might have been a beam, in the order in which its fate was "
    "decided, in the world frame; lines of single scans that were refused at one place for one "
    "reason are one row.",
    (
        Column(
            "stage",
            "",
            "Where its fate was decided: `scan` (lines of scans), `leftovers` (lines in what no "
            "beam explains), `gathering` (too few sightings), `pass` or `end`",
            kind="text",
        ),
        _number("pass", "The pass over the rays that decided, from 1; null at other stages"),
        _number("candidate", "Number of the candidate; null for what was never asked about"),
        Column(
            "origin",
            "",
            "Where it came from: `scans`, `leftovers`, `split`, or `refused` as a round beam",
            kind="text",
        ),
        _number("parent", "The candidate that it was split from"),
        _metres("x1", "First end, x"),
        _metres("y1", "First end, y"),
        _metres("z1", "First end, z"),
        _metres("x2", "Second end, x"),
        _metres("y2", "Second end, y"),
        _metres("z2", "Second end, z"),
        _metres("radius", "Radius; of lines the one that was looked for"),
        _number("n_lines", "Lines that were found there; null where they were not counted"),
        _count("n_scans", "Scans that saw it"),
        _count("n_points", "Points of its lines, or rays that it alone explains (hits)"),
        Column("seen_through", "", "Rays that saw through it, at least; NaN where none were asked"),
        Column(
            "score",
            "",
            "Log-likelihood ratio of the evidence, as of the pass that decided; NaN without any",
        ),
        Column(
            "flank_left",
            "",
            "Share of the rays on its left that found something at its depth; NaN if too few",
        ),
        Column("flank_right", "", "Likewise on its right"),
        Column("reduced_chi2", "", "Of the fit of its axis"),
        _count("first_stamp_ns", "Stamp of the first scan that saw it", "ns"),
        _count("last_stamp_ns", "Stamp of the last one", "ns"),
        Column("fate", "", "`kept`, `merged` or `refused`", kind="text"),
        Column(
            "reason", "", "Name of the reason, as in `summary.json`; empty if kept", kind="text"
        ),
        Column("value", "", "What the reason is about; of lines of the one refused most narrowly"),
        Column("limit", "", "What the value had to reach, or not to exceed"),
        _number("into", "The candidate that it gave way to"),
        _number("segment", "Number of the beam that it is, or gave way to"),
    ),
    deterministic=True,
)
"""What might have been a beam, and why it is one or not; written where that is asked."""

FLY_AGAIN = Table(
    "fly_again.csv",
    "One row per place that the drone flies to, in the world frame, in that order.",
    (
        Column("x", "m", "Where the drone flies to, x", spec=".3f"),
        Column("y", "m", "Where the drone flies to, y", spec=".3f"),
        Column("z", "m", "Where the drone flies to, z", spec=".3f"),
        Column("yaw", "rad", "Where it looks when it arrives", spec=".4f"),
        Column("duration", "s", "Time that it takes from the place before", spec=".1f"),
    ),
    deterministic=True,
)
"""Where to fly again, as a file of waypoints; a run without need of it has none."""

TABLES = (SEGMENTS, INTERSECTIONS, JOINTS, MEMBERS, PROCESSING_TIME)
"""The tables that every run has."""

TRUTH = Table(
    "truth.csv",
    "One row per member as it truly stands, in the world frame.",
    (
        Column("id", "", "Name of the member", kind="text"),
        _true_metres("x1", "First end of the axis, x"),
        _true_metres("y1", "First end of the axis, y"),
        _true_metres("z1", "First end of the axis, z"),
        _true_metres("x2", "Second end of the axis, x"),
        _true_metres("y2", "Second end of the axis, y"),
        _true_metres("z2", "Second end of the axis, z"),
        _true_metres("radius", "Radius; half the larger extent of a section that is not round"),
        Column("shape", "", "Cross-section: `round`, `square`, `i`, `l` or `c`", kind="text"),
        Column("visible_fraction", "", "Share of the length that was seen", spec=".4f"),
        _true_metres("ox1", "First end of the longest stretch that was seen, x"),
        _true_metres("oy1", "First end of the longest stretch that was seen, y"),
        _true_metres("oz1", "First end of the longest stretch that was seen, z"),
        _true_metres("ox2", "Second end of the longest stretch that was seen, x"),
        _true_metres("oy2", "Second end of the longest stretch that was seen, y"),
        _true_metres("oz2", "Second end of the longest stretch that was seen, z"),
        Column("observed_length", "m", "Length of that stretch; 0 if none was seen", spec=".4f"),
        _count("frames", "Scans that hit the member"),
        Column(
            "intervals",
            "m",
            "All stretches that were seen, `from:to` along the axis from the first end, "
            "joined by `;`",
            kind="text",
        ),
        _true_metres("width", "Extent of the section along its u axis"),
        _true_metres("height", "Extent of the section along its v axis"),
        _true_metres("web", "Thickness of the parts along v; 0 if the section is round"),
        _true_metres("flange", "Thickness of the parts along u; 0 if the section is round"),
        Column("roll_deg", "°", "Turn of the section about the axis", spec=".4f"),
        _true_metres("bow", "Deviation of the axis from its chord at mid-length, along v"),
    ),
    deterministic=True,
    repeated="the same world is flown with the same seed again",
)
"""The members of a structure, and what a flight saw of them."""

TRUTH_JOINTS = Table(
    "truth_joints.csv",
    "One row per place where members truly meet.",
    (
        Column("ids", "", "Names of the members, joined by `;`", kind="text"),
        _true_metres("x", "Where they meet, world frame, x"),
        _true_metres("y", "Where they meet, world frame, y"),
        _true_metres("z", "Where they meet, world frame, z"),
    ),
    deterministic=True,
    repeated="the same world is flown with the same seed again",
)
"""Where the members of a structure meet."""

TRUTH_TABLES = (TRUTH, TRUTH_JOINTS)
"""Every table of a truth."""
