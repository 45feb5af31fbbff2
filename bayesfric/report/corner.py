"""Corner plot: marginal posteriors with their priors, and every pair."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayesfric.errors import BadInput, nearest
from bayesfric.inference.fit import Fit
from bayesfric.report.quantity import Quantity, not_shown, quantities
from bayesfric.report.style import PAGE, POSTERIOR, PRIOR, SMALL, Array, few_ticks, paper_style
from bayesfric.report.summary import LEVEL

# More panels than 8 by 8 cannot be read at the width of a page.
_MOST = 8
# Share of the draws inside the contours.
MASSES = (0.5, 0.9)
_BINS = 40
# In bins: enough for closed contours from some thousand draws, too little to widen them.
_SMOOTH = 1.2

# Characters of a number there is room for beside a panel; longer ones are turned.
_WIDEST = 6

_LEFT, _RIGHT, _BOTTOM, _TOP, _BETWEEN = 0.72, 0.06, 0.66, 0.06, 0.05


def corner_figure(fit: Fit, chosen: Sequence[str] | None = None) -> Figure:
    """Draw marginal and pairwise posteriors.

    On the diagonal the posterior density is a histogram with the prior density
    dashed on the same scale and the 90 % interval marked; below it contours hold
    50 % and 90 % of the draws.

    Parameters
    ----------
    fit
        A finished fit.
    chosen
        Names of the parameters to show, in this order. If left out, the first
        eight of the sampled ones, the chain's before the noise scales.

    Returns
    -------
    matplotlib.figure.Figure
        A page wide.

    Raises
    ------
    BadInput
        If a name is not among the sampled parameters, or none is given.
    """
    everything = quantities(fit)
    shown = everything[:_MOST] if chosen is None else _pick(everything, chosen)
    left_out = [q for q in everything if q not in shown]
    with paper_style():
        k = len(shown)
        panel = (PAGE - _LEFT - _RIGHT - (k - 1) * _BETWEEN) / k
        figure = Figure(figsize=(PAGE, PAGE - _LEFT - _RIGHT + _BOTTOM + _TOP))
        grid = figure.add_gridspec(
            k,
            k,
            left=_LEFT / PAGE,
            right=1.0 - _RIGHT / PAGE,
            bottom=_BOTTOM / figure.get_figheight(),
            top=1.0 - _TOP / figure.get_figheight(),
            wspace=_BETWEEN / panel,
            hspace=_BETWEEN / panel,
        )
        axes = {(i, j): figure.add_subplot(grid[i, j]) for i in range(k) for j in range(i + 1)}
        draws = [q.draws.ravel() / q.factor for q in shown]
        ranges = [_range(q, x) for q, x in zip(shown, draws, strict=True)]
        for (i, j), ax in axes.items():
            if i == j:
                _marginal(ax, shown[i], draws[i], ranges[i])
            else:
                _pair(ax, draws[j], draws[i], ranges[j], ranges[i])
                ax.set_ylim(ranges[i])
                few_ticks(ax.yaxis, 3, inner=True)
            ax.set_xlim(ranges[j])
            few_ticks(ax.xaxis, 3, inner=True)
        _label(axes, shown, panel)
        _legend(figure, left_out, k)
    return figure


def _pick(everything: list[Quantity], chosen: Sequence[str]) -> list[Quantity]:
    known = {q.name: q for q in everything}
    if not chosen:
        raise BadInput("corner", "no parameter chosen", f"choose from {', '.join(known)}")
    for name in chosen:
        if name not in known:
            raise BadInput(
                "corner", f"{name} is not a sampled parameter", nearest(name, list(known))
            )
    return [known[name] for name in dict.fromkeys(chosen)]


def _range(q: Quantity, x: Array) -> tuple[float, float]:
    """Nearly all draws and a margin, but nothing beyond the prior's support."""
    low, high = (float(v) for v in np.quantile(x, [0.001, 0.999]))
    if not _moves(x):
        margin = 0.05 * abs(low) or 1.0
        return low - margin, low + margin
    margin = 0.06 * (high - low) or 0.5 * float(np.ptp(x))
    return (
        max(low - margin, min(q.prior.lower / q.factor, low)),
        min(high + margin, max(q.prior.upper / q.factor, high)),
    )


def _moves(x: Array) -> bool:
    # draws that differ in rounding only leave no room for a histogram
    return bool(np.ptp(x) > 1e-12 * np.abs(x).max())


