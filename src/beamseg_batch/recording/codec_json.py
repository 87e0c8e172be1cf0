"""JSON messages -> plain objects, by the JSON schema that an MCAP file carries."""

from __future__ import annotations

import json
from base64 import b64decode
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

__all__ = ["json_decoder"]

_EMPTY: Mapping[str, Any] = {
    "number": 0.0, "integer": 0, "string": "", "boolean": False, "array": [], "object": {},
}  # fmt: skip


def json_decoder(schema_text: str) -> Callable[[bytes], object]:
    """Make a decoder of one message type.

    Parameters
    ----------
    schema_text : str
        The JSON schema; empty or of another form, messages are taken as they are.

    Returns
    -------
    callable
        From the bytes of a message to its object: a field is an attribute of that name,
        a field that the schema knows and the message lacks is zero or empty, a field
        whose schema says base64 is bytes, and one that names its values (``FLOAT32``)
        is the number.
    """
    try:
        schema = json.loads(schema_text or "{}")
    except ValueError:
        schema = {}
    return lambda raw: _plain(json.loads(raw), schema)


def _plain(value: Any, schema: Any) -> Any:
    rule: dict[str, Any] = schema if isinstance(schema, dict) else {}
    if isinstance(value, dict):
        return _object(value, rule)
    if isinstance(value, list):
        return [_plain(item, rule.get("items")) for item in value]
    if isinstance(value, str):
        return _text(value, rule)
    return value


def _object(value: dict[str, Any], rule: dict[str, Any]) -> SimpleNamespace:
    rules = rule.get("properties", {})
    missing = {name: _EMPTY.get(rules[name].get("type")) for name in rules if name not in value}
    return SimpleNamespace(
        **{name: _plain(item, rules.get(name)) for name, item in {**value, **missing}.items()}
    )


def _text(value: str, rule: dict[str, Any]) -> str | bytes | int:
    if rule.get("contentEncoding") == "base64":
        return b64decode(value, validate=True)
    named = {choice.get("title"): choice.get("const") for choice in rule.get("oneOf", ())}
    number: str | int = named.get(value, value)
    return number
