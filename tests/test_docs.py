"""The documentation says what the program is: generated parts, places in the code, links."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
GENERATOR = runpy.run_path(str(ROOT / "docs" / "generate.py"))

LINK = re.compile(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]+))?\)")
HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
CODE_BLOCK = re.compile(r"^ *```.*?^ *```", re.MULTILINE | re.DOTALL)


def anchors(page):
    """Anchors of a page's headings, as GitHub makes them."""
    text = CODE_BLOCK.sub("", page.read_text(encoding="utf-8"))
    words = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in HEADING.findall(text))
    return {word.replace(" ", "-") for word in words}


def test_generated_pages__are_those_with_tables():
    pages = [page.name for page in GENERATOR["generated_pages"]()]
    assert pages == ["configuration.md", "evaluation.md", "explain.md", "outputs.md"]


@pytest.mark.parametrize("name", ["configuration.md", "evaluation.md", "explain.md", "outputs.md"])
def test_generated_pages__are_up_to_date(name):
    page = (ROOT / "docs" / name).read_text(encoding="utf-8")
    assert GENERATOR["updated"](page) == page, "run: python docs/generate.py"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links__lead_somewhere(page):
    broken = []
    for target, anchor in LINK.findall(CODE_BLOCK.sub("", page.read_text(encoding="utf-8"))):
        file = page.parent / target if target else page
        if not file.exists() or (anchor and anchor not in anchors(file)):
            broken.append(f"{target}#{anchor}")
    assert broken == []


def definitions(source):
    """Names of the functions and classes that a file defines."""
    text = source.read_text(encoding="utf-8")
    return set(re.findall(r"^(?:def|class) (\w+)", text, re.MULTILINE))


def test_method__names_places_that_exist():
    text = (ROOT / "docs" / "method.md").read_text(encoding="utf-8")
    places = re.findall(r"`([a-z_.]+):(\w+)`", text)
    assert len(places) > 20
    for module, name in places:
        file = ROOT / "src" / "beamseg_batch" / f"{module.replace('.', '/')}.py"
        assert name in definitions(file), f"{module}:{name}"


def test_method__names_tests_that_exist():
    text = (ROOT / "docs" / "method.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`(test_\w+)`", text))
    known = set().union(*(definitions(file) for file in (ROOT / "tests").rglob("test_*.py")))
    assert named
    assert named <= known, sorted(named - known)
