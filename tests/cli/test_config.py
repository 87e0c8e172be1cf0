"""`beamseg config`: show, check, schema."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from beamseg_batch.config import RunConfig, load_config, profile_names


def read_yaml(text: str) -> dict:
    tree: dict = YAML(typ="safe", pure=True).load(text)
    return tree


@pytest.mark.parametrize("profile", profile_names())
def test_show__is_the_configuration_of_a_run(ok, profile):
    result = ok("config", "show", "--profile", profile)
    assert RunConfig.model_validate(read_yaml(result.stdout)) == load_config(profile)
    assert result.stderr == ""


def test_show__default_profile(ok):
    assert read_yaml(ok("config", "show").stdout)["profile"] == "precise"


def test_show__json(ok):
    tree = json.loads(ok("config", "show", "--json", "--profile", "report").stdout)
    assert RunConfig.model_validate(tree) == load_config("report")


def test_show__file_settings_and_options(ok, here):
    (here / "c.yaml").write_text(
        "profile: report\nfiltering: {radii: [0.1, 0.05]}\n", encoding="utf-8"
    )
    text = ok(
        *("config", "show", "-c", "c.yaml", "--set", "detection.hough.granularity=5"),
        *("--set", "filtering.floor_trim=segment", "--cloud-topic", "/a: [b", "--pose-topic", "/p"),
        *("--extrinsic", "0.071,0.011,0.04,1,2,3"),
    ).stdout
    tree = read_yaml(text)
    assert tree["profile"] == "report"
    assert tree["filtering"]["radii"] == [0.1, 0.05]
    assert tree["filtering"]["floor_trim"] == "segment"
    assert tree["detection"]["hough"]["granularity"] == 5
    assert tree["recording"]["cloud_topic"] == "/a: [b"
    assert tree["recording"]["pose_topic"] == "/p"
    assert tree["sensor"]["extrinsic"] == {
        "translation": [0.071, 0.011, 0.04],
        "rotation_rpy_deg": [1.0, 2.0, 3.0],
    }


def test_show__can_be_checked(ok, here):
    (here / "c.yaml").write_text(ok("config", "show").stdout, encoding="utf-8")
    assert ok("config", "check", "c.yaml").stdout == "c.yaml: valid, overlays profile 'precise'\n"


@pytest.mark.parametrize(
    ("content", "profile"),
    [("", "precise"), ("profile: report", "report"), ("radius_sizes: [0.1]", "report")],
)
def test_check__valid(ok, here, content, profile):
    (here / "c.yaml").write_text(content, encoding="utf-8")
    result = ok("config", "check", "c.yaml")
    assert result.stdout == f"c.yaml: valid, overlays profile {profile!r}\n"
    assert result.stderr == ""


def test_check__configuration_of_the_original_node(ok):
    original = Path(__file__).parents[1] / "data" / "original_config.yaml"
    assert "overlays profile 'report'" in ok("config", "check", original).stdout


def test_schema__describes_every_key(ok):
    schema = json.loads(ok("config", "schema").stdout)
    hough = schema["$defs"]["HoughConfig"]["properties"]
    assert (hough["granularity"]["minimum"], hough["granularity"]["maximum"]) == (0, 6)
    for definition in [schema, *schema["$defs"].values()]:
        for name, entry in definition["properties"].items():
            assert "description" in entry or "$ref" in entry, name
