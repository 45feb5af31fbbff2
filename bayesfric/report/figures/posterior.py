"""Posterior draws: corner plot with priors, and the ridge of a scaling that no torque shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesfric.inference.fitting import Fit
from bayesfric.inference.priors import Prior
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.scaling import Scaling, scalings
from bayesfric.report.figures import style
from bayesfric.report.figures.style import Array, Look
from bayesfric.report.result_row import ResultRow, result_rows
from bayesfric.report.summary.derived_quantities import LEVEL, coefficients
from bayesfric.report.summary.record import Summary, of_noise

# Share of the draws inside the contours.
MASSES = (0.5, 0.9)
_OPEN: Look = {
    "facecolor": "none", "edgecolor": style.POSTERIOR, "linewidth": 0.0, "hatch": style.OPEN_HATCH,
    "label": "posterior that the data leave open", "gid": "open",
}  # fmt: skip
_KNOWN: Look = {
    "facecolor": style.POSTERIOR, "edgecolor": "none", "linewidth": 0.0, "alpha": 0.3,
    "label": "posterior", "gid": "posterior",
}  # fmt: skip
_PRIOR: Look = {
    "color": style.PRIOR,
    "linestyle": style.DASHED,
    "label": "prior",
    "gid": "prior",
    "zorder": 3,
}
_END: Look = {
    "color": style.POSTERIOR, "linewidth": 0.7, "linestyle": style.DOTTED,
    "label": f"{100 * LEVEL:.0f} % interval", "gid": "interval",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Shown:
    """A sampled parameter, or a combination of them, with its draws ``(n,)``."""

    row: ResultRow
    draws: Array
    prior: Prior | None  # `None` of a combination

    @property
    def limits(self) -> tuple[float, float]:
        """Give an axis nearly all draws and some margin, nothing beyond the prior's support."""
        low, high = (float(v) for v in np.quantile(self.draws, [0.001, 0.999]))
        margin = 0.06 * (high - low)
        lower, upper = (self.prior.lower, self.prior.upper) if self.prior else (-np.inf, np.inf)
        return max(low - margin, min(lower, low)), min(high + margin, max(upper, high))


def corner_figure(fit: Fit, summary: Summary, max_count: int = 8) -> Figure | None:
    """Draw marginal and pairwise posteriors of at most ``max_count`` quantities, a page wide.

    What the data leave open is hatched, without an interval, and its pairs are not filled. Where
    they leave parameters open, combinations that they determine come first.
    """
    import corner  # brings ArviZ along, which takes a second or more

    # what never moved has no histogram
    moved = [q for q in choice(fit.wide, summary) if np.ptp(q.draws) > 1e-12 * abs(q.draws).max()]
    if not (shown := moved[:max_count]):
        return None
    ranges = [quantity.limits for quantity in shown]
    exponents = [style.power_of_ten(*np.quantile(q.draws, [0.05, 0.95]).tolist()) for q in shown]
    # on two lines: a panel is hardly wider than a unit
    labels = [
        f"{style.mathtext(q.row.symbol, q.row.name)}\n({style.scaled_unit(exponent, q.row.unit)})"
        for q, exponent in zip(shown, exponents, strict=True)
    ]
    with style.paper_style():
        figure = Figure(figsize=(style.PAGE, style.PAGE))
        corner.corner(
            np.stack([quantity.draws for quantity in shown], axis=1),
            fig=figure, range=ranges, bins=40, color=style.POSTERIOR, labels=labels,
            label_kwargs={"fontsize": style.SMALL, "linespacing": 1.3},
            # in bins: closed contours from some thousand draws, hardly wider
            smooth=1.2, levels=MASSES, fill_contours=True, plot_datapoints=False,
            plot_density=False, contour_kwargs={"linewidths": (0.6, 0.9)},
            hist_kwargs={"density": True, "linewidth": 0.8}, quiet=True,
        )  # fmt: skip
        figure.subplots_adjust(0.1, 0.12, 0.99, 0.99, wspace=0.08, hspace=0.08)
        away = -0.057 * len(shown)  # of labels, in heights of a panel
        axes = np.array(figure.axes).reshape(len(shown), len(shown))
        for k, quantity in enumerate(shown):
            _marginal(axes[k, k], quantity)
            style.few_ticks(axes[-1, k].xaxis, 3, inner=True, exponent=exponents[k])
            # upright: neighbours leave a number no room
            axes[-1, k].tick_params(axis="x", labelrotation=90)
            axes[-1, k].xaxis.set_label_coords(0.5, away)
            if k:
                style.few_ticks(axes[k, 0].yaxis, 3, inner=True, exponent=exponents[k])
                axes[k, 0].tick_params(axis="y", labelrotation=0)
                axes[k, 0].yaxis.set_label_coords(away, 0.5)
            for other in range(k):
                if _is_open(quantity) or _is_open(shown[other]):
                    for contours in axes[k, other].collections:
                        contours.set_visible(not getattr(contours, "filled", False))
        # in the empty upper triangle
        share = " and ".join(f"{100 * mass:.0f}" for mass in MASSES)
        contours = Line2D([], [], color=style.POSTERIOR, label=f"around {share} % of the draws")
        handles = [*style.labelled(figure), contours]
        figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.99, 0.985))
    return figure


