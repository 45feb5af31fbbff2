"""``report.html`` of a run, made from what its folder holds and nothing else."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup

from bayesfric.report.alerts import alerts
from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.comparison.table import explained
from bayesfric.report.figures.registry import JudgedRun, read_captions, run_figures
from bayesfric.report.page.facts import Facts, Row, read_facts
from bayesfric.report.page.figures import page_figures
from bayesfric.report.page.first_words import first_words
from bayesfric.report.page.provenance import read_provenance
from bayesfric.report.page.rendering import render
from bayesfric.report.page.values import (
    ends_html,
    interval_html,
    value_html,
    verdict_kind,
    verdict_words,
)
from bayesfric.report.paper.tables import ParameterRow, ParameterTable, parameter_table

_GROUPS = {
    "free": (
        "What the motor feels",
        "Combinations of parameters that no scaling of leg and gearbox changes. These are what "
        "the measurement tells first.",
    ),
    "parameter": ("Parameters", "Each at its element's own input shaft, and the noise."),
    "derived": (
        "Derived quantities",
        "They follow from the parameters; where the scale of leg and gearbox is open, so are they.",
    ),
    "known": ("Taken as known", "Fixed in the configuration; nothing here was estimated."),
}


@dataclass(frozen=True)
class Line:
    """One line of a table of parameters."""

    row: ParameterRow
    value: Markup
    interval: Markup
    verdict: str
    kind: str
    facts: Row | None
    white: Markup | None

    @property
    def narrowing(self) -> float | None:
        """How many times narrower than its prior the posterior is."""
        facts = self.facts
        return facts.prior_sd / facts.sd if facts and facts.prior_sd and facts.sd else None


@dataclass(frozen=True)
class Group:
    """One table of parameters."""

    key: str
    title: str
    words: str
    lines: tuple[Line, ...]

    @property
    def has_prior(self) -> bool:
        """Whether any line has a prior of its own."""
        return any(line.facts is not None and line.facts.prior for line in self.lines)

    @property
    def has_white(self) -> bool:
        """Whether white noise would have given other intervals."""
        return any(line.white is not None for line in self.lines)


def run_page(folder: Path, summary: Mapping[str, Any], name: str) -> str:
    """Write the page of a run.

    Parameters
    ----------
    folder
        A run directory: figures, texts, configuration and the head of ``posterior.nc``
        are read from it; what is missing is left out.
    summary
        What its ``summary.json`` holds.
    name
        What to call the run.

    Returns
    -------
    str
        HTML that fetches nothing.

    Raises
    ------
    BadInput
        Where the summary lacks something.
    """
    config = _text(folder / "config.toml")
    facts = read_facts({"may_be_simulated": _simulated(config)} | dict(summary), name)
    table = parameter_table(summary, name)
    methods = comparison({name: summary})
    judged = JudgedRun(facts, table, methods)
    captions = read_captions(_text(folder / "text" / "captions.md"))
    lines = _lines(table, facts)
    return render(
        "run.html.j2",
        title=name,
        facts=facts,
        alerts=alerts(facts, methods.contested),
        first=first_words(table, facts),
        shown={line.row.name: line for line in lines},
        groups=_groups(lines),
        level=table.level,
        notes=table.notes,
        methods=methods,
        explained=list(explained(methods)),
        figures=page_figures(folder, run_figures().values(), captions, judged),
        provenance=read_provenance(folder),
        config=config,
        methods_text=_text(folder / "text" / "methods.txt").strip(),
    )


def _lines(table: ParameterTable, facts: Facts) -> list[Line]:
    rows = facts.derived | facts.parameters
    return [
        Line(
            row,
            value_html(row),
            interval_html(row),
            verdict_words(row),
            verdict_kind(row),
            rows.get(row.name),
            _white(row, rows.get(row.name)),
        )
        for row in table.rows
    ]


def _white(row: ParameterRow, facts: Row | None) -> Markup | None:
    """Write the interval of white noise, of what is determined."""
    if facts is None or not facts.white_interval or row.cell.status != "determined":
        return None
    sd = facts.white_sd or facts.sd
    low, high = facts.white_interval
    return ends_html(low, high, sd) if sd else None


def _groups(lines: Sequence[Line]) -> list[Group]:
    found = []
    for key, (title, words) in _GROUPS.items():
        if mine := tuple(line for line in lines if line.row.group == key):
            found.append(Group(key, title, words, mine))
    return found


def _text(path: Path) -> str:
    """Read a text that a run may lack."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return ""


def _simulated(config: str) -> bool:
    """Whether the configuration says how to simulate its recordings; for older summaries."""
    try:
        return "simulation" in tomllib.loads(config)
    except tomllib.TOMLDecodeError:
        return False
