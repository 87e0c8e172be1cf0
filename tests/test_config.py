"""The configuration tree: profiles, the original node's file, overrides, refusals."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from pydantic import BaseModel, ValidationError
from ruamel.yaml import YAML

from beamseg_batch.config import (
    ALIASES,
    DEFAULT_PROFILE,
    RunConfig,
    config_folder,
    config_yaml,
    load_config,
    profile_names,
    sensor_names,
)
from beamseg_batch.errors import ConfigError

ORIGINAL = Path(__file__).parent / "data" / "original_config.yaml"
"""The original node's configuration file, as its users have it."""

PROFILES = ("precise", "report")


def written(tmp_path, text):
    path = tmp_path / "config.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def leaves(node, prefix=""):
    for name, value in node:
        if isinstance(value, BaseModel):
            yield from leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}"


# --- profiles -------------------------------------------------------------------------


def test_profile_names__are_sorted_and_hold_the_default():
    assert profile_names() == PROFILES
    assert DEFAULT_PROFILE == "precise"
    assert load_config() == load_config("precise")


@pytest.mark.parametrize("name", PROFILES)
def test_load_config__profile_is_complete_and_named(name):
    assert load_config(name).profile == name


def test_load_config__report_has_the_reports_parameters():
    config = load_config("report")
    assert config.matching.method == "nearest"
    assert config.sensor.extrinsic is None
    assert not config.sensor.extrinsic_from_tf
    assert config.filtering.window.x == (0.0, 1.5)
    assert config.filtering.window.y == config.filtering.window.z == (-1.5, 1.5)
    assert config.filtering.radii == (0.05,)
    assert config.detection.hough.granularity == 4
    assert config.detection.screening.gap == "longest_run"
    assert config.filtering.floor_trim == "points"
    assert (config.structure.similarity, config.structure.fusion) == ("projection", "weighted")


def test_load_config__precise_differs_where_it_says():
    def flat(node, prefix=""):
        return {
            key: value
            for name, value in node.items()
            for key, value in (
                flat(value, f"{prefix}{name}.")
                if isinstance(value, dict)
                else {prefix + name: value}
            ).items()
        }

    report, precise = (flat(load_config(name).model_dump()) for name in ("report", "precise"))
    assert report.keys() == precise.keys()
    different = {key for key in report if report[key] != precise[key]}
    assert different >= {"profile", "matching.method", "sensor.extrinsic_from_tf"}


@pytest.mark.parametrize("name", PROFILES)
def test_config_folder__files_hold_only_known_keys(name):
    tree = YAML(typ="safe", pure=True).load((config_folder() / f"{name}.yaml").read_text("utf-8"))
    RunConfig.model_validate(tree)
    assert tree["profile"] == name
    assert not set(tree) & set(ALIASES)


def test_run_config__is_frozen():
    config = load_config()
    with pytest.raises(ValidationError, match="frozen"):
        config.detection.hough.granularity = 5


def test_leaf_size__by_hand():
    filtering = load_config("report").filtering
    assert filtering.leaf_size(0.05) == pytest.approx(1 / 30)
    assert filtering.diag_voxel(0.05) == pytest.approx(0.0577350269)


# --- the original node's file ---------------------------------------------------------


def test_load_config__original_file_overlays_report():
    config = load_config(file=ORIGINAL)
    assert config.profile == "report"
    assert config.outputs.verbosity == 0
    assert config.outputs.path == "output_data"
    assert config.filtering.floor_trim_height == 0.3
    assert config.detection.screening.min_pca_coeff == 0.995
    assert config.structure.min_weight == 0.01
    assert config.filtering.rad_2_leaf_ratio == 1.5
    assert config.detection.hough.minvotes == 12
    assert config.detection.hough.nlines == 10
    assert config.filtering.radii == (0.05,)
    assert config.matching.method == "nearest"


def test_load_config__granularity_of_the_original_file_is_used():
    """Fault of the original: this value never reached its accumulator."""
    assert load_config(file=ORIGINAL).detection.hough.granularity == 6


def test_load_config__original_file_over_a_named_profile():
    config = load_config("precise", ORIGINAL)
    assert config.profile == "precise"
    assert config.matching.method == "interpolate"
    assert config.detection.hough.granularity == 6


