"""The examples of the documented Python API run as they stand."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "python.md"


def block(language: str, number: int) -> str:
    """Give a fenced block of a language on the page, counted from 0."""
    assert PAGE.is_file(), f"{PAGE} is missing: it must show the Python API by an example"
    text = PAGE.read_text(encoding="utf-8")
    found = re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    assert len(found) > number, f"{PAGE} has {len(found)} ```{language} blocks"
    return found[number]


def shape_of(printed: str) -> str:
    """Leave out the digits and spaces of a text: they differ between machines."""
    return re.sub(r"\s+", "", re.sub(r"-?\d+\.?\d*", "#", printed))


@pytest.mark.parametrize("number", range(3))
def test_example__runs_from_the_root_of_the_repository(number, monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    exec(compile(block("python", number), str(PAGE), "exec"), {"__name__": "__main__"})
    printed = capsys.readouterr()
    assert printed.err == ""
    assert shape_of(printed.out) == shape_of(block("text", number))
