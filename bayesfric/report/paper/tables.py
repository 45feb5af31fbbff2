r"""Tables of a run: parameters and methods, as LaTeX (booktabs, siunitx 3) and CSV.

What the data do not determine has a dash where its value would stand: its interval is that
of the prior and the bounds, and out of the table it would be quoted as a measurement.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bayesfric.report.comparison.cell import Cell, posterior_cells, settled_by
from bayesfric.report.comparison.comparison import Comparison, comparison, comparison_csv
from bayesfric.report.numbers import LATEX, Medium
from bayesfric.report.paper import latex
from bayesfric.report.summary.conclusions import bound_mend, put_reported
from bayesfric.report.summary.derived_quantities import described_as
from bayesfric.report.summary.record import Readable, Summary, of_noise
from bayesfric.report.summary.rows import PosteriorRow
from bayesfric.report.words import doubt_text, filled

_GROUPS = {
    "free": "Quantities seen at the motor (base parameters)",
    "parameter": "Parameters",
    "derived": "Derived, of the scale of load and gearbox",
    "known": "Taken as known",
}
# By what settles a number, as on the page, in words that a column of a paper has room for.
_VERDICTS = {
    "data": "data",
    "weak": "data and prior",
    "limit": "data, on one side",
    "open": "prior",
    "known": "known",
}
# where a prior on another gives its scale
_GIVEN_LIMIT = "data and prior, on one side"


@dataclass(frozen=True)
class ParameterRow:
    """One line of the table of parameters."""

    group: str  # `free` (of scaling), `parameter`, `derived` or `known`
    # as in `summary.json`
    name: str
    unit: str
    symbol: str  # LaTeX without dollar signs
    meaning: str
    row: PosteriorRow | None  # the numbers; `None` of what was taken as known
    cell: Cell  # what may be said of it, as in the comparison of methods

    @property
    def by(self) -> str:
        """What settles it: ``data``, ``weak`` (and prior), ``limit``, ``open`` or ``known``."""
        if self.row is None:
            return "known"
        if self.cell.status == "determined":
            return "data" if self.row.verdict == "data" else "weak"
        return "limit" if self.cell.status == "limit" else "open"

    @property
    def verdict(self) -> str:
        """What determined it, in words."""
        if not self.cell.converged:
            return "not converged"
        if self.cell.doubted:
            return "doubtful"
        given = self.by == "limit" and self.row is not None and self.row.given_by
        return _GIVEN_LIMIT if given else _VERDICTS[self.by]

    @property
    def in_words(self) -> str:
        """What determined it, in words that there is room for in its line of a page."""
        given = self.by == "limit" and self.row is not None and self.row.given_by
        if self.row is None or self.cell.doubted or not (self.by == "weak" or given):
            return self.verdict
        return settled_by(self.row) + (", on one side only" if given else "")

    @property
    def mend(self) -> str:
        """What to do about a bound that holds it."""
        return bound_mend(self.name, self.row) if self.row and self.cell.converged else ""

    def shown(self, medium: Medium) -> tuple[str, str]:
        """Write value and interval; an open one has neither."""
        if self.by == "open":
            return f"{medium.none} ({self.verdict})", medium.none
        value, interval = self.cell.shown(medium, sds=medium.sds)
        doubt = " (doubtful)" if self.cell.doubted else ""
        return (value + doubt, interval) if interval == medium.none else (value, interval + doubt)


@dataclass(frozen=True)
class ParameterTable:
    """Lines in the order to print them, of a run's ``summary``."""

    rows: tuple[ParameterRow, ...]
    summary: Summary

    def notes(self, *, marked: bool = True) -> tuple[str, ...]:
        """Say what to know besides; ``marked`` is whether open numbers are marked ``(prior)``."""
        text = filled(
            "parameter_notes.txt.j2",
            rows=self.rows,
            summary=self.summary,
            correlated=next(
                (
                    doubt_text(doubt.model_dump())
                    for doubt in self.summary.doubts
                    if doubt.kind == "independent"
                ),
                None,
            ),
            marked=marked,
        )
        return tuple(text.splitlines())

    @property
    def joint(self) -> list[ParameterRow]:
        """Sampled parameters of the joint: without those of the noise."""
        return [r for r in self.rows if r.group == "parameter" and not of_noise(r.name)]


