"""A page out of a template, its figures and plotly.js."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from importlib import resources
from typing import Any

from beamseg_batch.pages.figures import Figure

__all__ = ["render_page"]


def render_page(
    template: str,
    figures: Mapping[str, Figure],
    filters: Mapping[str, Callable[..., Any]] | None = None,
    **values: Any,
) -> str:
    """Render a page.

    Parameters
    ----------
    template : str
        Jinja, which extends ``page.html.j2``: blocks `title` and `content`.
    figures : mapping of str to Figure
        Each is drawn in the element of that id; ``structure`` is the one with a scene.
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
    import jinja2
    from plotly.offline import get_plotlyjs

    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_shared_template),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= filters or {}
    return environment.from_string(template).render(
        figures_json=_script_json(figures), plotly_js=get_plotlyjs(), **values
    )


def _shared_template(name: str) -> str:
    return resources.files(__package__).joinpath("templates", name).read_text("utf-8")


def _script_json(tree: Mapping[str, Any]) -> str:
    """JSON that cannot end the script element that holds it."""
    text = json.dumps(tree, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
