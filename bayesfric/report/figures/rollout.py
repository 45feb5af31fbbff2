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


def rollout_figure(found: RollOut) -> Figure:
    """Draw measured positions, the middle of the draws and both bands, a column wide."""
    chosen = _chosen(found)
    with paper_figure(style.COLUMN, 0.35 + _HEIGHT * len(chosen)) as figure:
        axes = np.atleast_1d(figure.subplots(len(chosen), 1))
        for ax, one in zip(axes, chosen, strict=True):
            drawn: Look = {"rasterized": as_pixels(one)}
            wide = drawn | {"color": style.BAND, "linewidth": 0.0, "gid": "band"}
            label = f"{100 * found.level:.0f} % band"
            ax.fill_between(one.time, *one.band, label=label, **wide)
            narrow = drawn | {"color": style.PALETTE[1], "alpha": 0.45, "linewidth": 0.0}
            ax.fill_between(one.time, *one.alone, label="of the parameters alone", **narrow)
            line = drawn | {"color": style.PALETTE[2], "linewidth": 0.8, "gid": "measured"}
            ax.plot(one.time, one.position, label="measured", **line)
            ax.set(xlim=(float(one.time[0]), float(one.time[-1])), ylabel=f"position ({one.unit})")
            share = f"{100 * one.at_position.inside:.0f} % inside"
            share += " a band too wide to tell" if one.wide else ""
            ax.set_title(f"{shortened(one.name)}: {share}", fontsize=style.SMALL, pad=2.5)
            few_ticks(ax.yaxis, 4)
            few_ticks(ax.xaxis, 6)
        axes[-1].set_xlabel("time (s)")
        legend_above(figure, axes[0].get_legend_handles_labels()[0])
        figure.align_ylabels(list(axes))
    return figure


def _chosen(found: RollOut) -> list[Rolled]:
    """Take the recordings furthest inside and furthest outside, and one between."""
    ranked = sorted(found.rolled, key=lambda one: (-one.at_position.inside, one.at_position.mae))
    places = np.unique(np.linspace(0, len(ranked) - 1, min(_MOST, len(ranked))).round().astype(int))
    return [ranked[k] for k in places]


def _caption(found: RollOut) -> str:
    more = f", {min(_MOST, len(found.rolled))} of {len(found.rolled)}, most inside first"
    return (
        "Motion of the simulated joint when recordings' own inputs are played to it, and the "
        f"measured position{more if len(found.rolled) > 1 else ''}. Dark: {found.draws} draws of "
        "the posterior, parameters alone; light: with torque that the model leaves unexplained."
    )


# Of the roll-outs of a run, which are asked for when it is finished.
FIGURE = Declared(
    stem="rollout",
    title="Recordings played to the joint",
    section="roll-out",
    draw=rollout_figure,
    caption=_caption,
)
