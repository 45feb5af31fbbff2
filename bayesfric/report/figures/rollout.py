"""Measured motion in the bands of roll-outs, of the recordings between best and worst."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from bayesfric.report.figures import style
from bayesfric.report.figures.prediction import as_pixels
from bayesfric.report.figures.registry import Declared
from bayesfric.report.figures.style import Look, few_ticks, legend_above, paper_figure, shortened
from bayesfric.results.roll_out import Rolled, RollOut

# Recordings that are drawn, and the height of each in inches.
_MOST = 3
_HEIGHT = 1.35


def rollout_figure(rollout: RollOut) -> Figure:
    """Draw measured positions, the middle of the draws and both bands, a column wide."""
    chosen = _chosen(rollout)
    with paper_figure(style.COLUMN, 0.35 + _HEIGHT * len(chosen)) as figure:
        axes = np.atleast_1d(figure.subplots(len(chosen), 1))
        for ax, one in zip(axes, chosen, strict=True):
            drawn: Look = {"rasterized": as_pixels(one)}
            wide = drawn | {"color": style.BAND, "linewidth": 0.0, "gid": "band"}
            label = f"{100 * rollout.level:.0f} % band"
            ax.fill_between(one.time, *one.band, label=label, **wide)
            narrow = drawn | {"color": style.PALETTE[1], "alpha": 0.45, "linewidth": 0.0}
            ax.fill_between(one.time, *one.alone, label="of the parameters alone", **narrow)
            line = drawn | {"color": style.PALETTE[2], "linewidth": 0.8, "gid": "measured"}
            ax.plot(one.time, one.position, label="measured", **line)
            ax.set(xlim=(float(one.time[0]), float(one.time[-1])), ylabel=f"position ({one.unit})")
            share = f"{100 * one.at_position.inside:.0f} % inside"
            share += " a band too wide to judge" if one.wide else ""
            ax.set_title(f"{shortened(one.name)}: {share}", fontsize=style.SMALL, pad=2.5)
            few_ticks(ax.yaxis, 4)
            few_ticks(ax.xaxis, 6)
        axes[-1].set_xlabel("time (s)")
        legend_above(figure, axes[0].get_legend_handles_labels()[0])
        figure.align_ylabels(list(axes))
    return figure


def _chosen(rollout: RollOut) -> list[Rolled]:
    """Choose the recordings furthest inside and furthest outside, and one between."""
    ranked = sorted(rollout.rolled, key=lambda one: (-one.at_position.inside, one.at_position.mae))
    places = np.unique(np.linspace(0, len(ranked) - 1, min(_MOST, len(ranked))).round().astype(int))
    return [ranked[k] for k in places]


def _caption(rollout: RollOut) -> str:
    count = len(rollout.rolled)
    which = f", {min(_MOST, count)} of {count}, most inside first" if count > 1 else ""
    return (
        "Motion of the joint simulated with recordings' inputs, and the "
        f"measured position{which}. Dark: {rollout.draws} draws of "
        "the posterior, parameters alone; light: with torque that the model leaves unexplained."
    )


# Of roll-outs, which are made when a run is finished.
FIGURE = Declared(
    stem="rollout",
    title="Simulated and measured motion",
    section="roll-out",
    draw=rollout_figure,
    caption=_caption,
)
