"""`structure.npz`: arrays that repeat byte for byte and read back."""

from __future__ import annotations

import dataclasses
import io
import time
import zipfile

import numpy as np
import pytest

from beamseg_batch.errors import RunError
from beamseg_batch.outputs.structure_file import (
    ARRAYS,
    documentation,
    read_structure,
    structure_arrays,
    structure_npz,
)


def written(tmp_path, arrays):
    file = tmp_path / "structure.npz"
    file.write_bytes(structure_npz(arrays))
    return file


def assert_equal(one, other):
    assert list(one) == list(other)
    for name, array in one.items():
        np.testing.assert_array_equal(array, other[name], err_msg=name)
        assert array.dtype == other[name].dtype


def test_read_structure__gives_what_was_written(tmp_path, flight):
    arrays = structure_arrays(flight)
    assert_equal(read_structure(written(tmp_path, arrays)), arrays)


def test_structure_npz__is_what_numpy_reads(flight):
    arrays = structure_arrays(flight)
    with np.load(io.BytesIO(structure_npz(arrays)), allow_pickle=False) as archive:
        assert_equal(dict(archive), arrays)


def test_structure_npz__no_clock_is_asked(flight, monkeypatch):
    first = structure_npz(structure_arrays(flight))
    monkeypatch.setattr(time, "time", lambda: 2e9)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1234567890")
    assert structure_npz(structure_arrays(flight)) == first


def test_structure_arrays__hold_the_structure(flight):
    arrays = structure_arrays(flight)
    assert [(array.name, array.dtype) for array in ARRAYS] == [
        (name, str(values.dtype)) for name, values in arrays.items()
    ]
    segment, joint = flight.segments[2], flight.joints[1]
    ends = arrays["segment_anchor"][2] + np.outer(
        arrays["segment_t"][2], arrays["segment_direction"][2]
    )
    np.testing.assert_array_equal(ends, [segment.end_1, segment.end_2])
    np.testing.assert_array_equal(arrays["segment_covariance"][2], segment.covariance)
    np.testing.assert_array_equal(arrays["segment_ends_seen"][2], segment.ends_seen)
    np.testing.assert_array_equal(arrays["joint_covariance"][1], joint.covariance)
    np.testing.assert_array_equal(arrays["cloud"], flight.cloud)
    assert len(arrays["trajectory_position"]) == len(flight.trajectory)


def test_structure_arrays__ends_of_which_nobody_asked_are_nan(flight):
    segments = tuple(dataclasses.replace(one, ends_seen=None) for one in flight.segments)
    arrays = structure_arrays(dataclasses.replace(flight, segments=segments))
    assert np.isnan(arrays["segment_ends_seen"]).all()


def test_structure_arrays__of_nothing_have_their_shapes(tmp_path, empty_flight):
    arrays = read_structure(written(tmp_path, structure_arrays(empty_flight)))
    assert arrays["segment_covariance"].shape == (0, 6, 6)
    assert arrays["joint_position"].shape == (0, 3)
    assert arrays["cloud"].shape == (0, 3)


def test_read_structure__leaves_what_it_does_not_know(tmp_path, flight):
    arrays = structure_arrays(flight)
    assert_equal(read_structure(written(tmp_path, arrays | {"later": np.zeros(3)})), arrays)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"schema_version": np.array(9)}, "has schema_version 9, this version reads up to 1"),
        ({"segment_radius": None}, "has no array segment_radius"),
        ({"joint_position": np.zeros((3, 3))}, r"joint_covariance has shape \(2, 3, 3\), not \(3,"),
        ({"segment_t": np.zeros((7, 3))}, r"segment_t has shape \(7, 3\), not \(7, 2\)"),
        ({"schema_version": np.zeros(2)}, r"schema_version has shape \(2,\), not \(\)"),
        ({"cloud": np.zeros(())}, r"cloud has shape \(\), not \(0, 3\)"),
    ],
)
def test_read_structure__wrong_arrays(tmp_path, flight, changes, reason):
    arrays = {**structure_arrays(flight), **changes}
    kept = {name: array for name, array in arrays.items() if array is not None}
    with pytest.raises(RunError, match=rf"structure\.npz: {reason}"):
        read_structure(written(tmp_path, kept))


def test_read_structure__unreadable(tmp_path, flight):
    file = tmp_path / "structure.npz"
    with pytest.raises(RunError, match="cannot be read: No such file"):
        read_structure(file)
    whole = structure_npz(structure_arrays(flight))
    for content in (b"", b"PK", b"no archive", whole[: len(whole) // 2], whole[:-30]):
        file.write_bytes(content)
        with pytest.raises(RunError, match="holds no arrays"):
            read_structure(file)


def test_read_structure__objects_are_not_unpickled(tmp_path):
    file = tmp_path / "structure.npz"
    np.savez(file, schema_version=np.array([{}], dtype=object))
    with pytest.raises(RunError, match="holds no arrays"):
        read_structure(file)


def test_read_structure__damaged_within(tmp_path, flight):
    whole = bytearray(structure_npz(structure_arrays(flight)))
    entries = zipfile.ZipFile(io.BytesIO(whole)).infolist()
    for entry in entries:
        # In the middle of its data: the time in its header, say, is of no account.
        place = entry.header_offset + 30 + len(entry.filename) + entry.compress_size // 2
        damaged = bytearray(whole)
        damaged[place : place + 8] = b"\xff" * 8
        file = tmp_path / "structure.npz"
        file.write_bytes(damaged)
        with pytest.raises(RunError, match=r"structure\.npz"):
            read_structure(file)


def test_documentation__names_every_array_once():
    cells = [line.split(" | ")[0] for line in documentation().splitlines() if "`" in line]
    assert cells == [f"| `{array.name}`" for array in ARRAYS]
    assert len({array.name for array in ARRAYS}) == len(ARRAYS)
