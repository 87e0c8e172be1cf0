"""Configurations out of YAML: profile, file and single values, laid over one another.

A profile (`configs/NAME.yaml`) is the base; a user's file overlays the profile it names, the
command line overlays both.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from beamseg_batch.config.tree import DEFAULT_PROFILE, RunConfig, SensorConfig
from beamseg_batch.errors import ConfigError
from beamseg_batch.schema import (
    YamlError,
    message_of,
    nearest,
    parse_setting,
    problems,
    read_yaml,
    shortened,
)

__all__ = [
    "ALIASES",
    "config_folder",
    "config_yaml",
    "load_config",
    "profile_names",
    "sensor_names",
]

ALIASES: Mapping[str, str] = {
    "radius_sizes": "filtering.radii",
    "radius_size": "filtering.radii",
    "floor_trim_height": "filtering.floor_trim_height",
    "rad_2_leaf_ratio": "filtering.rad_2_leaf_ratio",
    "min_pca_coeff": "detection.screening.min_pca_coeff",
    "min_pca_coef": "detection.screening.min_pca_coeff",
    "opt_minvotes": "detection.hough.minvotes",
    "opt_nlines": "detection.hough.nlines",
    "opt_dx": "detection.hough.dx",
    "granularity": "detection.hough.granularity",
    "min_weight": "structure.min_weight",
    "path_to_output": "outputs.path",
    "verbose_level": "outputs.verbosity",
    "vebose_level": "outputs.verbosity",
}
"""Keys of the original node's configuration file, and where they live here."""


_OF_MODEL: Mapping[str, str] = {
    "noise_m": "camera.noise",
    "noise_relative": "camera.noise_relative",
    "mixed_pixels": "camera.footprint",
    "pose_jitter_m": "poses.jitter_position",
    "pose_jitter_deg": "poses.jitter_attitude_deg",
    "extrinsic": "extrinsic",
}
"""Keys of the `sensor` branch that a sensor's file tells, and their places there."""


def config_folder() -> Path:
    """Folder of the shipped configuration files.

    Returns
    -------
    Path
        Inside the installed package; in an editable install, ``configs/`` of the checkout.
    """
    package = Path(__file__).parents[1]
    installed = package / "configs"
    return installed if installed.is_dir() else package.parents[1] / "configs"


def profile_names() -> tuple[str, ...]:
    """Names of the shipped profiles, sorted."""
    return tuple(sorted(path.stem for path in config_folder().glob("*.yaml")))


def sensor_names() -> tuple[str, ...]:
    """Names of the shipped sensors, sorted."""
    return tuple(sorted(path.stem for path in (config_folder() / "sensors").glob("*.yaml")))


def load_config(
    profile: str | None = None,
    file: Path | None = None,
    overrides: Sequence[str] = (),
) -> RunConfig:
    """Load a configuration: profile, then file, then single values.

    Parameters
    ----------
    profile : str, optional
        Name of a shipped profile. Without it the file's own, or ``report`` when the
        file is one of the original node, or ``precise``.
    file : Path, optional
        YAML file that overlays the profile.
    overrides : sequence of str
        ``key.path=value`` settings, the value in YAML.

    Returns
    -------
    RunConfig

    Raises
    ------
    ConfigError
        If a file is missing or not YAML, a profile or key unknown, or a value out of range.
    """
    overlay = _read_mapping(file) if file else {}
    where = str(file) if file else "configuration"
    original = _is_original(overlay)
    overlay = _resolve_aliases(overlay, where)
    for override in overrides:
        overlay = _merged(overlay, _parse_override(override))
    named = overlay.get("profile")
    if named is not None and not isinstance(named, str):
        raise ConfigError(f"{where}: profile must be a name, not {named!r}")
    name = profile or named or ("report" if original else DEFAULT_PROFILE)
    tree = _merged(_read_profile(name), overlay)
    tree["profile"] = name
    tree = _with_sensor_model(tree)
    return _validated(tree, where)


def config_yaml(config: RunConfig) -> str:
    """Write a configuration as YAML that `load_config` reads back to the same tree."""
    from ruamel.yaml import YAML

    buffer = io.StringIO()
    writer = YAML(typ="safe", pure=True)
    writer.default_flow_style = None
    writer.width = 100
    writer.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    writer.dump(config.model_dump(mode="json"), buffer)
    return buffer.getvalue()


def _read_profile(name: str) -> dict[str, Any]:
    if name not in profile_names():
        raise ConfigError(
            f"unknown profile {name!r}{nearest(name, profile_names())}; "
            f"there are: {', '.join(profile_names())}"
        )
    return _read_mapping(config_folder() / f"{name}.yaml")


def _read_mapping(path: Path) -> dict[str, Any]:
    try:
        content, _ = read_yaml(path)
    except YamlError as error:
        raise ConfigError(f"{path}: {error}") from error
    if content is None:
        return {}
    if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
        raise ConfigError(f"{path}: must be a mapping of keys to values")
    return content


