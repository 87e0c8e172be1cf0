"""A finished run to the files of other programs: CAD, BIM, meshes, points, maps, tables."""

from __future__ import annotations

from beamseg_batch.export.exporting import FORMATS, Exported, export_run
from beamseg_batch.export.geodesy import Origin

__all__ = ["FORMATS", "Exported", "Origin", "export_run"]
