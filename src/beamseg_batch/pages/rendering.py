"""A page out of a template, its figures and plotly.js."""

from __future__ import annotations

import base64
import functools
import gzip
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from html import escape
from importlib import resources
from typing import TYPE_CHECKING, Any

from beamseg_batch.pages.drawing import Drawing

if TYPE_CHECKING:
    import jinja2

__all__ = ["Html", "Section", "chip", "render_page", "render_part"]

_COMPRESSION = 4  # a third of a second less than 9, for 4 % more


class Html(str):
    """HTML that a template takes as it is."""

    __slots__ = ()

    def __html__(self) -> str:
        """Give itself, as templates ask for it."""
        return self


@dataclass(frozen=True, eq=False)
class Section:
    """A part of a page that was rendered apart.

    Attributes
    ----------
    name : str
        Its id in the page.
    title : str
    html : Html
    drawings : mapping of str to Drawing
        Those that stand in it, by id.
    """

    name: str
    title: str
    html: Html
    drawings: Mapping[str, Drawing]


def render_page(
    template: str,
    drawings: Mapping[str, Drawing],
    filters: Mapping[str, Callable[..., Any]] | None = None,
    **values: Any,
) -> str:
    """Render a page.

    Parameters
    ----------
    template : str
        Jinja, which extends ``page.html.j2``: blocks `title` and `content`.
    drawings : mapping of str to Drawing
        By id; the macro `figure` puts each into the page.
    filters : mapping of str to callable, optional
        Filters that the template uses.
    **values
        Variables of the template.

    Returns
    -------
    str
        HTML with everything in it, plotly.js included. It requests nothing from anywhere,
        and a content security policy in it forbids to.
    """
    figures = {name: drawing.figure for name, drawing in drawings.items()}
    return (
        _environment(filters)
        .from_string(template)
        .render(
            drawings=drawings,
            figures_json=_script_json(figures),
            packed_plotly=_packed_plotly() if figures else "",
            style=_shared("page.css"),
            script=_shared("page.js"),
            **values,
        )
    )


def render_part(
    template: str,
    drawings: Mapping[str, Drawing],
    filters: Mapping[str, Callable[..., Any]] | None = None,
    **values: Any,
) -> Html:
    """Render a part of a page, as `render_page` renders the whole.

    Parameters
    ----------
    template : str
        Jinja.
    drawings : mapping of str to Drawing
    filters : mapping of str to callable, optional
    **values

    Returns
    -------
    Html
    """
    part = _environment(filters).from_string(template)
    return Html(part.render(drawings=drawings, **values))


def chip(text: str, colour: str) -> Html:
    """Make a word with a dot of a colour of the theme, such as ``$good``, before it.

    Returns
    -------
    Html
    """
    dot = f'<i style="background:var(--{colour.removeprefix("$")})"></i>'
    return Html(f'<span class="chip">{dot}{escape(text)}</span>')


def _environment(filters: Mapping[str, Callable[..., Any]] | None) -> jinja2.Environment:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_shared),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= filters or {}
    return environment


def _shared(name: str) -> str:
    return resources.files(__package__).joinpath("templates", name).read_text("utf-8")


@functools.cache
def _packed_plotly() -> str:
    """Give plotly.js compressed, in base64: a page unpacks it when it is on the screen."""
    from plotly.offline import get_plotlyjs

    packed = gzip.compress(get_plotlyjs().encode(), _COMPRESSION, mtime=0)
    return base64.b64encode(packed).decode("ascii")


def _script_json(tree: Mapping[str, Any]) -> str:
    """JSON that cannot end the script element that holds it."""
    text = json.dumps(tree, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
