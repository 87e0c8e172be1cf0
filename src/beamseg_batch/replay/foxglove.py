"""Messages of Foxglove's `SceneUpdate`, as ROS has them.

ROS messages rather than protobuf: a player of ROS refuses a file of two serialisations.
"""

from __future__ import annotations

__all__ = ["SCENE_TYPES"]

_PLACED = "geometry_msgs/Pose pose\n"
_COLOUR = "foxglove_msgs/Color color\n"
_SIZED = f"{_PLACED}geometry_msgs/Vector3 size\n"
_MANY_POINTS = (
    "geometry_msgs/Point[] points\nfoxglove_msgs/Color color\nfoxglove_msgs/Color[] colors\n"
    "uint32[] indices\n"
)

SCENE_TYPES = {
    "Color": "float64 r\nfloat64 g\nfloat64 b\nfloat64 a\n",
    "KeyValuePair": "string key\nstring value\n",
    "ArrowPrimitive": f"{_PLACED}float64 shaft_length\nfloat64 shaft_diameter\n"
    f"float64 head_length\nfloat64 head_diameter\n{_COLOUR}",
    "CubePrimitive": f"{_SIZED}{_COLOUR}",
    "SpherePrimitive": f"{_SIZED}{_COLOUR}",
    "CylinderPrimitive": f"{_SIZED}float64 bottom_scale\nfloat64 top_scale\n{_COLOUR}",
    "LinePrimitive": f"uint8 type\n{_PLACED}float64 thickness\nbool scale_invariant\n"
    f"{_MANY_POINTS}",
    "TriangleListPrimitive": f"{_PLACED}{_MANY_POINTS}",
    "TextPrimitive": f"{_PLACED}bool billboard\nfloat64 font_size\nbool scale_invariant\n"
    f"{_COLOUR}string text\n",
    "ModelPrimitive": f"{_PLACED}geometry_msgs/Vector3 scale\n{_COLOUR}bool override_color\n"
    "string url\nstring media_type\nuint8[] data\n",
    "SceneEntityDeletion": "builtin_interfaces/Time timestamp\nuint8 type\nstring id\n",
    "SceneEntity": "builtin_interfaces/Time timestamp\nstring frame_id\nstring id\n"
    "builtin_interfaces/Duration lifetime\nbool frame_locked\n"
    "foxglove_msgs/KeyValuePair[] metadata\n"
    + "".join(
        f"foxglove_msgs/{kind}Primitive[] {kinds}\n"
        for kind, kinds in (
            ("Arrow", "arrows"),
            ("Cube", "cubes"),
            ("Sphere", "spheres"),
            ("Cylinder", "cylinders"),
            ("Line", "lines"),
            ("TriangleList", "triangles"),
            ("Text", "texts"),
            ("Model", "models"),
        )
    ),
    "SceneUpdate": "foxglove_msgs/SceneEntityDeletion[] deletions\n"
    "foxglove_msgs/SceneEntity[] entities\n",
}
"""Definitions by type: what Foxglove calls `foxglove.SceneUpdate`, and what it is made of."""
