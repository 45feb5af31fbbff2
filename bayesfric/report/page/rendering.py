"""Templates, style and script put together into one file that fetches nothing.

With numbers, verdicts and the paper's symbols as a page shows them: never a bare open interval; and
drawings as images: whatever its file holds, an image neither acts nor reaches out.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, get_args
from unicodedata import lookup
from urllib.parse import quote

from jinja2 import Environment
from markupsafe import Markup, escape

from bayesfric.base.errors import BadInput
from bayesfric.base.safe_read import read_text
from bayesfric.base.templates import environment
from bayesfric.report import numbers
from bayesfric.report.figures.registry import Declared, Section
from bayesfric.report.figures.style import mathtext
from bayesfric.report.numbers import HTML
from bayesfric.report.words import FILTERS, clause

_SIGNS = {"dot": "", "cdot": "·", "times": "×", "sin": "\u2009sin\u2009", "cos": "\u2009cos\u2009"}
_SPACES = {"!": "", **dict.fromkeys(",;: ", "\u2009")}
_TOKEN = re.compile(
    r"\\(?:mathrm|text|mathit|operatorname)\{((?:[^{}\\]|\\.)*)\}"
    r"|\\([A-Za-z]+|.)|([{}_^])|([^\W\d_])|(.)",
    re.DOTALL,
)
_GROUP = re.compile(r"([_^])(?:\{([^{}]*)\}|(<i>.</i>|&#?\w+;|[^{}]))")
_BARE = re.compile(r"(?<![_^])\{([^{}]*)\}")
_TAGS = {"_": "sub", "^": "sup"}
_SIZE = re.compile(r'<svg\b[^>]*\bviewBox="0 0 ([\d.]+) ([\d.]+)"')
# Coordinates in points: a hundredth is finer than any printer, and halves the page.
_COORDINATES = re.compile(r'\b[dxy]="[^"]*"')
_LONG = re.compile(r"(?<=\.\d\d)\d+")
# Points; wider than a column of a paper, a figure needs a page's width to be read.
_COLUMN = 300.0


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
        "named": clause,
    }
    made.globals |= {"symbol": html_symbol, "number": HTML.value, "HTML": HTML}
    return made


def html_symbol(symbol: str, name: str) -> Markup:
    """Set a quantity's LaTeX symbol for a page; its name as code where that cannot be.

    Only ``i``, ``sub``, ``sup`` and escaped text, whatever the symbol holds.
    """
    # as figures set it: words in subscripts upright, underscores of names kept
    shown = mathtext(symbol, name) if symbol else ""
    try:
        text = _TOKEN.sub(_set, shown[1:-1] if shown.startswith("$") else "")
    except KeyError:  # a sign that no page has
        text = ""
    before = None
    while before != text:  # groups from the innermost out
        before = text
        text = _GROUP.sub(_scripted, text)
        text = _BARE.sub(r"\1", text)
    if not text or re.search(r"[{}_^]", text):
        return Markup("<code>{}</code>").format(name)
    return Markup(f'<span class="sym">{text.replace("</i><i>", "")}</span>')


def _scripted(group: re.Match[str]) -> str:
    mark, inside, single = group.groups(default="")
    return f"<{_TAGS[mark]}>{inside}{single}</{_TAGS[mark]}>"


def _set(token: re.Match[str]) -> str:
    """Set all but marks and braces; those of names are written so that they are none."""
    words, command, mark, letter, other = token.groups(default="")
    if mark or letter:
        return mark or f"<i>{letter}</i>"
    if len(command) > 1:
        return _SIGNS[command] if command in _SIGNS else _greek(command)
    plain = re.sub(r"\\(.)", r"\1", words) + _SPACES.get(command, command)
    plain += {" ": "", "-": "\u2212"}.get(other, other)  # a space means nothing in mathematics
    return re.sub("[{}_^]", lambda m: f"&#{ord(m[0])};", escape(plain))


def _greek(name: str) -> str:
    """Give a letter by its LaTeX command; ``KeyError`` where it is none."""
    case = "CAPITAL" if name[0].isupper() else "SMALL"
    # as Unicode spells it
    return lookup(f"GREEK {case} LETTER {name.upper().replace('LAMBDA', 'LAMDA')}")


@dataclass(frozen=True)
class PageFigure:
    """One figure."""

    stem: str  # its file's name, and its anchor behind `figure-`
    # in words
    title: str
    caption: str
    alt: str  # what it says to who cannot see it
    source: str  # the drawing as a data URL
    # in points
    width: float
    height: float

    @property
    def wide(self) -> bool:
        """Whether it is made for the width of a page."""
        return self.width > _COLUMN


def page_figure(folder: Path, stem: str, title: str, caption: str, alt: str) -> PageFigure:
    """Read one figure of a folder; ``BadInput`` or ``ValueError`` where there is none."""
    text = read_text(folder / "figures" / f"{stem}.svg")
    if (size := _SIZE.search(text)) is None:
        raise ValueError(f"{stem}.svg is no SVG with a view box")
    text = _COORDINATES.sub(lambda found: _LONG.sub("", found[0]), text).replace("\n", " ")
    source = "data:image/svg+xml," + quote(text, safe=" :/;=,().-")
    return PageFigure(stem, title, caption, alt, source, float(size[1]), float(size[2]))


def page_figures(
    folder: Path, figures: Iterable[Declared], captions: Mapping[str, str]
) -> dict[str, list[PageFigure]]:
    """Read the figures that the folder has, by section of the page.

    ``captions``, by stem, come before what a figure declares of itself. What a figure says to who
    cannot see it is its caption: the numbers are in the page's tables.
    """
    sections: dict[str, list[PageFigure]] = {section: [] for section in get_args(Section)}
    for one in figures:
        # not every caption is written down
        caption = captions.get(one.stem, one.caption if isinstance(one.caption, str) else "")
        alt = f"{one.title}. {caption}".strip()
        try:
            sections[one.section].append(page_figure(folder, one.stem, one.title, caption, alt))
        except (BadInput, ValueError):
            continue
    return sections
