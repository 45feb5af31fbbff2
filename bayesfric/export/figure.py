"""The figure of an export: how wrong its torque is over time, and its friction over the load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesfric.export.at_joint import Array, Moved
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
    with paper_figure(style.COLUMN, _HEIGHT) as figure:
        above, below = figure.subplots(2, 1)
        lines = _over_time(above, picture)
        above.set_ylabel(f"motor {kind} ({unit})")
        way = np.sign(np.concatenate([m.qd for m in motions]))
        place = _friction_label(below, chain, motions, found)
        fitted = way * (found.whole - found.free)
        look: Look = {"linestyle": "none", "rasterized": True, "zorder": 2.0}
        for values, marker, size, colour, words in (
            (fitted, "o", 2.2, style.PALETTE[3], "friction of the fitted joint"),
            (
                fitted + way * found.difference,
                ".",
                2.0,
                style.PALETTE[0],
                f"friction of {picture.name}",
            ),
        ):
            look |= {"marker": marker, "markersize": size, "color": colour, "label": words}
            lines += below.plot(place, values, **look)
        below.set_ylim(bottom=min(0.0, below.get_ylim()[0]))
        below.set_ylabel(f"friction {kind} ({unit})")
        for ax in (above, below):
            few_ticks(ax.xaxis, 6)
            few_ticks(ax.yaxis, 5)
        legend_above(figure, lines, 2)
    return figure


def _over_time(ax: Axes, picture: ExportPicture) -> list[Line2D]:
    sizes = [m.q.size for m in picture.motions]
    longest = int(np.argmax(sizes))
    end = int(np.cumsum(sizes)[longest])
    part = slice(end - sizes[longest], end)
    time = picture.motions[longest].time
    gaps = np.flatnonzero(np.diff(time) > _GAP * np.median(np.diff(time))) + 1
    lines = []
    for values, colour, words in (
        (picture.wrong.whole, style.PALETTE[3], "fitted joint, unfiltered"),
        (picture.wrong.difference, style.PALETTE[0], f"error of {picture.name}"),
    ):
        x, y = np.insert(time, gaps, np.nan), np.insert(values[part], gaps, np.nan)
        lines += ax.plot(x, y, color=colour, label=words)
    ax.set_xlabel("time (s)")
    return lines


def _friction_label(ax: Axes, chain: Joint, motions: Sequence[Moved], found: Wrong) -> Array:
    """Name the axis that friction is shown over, and give its values."""
    speed = np.concatenate([m.qd for m in motions])
    turns = chain.load.motion == "rotary"
    if all(element.load_loss == "none" for element in chain.elements):
        ax.set_xlabel(rf"joint speed $\dot q$ ({'rad/s' if turns else 'm/s'})")
        return speed
    ax.set_xlabel(f"load at the joint, against the motion ({'N m' if turns else 'N'})")
    return np.asarray(np.sign(speed) * found.load)