def _marginal(ax: Axes, q: Quantity, x: Array, limits: tuple[float, float]) -> None:
    ax.set_yticks([])
    grid = np.linspace(*limits, 201)
    # a density in one over the unit of the axis, as the histogram is
    prior = np.exp(q.prior.log_density(grid * q.factor)) * q.factor
    if _moves(x):
        height, edges = np.histogram(x, bins=_BINS, range=limits)
        density = height / (x.size * np.diff(edges))
        low, high = np.quantile(x, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2])
        ax.stairs(density, edges, color=POSTERIOR, alpha=0.3, fill=True, gid="posterior")
        ax.stairs(density, edges, color=POSTERIOR, linewidth=0.8)
        for bound in (low, high):
            ax.axvline(bound, color=POSTERIOR, linewidth=0.7, linestyle=(0, (1.0, 1.0)))
        top = float(density.max())
        # a prior may have a pole at its bound; it must not flatten the posterior
        top = max(top, min(2.0 * top, float(prior[np.isfinite(prior)].max(initial=0.0))))
        ax.set_ylim(0.0, 1.12 * top)
    else:
        ax.axvline(float(x[0]), color=POSTERIOR)
        ax.set_ylim(0.0, 1.12 * float(prior[np.isfinite(prior)].max(initial=0.0)) or 1.0)
    ax.plot(grid, prior, color=PRIOR, linestyle=(0, (4.0, 1.5)), gid="prior")


def _pair(
    ax: Axes,
    x: Array,
    y: Array,
    x_limits: tuple[float, float],
    y_limits: tuple[float, float],
) -> None:
    import corner  # brings ArviZ along, which takes a second or more

    if _moves(x) and _moves(y):
        corner.hist2d(
            x,
            y,
            ax=ax,
            bins=_BINS,
            range=[x_limits, y_limits],
            levels=MASSES,
            smooth=_SMOOTH,
            color=POSTERIOR,
            plot_datapoints=False,
            plot_density=False,
            fill_contours=True,
            contour_kwargs={"linewidths": (0.6, 0.9)},
            quiet=True,
        )
        return
    # a parameter that never changes: the interval of the other one, or a point
    ends = [
        np.quantile(v, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2]) if _moves(v) else np.repeat(v[0], 2)
        for v in (x, y)
    ]
    ax.plot(*ends, color=POSTERIOR, marker=".", markersize=3.0)


def _label(axes: dict[tuple[int, int], Axes], shown: list[Quantity], panel: float) -> None:
    """Label the outer panels, on two lines: a panel is hardly wider than a unit."""
    k = len(shown)
    said: dict[str, Any] = {"linespacing": 1.3, "fontsize": SMALL if k > 6 else 8.0}
    for (i, j), ax in axes.items():
        if i < k - 1:
            ax.tick_params(labelbottom=False)
        else:
            ax.set_xlabel(shown[j].label("\n"), **said)
            ax.xaxis.set_label_coords(0.5, -0.32 / panel)
            ax.tick_params(axis="x", labelrotation=45)
        if 0 < j < i:
            ax.tick_params(labelleft=False)
        elif j < i:
            ax.set_ylabel(shown[i].label("\n"), **said)
            ax.yaxis.set_label_coords(-0.40 / panel, 0.5)
            numbers = ax.yaxis.get_major_formatter().format_ticks(
                [float(y) for y in ax.get_yticks()]
            )
            if max(map(len, numbers), default=0) > _WIDEST:
                ax.tick_params(axis="y", labelrotation=45)


def _legend(figure: Figure, left_out: list[Quantity], k: int) -> None:
    share = " and ".join(f"{100 * mass:.0f}" for mass in MASSES)
    handles = [
        Patch(facecolor=POSTERIOR, alpha=0.3, label="posterior density"),
        Line2D([], [], color=PRIOR, linestyle=(0, (4.0, 1.5)), label="prior density"),
        Line2D(
            [],
            [],
            color=POSTERIOR,
            linewidth=0.7,
            linestyle=(0, (1.0, 1.0)),
            label=f"{100 * LEVEL:.0f} % interval",
        ),
    ]
    if k > 1:
        handles.append(
            Line2D([], [], color=POSTERIOR, label=f"contours around {share} % of the draws")
        )
    # the empty upper triangle has room
    figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.99, 0.985))
    remark = not_shown(left_out)
    if remark and k > 1:
        figure.text(0.98, 0.985 - 0.75 / PAGE, remark, ha="right", va="top", fontsize=SMALL)
