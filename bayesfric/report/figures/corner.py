"""Corner plot: marginal posteriors with their priors, and every pair."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayesfric.inference.fitting import Fit
from bayesfric.inference.priors import Prior
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
    explained,
    few_ticks,
    mathtext,
    paper_figure,
    power_of_ten,
    scaled_unit,
)
from bayesfric.report.result_row import ResultRow, result_rows
from bayesfric.report.summary.derived_quantities import LEVEL, coefficients
from bayesfric.report.summary.record import Summary, of_noise

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
_KNOWN: Look = {
    "facecolor": POSTERIOR, "edgecolor": "none", "linewidth": 0.0, "alpha": 0.3
}  # fmt: skip
_PRIOR: Look = {"color": PRIOR, "linestyle": DASHED}
_END: Look = {"color": POSTERIOR, "linewidth": 0.7, "linestyle": DOTTED}


def corner_figure(fit: Fit, summary: Summary) -> Figure:
    """Draw marginal and pairwise posteriors of at most eight quantities, a page wide.

    What the data leave open is hatched, without an interval, and its pairs are not filled. Where
    they leave parameters open, combinations that they determine come first.
    """
    sampled, shown = quantities(fit.wide, summary), choice(fit.wide, summary)
    left_out = [q.symbol for q in sampled if q.name not in {quantity.name for quantity in shown}]
    k = len(shown)
    with paper_figure(PAGE, PAGE, apart=0.02) as figure:
        grid = figure.add_gridspec(k, k)
        ranges = [q.nearly_all(0.06) for q in shown]
        for i in range(k):
            for j in range(i + 1):
                ax = figure.add_subplot(grid[i, j])
                if i == j:
                    _marginal(ax, shown[i], ranges[i])
                else:
                    _pair(ax, (shown[j], shown[i]), (ranges[j], ranges[i]))
                few_ticks(ax.xaxis, 3, inner=True, exponent=shown[j].exponent)
                _label(ax, shown[j] if i == k - 1 else None, shown[i] if 0 == j < i else None)
        figure.align_labels()
        # in the empty upper triangle
        handles = explained(figure, _handles())
        figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.99, 0.985))
        if left_out and k > 1:
            below = 0.985 - 0.16 * (len(handles) + 1) / PAGE
            words = f"not shown: {', '.join(left_out)}"
            figure.text(0.98, below, words, ha="right", va="top", fontsize=SMALL)
    return figure


def choice(fit: Fit, summary: Summary) -> list[Quantity]:
    """Choose what to show: what the data determine before what they leave open."""
    sampled = quantities(fit, summary)
    joint = [q for q in sampled if not of_noise(q.name)]
    open_ = [q for q in joint if q.is_open]
    if not open_:
        return sampled[:_MOST]
    combined = [q for q in combinations(fit, summary) if q.row.status == "determined"]
    known = [q for q in joint if not q.is_open]
    noise = [q for q in sampled if of_noise(q.name)]
    return [*combined[:_COMBINATIONS], *known, *open_, *noise][:_MOST]


def _marginal(ax: Axes, q: Quantity, limits: tuple[float, float]) -> None:
    """Draw posterior and prior density of a quantity."""
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
        gid, look = ("open", _OPEN) if q.is_open else ("posterior", _KNOWN)
        ax.stairs(density, edges, fill=True, gid=gid, **look)
        ax.stairs(density, edges, color=POSTERIOR, linewidth=0.8)
        # those of the tables, to the digit; of a limit the end away from the bound
        for end in [q.row.limit] if q.row.limit is not None else q.row.interval or ():
            ax.axvline(end, ymax=0.8, gid="interval", **_END)
        peak = float(density.max())
        # a prior may have a pole at its bound; it must not flatten the posterior
        highest = max(peak, min(2.0 * peak, highest))
    ax.set(xlim=limits, ylim=(0.0, 1.12 * highest or 1.0))
    ax.set_yticks([])


def _moves(draws: Array) -> bool:
    """Whether draws differ by more than rounding, too little for a histogram."""
    return bool(np.ptp(draws) > 1e-12 * np.abs(draws).max())


def _pair(
    ax: Axes, pair: tuple[Quantity, Quantity], limits: tuple[tuple[float, float], ...]
) -> None:
    import corner  # brings ArviZ along, which takes a second or more

    if all(_moves(q.draws) for q in pair):
        look: Look = {"color": POSTERIOR, "contour_kwargs": {"linewidths": (0.6, 0.9)}}
        look |= {"plot_datapoints": False, "plot_density": False}
        look |= {"fill_contours": not any(q.is_open for q in pair)}
        look |= {"bins": _BINS, "range": list(limits), "levels": MASSES, "smooth": _SMOOTH}
        corner.hist2d(*(q.draws for q in pair), ax=ax, quiet=True, **look)
        ax.set_gid("contours")
    ax.set(xlim=limits[0], ylim=limits[1])
    few_ticks(ax.yaxis, 3, inner=True, exponent=pair[1].exponent)


def _label(ax: Axes, below: Quantity | None, left: Quantity | None) -> None:
    """Label an outer panel, on two lines: a panel is hardly wider than a unit."""
    # upright: neighbours leave a number no room, and gaps stay equal
    ax.tick_params(axis="x", labelrotation=90, labelbottom=below is not None)
    ax.tick_params(axis="y", labelleft=left is not None)
    if below is not None:
        ax.set_xlabel(below.label("\n"), linespacing=1.3, fontsize=SMALL)
    if left is not None:
        ax.set_ylabel(left.label("\n"), linespacing=1.3, fontsize=SMALL)


def _handles() -> list[Artist]:
    """List what the legend explains."""
    share = " and ".join(f"{100 * mass:.0f}" for mass in MASSES)
    contours = f"contours around {share} % of the draws"
    return [
        Patch(label="posterior", gid="posterior", **_KNOWN),
        Patch(label="posterior that the data leave open", gid="open", **_OPEN),
        Line2D([], [], label="prior", gid="prior", **_PRIOR),
        Line2D([], [], label=f"{100 * LEVEL:.0f} % interval", gid="interval", **_END),
        Line2D([], [], color=POSTERIOR, label=contours, gid="contours"),
    ]


@dataclass(frozen=True, eq=False)
class Quantity:
    """A sampled parameter, or a combination of them, as figures show it."""

    row: ResultRow
    draws: Array  # `(n,)`; walkers that never moved are left out
    prior: Prior | None = None  # of the parameter; `None` of a combination

    @property
    def name(self) -> str:
        """As in the summary."""
        return self.row.name

    @property
    def symbol(self) -> str:
        """With dollar signs, ready for Matplotlib."""
        return mathtext(self.row.symbol, self.name)

    @property
    def is_open(self) -> bool:
        """Whether the data leave it open."""
        return self.row.status == "undetermined"

    @property
    def exponent(self) -> int:
        """Power of ten that is taken out of the numbers on an axis."""
        low, high = (float(v) for v in np.quantile(self.draws, [0.05, 0.95]))
        return power_of_ten(low, high)

    def label(self, between: str = " ") -> str:
        """Symbol and unit for an axis, with ``between`` between them."""
        return f"{self.symbol}{between}({scaled_unit(self.exponent, self.row.unit)})"

    def nearly_all(self, margin: float) -> tuple[float, float]:
        """Give an axis nearly all draws and a share of their width, nothing beyond the support."""
        low, high = (float(v) for v in np.quantile(self.draws, [0.001, 0.999]))
        room = margin * (high - low) or 0.05 * abs(low) or 1.0
        if self.prior is None:
            return low - room, high + room
        lower, upper = self.prior.lower, self.prior.upper
        return max(low - room, min(lower, low)), min(high + room, max(upper, high))


def quantities(fit: Fit, summary: Summary) -> list[Quantity]:
    """List the sampled parameters of a fit, noise scales last."""
    posterior, rows = fit.posterior, result_rows(summary)
    columns = zip(posterior.names, posterior.flat().T, posterior.priors, strict=True)
    return [Quantity(rows[name], x, prior) for name, x, prior in columns]


def combinations(fit: Fit, summary: Summary) -> list[Quantity]:
    """List what no scaling of leg parameters and alpha changes, where every draw has it."""
    rows = result_rows(summary)
    return [
        Quantity(rows[q.name], q.values)
        for q in coefficients(fit).quantities
        # those of fixed parameters only have no posterior
        if q.gauge_free and q.name in summary.derived and np.isfinite(q.values).all()
    ]


def which_posterior(summary: Summary) -> str:
    """Say that densities are of the widened posterior, where they are."""
    wide = " Densities and intervals allow for model discrepancy, as in the tables."
    return wide if summary.widened else ""


FIGURE = RunFigure(
    stem="corner",
    title="Marginal and pairwise posteriors",
    section="posterior",
    draw=lambda run: corner_figure(run.fit, run.summary),
    caption=lambda run: (
        f"Diagonal: posterior density with {100 * LEVEL:.0f} % interval, dashed the prior of "
        "parameters. Below: 50 % and 90 % of the draws. What the data leave open is hatched, has "
        "no interval and is not filled in its pairs: it shows prior and bounds. So is "
        "everything where the sampling has not converged. A limit has one dotted end."
        + which_posterior(run.summary)
    ),
)
