"""Forest figure: a panel for each quantity, a line for each method, run or reference."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import cycle
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend_handler import HandlerLine2D
from matplotlib.lines import Line2D

from bayesfric.base.errors import BadInput
from bayesfric.estimates.point_estimate import HALF
from bayesfric.report.comparison.comparison import (
    REFERENCE,
    Column,
    Comparison,
    Quantity,
    comparison,
)
from bayesfric.report.figures import style
from bayesfric.report.figures.registry import Declared, RunFigure
from bayesfric.report.figures.style import Look, power_of_ten, remark_below, shortened
from bayesfric.report.result_row import ResultRow
from bayesfric.report.summary.derived_quantities import LEVEL

# Up to so many panels are below each other in one column of a paper.
_FEW = 4
_ACROSS = 3
_HIGHEST = 9.0
# Inches: between lines, for the axis below a panel, for the legend.
_LINE, _AXIS, _LEGEND = 0.155, 0.40, 0.3
# Letters that fit: of a column's name, of a reference's.
_LETTERS, _SOURCE = 24, 22
_MARGIN = 0.65  # lines above the first and below the last
_REFERENCE = style.PALETTE[2]
_THICK: Look = {"linewidth": 2.2, "alpha": 0.55, "solid_capstyle": "butt"}
_THIN: Look = {"linewidth": 0.7, "marker": "|", "markersize": 4.5, "markeredgewidth": 0.7}
_SPAN: Look = {"linewidth": 0.9, "linestyle": style.DOTTED}

# Estimates in greys, posteriors in colours, each with its own shape.
_ESTIMATES = {
    "least-squares": ("s", "#8c8c8c"),
    "input-error": ("^", "#5e5e5e"),
    "output-error": ("D", style.MEASURED),
}
_POSTERIORS = ("o", "v", "P", "X", "<", ">")
_RUNS = (style.POSTERIOR, style.PALETTE[0], style.PALETTE[3])  # orange is a reference's


class _Line(NamedTuple):
    """How a column is drawn: its height in the panels, its marker and colour."""

    column: Column
    y: float
    marker: str
    colour: str

    def mark(self, *, filled: bool = True) -> Look:
        """Give the look of a value."""
        return {
            "marker": self.marker, "markersize": 3.6 if self.marker in "sD" else 4.4,
            "markeredgewidth": 0.7, "color": self.colour, "linestyle": "none", "zorder": 4,
            "markerfacecolor": self.colour if filled else "white",
        }  # fmt: skip

    def draw(self, ax: Axes, x: Iterable[float], kind: str, look: Look) -> None:
        """Draw a bar of some kind."""
        ax.plot([*x], [self.y] * 2, color=self.colour, gid=kind, **look)


def forest_figure(compared: Comparison) -> Figure:
    """Draw a comparison, a column wide for up to four quantities, else a page.

    Bars are 90 % intervals: a posterior's, an estimate's 1.645 standard deviations to either side.
    Thick ones account for correlated residuals, thin ones with caps assume uncorrelated ones. What
    is not determined has an open marker and those words, never a bar; dots span the values that fit
    as well. A reference is a vertical line. Quantities of only one column are left out, unless
    there are no others; ``BadInput`` if nothing at all can be drawn.
    """
    rows = _drawable(compared)
    columns = [column for column in compared.columns if column.kind != "reference"]
    width, across = (style.COLUMN, 1) if len(rows) <= _FEW else (style.PAGE, _ACROSS)
    # names of references need some room
    above = 0.75 if any(REFERENCE in row.cells for row in rows) else 0.0
    room = _LINE * (len(columns) - 1 + 2 * _MARGIN + above) + _AXIS
    most = max(1, int((_HIGHEST - _LEGEND) / room))
    shown = rows[: across * most]
    # the run alone where there is nothing but posteriors
    runs = len(columns) > 1 and all(column.kind == "posterior" for column in columns)
    names = [shortened(c.run if runs else c.label, _LETTERS) for c in columns]
    lines = _styled(columns)
    with style.paper_figure(width, _LEGEND + -(-len(shown) // across) * room) as figure:
        panels = style.panel_grid(figure, len(shown), across)
        for k, (ax, row) in enumerate(zip(panels, shown, strict=True)):
            ax.set_ylim(-_MARGIN, len(columns) - 1 + _MARGIN + above)
            ax.set_gid(row.name)
            _panel(ax, row, lines)
            ax.set_yticks([])
            if k % across == 0:
                ax.set_yticks([line.y for line in lines], names)
                ax.tick_params(axis="y", length=0.0)
        _legend(figure)
        if left_out := len(rows) - len(shown):
            remark_below(figure, f"{left_out} more quantities are in the table only")
    return figure


def _styled(columns: list[Column]) -> list[_Line]:
    posteriors = zip(cycle(_POSTERIORS), cycle(_RUNS), strict=True)
    return [
        _Line(
            c,
            float(len(columns) - 1 - k),
            *(_ESTIMATES[c.method] if c.method else next(posteriors)),
        )
        for k, c in enumerate(columns)
    ]


def _drawable(compared: Comparison) -> list[Quantity]:
    """Rows with something to compare, or else with anything to show."""

    def drawable(row: Quantity) -> int:
        return sum(c.status != "undetermined" or c.span is not None for c in row.cells.values())

    for least in (2, 1):
        if rows := [row for row in compared.rows if drawable(row) >= least]:
            return rows
    raise BadInput("forest", "no quantity is determined by any of the columns", "fit says why")


def _panel(ax: Axes, row: Quantity, lines: list[_Line]) -> None:
    cells = [
        (line, row.cells[label]) for line in lines if (label := line.column.label) in row.cells
    ]
    ax.margins(x=0.06)
    for line, cell in cells:
        if cell.span is not None:
            line.draw(ax, cell.span, "span", _SPAN)
            ax.plot(cell.value, line.y, gid="open", **line.mark(filled=False))
        elif cell.limit is not None:
            # an arrow to the bound
            end = cell.value if cell.bound is None else cell.bound
            line.draw(ax, [end, cell.limit], "limit", {"linewidth": 0.9})
            ax.plot(cell.limit, line.y, color=line.colour, marker="|", markersize=6.0)
            ax.plot(end, line.y, **line.mark() | {"marker": "<" if end < cell.limit else ">"})
        elif cell.status != "undetermined":
            for ends, kind, look in _bars(cell):
                line.draw(ax, ends, "wide" if line.column.widened else kind, look)
            ax.plot(cell.value, line.y, gid="value", **line.mark())
    if REFERENCE in row.cells:
        _reference(ax, row.cells[REFERENCE])
    ax.set_xlim(ax.get_xlim())  # words do not move it
    for line, cell in cells:
        if cell.status == "undetermined":
            words = "not determined" if cell.converged else "not converged"
            _words(ax, cell.value if cell.span is not None else None, line.y, words)
        elif cell.status != "determined":
            _words(ax, cell.value if cell.limit is None else cell.limit, line.y, cell.remark)
    exponent = power_of_ten(*ax.get_xlim())
    style.few_ticks(ax.xaxis, 4, inner=True, exponent=exponent)
    label = style.axis_label(row.symbol, row.name, exponent, row.unit)
    # names are longer than symbols
    ax.set_xlabel(label, fontsize=style.SMALL + 1.0 if row.symbol else style.WORDS)


def _around(cell: ResultRow, sd: float) -> tuple[float, float]:
    return cell.value - HALF * sd, cell.value + HALF * sd


def _bars(cell: ResultRow) -> list[tuple[tuple[float, float], str, Look]]:
    """List the 90 % intervals of what is determined, with kind and look."""
    if cell.status != "determined" or cell.sd is None:
        return []
    exact = cell.interval is not None and cell.level == LEVEL
    ends = cell.interval if cell.interval is not None and exact else _around(cell, cell.sd)
    bars = [(ends, "thick", _THICK)] if cell.accounts else []
    if cell.sd_plain is not None:
        plain = _around(cell, cell.sd_plain) if cell.accounts else ends
        bars.append((plain, "thin", _THIN))
    return bars


def _words(ax: Axes, at: float | None, y: float, words: str) -> None:
    """Write next to a place, on the side with more room; else in the middle."""
    low, high = ax.get_xlim()
    middle = 0.5 * (low + high)
    side, away = ("left", 4.5) if at is not None and at < middle else ("right", -4.5)
    side, away = ("center", 0.0) if at is None else (side, away)
    # the dots of a span stop for the words
    look: Look = {"bbox": {"facecolor": "white", "edgecolor": "none", "pad": 0.6}, "zorder": 3.5}
    look |= {"ha": side, "va": "center_baseline", "fontsize": style.WORDS}
    place = (middle if at is None else at, y)
    text = ax.annotate(words, place, xytext=(away, 0.0), textcoords="offset points", **look)
    text.set_in_layout(False)


def _reference(ax: Axes, cell: ResultRow) -> None:
    if cell.sd:
        ax.axvspan(*_around(cell, cell.sd), color=_REFERENCE, alpha=0.15, linewidth=0.0, zorder=0)
    ax.axvline(cell.value, color=_REFERENCE, linewidth=0.8, zorder=1, gid="reference")
    side, away = ("left", 2.0) if cell.value < sum(ax.get_xlim()) / 2.0 else ("right", -2.0)
    words = shortened(cell.remark, _SOURCE)
    look: Look = {"xycoords": ax.get_xaxis_transform(), "color": _REFERENCE, "va": "top"}
    look |= {"textcoords": "offset points", "ha": side, "fontsize": style.WORDS}
    ax.annotate(words, (cell.value, 1.0), xytext=(away, -1.5), **look).set_in_layout(False)


def _legend(figure: Figure) -> None:
    """Explain what bars and dots mean; rows are named at their side."""
    grey: Look = {"color": _ESTIMATES["output-error"][1]}
    blue: Look = {"color": style.POSTERIOR}
    open_ = _SPAN | {"gid": "open", "marker": "o", "markersize": 4.0, "markeredgewidth": 0.7}
    capped = Line2D([], [], label="90 %, uncorrelated residuals", gid="thin", **_THIN, **grey)
    handles = [
        Line2D([], [], label="90 %, correlated residuals", gid="thick", **_THICK, **grey),
        capped,
        wide := Line2D([], [], label="90 %, with model discrepancy", gid="wide", **_THIN, **blue),
        Line2D([], [], label="not determined", markerfacecolor="white", **open_, **grey),
        Line2D([], [], color=_REFERENCE, linewidth=0.8, label="reference", gid="reference"),
    ]
    if shown := style.explained(figure, handles):
        ends = HandlerLine2D(numpoints=2)
        look: Look = {"handler_map": {capped: ends, wide: ends}}
        across = 2 if figure.get_figwidth() == style.COLUMN else 4
        figure.legend(handles=shown, loc="outside upper right", ncols=across, **look)


_BARS = (
    f"Thick: {100 * LEVEL:.0f} %, accounting for correlated residuals; thin: assuming them "
    "uncorrelated, or of posteriors with model discrepancy; open symbols: not determined, "
    "dotted what fits as well."
)
METHODS = RunFigure(
    stem="methods",
    title="Estimates and posterior side by side",
    section="methods",
    # of a single run, whose name is nowhere shown
    draw=lambda run: forest_figure(comparison({"run": run.summary})),
    caption=f"Every quantity by every method and by the posterior. {_BARS}",
)
FOREST = Declared(
    stem="forest",
    title="Every quantity by every run and method",
    section="side-by-side",
    draw=forest_figure,
    caption=_BARS,
)
