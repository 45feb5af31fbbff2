"""Forest figure: a panel for each quantity, a line for each method, run or reference."""

from __future__ import annotations

from itertools import cycle

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesfric.base.errors import BadInput
from bayesfric.estimates.point_estimate import HALF
from bayesfric.report.comparison.comparison import REFERENCE, Comparison, Quantity
from bayesfric.report.figures import style
from bayesfric.report.figures.style import DOTTED, Look, remark_below, shortened
from bayesfric.report.result_row import ResultRow

_LINE, _AXIS, _LEGEND = 0.17, 0.45, 0.3  # inches: a line, the axis below a panel, the legend
_BAR: Look = {"linewidth": 2.2, "alpha": 0.55, "solid_capstyle": "butt"}
_PLAIN: Look = {"linewidth": 0.7, "label": "90 %, uncorrelated residuals", "gid": "plain"}
# Estimates in greys, posteriors in colours, each with its own shape; orange is a reference's.
_ESTIMATES = {
    "least-squares": ("s", "#8c8c8c"),
    "input-error": ("^", "#5e5e5e"),
    "output-error": ("D", style.MEASURED),
}
_RUNS = (style.POSTERIOR, style.PALETTE[0], style.PALETTE[3])


def forest_figure(compared: Comparison) -> Figure:
    """Draw a comparison, a column wide for up to four quantities, else a page.

    Bars are 90 % intervals; what is not determined has words and never a bar; dots span the values
    that fit as well. ``BadInput`` if nothing at all can be drawn.
    """
    columns = [column for column in compared.columns if column.kind != "reference"]
    posteriors = zip(cycle("ovPX<>"), cycle(_RUNS), strict=True)
    looks = {c.label: _ESTIMATES[c.method] if c.method else next(posteriors) for c in columns}
    counts = [
        sum(c.status != "unidentified" or c.span is not None for c in row.cells.values())
        for row in compared.rows
    ]
    # with something to compare, or else with anything to show
    least = 2 if max(counts, default=0) > 1 else 1
    rows = [row for row, count in zip(compared.rows, counts, strict=True) if count >= least]
    if not rows:
        raise BadInput("forest", "no quantity is determined by any of the columns", "fit says why")
    width, across = (style.COLUMN, 1) if len(rows) <= 4 else (style.PAGE, 3)
    height = _LINE * (len(columns) + 1) + _AXIS
    shown = rows[: across * max(1, int((9.0 - _LEGEND) / height))]
    # the run alone where there is nothing but posteriors
    runs = len(columns) > 1 and all(column.kind == "posterior" for column in columns)
    names = [shortened(c.run if runs else c.label, 24) for c in columns]
    with style.paper_figure(width, _LEGEND + -(-len(shown) // across) * height) as figure:
        panels = style.panel_grid(figure, len(shown), across)
        for k, (ax, row) in enumerate(zip(panels, shown, strict=True)):
            _panel(ax, row, looks)
            ax.set_yticks(range(len(columns)), names if k % across == 0 else [""] * len(columns))
            ax.tick_params(axis="y", length=0.0)
        if handles := style.labelled(figure):
            ncols = 2 if width == style.COLUMN else 4
            figure.legend(handles=handles, loc="outside upper right", ncols=ncols)
        if left_out := len(rows) - len(shown):
            remark_below(figure, f"{left_out} more quantities are in the table only")
    return figure


def _panel(ax: Axes, row: Quantity, looks: dict[str, tuple[str, str]]) -> None:
    ax.set(gid=row.name, ylim=(len(looks) - 0.35, -1.0))  # room for a reference's name
    ax.margins(x=0.06)
    words: list[tuple[ResultRow, int, str]] = []
    for y, (label, (marker, colour)) in enumerate(looks.items()):
        if (cell := row.cells.get(label)) is None:
            continue
        mark: Look = {"marker": marker, "markersize": 4.0, "color": colour, "linestyle": "none"}
        if cell.span is not None:
            ax.plot(cell.span, [y, y], color=colour, gid="span", linestyle=DOTTED)
            ax.plot(cell.value, y, **mark, markerfacecolor="white", label="not determined")
        elif cell.limit is not None:
            # an arrow to the bound
            end = cell.value if cell.bound is None else cell.bound
            ax.plot([end, cell.limit], [y, y], color=colour, gid="limit")
            ax.plot(cell.limit, y, color=colour, marker="|", markersize=6.0)
            ax.plot(end, y, **mark | {"marker": "<" if end < cell.limit else ">"})
        elif cell.status != "unidentified":
            if cell.sd:
                ends = cell.interval or _around(cell, cell.sd)
                look = _PLAIN if cell.plain else _BAR | {"label": "90 %", "gid": "bar"}
                ax.plot(ends, [y, y], color=colour, **look)
            ax.plot(cell.value, y, gid="value", **mark)
        if cell.status in ("unidentified", "bound", "known"):
            words.append((cell, y, "not determined" if cell.status[0] == "u" else cell.remark))
    if (reference := row.cells.get(REFERENCE)) is not None:
        if reference.sd:
            ends = _around(reference, reference.sd)
            ax.axvspan(*ends, color=style.PALETTE[2], alpha=0.15, linewidth=0.0, zorder=0)
        ax.axvline(reference.value, color=style.PALETTE[2], linewidth=0.8, label="reference")
        words.append((reference, -1, shortened(reference.remark, 22)))
    low, high = ax.get_xlim()
    for cell, y, text in words:
        # on the side with more room; in the middle where there is no value
        placed = cell.status != "unidentified" or cell.span is not None
        at = cell.value if placed else 0.5 * (low + high)
        side = ("left" if at < 0.5 * (low + high) else "right") if placed else "center"
        away = {"left": 4.5, "right": -4.5, "center": 0.0}[side]
        note = ax.annotate(
            text, (at, y + 0.5 * (y < 0)), xytext=(away, 0.0), textcoords="offset points",
            ha=side, va="center_baseline", fontsize=style.WORDS,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
        )  # fmt: skip
        note.set_in_layout(False)
    ax.set_xlim(low, high)  # words do not move it
    style.few_ticks(ax.xaxis, 4, inner=True)
    # names are longer than symbols
    size = style.SMALL + 1.0 if row.symbol else style.WORDS
    ax.set_xlabel(style.axis_label(row.symbol, row.name, row.unit), fontsize=size)


def _around(cell: ResultRow, sd: float) -> tuple[float, float]:
    return cell.value - HALF * sd, cell.value + HALF * sd
