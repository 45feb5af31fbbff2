"""``report.html`` of a run or of several, from their folders alone.

A page is one file that fetches nothing: templates, style, script, and figures as images, which can
neither act nor request anything.
"""

from __future__ import annotations

import base64
import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from html import unescape
from importlib.resources import files
from itertools import combinations
from pathlib import Path
from typing import Any
from urllib.parse import quote

from jinja2 import Environment
from markupsafe import Markup, escape

from bayesfric.base.errors import BadInput
from bayesfric.base.safe_read import open_hdf5, parse_json, read_text
from bayesfric.base.templates import environment
from bayesfric.recordings.checks import too_slow
from bayesfric.report.comparison.comparison import Comparison, comparison, explained
from bayesfric.report.figures.registry import FOREST, ROLL_OUT, RUN_FIGURES, captions
from bayesfric.report.figures.style import mathtext
from bayesfric.report.numbers import HTML
from bayesfric.report.paper.tables import parameter_notes
from bayesfric.report.result_row import GROUPS, table_rows
from bayesfric.report.summary.parts import friction_cells
from bayesfric.report.summary.record import Readable, Summary, of_noise
from bayesfric.report.terminal import brief, messages_of
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
    source: str
    width: float
    height: float

    @property
    def wide(self) -> bool:
        """Whether it needs a page's width, being wider than a column of a paper."""
        return self.width > 300.0


def page_figure(folder: Path, stem: str, title: str, caption: str) -> PageFigure:
    """Read one figure of a folder; ``BadInput`` or ``ValueError`` where there is none."""
    text = read_text(folder / "figures" / f"{stem}.svg")
    if (size := re.search(r'<svg\b[^>]*\bviewBox="0 0 ([\d.]+) ([\d.]+)"', text)) is None:
        raise ValueError(f"{stem}.svg is no SVG with a view box")
    # coordinates in points: a hundredth is finer than any printer, and halves the page
    text = re.sub(
        r'\b[dxy]="[^"]*"', lambda match: re.sub(r"(?<=\.\d\d)\d+", "", match[0]), text
    ).replace("\n", " ")
    source = "data:image/svg+xml," + quote(text, safe=" :/;=,().-")
    return PageFigure(stem, title, caption, source, float(size[1]), float(size[2]))


def page_figures(
    folder: Path, words: Mapping[str, str] | None = None
) -> dict[str, list[PageFigure]]:
    """Read the figures that the folder has, by section; ``words`` are captions of a run's."""
    sections: dict[str, list[PageFigure]] = {}
    for declared in (*RUN_FIGURES.values(), ROLL_OUT, FOREST):
        figures = sections.setdefault(declared.section, [])
        caption = (words or {}).get(declared.stem, declared.caption)
        with suppress(BadInput, ValueError):
            figures.append(page_figure(folder, declared.stem, declared.title, caption))
    return sections


def run_page(folder: Path, summary: Readable, name: str) -> str:
    """Write the page of a run: HTML that fetches nothing.

    Figures, texts, configuration and the head of ``posterior.nc`` are read from the run directory
    ``folder``; what is missing is left out.
    """
    read = Summary.read(summary, name)
    rows = table_rows(read, name)
    methods = comparison({name: read})
    messages = messages_of(read, methods.contested)
    return render(
        "run.html.j2",
        title=name,
        summary=read,
        messages=messages,
        too_slow=too_slow(),
        brief=brief(read, messages),
        rows=rows,
        groups=GROUPS,
        noise=[row.name for row in rows if of_noise(row.name)],
        notes=parameter_notes(rows, read),
        methods=methods,
        friction=list(friction_cells(read.friction, HTML)),
        explained=list(explained(methods)),
        figures=page_figures(folder, captions(read)),
        provenance=read_provenance(folder),
        config=_text(folder / "config.toml"),
    )


def _text(path: Path) -> str:
    """Read a text that a run may lack."""
    try:
        return read_text(path)
    except BadInput:
        return ""


# What is needed to repeat a run: `versions` of Python and the libraries, SHA-256 of `recordings`
# and the seconds that were fitted of each (`spans`) by name, and the `seed` as text.
Provenance = dict[str, Any]


def read_provenance(run: Path) -> Provenance | None:
    """Read the root attributes of a run's ``posterior.nc``, and no draws; ``None`` without them."""
    try:
        with open_hdf5(run / "posterior.nc") as file:
            tables = ("versions", "recordings", "spans")
            attributes = {key: dict(parse_json(key, file.attrs[key])) for key in tables}
            return {**attributes, "seed": str(file.attrs["seed"])}
    except (BadInput, ValueError, TypeError):
        return None


def shared_recordings(provenance: Mapping[str, Provenance | None]) -> list[tuple[str, str]]:
    """Name the pairs of runs that fitted the same seconds of a recording, by SHA-256."""
    parts = [
        (run, sha256, *of["spans"].get(name, [-math.inf, math.inf]))
        for run, of in provenance.items()
        if of
        for name, sha256 in of["recordings"].items()
        if sha256
    ]
    pairs = {
        (run, other): None
        for (run, sha256, start, stop), (other, theirs, first, last) in combinations(parts, 2)
        if run != other and sha256 == theirs and max(start, first) <= min(stop, last)
    }
    return [*pairs]


def compare_page(
    folder: Path,
    compared: Comparison,
    runs: Mapping[str, Summary],
    pooled: Sequence[Mapping[str, Any]],
    provenance: Mapping[str, Provenance | None],
) -> str:
    """Write the page of a comparison; a figure that ``folder`` lacks is left out."""
    return render(
        "compare.html.j2",
        title=" and ".join(runs) if len(runs) < 3 else f"{len(runs)} runs",
        runs=runs,
        pooled=pooled,
        same=shared_recordings(provenance),
        provenance=provenance,
        methods=compared,
        explained=list(explained(compared)),
        figures=page_figures(folder),
        version=next(iter(runs.values())).bayesfric,
    )
