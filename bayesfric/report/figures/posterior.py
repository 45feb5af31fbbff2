"""Posterior draws: corner plot with priors, and the ridge of a scaling that no torque shows."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesfric.inference.fitting import Fit
from bayesfric.inference.priors import Prior
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.scaling import Scaling, scalings
from bayesfric.report.figures import style
from bayesfric.report.figures.style import Array, Look
from bayesfric.report.result_row import ResultRow, result_rows
from bayesfric.report.summary.derived_quantities import LEVEL, coefficients
from bayesfric.report.summary.record import Summary, of_noise

# Share of the draws inside the contours.
MASSES = (0.5, 0.9)
_OPEN: Look = {
    "facecolor": "none", "edgecolor": style.POSTERIOR, "hatch": style.OPEN_HATCH,
    "label": "posterior that the data leave open", "gid": "open",
}  # fmt: skip
_KNOWN: Look = {
    "facecolor": style.POSTERIOR, "alpha": 0.3, "label": "posterior", "gid": "posterior",
}  # fmt: skip
# A parameter, or a combination of them without a prior, with its draws `(n,)`.
Shown = tuple[ResultRow, Array, Prior | None]


def corner_figure(fit: Fit, summary: Summary, max_count: int = 8) -> Figure | None:
    """Draw marginal and pairwise posteriors of at most ``max_count`` quantities, a page wide.

    What the data leave open is hatched, without an interval, and its pairs are not filled. Where
    they leave parameters open, combinations that they determine come first.
    """
    import corner  # brings ArviZ along, which takes a second or more

    # what never moved has no histogram
    moved = [x for x in choice(fit.wide, summary) if np.ptp(x[1]) > 1e-12 * abs(x[1]).max()]
    if not (shown := moved[:max_count]):
        return None
    number, is_open = len(shown), [row.status == "unidentified" for row, *_ in shown]
    with style.paper_style():
        figure = Figure(figsize=(style.PAGE, style.PAGE))
        corner.corner(
            np.stack([draws for _, draws, _ in shown], axis=1),
            fig=figure, range=[_limits(*x[1:]) for x in shown], bins=40, color=style.POSTERIOR,
            # on two lines: a panel is hardly wider than a unit
            labels=[style.axis_label(r.symbol, r.name, r.unit, "\n") for r, *_ in shown],
            label_kwargs={"fontsize": style.SMALL, "linespacing": 1.3}, use_math_text=True,
            # in bins: closed contours from some thousand draws, hardly wider
            smooth=1.2, levels=MASSES, fill_contours=True, plot_datapoints=False,
            plot_density=False, contour_kwargs={"linewidths": (0.6, 0.9)},
            hist_kwargs={"density": True, "linewidth": 0.8}, quiet=True,
        )  # fmt: skip
        figure.subplots_adjust(0.1, 0.12, 0.99, 0.99, wspace=0.08, hspace=0.08)
        away = -0.057 * number  # of labels, in heights of a panel
        axes = np.array(figure.axes).reshape(number, number)
        for k, quantity in enumerate(shown):
            _marginal(axes[k, k], *quantity)
            style.few_ticks(axes[-1, k].xaxis, 3, inner=True)
            # upright: neighbours leave a number no room
            axes[-1, k].tick_params(axis="x", labelrotation=90)
            axes[-1, k].xaxis.set_label_coords(0.5, away)
            _power_in_label(axes[-1, k].xaxis)
            if k:
                style.few_ticks(axes[k, 0].yaxis, 3, inner=True)
                axes[k, 0].tick_params(axis="y", labelrotation=0)
                axes[k, 0].yaxis.set_label_coords(away, 0.5)
                _power_in_label(axes[k, 0].yaxis)
            for other in range(k):
                if is_open[k] or is_open[other]:
                    for contours in axes[k, other].collections:
                        contours.set_visible(not getattr(contours, "filled", False))
        # in the empty upper triangle
        share = " and ".join(f"{100 * mass:.0f}" for mass in MASSES)
        contours = Line2D([], [], color=style.POSTERIOR, label=f"around {share} % of the draws")
        handles = [*style.labelled(figure), contours]
        figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.99, 0.985))
    return figure


def _power_in_label(axis: Axis) -> None:
    """Write the numbers' power of ten before the unit: at the axis' end is another panel."""
    formatter = axis.get_major_formatter()
    formatter.set_locs(axis.get_majorticklocs())  # type: ignore[arg-type]
    symbol, _, unit = axis.get_label_text().rpartition("(")
    axis.set_label_text(f"{symbol}({f'{formatter.get_offset()} {unit}'.lstrip()}")
    axis.get_offset_text().set_visible(False)


def choice(fit: Fit, summary: Summary) -> list[Shown]:
    """Order what to show: what the data determine before what they leave open."""
    posterior, rows = fit.posterior, result_rows(summary)
    columns = zip(posterior.names, posterior.flat().T, posterior.priors, strict=True)
    sampled: list[Shown] = [(rows[name], draws, prior) for name, draws, prior in columns]
    if not any(row.status == "unidentified" for row, *_ in sampled if not of_noise(row.name)):
        return sampled
    # what no scaling of the leg and alpha changes, where every draw has it; but first parameters
    combined: list[Shown] = [
        (rows[q.name], q.values, None)
        for q in coefficients(fit).quantities
        if q.gauge_free and q.name in summary.derived and np.isfinite(q.values).all()
    ]
    combined = [x for x in combined if x[0].sd is not None]
    sampled.sort(key=lambda x: (of_noise(x[0].name), x[0].status == "unidentified"))
    return [*combined[:5], *sampled]


def _limits(draws: Array, prior: Prior | None) -> tuple[float, float]:
    """Give an axis nearly all draws and some margin, nothing beyond the prior's support."""
    low, high = (float(v) for v in np.quantile(draws, [0.001, 0.999]))
    margin = 0.06 * (high - low)
    lower, upper = (prior.lower, prior.upper) if prior else (-np.inf, np.inf)
    return max(low - margin, min(lower, low)), min(high + margin, max(upper, high))


