"""Segments -> structure: fused as they come, or as hypotheses that all rays are asked about."""

from beamseg_batch.structure.cloud import ThinnedCloud
from beamseg_batch.structure.evidence import EvidenceStructure
from beamseg_batch.structure.fates import RefusedLines
from beamseg_batch.structure.intersections import intersections_of
from beamseg_batch.structure.joints import joints_of
from beamseg_batch.structure.members import members_of
from beamseg_batch.structure.questions import LeftoverQuestion, Leftovers
from beamseg_batch.structure.section_question import NearRays
from beamseg_batch.structure.sections import warm_up_sections
from beamseg_batch.structure.structure import Structure

__all__ = [
    "EvidenceStructure",
    "LeftoverQuestion",
    "Leftovers",
    "NearRays",
    "RefusedLines",
    "Structure",
    "ThinnedCloud",
    "intersections_of",
    "joints_of",
    "members_of",
    "warm_up_sections",
]
