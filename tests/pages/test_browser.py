"""The report in a headless Chromium: what a person does with it, and what it must not do."""

from __future__ import annotations

import dataclasses
import json
import re

import numpy as np
import pytest

from beamseg_batch.evaluation import evaluate
from beamseg_batch.evaluation.page import evaluation_section, render_evaluation
from beamseg_batch.outputs.report import render_report
from tests.browser import browser, find_chromium
from tests.evaluation.structures import result_of, scattered, truth_of
from tests.outputs.conftest import build_flight

CHROMIUM = find_chromium()
pytestmark = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium found: install one, or name it in $CHROMIUM"
)

DRAWN = "!!document.querySelector('#structure.drawn')"
CAMERA = "JSON.stringify(document.querySelector('#structure .live').layout.scene.camera.eye)"
BEAMS = "#segments-table tbody tr"
WITHOUT_INFLATING = "delete window.DecompressionStream"


@pytest.fixture(scope="module")
def tab():
    with browser(CHROMIUM) as opened:
        yield opened


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """A report with everything in it: 12 beams, and how they compare with a truth."""
    flight = build_flight(n_segments=12, n_scans=300)
    ends = scattered(5)
    section = evaluation_section(evaluate(truth_of(ends), result_of(ends + 0.01)))
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(render_report(flight, sections=[section]), encoding="utf-8")
    return path


@pytest.fixture
def page(tab, file):
    """The report on a wide screen, its first figure drawn, as earlier tests left it."""
    tab.resize(1280, 900)
    if tab.evaluate("location.href") != file.resolve().as_uri() or not tab.evaluate(DRAWN):
        tab.open(file)
        tab.wait_for(DRAWN)
    return tab


def column(page, table, name):
    """Texts of a column as they stand, without hidden rows."""
    texts = page.evaluate(
        f"""(() => {{
            const table = document.querySelector("#{table}-table table");
            const n = [...table.tHead.rows[0].cells].findIndex((h) => h.dataset.name === "{name}");
            return JSON.stringify([...table.tBodies[0].rows].filter((row) => !row.hidden)
                .map((row) => row.cells[n].textContent));
        }})()"""
    )
    return json.loads(texts)


def colours(page):
    """How many beams have which colour in the scene."""
    return page.evaluate(
        """(() => {
            const trace = document.querySelector("#structure .live").data
                .find((trace) => trace.name === "beams");
            return new Set(trace.vertexcolor).size;
        })()"""
    )


def test_report__complains_of_nothing_and_requests_nothing(tab, file):
    tab.resize(1280, 900)
    tab.complaints.clear()
    tab.requests.clear()
    tab.open(file)
    tab.wait_for(DRAWN)
    figures = tab.evaluate("document.querySelectorAll('figure').length")
    for number in range(figures):
        tab.evaluate(f"document.querySelectorAll('figure')[{number}].scrollIntoView()")
        tab.wait_for(f"document.querySelectorAll('figure')[{number}].matches('.drawn')")
    # Chromium advises plotly.js on how to read its canvas; that is no fault of the page.
    assert [text for text in tab.complaints if "willReadFrequently" not in text] == []
    assert {url.partition(":")[0] for url in tab.requests} <= {"file", "blob", "data"}
    assert [url for url in tab.requests if url.startswith("file:")] == [file.resolve().as_uri()]


def test_report__rows_sort_by_numbers(page):
    as_found = column(page, "segments", "length")
    head = '#segments-table th[data-name="length"]'
    page.click(f"{head} button")
    assert column(page, "segments", "length") == sorted(as_found, key=float)
    assert page.evaluate(f"document.querySelector('{head}').ariaSort") == "ascending"
    page.click(f"{head} button")
    assert column(page, "segments", "length") == sorted(as_found, key=float, reverse=True)


def test_report__rows_that_miss_a_number_come_last(page):
    head = '#members-table th[data-name="joint_1"]'
    for _ in range(2):
        page.click(f"{head} button")
        values = column(page, "members", "joint_1")
        assert "–" in values
        assert "–" not in values[: -values.count("–")]