def _is_open(quantity: Shown) -> bool:
    return quantity.row.status == "undetermined"


def choice(fit: Fit, summary: Summary) -> list[Shown]:
    """Order what to show: what the data determine before what they leave open."""
    sampled = quantities(fit, summary)
    groups: dict[str, list[Shown]] = {"known": [], "open": [], "noise": []}
    for quantity in sampled:
        group = "open" if _is_open(quantity) else "known"
        groups["noise" if of_noise(quantity.row.name) else group].append(quantity)
    if not groups["open"]:
        return sampled
    combined = [q for q in combinations(fit, summary) if q.row.status == "determined"]
    # parameters want to be seen, too
    return [*combined[:5], *groups["known"], *groups["open"], *groups["noise"]]


def _marginal(ax: Axes, quantity: Shown) -> None:
    """Fill a posterior density and draw the prior over it."""
    low, high = quantity.limits
    density, edges = np.histogram(quantity.draws, 40, (low, high), density=True)
    ax.stairs(density, edges, fill=True, **(_OPEN if _is_open(quantity) else _KNOWN))
    highest = peak = float(density.max())
    if quantity.prior is not None:
        grid = np.linspace(low, high, 301)
        prior = np.exp(quantity.prior.log_density(grid))
        prior = np.where(np.isfinite(prior), prior, np.nan)
        ax.plot(grid, prior, **_PRIOR)
        # a prior may have a pole at its bound; it must not flatten the posterior
        highest = max(peak, min(2.0 * peak, float(np.nanmax(prior, initial=0.0))))
    # those of the tables, to the digit; of a limit the end away from the bound
    row = quantity.row
    for end in [row.limit] if row.limit is not None else row.interval or ():
        ax.axvline(end, ymax=0.8, **_END)
    ax.set(xlim=(low, high), ylim=(0.0, 1.12 * highest))


def quantities(fit: Fit, summary: Summary) -> list[Shown]:
    """List the sampled parameters of a fit, noise scales last."""
    posterior, rows = fit.posterior, result_rows(summary)
    columns = zip(posterior.names, posterior.flat().T, posterior.priors, strict=True)
    return [Shown(rows[name], draws, prior) for name, draws, prior in columns]


def combinations(fit: Fit, summary: Summary) -> list[Shown]:
    """List what no scaling of leg parameters and alpha changes, where every draw has it."""
    rows = result_rows(summary)
    return [
        Shown(rows[q.name], q.values, None)
        for q in coefficients(fit).quantities
        # those of fixed parameters only have no posterior
        if q.gauge_free and q.name in summary.derived and np.isfinite(q.values).all()
    ]


