"""The page on simulation names what there is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from beamseg_batch.simulation.recorder import FORMATS
from beamseg_batch.simulation.sensor import Camera, PoseSource, Sensor, sensor_names
from beamseg_batch.simulation.trajectory import (
    FigureEight,
    Lawnmower,
    Orbit,
    Spiral,
    Waypoints,
    Wobble,
)

PAGE = (Path(__file__).parents[2] / "docs" / "simulation.md").read_text(encoding="utf-8")
PROSE = re.sub(r"```.*?```", "", PAGE, flags=re.DOTALL)


def words(text):
    """Words that a text sets as code."""
    return set(re.findall(r"[\w-]+", " ".join(re.findall(r"`([^`]+)`", text))))


@pytest.mark.parametrize("model", [Camera, PoseSource, Sensor, Wobble], ids=lambda m: m.__name__)
def test_page__names_every_key(model):
    assert set(model.model_fields) <= words(PROSE)


@pytest.mark.parametrize(
    "model", [Waypoints, Orbit, Spiral, Lawnmower, FigureEight], ids=lambda m: m.__name__
)
def test_page__names_every_key_of_a_flight(model):
    kind = model.model_fields["kind"].default
    (row,) = [line for line in PAGE.splitlines() if line.startswith(f"| `{kind}` |")]
    assert set(model.model_fields) - {"kind", "wobble"} <= words(row)


def test_page__names_sensors_and_formats():
    assert set(sensor_names()) <= words(PROSE)
    named = {"bag", "mcap", "db3", "ros2"} | words(PROSE)
    assert set(FORMATS) <= named


def test_page__example_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    code = code.replace("limit_s=20.0", "limit_s=0.4")
    exec(compile(code, "simulation.md", "exec"), {})
    assert "members seen; Clearance(distance_m=" in capsys.readouterr().out
    assert (tmp_path / "sim" / "flight.bag").is_file()