def test_report__rows_are_filtered_by_words_and_limits(page):
    lengths = [float(text) for text in column(page, "segments", "length")]
    filter_by = (
        "((text) => {{ const box = document.querySelector('#segments-table input[type=search]');"
        "box.value = text; box.dispatchEvent(new Event('input')); }})({!r})"
    )
    page.evaluate(filter_by.format("length>1.5"))
    expected = [length for length in lengths if length > 1.5]
    assert [float(text) for text in column(page, "segments", "length")] == expected
    assert 0 < len(expected) < len(lengths)
    page.evaluate(filter_by.format("no such beam"))
    assert column(page, "segments", "length") == []
    page.evaluate(filter_by.format(""))
    assert len(column(page, "segments", "length")) == len(lengths)


def test_report__table_is_copied_as_csv(page):
    page.evaluate("navigator.clipboard.writeText = async (text) => { window.copied = text; }")
    page.click("#segments-table .tools button")
    lines = page.wait_for("window.copied").splitlines()
    assert lines[0].startswith("beam,quality,remarks,")
    assert "pca_coeff" not in lines[0]
    assert [line.split(",")[0] for line in lines[1:]] == column(page, "segments", "segment")
    page.click("#segments-table .tools input[type=checkbox]")
    page.click("#segments-table .tools button")
    page.wait_for("window.copied.includes('pca_coeff')")


def test_report__click_on_a_row_marks_its_beam(page):
    before = colours(page)
    page.click(f"{BEAMS}[data-beam='3'] td:nth-child(2)")
    page.wait_for(f"document.querySelector(\"{BEAMS}[data-beam='3']\").matches('.chosen')")
    assert page.evaluate("document.querySelectorAll('#segments-table .chosen').length") == 1
    assert colours(page) == before + 1
    page.click(f"{BEAMS}[data-beam='3'] td:nth-child(2)")
    page.wait_for("document.querySelectorAll('.chosen').length === 0")
    assert colours(page) == before


def test_report__rows_are_chosen_by_keys(page):
    page.evaluate(f"document.querySelector('{BEAMS}').focus()")
    page.press("ArrowDown")
    page.press("ArrowDown")
    page.press("Enter")
    chosen = "document.querySelector('#segments-table .chosen')"
    assert page.wait_for(f"{chosen}?.dataset.beam") == column(page, "segments", "segment")[2]
    assert page.evaluate(f"{chosen}.getAttribute('aria-selected')") == "true"


def test_report__view_buttons_change_the_camera(page):
    eyes = {page.evaluate(CAMERA)}
    for name in ("top", "front", "side", "iso"):
        page.click(f"[data-for=structure] [data-view={name}]")
        page.wait_for(f"document.querySelector('[data-view={name}]').ariaPressed === 'true'")
        eyes.add(page.evaluate(CAMERA))
    assert len(eyes) == 4
    page.click("[data-for=structure] [data-view=top]")
    eye = json.loads(page.evaluate(CAMERA))
    assert eye["z"] > 10 * np.hypot(eye["x"], eye["y"]) or eye["z"] > 1


def test_report__view_is_kept_when_colours_change(page):
    page.click("[data-for=structure] [data-view=front]")
    front = page.evaluate(CAMERA)
    page.click(f"{BEAMS}[data-beam='1'] td:nth-child(2)")
    page.resize(1280, 900, dark=True)
    page.wait_for("document.querySelector('#structure .live').layout.font.color === '#e6ebf1'")
    assert page.evaluate(CAMERA) == front


def test_report__beams_are_coloured_as_asked(page):
    key = "document.getElementById('key').textContent"
    seen = set()
    for name in ("quality", "shape", "first seen"):
        page.evaluate(
            f"(() => {{ const s = document.getElementById('shade'); s.value = '{name}';"
            "s.dispatchEvent(new Event('change')); })()"
        )
        text = page.evaluate(key)
        assert sum(int(count) for count in re.findall(r"\((\d+)\)", text)) == 12
        seen.add(text)
    assert len(seen) == 3


@pytest.mark.parametrize("dark", [False, True])
def test_report__fits_a_phone(tab, file, dark):
    tab.open(file)
    tab.resize(390, 844, dark=dark, phone=True)
    tab.wait_for(DRAWN)
    assert tab.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.parametrize("dark", [False, True])
