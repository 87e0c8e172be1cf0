"""The page of an evaluation: one file, everything in it, nothing asked of anybody."""

from __future__ import annotations

import base64
import dataclasses
import json
import re

import numpy as np
import pytest

from beamseg_batch.evaluation import Check, evaluate
from beamseg_batch.evaluation.page import errors_chart, overlay_scene, render_evaluation
from tests.evaluation.structures import result_of, scattered, truth_of

HOSTILE = "</script><script>alert('x')</script><img src=x onerror=alert(1)>&\"{{ 7*7 }}"
ENDS = scattered(6, seed=3)


def decoded(typed):
    kind = np.dtype(typed["dtype"]).newbyteorder("<")
    return np.frombuffer(base64.b64decode(typed["bdata"]), dtype=kind)


def traces(evaluation):
    return {trace["name"]: trace for trace in overlay_scene(evaluation).figure()["data"]}


@pytest.fixture(scope="module")
def evaluation():
    """One member missed, one segment false, one doubled; a joint found, one invented."""
    cross = [[ENDS[0, 0], ENDS[0, 0] + [0.0, 0.0, 1.0]]]
    truth = truth_of(np.concatenate([ENDS, cross]))
    found = np.concatenate(
        [np.add(ENDS[:5], [0.0, 0.0, 0.004]), ENDS[:1], np.add(ENDS[1:2], [0, 0, 0.4]), cross]
    )
    return evaluate(truth, result_of(found, joints=[ENDS[0, 0], [9.0, 9.0, 9.0]]))


@pytest.fixture(scope="module")
def html(evaluation):
    return render_evaluation(evaluation, [Check("recall >= 1", False, "is 0.857")])


def test_render_evaluation__requests_nothing(html):
    page = re.sub(r"<script.*?</script>", "", html, flags=re.DOTALL)
    assert not re.search(r"""(src|action|poster)\s*=|href="[^#]""", page)
    assert not re.search(r"@import|url\(", page)
    assert "default-src 'none'" in page
    assert len(html.encode()) < 8_000_000


def test_render_evaluation__says_what_was_measured(html, evaluation):
    main = html[html.index("<main>") : html.index("</main>")]
    text = " ".join(re.sub(r"<[^>]+>", " ", main).split())
    for expected in (
        "85.7 %",
        "6 of 7 members",
        "6 of 8 segments",
        "1 duplicates, 0 fragments, 1 false",
        "recall &gt;= 1 is 0.857 failed",
        "axis_offset",
        "missed",
        "1 of 1 1 invented",
    ):
        assert expected in text
    assert "None" not in text
    assert "nan" not in text


def test_render_evaluation__figures_are_valid_plotly(html):
    graph_objects = pytest.importorskip("plotly.graph_objects")
    figures = json.loads(re.search(r'id="figures">(.*?)</script>', html, re.DOTALL)[1])
    assert list(figures) == ["overlay", "errors"]
    for figure in figures.values():
        text = re.sub(r'"\$\w+"', '"red"', json.dumps(figure))
        graph_objects.Figure(json.loads(text))


def test_overlay_scene__a_trace_per_verdict(evaluation):
    drawn = traces(evaluation)
    assert {name: len(trace["meta"]["labels"]) for name, trace in drawn.items()} == {
        "truth": 6,
        "truth, missed": 1,
        "matched": 6,
        "duplicate": 1,
        "false": 1,
        "joints found": 1,
        "joints invented": 1,
    }
    for trace in drawn.values():
        assert sum(trace["meta"]["counts"]) == len(decoded(trace["x"]))
    assert "member 6" in drawn["truth, missed"]["meta"]["labels"][0]
    assert "duplicate, member 1" in drawn["duplicate"]["meta"]["labels"][0]


def test_errors_chart__distance_and_angle_of_every_match(evaluation):
    (trace,) = errors_chart(evaluation).figure()["data"]
    np.testing.assert_allclose(
        decoded(trace["x"]), [m.midpoint_distance for m in evaluation.matches], rtol=1e-6
    )
    np.testing.assert_allclose(
        decoded(trace["y"]), np.radians([m.angle_deg for m in evaluation.matches]), rtol=1e-6
    )
    assert trace["text"] == ["1", "2", "3", "4", "5", "7"]


def test_render_evaluation__nothing_found():
    html = render_evaluation(evaluate(truth_of(ENDS), result_of([], joints=None)))
    assert "No segment is a member." in html
    assert "the run says nothing of joints" in html
    assert 'id="errors"' not in html


def test_render_evaluation__hostile_names(evaluation):
    truth = dataclasses.replace(
        evaluation.truth, source=HOSTILE, names=(HOSTILE,) * 7, notes=(HOSTILE,)
    )
    result = dataclasses.replace(evaluation.result, source=HOSTILE)
    hostile = dataclasses.replace(evaluation, truth=truth, result=result)
    page = render_evaluation(hostile, [Check(HOSTILE, False, HOSTILE)])
    assert page.count("<script") == render_evaluation(evaluation).count("<script")
    assert "<img" not in page[page.index("<main>") : page.index("</main>")]
    assert "49" not in re.findall(r"onerror=alert\(1\)&gt;&amp;&#34;(.{2})", page)


def test_render_evaluation__no_more_than_can_be_drawn(monkeypatch):
    monkeypatch.setattr("beamseg_batch.evaluation.page.MAX_DRAWN", 4)
    evaluation = evaluate(truth_of(ENDS), result_of(ENDS, joints=ENDS[:, 0]))
    assert evaluation.metrics["recall"] == 1.0
    for trace in traces(evaluation).values():
        assert len(trace["meta"]["labels"]) == 4
    assert "At most 4 of a kind are drawn." in render_evaluation(evaluation)


def test_overlay_scene__members_that_were_not_seen_stand_apart():
    ends = scattered(3)
    seen = ends.copy()
    seen[2] = np.nan
    truth = truth_of(ends, seen)
    drawn = traces(evaluate(truth, result_of(ends[:1])))
    assert {
        name: trace["meta"]["labels"][0].partition("<br>")[0] for name, trace in drawn.items()
    } == {
        "truth": "<b>member 1</b>",
        "truth, missed": "<b>member 2</b>",
        "truth, not seen": "<b>member 3</b>",
        "matched": "<b>segment 0</b>: matched, member 1",
    }
