"""Ranges of time, every n-th cloud, and no more than so many."""

from __future__ import annotations

import pytest

from beamseg_batch.errors import NoScansError
from beamseg_batch.model import SkippedScan
from beamseg_batch.recording.codec import UndecodableMessageError
from tests.recording.conftest import configured, some_clouds, some_poses


@pytest.mark.parametrize(
    ("chosen", "indexes"),
    [
        ({}, range(10)),
        ({"start_s": 0.3}, range(3, 10)),
        ({"duration_s": 0.3}, range(3)),
        ({"start_s": 0.25, "duration_s": 0.5}, range(3, 8)),
        ({"every": 4}, (0, 4, 8)),
        ({"max_scans": 3}, range(3)),
        ({"max_scans": 30}, range(10)),
        ({"start_s": 0.1, "every": 3, "max_scans": 2}, (1, 4)),
    ],
)
@pytest.mark.parametrize("kind", ["bag", "mcap", "db3"])
def test_scans__of_the_selection(fly, kind, chosen, indexes):
    flight = fly(
        configured(recording=chosen), kind=kind, clouds=some_clouds(10), poses=some_poses(100)
    )
    assert [scan.index for scan in flight.scans()] == list(indexes)
    assert flight.n_clouds == len(indexes)
    assert len(flight.trajectory) == 100


def test_scans__left_out_clouds_are_not_decoded(fly, monkeypatch):
    flight = fly(configured(recording={"start_s": 0.3}), clouds=some_clouds(4))
    first_ns = flight.recording.start_ns
    read = type(flight.recording).read

    def refuse_early(self, raw, extract):
        if raw.log_time_ns < first_ns + 300_000_000:
            raise UndecodableMessageError("too early")
        return read(self, raw, extract)

    monkeypatch.setattr(type(flight.recording), "read", refuse_early)
    assert not any(isinstance(scan, SkippedScan) for scan in flight.scans())


def test_open_flight__raise_when_no_cloud_is_left(fly):
    with pytest.raises(NoScansError, match=r"none of 4 clouds lies in .* 5 s to 6 s of 0\.390 s"):
        fly(configured(recording={"start_s": 5.0, "duration_s": 1.0}))


def test_thinned__multiplies(fly):
    flight = fly(configured(recording={"every": 2}), clouds=some_clouds(13)).thinned(3)
    assert [scan.index for scan in flight.scans()] == [0, 6, 12]
