"""Runs, what the others make of each, the population's mean and the next recording."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesfric.population.population import Interval
from bayesfric.report.comparison.between_runs import PooledQuantity
from bayesfric.report.figures import style
from bayesfric.report.figures.registry import ComparedRuns, ComparisonFigure
from bayesfric.report.figures.style import (
    Look,
    axis_label,
    few_ticks,
    legend_above,
    paper_figure,
    power_of_ten,
    shortened,
)

# Panels beside each other and in all; runs by name, beyond which they are numbered.
_ACROSS, _MOST, _NAMED = 2, 8, 24
# Inches of a line, and of a panel beyond its lines; letters of a run's name.
_LINE, _REST, _LETTERS = 0.125, 0.5, 14
_OWN: Look = {"color": "#9a9a9a", "linewidth": 2.2, "label": "by itself"}


def population_figure(compared: ComparedRuns) -> Figure | None:
    """Draw the first pooled quantities, a panel each; ``None`` where nothing is pooled."""
    shown = _shown(compared)
    if not shown:
        return None
    runs = [name for name in compared.runs if any(name in one.runs for one in shown)]
    rows = math.ceil(len(shown) / _ACROSS)
    lines = min(len(runs), _NAMED)
    places = dict(zip(runs, np.linspace(0.0, -float(lines), len(runs)), strict=True))
    with paper_figure(style.COLUMN, rows * (_LINE * (lines + 3) + _REST) + 0.4) as figure:
        axes = np.atleast_2d(figure.subplots(rows, _ACROSS, squeeze=False, sharey=True))
        first: list[Artist] = []
        for ax, one in zip(axes.ravel(), shown, strict=False):
            drawn = _panel(ax, one, places, lines)
            first = first or drawn
        for ax in axes.ravel()[len(shown) :]:
            ax.set_visible(False)
        for ax in axes[:, 0]:
            named = len(runs) <= _NAMED
            names = [shortened(run, _LETTERS, keep_end=True) if named else "" for run in runs]
            ends = [-lines - 1.6, -lines - 2.6]
            ax.set_yticks([*places.values(), *ends], [*names, "population", "next"])
            ax.tick_params(axis="y", length=0.0)
        legend_above(figure, first, 2)
    return figure


def _shown(compared: ComparedRuns) -> list[PooledQuantity]:
    """Pick parameters and what no scaling changes; totals say the same in other words."""
    told = [one for one in compared.pooled if not one.name.startswith("total")]
    return (told or list(compared.pooled))[:_MOST]


def _panel(ax: Axes, one: PooledQuantity, places: Mapping[str, float], lines: int) -> list[Artist]:
    """Draw one quantity; gives what the legend names."""
    ends = [end for row in one.runs.values() for end in row.told_interval]
    exponent = power_of_ten(min(ends), max(ends))
    factor = 10.0**exponent

    def interval(told: Interval, y: float, colour: str, marker: str, label: str) -> Artist:
        middle, ends = told.median / factor, (told.low / factor, told.high / factor)
        (mark,) = ax.plot(middle, y, color=colour, marker=marker, ms=2.6, ls="none", label=label)
        ax.plot(ends, [y, y], color=colour, lw=0.8)
        return mark

    bars: list[Artist] = []
    for (name, row), pooled in zip(one.runs.items(), one.pool.runs, strict=True):
        y, (low, high) = places[name], row.told_interval
        own = ax.plot([low / factor, high / factor], [y, y], **_OWN)
        bars = [*own, interval(pooled, y, style.PALETTE[1], "o", "with the others")]
    mean, following = one.pool.mean, one.pool.following
    bars.append(interval(mean, -lines - 1.6, style.PALETTE[2], "D", "population mean"))
    bars.append(interval(following, -lines - 2.6, style.MEASURED, "s", "next recording"))
    ax.axhline(-lines - 0.8, color="#c8c8c8", lw=0.6)
    ax.set_ylim(-lines - 3.3, 0.8)
    few_ticks(ax.xaxis, 3)
    ax.set_xlabel(axis_label(one.told.symbol, one.name, exponent, one.told.unit))
    return bars


FIGURE = ComparisonFigure(
    stem="population",
    title="The population, each run in it, and the next recording",
    section="together",
    draw=population_figure,
    caption="Each run by itself (grey), the same in view of the others (circles), the mean of the "
    "population they are drawn from (diamond) and where the true value of the next recording lies "
    "(square); 90 % intervals of the normal hierarchical model.",
)
