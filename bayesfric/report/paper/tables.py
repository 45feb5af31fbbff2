r"""Tables for papers: parameters and methods, as LaTeX (booktabs, siunitx 3), Markdown and CSV.

What the data do not determine has a dash where its value would stand: its interval is that
of the prior and the bounds, and out of the table it would be quoted as a measurement.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bayesfric.report.comparison.cell import Cell, posterior_cell
from bayesfric.report.comparison.comparison import Comparison
from bayesfric.report.comparison.table import number as plain_number
from bayesfric.report.paper import latex
from bayesfric.report.summary.bounds import bound_mend
from bayesfric.report.summary.read_back import PosteriorRow, RunSummary, read_summary

# Ends of the interval whose distances from the median differ by more than this are skewed.
_SKEWED = 0.2
_GROUPS = {
    "free": "What the motor feels, whatever the scale of leg and gearbox",
    "parameter": "Parameters",
    "derived": "Derived, of the scale of leg and gearbox",
    "known": "Taken as known",
}
_VERDICTS = {"data": "data", "weak": "data and prior", "prior": "prior"}
COLUMNS = (
    "group", "name", "symbol", "meaning", "unit", "status", "verdict",
    "median", "mean", "sd", "low", "high", "level", "limit", "remark",
)  # fmt: skip


@dataclass(frozen=True)
class ParameterRow:
    """One line of the table of parameters.

    Attributes
    ----------
    group
        ``free`` (of scaling), ``parameter``, ``derived`` or ``known``.
    name, symbol, meaning, unit
        As in ``summary.json``.
    row
        The numbers; ``None`` of what was taken as known.
    cell
        What may be said of them, as in the comparison of methods.
    """

    group: str
    name: str
    symbol: str
    meaning: str
    unit: str
    row: PosteriorRow | None
    cell: Cell

    @property
    def skewed(self) -> bool:
        """Whether one sd would misname the interval's two sides."""
        if self.row is None or self.row.median is None:
            return False
        low, high = self.row.interval
        down, up = self.row.median - low, high - self.row.median
        return abs(up - down) > _SKEWED * (up + down)

    @property
    def verdict(self) -> str:
        """What determined it, in words."""
        if not self.cell.converged:
            return "not converged"
        return _VERDICTS[self.row.verdict] if self.row is not None else "known"

    @property
    def mend(self) -> str:
        """What to do about a bound that holds it."""
        return bound_mend(self.name, self.row) if self.row and self.cell.converged else ""


@dataclass(frozen=True)
class Counts:
    """How many of some numbers are determined, and by what.

    ``data``: by the data; ``together``: by data, prior and bounds; ``limits``: by the data,
    on one side; ``open``: not by the data.
    """

    data: int
    together: int
    limits: int
    open: int


@dataclass(frozen=True)
class ParameterTable:
    """Lines in the order to print them, and what to know besides."""

    rows: tuple[ParameterRow, ...]
    level: float
    notes: tuple[str, ...]

    @property
    def joint(self) -> list[ParameterRow]:
        """Sampled parameters of the joint: without those of the noise."""
        return [
            row
            for row in self.rows
            if row.group == "parameter" and not row.name.startswith("noise.")
        ]


def parameter_table(summary: Mapping[str, Any], run: str = "summary.json") -> ParameterTable:
    """Judge every number of a summary for the table of parameters.

    Parameters
    ----------
    summary
        What ``summary.json`` holds.
    run
        What to call it in complaints.

    Returns
    -------
    ParameterTable
        What no scaling of leg and alpha changes comes first.

    Raises
    ------
    BadInput
        Where the summary lacks something.
    """
    read = read_summary(summary, run)
    derived = [(name, row) for name, row in read.derived.items()]
    groups: list[tuple[str, list[tuple[str, PosteriorRow]]]] = [
        ("free", [(name, row) for name, row in derived if row.gauge_free]),
        ("parameter", list(read.parameters.items())),
        ("derived", [(name, row) for name, row in derived if not row.gauge_free]),
    ]
    rows = [
        ParameterRow(
            group,
            name,
            row.symbol,
            row.meaning,
            row.unit,
            row,
            posterior_cell(row, read.accounts, read.sampler.status),
        )
        for group, members in groups
        for name, row in members
    ]
    rows += [
        ParameterRow("known", name, "", "", known.unit, None, Cell(known.value, "known"))
        for name, known in read.fixed.items()
    ]
    levels = {row.level for _, members in groups for _, row in members}
    level = levels.pop() if levels else 0.9
    return ParameterTable(
        tuple(rows), level, tuple(_notes(rows, read, level, list(summary.get("warnings", ()))))
    )


