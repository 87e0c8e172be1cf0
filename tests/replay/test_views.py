"""The views that are shipped show what a replay holds."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from beamseg_batch.replay import recording

VIEWS = Path(__file__).parents[2] / "configs" / "views"
CLOUDS = {recording.FILTERED, recording.HOUGH}
RECORDED = {"/tof_pc"}


@pytest.mark.parametrize("name", ["beamseg.rviz", "beamseg.rviz2.rviz"])
def test_rviz__shows_the_topics_of_a_replay(name):
    view = YAML(typ="safe").load((VIEWS / name).read_text(encoding="utf-8"))
    manager = view["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "mocap"
    topics = [d.get("Marker Topic", d.get("Topic")) for d in manager["Displays"]]
    named = {topic["Value"] if isinstance(topic, dict) else topic for topic in topics if topic}
    assert named == {recording.MARKERS, *CLOUDS, *RECORDED}
    package = "rviz_default_plugins" if "rviz2" in name else "rviz"
    assert {d["Class"].partition("/")[0] for d in manager["Displays"]} == {package}


def test_foxglove__shows_the_topics_of_a_replay():
    layout = json.loads((VIEWS / "foxglove.json").read_text(encoding="utf-8"))
    panel = layout["configById"][layout["layout"]]
    assert panel["followTf"] == "mocap"
    assert set(panel["topics"]) == {recording.SCENE, recording.MARKERS, *CLOUDS, *RECORDED}
    assert panel["topics"][recording.SCENE]["visible"]
