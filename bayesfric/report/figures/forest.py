"""Forest figure: each quantity on a scale of its own, one line a method, run or reference."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend_handler import HandlerLine2D
from matplotlib.lines import Line2D

from bayesfric.errors import BadInput
from bayesfric.report.comparison.cell import Cell
from bayesfric.report.comparison.comparison import REFERENCE, Column, Comparison, Row
from bayesfric.report.figures.style import (
    COLUMN,
    MEASURED,
    PAGE,
    PALETTE,
    SMALL,
    few_ticks,
    mathtext,
    paper_style,
    power_of_ten,
    run_style,
    scaled_unit,
    shortened,
)

# Half width of a 90 % interval of a normal distribution, in standard deviations.
_HALF = 1.645
LEVEL = 0.9
# Up to so many panels stand below each other in one column of a paper.
_FEW = 4
_ACROSS = 3
_HIGHEST = 9.0

# Inches: between lines, for the axis below a panel, a line of legend, and about panels.
_LINE, _AXIS, _LEGEND, _RIGHT, _BETWEEN = 0.155, 0.40, 0.135, 0.08, 0.14
_MARGIN = 0.65  # lines above the first and below the last
_LETTER = 0.054  # inches a letter of row names takes
_WORDS = 6.0  # points, of words inside panels
_REFERENCE = PALETTE[2]

# Estimates in greys, posteriors in colours; shapes tell them apart once more.
_ESTIMATES = {
    "least-squares": ("s", "#8c8c8c"),
    "input-error": ("^", "#5e5e5e"),
    "output-error": ("D", MEASURED),
}
_POSTERIORS = ("o", "v", "P", "X", "<", ">")


@dataclass(frozen=True)
class _Line:
    """How a column is drawn: its height in the panels, its marker and colour."""

    column: Column
    y: float
    marker: str
    colour: str


def forest_figure(found: Comparison) -> Figure:
    """Draw a comparison.

    Bars are 90 % intervals: a posterior's own, an estimate's 1.645 standard
    deviations to either side. Thick ones account for correlated residuals, thin ones
    with caps take them for uncorrelated. What is not determined has an open marker
    and those words, never a bar; dots span the values that fit as well. A reference
    is a vertical line.

    Parameters
    ----------
    found
        From :func:`bayesfric.report.comparison.comparison.comparison`.

    Returns
    -------
    matplotlib.figure.Figure
        A column wide for up to four quantities, else a page. Quantities that only one
        column tells anything of are left out, unless there are no others.

    Raises
    ------
    BadInput
        If nothing at all can be drawn.
    """
    rows = _drawable(found)
    columns = [column for column in found.columns if column.kind != "reference"]
    lines = _styled(columns)
    few = len(rows) <= _FEW
    width, across = (COLUMN, 1) if few else (PAGE, _ACROSS)
    rooms = _rooms(rows, across, len(lines))
    top = _LEGEND * (2 if few else 1) + 0.08
    while len(rooms) > 1 and top + sum(rooms) + len(rooms) * _AXIS > _HIGHEST:
        rooms.pop()
    shown = rows[: across * len(rooms)]
    height = top + sum(rooms) + len(rooms) * _AXIS + (_LEGEND if len(rows) > len(shown) else 0.0)
    names = _names(columns)
    left = min(0.16 + _LETTER * max(map(len, names)), 0.4 * width)
    each = (width - left - _RIGHT - (across - 1) * _BETWEEN) / across
    with paper_style():
        figure = Figure(figsize=(width, height))
        for k, row in enumerate(shown):
            i, j = divmod(k, across)
            x = left + j * (each + _BETWEEN)
            y = height - top - sum(rooms[: i + 1]) - i * _AXIS
            ax = figure.add_axes((x / width, y / height, each / width, rooms[i] / height))
            ax.set_ylim(-_MARGIN, rooms[i] / _LINE - _MARGIN)
            ax.set_gid(row.name)
            _panel(ax, row, lines, (each, rooms[i]))
            # a tick costs time to draw, also where it has neither length nor label
            ax.set_yticks([])
            if j == 0:
                ax.set_yticks(
                    [line.y for line in lines], [_shortened(name, left) for name in names]
                )
                ax.tick_params(axis="y", length=0.0)
        _legend(figure, shown, columns)
        if len(rows) > len(shown):
            figure.text(
                1.0 - _RIGHT / width,
                0.03 / height,
                f"{len(rows) - len(shown)} more quantities are in the table only",
                ha="right",
                va="bottom",
                fontsize=SMALL,
            )
    return figure


def _rooms(rows: list[Row], across: int, lines: int) -> list[float]:
    """Height of the panels in each row of them, in inches; names of references need some."""
    rooms = []
    for first in range(0, len(rows), across):
        named = any(REFERENCE in row.cells for row in rows[first : first + across])
        rooms.append(_LINE * (lines - 1 + 2 * _MARGIN + (0.75 if named else 0.0)))
    return rooms


def _names(columns: list[Column]) -> list[str]:
    """Names at the side; the run alone where there is nothing but posteriors."""
    runs = len(columns) > 1 and all(column.kind == "posterior" for column in columns)
    return [column.run if runs else column.label for column in columns]


def _styled(columns: list[Column]) -> list[_Line]:
    lines, posteriors = [], 0
    for k, column in enumerate(columns):
        if column.method is not None:
            marker, colour = _ESTIMATES[column.method]
        else:
            marker, colour = _POSTERIORS[posteriors % len(_POSTERIORS)], run_style(posteriors)[0]
            posteriors += 1
        lines.append(_Line(column, float(len(columns) - 1 - k), marker, colour))
    return lines


def _drawable(found: Comparison) -> list[Row]:
    """Rows with something to compare, or else with anything to show."""
    for least in (2, 1):
        rows = [
            row
            for row in found.rows
            if sum(c.status != "undetermined" or c.span is not None for c in row.cells.values())
            >= least
        ]
        if rows:
            return rows
    raise BadInput(
        "forest", "no quantity is determined by any of the columns", "see what a fit says of them"
    )


def _panel(ax: Axes, row: Row, lines: list[_Line], inches: tuple[float, float]) -> None:
    low, high = _range(row)
    exponent = power_of_ten(low, high)
    factor = 10.0**exponent
    ax.set_xlim(low / factor, high / factor)
    for line in lines:
        cell = row.cells.get(line.column.label)
        if cell is None:
            continue
        if cell.status == "undetermined":
            _open(ax, line, cell, factor)
        elif cell.status == "limit":
            _limit(ax, line, cell, factor)
        else:
            _bars(ax, line, cell, factor)
            ax.plot(cell.value / factor, line.y, gid="value", zorder=4, **_mark(line))
            if cell.status != "determined":
                _words(ax, cell.value / factor, line.y, cell.remark)
    if REFERENCE in row.cells:
        _reference(ax, row.cells[REFERENCE], factor)
    few_ticks(ax.xaxis, max(3, int(inches[0] / 0.4)), inner=True)
    name = mathtext(row.symbol, row.name) if row.symbol else row.name
    # names are longer than symbols
    long = not row.symbol and _LETTER * (len(name) + len(row.unit) + 6) > inches[0]
    ax.set_xlabel(
        f"{name} ({scaled_unit(exponent, row.unit)})",
        fontsize=_WORDS if long else SMALL + 1.0,
        va="baseline",
    )
    ax.xaxis.set_label_coords(0.5, -0.28 / inches[1])


def _mark(line: _Line, *, filled: bool = True) -> dict[str, Any]:
    return {
        "marker": line.marker,
        "markersize": 3.6 if line.marker in "sD" else 4.4,
        "markeredgewidth": 0.7,
        "color": line.colour,
        "markerfacecolor": line.colour if filled else "white",
        "linestyle": "none",
    }


def _ends(cell: Cell) -> tuple[float, float] | None:
    """Give the ends of the 90 % interval."""
    if cell.interval is not None and cell.level == LEVEL:
        return cell.interval
    if cell.sd is None:
        return None
    return cell.value - _HALF * cell.sd, cell.value + _HALF * cell.sd


def _bars(ax: Axes, line: _Line, cell: Cell, factor: float) -> None:
    ends = _ends(cell)
    if cell.status != "determined" or ends is None:
        return
    if cell.accounts:
        ax.plot(
            [end / factor for end in ends],
            [line.y] * 2,
            color=line.colour,
            linewidth=2.2,
            solid_capstyle="butt",
            alpha=0.55,
            gid="thick",
        )
    if cell.sd_plain is not None:
        if cell.accounts:
            ends = cell.value - _HALF * cell.sd_plain, cell.value + _HALF * cell.sd_plain
        ax.plot(
            [end / factor for end in ends],
            [line.y] * 2,
            color=line.colour,
            linewidth=0.7,
            marker="|",
            markersize=4.5,
            markeredgewidth=0.7,
            zorder=3,
            gid="thin",
        )


def _open(ax: Axes, line: _Line, cell: Cell, factor: float) -> None:
    if cell.span is not None:
        ax.plot(
            [end / factor for end in cell.span],
            [line.y] * 2,
            color=line.colour,
            linewidth=0.9,
            linestyle=(0, (1.0, 1.6)),
            gid="span",
        )
    low, high = ax.get_xlim()
    at = cell.value / factor
    # where nothing else is known, the number may lie anywhere
    if low <= at <= high:
        ax.plot(at, line.y, gid="open", zorder=4, **_mark(line, filled=False))
    words = "not determined" if cell.converged else "not converged"
    if cell.span is None:
        _words(ax, at if low <= at <= high else None, line.y, words)
        return
    # behind the dots if there is room, else where they are longer: their ends must be seen
    start, end = (x / factor for x in cell.span)
    needed = 0.9 * _LETTER * len(words) * (high - low) / (ax.get_position().width * _width(ax))
    if max(high - end, start - low) > needed:
        right = high - end > start - low
        _words(ax, max(at, end) if right else min(at, start), line.y, words, right=right)
    else:
        _words(ax, at, line.y, words, right=end - at > at - start)


def _limit(ax: Axes, line: _Line, cell: Cell, factor: float) -> None:
    """Draw an arrow from the limit towards the bound."""
    assert cell.limit is not None
    limit = cell.limit / factor
    left = cell.limit >= cell.value
    low, high = ax.get_xlim()
    end = low + (0.03 if left else 0.97) * (high - low)
    ax.plot([limit, end], [line.y] * 2, color=line.colour, linewidth=0.9, gid="limit")
    ax.plot(limit, line.y, color=line.colour, marker="|", markersize=6.0, gid="limit")
    mark = _mark(line) | {"marker": "<" if left else ">"}
    ax.plot(end, line.y, gid="limit", **mark)
    _words(ax, limit, line.y, cell.remark)


def _words(ax: Axes, at: float | None, y: float, words: str, *, right: bool | None = None) -> None:
    """Write beside a place, on the side with more room if none is told; else in the middle."""
    low, high = ax.get_xlim()
    if right is None:
        right = at is not None and at - low < high - at
    ax.annotate(
        words,
        (0.5 * (low + high) if at is None else at, y),
        xytext=(0.0 if at is None else 4.5 if right else -4.5, 0.0),
        textcoords="offset points",
        ha="center" if at is None else "left" if right else "right",
        va="center_baseline",
        fontsize=_WORDS,
        # the dots of a span stop for the words
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
        zorder=3.5,
    )


def _reference(ax: Axes, cell: Cell, factor: float) -> None:
    at = cell.value / factor
    if cell.sd:
        half = _HALF * cell.sd / factor
        ax.axvspan(at - half, at + half, color=_REFERENCE, alpha=0.15, linewidth=0.0, zorder=0)
    ax.axvline(at, color=_REFERENCE, linewidth=0.8, zorder=1, gid="reference")
    low, high = ax.get_xlim()
    right = at - low < high - at
    ax.annotate(
        _shortened(cell.remark, 0.6 * ax.get_position().width * _width(ax)),
        (at, 1.0),
        xycoords=ax.get_xaxis_transform(),
        xytext=(2.0 if right else -2.0, -1.5),
        textcoords="offset points",
        ha="left" if right else "right",
        va="top",
        fontsize=_WORDS,
        color=_REFERENCE,
    )


def _width(ax: Axes) -> float:
    figure = ax.get_figure(root=True)
    assert figure is not None
    return float(figure.get_figwidth())


def _range(row: Row) -> tuple[float, float]:
    """Everything that is drawn, and a margin."""
    points: list[float] = []
    for cell in row.cells.values():
        if cell.status == "undetermined":
            points += [*cell.span, cell.value] if cell.span is not None else []
        elif cell.status == "limit":
            points += [cell.value, cell.value if cell.limit is None else cell.limit]
        else:
            points += [cell.value, *(_ends(cell) or ())]
            if cell.sd_plain is not None:
                points += [cell.value - _HALF * cell.sd_plain, cell.value + _HALF * cell.sd_plain]
    low, high = min(points), max(points)
    margin = 0.06 * (high - low) or 0.1 * abs(low) or 1.0
    if not math.isclose(low, high, rel_tol=1e-9):
        return low - margin, high + margin
    return low - max(margin, 0.1 * abs(low)), high + max(margin, 0.1 * abs(low))


def _shortened(label: str, inches: float) -> str:
    return shortened(label, max(6, int((inches - 0.1) / _LETTER)))


def _legend(figure: Figure, rows: list[Row], columns: list[Column]) -> None:
    """Explain what bars and dots mean; rows are named at their side."""
    cells = [row.cells[c.label] for row in rows for c in columns if c.label in row.cells]
    handles: list[Line2D] = []
    labels: list[str] = []
    grey = _ESTIMATES["output-error"][1]
    capped = Line2D([], [], color=grey, linewidth=0.7, marker="|", markersize=4.5)
    if any(cell.accounts and cell.sd is not None for cell in cells):
        handles.append(Line2D([], [], color=grey, linewidth=2.2, alpha=0.55))
        labels.append("90 %, correlated residuals")
    if any(cell.sd_plain is not None for cell in cells):
        handles.append(capped)
        labels.append("90 %, uncorrelated residuals")
    if any(cell.status == "undetermined" and cell.converged for cell in cells):
        handles.append(
            Line2D(
                [],
                [],
                color=grey,
                linestyle=(0, (1.0, 1.6)),
                marker="o",
                markersize=4.0,
                markeredgewidth=0.7,
                markerfacecolor="white",
            )
        )
        labels.append("not determined: fits as well")
    if any(REFERENCE in row.cells for row in rows):
        handles.append(Line2D([], [], color=_REFERENCE, linewidth=0.8))
        labels.append("reference")
    width = float(figure.get_figwidth())
    if handles:
        figure.legend(
            handles,
            labels,
            loc="upper right",
            ncols=2 if width == COLUMN else 4,
            bbox_to_anchor=(1.0 - _RIGHT / width, 1.0),
            borderaxespad=0.2,
            borderpad=0.1,
            columnspacing=1.2,
            handlelength=1.8,
            labelspacing=0.25,
            handler_map={capped: HandlerLine2D(numpoints=2)},
        )