def counts(rows: Sequence[ParameterRow]) -> Counts:
    """Count what is determined, and by what."""
    status = [r.cell.status for r in rows]
    data = sum(
        r.cell.status == "determined" and r.row is not None and r.row.verdict == "data"
        for r in rows
    )
    return Counts(
        data,
        status.count("determined") - data,
        status.count("limit"),
        status.count("undetermined"),
    )


def _notes(
    rows: list[ParameterRow], read: RunSummary, level: float, warnings: list[str]
) -> Iterator[str]:
    share = f"{100 * level:g} %"
    yield f"Values are medians with one standard deviation; intervals hold {share} of the posterior"
    if any(row.skewed and row.cell.status == "determined" for row in rows):
        yield (
            "Skewed posteriors have no standard deviation: their distances to the ends of the "
            "interval are given, or the interval alone"
        )
    if any(row.cell.status == "undetermined" and row.cell.converged for row in rows):
        yield "(prior): not determined by the data; the posterior is that of prior and bounds"
    if any(row.cell.status == "limit" for row in rows):
        side = f"{100 * (1.0 + level) / 2:g} %"
        yield f"Limits have {side} of the posterior between them and the bound the data push to"
    for text in warnings:
        # of noise that is not what the likelihood takes it for
        if "taken for independent" in text:
            yield text[0].upper() + text[1:]
    if read.sampler.status == "unusable" or read.sampler.problems:
        yield f"The sampling is {read.sampler.status}: it has not converged"


