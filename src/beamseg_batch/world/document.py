"""A YAML file whose values know the line they stand in, and its validation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from beamseg_batch.errors import WorldError
from beamseg_batch.schema import YamlError, message_of, nearest, problems, read_yaml, shortened

__all__ = ["Document", "Key", "load_document", "requirement", "validate"]

Key: TypeAlias = tuple[str | int, ...]
"""Place of a value in a document: names of keys and numbers of items, from the top down."""

_REQUIREMENTS = {
    "missing": "is missing",
    "greater_than": "must be above {gt:g}",
    "greater_than_equal": "must be at least {ge:g}",
    "less_than": "must be below {lt:g}",
    "less_than_equal": "must be at most {le:g}",
    "finite_number": "must be finite",
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "int_type": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_from_float": "must be a whole number",
    "bool_type": "must be true or false",
    "bool_parsing": "must be true or false",
    "string_type": "must be text",
    "literal_error": "must be {expected}",
    "union_tag_not_found": "{discriminator} is missing",
    "union_tag_invalid": "{discriminator} must be one of {expected_tags}",
    "list_type": "must be a list",
    "tuple_type": "must be a list",
    "too_short": "must hold at least {min_length} values",
    "too_long": "must hold at most {max_length} values",
    "dict_type": "must be a mapping of keys to values",
    "mapping_type": "must be a mapping of keys to values",
    "model_type": "must be a mapping of keys to values",
    "model_attributes_type": "must be a mapping of keys to values",
}
"""What each kind of pydantic's problems asks for; its own words serve for the others."""

Model = TypeVar("Model", bound=BaseModel)


@dataclass(frozen=True, eq=False)
class Document:
    """A YAML file as it was read.

    Attributes
    ----------
    path : Path
        As it was named; files that the document names are relative to its folder.
    data : dict
        Plain Python values.
    """

    path: Path
    data: dict[str, Any]
    _node: Any = field(repr=False)

    def value(self, key: Key) -> Any:
        """Value at a place; KeyError or IndexError if there is none."""
        value: Any = self.data
        for part in key:
            value = value[part]
        return value

    def line_of(self, key: Key) -> int | None:
        """Line of a value, counted from 1.

        Parameters
        ----------
        key : tuple of str and int
            ``("members", 3, "radius")``

        Returns
        -------
        int or None
            Where its key stands. Of a place that does not exist, the line of the part
            around it; None if even the first key is not in the document.
        """
        line, node = None, self._node
        for part in key:
            found = _entry(node, part)
            if found is None:
                break
            line, node = found
        return line

    def error(self, key: Key, message: str) -> WorldError:
        """Make the error that something is wrong at a place.

        Parameters
        ----------
        key : tuple of str and int
        message : str
            ``must be above 0, not -0.05``

        Returns
        -------
        WorldError
            ``world.yaml:12: members[3].radius: must be above 0, not -0.05``
        """
        return WorldError(self._sentence(key, message))

    def _sentence(self, key: Key, message: str) -> str:
        where = _place(self.path, self.line_of(key))
        return f"{where}: {_key_path(key)}: {message}" if key else f"{where}: {message}"


def load_document(path: Path) -> Document:
    """Read a YAML file.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Document

    Raises
    ------
    WorldError
        If the file cannot be read, is not UTF-8, not YAML, empty, or not a mapping of
        keys to values.
    """
    try:
        content, node = read_yaml(path)
    except YamlError as error:
        raise WorldError(f"{_place(path, error.line)}: {error}") from error
    if content is None:
        raise WorldError(f"{path}: is empty")
    if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
        raise WorldError(f"{path}: must be a mapping of keys to values")
    return Document(path, content, node)


def validate(model: type[Model], document: Document, key: Key = ()) -> Model:
    """Check a part of a document against its model.

    Parameters
    ----------
    model : type of pydantic.BaseModel
    document : Document
    key : tuple of str and int
        Where the part stands; the whole document without.

    Returns
    -------
    an instance of `model`

    Raises
    ------
    WorldError
        With a line for each problem: ``FILE:LINE: KEY: what it must be, not VALUE``.
    """
    try:
        value = document.value(key)
    except (KeyError, IndexError, TypeError):
        raise document.error(key, "is missing") from None
    try:
        return model.model_validate(value)
    except ValidationError as error:
        sentences = [
            document._sentence(*_explained(problem, model, document, key))
            for problem in problems(error)
        ]
        raise WorldError(*sentences) from None


def _place(path: Path, line: int | None) -> str:
    return str(path) if line is None else f"{path}:{line}"


def _key_path(key: Key) -> str:
    """Write a place in a tree as people do: ``members[3].radius``."""
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in key)
    return "".join(parts).removeprefix(".")


def _entry(node: Any, part: str | int) -> tuple[int, Any] | None:
    """Line and node of an entry of a mapping or a list."""
    if node.id == "sequence" and isinstance(part, int) and part < len(node.value):
        return node.value[part].start_mark.line + 1, node.value[part]
    if node.id == "mapping":
        # The last of equal keys: those that a `<<` merges stand first.
        for name, value in reversed(node.value):
            if name.value == part:
                return name.start_mark.line + 1, value
    return None


def _explained(
    problem: Mapping[str, Any], model: type[BaseModel], document: Document, key: Key
) -> tuple[Key, str]:
    """Say where one of pydantic's problems lies, and in a sentence what is wrong."""
    kind, value = problem["type"], problem.get("input")
    place = key + _without_tags(problem["loc"], document.value(key), kind == "missing")
    if kind == "extra_forbidden":
        known = list(_keys(model, problem["loc"][:-1]))
        suggestion = nearest(str(place[-1]), known) or f"; there are: {', '.join(known)}"
        return place, f"unknown key{suggestion}"
    said = kind in {"missing", "value_error"} or isinstance(value, Mapping)
    return place, requirement(problem) + ("" if said else f", not {shortened(value)}")


def requirement(problem: Mapping[str, Any]) -> str:
    """Say what one of pydantic's problems asks for: ``must be above 0``."""
    words = _REQUIREMENTS.get(problem["type"])
    return words.format(**problem.get("ctx", {})) if words else message_of(problem)


def _without_tags(loc: Key, data: Any, missing: bool) -> Key:
    """Leave out of a problem's place what stands for a choice of models, not for a key."""
    kept: list[str | int] = []
    for number, part in enumerate(loc):
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            if not (missing and number == len(loc) - 1):
                continue
        kept.append(part)
    return tuple(kept)


def _keys(model: type[BaseModel], loc: Key) -> Iterator[str]:
    """Keys that may stand at a place of a model."""
    models = [model]
    for part in loc:
        fields = [field for m in models for name, field in _named_fields(m) if name == part]
        models = [m for field in fields for m in _models(field.annotation)] or models
    for candidate in models:
        yield from (name for name, _ in _named_fields(candidate))


def _named_fields(model: type[BaseModel]) -> Iterator[tuple[str, Any]]:
    for name, entry in model.model_fields.items():
        yield entry.alias or name, entry


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """Models in an annotation, whatever lists and choices they stand in."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models(argument)
