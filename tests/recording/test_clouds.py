"""Points of every cloud layout, against a plain decoder that walks the bytes."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beamseg_batch.recording.clouds import BadCloudError, points_from_cloud


@dataclass
class Field:
    name: str
    offset: int
    datatype: int
    count: int = 1


@dataclass
class Cloud:
    height: int
    width: int
    point_step: int
    row_step: int
    data: Any
    fields: list[Field]
    is_bigendian: bool = False
    noise: dict[str, Any] = field(default_factory=dict)


CODES = {1: "b", 2: "B", 3: "h", 4: "H", 5: "i", 6: "I", 7: "f", 8: "d"}


def points_one_by_one(cloud: Cloud) -> list[list[float]]:
    """Slow and obvious: one struct per coordinate."""
    order = ">" if cloud.is_bigendian else "<"
    data, by_name = bytes(cloud.data), {}
    for entry in reversed(cloud.fields):
        by_name[entry.name] = entry
    points = []
    for row in range(cloud.height):
        for column in range(cloud.width):
            start = row * cloud.row_step + column * cloud.point_step
            point = []
            for name in "xyz":
                code = order + CODES[by_name[name].datatype]
                point.append(struct.unpack_from(code, data, start + by_name[name].offset)[0])
            points.append(point)
    return points


@st.composite
def clouds(draw) -> Cloud:
    """Clouds with fields in any order and place, of any size and padding."""
    kinds = st.sampled_from([7, 7, 7, 8, *CODES])
    same = draw(kinds)
    types = {name: same if draw(st.booleans()) else draw(kinds) for name in "xyz"}
    extra = draw(st.lists(st.sampled_from(sorted(CODES)), max_size=3))
    entries = [*types.items(), *((f"extra_{k}", code) for k, code in enumerate(extra))]
    if draw(st.booleans()):
        entries = draw(st.permutations(entries))
    fields, offset = [], draw(st.integers(0, 3))
    for name, code in entries:
        fields.append(Field(name, offset, code))
        offset += struct.calcsize(CODES[code]) + draw(st.sampled_from([0, 0, 0, 1, 4]))
    if draw(st.booleans()):
        fields = draw(st.permutations(fields))
    height, width = draw(st.integers(1, 3)), draw(st.integers(1, 4))
    row_step = width * offset + draw(st.sampled_from([0, 0, 3, 8]))
    size = height * row_step + draw(st.sampled_from([0, 0, 5]))
    raw = draw(st.binary(min_size=size + 8, max_size=size + 8))
    shift = draw(st.integers(0, 7))  # messages start at any address
    data = np.frombuffer(raw, dtype=np.uint8)[shift : shift + size]
    return Cloud(height, width, offset, row_step, data, fields, draw(st.booleans()))


@given(clouds())
def test_points_from_cloud__agrees_with_one_by_one(cloud):
    points = points_from_cloud(cloud)
    expected = np.array(points_one_by_one(cloud), dtype=points.dtype)
    assert points.shape == (cloud.height * cloud.width, 3)
    assert points.dtype in (np.float32, np.float64)
    assert points.dtype.isnative
    assert points.flags.aligned
    np.testing.assert_array_equal(points, expected)


@given(clouds())
def test_points_from_cloud__float64_only_when_needed(cloud):
    doubles = [e for e in cloud.fields if e.name in "xyz" and e.datatype in (5, 6, 8)]
    assert points_from_cloud(cloud).dtype == (np.float64 if doubles else np.float32)


def plain_cloud(count: int = 6, **changes: Any) -> Cloud:
    data = np.arange(count * 4, dtype="<f4").view(np.uint8)
    fields = [Field(name, 4 * k, 7) for k, name in enumerate("xyz")]
    values = {
        "height": 1, "width": count, "point_step": 16, "row_step": 16 * count,
        "data": data, "fields": fields,
    }  # fmt: skip
    return Cloud(**{**values, **changes})


def test_points_from_cloud__is_a_read_only_view():
    cloud = plain_cloud()
    points = points_from_cloud(cloud)
    assert np.shares_memory(points, cloud.data)
    assert not points.flags.writeable


def test_points_from_cloud__no_returns_stay():
    data = np.array([[np.nan] * 3, [1, 2, 3], [np.inf, 0, 0]], dtype="<f4").view(np.uint8).ravel()
    points = points_from_cloud(plain_cloud(3, point_step=12, row_step=36, data=data))
    np.testing.assert_array_equal(points, [[np.nan] * 3, [1, 2, 3], [np.inf, 0, 0]])


@pytest.mark.parametrize(("height", "width"), [(0, 0), (0, 5), (1, 0)])
def test_points_from_cloud__no_points(height, width):
    cloud = plain_cloud(0, height=height, width=width, fields=[], point_step=0, row_step=0)
    assert points_from_cloud(cloud).shape == (0, 3)


def test_points_from_cloud__row_step_left_at_zero():
    cloud = plain_cloud(row_step=0)
    np.testing.assert_array_equal(points_from_cloud(cloud), points_from_cloud(plain_cloud()))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"fields": [Field("x", 0, 7), Field("z", 4, 7)]},
            "no field 'y'; its fields are: x, z",
        ),
        ({"fields": []}, "no field 'x'; its fields are: none"),
        (
            {"fields": [Field("x", 0, 99), Field("y", 4, 7), Field("z", 8, 7)]},
            "'x' is of type 99, which is none",
        ),
        ({"data": np.zeros(95, dtype=np.uint8)}, "95 bytes, but 1 rows of 96 bytes need 96"),
        ({"row_step": 80}, "row_step 80 is less than 6 points of 16 bytes"),
        (
            {"point_step": 10, "row_step": 60},
            "'z' at byte 8 does not fit into a point of 10 bytes",
        ),
    ],
)
def test_points_from_cloud__bad_layout(changes, message):
    with pytest.raises(BadCloudError, match=message):
        points_from_cloud(plain_cloud(**changes))
