"""Templates, style and script put together into one file that fetches nothing."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment
from markupsafe import Markup

from bayesfric.identifiability.sentences import capital, factor
from bayesfric.report import numbers
from bayesfric.report.page import values
from bayesfric.report.page.symbol import html_symbol
from bayesfric.report.paper.tables import counts, parameter_table
from bayesfric.report.summary.record import Summary
from bayesfric.report.text_templates import FILTERS
from bayesfric.report.words import clause
from bayesfric.templates import environment


def render(template: str, *, scripts: Sequence[str] = ("page.js",), **told: Any) -> str:
    """Fill a template of ``templates/``, with ``scripts`` that lie beside it; text is escaped.

    The page's policy forbids every request and every script but its own, which is
    named by its hash: what a file of the run may hold cannot act.
    """
    style, script = _asset("page.css"), "".join(_asset(name) for name in scripts)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = (
        "default-src 'none'; base-uri 'none'; form-action 'none'; img-src data:; "
        f"style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
    )
    fixed = {"style": Markup(style), "script": Markup(script), "policy": policy}
    return _environment().get_template(template).render(**fixed, **told)


def notebook_table(summary: Summary) -> str:
    """Write what a notebook shows of a summary: every number with its verdict."""
    template = _environment().get_template("notebook.html.j2")
    return template.render(summary=summary, table=parameter_table(summary))


@cache
def _asset(name: str) -> str:
    return (files("bayesfric.report.page") / "templates" / name).read_text(encoding="utf-8")


@cache
def _environment() -> Environment:
    made = environment("bayesfric.report.page", escaped=True)
    made.filters |= FILTERS | {
        "spaced": numbers.spaced,
        "unit": numbers.html_unit,
        "interval": numbers.HTML.interval,
        "p": numbers.html_p,
        "sig": numbers.HTML.number,
        "fixed": lambda x, digits=2: numbers.html_number(f"{x:.{digits}f}"),
        "capital": capital,
        "named": clause,
        "factor": factor,
        "cell": values.cell_html,
        "counts": counts,
        "value_of": values.value_html,
        "interval_of": values.interval_html,
        "were_right": values.were_right_html,
        "verdict_of": values.verdict_words,
        "kind_of": values.verdict_kind,
    }
    made.globals |= {"symbol": html_symbol, "number": numbers.HTML.value}
    return made
