"""Render pages: templates, style, script and figures in one file that fetches nothing.

Figures are images, which can neither act nor request anything.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from html import unescape
from importlib.resources import files
from pathlib import Path
from typing import Any, get_args
from urllib.parse import quote

from jinja2 import Environment
from markupsafe import Markup, escape

from bayesfric.base.errors import BadInput
from bayesfric.base.safe_read import read_text
from bayesfric.base.templates import environment
from bayesfric.report.figures.registry import Declared, Section
from bayesfric.report.figures.style import mathtext
from bayesfric.report.numbers import HTML
from bayesfric.report.words import FILTERS, clause


def render(template: str, **values: Any) -> str:
    """Fill a template of ``templates/``; text is escaped.

    The page's policy forbids every request and every script but its own, named by its hash.
    """
    style, script = _asset("page.css"), _asset("page.js")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = (
        "default-src 'none'; base-uri 'none'; form-action 'none'; img-src data:; "
        f"style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
    )
    fixed = {"style": Markup(style), "script": Markup(script), "policy": policy}
    return _environment().get_template(template).render(**fixed, **values)


@cache
def _asset(name: str) -> str:
    return (files("bayesfric.report.page") / "templates" / name).read_text(encoding="utf-8")


@cache
def _environment() -> Environment:
    templates = environment("bayesfric.report.page", escaped=True)
    templates.filters |= FILTERS | {
        # a whole number with narrow spaces between thousands
        "spaced": lambda x: f"{x:,.0f}".replace(",", "\u202f"),
        # on one line; a dash where there is none
        "unit": lambda unit: unit.replace(" ", "\u00a0") or "–",
        "interval": HTML.interval,
        "p": lambda p: Markup("= {}").format(HTML.number(p, 2)) if p else "< 1e-300",
        "sig": HTML.number,
        "fixed": lambda x, digits=2: f"{x:.{digits}f}".replace("-", "\u2212"),
        "named": clause,
    }
    templates.globals |= {"symbol": html_symbol, "number": HTML.value, "HTML": HTML}
    return templates


def html_symbol(symbol: str, name: str) -> Markup:
    """Write a quantity's LaTeX symbol as HTML; its name as code where that cannot be."""
    # as figures set it, which marks words and escapes underscores of names
    shown = mathtext(symbol, name)
    text = re.sub(r"\\mathrm\{([^{}]*)\}|\\dot|\\,", r"\1", shown.strip("$")).replace(r"\_", "_")
    # LaTeX and HTML have the same names for Greek letters
    text = unescape(re.sub(r"\\([A-Za-z]+) ?", r"&\1;", text))
    html = str(escape(text))
    for sign, tag in (("_", "sub"), ("^", "sup")):
        html = re.sub(rf"\{sign}(?:\{{([^{{}}]*)\}}|(\w))", rf"<{tag}>\1\2</{tag}>", html)
    if not shown.startswith("$") or set(text) & set("\\&") or set(html) & set("{}"):
        return Markup("<code>{}</code>").format(name)
    return Markup(f'<span class="sym">{html}</span>')


@dataclass(frozen=True)
class PageFigure:
    """One figure: its file's stem, its words, and the drawing as a data URL, sizes in points."""

    stem: str
    title: str
    caption: str
    alt: str  # text for who cannot see it
    source: str
    width: float
    height: float

    @property
    def wide(self) -> bool:
        """Whether it needs a page's width, being wider than a column of a paper."""
        return self.width > 300.0


def page_figure(folder: Path, stem: str, title: str, caption: str, alt: str = "") -> PageFigure:
    """Read one figure of a folder; ``BadInput`` or ``ValueError`` where there is none.

    The text for who cannot see it is its caption by default: the numbers are in the page's tables.
    """
    text = read_text(folder / "figures" / f"{stem}.svg")
    if (size := re.search(r'<svg\b[^>]*\bviewBox="0 0 ([\d.]+) ([\d.]+)"', text)) is None:
        raise ValueError(f"{stem}.svg is no SVG with a view box")
    # coordinates in points: a hundredth is finer than any printer, and halves the page
    text = re.sub(
        r'\b[dxy]="[^"]*"', lambda match: re.sub(r"(?<=\.\d\d)\d+", "", match[0]), text
    ).replace("\n", " ")
    source = "data:image/svg+xml," + quote(text, safe=" :/;=,().-")
    alt = alt or f"{title}. {caption}".strip()
    return PageFigure(stem, title, caption, alt, source, float(size[1]), float(size[2]))


def page_figures(
    folder: Path, figures: Iterable[Declared], captions: Mapping[str, str]
) -> dict[str, list[PageFigure]]:
    """Read the figures that the folder has, by section; ``captions`` replace those declared."""
    sections: dict[str, list[PageFigure]] = {section: [] for section in get_args(Section)}
    for declared in figures:
        caption = declared.caption if isinstance(declared.caption, str) else ""
        caption = captions.get(declared.stem, caption)
        with suppress(BadInput, ValueError):
            figure = page_figure(folder, declared.stem, declared.title, caption)
            sections[declared.section].append(figure)
    return sections
