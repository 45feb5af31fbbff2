"""Posterior draws: corner plot with priors, and the ridge of a scaling that no torque shows."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
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
    # what never moved has no histogram
    moved = [x for x in choice(fit.wide, summary) if np.ptp(x[1]) > 1e-12 * abs(x[1]).max()]
    if not (shown := moved[:max_count]):
        return None
    number, ends = len(shown), [_limits(*x[1:]) for x in shown]
    away = -0.057 * number  # of labels, in heights of a panel
    with style.paper_style():
        figure = Figure(figsize=(style.PAGE, style.PAGE))
        room: Look = {"left": 0.1, "bottom": 0.12, "right": 0.99, "top": 0.99}
        grid = figure.add_gridspec(number, number, wspace=0.08, hspace=0.08, **room)
        diagonal: list[Axes] = []
        for k, quantity in enumerate(shown):
            row: list[Axes] = []
            for other, above in enumerate(diagonal):
                shared = row[0] if row else None
                row.append(figure.add_subplot(grid[k, other], sharex=above, sharey=shared))
                _pair(row[-1], shown[other], quantity, (ends[other], ends[k]))
                row[-1].tick_params(labelleft=not other, labelbottom=False)
            if row:
                _numbers(row[0].yaxis, quantity[0], (away, 0.5))
            diagonal.append(figure.add_subplot(grid[k, k]))
            _marginal(diagonal[k], *quantity)
        for ax, quantity in zip([*row, diagonal[-1]], shown, strict=True):
            # upright: neighbours leave a number no room
            ax.tick_params(axis="x", labelrotation=90, labelbottom=True)
            _numbers(ax.xaxis, quantity[0], (0.5, away))
        # in the empty upper triangle
        share = " and ".join(f"{100 * mass:.0f}" for mass in MASSES)
        contours = Line2D([], [], color=style.POSTERIOR, label=f"around {share} % of the draws")
        handles = [*style.labelled(figure), contours]
        figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.99, 0.985))
    return figure


@cache
def _hist2d() -> Any:
    """Load that function of corner, without the package, which imports ArviZ."""
    package: Any = find_spec("corner")
    path = Path(package.submodule_search_locations[0], "core.py")
    spec: Any = spec_from_file_location("bayesfric.corner_core", path)
    core = module_from_spec(spec)
    spec.loader.exec_module(core)
    return core.hist2d


def _pair(ax: Axes, across: Shown, up: Shown, ends: Sequence[tuple[float, float]]) -> None:
    """Draw contours around most draws of two quantities, filled if the data determine both."""
    filled = "unidentified" not in (across[0].status, up[0].status)
    _hist2d()(
        across[1], up[1], ax=ax, range=ends, bins=40, color=style.POSTERIOR, levels=MASSES,
        # in bins: closed contours from some thousand draws, hardly wider
        smooth=1.2, fill_contours=filled, no_fill_contours=True, plot_datapoints=False,
        plot_density=False, contour_kwargs={"linewidths": (0.6, 0.9)}, quiet=True,
    )  # fmt: skip
    ax.set(xlim=ends[0], ylim=ends[1])
    for axis in (ax.xaxis, ax.yaxis):  # without numbers, but at the edge
        axis.get_offset_text().set_visible(False)


def _numbers(axis: Axis, row: ResultRow, place: tuple[float, float]) -> None:
    """Put few numbers on an axis, and a label on two lines: a panel is hardly wider than a unit.

    The numbers' power of ten is before the unit: at the axis' end is another panel.
    """
    style.few_ticks(axis, 3, inner=True)
    label = style.axis_label(row.symbol, row.name, row.unit, "\n")
    axis.set_label_text(label, fontsize=style.SMALL, linespacing=1.3)
    axis.set_label_coords(*place)
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
    ax.stairs(density, edges, color=style.POSTERIOR, linewidth=0.8)
    ax.set_yticks([])
    ax.tick_params(labelbottom=False)
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
