"""The figure of an export: how wrong its torque is over time, and its friction over the load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesfric.export.at_joint import Moved
from bayesfric.export.error import Wrong
from bayesfric.mechanism.joint import Joint
from bayesfric.report.figures import style
from bayesfric.report.figures.style import Look, few_ticks, legend_above, paper_figure

_HEIGHT = 3.4
# Outputs further apart, in their usual distance, are not joined by a line.
_GAP = 20.0


@dataclass(frozen=True, eq=False)
class ExportPicture:
    """What the figure is drawn from."""

    chain: Joint
    motions: Sequence[Moved]
    wrong: Wrong
    name: str  # of the format


def export_figure(picture: ExportPicture) -> Figure:
    """Draw the torque of the fitted joint and a format's error along the longest recording.

    That torque follows from the motion at the compared outputs as it is; a fit compares it after a
    filter that measured and modelled torque pass alike, which takes its peaks.

    Below, friction of both in all recordings: over the load that resists the motion where the
    joint has a loss that depends on it, else over speed.
    """
    chain, motions, found = picture.chain, picture.motions, picture.wrong
    kind, unit = ("torque", "N m") if chain.motor_motion == "rotary" else ("force", "N")
    speed = np.concatenate([m.qd for m in motions])
    way = np.sign(speed)
    place, per = speed, "rad/s" if chain.load.motion == "rotary" else "m/s"
    label = rf"joint speed $\dot q$ ({per})"
    if any(element.load_loss != "none" for element in chain.elements):
        place, per = way * found.load, "N m" if chain.load.motion == "rotary" else "N"
        label = f"load at the joint, against the motion ({per})"
    fitted = way * (found.whole - found.free)
    with paper_figure(style.COLUMN, _HEIGHT) as figure:
        above, below = figure.subplots(2, 1)
        lines = _over_time(above, picture)
        above.set_ylabel(f"motor {kind} ({unit})")
        look: Look = {"linestyle": "none", "rasterized": True, "zorder": 2.0}
        look |= {"marker": "o", "markersize": 2.2, "color": style.PALETTE[3]}
        lines += below.plot(place, fitted, label="friction of the fitted joint", **look)
        look |= {"marker": ".", "markersize": 2.0, "color": style.PALETTE[0]}
        lines += below.plot(
            place, fitted + way * found.difference, label=f"friction of {picture.name}", **look
        )
        below.set_ylim(bottom=min(0.0, below.get_ylim()[0]))
        below.set_ylabel(f"friction {kind} ({unit})")
        below.set_xlabel(label)
        for ax in (above, below):
            few_ticks(ax.xaxis, 6)
            few_ticks(ax.yaxis, 5)
        legend_above(figure, lines, 2)
    return figure


def _over_time(ax: Axes, picture: ExportPicture) -> list[Line2D]:
    sizes = [m.q.size for m in picture.motions]
    longest = int(np.argmax(sizes))
    end = int(np.cumsum(sizes)[longest])
    time = picture.motions[longest].time
    gaps = np.flatnonzero(np.diff(time) > _GAP * np.median(np.diff(time))) + 1
    lines = []
    for values, colour, words in (
        (picture.wrong.whole, style.PALETTE[3], "fitted joint, unfiltered"),
        (picture.wrong.difference, style.PALETTE[0], f"error of {picture.name}"),
    ):
        part = values[end - time.size : end]
        x, y = np.insert(time, gaps, np.nan), np.insert(part, gaps, np.nan)
        lines += ax.plot(x, y, color=colour, label=words)
    ax.set_xlabel("time (s)")
    return lines
