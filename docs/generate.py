"""Fill in the generated parts of the documentation: ``python docs/generate.py``.

A generated part of a page stands between two comments, ``<!-- generated: NAME -->`` and
``<!-- end -->``. What is outside of them is written by hand and stays as it is.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from beamseg_batch import reasons
from beamseg_batch.config import ALIASES, RunConfig, load_config
from beamseg_batch.evaluation import COMPARED, MEASURES, Measure
from beamseg_batch.outputs import structure_file
from beamseg_batch.tables import CANDIDATES, FLY_AGAIN, TABLES, TRUTH_TABLES

DOCS = Path(__file__).resolve().parent
PROFILES = ("precise", "report")

_PART = re.compile(r"(<!-- generated: (?P<name>[\w.]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def main() -> None:
    """Bring every page up to date."""
    for page in generated_pages():
        page.write_text(updated(page.read_text(encoding="utf-8")), encoding="utf-8")


def generated_pages() -> tuple[Path, ...]:
    """Pages with at least one generated part, sorted."""
    pages = sorted(DOCS.glob("*.md"))
    return tuple(page for page in pages if _PART.search(page.read_text(encoding="utf-8")))


def updated(page: str) -> str:
    """Text of a page with its generated parts as they should be."""
    return _PART.sub(lambda part: f"{part[1]}{_parts()[part['name']]()}{part[3]}", page)


def _parts() -> dict[str, Callable[[], str]]:
    """What can be generated, by name."""
    parts: dict[str, Callable[[], str]] = {
        table.file_name: table.documentation
        for table in (*TABLES, FLY_AGAIN, CANDIDATES, *TRUTH_TABLES)
    }
    return parts | {
        "structure.npz": structure_file.documentation,
        "reasons": reasons.documentation,
        "configuration": _configuration,
        "aliases": _aliases,
        "measures": lambda: _measures(MEASURES),
        "compared": lambda: _measures(COMPARED),
    }


def _measures(measures: Iterable[Measure]) -> str:
    """Table of measures; `.*` stands for the three figures of a spread."""
    rows = [
        f"| `{m.name}{'.*' if m.is_spread else ''}` | {m.unit or '–'} | {m.meaning} |"
        for m in measures
    ]
    return "\n".join(["| metric | unit | what |", "|---|---|---|", *rows]) + "\n"


def _aliases() -> str:
    """Table of the keys of the original node."""
    rows = [f"| `{alias}` | `{path}` |" for alias, path in ALIASES.items()]
    return "\n".join(["| original key | here |", "|---|---|", *rows]) + "\n"


def _configuration() -> str:
    """Every branch of the configuration tree with a table of its values."""
    schema = RunConfig.model_json_schema()
    defaults = [load_config(name).model_dump(mode="json") for name in PROFILES]
    sections = []
    for path, branch in _branches(RunConfig):
        rows = list(_rows(path, branch, schema, defaults))
        if rows:
            sections.append(_section(path, branch, rows))
    return "\n".join(sections)


def _branches(node: type[BaseModel], path: str = "") -> Iterator[tuple[str, type[BaseModel]]]:
    """All branches of the tree, each before its own branches."""
    yield path, node
    for name, entry in node.model_fields.items():
        branch = _branch_of(entry.annotation)
        if branch:
            yield from _branches(branch, f"{path}.{name}".lstrip("."))


def _branch_of(annotation: Any) -> type[BaseModel] | None:
    for candidate in (annotation, *getattr(annotation, "__args__", ())):
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            return candidate
    return None


def _section(path: str, branch: type[BaseModel], rows: list[str]) -> str:
    head = "| key | meaning | values | " + " | ".join(f"`{name}`" for name in PROFILES) + " |"
    title = f"### `{path}`" if path else "### Top level"
    meaning = " ".join((branch.__doc__ or "").split()).replace("``", "`")
    return "\n".join([title, "", meaning, "", head, "|---|---|---|---|---|", *rows, ""])


def _rows(
    path: str, branch: type[BaseModel], schema: Mapping[str, Any], defaults: list[dict[str, Any]]
) -> Iterator[str]:
    own = schema["$defs"].get(branch.__name__, schema)["properties"]
    for name, entry in branch.model_fields.items():
        optional = entry.default is None
        if _branch_of(entry.annotation) and not optional:
            continue
        meaning = " ".join((entry.description or "").split())
        values = [_value(_at(tree, path), name, entry.default) for tree in defaults]
        cells = [f"`{name}`", meaning, _range(own[name], schema), *values]
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _at(tree: Any, path: str) -> Any:
    for key in filter(None, path.split(".")):
        tree = tree[key] if tree is not None else None
    return tree


def _value(branch: Mapping[str, Any] | None, name: str, default: Any) -> str:
    """A default as YAML; one of a branch that is null applies once the branch is given."""
    value = default if branch is None else branch[name]
    return f"`{json.dumps(value).strip(chr(34))}`"


def _range(entry: Mapping[str, Any], schema: Mapping[str, Any]) -> str:
    """Which values a key takes, for people."""
    if "anyOf" in entry:
        return " or ".join(_range(choice, schema) for choice in entry["anyOf"])
    if "$ref" in entry:
        return "the keys below"
    if "enum" in entry:
        return ", ".join(f"`{value}`" for value in entry["enum"])
    kind = entry["type"]
    if kind == "array":
        return _array_range(entry, schema)
    if kind in ("number", "integer"):
        return ("integer" if kind == "integer" else "number") + _limits(entry)
    return {"boolean": "`true`, `false`", "null": "`null`", "string": "text"}[kind]


def _array_range(entry: Mapping[str, Any], schema: Mapping[str, Any]) -> str:
    if "prefixItems" in entry:
        count = len(entry["prefixItems"])
        return "[low, high]" if count == 2 else f"{count} numbers"
    return f"list, each a {_range(entry['items'], schema)}"


def _limits(entry: Mapping[str, Any]) -> str:
    low, high = entry.get("minimum"), entry.get("maximum")
    if low is not None and high is not None:
        return f", {low:g} to {high:g}"
    if "exclusiveMinimum" in entry:
        return f" above {entry['exclusiveMinimum']:g}"
    return f", {low:g} or more" if low is not None else ""


if __name__ == "__main__":
    main()
