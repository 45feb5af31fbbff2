"""Overlaid posteriors of several runs: one small panel a quantity, one curve a run."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from bayesfric.report.comparison.between_runs import PooledQuantity
from bayesfric.report.comparison.cell import Cell
from bayesfric.report.comparison.comparison import Comparison, Row
from bayesfric.report.figures.run_draws import RunDraws
from bayesfric.report.figures.style import (
    PAGE,
    SMALL,
    add_panels,
    few_ticks,
    mathtext,
    paper_style,
    power_of_ten,
    run_style,
    scaled_unit,
    shortened,
)
from bayesfric.report.summary.record import PosteriorRow, Summary

Array = NDArray[np.float64]
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

# Inches.
_LEFT, _RIGHT, _BETWEEN = 0.22, 0.10, 0.14
_PANEL, _BELOW, _LINE = 0.80, 0.42, 0.145
_LETTER = 0.052  # a letter of the legend
_NAME, _SHORT_NAME = 30, 16  # letters of a run's name that are shown
_WORDS = 6.0  # points, of words inside panels
_TOLD: dict[Told, str] = {
    "data": "determined by the data",
    "both": "by data and prior, or from one side",
    "open": "NOT determined: prior and bounds",
}


@dataclass(frozen=True)
class Curve:
    """The marginal posterior density of one quantity in one run.

    Attributes
    ----------
    run, number
        Name of the run and its place among all that are compared.
    x, density
        ``(n,)``, in the quantity's unit and in one over it; both of length one where all
        draws are the same.
    told
        ``data``, ``both`` (data and prior, or the data from one side only) or ``open``.
    row, cell
        What the summary says, and what may be said of it.
    """

    run: str
    number: int
    x: Array
    density: Array
    told: Told
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
    """Everything to draw, and what cannot be.

    Attributes
    ----------
    panels
        What no scaling changes first, then parameters.
    left_out
        Why a run has no curves, by its name.
    without_draws
        Quantities of the same kinds that runs determine but that fewer than two hold draws of.
    """

    panels: tuple[OverlayPanel, ...]
    left_out: Mapping[str, str]
    without_draws: tuple[str, ...]


def density(draws: Array) -> tuple[Array, Array]:
    """Estimate a density from draws by a normal kernel, reflected at the outermost draws.

    The reflection keeps a density that ends at a bound from leaking over it [1]_; the
    bandwidth is Silverman's [1]_. The integral is one, less the share of draws that are
    further than twenty quartile ranges away.

    Parameters
    ----------
    draws
        ``(n,)``; what is not finite is left aside.

    Returns
    -------
    x, density : ndarray
        ``(k,)`` midpoints of equal steps and the density there; one point, and infinity,
        where the draws are all the same.

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


def overlay(
    found: Comparison,
    runs: Mapping[str, Summary],
    draws: Mapping[str, RunDraws],
    pooled: Sequence[PooledQuantity] = (),
) -> Overlay:
    """Gather what overlaid posteriors show.

    Shown are the combinations that no scaling of leg parameters and alpha changes and the
    parameters, of those that the data of one run at least determine and two hold draws of.

    Parameters
    ----------
    found
        The comparison, for the order and for what each run leaves open.
    runs, draws
        Summary and draws of each run.
    pooled
        From :func:`bayesfric.report.comparison.between_runs.between_runs`.
    """
    labels = {c.run: c.label for c in found.columns if c.kind == "posterior"}
    agree = {one.name: one.pool.agree for one in pooled}
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
        have = [run for run in told if row.name in draws[run].values]
        if len(have) < 2:
            without += [row.name] if len(told) > 1 else []
            continue
        curves = tuple(
            Curve(
                run,
                number,
                *density(draws[run].values[row.name]),
                told[run],
                _row(runs[run], row.name),
                row.cells[labels[run]],
            )
            for number, run in enumerate(runs)
            if run in have
        )
        # of what none of those with draws determines there is nothing to compare
        if any(curve.told != "open" for curve in curves):
            panels.append(OverlayPanel(row, curves, agree.get(row.name)))
    panels.sort(key=lambda panel: not panel.row.gauge_free)
    left_out = {run: found.missing for run, found in draws.items() if found.missing}
    if sum(not one.missing for one in draws.values()) < 2:
        without = []
    return Overlay(tuple(panels), left_out, tuple(without))


def _row(run: Summary, name: str) -> PosteriorRow:
    return run.parameters[name] if name in run.parameters else run.derived[name]


def _told(row: Row, label: str, run: Summary) -> Told | None:
    """Judge as the table does; ``None`` where the run did not sample the quantity."""
    if label not in row.cells or not (row.name in run.parameters or row.name in run.derived):
        return None
    cell = row.cells[label]
    if cell.status == "undetermined":
        return "open"
    return "data" if _row(run, row.name).verdict == "data" else "both"


