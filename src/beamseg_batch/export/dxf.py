"""Bars as a CAD drawing, by ezdxf."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from beamseg_batch.bars import Bar, section_name
from beamseg_batch.export.content import Content
from beamseg_batch.extras import load_extra
from beamseg_batch.prisms import mesh_of

__all__ = ["AXES", "JOINTS", "write_dxf"]

AXES, JOINTS = "AXES", "JOINTS"
"""Layers of the axes and of the joints. Solids are on a layer for each section."""

_YELLOW, _RED = 2, 1
_SECTION_COLOURS = (5, 3, 4, 6, 30, 140, 200, 90)
_METRES = 6  # as AutoCAD numbers units
_CROSS = 35  # how a point is shown: a circle with a cross


def write_dxf(content: Content, path: Path) -> int:
    """Write axes as lines, solids as meshes on layers by section, joints as points."""
    ezdxf = load_extra("ezdxf", f"a {path.suffix} file")
    drawing = ezdxf.new("R2010", units=_METRES)
    drawing.header["$PDMODE"], drawing.header["$PDSIZE"] = _CROSS, 0.05
    drawing.layers.add(AXES, color=_YELLOW)
    drawing.layers.add(JOINTS, color=_RED)
    space = drawing.modelspace()
    for bar in content.bars:
        _add_axis(space, bar)
        _add_solid(drawing, space, bar)
    for position in content.joints.tolist():
        space.add_point(position, dxfattribs={"layer": JOINTS})
    drawing.saveas(path)
    return len(content.bars)


def _add_axis(space: Any, bar: Bar) -> None:
    attributes = {"layer": AXES}
    if len(bar.nodes) > 2:
        space.add_polyline3d(bar.nodes.tolist(), dxfattribs=attributes)
    else:
        space.add_line(*bar.nodes.tolist(), dxfattribs=attributes)


def _add_solid(drawing: Any, space: Any, bar: Bar) -> None:
    layer = f"SECTION-{section_name(bar.section)}"
    if layer not in drawing.layers:
        number = len(drawing.layers) % len(_SECTION_COLOURS)
        drawing.layers.add(layer, color=_SECTION_COLOURS[number])
    mesh = mesh_of(bar)
    with space.add_mesh(dxfattribs={"layer": layer}).edit_data() as data:
        data.vertices = mesh.vertices.tolist()
        data.faces = mesh.triangles.tolist()