@pytest.mark.parametrize(
    ("text", "path", "expected"),
    [
        ("radius_size: 0.07", "filtering.radii", (0.07,)),
        ("radius_sizes: [0.1, 0.05]", "filtering.radii", (0.1, 0.05)),
        ("min_pca_coef: 0.5", "detection.screening.min_pca_coeff", 0.5),
        ("opt_dx: 0.04", "detection.hough.dx", 0.04),
        ("opt_dx: 0", "detection.hough.dx", None),
        ("opt_dx: 0.0", "detection.hough.dx", None),
        ("vebose_level: 2", "outputs.verbosity", 2),
        ("granularity: 5", "detection.hough.granularity", 5),
    ],
)
def test_load_config__aliases(tmp_path, text, path, expected):
    value = load_config(file=written(tmp_path, text))
    for part in path.split("."):
        value = getattr(value, part)
    assert value == expected


def test_aliases__lead_to_values_of_the_tree():
    known = set(leaves(RunConfig()))
    assert set(ALIASES.values()) <= known


def test_load_config__aliases_beside_the_tree(tmp_path):
    text = "profile: report\ngranularity: 5\ndetection: {hough: {minvotes: 20}}\n"
    config = load_config(file=written(tmp_path, text))
    assert (config.detection.hough.granularity, config.detection.hough.minvotes) == (5, 20)


# --- files ----------------------------------------------------------------------------


def test_load_config__file_names_its_profile(tmp_path):
    path = written(tmp_path, "profile: report\n")
    assert load_config(file=path) == load_config("report")
    assert load_config("precise", path).profile == "precise"
    assert load_config(file=written(tmp_path, "matching: {max_gap_s: 0.2}")).profile == "precise"


@pytest.mark.parametrize("text", ["", "# nothing but a comment\n"])
def test_load_config__empty_file_changes_nothing(tmp_path, text):
    assert load_config(file=written(tmp_path, text)) == load_config()


@pytest.mark.parametrize("name", PROFILES)
def test_config_yaml__round_trip(tmp_path, name):
    config = load_config(
        name,
        overrides=[
            "filtering.radii=[0.1, 0.05, 0.03]",
            "sensor.extrinsic={translation: [0.071, 0.011, 0.04], rotation_rpy_deg: [0, -1.5, 90]}",
            "detection.hough.dx=0.0123456789012345678",
            "recording.cloud_topic='/null'",
            "outputs.path='yes'",
        ],
    )
    assert load_config(file=written(tmp_path, config_yaml(config))) == config
    assert config_yaml(load_config(file=written(tmp_path, config_yaml(config)))) == config_yaml(
        config
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [1, 2", "not valid YAML"),
        ("- 1\n- 2\n", "must be a mapping"),
        ("just words", "must be a mapping"),
        ("1: 2", "must be a mapping"),
        ("profile: reprot", "unknown profile 'reprot'; did you mean 'report'"),
        ("profile: 5", "profile must be a name, not 5"),
        ("profile: [a]", "profile must be a name"),
        ("filtering: 5", "filtering"),
    ],
)
def test_load_config__raise_on_a_file_that_is_none(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message):
        load_config(file=written(tmp_path, text))


