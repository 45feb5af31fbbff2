"""Overlaid posteriors of several runs: one small panel a quantity, one curve a run."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.ndimage import gaussian_filter1d

from bayesfric.report.comparison.cell import TOGETHER, Cell
from bayesfric.report.comparison.comparison import Row
from bayesfric.report.figures import style
from bayesfric.report.figures.registry import ComparedRuns, ComparisonFigure
from bayesfric.report.figures.style import Array, Look, corner_words, run_style, shortened
from bayesfric.report.summary.record import Summary
from bayesfric.report.summary.rows import PosteriorRow

Told = Literal["data", "both", "open"]

_COLUMNS = 4
_MOST = 24
# A posterior this many times as wide as what is determined would leave that no room.
_WIDEST = 6.0
# Bins in one bandwidth of the densities, and quartile ranges they reach beyond the quartiles.
_FINE = 2.5
_FAR = 20.0
# Draws of one walker resemble each other; about so many count as one.
_DRAWS_APART = 5.0

# Inches: a row of panels, a line of words, a letter of a label, and a panel's width.
_ROW, _LINE, _LETTER, _WIDTH = 1.22, 0.145, 0.052, 1.6
_NAME, _SHORT_NAME = 30, 16  # letters of a run's name that are shown
_ACROSS = 3  # in the legend
_GREY = "#5e5e5e"
_TOLD: dict[Told, str] = {
    "data": "determined by the data",
    "both": "by data and prior, or from one side",
    "open": "NOT determined: prior and bounds",
}


@dataclass(frozen=True)
class Curve:
    """The marginal posterior density of one quantity in one run."""

    # name of the run and its place among all that are compared
    run: str
    number: int
    # `(n,)`, in the quantity's unit and in one over it; both of length one where all draws are the
    # same
    x: Array
    density: Array
    told: Told  # `data`, `both` (data and prior, or the data from one side only) or `open`
    # what the summary says, and what may be said of it
    row: PosteriorRow
    cell: Cell


@dataclass(frozen=True)
class OverlayPanel:
    """One quantity; ``agree`` is whether runs do, ``None`` where they are not pooled."""

    row: Row
    curves: tuple[Curve, ...]
    agree: bool | None


@dataclass(frozen=True)
class Overlay:
    """Everything to draw, and what cannot be."""

    panels: tuple[OverlayPanel, ...]  # what no scaling changes first, then parameters
    left_out: Mapping[str, str]  # why a run has no curves, by its name
    # quantities of the same kinds that runs determine but that fewer than two hold draws of
    without_draws: tuple[str, ...]


def density(draws: Array) -> tuple[Array, Array]:
    """Estimate a density from draws ``(n,)`` by a normal kernel, reflected at the outermost draws.

    The reflection keeps a density that ends at a bound from leaking over it [1]_; the
    bandwidth is Silverman's [1]_. The integral is one, less the share of draws that are
    further than twenty quartile ranges away. Given are midpoints of equal steps and the density
    there; one point, and infinity, where the finite draws are all the same.

    References
    ----------
    .. [1] B. W. Silverman, Density Estimation for Statistics and Data Analysis, Chapman and
       Hall, 1986, sections 2.10 and 3.4.
    """
    x = draws[np.isfinite(draws)]
    first, last = (float(q) for q in np.quantile(x, [0.25, 0.75]))
    middle = float(np.median(x))
    if last - first <= 1e-12 * max(abs(first), abs(last)):
        return np.array([middle]), np.array([np.inf])
    reach = _FAR * (last - first)
    low, high = max(float(x.min()), first - reach), min(float(x.max()), last + reach)
    near = x[(x >= low) & (x <= high)]
    spread = min(float(near.std()), (last - first) / 1.349)
    width = 0.9 * spread * max(x.size / _DRAWS_APART, 1.0) ** -0.2
    bins = math.ceil(_FINE * (high - low) / width)
    counts, edges = np.histogram(x, bins=bins, range=(low, high))
    step = (high - low) / bins
    # "reflect" keeps the sum
    smooth = gaussian_filter1d(counts.astype(np.float64), width / step, mode="reflect")
    return 0.5 * (edges[1:] + edges[:-1]), smooth / (x.size * step)


@lru_cache(1)  # drawn, captioned and worded one after another
def overlay(compared: ComparedRuns) -> Overlay:
    """Gather what overlaid posteriors show.

    Shown are the combinations that no scaling of leg parameters and alpha changes and the
    parameters, of those that the data of one run at least determine and two hold draws of.
    """
    found, runs, draws = compared.found, compared.runs, compared.draws
    labels = {c.run: c.label for c in found.columns if c.kind == "posterior"}
    # where a run leaves it open, that is said instead
    whole = (one for one in compared.pooled if len(one.runs) == len(runs))
    agree = {one.name: one.pool.agree for one in whole}
    panels, without = [], []
    for row in found.rows:
        if not (row.gauge_free or row.kind == "parameter"):
            continue
        told = {
            run: judged
            for run, label in labels.items()
            if (judged := _told(row, label, runs[run])) is not None
        }
        if all(how == "open" for how in told.values()):
            continue
        have = [run for run in told if run in draws and row.name in draws[run].values]
        if len(have) < 2:
            without += [row.name] if len(told) > 1 else []
            continue
        curves = []
        for number, run in enumerate(runs):
            if run in have:
                x, y = density(draws[run].values[row.name])
                what = runs[run].rows[row.name], row.cells[labels[run]]
                curves.append(Curve(run, number, x, y, told[run], *what))
        # of what none of those with draws determines there is nothing to compare
        if any(curve.told != "open" for curve in curves):
            panels.append(OverlayPanel(row, tuple(curves), agree.get(row.name)))
    panels.sort(key=lambda panel: not panel.row.gauge_free)
    left_out = {run: one.missing for run, one in draws.items() if one.missing}
    if sum(not one.missing for one in draws.values()) < 2:
        without = []
    return Overlay(tuple(panels), left_out, tuple(without))


def _told(row: Row, label: str, run: Summary) -> Told | None:
    """Judge as the table does; ``None`` where the run did not sample the quantity."""
    if label not in row.cells or row.name not in run.rows:
        return None
    if row.cells[label].status == "undetermined":
        return "open"
    return "data" if run.rows[row.name].verdict == "data" else "both"


def overlay_figure(shown: Overlay) -> Figure:
    """Draw overlaid marginal posteriors, of one panel at least and twenty-four at most.

    The area below each curve is one. Where data determine a quantity it is filled, where the
    prior has a say it is not, and where the data leave it open it is hatched. A page wide.
    """
    panels = shown.panels[:_MOST]
    remarks = _remarks(shown)
    rows = -(-len(panels) // _COLUMNS)
    with style.paper_figure(style.PAGE, rows * _ROW, apart=0.05) as figure:
        handles = _handles(panels)
        lines = len(handles) // _ACROSS + len(remarks)
        figure.set_figheight(0.1 + lines * _LINE + rows * _ROW)
        every = style.panel_grid(figure, len(panels), _COLUMNS)
        for k, (ax, panel) in enumerate(zip(every, panels, strict=True)):
            _panel(ax, panel)
            if k % _COLUMNS == 0:
                ax.set_ylabel("density (1/unit)", fontsize=style.SMALL)
        style.legend_above(figure, handles, _ACROSS)
        style.remark_below(figure, "\n".join(remarks))
    return figure


def _remarks(shown: Overlay) -> list[str]:
    said = [f"not shown: {_shortened(run)}, which {why}" for run, why in shown.left_out.items()]
    if len(shown.panels) > _MOST:
        said.append(f"{len(shown.panels) - _MOST} more quantities are in the table only")
    return textwrap.wrap("; ".join(said), 125)


def _shortened(run: str, most: int = _NAME) -> str:
    return shortened(run, most, keep_end=True)


def _panel(ax: Axes, panel: OverlayPanel) -> None:
    low, high = _range(panel.curves)
    exponent = style.power_of_ten(low, high)
    factor = 10.0**exponent
    top = 0.0
    for curve in panel.curves:
        colour, dashes = run_style(curve.number)
        x, y = curve.x / factor, curve.density * factor
        if x.size == 1:
            ax.axvline(float(x[0]), color=colour, linestyle=dashes, gid=f"{curve.told} {curve.run}")
            continue
        # down to zero at the ends: a density that stops at a bound is seen to stop
        x, y = np.r_[x[0], x, x[-1]], np.r_[0.0, y, 0.0]
        inside = (x >= low / factor) & (x <= high / factor)
        top = max(top, float(y[inside].max(initial=0.0)))
        if curve.told != "both":
            # two runs' hatches cross, and stay apart
            hatch = style.OPEN_HATCH_BACK if curve.number % 2 else style.OPEN_HATCH
            area = _area(curve.told, colour, hatch)
            ax.fill_between(x, y, gid=f"{curve.told} area {curve.run}", **area)
        ax.plot(x, y, color=colour, linestyle=dashes, gid=f"{curve.told} {curve.run}")
    ax.set_xlim(low / factor, high / factor)
    # room for the word
    ax.set_ylim(0.0, 1.28 * top or 1.0)
    ax.set_yticks([])
    ax.set_gid(panel.row.name)
    style.few_ticks(ax.xaxis, 3, inner=True)
    label = style.axis_label(panel.row.symbol, panel.row.name, exponent, panel.row.unit)
    long = not label.startswith("$") and _LETTER * len(label) > _WIDTH
    ax.set_xlabel(label, fontsize=style.WORDS if long else 8.0)
    # what is pooled, every run determines: there is never both to say
    if panel.agree is not None:
        corner_words(ax, "agree" if panel.agree else "DIFFER", "agreement", size=style.WORDS)
    if open_ := [curve.run for curve in panel.curves if curve.told == "open"]:
        # a wide curve may be too low for its hatching to be seen
        who = f"{len(open_)} runs" if len(open_) > 1 else _shortened(open_[0], _SHORT_NAME)
        corner_words(ax, f"{who}: NOT determined", "open", size=style.WORDS)


def _area(told: Told, colour: str, hatch: str = style.OPEN_HATCH) -> Look:
    if told == "data":
        return {"facecolor": colour, "alpha": 0.18, "linewidth": 0.0}
    if told == "both":
        return {"facecolor": "white", "edgecolor": colour}
    return {"facecolor": "none", "edgecolor": colour, "hatch": hatch, "linewidth": 0.0}


def _range(curves: Sequence[Curve]) -> tuple[float, float]:
    """Everything of what is determined, and of the open as much as leaves that some width."""
    low, high = _ends([c for c in curves if c.told != "open"])
    first, last = _ends(curves)
    room = 0.5 * (_WIDEST - 1.0) * (high - low)
    low, high = max(first, low - room), min(last, high + room)
    margin = 0.04 * (high - low) or 0.1 * abs(low) or 1.0
    return low - margin, high + margin


def _ends(curves: Sequence[Curve]) -> tuple[float, float]:
    """Hold nearly all of every curve."""
    ends = []
    for curve in curves:
        if curve.x.size == 1:
            ends += [float(curve.x[0])] * 2
            continue
        mass = np.cumsum(curve.density) * (curve.x[1] - curve.x[0])
        ends += [float(curve.x[np.searchsorted(mass, q * mass[-1])]) for q in (0.001, 0.999)]
    return min(ends), max(ends)


def _handles(panels: Sequence[OverlayPanel]) -> list[Artist]:
    """List lines of runs row by row, and below them what fillings mean, for three columns."""
    curves = [curve for panel in panels for curve in panel.curves]
    handles: list[Artist] = []
    for run, number in {c.run: c.number for c in curves}.items():
        colour, dashes = run_style(number)
        handles.append(Line2D([], [], color=colour, linestyle=dashes, label=_shortened(run)))
    found = {curve.told for curve in curves}
    fillings = [Patch(**_area(how, _GREY), label=_TOLD[how]) for how in _TOLD if how in found]
    blank = Line2D([], [], linestyle="none", label=" ")
    handles += [blank] * (-len(handles) % _ACROSS)
    handles += [*fillings, *[blank] * (_ACROSS - len(fillings))]
    # a legend fills column by column
    return [handle for k in range(_ACROSS) for handle in handles[k::_ACROSS]]


def _draw(compared: ComparedRuns) -> Figure | None:
    shown = overlay(compared)
    return overlay_figure(shown) if shown.panels else None


def overlay_caption(shown: Overlay) -> str:
    """Say what is drawn, and what cannot be."""
    caption = (
        "Marginal posterior density of every run, the area below each curve being one: filled "
        "where the data determine the quantity, not filled where the prior has a say or the data "
        "tell from one side only, hatched where they leave it open: then it is prior and bounds "
        "that are seen. Densities have room for the model's error where a run shows one. What the "
        "data of no run determine is left out."
    )
    if shown.without_draws:
        names = ", ".join(shown.without_draws)
        caption += f" In the table only, for no draws of them are kept: {names}."
    for run, why in shown.left_out.items():
        caption += f" Not shown: {run}, which {why}."
    return caption


def overlay_words(shown: Overlay) -> str:
    """Say medians and intervals run by run; what is open has no numbers."""
    said = []
    for panel in shown.panels:
        unit = f" in {panel.row.unit}" if panel.row.unit else ""
        each = ", ".join(map(_curve_words, panel.curves))
        agree = {None: "", True: "; they agree", False: "; they differ"}[panel.agree]
        said.append(f"{panel.row.name}{unit}: {each}{agree}")
    return f"{'. '.join(said)}."


def _curve_words(curve: Curve) -> str:
    if curve.told == "open":
        return f"{curve.run} not determined by the data"
    if curve.cell.status == "limit":
        return f"{curve.run} {curve.cell.remark}, as far as the data tell"
    low, high = curve.row.told_interval
    by = "the data" if curve.told == "data" else TOGETHER
    ends = f"{100 * curve.row.level:g} % from {low:.4g} to {high:.4g}"
    return f"{curve.run} {curve.row.middle:.4g}, {ends}, determined by {by}"


FIGURE = ComparisonFigure(
    stem="overlay",
    title="Posteriors of the runs, overlaid",
    section="together",
    draw=_draw,
    caption=lambda compared: overlay_caption(overlay(compared)),
    alternative=lambda compared: overlay_words(overlay(compared)),
)
