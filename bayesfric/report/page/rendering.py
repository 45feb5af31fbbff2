"""Templates, style and script put together into one file that fetches nothing.

With numbers, verdicts and the paper's symbols as a page shows them: never a bare open interval.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections import deque
from collections.abc import Iterator, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment
from markupsafe import Markup, escape

from bayesfric.identifiability.sentences import capital, factor
from bayesfric.report import numbers
from bayesfric.report.comparison.cell import Cell, settled_by
from bayesfric.report.figures.style import mathtext
from bayesfric.report.numbers import HTML, finer
from bayesfric.report.paper.tables import ParameterRow, parameter_table
from bayesfric.report.summary.record import Summary
from bayesfric.report.text_templates import FILTERS
from bayesfric.report.words import clause
from bayesfric.templates import environment

_GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "delta": "δ", "epsilon": "ε", "eta": "η",
    "theta": "θ", "kappa": "κ", "lambda": "λ", "mu": "μ", "nu": "ν", "phi": "φ", "pi": "π",
    "rho": "ρ", "sigma": "σ", "tau": "τ", "chi": "χ", "psi": "ψ", "omega": "ω",
    "Delta": "Δ", "Gamma": "Γ", "Lambda": "Λ", "Omega": "Ω", "Phi": "Φ", "Sigma": "Σ",
    "Theta": "Θ", "dot": "", "cdot": "·", "times": "×",
    "sin": "\u2009sin\u2009", "cos": "\u2009cos\u2009",
}  # fmt: skip
_UPRIGHT = ("mathrm", "text", "mathit", "operatorname")
_TOKEN = re.compile(r"\\([A-Za-z]+|.)|([{}_^])|([^\\{}_^]+)", re.DOTALL)


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
        "cell": cell_html,
        "value_of": value_html,
        "interval_of": interval_html,
        "were_right": were_right_html,
        "verdict_of": verdict_words,
        "kind_of": verdict_kind,
    }
    made.globals |= {"symbol": html_symbol, "number": numbers.HTML.value}
    return made


def html_symbol(symbol: str, name: str) -> Markup:
    """Set a quantity's LaTeX symbol for a page; its name as code where that cannot be.

    Only ``i``, ``sub``, ``sup`` and escaped text, whatever the symbol holds.
    """
    # as figures set it: words in subscripts upright, underscores of names kept
    shown = mathtext(symbol, name) if symbol else ""
    if shown.startswith("$"):
        tokens = deque(_tokens(shown[1:-1]))
        try:
            set_ = _group(tokens, upright=False)
        except (IndexError, KeyError):
            set_ = Markup()
        if set_ and not tokens:
            return Markup('<span class="sym">{}</span>').format(set_)
    return Markup("<code>{}</code>").format(name)


def _tokens(text: str) -> Iterator[str]:
    for command, mark, plain in _TOKEN.findall(text):
        if command:
            yield "\\" + command
        else:
            yield from mark or plain


def _group(tokens: deque[str], *, upright: bool) -> Markup:
    """Set everything up to a closing brace, which is left."""
    parts = Markup()
    while tokens and tokens[0] != "}":
        parts += _one(tokens, upright=upright)
    return Markup(parts.replace("</i><i>", ""))


def _one(tokens: deque[str], *, upright: bool) -> Markup:
    first = tokens.popleft()
    if first in ("_", "^"):
        tag = "sub" if first == "_" else "sup"
        return Markup(f"<{tag}>{{}}</{tag}>").format(_one(tokens, upright=upright))
    if first == "{":
        inner = _group(tokens, upright=upright)
        tokens.popleft()
        return inner
    if first.startswith("\\"):
        command = first[1:]
        if command in _UPRIGHT:
            return _one(tokens, upright=True)
        if command in (",", ";", ":", " ", "!"):
            return Markup("\u2009" if command != "!" else "")
        return escape(command) if len(command) == 1 else escape(_GREEK[command])
    if first == " ":  # of no meaning in LaTeX's mathematics
        return Markup()
    if first.isalpha() and not upright:
        return Markup("<i>{}</i>").format(first)
    return escape("\u2212" if first == "-" else first)


def verdict_words(row: ParameterRow) -> str:
    """Say what determined a number, in words that stand in its line."""
    told, settled = row.row, row.by == "together" and not row.cell.doubted
    if told is None or row.cell.doubted or not (settled or (row.by == "limit" and told.given_by)):
        return row.verdict
    return settled_by(told) + ("" if settled else ", on one side only")


def verdict_kind(row: ParameterRow) -> str:
    """Sort verdicts from ``data`` to ``open``."""
    return "weak" if row.by == "together" else row.by


def value_html(row: ParameterRow) -> Markup:
    """Write a number with its standard deviation, or what may be said of it instead."""
    if row.by == "open":
        words = "not determined" if row.cell.converged else "not converged"
        return Markup('<span class="open">{}</span>').format(words)
    return Markup(row.shown(HTML)[0])


def interval_html(row: ParameterRow) -> Markup:
    """Write an interval; of an open number in words that say so."""
    if not row.cell.converged:
        return Markup('<span class="open">none: the ensembles disagree, or stand still</span>')
    if row.by == "open" and row.row is not None:
        return Markup('<span class="open">prior and bounds leave {} to {}</span>').format(
            *(HTML.number(end, 3) for end in row.row.interval)
        )
    return Markup(row.shown(HTML)[1])


def were_right_html(row: ParameterRow) -> Markup | None:
    """Write the interval that takes the model for right, where that is not the one shown."""
    told = row.row
    if told is None or not told.widened or row.cell.status != "determined":
        return None
    low, high = told.interval
    fine = finer(told.middle, low, high, told.sd)
    return Markup(row.with_doubt(HTML.interval(low, high, fine))) if told.sd else None


def cell_html(cell: Cell | None) -> Markup:
    """Write one cell of a comparison; an open one in words only."""
    if cell is None:
        return Markup('<span class="quiet">–</span>')
    shown = {
        "plain": '{}<sup class="mark">†</sup>',
        "open": '<span class="open">{}</span>',
        "quiet": '<span class="quiet">{}</span>',
    }
    lines = [Markup(shown.get(kind, "{}")).format(text) for kind, text in cell.parts(HTML)]
    return Markup("<br>").join(lines)