def test_load_config__raise_on_a_missing_file(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.yaml: cannot be read"):
        load_config(file=tmp_path / "none.yaml")


def test_load_config__raise_on_bytes(tmp_path):
    path = tmp_path / "flight.mcap"
    path.write_bytes(b"\x89MCAP0\r\n\xff\xfe")
    with pytest.raises(ConfigError, match="not valid YAML"):
        load_config(file=path)


# --- single values --------------------------------------------------------------------


def test_load_config__overrides_win_in_their_order(tmp_path):
    path = written(tmp_path, "detection: {hough: {granularity: 2, minvotes: 9}}")
    config = load_config(
        "report", path, ["detection.hough.granularity=3", "detection.hough.granularity=5"]
    )
    assert (config.detection.hough.granularity, config.detection.hough.minvotes) == (5, 9)


@pytest.mark.parametrize(
    ("override", "path", "expected"),
    [
        ("detection.hough.granularity=5", "detection.hough.granularity", 5),
        (" detection.hough.dx = 0.05", "detection.hough.dx", 0.05),
        ("detection.hough.dx=null", "detection.hough.dx", None),
        ("granularity=3", "detection.hough.granularity", 3),
        ("radius_sizes=0.1", "filtering.radii", (0.1,)),
        ("filtering.window.x=[0.1, 3]", "filtering.window.x", (0.1, 3.0)),
        ("filtering.window={x: [0.1, 3]}", "filtering.window.y", (-1.5, 1.5)),
        ("outputs.report=false", "outputs.report", False),
        ("outputs.path=a=b", "outputs.path", "a=b"),
        ("structure.fusion=mean", "structure.fusion", "mean"),
    ],
)
def test_load_config__override(override, path, expected):
    value = load_config("report", overrides=[override])
    for part in path.split("."):
        value = getattr(value, part)
    assert value == expected


@pytest.mark.parametrize("text", ["detection.hough.granularity", "=5", ""])
def test_load_config__raise_on_an_override_that_is_none(text):
    with pytest.raises(ConfigError, match=r"write KEY=VALUE"):
        load_config(overrides=[text])


def test_load_config__raise_on_an_override_that_is_no_yaml():
    with pytest.raises(ConfigError, match="not valid YAML"):
        load_config(overrides=["filtering.radii=[0.1"])


def test_load_config__profile_is_not_silently_kept_when_overridden():
    """Either the profile is taken or the setting is refused; it is not passed over."""
    try:
        config = load_config(overrides=["profile=report"])
    except ConfigError:
        return
    assert config == load_config("report")


# --- refusals -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "nearest"),
    [
        ("detection.hough.granularty", "detection.hough.granularity"),
        ("detection.hough.min_votes", "detection.hough.minvotes"),
        ("detection.granularity", "detection.hough.granularity"),
        ("filtering.radius", "filtering.radii"),
        ("structure.min_wait", "structure.min_weight"),
        ("rad_2_leaf_ration", "rad_2_leaf_ratio"),
        ("matching.max_gap", "matching.max_gap_s"),
    ],
)
def test_load_config__unknown_key_with_the_nearest_name(key, nearest):
    with pytest.raises(ConfigError, match=rf"unknown key '{key}'; did you mean '{nearest}'"):
        load_config(overrides=[f"{key}=1"])


def test_load_config__unknown_key_like_no_other():
    with pytest.raises(ConfigError, match=r"unknown key 'xyzzy'$"):
        load_config(overrides=["xyzzy=1"])


def test_load_config__unknown_key_names_the_file(tmp_path):
    path = written(tmp_path, "filtering: {radi: [0.1]}")
    with pytest.raises(ConfigError, match=rf"{path.name}: unknown key 'filtering\.radi'"):
        load_config(file=path)


def test_load_config__all_problems_at_once():
    with pytest.raises(ConfigError) as caught:
        load_config(overrides=["detection.hough.granularity=9", "filtering.radii=[0]", "bogus=1"])
    for part in ("granularity", "radii", "bogus"):
        assert part in str(caught.value)


@pytest.mark.parametrize(
    "override",
    [
        "detection.hough.granularity=9",
        "detection.hough.granularity=-1",
        "detection.hough.granularity=4.5",
        "detection.hough.granularity=null",
        "detection.hough.minvotes=1",
        "detection.hough.nlines=-1",
        "detection.hough.dx=0",
        "filtering.radii=[]",
        "filtering.radii=[0.05, 0]",
        "filtering.radii=[-0.05]",
        "filtering.radii=[.nan]",
        "filtering.radii=[.inf]",
        "filtering.rad_2_leaf_ratio=0",
        "filtering.window.x=[1, 0]",
        "filtering.window.x=[1, 1]",
        "filtering.window.x=[0, .inf]",
        "filtering.window.x=[0]",
        "filtering.floor_trim=walls",
        "detection.screening.min_pca_coeff=1.1",
        "detection.screening.min_pca_coeff=.nan",
        "detection.screening.gap=ignore",
        "structure.min_weight=-0.1",
        "structure.similarity=4",
        "structure.min_scans=0",
        "matching.max_gap_s=-1",
        "matching.method=linear",
        "sensor.extrinsic={translation: [1, 2]}",
        "outputs.verbosity=3",
        "outputs.cloud_points=-1",
        "detection=5",
        "detection.hough.granularity.x=5",
    ],
)
def test_load_config__raise_out_of_range(override):
    key = override.partition("=")[0]
    with pytest.raises(ConfigError, match=key.split(".")[0]) as caught:
        load_config(overrides=[override])
    assert caught.value.exit_code == 2
    assert "\n" not in str(caught.value)


