"""Charts: one description, a plotly figure and a picture."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from beamseg_batch.pages.charts import Chart, Limit, Series, envelope, histogram, quartiles

X = np.linspace(0.0, 10.0, 50)


def chart(kind="line", x=X, y=X**2, labels=(), **more):
    return Chart(
        "across [s]", "up [ms]", (Series(kind, "one", "$beam", x, y, labels),), "so", **more
    )


def elements(picture, name):
    return [e for e in ElementTree.fromstring(picture).iter() if e.tag == name]


def texts(picture):
    return [element.text for element in elements(picture, "text")]


@pytest.mark.parametrize("size", [0, 1, 5, 2999, 3000])
def test_envelope__short_series_stay_as_they_are(size):
    x, y = np.arange(size, dtype=float), np.ones(size)
    assert [len(values) for values in envelope(x, y)] == [size, size]


def test_envelope__keeps_the_lowest_and_highest_of_every_stretch():
    rng = np.random.default_rng(3)
    x, y = np.arange(36_000.0), rng.normal(size=36_000)
    y[17_001], y[17_002] = 50.0, -50.0
    thin_x, thin_y = envelope(x, y, 100)
    assert len(thin_x) <= 202
    assert np.all(np.diff(thin_x) > 0)
    assert (thin_x[0], thin_x[-1]) == (0.0, 35_999.0)
    assert {50.0, -50.0} <= set(thin_y)
    np.testing.assert_array_equal(y[thin_x.astype(int)], thin_y)
    for start in range(0, 36_000, 360):
        inside = (thin_x >= start) & (thin_x < start + 360)
        assert thin_y[inside].max() == y[start : start + 360].max()
        assert thin_y[inside].min() == y[start : start + 360].min()


def test_histogram__counts_all_from_zero():
    values = np.array([0.0, 0.1, 0.9, 1.0, 1.0])
    x, y = histogram(values, 10)
    assert y.sum() == 5
    assert (x[0], y[0], y[-1]) == (0.05, 1.0, 3.0)
    assert histogram(np.zeros(3), 4)[1].tolist() == [3.0, 0.0, 0.0, 0.0]


def test_quartiles__whiskers_leave_outliers_out():
    low, lower, middle, upper, high = quartiles(np.append(np.arange(101.0), 1000.0))
    assert (low, high) == (0.0, 100.0)
    assert lower < middle < upper
    assert quartiles(np.array([2.0])).tolist() == [2.0] * 5


@pytest.mark.parametrize("kind", ["line", "steps", "points", "bars"])
def test_chart__both_forms_hold_the_series(kind):
    made = chart(kind, labels=tuple("abc") if kind == "points" else (), x=X[:3], y=X[:3])
    figure, picture = made.figure(), made.picture()
    (trace,) = figure["data"]
    assert trace["type"] == ("bar" if kind == "bars" else "scatter")
    assert figure["layout"]["xaxis"]["title"]["text"] == "across [s]"
    assert {"across [s]", "up [ms]"} <= set(texts(picture))
    assert 'fill="var(--beam)"' in picture or 'stroke="var(--beam)"' in picture
    assert ElementTree.fromstring(picture).get("aria-label") == "so"


def test_chart_picture__numbers_lie_where_the_axes_say():
    x, y = np.array([0.0, 5.0, 10.0]), np.array([0.0, 50.0, 100.0])
    picture = chart(x=x, y=y, top=100.0).picture()
    (path,) = elements(picture, "path")
    places = np.array(re.findall(r"([\d.]+) ([\d.]+)", path.get("d")), dtype=float)
    np.testing.assert_allclose(np.diff(places[:, 0]), 257.0)
    np.testing.assert_allclose(np.diff(places[:, 1]), -121.0)
    labels = {e.text: float(e.get("x")) for e in elements(picture, "text") if e.text}
    assert labels["4"] == pytest.approx(places[0, 0] + 0.4 * 514.0, abs=0.1)


def test_chart__boxes_are_named():
    boxes = np.array([quartiles(X), quartiles(X[:10])])
    made = chart("boxes", np.arange(2.0), boxes, ("all", "3"))
    assert made.figure()["layout"]["xaxis"]["ticktext"] == ["all", "3"]
    assert {"all", "3"} <= set(texts(made.picture()))
    assert len(elements(made.picture(), "rect")) == 2


@pytest.mark.parametrize("axis", ["x", "y"])
def test_chart__a_limit_is_named_and_in_view(axis):
    made = chart(limit=Limit(axis, 40.0, "enough <b>"))
    (shape,) = made.figure()["layout"]["shapes"]
    assert shape[f"{axis}0"] == shape[f"{axis}1"] == 40.0
    assert made.figure()["layout"][f"{axis}axis"]["range"][1] >= 40.0
    assert "enough <b>" in texts(made.picture())
    assert "enough &lt;b&gt;" in made.picture()


def test_chart__two_series_are_told_apart():
    first = Series("line", "first", "$beam", X, X)
    made = Chart("s", "m", (first, Series("line", "second", "$cloud", X, 2 * X)), "two")
    assert made.figure()["layout"]["showlegend"]
    assert {"first", "second"} <= set(texts(made.picture()))


@pytest.mark.parametrize("kind", ["line", "steps", "points", "bars"])
@pytest.mark.parametrize("value", [0.0, 1e-7, 3.0, 1e9])
def test_chart__a_single_number(kind, value):
    made = chart(kind, np.array([value]), np.array([value]), ("a",) if kind == "points" else ())
    assert "nan" not in made.picture()
    low, high = made.figure()["layout"]["xaxis"]["range"]
    assert low < high
