"""Profile likelihoods as a figure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesfric.identifiability.profile import DROP_90, Profile, profiles
from bayesfric.inference.fitting import Fit
from bayesfric.report.figures.quantity import Quantity, quantities
from bayesfric.report.figures.style import (
    MEASURED,
    PAGE,
    PALETTE,
    POSTERIOR,
    SMALL,
    Array,
    few_ticks,
    panel_grid,
    paper_figure,
)
from bayesfric.report.summary.summary import LEVEL

_ACROSS = 4
_MOST = 16
# Log-likelihood shown below the best; a chi-square of 12 lies outside any interval.
_DEEPEST = -6.0


def profile_figure(fit: Fit, found: Sequence[Profile] | None = None) -> Figure:
    """Draw the profile log-likelihood of every free parameter.

    Each panel shows the log-likelihood of the torque, minus its largest, with all other
    parameters fitted anew; the line of the 90 % interval that chi-square gives; and the
    posterior's 90 % interval. Hollow markers: another parameter, which is named once,
    stands on a bound there.

    Parameters
    ----------
    fit
        A finished fit.
    found
        From :func:`bayesfric.identifiability.profile.profiles`; made here if left out,
        which takes seconds.

    Returns
    -------
    matplotlib.figure.Figure
        A page wide; at most sixteen parameters.
    """
    by_name = {q.name: q for q in quantities(fit)}
    found = profiles(fit) if found is None else found
    shown = list(found)[:_MOST]
    across = min(_ACROSS, max(len(shown), 1))
    rows = max(-(-len(shown) // across), 1)
    with paper_figure(PAGE, 0.24 + rows * 1.64) as figure:
        panels = panel_grid(figure, len(shown), across)
        symbols = {q.name: q.symbol for q in by_name.values()}
        for k, profile in enumerate(shown):
            ax = panels[k]
            _panel(ax, profile, by_name[profile.name], symbols)
            if k % across == 0:
                ax.set_ylabel(r"$\Delta$ log-likelihood")
            else:
                ax.tick_params(axis="y", labelleft=False)
        _legend(figure)
    return figure


def _panel(ax: Axes, profile: Profile, q: Quantity, symbols: dict[str, str]) -> None:
    ax.set_gid(profile.name)
    x = profile.values / q.factor
    ax.axhline(
        DROP_90, color=PALETTE[2], linewidth=0.8, linestyle=(0, (4.0, 1.5)), gid="chi-square"
    )
    ax.plot(x, profile.drop, color=PALETTE[0], zorder=2, gid="profile")
    held = np.array([bool(names) for names in profile.on_bound])
    for which, face, gid in ((~held, PALETTE[0], "free"), (held, "white", "held")):
        ax.plot(
            x[which],
            profile.drop[which],
            linestyle="none",
            marker="o",
            markersize=2.8,
            markeredgewidth=0.7,
            markeredgecolor=PALETTE[0],
            markerfacecolor=face,
            zorder=3,
            gid=gid,
        )
    low, high = np.quantile(q.draws, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2]) / q.factor
    floor = _DEEPEST - 0.15 * abs(_DEEPEST)
    ax.plot([low, high], [floor * 0.94] * 2, color=POSTERIOR, linewidth=2.4, gid="posterior")
    ax.set_ylim(floor, 1.6)
    _names(ax, x, profile, symbols)
    few_ticks(ax.xaxis, 4, inner=True)
    ax.set_yticks([-6.0, -4.0, -2.0, 0.0])
    ax.set_xlabel(q.label())


def _names(ax: Axes, x: Array, profile: Profile, symbols: dict[str, str]) -> None:
    """Name each parameter on a bound once, about above where it stands there."""
    seen: dict[str, list[float]] = {}
    for at, names, drop in zip(x, profile.on_bound, profile.drop, strict=True):
        for name in names:
            if drop > _DEEPEST or name not in seen:
                seen.setdefault(name, []).append(float(at))
    sides: dict[str, list[str]] = {}
    for name, places in seen.items():
        share = (np.mean(places) - x[0]) / (x[-1] - x[0])
        side = "left" if share < 1 / 3 else "right" if share > 2 / 3 else "center"
        sides.setdefault(side, []).append(symbols[name])
    for side, words in sides.items():
        ax.text(
            {"left": 0.03, "center": 0.5, "right": 0.97}[side],
            0.97,
            ", ".join(words),
            transform=ax.transAxes,
            ha=side,
            va="top",
            fontsize=SMALL,
            color=MEASURED,
            gid="on bound",
        )


def _legend(figure: Figure) -> None:
    ink: dict[str, Any] = {
        "color": PALETTE[0],
        "marker": "o",
        "markersize": 2.8,
        "markeredgewidth": 0.7,
    }
    handles = [
        Line2D([], [], **ink),
        Line2D([], [], markerfacecolor="white", **ink),
        Line2D([], [], color=PALETTE[2], linewidth=0.8, linestyle=(0, (4.0, 1.5))),
        Line2D([], [], color=POSTERIOR, linewidth=2.4),
    ]
    labels = [
        "profile likelihood",
        "the named parameter on a bound",
        "90 %, chi-square",
        "90 % of the posterior",
    ]
    figure.legend(handles, labels, loc="outside upper left", ncols=4)
