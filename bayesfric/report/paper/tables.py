r"""Tables of a run: parameters and methods, as LaTeX (booktabs, siunitx 3) and CSV.

What the data do not determine has a dash for its value: its interval is that of the prior and the
bounds, and out of the table it would be quoted as a measurement.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from itertools import chain
from typing import Any

from bayesfric.base import __version__
from bayesfric.report.comparison.comparison import Comparison, comparison, comparison_csv
from bayesfric.report.numbers import LATEX
from bayesfric.report.result_row import ResultRow, known_row, result_rows
from bayesfric.report.summary.record import Readable, Summary
from bayesfric.report.words import filled

_GROUPS = {
    "free": "Quantities seen at the motor (base parameters)",
    "parameter": "Parameters",
    "derived": "Derived, of the scale of load and gearbox",
    "known": "Taken as known",
}


# Rows by group, in the order to print them.
ParameterTable = Mapping[str, Sequence[ResultRow]]


def parameter_table(summary: Readable, run: str = "summary.json") -> ParameterTable:
    """Judge every number of a summary for the table of parameters.

    What no scaling of load and alpha changes comes first, without what depends on the motion;
    ``run`` names it in messages.
    """
    read = Summary.read(summary, run)
    rows = result_rows(read)
    known = [known_row(name, row.value, row) for name, row in read.fixed.items()]
    return {
        "free": [rows[name] for name in read.gauge_free],
        "parameter": [rows[name] for name in read.parameters],
        "derived": [rows[name] for name, row in read.derived.items() if not row.gauge_free],
        "known": [replace(row, remark="") for row in known],
    }


def parameter_notes(
    table: ParameterTable, summary: Summary, *, marked: bool = True
) -> tuple[str, ...]:
    """Write the notes below; ``marked`` is whether open numbers are marked ``(prior)``."""
    rows = [*chain.from_iterable(table.values())]
    text = filled("parameter_notes.txt.j2", rows=rows, summary=summary, marked=marked)
    return tuple(text.splitlines())


def parameters_latex(summary: Readable, run: str = "summary.json") -> str:
    r"""Write the table as a ``table*`` for two-column papers.

    It needs the packages array, booktabs, siunitx (version 3) and tabularx.
    """
    read = Summary.read(summary, run)
    table = parameter_table(read)
    lines = [
        (group, [
            latex_symbol(r.symbol, r.name), escaped(r.meaning or r.name), *r.shown(LATEX),
            latex_unit(r.unit), escaped(r.verdict),
        ])
        for group, rows in table.items()
        for r in rows
    ]  # fmt: skip
    share = rf"\qty{{{100 * read.level:g}}}{{\percent}} interval"
    head = ["Symbol", "Quantity", "Value", share, "Unit", "Determined by"]
    return _table(
        "Parameters of the joint", "parameters", parameter_notes(table, read),
        head=head, lines=lines,
        columns=r"@{}l>{\raggedright\arraybackslash}Xllll@{}", headings=_GROUPS,
    )  # fmt: skip


def methods_latex(compared: Comparison) -> str:
    """Write a comparison of methods, or of runs, as a ``table*``."""
    lines = []
    for row in compared.rows:
        name = latex_symbol(row.symbol, row.name)
        name += r"\textsuperscript{m}" if row.of_motion else ""
        cells = [_cell(row.cells.get(column.label)) for column in compared.columns]
        lines.append(((row.kind, row.gauge_free), [name, latex_unit(row.unit), *cells]))
    notes = filled(
        "methods_notes.txt.j2",
        compared=compared,
        cells=[cell for row in compared.rows for cell in row.cells.values()],
        skewed=any("^{+" in text for _, texts in lines for text in texts),
    ).splitlines()
    several = compared.several
    return _table(
        "Runs side by side" if several else "Estimates by method",
        "runs" if several else "methods",
        notes,
        head=["", "Unit", *(escaped(column.label) for column in compared.columns)],
        lines=lines,
        columns=f"@{{}}ll{'l' * len(compared.columns)}@{{}}",
    )


def _table(caption: str, label: str, notes: Sequence[str], **layout: Any) -> str:
    """Fill the template of tables."""
    below = escaped(". ".join(notes)).replace(r" \%", r"\,\%") + "."
    return filled("table.tex.j2", caption=caption, label=label, notes=below, **layout) + "\n"


def _cell(cell: ResultRow | None) -> str:
    if cell is None:
        return ""
    if cell.status == "undetermined":
        return "---" if cell.converged else "n.c."
    marks = {"b": cell.status == "bound", "d": cell.doubted, "s": not cell.alike}
    marks[r"\dag"] = cell.plain
    shown, _ = cell.texts(LATEX)
    return shown + "".join(rf"\textsuperscript{{{mark}}}" for mark, on in marks.items() if on)


def summary_table(summary: Readable) -> str:
    """Write the parameters and derived quantities of a summary as CSV."""
    return str(Summary.read(summary).frame.to_csv(index=False))


def summary_texts(summary: Readable, run: str) -> dict[str, str]:
    """Write the tables of a run's summary, by file name inside the run directory."""
    methods = comparison_csv(comparison({run: summary}))
    return {"summary.csv": summary_table(summary), "methods.csv": methods}


def latex_texts(summary: Readable, run: str) -> dict[str, str]:
    """Write tables and references for a paper, by file name inside the run directory."""
    return {
        "text/references.bib": references(),
        "tables/parameters.tex": parameters_latex(summary, run),
        "tables/estimates.tex": methods_latex(comparison({run: summary})),
    }


# -- LaTeX with siunitx

_LATEX = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#",
    "%": r"\%", "_": r"\_", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}",
    "²": r"\textsuperscript{2}", "³": r"\textsuperscript{3}", "µ": r"\textmu{}", "μ": r"\textmu{}",
    "°": r"\textdegree{}", "–": "--", "…": r"\dots{}", "†": r"\dag{}",
    "−": r"\ensuremath{-}", "×": r"\ensuremath{\times}", "·": r"\ensuremath{\cdot}",
    "±": r"\ensuremath{\pm}", "≤": r"\ensuremath{\leq}", "≥": r"\ensuremath{\geq}",
    # the standard fonts have other signs in their places
    "<": r"\ensuremath{<}", ">": r"\ensuremath{>}", "|": r"\textbar{}",
}  # fmt: skip


def escaped(text: str) -> str:
    """Write plain text so that LaTeX prints it as it is; ``?`` for what pdflatex cannot print."""

    def printable(character: str) -> str:
        # letters of western and central Europe, such as in a recording's name, pdflatex knows
        if character < "\u017f" and (character.isascii() or character.isalpha()):
            return _LATEX.get(character, character)
        plain = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
        return _LATEX.get(character) or "".join(_LATEX.get(c, c) for c in plain) or "?"

    return "".join(map(printable, text))


def references() -> str:
    """Give the BibTeX entries of the methods and of this package."""
    text = (files("bayesfric.report.paper") / "references.bib").read_text(encoding="utf-8")
    return text.replace("VERSION", __version__)


def latex_symbol(latex: str, name: str) -> str:
    """Write a quantity's symbol, or its name in typewriter."""
    from bayesfric.report.figures.style import mathtext  # with Matplotlib

    shown = mathtext(latex, name)
    return shown if shown.startswith("$") else rf"\texttt{{{escaped(name)}}}"


def latex_unit(text: str) -> str:
    """Write a unit such as ``kg m²`` or ``N s/m`` for siunitx; ``1`` where there is none."""
    if not text:
        return "1"
    return rf"\unit{{{re.sub(' +', '.', text.strip()).replace('²', '^2')}}}"
