"""Kernels loaded or compiled before they are timed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from beamseg_batch.config import RunConfig
from beamseg_batch.detection import (
    DEFAULT_NOISE,
    Detector,
)
from beamseg_batch.foreground import thin_foreground
from beamseg_batch.geometry import RigidTransform
from beamseg_batch.model import (
    Scan,
    SensorModel,
)
from beamseg_batch.passes import new_structure
from beamseg_batch.structure import (
    EvidenceStructure,
    ThinnedCloud,
    intersections_of,
    warm_up_sections,
)

__all__ = ["warm_up"]


def warm_up(like: RunConfig) -> None:
    """Load or compile every kernel, so that no scan's time contains it.

    A made-up scan of two beams that cross is detected and fused twice; nothing of it is
    kept, and no value of the user's configuration is needed.
    """
    along = np.linspace(-0.6, 0.6, 80)
    ahead, none = np.ones_like(along), np.zeros_like(along)
    beams = np.concatenate(
        [np.stack([ahead, none, along], axis=1), np.stack([ahead, along, none], axis=1)]
    )
    points = beams.astype(np.float32)
    points.flags.writeable = False  # as those of a recording, which are compiled for apart
    T_world_body = RigidTransform(np.eye(3), np.array([0.0, 0.0, 2.0]))
    scan = Scan(
        index=0,
        stamp_ns=0,
        pose_stamp_ns=0,
        T_world_body=T_world_body,
        T_body_sensor=RigidTransform.identity(),
        points=points,
        width=len(beams),
        height=1,
    )
    config = RunConfig.model_validate(
        {"structure": {"fusion": like.structure.fusion}, "detection": {"axis": like.detection.axis}}
    )
    detect, structure = Detector(config), new_structure(config, SensorModel(DEFAULT_NOISE))
    for _ in range(3):
        detections = detect(scan)
        structure.update(detections)
    if isinstance(structure, EvidenceStructure):
        for _ in range(2):
            question = structure.question()
            sums = question.sums()
            sums.add(question.ask([scan]))
            structure.renew(sums)
        structure.set_ends(structure.end_question().ask([scan])[None])
        structure.leftover_question().ask([scan])
        structure.section_question().ask([scan])
        warm_up_sections()
    if like.filtering.foreground == "thin":
        thin_foreground(replace(scan, width=16, height=10), 0.05, 1.5, DEFAULT_NOISE)
    intersections_of(detections.segments, config.structure.intersections)
    ThinnedCloud(len(beams), 0.1).add(detections.cloud)
