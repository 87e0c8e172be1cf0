"""Axes and joints as a map."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from beamseg_batch.bars import section_name
from beamseg_batch.export.content import Content
from beamseg_batch.export.geodesy import Origin
from beamseg_batch.geometry import FloatArray

__all__ = ["write_geojson"]


def write_geojson(content: Content, path: Path) -> int:
    """Write axes as lines and joints as points, RFC 7946 with heights."""
    assert content.origin is not None
    features = [*_lines(content, content.origin), *_points(content, content.origin)]
    document = {"type": "FeatureCollection", "features": features}
    path.write_text(json.dumps(document, indent=1), encoding="utf-8")
    return len(content.bars)


def _lines(content: Content, origin: Origin) -> Iterator[dict[str, Any]]:
    kind = content.what.removesuffix("s")
    for bar in content.bars:
        properties = {
            "kind": kind,
            kind: bar.number,
            "beam": bar.beam,
            "section": section_name(bar.section),
            "radius": bar.radius,
            "length": bar.length,
        }
        yield _feature("LineString", origin.geographic(bar.nodes), properties)


def _points(content: Content, origin: Origin) -> Iterator[dict[str, Any]]:
    for number, position in enumerate(origin.geographic(content.joints)):
        yield _feature("Point", position, {"kind": "joint", "joint": number})


def _feature(kind: str, coordinates: FloatArray, properties: dict[str, Any]) -> dict[str, Any]:
    # 11 decimals of a degree are a micrometre.
    rounded = np.round(coordinates, 11).tolist()
    return {
        "type": "Feature",
        "geometry": {"type": kind, "coordinates": rounded},
        "properties": properties,
    }
