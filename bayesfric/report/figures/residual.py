"""Residuals against speed, load and angle.

Tests of what else explains them are in :mod:`bayesfric.diagnostics`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesfric.estimates.torque import load_at_outputs
from bayesfric.inference.fitting import Fit
from bayesfric.report.figures import style
from bayesfric.report.figures.registry import RunFigure
from bayesfric.report.figures.style import few_ticks, paper_figure, power_of_ten, scaled_unit
from bayesfric.report.summary.derived_quantities import LEVEL

if TYPE_CHECKING:
    import pandas as pd

_BINS = 16
# Outputs in a bin at least, for its mean.
_LEAST = 5
_HEIGHT = 2.1


def residual_figure(fit: Fit) -> Figure | None:
    """Draw residuals against speed, load and angle, as far as they vary, a page wide."""
    left, outputs = residuals(fit), fit.target.likelihood.outputs
    rotary = fit.chain.load.motion == "rotary"
    labels = {
        "speed": rf"joint speed $\dot q$ ({'rad/s' if rotary else 'm/s'})",
        "load": rf"load $\Gamma$ ({'N m' if rotary else 'N'})",
        "position": "joint angle $q$ (rad)" if rotary else "position $q$ (m)",
    }
    shown = [key for key in labels if np.ptp(left[key]) > 0.0]
    if not shown:
        return None
    tables = [binned(left, key) for key in shown]
    reach = max(float(np.abs(table[["low", "high"]].to_numpy()).max()) for table in tables)
    exponent = power_of_ten(-reach, reach)
    with paper_figure(style.PAGE, _HEIGHT) as figure:
        axes = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
        for ax, table in zip(axes, tables, strict=True):
            _draw(ax, table)
            ax.set_xlabel(labels[str(table.columns[0])])
        few_ticks(axes[0].yaxis, 5, exponent=exponent)
        axes[0].set_ylabel(f"residual ({scaled_unit(exponent, outputs[0].unit)})")
        style.legend_above(figure, axes[0].get_legend_handles_labels()[0])
    return figure


def _draw(ax: Axes, table: pd.DataFrame) -> None:
    """Draw a table whose first column is the abscissa."""
    x = table.iloc[:, 0]
    ax.axhline(0.0, color="0.6", linewidth=0.5)
    label = f"{100 * LEVEL:.0f} % of the residuals"
    look: style.Look = {"color": style.BAND, "linewidth": 0.0, "gid": "band"}
    ax.fill_between(x, table["low"], table["high"], label=label, **look)
    look = {"color": style.PALETTE[0], "marker": "o", "markersize": 2.4, "gid": "mean"}
    ax.plot(x, table["mean"], label="their mean", **look)
    few_ticks(ax.xaxis, 5)


def residuals(fit: Fit) -> pd.DataFrame:
    """Give the residual of every output at the posterior mean, with speed, load and position."""
    import pandas as pd  # slow to import

    median = fit.target.chain_values(fit.posterior.median[None])[0]
    parts = []
    for o, observation, left in zip(
        fit.target.likelihood.outputs, fit.observations, fit.residuals, strict=True
    ):
        motion = {
            "speed": observation.speed,
            "load": load_at_outputs(fit.chain, observation, median),
        }
        motion["position"] = observation.q[observation.filter.centres]
        # outputs of a simulation are at other times than those of the filter
        there = {key: np.interp(o.time, observation.time, x) for key, x in motion.items()}
        parts.append(pd.DataFrame({"residual": left} | there))
    return pd.concat(parts, ignore_index=True)


def binned(left: pd.DataFrame, by: str) -> pd.DataFrame:
    """Give mean and central 90 % of residuals in bins of equally many outputs, ``by`` a column."""
    count = max(1, min(_BINS, len(left) // _LEAST))
    place = left[by].rank(method="first").sub(1.0) * count // len(left)
    bins = left.groupby(place)
    residual = bins["residual"]
    ends = {
        q: residual.quantile(p) for q, p in (("low", 0.5 - LEVEL / 2), ("high", 0.5 + LEVEL / 2))
    }
    return bins[[by]].mean().assign(mean=residual.mean(), **ends)


FIGURE = RunFigure(
    stem="residual",
    title="What is left unexplained",
    section="prediction",
    draw=lambda run: residual_figure(run.fit),
    caption=(
        "What the posterior mean leaves unexplained, against motion and load, as far as they vary: "
        f"means and {100 * LEVEL:.0f} % of the residuals, in bins of equally many outputs."
    ),
)