def parameters_csv(table: ParameterTable) -> str:
    """Lay the table out as CSV, every number in full; nothing in it where it is open."""
    out = io.StringIO()
    writer = csv.DictWriter(out, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for r in table.rows:
        told: dict[str, Any] = dict.fromkeys(COLUMNS)
        told |= {"group": r.group, "name": r.name, "symbol": r.symbol, "meaning": r.meaning}
        told |= {"unit": r.unit, "status": r.cell.status, "verdict": r.verdict}
        told["remark"] = "; ".join(text for text in (r.cell.remark, r.mend) if text)
        if r.row is None:
            told["median"] = r.cell.value
        elif r.cell.status == "limit":
            # one tail of the interval is on the bound's side
            told |= {"limit": r.cell.limit, "level": (1.0 + r.row.level) / 2.0}
        elif r.cell.status == "determined":
            low, high = r.row.interval
            told |= {"median": r.row.median, "mean": r.row.mean, "sd": r.row.sd}
            told |= {"low": low, "high": high, "level": r.row.level}
        writer.writerow(told)
    return out.getvalue()


def parameters_markdown(table: ParameterTable) -> str:
    """Lay the table out in Markdown."""
    head = ["quantity", "meaning", "value", f"{100 * table.level:g} % interval", "unit"]
    lines = [_piped([*head, "determined by"]), _piped(["---", "---", *["---:"] * 2, "---", "---"])]
    for r in table.rows:
        value, ends = _plain(r)
        cells = [f"`{r.name}`", r.meaning or "–", value, ends, r.unit or "–", r.verdict]
        lines.append(_piped([cell.replace("|", r"\|") for cell in cells]))
    return "\n".join([*lines, "", *(f"- {note}." for note in table.notes)]) + "\n"


def _piped(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _plain(r: ParameterRow) -> tuple[str, str]:
    if r.row is None:
        return f"{r.cell.value:.5g}", "–"
    if r.cell.status == "limit":
        assert r.cell.limit is not None
        return f"{'≤' if r.row.at_bound == 'lower' else '≥'} {r.cell.limit:.3g}", "–"
    if r.cell.status == "undetermined" or r.row.median is None or not r.row.sd:
        return f"– ({'prior' if r.cell.converged else 'not converged'})", "–"
    last = latex.last_digit(r.row.sd)
    low, high = (_decimal(end, last) for end in r.row.interval)
    if r.skewed:
        return _decimal(r.row.median, last), f"[{low}, {high}]"
    return plain_number(r.row.median, r.row.sd), f"[{low}, {high}]"


def _decimal(value: float, last: int) -> str:
    exponent = latex.shared_exponent(value, last)
    return latex.digits(value, last, exponent) + (f"e{exponent}" if exponent else "")


def parameters_latex(table: ParameterTable) -> str:
    r"""Lay the table out as a ``table*`` for two-column papers.

    It takes the packages array, booktabs, siunitx (version 3) and tabularx.
    """
    body: list[str] = []
    group = ""
    for r in table.rows:
        if r.group != group:
            group = r.group
            body.append(r"\midrule")
            body.append(rf"\multicolumn{{6}}{{@{{}}l}}{{\emph{{{_GROUPS[group]}}}}} \\")
        value, ends = _latex(r)
        name = latex.symbol(r.symbol, r.name)
        words = latex.escaped(r.meaning or r.name)
        cells = [name, words, value, ends, latex.unit(r.unit), latex.escaped(r.verdict)]
        body.append(" & ".join(cells) + r" \\")
    share = rf"\qty{{{100 * table.level:g}}}{{\percent}}"
    head = rf"Symbol & Quantity & Value & {share} interval & Unit & Determined by \\"
    columns = r"@{}l>{\raggedright\arraybackslash}Xllll@{}"
    return _table(
        "Parameters of the joint", _sentence(table.notes), "tab:parameters", columns, head, body[1:]
    )


def _sentence(notes: tuple[str, ...]) -> str:
    return latex.escaped(". ".join(notes)).replace(r" \%", r"\,\%") + "."


def _table(caption: str, notes: str, label: str, columns: str, head: str, body: list[str]) -> str:
    # IEEE sets captions of tables in small capitals: a title can be read so, notes cannot
    kind, width = ("tabularx", r"{\textwidth}") if "X" in columns else ("tabular", "")
    lines = [
        r"% needs \usepackage{array,booktabs,siunitx,tabularx}, siunitx version 3",
        r"\begin{table*}",
        r"\centering",
        rf"\caption{{{caption}}}",
        rf"\label{{{label}}}",
        r"\footnotesize",
        r"\setlength{\tabcolsep}{4pt}",
        # superscripts of one line must not touch subscripts of that above
        r"\renewcommand{\arraystretch}{1.25}",
        rf"\begin{{{kind}}}{width}{{{columns}}}",
        r"\toprule",
        head,
        r"\midrule",
        *body,
        r"\bottomrule",
        rf"\end{{{kind}}}",
        r"\par\medskip",
        rf"\parbox{{\textwidth}}{{\raggedright {notes}}}",
        r"\end{table*}",
    ]
    return "\n".join(lines) + "\n"


def _latex(r: ParameterRow) -> tuple[str, str]:
    if r.row is None:
        return latex.number(r.cell.value), "---"
    if r.cell.status == "limit":
        assert r.cell.limit is not None
        sign = r"\leq" if r.row.at_bound == "lower" else r"\geq"
        return rf"${sign}$ {latex.number(float(f'{r.cell.limit:.3g}'))}", "---"
    if r.cell.status == "undetermined" or r.row.median is None or not r.row.sd:
        return f"--- ({'prior' if r.cell.converged else 'not converged'})", "---"
    low, high = r.row.interval
    ends = latex.interval(low, high, r.row.sd)
    if r.skewed:
        return latex.with_ends(r.row.median, low, high, r.row.sd), ends
    return latex.with_sd(r.row.median, r.row.sd), ends


def methods_latex(found: Comparison) -> str:
    r"""Lay a comparison of methods out as a ``table*``.

    Parameters
    ----------
    found
        From :func:`bayesfric.report.comparison.comparison.comparison`.
    """
    body: list[str] = []
    group = None
    for row in found.rows:
        if group is not None and group != (row.kind, row.gauge_free):
            body.append(r"\addlinespace")
        group = (row.kind, row.gauge_free)
        cells = [_cell(row.cells.get(column.label)) for column in found.columns]
        name = latex.symbol(row.symbol, row.name)
        body.append(" & ".join([name, latex.unit(row.unit), *cells]) + r" \\")
    head = " & ".join(["", "Unit", *(latex.escaped(c.label) for c in found.columns)]) + r" \\"
    cells_ = [cell for row in found.rows for cell in row.cells.values()]
    notes = ["One standard deviation in parentheses, accounting for correlated residuals"]
    if any(c.status == "determined" and not c.accounts for c in cells_):
        notes.append("†: residuals taken for uncorrelated, too small where they are correlated")
    if any(c.status == "undetermined" and c.converged for c in cells_):
        notes.append("---: not determined by the data")
    if any(not c.converged for c in cells_):
        notes.append("n.c.: not converged")
    if any(c.status == "bound" for c in cells_):
        notes.append("b: on its bound")
    if any(column.label not in row.cells for row in found.rows for column in found.columns):
        notes.append("Empty: the method does not tell it")
    columns = "@{}ll" + "l" * len(found.columns) + "@{}"
    return _table(
        "Estimates by method", _sentence(tuple(notes)), "tab:methods", columns, head, body
    )


def _cell(cell: Cell | None) -> str:
    if cell is None:
        return ""
    if cell.status == "undetermined":
        return "---" if cell.converged else "n.c."
    if cell.status == "limit":
        assert cell.limit is not None
        sign = r"\geq" if cell.remark.startswith("at least") else r"\leq"
        return rf"${sign}$ {latex.number(float(f'{cell.limit:.3g}'))}"
    shown = latex.with_sd(cell.value, cell.sd) if cell.sd else latex.number(cell.value)
    if cell.status == "bound":
        return shown + r"\textsuperscript{b}"
    plain = cell.status == "determined" and not cell.accounts
    return shown + (r"\textsuperscript{\dag}" if plain else "")
