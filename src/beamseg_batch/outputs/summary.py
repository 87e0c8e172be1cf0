"""`summary.json`: what a run did, for machines."""

from __future__ import annotations

import hashlib
import json
import math
import platform
from collections.abc import Iterable, Mapping, Sequence
from importlib import metadata
from typing import Any

import numpy as np

from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import STAGES, FlightResult, RecordingInfo, ScanRecord, SensorModel
from beamseg_batch.outputs.columns import time_origin_ns
from beamseg_batch.reasons import KINDS, LEFTOVER, REASONS
from beamseg_batch.tables import TABLES

__all__ = ["SCHEMA_VERSION", "results_sha256", "sensor_text", "summarise", "summary_json"]

SCHEMA_VERSION = 1
"""Raised when a key of the summary changes its name or its meaning."""

_LIBRARIES = ("beamseg-batch", "numpy", "numba", "rosbags")


def summarise(result: FlightResult, files: Iterable[str], results_hash: str) -> dict[str, Any]:
    """Summarise a flight.

    Parameters
    ----------
    result : FlightResult
    files : iterable of str
        Names of all files of the run, the summary itself included.
    results_hash : str
        The value of `results_sha256`.

    Returns
    -------
    dict
        JSON values only; the keys are always the same, and a value that is not known,
        such as a percentile of no scans, is None.
    """
    summary = {
        "schema_version": SCHEMA_VERSION,
        "versions": _versions(),
        "recording": _recording(result),
        "sensor": _sensor(result.sensor),
        "profile": result.config.profile,
        "counts": _counts(result),
        "rejections": _rejections(result),
        "totals": {
            "beam_length_m": math.fsum(segment.length for segment in result.segments),
            "wall_s": result.wall_s,
        },
        "processing": _processing(result.scans),
        "real_time": _real_time(result.scans),
        "warnings": [_without_folders(text, result.recording) for text in result.warnings],
        "interrupted": result.interrupted,
        "results_sha256": results_hash,
        "files": sorted(files),
        "configuration": result.config.model_dump(mode="json"),
    }
    finite: dict[str, Any] = _finite(summary)
    return finite


def summary_json(summary: Mapping[str, Any]) -> str:
    """Write a summary as strict JSON.

    Parameters
    ----------
    summary : mapping

    Returns
    -------
    str
        Ended by a line feed; never with the literals NaN or Infinity.
    """
    return json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def results_sha256(contents: Mapping[str, bytes]) -> str:
    """Hash of the results that are the same whenever the flight is processed again.

    Parameters
    ----------
    contents : mapping of str to bytes
        Files by name; those that are not deterministic tables do not count.

    Returns
    -------
    str
        SHA-256 over the name, the size and the bytes of each table, in hexadecimal.
    """
    digest = hashlib.sha256()
    for table in TABLES:
        if table.deterministic and table.file_name in contents:
            content = contents[table.file_name]
            digest.update(f"{table.file_name}\0{len(content)}\0".encode())
            digest.update(content)
    return digest.hexdigest()


def _versions() -> dict[str, str | None]:
    versions: dict[str, str | None] = {name: _installed(name) for name in _LIBRARIES}
    versions["python"] = platform.python_version()
    return dict(sorted(versions.items()))


def _installed(distribution: str) -> str | None:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def _recording(result: FlightResult) -> dict[str, Any]:
    recording = result.recording
    return {
        # Names only: a summary is passed on, and a path tells about the machine.
        "files": [path.name or str(path) for path in recording.paths],
        "container": recording.container,
        "sha256": recording.sha256,
        "size_bytes": recording.size_bytes,
        "start_ns": recording.start_ns,
        "end_ns": recording.end_ns,
        "duration_s": recording.duration_s,
        "time_origin_ns": time_origin_ns(result),
        "cloud_topic": recording.cloud_topic,
        "pose_topic": recording.pose_topic,
        "frames": {
            "sensor": recording.sensor_frame,
            "body": recording.body_frame,
            "world": recording.world_frame,
        },
        "extrinsic": _extrinsic(recording),
        "notes": [_without_folders(text, recording) for text in recording.notes],
        "recovered": recording.recovered,
        "damage": [_without_folders(text, recording) for text in recording.damage],
    }


def _without_folders(text: str, recording: RecordingInfo) -> str:
    """Text in which the recording's files are called by their names only."""
    # The longest first: one path may begin with another.
    for path in sorted(recording.paths, key=lambda path: -len(str(path))):
        if path.name and str(path) != path.name:
            text = text.replace(str(path), path.name)
    return text


def _extrinsic(recording: RecordingInfo) -> dict[str, Any]:
    return {
        "source": recording.extrinsic_source,
        "translation_m": recording.T_body_sensor.translation.tolist(),
        "rotation_matrix": (recording.T_body_sensor.rotation + 0.0).tolist(),
    }