def _marginal(ax: Axes, row: ResultRow, draws: Array, prior: Prior | None) -> None:
    """Fill a posterior density and draw the prior over it."""
    low, high = _limits(draws, prior)
    density, edges = np.histogram(draws, 40, (low, high), density=True)
    look = _OPEN if row.status == "unidentified" else _KNOWN
    ax.stairs(density, edges, fill=True, linewidth=0.0, **look)
    if prior is not None:
        grid = np.linspace(low, high, 301)
        line: Look = {"color": style.PRIOR, "linestyle": style.DASHED, "gid": "prior"}
        ax.plot(grid, np.exp(prior.log_density(grid)), label="prior", zorder=3, **line)
    for end in [row.limit] if row.limit is not None else row.interval or ():
        line = {"color": style.POSTERIOR, "linewidth": 0.7, "linestyle": style.DOTTED}
        ax.axvline(end, ymax=0.8, label=f"{100 * LEVEL:.0f} % interval", gid="interval", **line)
    ax.set(xlim=(low, high), ylim=(0.0, 1.12 * density.max()))


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

    def values(parameters: Array) -> dict[str, tuple[str, Array]]:
        """Give label and values of parameters and derived quantities."""
        table: list[tuple[Any, Array]] = [*zip(fit.chain.parameters, parameters.T, strict=True)]
        table += [(q, q.values) for q in derive(fit.chain, parameters, 0.0)]
        return {q.name: (style.axis_label(q.symbol, q.name, q.unit), x) for q, x in table}

    with np.errstate(divide="ignore", invalid="ignore"):  # an irreversible gearbox has no alpha_2
        draws, line = values(fit.chain_draws(1500)), values(along)
    # those of the load come last, and are of most interest
    names = [*scaling.behind[:-3:-1], f"{scaling.element}.alpha_back"]
    along_x = f"{scaling.element}.alpha_drive"
    with style.paper_figure(style.PAGE, 2.7) as figure:
        for ax, name in zip(style.panel_grid(figure, len(names), len(names)), names, strict=True):
            dots: Look = {"marker": ".", "markersize": 2.2, "markeredgewidth": 0.0, "alpha": 0.25}
            dots |= {"linestyle": "none", "color": style.POSTERIOR, "rasterized": True}
            ax.plot(draws[along_x][1], draws[name][1], gid="posterior", **dots)
            ax.plot([], [], ".", color=style.POSTERIOR, label="posterior")
            x, y = line[along_x][1], line[name][1]
            label = "same torque, without added mass"
            ax.plot(x, y, color=style.PALETTE[0], label=label, gid="line")
            for k, marker, i, factor in zip((0, -1), "s^", (2, 1), bounds, strict=True):
                if factor > 0.0:
                    label = rf"end $\alpha_{i} = 1$, $k = 1/\alpha_{i} = {factor:.2f}$"
                    look: Look = {"marker": marker, "markerfacecolor": "white", "markersize": 5.0}
                    look |= {"markeredgecolor": style.PALETTE[0], "linestyle": "none"}
                    ax.plot(x[k], y[k], label=label, **look)
            ax.set(xlabel=draws[along_x][0], ylabel=draws[name][0])
            style.few_ticks(ax.xaxis, 5)
            style.few_ticks(ax.yaxis, 5)
        style.legend_above(figure)
    return figure
