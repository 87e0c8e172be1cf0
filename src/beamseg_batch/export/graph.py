"""The structural graph as JSON: nodes, sections and members, for frame analysis."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from beamseg_batch.bars import Bar, section_name
from beamseg_batch.export.content import Content
from beamseg_batch.section import Section
from beamseg_batch.tables import JOINTS, MEMBERS

__all__ = ["SCHEMA_FILE", "SCHEMA_VERSION", "structural_graph", "write_graph"]

SCHEMA_VERSION = 2
"""Raised when a key changes its name or its meaning."""

SCHEMA_FILE = "structural_graph.schema.json"
"""JSON schema of the file, beside this module."""


def schema() -> dict[str, Any]:
    """JSON schema that every graph fulfils."""
    text = resources.files("beamseg_batch.export").joinpath(SCHEMA_FILE).read_text("utf-8")
    loaded: dict[str, Any] = json.loads(text)
    return loaded


def write_graph(content: Content, path: Path) -> int:
    """Write the structural graph."""
    graph = structural_graph(content)
    path.write_text(json.dumps(graph, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return len(graph["members"])


def structural_graph(content: Content) -> dict[str, Any]:
    """Nodes, sections and members, each with a name that the others refer to.

    Parameters
    ----------
    content : Content

    Returns
    -------
    dict
        As its schema says. A node is a joint, or the free end of a member.
    """
    nodes, members = _joints(content), []
    sections: dict[Section, str] = {}
    columns = content.tables[MEMBERS.name]
    for bar in content.bars:
        ends = []
        for k, position in enumerate((bar.start, bar.end), start=1):
            joint = float(columns[f"joint_{k}"][bar.number])
            if np.isnan(joint):
                ends.append(f"E{bar.number}.{k}")
                nodes.append({"id": ends[-1], "kind": "free_end", "position": position.tolist()})
            else:
                ends.append(f"J{int(joint)}")
        section = sections.setdefault(bar.section, f"S{len(sections)}")
        members.append(_member(bar, section, ends))
    recording = content.run.summary["recording"]
    return {
        "schema_version": SCHEMA_VERSION,
        "units": {"length": "m", "angle": "deg"},
        "frame": recording.get("world_frame") or "world",
        "source": {"results_sha256": content.run.summary.get("results_sha256")},
        "nodes": nodes,
        "sections": [_section(section, name) for section, name in sections.items()],
        "members": members,
    }


def _joints(content: Content) -> list[dict[str, Any]]:
    columns = content.tables[JOINTS.name]
    sigmas = np.column_stack([columns[f"sigma_{axis}"] for axis in "xyz"])
    return [
        {
            "id": f"J{number}",
            "kind": "joint",
            "position": position,
            "sigma": sigma if np.isfinite(sigma).all() else None,
        }
        for number, (position, sigma) in enumerate(
            zip(content.joints.tolist(), sigmas.tolist(), strict=True)
        )
    ]


def _section(section: Section, name: str) -> dict[str, Any]:
    sizes = {size: getattr(section, size) for size in ("width", "height", "web", "flange")}
    described = {"id": name, "name": section_name(section), "shape": section.shape}
    return {**described, "radius": section.radius, **sizes}


def _member(bar: Bar, section: str, ends: list[str]) -> dict[str, Any]:
    return {
        "id": f"M{bar.number}",
        "beam": bar.beam,
        "node_1": ends[0],
        "node_2": ends[1],
        "end_1": bar.start.tolist(),
        "end_2": bar.end.tolist(),
        "length": bar.length,
        "section": section,
        "axis_u": bar.rotation[:, 0].tolist(),
        "roll_deg": bar.roll_deg,
        "bow": bar.bow.tolist(),
    }