def _with_sensor_model(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Fill in what the sensor's model tells and the configuration leaves open."""
    sensor = tree.get("sensor")
    if not isinstance(sensor, Mapping) or not isinstance(sensor.get("model"), str):
        return dict(tree)
    told = _told_by_model(sensor["model"])
    return _merged(tree, {"sensor": {k: v for k, v in told.items() if sensor.get(k) is None}})


def _told_by_model(name: str) -> dict[str, Any]:
    """Values of the `sensor` branch that a file of a sensor tells."""
    path = _sensor_path(name)
    content = _read_mapping(path)
    found: dict[str, Any] = {}
    for key, where in _OF_MODEL.items():
        branch: Any = content
        for part in where.split("."):
            branch = branch.get(part) if isinstance(branch, Mapping) else None
        if branch is None or (key == "extrinsic" and content.get("extrinsic_in", "none") != "none"):
            continue
        # A footprint of one sub-ray is a point, and noise of zero is not known.
        value = branch > 1 if key == "mixed_pixels" and isinstance(branch, int) else branch
        found[key] = None if key == "noise_m" and value == 0 else value
        try:
            SensorConfig.model_validate({key: found[key]})
        except ValidationError as error:
            reason = message_of(problems(error)[0])
            raise ConfigError(f"{path}: {where} is {shortened(branch)}: {reason}") from None
    if not found:
        raise ConfigError(
            f"{path}: tells nothing of a sensor; keys are {', '.join(_OF_MODEL.values())}"
        )
    return found


def _sensor_path(name: str) -> Path:
    if name in sensor_names():
        return config_folder() / "sensors" / f"{name}.yaml"
    if Path(name).suffix:
        return Path(name)
    raise ConfigError(
        f"sensor.model: unknown sensor {name!r}{nearest(name, sensor_names())}; there are: "
        f"{', '.join(sensor_names())}; a sensor of your own is a YAML file"
    )


def _is_original(tree: Mapping[str, Any]) -> bool:
    """Whether every key is one of the original node's flat keys."""
    return bool(tree) and all(key in ALIASES for key in tree)


def _resolve_aliases(tree: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Move the original node's flat keys to their places in the tree."""
    resolved: dict[str, Any] = {key: value for key, value in tree.items() if key not in ALIASES}
    given: dict[str, str] = {}
    for key in tree:
        if (path := ALIASES.get(key)) is not None and given.setdefault(path, key) != key:
            raise ConfigError(f"{where}: {given[path]!r} and {key!r} both set {path}; keep one")
    for key in tree:
        if key in ALIASES:
            resolved = _merged(resolved, _nested(ALIASES[key], _translated(key, tree[key])))
    return resolved


def _translated(alias: str, value: Any) -> Any:
    """Say a value of the original node as this tree says it."""
    if ALIASES[alias] == "filtering.radii" and not isinstance(value, list):
        return [value]
    if ALIASES[alias] == "detection.hough.dx" and value == 0:
        return None
    return value


def _nested(path: str, value: Any) -> dict[str, Any]:
    tree: Any = value
    for key in reversed(path.split(".")):
        tree = {key: tree}
    assert isinstance(tree, dict)
    return tree


def _parse_override(text: str) -> dict[str, Any]:
    key, value = parse_setting(text, "detection.hough.granularity=5")
    return _resolve_aliases({key: value}, key) if key in ALIASES else _nested(key, value)


def _merged(base: Mapping[str, Any], overlay: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in overlay.items():
        if isinstance(value, Mapping) and isinstance(merged.get(key), Mapping):
            merged[key] = _merged(merged[key], value)
        else:
            merged[key] = value
    return merged


def _validated(tree: Mapping[str, Any], where: str) -> RunConfig:
    try:
        return RunConfig.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(f"{where}: " + "; ".join(map(_explain, problems(error)))) from None


def _explain(problem: Mapping[str, Any]) -> str:
    """Say one pydantic problem in a sentence, with the way out."""
    path = ".".join(str(part) for part in problem["loc"])
    if problem["type"] == "extra_forbidden":
        return f"unknown key {path!r}{nearest(path, [*ALIASES, *_key_paths(RunConfig)])}"
    value = problem.get("input")
    shown = "" if isinstance(value, Mapping) else f" is {shortened(value)}"
    return f"{path}{shown}: {message_of(problem)}"


def _key_paths(node: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Paths of all values of the tree, branches left out."""
    for name, entry in node.model_fields.items():
        candidates = (entry.annotation, *getattr(entry.annotation, "__args__", ()))
        branches = [c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel)]
        for branch in branches:
            yield from _key_paths(branch, f"{prefix}{name}.")
        if not branches:
            yield prefix + name
