r"""Tables of a run: parameters and methods, as LaTeX (booktabs, siunitx 3) and CSV.

What the data do not determine has a dash for its value: its interval is that of the prior and the
bounds, and out of the table it would be quoted as a measurement.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from bayesfric.report.comparison.comparison import Comparison, comparison, comparison_csv
from bayesfric.report.numbers import LATEX
from bayesfric.report.paper import latex
from bayesfric.report.result_row import ResultRow, known_row, result_rows
from bayesfric.report.summary.record import Readable, Summary, of_noise
from bayesfric.report.words import filled

_GROUPS = {
    "free": "Quantities seen at the motor (base parameters)",
    "parameter": "Parameters",
    "derived": "Derived, of the scale of load and gearbox",
    "known": "Taken as known",
}


@dataclass(frozen=True)
class ParameterTable:
    """Rows by group, in the order to print them, of a run's ``summary``."""

    groups: Mapping[str, Sequence[ResultRow]]
    summary: Summary

    @property
    def rows(self) -> list[ResultRow]:
        """The rows of all groups."""
        return [row for rows in self.groups.values() for row in rows]

    @property
    def joint(self) -> list[ResultRow]:
        """Sampled parameters of the joint: without those of the noise."""
        return [row for row in self.groups["parameter"] if not of_noise(row.name)]

    def notes(self, *, marked: bool = True) -> tuple[str, ...]:
        """Write the notes below; ``marked`` is whether open numbers are marked ``(prior)``."""
        doubts = self.summary.doubts
        correlated = [doubt.text for doubt in doubts if doubt.kind == "independent"]
        return tuple(
            filled(
                "parameter_notes.txt.j2",
                rows=self.rows,
                summary=self.summary,
                correlated=correlated,
                marked=marked,
            ).splitlines()
        )


def parameter_table(summary: Readable, run: str = "summary.json") -> ParameterTable:
    """Judge every number of a summary for the table of parameters.

    What no scaling of load and alpha changes comes first, without what depends on the motion;
    ``run`` names it in messages.
    """
    read = Summary.read(summary, run)
    rows = result_rows(read)
    derived = [name for name, row in read.derived.items() if not row.gauge_free]
    known = [known_row(name, row.value, row) for name, row in read.fixed.items()]
    groups = {
        "free": [rows[name] for name in read.gauge_free],
        "parameter": [rows[name] for name in read.parameters],
        "derived": [rows[name] for name in derived],
        "known": [replace(row, remark="") for row in known],
    }
    return ParameterTable(groups, read)


def parameters_latex(table: ParameterTable) -> str:
    r"""Write the table as a ``table*`` for two-column papers.

    It needs the packages array, booktabs, siunitx (version 3) and tabularx.
    """
    lines = []
    for group, rows in table.groups.items():
        for r in rows:
            cells = [latex.symbol(r.symbol, r.name), latex.escaped(r.meaning or r.name)]
            cells += [*r.shown(LATEX), latex.unit(r.unit), latex.escaped(r.verdict)]
            lines.append((group, cells))
    share = rf"\qty{{{100 * table.summary.level:g}}}{{\percent}}"
    head = ["Symbol", "Quantity", "Value", f"{share} interval", "Unit", "Determined by"]
    columns = r"@{}l>{\raggedright\arraybackslash}Xllll@{}"
    layout = {"columns": columns, "head": head, "lines": lines, "headings": _GROUPS}
    return _table("Parameters of the joint", "parameters", table.notes(), layout)


def _table(
    caption: str,
    label: str,
    notes: Sequence[str],
    layout: Mapping[str, Any],
) -> str:
    """Fill the template of tables."""
    below = latex.escaped(". ".join(notes)).replace(r" \%", r"\,\%") + "."
    return filled("table.tex.j2", caption=caption, label=label, notes=below, **layout) + "\n"


def methods_latex(compared: Comparison) -> str:
    """Write a comparison of methods, or of runs, as a ``table*``."""
    lines = []
    for row in compared.rows:
        name = latex.symbol(row.symbol, row.name)
        name += r"\textsuperscript{m}" if row.of_motion else ""
        cells = [_cell(row.cells.get(column.label)) for column in compared.columns]
        lines.append(((row.kind, row.gauge_free), [name, latex.unit(row.unit), *cells]))
    notes = filled(
        "methods_notes.txt.j2",
        compared=compared,
        cells=[cell for row in compared.rows for cell in row.cells.values()],
        skewed=any("^{+" in text for _, texts in lines for text in texts),
    ).splitlines()
    head = ["", "Unit", *(latex.escaped(c.label) for c in compared.columns)]
    columns = f"@{{}}ll{'l' * len(compared.columns)}@{{}}"
    title = "Runs side by side" if compared.several else "Estimates by method"
    label = "runs" if compared.several else "methods"
    return _table(title, label, notes, {"columns": columns, "head": head, "lines": lines})


def _cell(cell: ResultRow | None) -> str:
    if cell is None:
        return ""
    if cell.status == "undetermined":
        return "---" if cell.converged else "n.c."
    shown, _ = cell.texts(LATEX)
    if cell.status == "bound":
        return shown + r"\textsuperscript{b}"
    shown += r"\textsuperscript{d}" if cell.doubted else ""
    shown += "" if cell.alike else r"\textsuperscript{s}"
    return shown + (r"\textsuperscript{\dag}" if cell.plain else "")


def summary_table(summary: Readable) -> str:
    """Write the parameters and derived quantities of a summary as CSV."""
    return str(Summary.read(summary).frame.to_csv(index=False))


def summary_texts(summary: Readable, run: str) -> dict[str, str]:
    """Write the tables of a run's summary, by file name inside the run directory."""
    methods = comparison_csv(comparison({run: summary}))
    return {"summary.csv": summary_table(summary), "methods.csv": methods}


def latex_texts(summary: Readable, run: str) -> dict[str, str]:
    """Write tables and references for a paper, by file name inside the run directory."""
    table = parameter_table(summary, run)
    return {
        "text/references.bib": latex.references(),
        "tables/parameters.tex": parameters_latex(table),
        "tables/estimates.tex": methods_latex(comparison({run: summary})),
    }
