"""Corner plot: marginal posteriors with their priors, and every pair."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesfric.errors import BadInput, nearest
from bayesfric.inference.fitting import Fit
from bayesfric.report.comparison.cell import Cell, posterior_cells
from bayesfric.report.figures.marginal import draw_marginal, marginal_handles, moves
from bayesfric.report.figures.quantity import (
    Quantity,
    combinations,
    not_shown,
    quantities,
    which_posterior,
)
from bayesfric.report.figures.registry import RunFigure
from bayesfric.report.figures.style import (
    PAGE,
    POSTERIOR,
    SMALL,
    Array,
    Look,
    few_ticks,
    paper_figure,
)
from bayesfric.report.page.values import rows_in_words
from bayesfric.report.summary.record import Summary
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


def corner_figure(fit: Fit, summary: Summary, chosen: Sequence[str] | None = None) -> Figure:
    """Draw marginal and pairwise posteriors, a page wide.

    On the diagonal the posterior density is a histogram with the prior density of
    parameters dashed on the same scale and the 90 % interval marked; below it contours
    hold 50 % and 90 % of the draws. What the data leave open is hatched, without an
    interval, and its pairs are not filled.

    ``chosen`` are names of sampled parameters and of combinations that no scaling changes, in the
    order to show them; ``BadInput`` where a name is not among them, or none is given. If left out,
    eight: where the data leave parameters open, first combinations that they determine, then what
    they determine of the parameters; else the parameters as sampled.
    """
    return _drawn(*_parts(fit, summary, chosen))


def _parts(
    fit: Fit, summary: Summary, chosen: Sequence[str] | None = None
) -> tuple[list[Quantity], list[Cell], list[Quantity]]:
    """Give what is shown, what is said of each, and what is left out."""
    cells = posterior_cells(summary)
    sampled = quantities(fit.wide)
    # what fixed parameters make up is known, and has no posterior
    combined = [q for q in combinations(fit.wide) if q.name in cells]
    if chosen is None:
        shown = _choice(sampled, combined, cells, fit.target.noise.names)
    else:
        shown = _pick([*combined, *sampled], chosen)
    return shown, [cells[q.name] for q in shown], [q for q in sampled if q not in shown]


def _drawn(shown: list[Quantity], judged: list[Cell], left_out: list[Quantity]) -> Figure:
    k = len(shown)
    with paper_figure(PAGE, PAGE, apart=0.02) as figure:
        grid = figure.add_gridspec(k, k)
        draws = [q.draws / q.factor for q in shown]
        ranges = [q.nearly_all(0.06) for q in shown]
        open_ = [cell.status == "undetermined" for cell in judged]
        for i in range(k):
            for j in range(i + 1):
                ax = figure.add_subplot(grid[i, j])
                if i == j:
                    draw_marginal(ax, shown[i], ranges[i], cell=judged[i], headroom=1.12)
                else:
                    filled = not (open_[i] or open_[j])
                    _pair(ax, (draws[j], draws[i]), (ranges[j], ranges[i]), filled=filled)
                _label(ax, shown[j] if i == k - 1 else None, shown[i] if 0 == j < i else None)
        figure.align_labels()
        _legend(figure, left_out, judged)
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


def _pair(
    ax: Axes,
    pair: tuple[Array, Array],
    limits: tuple[tuple[float, float], tuple[float, float]],
    *,
    filled: bool,
) -> None:
    import corner  # brings ArviZ along, which takes a second or more

    if all(map(moves, pair)):
        look: Look = {"color": POSTERIOR, "contour_kwargs": {"linewidths": (0.6, 0.9)}}
        look |= {"plot_datapoints": False, "plot_density": False, "fill_contours": filled}
        look |= {"bins": _BINS, "range": list(limits), "levels": MASSES, "smooth": _SMOOTH}
        corner.hist2d(*pair, ax=ax, quiet=True, **look)
    else:
        # a parameter that never changes: the interval of the other one, or a point
        ends = [
            np.quantile(v, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2]) if moves(v) else np.repeat(v[0], 2)
            for v in pair
        ]
        ax.plot(*ends, color=POSTERIOR, marker=".", markersize=3.0)
    ax.set_xlim(limits[0])
    ax.set_ylim(limits[1])
    few_ticks(ax.yaxis, 3, inner=True)


def _label(ax: Axes, below: Quantity | None, beside: Quantity | None) -> None:
    """Label an outer panel, on two lines: a panel is hardly wider than a unit."""
    few_ticks(ax.xaxis, 3, inner=True)
    # upright: neighbours leave a number no room, and gaps stay equal
    ax.tick_params(axis="x", labelrotation=90, labelbottom=below is not None)
    ax.tick_params(axis="y", labelleft=beside is not None)
    if below is not None:
        ax.set_xlabel(below.label("\n"), linespacing=1.3, fontsize=SMALL)
    if beside is not None:
        ax.set_ylabel(beside.label("\n"), linespacing=1.3, fontsize=SMALL)


def _legend(figure: Figure, left_out: list[Quantity], cells: Sequence[Cell]) -> None:
    """Explain in the empty upper triangle."""
    handles, remark = marginal_handles(cells), not_shown(left_out)
    if len(cells) > 1:
        share = " and ".join(f"{100 * mass:.0f}" for mass in MASSES)
        words = f"contours around {share} % of the draws"
        handles.append(Line2D([], [], color=POSTERIOR, label=words))
        below = 0.985 - 0.16 * (len(handles) + 1) / PAGE
        figure.text(0.98, below, remark, ha="right", va="top", fontsize=SMALL)
    figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.99, 0.985))


FIGURE = RunFigure(
    stem="corner",
    title="Marginal and pairwise posteriors",
    section="posterior",
    place=1,
    draw=lambda run: partial(_drawn, *_parts(run.fit, run.summary)),
    caption=lambda run: (
        f"Diagonal: posterior density with {100 * LEVEL:.0f} % interval, dashed the prior of "
        "parameters. Below: 50 % and 90 % of the draws. What the data leave open is hatched, has "
        "no interval and is not filled in its pairs: there prior and bounds are seen. So is "
        "everything where the sampling has not converged. A limit has one dotted end."
        + which_posterior(run.summary)
    ),
    alternative=lambda judged: rows_in_words(
        row for row in judged.table.rows if row.group in ("free", "parameter")
    ),
)
