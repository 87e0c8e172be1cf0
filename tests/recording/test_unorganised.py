"""Clouds that come without rows and columns get them back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamseg_batch.config import load_config
from beamseg_batch.recording import open_flight, open_recording
from beamseg_batch.recording.suggestion import suggest_config
from tests.recording.test_survey import simulated

SIZE = ["camera.width=40", "camera.height=32"]


def flown(folder, organised, settings=()):
    organised = f"camera.organised={str(organised).lower()}"
    path = simulated(folder / f"{organised}.mcap", 0.0, [*SIZE, organised, *settings], 4.0)
    return open_flight(open_recording(path), load_config())


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    return flown(tmp_path_factory.mktemp("images"), organised=True)


@pytest.fixture(scope="module")
def loose(tmp_path_factory):
    return flown(tmp_path_factory.mktemp("loose"), organised=False)


def test_organised__gives_the_images_that_were_seen(images, loose):
    first = next(loose.usable())
    assert first.height == 1
    assert np.isfinite(first.points).all()
    pairs = list(zip(images.usable(), loose.organised().usable(), strict=True))
    assert len(pairs) == 20
    for seen, given in pairs:
        assert (given.width, given.height) == (seen.width, seen.height)
        np.testing.assert_array_equal(
            given.points, np.where(np.isfinite(seen.points), seen.points, np.nan)
        )
        assert not given.points.flags.writeable


def test_organised__says_so(loose):
    assert loose.organised().notes[-1] == (
        "the clouds have no rows and columns: their points are put back into an image of "
        "40 x 32 pixels"
    )


def test_organised__leaves_images_alone(images):
    assert images.organised() is images


def test_organised__puts_points_in_order_that_are_on_no_grid(loose, monkeypatch):
    monkeypatch.setattr("beamseg_batch.recording.flight.find_grid", lambda clouds: None)
    ordered = loose.organised()
    assert "on no grid" in ordered.notes[-1]
    for before, after in zip(loose.usable(), ordered.usable(), strict=True):
        assert after.height == 1
        np.testing.assert_array_equal(after.points, before.points[np.lexsort(before.points.T)])


def test_usable__ends_where_the_recording_does(loose):
    assert len(list(replace(loose).usable())) == loose.n_clouds == 20


def test_suggest_config__of_clouds_without_rows(loose):
    text = suggest_config(loose.recording, loose.config)
    assert "40 x 32 pixels" in text
    assert "mrad apart" in text


def test_suggest_config__of_radii_that_nobody_knows(loose):
    config = load_config(overrides=["filtering.radii=auto"])
    (line,) = (
        line for line in suggest_config(loose.recording, config).splitlines() if "radii:" in line
    )
    assert "auto to measure them" in line
