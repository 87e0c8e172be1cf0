"""A figure as it is shown: live where scripts run, else a still picture of the same."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import Any, TypeAlias

__all__ = ["Drawing", "Figure", "element", "svg"]

Figure: TypeAlias = dict[str, Any]
"""A plotly figure: `data`, a list of traces, and `layout`."""


@dataclass(frozen=True)
class Drawing:
    """A figure, its still pictures, and what they show in words.

    Attributes
    ----------
    figure : Figure
    pictures : tuple of str
        SVG. The first stands in the page until the figure is drawn; all are printed.
    description : str
        For those who cannot see it.
    """

    figure: Figure
    pictures: tuple[str, ...]
    description: str


def svg(width: float, height: float, elements: list[str], title: str) -> str:
    """Make a picture that scales to the width it is given.

    Parameters
    ----------
    width, height : float
        Extent of its coordinates; y goes down.
    elements : list of str
        As `element` makes them.
    title : str
        What it shows, for those who cannot see it.

    Returns
    -------
    str
    """
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{escape(title)}">'
        f"{''.join(elements)}</svg>"
    )


def element(name: str, text: str = "", **attributes: Any) -> str:
    """Make an element of a picture.

    Parameters
    ----------
    name : str
    text : str, optional
        Its content; escaped.
    **attributes
        Numbers are rounded to a tenth; ``_`` stands for ``-``. A colour such as ``$beam`` is
        that of the page's theme.

    Returns
    -------
    str
    """
    written = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{_attribute(value)}"'
        for key, value in attributes.items()
    )
    return f"<{name}{written}>{escape(text)}</{name}>" if text else f"<{name}{written}/>"


def _attribute(value: Any) -> str:
    if isinstance(value, str):
        return f"var(--{value[1:]})" if value.startswith("$") else escape(value)
    return f"{value:.1f}".removesuffix(".0")
