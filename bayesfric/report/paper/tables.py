r"""Tables of a run: parameters and methods, as LaTeX (booktabs, siunitx 3) and CSV.

What the data do not determine has a dash for its value: its interval is that of the prior and the
bounds, and out of the table it would be quoted as a measurement.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

from bayesfric.base import __version__
from bayesfric.report.comparison.comparison import (
    Comparison,
    comparison,
    comparison_dict,
    explained,
)
from bayesfric.report.numbers import LATEX
from bayesfric.report.result_row import GROUPS, ResultRow, table_rows
from bayesfric.report.summary.record import COLUMNS, Readable, Summary
from bayesfric.report.words import csv_text, filled


def parameter_notes(rows: Sequence[ResultRow], summary: Summary) -> tuple[str, ...]:
    """Write the notes below a table of parameters."""
    return tuple(filled("parameter_notes.txt.j2", rows=rows, summary=summary).splitlines())


def parameters_latex(summary: Readable, run: str = "summary.json") -> str:
    r"""Write the table as a ``table*`` for two-column papers.

    It needs the packages array, booktabs, siunitx (version 3) and tabularx.
    """
    read = Summary.read(summary, run)
    rows = table_rows(read)
    lines = [
        (r.group, [
            latex_symbol(r.symbol, r.name), escaped(r.meaning or r.name), *r.texts(LATEX),
            latex_unit(r.unit), r.in_words,
        ])
        for r in rows
    ]  # fmt: skip
    share = rf"\qty{{{100 * read.level:g}}}{{\percent}} interval"
    return _table(
        "Parameters of the joint", "parameters", parameter_notes(rows, read),
        head=["Symbol", "Quantity", "Value", share, "Unit", "Status"], lines=lines,
        columns=r"@{}l>{\raggedright\arraybackslash}Xllll@{}", headings=GROUPS,
    )  # fmt: skip


def methods_latex(compared: Comparison) -> str:
    """Write a comparison of methods, or of runs, as a ``table*``; a number marks each remark."""
    remarks: dict[str, int] = {}
    lines = []
    for row in compared.rows:
        cells = []
        for column in compared.columns:
            cell = row.cells.get(column.label)
            text = (
                ""
                if cell is None
                else cell.texts(LATEX)[0] + r"\textsuperscript{\dag}" * cell.plain
            )
            if cell is not None and cell.remark and cell.status != "unidentified":
                mark = remarks.setdefault(cell.remark, len(remarks) + 1)
                text += rf"\textsuperscript{{{mark}}}"
            cells.append(text)
        name = latex_symbol(row.symbol, row.name)
        lines.append((row.group, [name, latex_unit(row.unit), *cells]))
    notes = [text.rstrip(".") for text in explained(compared)]
    notes += [f"{mark}: {remark}" for remark, mark in remarks.items()]
    several = len({column.run for column in compared.columns} - {""}) > 1
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


def comparison_csv(compared: Comparison) -> str:
    """Write a comparison as CSV, one line for each quantity and column."""
    rows = comparison_dict(compared)["rows"]
    return csv_text(rows, [*rows[0]] if rows else ["name"])


def summary_table(summary: Readable) -> str:
    """Write the parameters and derived quantities of a summary as CSV."""
    return csv_text(Summary.read(summary).lines, COLUMNS)


def text_files(summary: Readable, run: str, *, paper: bool) -> dict[str, str]:
    """Write a run's tables and captions, with ``paper`` also in LaTeX, by file name."""
    from bayesfric.report.figures.registry import captions  # with Matplotlib

    methods, words = comparison({run: summary}), captions(Summary.read(summary))
    texts = {"summary.csv": summary_table(summary), "methods.csv": comparison_csv(methods)}
    texts["text/captions.md"] = "\n".join(f"**{stem}**: {text}\n" for stem, text in words.items())
    if paper:
        texts["text/references.bib"] = references()
        texts["tables/parameters.tex"] = parameters_latex(summary, run)
        texts["tables/estimates.tex"] = methods_latex(methods)
    return texts


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
