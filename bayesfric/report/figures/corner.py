"""Corner plot: marginal posteriors with their priors, and every pair."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesfric.errors import BadInput, nearest
from bayesfric.inference.fit import Fit
from bayesfric.report.comparison.cell import Cell, posterior_cells
from bayesfric.report.figures.marginal import draw_marginal, marginal_handles, moves
from bayesfric.report.figures.quantity import Quantity, combinations, not_shown, quantities
from bayesfric.report.figures.style import (
    PAGE,
    POSTERIOR,
    SMALL,
    Array,
    few_ticks,
    margins,
    paper_style,
)
from bayesfric.report.summary.summary import LEVEL

# Combinations that come first; parameters want to be seen too.
_COMBINATIONS = 5
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


def corner_figure(
    fit: Fit, summary: Mapping[str, Any], chosen: Sequence[str] | None = None
) -> Figure:
    """Draw marginal and pairwise posteriors.

    On the diagonal the posterior density is a histogram with the prior density of
    parameters dashed on the same scale and the 90 % interval marked; below it contours
    hold 50 % and 90 % of the draws. What the data leave open is hatched, without an
    interval, and its pairs are not filled.

    Parameters
    ----------
    fit
        A finished fit.
    summary
        From :func:`bayesfric.report.summary.summary.summarise`, for what the data determine.
    chosen
        Names of the sampled parameters and of combinations that no scaling changes, in
        the order to show them. If left out, eight: where the data leave parameters
        open, first combinations that they determine, then what they determine of the
        parameters; else the parameters as sampled.

    Returns
    -------
    matplotlib.figure.Figure
        A page wide.

    Raises
    ------
    BadInput
        If a name is not among them, or none is given.
    """
    cells = posterior_cells(summary)
    sampled = quantities(fit)
    # what fixed parameters make up is known, and has no posterior
    combined = [q for q in combinations(fit) if q.name in cells]
    if chosen is None:
        shown = _choice(sampled, combined, cells, fit.target.noise.names)
    else:
        shown = _pick([*combined, *sampled], chosen)
    left_out = [q for q in sampled if q not in shown]
    with paper_style():
        k = len(shown)
        panel = (PAGE - _LEFT - _RIGHT - (k - 1) * _BETWEEN) / k
        figure = Figure(figsize=(PAGE, PAGE - _LEFT - _RIGHT + _BOTTOM + _TOP))
        grid = figure.add_gridspec(
            k,
            k,
            **margins(figure, left=_LEFT, right=_RIGHT, bottom=_BOTTOM, top=_TOP),
            wspace=_BETWEEN / panel,
            hspace=_BETWEEN / panel,
        )
        axes = {(i, j): figure.add_subplot(grid[i, j]) for i in range(k) for j in range(i + 1)}
        draws = [q.draws / q.factor for q in shown]
        ranges = [_range(q, x) for q, x in zip(shown, draws, strict=True)]
        open_ = [cells[q.name].status == "undetermined" for q in shown]
        for (i, j), ax in axes.items():
            if i == j:
                draw_marginal(ax, shown[i], ranges[i], cell=cells[shown[i].name], headroom=1.12)
            else:
                filled = not (open_[i] or open_[j])
                _pair(ax, draws[j], draws[i], ranges[j], ranges[i], filled=filled)
                ax.set_ylim(ranges[i])
                few_ticks(ax.yaxis, 3, inner=True)
            ax.set_xlim(ranges[j])
            few_ticks(ax.xaxis, 3, inner=True)
        _label(axes, shown, panel)
        _legend(figure, left_out, [cells[q.name] for q in shown])
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


def _pick(everything: list[Quantity], chosen: Sequence[str]) -> list[Quantity]:
    known = {q.name: q for q in everything}
    if not chosen:
        raise BadInput("corner", "no parameter chosen", f"choose from {', '.join(known)}")
    for name in chosen:
        if name not in known:
            raise BadInput(
                "corner",
                f"{name} is neither sampled nor a combination that no scaling changes",
                nearest(name, list(known)),
            )
    return [known[name] for name in dict.fromkeys(chosen)]


def _range(q: Quantity, x: Array) -> tuple[float, float]:
    """Nearly all draws and a margin, but nothing beyond the prior's support."""
    low, high = (float(v) for v in np.quantile(x, [0.001, 0.999]))
    if not moves(x):
        margin = 0.05 * abs(low) or 1.0
        return low - margin, low + margin
    margin = 0.06 * (high - low) or 0.5 * float(np.ptp(x))
    if q.prior is None:
        return low - margin, high + margin
    return (
        max(low - margin, min(q.prior.lower / q.factor, low)),
        min(high + margin, max(q.prior.upper / q.factor, high)),
    )


def _pair(
    ax: Axes,
    x: Array,
    y: Array,
    x_limits: tuple[float, float],
    y_limits: tuple[float, float],
    *,
    filled: bool,
) -> None:
    import corner  # brings ArviZ along, which takes a second or more

    if moves(x) and moves(y):
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
            fill_contours=filled,
            contour_kwargs={"linewidths": (0.6, 0.9)},
            quiet=True,
        )
        return
    # a parameter that never changes: the interval of the other one, or a point
    ends = [
        np.quantile(v, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2]) if moves(v) else np.repeat(v[0], 2)
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


def _legend(figure: Figure, left_out: list[Quantity], cells: Sequence[Cell]) -> None:
    share = " and ".join(f"{100 * mass:.0f}" for mass in MASSES)
    k, handles = len(cells), marginal_handles(cells)
    if k > 1:
        handles.append(
            Line2D([], [], color=POSTERIOR, label=f"contours around {share} % of the draws")
        )
    # the empty upper triangle has room
    figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.99, 0.985))
    remark = not_shown(left_out)
    if remark and k > 1:
        below = 0.985 - 0.16 * (len(handles) + 1) / PAGE
        figure.text(0.98, below, remark, ha="right", va="top", fontsize=SMALL)