def test_load_config__message_says_value_and_limit():
    with pytest.raises(ConfigError, match=r"detection\.hough\.granularity is 9: .*6"):
        load_config(overrides=["detection.hough.granularity=9"])


# --- the sensor's model ---------------------------------------------------------------


def test_load_config__takes_what_is_open_from_the_sensor_model():
    sensor = load_config(overrides=["sensor.model=voxl_tof"]).sensor
    assert (sensor.noise_m, sensor.noise_relative, sensor.mixed_pixels) == (0.003, 0.007, True)
    assert (sensor.pose_jitter_m, sensor.pose_jitter_deg) == (0.003, 0.15)
    assert sensor.extrinsic is None  # its file says that the recording holds it


def test_load_config__what_is_set_comes_before_the_sensor_model():
    overrides = ["sensor.model=voxl_tof", "sensor.noise_m=0.02", "sensor.mixed_pixels=false"]
    sensor = load_config(overrides=overrides).sensor
    assert (sensor.noise_m, sensor.mixed_pixels, sensor.noise_relative) == (0.02, False, 0.007)


def test_load_config__sensor_model_of_ones_own(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(
        "camera: {noise: 0.0, footprint: 1}\nextrinsic: {translation: [0.1, 0.0, 0.2]}\n"
    )
    sensor = load_config(overrides=[f"sensor.model={path}"]).sensor
    assert sensor.noise_m is None  # to be measured
    assert sensor.mixed_pixels is False
    assert sensor.extrinsic is not None
    assert sensor.extrinsic.translation == (0.1, 0.0, 0.2)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("camera: {noise: loud}", "mine.yaml: camera.noise is 'loud': "),
        ("poses: {jitter_position: -1}", "mine.yaml: poses.jitter_position is -1: "),
        ("camera: {footprint: wide}", "mine.yaml: camera.footprint is 'wide': "),
        ("extrinsic: {translation: [1]}", "mine.yaml: extrinsic"),
        ("camera: 5", "mine.yaml: tells nothing of a sensor; keys are camera.noise, "),
        ("", "mine.yaml: tells nothing of a sensor"),
        ("[1, 2]", "mine.yaml: must be a mapping"),
        ("a: [", "mine.yaml: is not valid YAML"),
    ],
)
def test_load_config__refuses_a_bad_sensor_model(tmp_path, content, message):
    path = tmp_path / "mine.yaml"
    path.write_text(content)
    with pytest.raises(ConfigError, match=re.escape(message)):
        load_config(overrides=[f"sensor.model={path}"])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("voxl_toff", "unknown sensor 'voxl_toff'; did you mean 'voxl_tof'?; there are: voxl_tof"),
        ("missing.yaml", "missing.yaml: cannot be read: No such file"),
        ("5", "sensor.model is 5: "),
    ],
)
def test_load_config__refuses_an_unknown_sensor_model(name, message):
    with pytest.raises(ConfigError, match=re.escape(message)):
        load_config(overrides=[f"sensor.model={name}"])


def test_load_config__every_shipped_sensor_can_be_a_model():
    for name in sensor_names():
        assert load_config(overrides=[f"sensor.model={name}"]).sensor.noise_m is not None


@pytest.mark.parametrize("setting", ["matching.smooth=on", "sensor.pose_jitter_m=-0.1"])
def test_load_config__refuses_bad_jitter(setting):
    with pytest.raises(ConfigError, match=re.escape(setting.partition("=")[0])):
        load_config(overrides=[setting])


def test_load_config__report_uses_poses_as_they_are():
    assert load_config("report").matching.smooth == "off"
    assert load_config("precise").matching.smooth == "auto"


@pytest.mark.parametrize("value", ["auto", "null", "~"])
def test_load_config__radii_to_be_measured(value):
    config = load_config(overrides=[f"filtering.radii={value}"])
    assert config.filtering.radii == ()
    assert config.model_dump(mode="json")["filtering"]["radii"] == "auto"
    assert "radii: auto" in config_yaml(config)
    assert RunConfig.model_validate(config.model_dump()) == config


@pytest.mark.parametrize("value", ["[]", "some", "[0.05, auto]", "[0.0]", "{}"])
def test_load_config__radii_that_are_none(value):
    with pytest.raises(ConfigError, match=r"filtering\.radii"):
        load_config(overrides=[f"filtering.radii={value}"])