_DOTS: Look = {
    "linestyle": "none", "marker": ".", "markersize": 2.2, "color": style.POSTERIOR, "alpha": 0.25,
}  # fmt: skip
_MARKER: Look = {
    "linestyle": "none", "markerfacecolor": "white", "markeredgecolor": style.PALETTE[0],
    "markeredgewidth": 0.9,
}  # fmt: skip


def ridge(fit: Fit) -> tuple[Scaling, tuple[float, float], Array] | None:
    """Follow the first scaling of a fit's chain through the posterior's median.

    Give what is multiplied together, the smallest and largest factor
    ``1/alpha_2 <= k <= 1/alpha_1`` (zero where ``mu_2`` is one or more), and the line of equal
    torque ``(101, n_parameters)`` from one end to the other. ``None`` for a chain without an
    element with load-dependent friction by direction.
    """
    if not (known := scalings(fit.chain)):
        return None
    median = np.median(fit.chain_draws(), axis=0)
    low, high = known[0].bounds(median)
    # where nothing ends the line (mu_2 of one or more) it is drawn down to a twentieth
    factors = np.geomspace(max(low, 0.05 * high), high, 101)
    return known[0], (low, high), known[0].scaled(median, factors)


def ridge_figure(fit: Fit) -> Figure | None:
    """Draw the scale that no torque determines: the posterior and the exact line, a page wide.

    ``alpha_1`` is against first moment, load inertia and ``alpha_2``; the line ends where a passive
    gearbox would have ``alpha_2 = 1`` and ``alpha_1 = 1``.
    """
    if (known := ridge(fit)) is None:
        return None
    scaling, bounds, along = known
    element = scaling.element
    # those of the load come last, and are of most interest
    names = [*scaling.behind[:-3:-1], f"{element}.alpha_back"]
    with np.errstate(divide="ignore", invalid="ignore"):  # an irreversible gearbox has no alpha_2
        draws, line = (_values(fit.chain, v) for v in (fit.chain_draws(1500), along))
    ends = [
        (k, marker, rf"end $\alpha_{i} = 1$, $k = 1/\alpha_{i} = {factor:.2f}$")
        for k, marker, i, factor in zip((0, -1), "s^", (2, 1), bounds, strict=True)
        if factor > 0.0
    ]
    with style.paper_figure(style.PAGE, 2.7) as figure:
        for ax, name in zip(style.panel_grid(figure, len(names), len(names)), names, strict=True):
            pair = (f"{element}.alpha_drive", name)
            for quantity, axis in zip(pair, (ax.xaxis, ax.yaxis), strict=True):
                symbol, unit, _ = draws[quantity]
                both = np.concatenate([values[quantity][2] for values in (draws, line)])
                exponent = style.power_of_ten(float(np.nanmin(both)), float(np.nanmax(both)))
                axis.set_label_text(style.axis_label(symbol, quantity, exponent, unit))
                style.few_ticks(axis, 5, exponent=exponent)
            (x, y), (x_line, y_line) = ([q[key][2] for key in pair] for q in (draws, line))
            ax.plot(x, y, gid="posterior", markeredgewidth=0.0, rasterized=True, **_DOTS)
            ax.plot(x_line, y_line, color=style.PALETTE[0], gid="line")
            for k, marker, _ in ends:
                ax.plot(x_line[k], y_line[k], marker=marker, markersize=5.0, **_MARKER)
        dots = Line2D([], [], **_DOTS | {"markersize": 4.0, "alpha": 1.0}, label="posterior")
        words = "same torque, without added mass"
        markers = [
            Line2D([], [], marker=marker, markersize=4.5, label=label, **_MARKER)
            for _, marker, label in ends
        ]
        drawn = Line2D([], [], color=style.PALETTE[0], label=words)
        style.legend_above(figure, [dots, drawn, *markers])
    return figure


def _values(chain: Joint, values: Array) -> dict[str, tuple[str, str, Array]]:
    """Give symbol, unit and values of parameters and derived quantities."""
    parameters = {p.name: (p.symbol, p.unit, values[:, k]) for k, p in enumerate(chain.parameters)}
    return parameters | {q.name: (q.symbol, q.unit, q.values) for q in derive(chain, values, 0.0)}
