"""Corner plot: marginal posteriors with their priors, and every pair."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayesfric.inference.fitting import Fit
from bayesfric.inference.prior.priors import Prior
from bayesfric.mechanism.derived import derive
from bayesfric.report.comparison.cell import Cell, posterior_cells
from bayesfric.report.figures.registry import RunFigure
from bayesfric.report.figures.style import (
    DASHED,
    DOTTED,
    OPEN_HATCH,
    PAGE,
    POSTERIOR,
    PRIOR,
    SMALL,
    Array,
    Look,
    few_ticks,
    mathtext,
    paper_figure,
    power_of_ten,
    scaled_unit,
)
from bayesfric.report.summary.derived_quantities import LEVEL, described_as
from bayesfric.report.summary.noise import noise_described
from bayesfric.report.summary.record import Summary

# Combinations that come first; parameters want to be seen too.
_COMBINATIONS = 5
# More panels than 8 by 8 cannot be read at the width of a page.
_MOST = 8
# Share of the draws inside the contours.
MASSES = (0.5, 0.9)
_BINS = 40
_GRID = 301
# In bins: enough for closed contours from some thousand draws, too little to widen them.
_SMOOTH = 1.2
_OPEN: Look = {
    "facecolor": "none", "edgecolor": POSTERIOR, "linewidth": 0.0, "hatch": OPEN_HATCH
}  # fmt: skip
_TOLD: Look = {
    "facecolor": POSTERIOR, "edgecolor": "none", "linewidth": 0.0, "alpha": 0.3
}  # fmt: skip
_PRIOR: Look = {"color": PRIOR, "linestyle": DASHED}
_END: Look = {"color": POSTERIOR, "linewidth": 0.7, "linestyle": DOTTED}


def corner_figure(fit: Fit, summary: Summary) -> Figure:
    """Draw marginal and pairwise posteriors of at most eight quantities, a page wide.

    On the diagonal the posterior density is a histogram with the prior density of
    parameters dashed on the same scale and the 90 % interval marked; below it contours
    hold 50 % and 90 % of the draws. What the data leave open is hatched, without an
    interval, and its pairs are not filled. Where the data leave parameters open, first come
    combinations that they determine, then what they determine of the parameters; else the
    parameters as sampled.
    """
    cells = posterior_cells(summary)
    sampled = quantities(fit.wide)
    # what fixed parameters make up is known, and has no posterior
    combined = [q for q in combinations(fit.wide) if q.name in cells]
    shown = _choice(sampled, combined, cells, fit.target.noise.names)
    judged = [cells[q.name] for q in shown]
    left_out = [q.symbol for q in sampled if q not in shown]
    k = len(shown)
    with paper_figure(PAGE, PAGE, apart=0.02) as figure:
        grid = figure.add_gridspec(k, k)
        ranges = [q.nearly_all(0.06) for q in shown]
        open_ = [cell.status == "undetermined" for cell in judged]
        for i in range(k):
            for j in range(i + 1):
                ax = figure.add_subplot(grid[i, j])
                if i == j:
                    _marginal(ax, shown[i], ranges[i], judged[i])
                else:
                    filled = not (open_[i] or open_[j])
                    _pair(ax, (shown[j], shown[i]), (ranges[j], ranges[i]), filled=filled)
                few_ticks(ax.xaxis, 3, inner=True, exponent=shown[j].exponent)
                _label(ax, shown[j] if i == k - 1 else None, shown[i] if 0 == j < i else None)
        figure.align_labels()
        # in the empty upper triangle
        handles = _handles(judged)
        figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.99, 0.985))
        if left_out and k > 1:
            below = 0.985 - 0.16 * (len(handles) + 1) / PAGE
            said = f"not shown: {', '.join(left_out)}"
            figure.text(0.98, below, said, ha="right", va="top", fontsize=SMALL)
    return figure


def _choice(
    sampled: list[Quantity],
    combined: list[Quantity],
    cells: Mapping[str, Cell],
    noise: Sequence[str],
) -> list[Quantity]:
    """Choose what to show: what the data tell before what they leave open."""
    joint = [q for q in sampled if q.name not in noise]
    open_ = [q for q in joint if cells[q.name].status == "undetermined"]
    if not open_:
        return sampled[:_MOST]
    told = [q for q in combined if cells[q.name].status == "determined"]
    known = [q for q in joint if q not in open_]
    rest = [q for q in sampled if q.name in noise]
    return [*told[:_COMBINATIONS], *known, *open_, *rest][:_MOST]


def _marginal(ax: Axes, q: Quantity, limits: tuple[float, float], cell: Cell) -> None:
    """Draw posterior and prior density of a quantity, both in one over the unit of the axis."""
    highest = 0.0
    if q.prior is not None:
        grid = np.linspace(*limits, _GRID)
        prior = np.exp(q.prior.log_density(grid))
        prior = np.where(np.isfinite(prior), prior, np.nan)
        highest = float(np.nanmax(prior, initial=0.0))
        ax.plot(grid, prior, gid="prior", zorder=3, **_PRIOR)
    if _moves(q.draws):
        height, edges = np.histogram(q.draws, bins=_BINS, range=limits)
        density = height / (q.draws.size * np.diff(edges))
        open_ = cell.status == "undetermined"
        gid, look = ("open", _OPEN) if open_ else ("posterior", _TOLD)
        ax.stairs(density, edges, fill=True, gid=gid, **look)
        ax.stairs(density, edges, color=POSTERIOR, linewidth=0.8)
        # those of the tables, to the digit; of a limit the end away from the bound
        told = [cell.limit] if cell.limit is not None else cell.interval or ()
        for end in () if open_ else told:
            ax.axvline(end, ymax=0.8, **_END)
        peak = float(density.max())
        # a prior may have a pole at its bound; it must not flatten the posterior
        highest = max(peak, min(2.0 * peak, highest))
    ax.set(xlim=limits, ylim=(0.0, 1.12 * highest or 1.0))
    ax.set_yticks([])


def _moves(draws: Array) -> bool:
    """Whether draws differ by more than rounding, which leaves no room for a histogram."""
    return bool(np.ptp(draws) > 1e-12 * np.abs(draws).max())


def _pair(
    ax: Axes,
    pair: tuple[Quantity, Quantity],
    limits: tuple[tuple[float, float], tuple[float, float]],
    *,
    filled: bool,
) -> None:
    import corner  # brings ArviZ along, which takes a second or more

    if all(_moves(q.draws) for q in pair):
        look: Look = {"color": POSTERIOR, "contour_kwargs": {"linewidths": (0.6, 0.9)}}
        look |= {"plot_datapoints": False, "plot_density": False, "fill_contours": filled}
        look |= {"bins": _BINS, "range": list(limits), "levels": MASSES, "smooth": _SMOOTH}
        corner.hist2d(*(q.draws for q in pair), ax=ax, quiet=True, **look)
    ax.set(xlim=limits[0], ylim=limits[1])
    few_ticks(ax.yaxis, 3, inner=True, exponent=pair[1].exponent)


def _label(ax: Axes, below: Quantity | None, beside: Quantity | None) -> None:
    """Label an outer panel, on two lines: a panel is hardly wider than a unit."""
    # upright: neighbours leave a number no room, and gaps stay equal
    ax.tick_params(axis="x", labelrotation=90, labelbottom=below is not None)
    ax.tick_params(axis="y", labelleft=beside is not None)
    if below is not None:
        ax.set_xlabel(below.label("\n"), linespacing=1.3, fontsize=SMALL)
    if beside is not None:
        ax.set_ylabel(beside.label("\n"), linespacing=1.3, fontsize=SMALL)


def _handles(cells: Sequence[Cell]) -> list[Artist]:
    """List what the legend explains."""
    open_ = [cell for cell in cells if cell.status == "undetermined"]
    told = len(open_) < len(cells)
    lost = any(not cell.converged for cell in open_)
    left_open = "draws of ensembles that disagree" if lost else "posterior that the data leave open"
    share = " and ".join(f"{100 * mass:.0f}" for mass in MASSES)
    contours = f"contours around {share} % of the draws"
    handles: dict[Artist, bool] = {
        Patch(label="posterior", **_TOLD): told,
        Patch(label=left_open, **_OPEN): bool(open_),
        Line2D([], [], label="prior", **_PRIOR): True,
        Line2D([], [], label=f"{100 * LEVEL:.0f} % interval", **_END): told,
        Line2D([], [], color=POSTERIOR, label=contours): len(cells) > 1,
    }
    return [handle for handle, needed in handles.items() if needed]


@dataclass(frozen=True, eq=False)
class Quantity:
    """A sampled parameter, or a combination of them, as figures show it."""

    name: str  # as in `posterior.names`, or of the derived quantity
    symbol: str  # with dollar signs, ready for Matplotlib
    unit: str  # SI, empty where there is none
    draws: Array  # `(n,)` in `unit`; walkers that never moved are left out
    prior: Prior | None  # of the parameter; `None` of a combination

    @property
    def exponent(self) -> int:
        """Power of ten that is taken out of the numbers on an axis."""
        low, high = (float(v) for v in np.quantile(self.draws, [0.05, 0.95]))
        return power_of_ten(low, high)

    def label(self, between: str = " ") -> str:
        """Symbol and unit for an axis, with ``between`` between them."""
        return f"{self.symbol}{between}({scaled_unit(self.exponent, self.unit)})"

    def nearly_all(self, margin: float) -> tuple[float, float]:
        """Give an axis nearly all draws and a share of their width, nothing beyond the support."""
        low, high = (float(v) for v in np.quantile(self.draws, [0.001, 0.999]))
        room = margin * (high - low) or 0.05 * abs(low) or 1.0
        if self.prior is None:
            return low - room, high + room
        lower, upper = self.prior.lower, self.prior.upper
        return max(low - room, min(lower, low)), min(high + room, max(upper, high))


def quantities(fit: Fit) -> list[Quantity]:
    """List the sampled parameters of a fit, noise scales last."""
    posterior = fit.posterior
    said = {p.name: described_as(p) for p in fit.chain.parameters} | noise_described(fit)
    return [
        Quantity(name, mathtext(said[name]["symbol"], name), said[name]["unit"], draws, prior)
        for name, draws, prior in zip(
            posterior.names, posterior.flat().T, posterior.priors, strict=True
        )
    ]


def combinations(fit: Fit) -> list[Quantity]:
    """List what no scaling of leg parameters and alpha changes, where every draw has it."""
    # without a load no efficiency is stated
    return [
        Quantity(d.name, mathtext(d.symbol, d.name), d.unit, d.values, None)
        for d in derive(fit.chain, fit.chain_draws(), 0.0)
        if d.gauge_free and np.isfinite(d.values).all()
    ]


def which_posterior(summary: Summary) -> str:
    """Say of which posterior figures are whose intervals stand in the tables, where it matters."""
    wide = " Densities and intervals have room for the model's error, as in the tables."
    words = wide if summary.widened else ""
    if biased := [n for n, row in summary.rows.items() if row.reported and row.reported.how.bias]:
        words += f" The bias of filters and encoder is not taken off: {', '.join(biased)}."
    return words


FIGURE = RunFigure(
    stem="corner",
    title="Marginal and pairwise posteriors",
    section="posterior",
    draw=lambda run: corner_figure(run.fit, run.summary),
    caption=lambda run: (
        f"Diagonal: posterior density with {100 * LEVEL:.0f} % interval, dashed the prior of "
        "parameters. Below: 50 % and 90 % of the draws. What the data leave open is hatched, has "
        "no interval and is not filled in its pairs: there prior and bounds are seen. So is "
        "everything where the sampling has not converged. A limit has one dotted end."
        + which_posterior(run.summary)
    ),
)
