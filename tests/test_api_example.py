"""The example of the documented Python API runs as it stands."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "python.md"


def first_block(language: str) -> str:
    """Give the first fenced block of a language on the page."""
    assert PAGE.is_file(), f"{PAGE} is missing: it must show the Python API by an example"
    text = PAGE.read_text(encoding="utf-8")
    found = re.search(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    assert found, f"{PAGE} has no ```{language} block"
    return found[1]


def shape_of(printed: str) -> str:
    """Leave out the digits and spaces of a text: they differ between machines."""
    return re.sub(r"\s+", "", re.sub(r"-?\d+\.?\d*", "#", printed))


def test_example__runs_from_the_root_of_the_repository():
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", first_block("python")],
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
        encoding="utf-8",
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert shape_of(done.stdout) == shape_of(first_block("text"))
