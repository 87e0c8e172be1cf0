"""Scans that are kept from one reading to the next."""

from __future__ import annotations

import numpy as np
import pytest

from beamseg_batch.model import SkippedScan
from beamseg_batch.recording import kept_scans
from beamseg_batch.recording.kept_scans import KeptScans
from tests.detection.scans import make_scan

SCANS = [make_scan(np.zeros((10, 3), np.float32)), SkippedScan(1, 0, "bad_cloud")] * 2


def not_begun():
    raise AssertionError("read again")
    yield


def test_reading__what_was_read_to_its_end_is_given_again():
    kept = KeptScans()
    assert list(kept.reading(iter(SCANS))) == SCANS
    assert list(kept.reading(not_begun())) == SCANS


def test_reading__that_was_broken_off_is_not_kept():
    kept = KeptScans()
    assert next(kept.reading(iter(SCANS))) is SCANS[0]
    assert list(kept.reading(iter(SCANS[2:]))) == SCANS[2:]


def test_reading__that_failed_is_not_kept():
    def broken():
        yield SCANS[0]
        raise OSError

    kept = KeptScans()
    with pytest.raises(OSError):  # noqa: PT011
        list(kept.reading(broken()))
    assert list(kept.reading(iter(SCANS))) == SCANS


@pytest.mark.parametrize(("room", "again"), [(240, True), (239, False)])
def test_reading__of_too_many_points_is_not_kept(monkeypatch, room, again):
    monkeypatch.setattr(kept_scans, "_MOST_BYTES", room)
    kept = KeptScans()
    assert list(kept.reading(iter(SCANS))) == SCANS
    if again:
        assert list(kept.reading(not_begun())) == SCANS
    else:
        assert list(kept.reading(iter(SCANS[:1]))) == SCANS[:1]
