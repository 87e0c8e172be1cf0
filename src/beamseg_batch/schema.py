"""What people write in YAML: closed models, their number types, problems in plain words."""

from __future__ import annotations

import difflib
import reprlib
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from beamseg_batch.errors import ConfigError

__all__ = [
    "Finite",
    "Interval",
    "Node",
    "NonNegative",
    "Positive",
    "Seconds",
    "Share",
    "Vector3",
    "YamlError",
    "message_of",
    "nearest",
    "parse_setting",
    "problems",
    "read_yaml",
    "shortened",
]

# The limits are far beyond any structure; they keep arithmetic from overflowing.
Positive: TypeAlias = Annotated[float, Field(gt=0, le=1e4, allow_inf_nan=False)]
NonNegative: TypeAlias = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]
Finite: TypeAlias = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
Seconds: TypeAlias = Annotated[float, Field(ge=-4e9, le=4e9, allow_inf_nan=False)]
Share: TypeAlias = Annotated[float, Field(ge=0, le=1)]
Vector3: TypeAlias = tuple[Finite, Finite, Finite]
Interval: TypeAlias = tuple[Finite, Finite]


class Node(BaseModel):
    """A branch of a tree of values: frozen, and closed to keys it does not know."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


class YamlError(ValueError):
    """A file cannot be read as YAML; `line` says where, counted from 1, if that is known."""

    def __init__(self, reason: str, line: int | None = None) -> None:
        super().__init__(reason)
        self.line = line


def read_yaml(path: Path) -> tuple[Any, Any]:
    """Read a YAML file.

    Parameters
    ----------
    path : Path

    Returns
    -------
    content : Any
        Plain Python values; None if the file is empty.
    node : ruamel.yaml.nodes.Node or None
        The same as written, with the place of each part.

    Raises
    ------
    YamlError
        If the file cannot be read, is not UTF-8 or not YAML.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import ReusedAnchorWarning, YAMLError

    yaml = YAML(typ="safe", pure=True)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ReusedAnchorWarning)  # YAML 1.2 allows it
            node = yaml.compose(path.read_text(encoding="utf-8"))
        return (None if node is None else yaml.constructor.construct_document(node)), node
    except OSError as error:
        raise YamlError(f"cannot be read: {error.strerror}") from error
    except (YAMLError, ValueError, TypeError, LookupError, RecursionError) as error:
        line = getattr(getattr(error, "problem_mark", None), "line", None)
        reason = getattr(error, "problem", None) or " ".join(str(error).split())
        raise YamlError(
            f"is not valid YAML: {reason}", None if line is None else line + 1
        ) from error


def parse_setting(text: str, example: str) -> tuple[str, Any]:
    """Read a setting of the command line.

    Parameters
    ----------
    text : str
        ``key.path=value``, the value in YAML.
    example : str
        A setting that would do, for the error.

    Returns
    -------
    key : str
    value : Any
        Plain Python values.

    Raises
    ------
    ConfigError
        If it is no setting, or the value not YAML.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import ReusedAnchorWarning, YAMLError

    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise ConfigError(f"{text!r} is not a setting; write KEY=VALUE, for example {example}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ReusedAnchorWarning)
            return key.strip(), YAML(typ="safe", pure=True).load(value)
    except (YAMLError, ValueError, TypeError, LookupError, RecursionError) as error:
        raise ConfigError(f"{text!r}: the value is not valid YAML") from error


def problems(error: ValidationError) -> list[Mapping[str, Any]]:
    """List each problem once, where it lies: a branch fails because of what is in it."""
    found: list[Any] = list(error.errors())
    return [
        problem
        for problem in found
        if not any(_lies_in(other["loc"], problem["loc"]) for other in found)
    ]


def _lies_in(inner: Sequence[Any], outer: Sequence[Any]) -> bool:
    return len(inner) > len(outer) and tuple(inner[: len(outer)]) == tuple(outer)


def message_of(problem: Mapping[str, Any]) -> str:
    """Pydantic's own words for a problem, as the end of a sentence."""
    message = str(problem["msg"]).removeprefix("Value error, ")
    return message[:1].lower() + message[1:]


def nearest(name: str, known: Iterable[str]) -> str:
    """Suggest the known name that looks most like an unknown one, as the end of a sentence.

    Names may be dotted paths; one that ends alike is suggested too.
    """
    paths = list(known)
    matches = difflib.get_close_matches(name, paths, n=1, cutoff=0.75)
    if not matches:
        by_leaf = {path.rpartition(".")[2]: path for path in paths}
        close = difflib.get_close_matches(name.rpartition(".")[2], by_leaf, n=1, cutoff=0.7)
        matches = [by_leaf[leaf] for leaf in close]
    return f"; did you mean {matches[0]!r}?" if matches else ""


def shortened(value: Any) -> str:
    """Show a value in at most 60 characters, however large or nested it is."""
    printer = reprlib.Repr()
    printer.maxlevel, printer.maxstring, printer.maxother = 2, 60, 60
    text = printer.repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
