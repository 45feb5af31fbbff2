"""Posterior and prior density of one quantity in a panel, hatched where the data leave it open."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayesfric.report.comparison.cell import Cell
from bayesfric.report.figures.quantity import Quantity
from bayesfric.report.figures.style import DASHED, DOTTED, OPEN_HATCH, POSTERIOR, PRIOR, Array, Look
from bayesfric.report.summary.summary import LEVEL

_BINS = 40
_GRID = 301
_OPEN: Look = {
    "facecolor": "none", "edgecolor": POSTERIOR, "linewidth": 0.0, "hatch": OPEN_HATCH
}  # fmt: skip
_TOLD: Look = {
    "facecolor": POSTERIOR, "edgecolor": "none", "linewidth": 0.0, "alpha": 0.3
}  # fmt: skip
_PRIOR: Look = {"color": PRIOR, "linestyle": DASHED}
_END: Look = {"color": POSTERIOR, "linewidth": 0.7, "linestyle": DOTTED}


def draw_marginal(
    ax: Axes, q: Quantity, limits: tuple[float, float], *, cell: Cell, headroom: float
) -> None:
    """Draw the densities of a quantity, both in one over the unit of the axis.

    ``limits`` of the axis are in scaled units; ``cell`` is what the data tell: what they leave open
    has no interval, and a limit one end. ``headroom`` is the height of the panel over that of the
    highest density.
    """
    draws = q.draws / q.factor
    highest = 0.0
    if q.prior is not None:
        grid = np.linspace(*limits, _GRID)
        prior = np.exp(q.prior.log_density(grid * q.factor)) * q.factor
        prior = np.where(np.isfinite(prior), prior, np.nan)
        highest = float(np.nanmax(prior, initial=0.0))
        ax.plot(grid, prior, gid="prior", zorder=3, **_PRIOR)
    if moves(draws):
        height, edges = np.histogram(draws, bins=_BINS, range=limits)
        density = height / (draws.size * np.diff(edges))
        open_ = cell.status == "undetermined"
        gid, look = ("open", _OPEN) if open_ else ("posterior", _TOLD)
        ax.stairs(density, edges, fill=True, gid=gid, **look)
        ax.stairs(density, edges, color=POSTERIOR, linewidth=0.8)
        for end in _ends(cell, draws, q.factor):
            ax.axvline(end, ymax=0.8, **_END)
        peak = float(density.max())
        # a prior may have a pole at its bound; it must not flatten the posterior
        highest = max(peak, min(2.0 * peak, highest))
    else:
        ax.axvline(float(draws[0]), color=POSTERIOR)
    ax.set_xlim(limits)
    ax.set_ylim(0.0, headroom * highest or 1.0)
    ax.set_yticks([])


def _ends(cell: Cell, draws: Array, factor: float) -> list[float]:
    """List what may be marked of an interval: of a limit the end away from the bound."""
    if cell.status == "undetermined":
        return []
    if cell.limit is not None:
        return [cell.limit / factor]
    if cell.interval is not None:  # that of the tables, to the digit
        return [end / factor for end in cell.interval]
    return [float(end) for end in np.quantile(draws, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2])]


def moves(draws: Array) -> bool:
    """Whether draws differ by more than rounding, which leaves no room for a histogram."""
    return bool(np.ptp(draws) > 1e-12 * np.abs(draws).max())


def marginal_handles(cells: Sequence[Cell]) -> list[Artist]:
    """List what a legend explains of panels with these cells."""
    open_ = [cell for cell in cells if cell.status == "undetermined"]
    told = len(open_) < len(cells)
    handles: list[Artist] = [Patch(label="posterior", **_TOLD)] if told else []
    if open_:
        left_open = "posterior that the data leave open"
        disagree = "draws of ensembles that disagree"
        handles.append(Patch(label=left_open if open_[0].converged else disagree, **_OPEN))
    handles.append(Line2D([], [], label="prior", **_PRIOR))
    if told:
        handles.append(Line2D([], [], label=f"{100 * LEVEL:.0f} % interval", **_END))
    return handles