def parameter_table(summary: Readable, run: str = "summary.json") -> ParameterTable:
    """Judge every number of a summary for the table of parameters.

    What no scaling of load and alpha changes comes first, without what is the motion's as much as
    the joint's; ``run`` is what complaints call it.
    """
    read = put_reported(Summary.read(summary, run))
    cells = posterior_cells(read)
    groups = {
        "free": read.felt,
        "parameter": read.parameters,
        "derived": {name: row for name, row in read.derived.items() if not row.gauge_free},
    }
    rows = [
        ParameterRow(group, name, **described_as(row), row=row, cell=cells[name])
        for group, members in groups.items()
        for name, row in members.items()
    ]
    rows += [
        ParameterRow("known", name, **described_as(one), row=None, cell=Cell(one.value, "known"))
        for name, one in read.fixed.items()
    ]
    return ParameterTable(tuple(rows), read)


def parameters_latex(table: ParameterTable) -> str:
    r"""Lay the table out as a ``table*`` for two-column papers.

    It takes the packages array, booktabs, siunitx (version 3) and tabularx.
    """
    lines = []
    for r in table.rows:
        cells = [latex.symbol(r.symbol, r.name), latex.escaped(r.meaning or r.name)]
        cells += [*r.shown(LATEX), latex.unit(r.unit), latex.escaped(r.verdict)]
        lines.append((r.group, cells))
    share = rf"\qty{{{100 * table.summary.level:g}}}{{\percent}}"
    head = ["Symbol", "Quantity", "Value", f"{share} interval", "Unit", "Determined by"]
    columns = r"@{}l>{\raggedright\arraybackslash}Xllll@{}"
    symbols = {r.name: r.symbol for r in table.rows}
    laid = {"columns": columns, "head": head, "lines": lines, "headings": _GROUPS}
    return _table("Parameters of the joint", "parameters", table.notes(), symbols, laid)


def _table(
    caption: str,
    label: str,
    notes: Sequence[str],
    symbols: Mapping[str, str],
    laid: Mapping[str, Any],
) -> str:
    """Lay out a table; notes have ``symbols`` in place of names, as its lines have."""
    below = latex.escaped(". ".join(notes)).replace(r" \%", r"\,\%") + "."
    below = latex.with_symbols(below, symbols)
    return filled("table.tex.j2", caption=caption, label=label, notes=below, **laid) + "\n"


def methods_latex(found: Comparison) -> str:
    """Lay a comparison of methods, or of runs, out as a ``table*``."""
    lines = []
    for row in found.rows:
        name = latex.symbol(row.symbol, row.name)
        name += r"\textsuperscript{m}" if row.of_motion else ""
        cells = [_cell(row.cells.get(column.label)) for column in found.columns]
        lines.append(((row.kind, row.gauge_free), [name, latex.unit(row.unit), *cells]))
    told = [cell for row in found.rows for cell in row.cells.values()]
    notes = filled(
        "methods_notes.txt.j2",
        found=found,
        cells=told,
        skewed=any("^{+" in text for _, texts in lines for text in texts),
    ).splitlines()
    head = ["", "Unit", *(latex.escaped(c.label) for c in found.columns)]
    laid = {"columns": f"@{{}}ll{'l' * len(found.columns)}@{{}}", "head": head, "lines": lines}
    title = "Runs side by side" if found.several else "Estimates by method"
    return _table(title, "runs" if found.several else "methods", notes, {}, laid)


def _cell(cell: Cell | None) -> str:
    if cell is None:
        return ""
    if cell.status == "undetermined":
        return "---" if cell.converged else "n.c."
    shown, _ = cell.shown(LATEX)
    if cell.status == "bound":
        return shown + r"\textsuperscript{b}"
    shown += r"\textsuperscript{d}" if cell.doubted else ""
    shown += "" if cell.alike else r"\textsuperscript{s}"
    return shown + (r"\textsuperscript{\dag}" if cell.plain else "")


def summary_table(summary: Readable) -> str:
    """Lay the parameters and derived quantities of a summary out as CSV text."""
    return str(put_reported(Summary.read(summary)).frame.to_csv(index=False))


def summary_texts(summary: Readable, run: str) -> dict[str, str]:
    """Lay the numbers of a run's summary out as its tables, by file name inside the run directory.

    ``BadInput`` where the summary lacks something.
    """
    return {
        "summary.csv": summary_table(summary),
        "methods.csv": comparison_csv(comparison({run: summary})),
    }


def latex_texts(summary: Readable, run: str) -> dict[str, str]:
    """Give what a paper takes over, by file name inside the run directory: tables, references."""
    table = parameter_table(summary, run)
    return {
        "text/references.bib": latex.references(),
        "tables/parameters.tex": parameters_latex(table),
        "tables/estimates.tex": methods_latex(comparison({run: summary})),
    }