def overlay_figure(shown: Overlay) -> Figure:
    """Draw overlaid marginal posteriors.

    The area below each curve is one. Where data determine a quantity it is filled, where the
    prior has a say it is not, and where the data leave it open it is hatched.

    Parameters
    ----------
    shown
        From :func:`overlay`; at least one panel.

    Returns
    -------
    matplotlib.figure.Figure
        A page wide, four panels in a row, at most twenty-four.
    """
    panels = shown.panels[:_MOST]
    remarks = _remarks(shown)
    curves = {c.run: c.number for panel in panels for c in panel.curves}
    names = [_shortened(run) for run in curves]
    across = max(1, min(len(names), int((PAGE - 0.3) / (0.6 + _LETTER * max(map(len, names))))))
    legend = -(-len(names) // across) + 1
    rows = -(-len(panels) // _COLUMNS)
    top = legend * _LINE + 0.10
    height = top + rows * (_PANEL + _BELOW) + len(remarks) * _LINE
    width = (PAGE - _LEFT - _RIGHT - (_COLUMNS - 1) * _BETWEEN) / _COLUMNS
    with paper_style():
        figure = Figure(figsize=(PAGE, height))
        every = add_panels(
            figure, len(panels), _COLUMNS, left=_LEFT, right=_RIGHT, top=top, between=_BETWEEN,
            panel=_PANEL, below=_BELOW,
        )  # fmt: skip
        for k, (ax, panel) in enumerate(zip(every, panels, strict=True)):
            _panel(ax, panel, width)
            if k % _COLUMNS == 0:
                ax.set_ylabel("density (1/unit)", fontsize=SMALL)
        _legend(figure, panels, curves, names, across)
        for k, remark in enumerate(reversed(remarks)):
            figure.text(
                1.0 - _RIGHT / PAGE,
                (0.03 + k * _LINE) / height,
                remark,
                ha="right",
                va="bottom",
                fontsize=SMALL,
            )
    return figure


def _remarks(shown: Overlay) -> list[str]:
    said = [f"not shown: {_shortened(run)}, which {why}" for run, why in shown.left_out.items()]
    if len(shown.panels) > _MOST:
        said.append(f"{len(shown.panels) - _MOST} more quantities are in the table only")
    return textwrap.wrap("; ".join(said), 125)


def _shortened(run: str, most: int = _NAME) -> str:
    return shortened(run, most, keep_end=True)


def _panel(ax: Axes, panel: OverlayPanel, width: float) -> None:
    low, high = _range(panel.curves)
    exponent = power_of_ten(low, high)
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
            ax.fill_between(x, y, gid=f"{curve.told} area {curve.run}", **_area(curve))
        ax.plot(x, y, color=colour, linestyle=dashes, gid=f"{curve.told} {curve.run}")
    ax.set_xlim(low / factor, high / factor)
    # room for the word
    ax.set_ylim(0.0, 1.28 * top or 1.0)
    ax.set_yticks([])
    ax.set_gid(panel.row.name)
    few_ticks(ax.xaxis, 3, inner=True)
    symbol = mathtext(panel.row.symbol, panel.row.name) if panel.row.symbol else panel.row.name
    label = f"{symbol} ({scaled_unit(exponent, panel.row.unit)})"
    long = not symbol.startswith("$") and _LETTER * len(label) > width
    ax.set_xlabel(label, fontsize=_WORDS if long else 8.0)
    # what is pooled, every run determines: there is never both to say
    if panel.agree is not None:
        _word(ax, "agree" if panel.agree else "DIFFER", "agreement")
    if open_ := [curve.run for curve in panel.curves if curve.told == "open"]:
        # a wide curve may be too low for its hatching to be seen
        who = f"{len(open_)} runs" if len(open_) > 1 else _shortened(open_[0], _SHORT_NAME)
        _word(ax, f"{who}: NOT determined", "open")


def _word(ax: Axes, words: str, gid: str) -> None:
    said: dict[str, Any] = {"va": "top", "ha": "left", "fontsize": _WORDS}
    ax.text(0.03, 0.97, words, transform=ax.transAxes, gid=gid, **said)


def _area(curve: Curve) -> dict[str, Any]:
    colour, _ = run_style(curve.number)
    if curve.told == "data":
        return {"facecolor": colour, "alpha": 0.18, "linewidth": 0.0}
    # two runs' hatches cross, and stay apart
    hatch = "//////" if curve.number % 2 == 0 else "\\\\\\\\\\\\"
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


def _legend(
    figure: Figure,
    panels: Sequence[OverlayPanel],
    curves: Mapping[str, int],
    names: Sequence[str],
    across: int,
) -> None:
    said: dict[str, Any] = {
        "loc": "upper left",
        "borderaxespad": 0.2,
        "borderpad": 0.1,
        "columnspacing": 1.4,
        "labelspacing": 0.3,
    }
    lines = [
        Line2D([], [], color=run_style(k)[0], linestyle=run_style(k)[1]) for k in curves.values()
    ]
    height = figure.get_figheight()
    figure.legend(
        lines,
        names,
        ncols=across,
        handlelength=3.2,
        bbox_to_anchor=(_LEFT / PAGE, 1.0 - 0.02 / height),
        **said,
    )
    grey = "#5e5e5e"
    looks: dict[Told, dict[str, Any]] = {
        "data": {"facecolor": grey, "alpha": 0.3},
        "both": {"facecolor": "white", "edgecolor": grey},
        "open": {"facecolor": "none", "edgecolor": grey, "hatch": "//////", "linewidth": 0.0},
    }
    found = {curve.told for panel in panels for curve in panel.curves}
    shown = [how for how in _TOLD if how in found]
    patches = [Patch(**looks[how], label=_TOLD[how]) for how in shown]
    below = 0.02 + -(-len(names) // across) * _LINE
    figure.legend(
        handles=patches,
        ncols=len(patches),
        handlelength=1.8,
        bbox_to_anchor=(_LEFT / PAGE, 1.0 - below / height),
        **said,
    )
