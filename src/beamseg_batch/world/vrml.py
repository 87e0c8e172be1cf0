"""The VRML dialect of Webots worlds: nodes, fields, DEF and USE, with their lines."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, TypeAlias

from beamseg_batch.errors import WorldError
from beamseg_batch.schema import shortened

__all__ = ["VrmlField", "VrmlNode", "VrmlValue", "VrmlWorld", "parse_vrml"]

VrmlValue: TypeAlias = "float | bool | str | VrmlNode"

_TOKEN = re.compile(
    r"""(?P<space>[\s,]+|\#[^\n]*)
      | (?P<string>"(?:[^"\\]|\\.)*")
      | (?P<mark>[{}\[\]])
      | (?P<word>[^\s,\#"{}\[\]]+)
      | (?P<bad>.)""",
    re.VERBOSE | re.DOTALL,
)
_HEADER = re.compile(r"#VRML_SIM R(\d{4})([a-z])?")
_MAX_DEPTH = 100


class _Token(NamedTuple):
    kind: str
    text: str
    line: int


@dataclass(frozen=True, eq=False)
class VrmlField:
    """Value of a field: one or several numbers, flags, texts or nodes; and its line."""

    values: tuple[VrmlValue, ...]
    line: int


@dataclass(frozen=True, eq=False)
class VrmlNode:
    """A node.

    Attributes
    ----------
    kind : str
        ``Solid``
    name : str or None
        What DEF calls it.
    line : int
        Where its kind stands, counted from 1.
    fields : dict of str to VrmlField
    """

    kind: str
    name: str | None
    line: int
    fields: dict[str, VrmlField] = field(repr=False)

    def nodes(self, name: str) -> tuple[VrmlNode, ...]:
        """Nodes in a field; none if it is absent."""
        return tuple(value for value in self._values(name) if isinstance(value, VrmlNode))

    def texts(self, name: str) -> tuple[str, ...]:
        """Texts in a field; none if it is absent."""
        return tuple(value for value in self._values(name) if isinstance(value, str))

    def _values(self, name: str) -> tuple[VrmlValue, ...]:
        return self.fields[name].values if name in self.fields else ()


@dataclass(frozen=True, eq=False)
class VrmlWorld:
    """A Webots world as it is written.

    Attributes
    ----------
    release : tuple of (int, str)
        Of the file's header: ``(2023, "b")``.
    nodes : tuple of VrmlNode
    """

    release: tuple[int, str]
    nodes: tuple[VrmlNode, ...]


def parse_vrml(path: Path) -> VrmlWorld:
    """Read a Webots world.

    Parameters
    ----------
    path : Path

    Returns
    -------
    VrmlWorld

    Raises
    ------
    WorldError
        With file and line, if the file cannot be read or is not a Webots world.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise WorldError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise WorldError(f"{path}: is not UTF-8 text: {error}") from error
    header = _HEADER.match(text)
    if not header:
        raise WorldError(
            f"{path}:1: is not a Webots world: it must begin with '#VRML_SIM R2023b utf8' or alike"
        )
    nodes = _Parser(path, _tokens(text)).world()
    return VrmlWorld((int(header[1]), header[2] or "a"), nodes)


def _tokens(text: str) -> Iterator[_Token]:
    line = 1
    for match in _TOKEN.finditer(text):
        if match.lastgroup != "space":
            yield _Token(str(match.lastgroup), match[0], line)
        line += match[0].count("\n")
    yield _Token("end", "end of file", line)


class _Parser:
    """Recursive descent; a field's type follows from its first token, for any kind of node."""

    def __init__(self, path: Path, tokens: Iterator[_Token]) -> None:
        self._path = path
        self._tokens = tokens
        self._token = next(tokens)
        self._named: dict[str, VrmlNode] = {}

    def world(self) -> tuple[VrmlNode, ...]:
        nodes = []
        while self._token.kind != "end":
            word = self._token.text
            if word in {"EXTERNPROTO", "IMPORTABLE"}:
                self._skip_declaration()
            elif (node := self._node(0)) is not None:
                nodes.append(node)
        return tuple(nodes)

    def _skip_declaration(self) -> None:
        while self._token.text in {"EXTERNPROTO", "IMPORTABLE"}:
            self._next()
        self._expect("string", "the address of a PROTO")

    def _node(self, depth: int) -> VrmlNode | None:
        if depth > _MAX_DEPTH:
            raise self._error(self._token, f"nodes nest deeper than {_MAX_DEPTH}")
        word = self._expect("word", "a node")
        if word.text == "NULL":
            return None
        if word.text == "USE":
            return self._used()
        name = None
        if word.text == "DEF":
            name = self._expect("word", "a name").text
            word = self._expect("word", "a node")
        node = VrmlNode(word.text, name, word.line, self._fields(word.text, depth))
        if name is not None:
            self._named[name] = node
        return node

    def _used(self) -> VrmlNode:
        name = self._expect("word", "a name")
        if name.text not in self._named:
            raise self._error(name, f"USE {name.text}: no DEF {name.text} stands before it")
        return self._named[name.text]

    def _fields(self, kind: str, depth: int) -> dict[str, VrmlField]:
        opening = self._expect_mark("{", f"after {kind}")
        fields = {}
        while self._token.text != "}":
            if self._token.kind == "end":
                raise self._error(opening, f"{kind} has no closing brace")
            name = self._expect("word", "a field or a closing brace")
            fields[name.text] = VrmlField(tuple(self._values(name, depth)), name.line)
        self._next()
        return fields

    def _values(self, name: _Token, depth: int) -> Iterator[VrmlValue]:
        """Values of a field: a list in brackets, a run of numbers, or one value."""
        if self._token.text == "[":
            opening = self._next()
            while self._token.text != "]":
                if self._token.kind == "end":
                    raise self._error(opening, f"{name.text} has no closing bracket")
                yield from self._value(depth)
            self._next()
        elif _number(self._token) is not None:
            while (number := _number(self._token)) is not None:
                self._next()
                yield number
        elif self._token.kind in {"string", "word"}:
            yield from self._value(depth)
        else:
            raise self._error(name, f"{name.text} has no value")

    def _value(self, depth: int) -> Iterator[VrmlValue]:
        number = _number(self._token)
        if number is not None:
            self._next()
            yield number
        elif self._token.kind == "string":
            yield re.sub(r"\\(.)", r"\1", self._next().text[1:-1], flags=re.DOTALL)
        elif self._token.text in {"TRUE", "FALSE"}:
            yield self._next().text == "TRUE"
        elif (node := self._node(depth + 1)) is not None:
            yield node

    def _next(self) -> _Token:
        token = self._token
        self._token = next(self._tokens, token)
        if self._token.kind == "bad":
            raise self._error(self._token, "a text has no closing quote")
        return token

    def _expect(self, kind: str, what: str) -> _Token:
        if self._token.kind != kind:
            raise self._error(self._token, f"{what} is expected, not {shortened(self._token.text)}")
        return self._next()

    def _expect_mark(self, mark: str, where: str) -> _Token:
        if self._token.text != mark:
            raise self._error(
                self._token, f"{mark!r} is expected {where}, not {shortened(self._token.text)}"
            )
        return self._next()

    def _error(self, token: _Token, message: str) -> WorldError:
        return WorldError(f"{self._path}:{token.line}: {message}")


def _number(token: _Token) -> float | None:
    if token.kind != "word":
        return None
    try:
        return float(token.text)
    except ValueError:
        return None
