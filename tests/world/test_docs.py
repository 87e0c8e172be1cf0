"""The page on worlds says what worlds are."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from beamseg_batch.world import load_scene_file, models, world_names
from tests.world.worlds import refusal_of, scene_of

PAGE = (Path(__file__).parents[2] / "docs" / "worlds.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)


def models_below(model):
    """A model and all that stand in its fields."""
    yield model
    for entry in model.model_fields.values():
        for child in re.findall(r"\b\w+Config\b", str(entry.annotation)):
            yield from models_below(getattr(models, child))


@pytest.mark.parametrize("model", set(models_below(models.WorldConfig)), ids=lambda m: m.__name__)
def test_page__names_every_key(model):
    """As code of its own, or within braces."""
    written = set(re.findall(r"\w+", " ".join(re.findall(r"`([^`\n]+)`", PAGE))))
    assert set(model.model_fields) <= written


def test_page__counts_the_members_of_the_shipped_worlds():
    rows = dict(re.findall(r"^\| `(\w+)` \| (\d+) \|", PAGE, re.MULTILINE))
    assert rows == {name: str(len(load_scene_file(name).scene.members)) for name in world_names()}


@pytest.mark.parametrize("example", EXAMPLES)
def test_page__examples_can_be_read(tmp_path, example):
    assert scene_of(tmp_path, example).members


def test_page__shows_what_is_said_of_a_mistake(tmp_path):
    text = EXAMPLES[0].replace("shape: square", "shape: hexagon").replace("size:", "sice:")
    said = [line for line in refusal_of(tmp_path, text).splitlines() if "missing" not in line]
    assert said
    assert "\n".join(said) in PAGE
