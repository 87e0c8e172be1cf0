"""Segments -> structure: similarity, fusion and intersections, in time order."""

from beamseg_batch.structure.cloud import ThinnedCloud
from beamseg_batch.structure.structure import Structure

__all__ = ["Structure", "ThinnedCloud"]
