"""Posterior and prior density of one quantity in a panel, hatched where the data leave it open."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayesfric.report.figures.quantity import Quantity
from bayesfric.report.figures.style import OPEN_HATCH, POSTERIOR, PRIOR, Array
from bayesfric.report.summary.summary import LEVEL

_BINS = 40
_GRID = 301
_DASHED = (0, (4.0, 1.5))
_DOTTED = (0, (1.0, 1.0))


def draw_marginal(
    ax: Axes, q: Quantity, limits: tuple[float, float], *, open_: bool, headroom: float
) -> None:
    """Draw the densities of a quantity, both in one over the unit of the axis.

    Parameters
    ----------
    ax
        Its limits are set.
    q
        The quantity; its draws are a histogram, its prior a line.
    limits
        Of the axis, in scaled units.
    open_
        Whether the data leave it open: then it has no interval.
    headroom
        Height of the panel over that of the highest density.
    """
    draws = q.draws / q.factor
    highest = 0.0
    if q.prior is not None:
        grid = np.linspace(*limits, _GRID)
        prior = np.exp(q.prior.log_density(grid * q.factor)) * q.factor
        prior = np.where(np.isfinite(prior), prior, np.nan)
        highest = float(np.nanmax(prior, initial=0.0))
        ax.plot(grid, prior, color=PRIOR, linestyle=_DASHED, gid="prior", zorder=3)
    if moves(draws):
        height, edges = np.histogram(draws, bins=_BINS, range=limits)
        density = height / (draws.size * np.diff(edges))
        ax.stairs(
            density,
            edges,
            fill=True,
            facecolor="none" if open_ else POSTERIOR,
            edgecolor=POSTERIOR if open_ else "none",
            alpha=1.0 if open_ else 0.3,
            hatch=OPEN_HATCH if open_ else None,
            linewidth=0.0,
            gid="open" if open_ else "posterior",
        )
        ax.stairs(density, edges, color=POSTERIOR, linewidth=0.8)
        if not open_:
            for bound in np.quantile(draws, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2]):
                ax.axvline(bound, ymax=0.8, color=POSTERIOR, linewidth=0.7, linestyle=_DOTTED)
        peak = float(density.max())
        # a prior may have a pole at its bound; it must not flatten the posterior
        highest = max(peak, min(2.0 * peak, highest))
    else:
        ax.axvline(float(draws[0]), color=POSTERIOR)
    ax.set_xlim(limits)
    ax.set_ylim(0.0, headroom * highest or 1.0)
    ax.set_yticks([])


def moves(draws: Array) -> bool:
    """Whether draws differ by more than rounding, which leaves no room for a histogram."""
    return bool(np.ptp(draws) > 1e-12 * np.abs(draws).max())


def marginal_handles(*, open_: bool) -> list[Artist]:
    """List what a legend explains; with ``open_`` also the hatched ones."""
    handles: list[Artist] = [Patch(facecolor=POSTERIOR, alpha=0.3, label="posterior")]
    if open_:
        look: dict[str, Any] = {"facecolor": "none", "edgecolor": POSTERIOR, "linewidth": 0.0}
        label = "posterior that the data leave open"
        handles.append(Patch(hatch=OPEN_HATCH, label=label, **look))
    share = f"{100 * LEVEL:.0f} % interval"
    return [
        *handles,
        Line2D([], [], color=PRIOR, linestyle=_DASHED, label="prior"),
        Line2D([], [], color=POSTERIOR, linewidth=0.7, linestyle=_DOTTED, label=share),
    ]
