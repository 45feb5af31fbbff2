"""Templates, style and script put together into one file that fetches nothing."""

from __future__ import annotations

import base64
import hashlib
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from bayesfric.identifiability.sentences import capital
from bayesfric.report.page.first_words import spaced
from bayesfric.report.page.symbol import html_symbol
from bayesfric.report.page.values import cell_html, number_html, p_html, plain, unit_html
from bayesfric.report.summary.noise import white_words


def render(template: str, **told: Any) -> str:
    """Fill a template.

    The page's policy forbids every request and every script but its own, which is
    named by its hash: what a file of the run may hold cannot act.

    Parameters
    ----------
    template
        File name in ``templates/``.
    told
        What it shows; text is escaped.
    """
    style, script = _asset("page.css"), _asset("page.js")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = (
        "default-src 'none'; base-uri 'none'; form-action 'none'; img-src data:; "
        f"style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
    )
    return (
        _environment()
        .get_template(template)
        .render(style=Markup(style), script=Markup(script), policy=policy, **told)
    )


@cache
def _asset(name: str) -> str:
    return (files("bayesfric.report.page") / "templates" / name).read_text(encoding="utf-8")


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("bayesfric.report.page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "spaced": spaced,
        "unit": unit_html,
        "capital": capital,
        "white_words": white_words,
        "cell": cell_html,
        "p": p_html,
        "sig": lambda x, digits=4: plain(f"{x:.{digits}g}"),
    }
    environment.globals |= {"symbol": html_symbol, "number": number_html}
    return environment
