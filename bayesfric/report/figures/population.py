"""Runs, what the others make of each, the population's mean and the next recording."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesfric.pooling.population import Interval
from bayesfric.report.comparison.between_runs import PooledQuantity
from bayesfric.report.figures import style
from bayesfric.report.figures.registry import ComparedRuns, ComparisonFigure
from bayesfric.report.figures.style import few_ticks, legend_above, paper_figure, shortened

# Panels beside each other and in all; runs by name, beyond which they are numbered.
_ACROSS, _MOST, _NAMED = 2, 8, 24
# Inches of a line, and of a panel beyond its lines; letters of a run's name.
_LINE, _REST, _LETTERS = 0.125, 0.5, 14


def population_figure(compared: ComparedRuns) -> Figure | None:
    """Draw the first pooled quantities, a panel each; ``None`` where nothing is pooled."""
    shown = compared.pooled[:_MOST]
    if not shown:
        return None
    runs = list(shown[0].runs)
    rows = math.ceil(len(shown) / _ACROSS)
    lines = min(len(runs), _NAMED) + 3
    with paper_figure(style.COLUMN, rows * (_LINE * lines + _REST) + 0.3) as figure:
        axes = np.atleast_2d(figure.subplots(rows, _ACROSS, squeeze=False, sharey=True))
        first: list[Artist] = []
        for ax, one in zip(axes.ravel(), shown, strict=False):
            drawn = _panel(ax, one)
            first = first or drawn
        for ax in axes.ravel()[len(shown) :]:
            ax.set_visible(False)
        for ax in axes[:, 0]:
            places = np.linspace(0.0, -float(lines - 3), len(runs))
            names = (
                [shortened(run, _LETTERS) for run in runs]
                if len(runs) <= _NAMED
                else [""] * len(runs)
            )
            ends = [-(lines - 3) - 1.6, -(lines - 3) - 2.6]
            ax.set_yticks([*places, *ends], [*names, "population", "next"])
            ax.tick_params(axis="y", length=0.0)
        legend_above(figure, first)
    return figure


def _panel(ax: Axes, one: PooledQuantity) -> list[Artist]:
    """Draw one quantity; gives what the legend names."""
    lines = min(len(one.runs), _NAMED)
    places = np.linspace(0.0, -float(lines), len(one.runs))
    bars: list[Artist] = []
    for y, row, pooled in zip(places, one.runs.values(), one.pool.runs, strict=True):
        low, high = row.told_interval
        (own,) = ax.plot([low, high], [y, y], color="#9a9a9a", lw=2.2, label="by itself")
        seen = _interval(ax, pooled, y, style.PALETTE[1], "o", "with the others")
        bars = bars or [own, seen]
    last = _interval(ax, one.pool.mean, -lines - 1.6, style.PALETTE[2], "D", "population mean")
    following = _interval(
        ax, one.pool.following, -lines - 2.6, style.MEASURED, "s", "next recording"
    )
    ax.axhline(-lines - 0.8, color="#c8c8c8", lw=0.6)
    ax.set_ylim(-lines - 3.3, 0.8)
    few_ticks(ax.xaxis, 4)
    unit = f" ({one.told.unit})" if one.told.unit else ""
    ax.set_xlabel(f"{one.name}{unit}")
    return [*bars, last, following]


def _interval(ax: Axes, told: Interval, y: float, colour: str, marker: str, label: str) -> Artist:
    bar = ax.errorbar(
        told.median, y, xerr=[[told.median - told.low], [told.high - told.median]], color=colour,
        marker=marker, markersize=2.6, elinewidth=0.8, linestyle="none", label=label,
    )  # fmt: skip
    return bar.lines[0]


def _words(compared: ComparedRuns) -> str:
    said = []
    for one in compared.pooled[:_MOST]:
        unit = f" {one.told.unit}" if one.told.unit else ""
        told = {"mean": one.pool.mean, "next recording": one.pool.following}
        each = ", ".join(
            f"{k} {x.median:.4g} from {x.low:.4g} to {x.high:.4g}" for k, x in told.items()
        )
        said.append(f"{one.name}: {each}{unit}")
    return f"{'. '.join(said)}." if said else ""


FIGURE = ComparisonFigure(
    stem="population",
    title="The population, each run in it, and the next recording",
    section="together",
    draw=population_figure,
    caption="Each run by itself (grey), the same in view of the others (circles), the mean of the "
    "population they are drawn from (diamond) and where the true value of the next recording lies "
    "(square); 90 % intervals of the normal hierarchical model.",
    alternative=_words,
    place=1,
)