def test_report__text_stands_out(page, dark):
    """The least contrast of WCAG, 4.5, for every kind of text."""
    page.resize(1280, 900, dark=dark)
    pairs = [
        ("ink", "page"), ("ink", "card"), ("muted", "page"), ("muted", "card"),
        ("accent", "page"), ("accent", "card"), ("ink", "warn-page"),
    ]  # fmt: skip
    values = json.loads(
        page.evaluate(
            f"JSON.stringify({json.dumps(pairs)}.map((pair) => pair.map((name) =>"
            "getComputedStyle(document.documentElement).getPropertyValue('--' + name).trim())))"
        )
    )
    for (one, other), pair in zip(values, pairs, strict=True):
        light, dim = sorted((luminance(one), luminance(other)), reverse=True)
        assert (light + 0.05) / (dim + 0.05) >= 4.5, pair


def luminance(colour):
    parts = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    linear = np.where(parts <= 0.03928, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def test_report__controls_have_names(page):
    nameless = page.evaluate(
        "[...document.querySelectorAll("
        "'main :is(button, input, select, [role=img], [role=region], svg)')]"
        ".filter((e) => !e.closest('.js-plotly-plot') && !e.textContent.trim()"
        " && !e.ariaLabel && !e.closest('label')).map((e) => e.outerHTML).join()"
    )
    assert nameless == ""


def test_report__prints_still_pictures(page, tmp_path):
    page.call("Emulation.setEmulatedMedia", media="print")
    shown = page.evaluate(
        "JSON.stringify([...document.querySelectorAll('.live, .picture, .tools, nav')].map((e) =>"
        "[e.className || e.tagName, getComputedStyle(e).display !== 'none']))"
    )
    page.call("Emulation.setEmulatedMedia", media="")
    visible = {name: set() for name in ("live", "picture", "tools", "NAV")}
    for name, is_shown in json.loads(shown):
        visible[name.split()[0]].add(is_shown)
    assert visible == {"live": {False}, "picture": {True}, "tools": {False}, "NAV": {False}}
    page.printed(tmp_path / "report.pdf")
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF")


def test_report__shows_still_pictures_where_nothing_unpacks(tab, file):
    script = tab.call("Page.addScriptToEvaluateOnNewDocument", source=WITHOUT_INFLATING)
    try:
        tab.resize(1280, 900)
        tab.complaints.clear()
        tab.open(file)
        tab.click('#segments-table th[data-name="length"] button')
        tab.click("[data-for=structure] [data-view=top]")
        tab.click(f"{BEAMS}[data-beam='3'] td:nth-child(2)")
        assert not tab.evaluate("'Plotly' in window")
        height = "document.querySelector('#structure .picture svg').getBoundingClientRect().height"
        assert tab.evaluate(height) > 100
        assert tab.complaints == []
    finally:
        tab.call("Page.removeScriptToEvaluateOnNewDocument", identifier=script["identifier"])


def test_report__without_beams(tab, tmp_path):
    flight = build_flight(n_segments=0, n_scans=3, n_cloud=10)
    tab.complaints.clear()
    for number, one in enumerate((flight, dataclasses.replace(flight, scans=()))):
        path = tmp_path / f"{number}.html"
        path.write_text(render_report(one), encoding="utf-8")
        tab.open(path)
        tab.wait_for(DRAWN)
    assert [text for text in tab.complaints if "willReadFrequently" not in text] == []


def test_evaluation__is_drawn(tab, tmp_path):
    ends = scattered(5)
    path = tmp_path / "evaluation.html"
    path.write_text(render_evaluation(evaluate(truth_of(ends), result_of(ends + 0.01))))
    tab.resize(1280, 900)
    tab.complaints.clear()
    tab.open(path)
    tab.wait_for("!!document.querySelector('#overlay.drawn')")
    tab.click("[data-for=overlay] [data-view=side]")
    tab.wait_for("document.querySelector('[data-view=side]').ariaPressed === 'true'")
    assert [text for text in tab.complaints if "willReadFrequently" not in text] == []