def _sensor(sensor: SensorModel) -> dict[str, Any]:
    noise, jitter, pitch = sensor.noise, sensor.jitter, sensor.pitch_rad
    values = {
        "noise_m": (noise.constant, noise.source),
        "noise_relative": (noise.relative, noise.source),
        "mixed_pixels": (noise.mixed, noise.mixed_source),
        "pixel_pitch_rad": (pitch, "default" if pitch is None else "measured"),
        "pose_jitter_m": (jitter.position, jitter.position_source),
        "pose_jitter_deg": (math.degrees(jitter.attitude), jitter.attitude_source),
    }
    return {name: {"value": v, "source": source} for name, (v, source) in values.items()} | {
        "poses_smoothed": jitter.smoothed,
        "pose_jitter_left_m": jitter.left_position,
        "pose_jitter_left_deg": math.degrees(jitter.left_attitude),
    }


def sensor_text(sensor: SensorModel) -> str:
    """Say in one line what a run took the camera and its poses for.

    Parameters
    ----------
    sensor : SensorModel

    Returns
    -------
    str
    """
    noise, jitter = sensor.noise, sensor.jitter
    relative = f" + {1e2 * noise.relative:.2g} % of the depth" if noise.relative else ""
    pitch = "" if sensor.pitch_rad is None else f", {1e3 * sensor.pitch_rad:.1f} mrad a pixel"
    mixed = ", mixed at edges" if noise.mixed else ""
    left = f", smoothed to {_jitter_text(jitter.left_position, jitter.left_attitude)}"
    sources = sorted({jitter.position_source, jitter.attitude_source} - {"default"})
    poses = (
        f"poses jitter by {_jitter_text(jitter.position, jitter.attitude)} "
        f"({' and '.join(sources)}){left if jitter.smoothed else ''}"
    )
    depths = f"noise {1e3 * noise.constant:.2g} mm{relative} ({noise.source}){pitch}{mixed}"
    return "; ".join([depths, poses] if sources else [depths])


def _jitter_text(position: float, attitude: float) -> str:
    return f"{1e3 * position:.2f} mm, {math.degrees(attitude):.3f}°"


def _counts(result: FlightResult) -> dict[str, Any]:
    skipped = sum(result.skipped.values())
    return {
        "clouds": len(result.scans) + skipped,
        "processed": len(result.scans),
        "skipped": skipped,
        "skipped_by_reason": dict(sorted(result.skipped.items())),
        "lines": sum(scan.n_lines for scan in result.scans),
        "rejected": sum(result.rejections.values()),
        "rejected_by_criterion": dict(sorted(result.rejections.items())),
        "segments": len(result.segments),
        "intersections": len(result.intersections),
        "joints": len(result.joints),
        "members": len(result.members),
    }


def _rejections(result: FlightResult) -> dict[str, dict[str, int]]:
    """How many were refused for each reason: lines of scans, of leftovers, and candidates."""
    return {
        kind: {
            reason.name.removeprefix(LEFTOVER): result.rejections[reason.name]
            for reason in REASONS.values()
            if reason.kind == kind
        }
        for kind in KINDS
    }


def _processing(scans: Sequence[ScanRecord]) -> dict[str, Any]:
    times = np.array([scan.processing_us for scan in scans]) * 1e-3
    stages = {
        stage: np.array([scan.stage_us.get(stage, 0.0) for scan in scans]) * 1e-3
        for stage in STAGES
    }
    return _percentiles_ms(times) | {
        "stages": {stage: _percentiles_ms(values) for stage, values in stages.items()}
    }


def _percentiles_ms(times_ms: FloatArray) -> dict[str, float | None]:
    names = ("p50_ms", "p90_ms", "p99_ms", "max_ms", "mean_ms")
    if not len(times_ms):
        return dict.fromkeys(names)
    values = [*np.percentile(times_ms, (50, 90, 99, 100)), times_ms.mean()]
    return {name: float(value) for name, value in zip(names, values, strict=True)}


def _real_time(scans: Sequence[ScanRecord]) -> dict[str, Any]:
    """Whether a live node at this pace would have kept up with the clouds."""
    intervals_ms = np.diff([scan.stamp_ns for scan in scans]) * 1e-6
    if not len(intervals_ms) or not np.median(intervals_ms) > 0:
        return dict.fromkeys(("kept_up", "cloud_interval_ms", "load", "share_of_scans_late"))
    interval_ms = float(np.median(intervals_ms))
    times_ms = np.array([scan.processing_us for scan in scans]) * 1e-3
    load = float(times_ms.mean()) / interval_ms
    return {
        "kept_up": load <= 1.0,
        "cloud_interval_ms": interval_ms,
        "load": load,
        "share_of_scans_late": float(np.mean(times_ms > interval_ms)),
    }


def _finite(value: Any) -> Any:
    """Replace what JSON cannot hold by None, in a tree of JSON values."""
    if isinstance(value, Mapping):
        return {str(key): _finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(entry) for entry in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value
