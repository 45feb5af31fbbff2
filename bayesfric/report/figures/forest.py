"""Forest figure: a panel for each quantity, a line for each method, run or reference."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesfric.base.errors import BadInput
from bayesfric.estimates.point_estimate import HALF
from bayesfric.report.comparison.comparison import REFERENCE, Column, Comparison, Quantity
from bayesfric.report.figures import style
from bayesfric.report.figures.style import DOTTED, Look, power_of_ten, remark_below, shortened
from bayesfric.report.result_row import ResultRow

# Inches: between lines, for the axis below a panel, for the legend.
_LINE, _AXIS, _LEGEND = 0.155, 0.40, 0.3
_MARGIN = 0.65  # lines above the first and below the last
_REFERENCE = style.PALETTE[2]
_THICK: Look = {
    "linewidth": 2.2, "alpha": 0.55, "solid_capstyle": "butt",
    "label": "90 %, correlated residuals", "gid": "thick",
}  # fmt: skip
_THIN: Look = {
    "linewidth": 0.7, "marker": "|", "markersize": 4.5, "markeredgewidth": 0.7,
    "label": "90 %, uncorrelated residuals", "gid": "thin",
}  # fmt: skip
_WIDE: Look = {"label": "90 %, with model discrepancy", "gid": "wide"}
_OPEN: Look = {"markerfacecolor": "white", "label": "not determined", "gid": "open"}
# Estimates in greys, posteriors in colours, each with its own shape; orange is a reference's.
_ESTIMATES = {
    "least-squares": ("s", "#8c8c8c"),
    "input-error": ("^", "#5e5e5e"),
    "output-error": ("D", style.MEASURED),
}
_POSTERIORS = "ovPX<>"
_RUNS = (style.POSTERIOR, style.PALETTE[0], style.PALETTE[3])


def forest_figure(compared: Comparison) -> Figure:
    """Draw a comparison, a column wide for up to four quantities, else a page.

    Bars are 90 % intervals; thick ones account for correlated residuals, thin ones assume
    uncorrelated ones. What is not determined has an open marker and those words, never a bar; dots
    span the values that fit as well. ``BadInput`` if nothing at all can be drawn.
    """

    def count(row: Quantity) -> int:
        return sum(c.status != "undetermined" or c.span is not None for c in row.cells.values())

    # with something to compare, or else with anything to show
    rows = [r for r in compared.rows if count(r) > 1] or [r for r in compared.rows if count(r)]
    if not rows:
        raise BadInput("forest", "no quantity is determined by any of the columns", "fit says why")
    columns = [column for column in compared.columns if column.kind != "reference"]
    width, across = (style.COLUMN, 1) if len(rows) <= 4 else (style.PAGE, 3)
    # names of references need some room
    above = 0.75 if any(REFERENCE in row.cells for row in rows) else 0.0
    height = _LINE * (len(columns) - 1 + 2 * _MARGIN + above) + _AXIS
    shown = rows[: across * max(1, int((9.0 - _LEGEND) / height))]
    # the run alone where there is nothing but posteriors
    runs = len(columns) > 1 and all(column.kind == "posterior" for column in columns)
    names = [shortened(c.run if runs else c.label, 24) for c in columns]
    posteriors = zip(cycle(_POSTERIORS), cycle(_RUNS), strict=True)
    looks = [_ESTIMATES[c.method] if c.method else next(posteriors) for c in columns]
    with style.paper_figure(width, _LEGEND + -(-len(shown) // across) * height) as figure:
        panels = style.panel_grid(figure, len(shown), across)
        for k, (ax, row) in enumerate(zip(panels, shown, strict=True)):
            ax.set_ylim(-_MARGIN, len(columns) - 1 + _MARGIN + above)
            ax.set_gid(row.name)
            _panel(ax, row, columns, looks)
            ax.set_yticks([])
            if k % across == 0:
                ax.set_yticks([*reversed(range(len(columns)))], names)
                ax.tick_params(axis="y", length=0.0)
        if handles := style.labelled(figure):
            across = 2 if width == style.COLUMN else 4
            figure.legend(handles=handles, loc="outside upper right", ncols=across)
        if left_out := len(rows) - len(shown):
            remark_below(figure, f"{left_out} more quantities are in the table only")
    return figure


def _panel(
    ax: Axes, row: Quantity, columns: Sequence[Column], looks: Sequence[tuple[str, str]]
) -> None:
    ax.margins(x=0.06)
    words: list[tuple[float | None, int, str]] = []
    lines = zip(reversed(range(len(columns))), columns, looks, strict=True)
    for y, column, (marker, colour) in lines:
        if (cell := row.cells.get(column.label)) is None:
            continue
        mark: Look = {
            "marker": marker, "markersize": 3.6 if marker in "sD" else 4.4, "markeredgewidth": 0.7,
            "color": colour, "linestyle": "none", "zorder": 4,
        }  # fmt: skip
        at: float | None = cell.value
        if cell.span is not None:
            ax.plot(cell.span, [y, y], color=colour, gid="span", linewidth=0.9, linestyle=DOTTED)
            ax.plot(cell.value, y, **mark, **_OPEN)
        elif cell.limit is not None:
            # an arrow to the bound
            end = cell.value if cell.bound is None else cell.bound
            ax.plot([end, cell.limit], [y, y], color=colour, linewidth=0.9, gid="limit")
            ax.plot(cell.limit, y, color=colour, marker="|", markersize=6.0)
            ax.plot(end, y, **mark | {"marker": "<" if end < cell.limit else ">"})
            at = cell.limit
        elif cell.status == "undetermined":
            at = None
        else:
            for ends, look in _bars(cell):
                ax.plot(ends, [y, y], color=colour, **look | (_WIDE if column.widened else {}))
            ax.plot(cell.value, y, gid="value", **mark)
        if cell.status == "undetermined":
            words.append((at, y, "not determined" if cell.converged else "not converged"))
        elif cell.status != "determined":
            words.append((at, y, cell.remark))
    if (reference := row.cells.get(REFERENCE)) is not None:
        _reference(ax, reference)
    ax.set_xlim(ax.get_xlim())  # words do not move it
    for at, y, text in words:
        _words(ax, at, y, text)
    exponent = power_of_ten(*ax.get_xlim())
    style.few_ticks(ax.xaxis, 4, inner=True, exponent=exponent)
    label = style.axis_label(row.symbol, row.name, exponent, row.unit)
    # names are longer than symbols
    ax.set_xlabel(label, fontsize=style.SMALL + 1.0 if row.symbol else style.WORDS)


def _around(cell: ResultRow, sd: float) -> tuple[float, float]:
    return cell.value - HALF * sd, cell.value + HALF * sd


def _bars(cell: ResultRow) -> list[tuple[tuple[float, float], Look]]:
    """List the 90 % intervals of what is determined, each with its look."""
    if cell.status != "determined" or cell.sd is None:
        return []
    ends = cell.interval or _around(cell, cell.sd)
    bars = [(ends, _THICK)] if cell.accounts else []
    if cell.sd_plain is not None:
        bars.append((_around(cell, cell.sd_plain) if cell.accounts else ends, _THIN))
    return bars


def _words(ax: Axes, at: float | None, y: float, words: str) -> None:
    """Write next to a place, on the side with more room; else in the middle."""
    middle = sum(ax.get_xlim()) / 2.0
    side, away = ("center", 0.0) if at is None else ("right", -4.5)
    if at is not None and at < middle:
        side, away = "left", 4.5
    # the dots of a span stop for the words
    look: Look = {"bbox": {"facecolor": "white", "edgecolor": "none", "pad": 0.6}, "zorder": 3.5}
    look |= {"ha": side, "va": "center_baseline", "fontsize": style.WORDS}
    place = (middle if at is None else at, y)
    text = ax.annotate(words, place, xytext=(away, 0.0), textcoords="offset points", **look)
    text.set_in_layout(False)


def _reference(ax: Axes, cell: ResultRow) -> None:
    if cell.sd:
        ax.axvspan(*_around(cell, cell.sd), color=_REFERENCE, alpha=0.15, linewidth=0.0, zorder=0)
    ax.axvline(cell.value, color=_REFERENCE, linewidth=0.8, zorder=1, label="reference")
    side, away = ("left", 2.0) if cell.value < sum(ax.get_xlim()) / 2.0 else ("right", -2.0)
    look: Look = {"xycoords": ax.get_xaxis_transform(), "color": _REFERENCE, "va": "top"}
    look |= {"textcoords": "offset points", "ha": side, "fontsize": style.WORDS}
    words = ax.annotate(shortened(cell.remark, 22), (cell.value, 1.0), xytext=(away, -1.5), **look)
    words.set_in_layout(False)
