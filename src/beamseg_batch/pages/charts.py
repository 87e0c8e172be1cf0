"""Charts with two axes, described once and drawn twice: as a plotly figure and as a picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from beamseg_batch.geometry import FloatArray
from beamseg_batch.pages.drawing import Drawing, Figure, element, svg
from beamseg_batch.pages.figures import axes_layout, typed

__all__ = ["Chart", "Limit", "Series", "envelope", "histogram", "quartiles"]

_WIDTH, _HEIGHT = 600.0, 300.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 74.0, 12.0, 14.0, 44.0
_PICTURE_BUCKETS = 250
_MAX_NAMED = 30  # points with their name beside them


@dataclass(frozen=True, eq=False)
class Series:
    """Numbers that are drawn alike.

    Attributes
    ----------
    kind : {'line', 'steps', 'points', 'bars', 'boxes'}
        steps: a line that keeps its value up to the next point; bars: of equal width, side by
        side; boxes: at 0, 1, ..., each named by its label.
    name : str
    colour : str
    x : (N,) float64
    y : (N,) float64; (N, 5) of boxes
        Of a box the lower whisker, the quartiles, the upper whisker.
    labels : tuple of str
        Names of points or boxes.
    """

    kind: Literal["line", "steps", "points", "bars", "boxes"]
    name: str
    colour: str
    x: FloatArray
    y: FloatArray
    labels: tuple[str, ...] = ()


@dataclass(frozen=True)
class Limit:
    """A value that is marked by a dashed line, across an axis."""

    axis: Literal["x", "y"]
    value: float
    name: str


@dataclass(frozen=True, eq=False)
class Chart:
    """Series over common axes, both of which begin at zero unless x says otherwise.

    Attributes
    ----------
    across, up : str
        Names of the axes, with unit.
    series : tuple of Series
        At least one number in all.
    description : str
        What it shows, for those who cannot see it.
    top : float, optional
        Where the y axis ends; by default above all numbers.
    limit : Limit, optional
    """

    across: str
    up: str
    series: tuple[Series, ...]
    description: str
    top: float | None = None
    limit: Limit | None = None

    @property
    def drawing(self) -> Drawing:
        """Both of its forms."""
        return Drawing(self.figure(), (self.picture(),), self.description)

    @property
    def _named_across(self) -> tuple[str, ...]:
        return next((s.labels for s in self.series if s.kind == "boxes"), ())

    def figure(self) -> Figure:
        """Draw it for plotly."""
        layout = axes_layout(self.across, self.up)
        (low, high), top = self._span(), self._ceiling()
        layout["xaxis"]["range"], layout["yaxis"]["range"] = [low, high], [0.0, top]
        layout["yaxis"]["exponentformat"] = "none"
        if names := self._named_across:
            layout["xaxis"] |= {"tickvals": list(range(len(names))), "ticktext": list(names)}
        if self.limit:
            layout["shapes"] = [_limit_shape(self.limit)]
        if len(self.series) > 1:
            legend = {"orientation": "h", "x": 0, "y": 1, "yanchor": "bottom"}
            layout |= {"showlegend": True, "legend": legend}
        return {"data": [_trace(series) for series in self.series], "layout": layout}

    def picture(self) -> str:
        """Draw it as SVG."""
        (low, high), top = self._span(), self._ceiling()
        plane = _Plane(low, high, top)
        elements = [*self._grid(plane, low, high, top)]
        for series in self.series:
            elements += _PAINTERS[series.kind](series, plane)
        if self.limit:
            elements += _limit_line(self.limit, plane)
        if len(self.series) > 1:
            elements += _legend(self.series)
        return svg(_WIDTH, _HEIGHT, elements, self.description)

    def _span(self) -> tuple[float, float]:
        """Ends of the x axis."""
        if names := self._named_across:
            return -0.6, len(names) - 0.4
        x = np.concatenate([series.x for series in self.series])
        low, high = float(x.min()), float(x.max())
        if any(series.kind == "bars" for series in self.series):
            half = _bar_width(self.series[0].x) / 2.0
            low, high = low - half, high + half
        elif any(series.kind == "points" for series in self.series):
            low, high = 0.0, 1.15 * max(high, 1e-6)
        if self.limit and self.limit.axis == "x":
            high = max(high, self.limit.value * 1.05)
        return (low, high) if high > low else (low - 0.5, high + 0.5)

    def _ceiling(self) -> float:
        """Where the y axis ends."""
        tops = [float(np.max(series.y)) for series in self.series]
        top = self.top or 1.08 * max(tops)
        return top if top > 0.0 else 1.0

    def _grid(self, plane: _Plane, low: float, high: float, top: float) -> list[str]:
        """Lines and numbers of both axes, and their names."""
        elements = []
        for value in _ticks(0.0, top):
            y = plane.y(value)
            line = {"x1": _LEFT, "x2": _WIDTH - _RIGHT, "y1": y, "y2": y}
            elements.append(element("line", stroke="$grid", **line))
            elements.append(_text(_number(value), _LEFT - 6, y + 4, "end"))
        named = self._named_across
        every = max(1, len(named) // 12)
        ticks = range(0, len(named), every) if named else _ticks(low, high)
        for value in ticks:
            name = named[int(value)] if named else _number(value)
            elements.append(_text(name, plane.x(value), _HEIGHT - _BOTTOM + 16, "middle"))
        elements.append(_text(self.across, (_LEFT + _WIDTH - _RIGHT) / 2, _HEIGHT - 8, "middle"))
        turned = f"rotate(-90 14 {_HEIGHT / 2 - 15:g})"
        elements.append(_text(self.up, 14, _HEIGHT / 2 - 15, "middle", transform=turned))
        return elements


def envelope(x: FloatArray, y: FloatArray, buckets: int = 1_500) -> tuple[FloatArray, FloatArray]:
    """Thin a long series so that its line looks the same: lowest and highest of every bucket.

    Parameters
    ----------
    x, y : (N,) float64
    buckets : int, optional
        Of equally many numbers.

    Returns
    -------
    x, y : (M,) float64
        In order; all of them where N is at most twice the buckets.
    """
    if len(y) <= 2 * buckets:
        return x, y
    edges = np.arange(buckets + 1) * len(y) // buckets
    kept = {
        int(place)
        for start, end in pairwise(edges)
        for place in (start + np.argmin(y[start:end]), start + np.argmax(y[start:end]))
    }
    rows = np.array(sorted({0, len(y) - 1} | kept))
    return x[rows], y[rows]


def histogram(values: FloatArray, bins: int = 24) -> tuple[FloatArray, FloatArray]:
    """Count values in bins of equal width from zero on.

    Parameters
    ----------
    values : (N,) float64, not negative
        At least one.
    bins : int, optional

    Returns
    -------
    x : (bins,) float64
        Middles of the bins.
    y : (bins,) float64
    """
    high = float(values.max()) or 1.0
    counts, edges = np.histogram(values, bins=bins, range=(0.0, high))
    return (edges[:-1] + edges[1:]) / 2.0, counts.astype(np.float64)


def quartiles(values: FloatArray) -> FloatArray:
    """Five numbers of a box: whiskers reach as far as 1.5 times the box beyond it.

    Parameters
    ----------
    values : (N,) float64
        At least one.

    Returns
    -------
    (5,) float64
        Lower whisker, the three quartiles, upper whisker.
    """
    lower, middle, upper = np.percentile(values, (25, 50, 75))
    reach = 1.5 * (upper - lower)
    inside = values[(values >= lower - reach) & (values <= upper + reach)]
    return np.array([min(inside.min(), lower), lower, middle, upper, max(inside.max(), upper)])


@dataclass(frozen=True)
class _Plane:
    """Where numbers lie in a picture."""

    low: float
    high: float
    top: float

    def x(self, value: Any) -> Any:
        across = (value - self.low) / (self.high - self.low)
        return _LEFT + across * (_WIDTH - _LEFT - _RIGHT)

    def y(self, value: Any) -> Any:
        height = _HEIGHT - _TOP - _BOTTOM
        return _HEIGHT - _BOTTOM - np.minimum(value / self.top, 1.0) * height


def _trace(series: Series) -> dict[str, Any]:
    common: dict[str, Any] = {"name": series.name, "x": typed(series.x)}
    if series.kind == "boxes":
        return common | _box_trace(series)
    common["y"] = typed(series.y)
    if series.kind == "bars":
        bars = {"type": "bar", "width": _bar_width(series.x), "marker": {"color": series.colour}}
        return common | bars
    if series.kind == "points":
        named = len(series.labels) <= _MAX_NAMED
        return common | {
            "type": "scatter",
            "mode": "markers+text" if named else "markers",
            "text": list(series.labels),
            "textposition": "top center",
            "cliponaxis": False,
            "marker": {"size": 9, "color": series.colour},
        }
    line = {"width": 1.5, "color": series.colour}
    if series.kind == "steps":
        line["shape"] = "hv"
    mode = "lines" if len(series.x) > 1 else "markers"
    return common | {"type": "scatter", "mode": mode, "line": line}


def _box_trace(series: Series) -> dict[str, Any]:
    names = ("lowerfence", "q1", "median", "q3", "upperfence")
    return {
        "type": "box",
        **{name: typed(series.y[:, k]) for k, name in enumerate(names)},
        "marker": {"color": series.colour},
        "line": {"width": 1.5},
    }


def _limit_shape(limit: Limit) -> dict[str, Any]:
    other = "y" if limit.axis == "x" else "x"
    return {
        "type": "line",
        f"{other}ref": "paper",
        f"{other}0": 0,
        f"{other}1": 1,
        f"{limit.axis}0": limit.value,
        f"{limit.axis}1": limit.value,
        "line": {"dash": "dash", "width": 1.5, "color": "$bad"},
        "label": {"text": limit.name, "textposition": "start"},
    }


def _path(x: FloatArray, y: FloatArray) -> str:
    return "M" + "L".join(f"{across:.1f} {up:.1f}" for across, up in zip(x, y, strict=True))


def _paint_line(series: Series, plane: _Plane) -> list[str]:
    x, y = envelope(series.x, series.y, _PICTURE_BUCKETS)
    x, y = plane.x(x), plane.y(y)
    if len(x) == 1:
        return [element("circle", cx=x[0], cy=y[0], r=3, fill=series.colour)]
    if series.kind == "steps":
        x, y = np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]
    return [element("path", d=_path(x, y), fill="none", stroke=series.colour, stroke_width="1.2")]


def _paint_points(series: Series, plane: _Plane) -> list[str]:
    places = list(zip(plane.x(series.x), plane.y(series.y), strict=True))
    elements = [element("circle", cx=x, cy=y, r=4, fill=series.colour) for x, y in places]
    if len(series.labels) <= _MAX_NAMED:
        named = zip(series.labels, places, strict=bool(series.labels))
        elements += [_text(name, x, y - 7, "middle") for name, (x, y) in named]
    return elements


def _paint_bars(series: Series, plane: _Plane) -> list[str]:
    half = _bar_width(series.x) / 2.0
    elements = []
    for middle, count in zip(series.x, series.y, strict=True):
        left, right = plane.x(middle - half), plane.x(middle + half)
        box = {"x": left + 0.5, "width": right - left - 1, "y": plane.y(count)}
        box["height"] = plane.y(0.0) - box["y"]
        elements += [element("rect", **box, fill=series.colour)] if count else []
    return elements


def _paint_boxes(series: Series, plane: _Plane) -> list[str]:
    half = 0.32 * (plane.x(1.0) - plane.x(0.0))
    half = min(half, 30.0)
    style = {"stroke": series.colour, "fill": series.colour}
    elements = []
    for place, five in zip(series.x, series.y, strict=True):
        x, (low, q1, median, q3, high) = plane.x(place), plane.y(five)
        box = {"x": x - half, "width": 2 * half, "y": q3, "height": q1 - q3}
        elements.append(element("line", x1=x, x2=x, y1=low, y2=high, stroke=series.colour))
        elements.append(element("rect", **box, **style, fill_opacity="0.35"))
        line = {"x1": x - half, "x2": x + half, "y1": median, "y2": median}
        elements.append(element("line", **line, stroke=series.colour, stroke_width="2.5"))
    return elements


_PAINTERS = {
    "line": _paint_line,
    "steps": _paint_line,
    "points": _paint_points,
    "bars": _paint_bars,
    "boxes": _paint_boxes,
}


def _limit_line(limit: Limit, plane: _Plane) -> list[str]:
    if limit.axis == "y":
        y = plane.y(limit.value)
        ends, place = {"x1": _LEFT, "x2": _WIDTH - _RIGHT, "y1": y, "y2": y}, (_LEFT + 4, y - 5)
    else:
        x = plane.x(limit.value)
        ends = {"x1": x, "x2": x, "y1": _TOP, "y2": _HEIGHT - _BOTTOM}
        place = (x - 4, _TOP + 10)
    anchor = "start" if limit.axis == "y" else "end"
    return [
        element("line", **ends, stroke="$bad", stroke_dasharray="5 4"),
        _text(limit.name, *place, anchor),
    ]


def _legend(series: Sequence[Series]) -> list[str]:
    elements, x = [], _LEFT + 6
    for one in series:
        elements.append(element("rect", x=x, y=2, width=10, height=10, fill=one.colour))
        elements.append(_text(one.name, x + 14, 11, "start"))
        x += 30.0 + 6.5 * len(one.name)
    return elements


def _text(text: str, x: float, y: float, anchor: str, **more: str) -> str:
    return element("text", text, x=x, y=y, text_anchor=anchor, **more)


def _bar_width(middles: FloatArray) -> float:
    return float(middles[1] - middles[0]) if len(middles) > 1 else 1.0


def _ticks(low: float, high: float) -> FloatArray:
    """Round numbers from low to high, four to nine of them."""
    step = 10.0 ** math.floor(math.log10((high - low) / 4.0))
    step *= next(m for m in (1.0, 2.0, 2.5, 5.0, 10.0) if (high - low) / (m * step) <= 9.0)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    ticks: FloatArray = np.arange(first, last + 1, dtype=np.float64) * step
    return ticks


def _number(value: float) -> str:
    return f"{value + 0.0:.4g}"
