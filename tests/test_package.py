"""What the installed package promises as a whole: version, data files, quick imports."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

import beamseg_batch
from beamseg_batch.config import config_folder, load_config, profile_names

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
HEAVY = {"apsw", "mcap", "numba", "open3d", "pandas", "plotly", "pyarrow", "rosbags", "scipy"}


def modules_after(statement: str) -> set[str]:
    """Top-level modules that a fresh interpreter holds after a statement."""
    program = f"{statement}\nimport json, sys\nprint(json.dumps(list(sys.modules)))"
    printed = subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True
    ).stdout
    return {name.partition(".")[0] for name in json.loads(printed)}


def imported_libraries() -> set[str]:
    """Top-level modules that the package's source imports anywhere."""
    found = set()
    for path in Path(beamseg_batch.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                found.add(node.module.partition(".")[0])
    return found - set(sys.stdlib_module_names) - {"beamseg_batch"}


def normalised(requirement: str) -> str:
    name = re.match(r"[\w.-]+", requirement)
    assert name, requirement
    return re.sub(r"[-_.]+", "-", name[0]).lower()


def test_import__loads_nothing():
    assert not modules_after("import beamseg_batch") & {*HEAVY, "numpy", "pydantic", "click"}


def test_import_of_the_command_line__loads_no_heavy_library():
    assert not modules_after("import beamseg_batch.cli.main") & HEAVY


def test_version__is_that_of_the_project_file():
    assert beamseg_batch.__version__ == PROJECT["version"]


@pytest.mark.parametrize("name", beamseg_batch.__all__)
def test_public_name__can_be_loaded(name):
    assert getattr(beamseg_batch, name) is not None
    assert name in dir(beamseg_batch)


def test_unknown_name__is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'proces_flight'"):
        beamseg_batch.proces_flight  # noqa: B018


def test_config_folder__holds_the_profiles():
    assert {"precise", "report"} <= set(profile_names())
    assert {path.stem for path in config_folder().glob("*.yaml")} == set(profile_names())
    assert load_config("report").profile == "report"


def test_imports__are_declared_dependencies():
    distributions = metadata.packages_distributions()
    requirements = [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["parquet"]]
    declared = {normalised(requirement) for requirement in requirements}
    undeclared = {
        module
        for module in imported_libraries()
        if not {normalised(name) for name in distributions.get(module, [module])} & declared
    }
    assert not undeclared
