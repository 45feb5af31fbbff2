"""The figure of an export: how wrong its torque is, over time and over speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from bayesfric.export.at_joint import Moved
from bayesfric.export.error import Wrong
from bayesfric.mechanism.joint import Joint
from bayesfric.report.figures import style
from bayesfric.report.figures.style import few_ticks, legend_above, paper_figure

_HEIGHT = 3.4


@dataclass(frozen=True, eq=False)
class ExportPicture:
    """What the figure is drawn from."""

    chain: Joint
    motions: Sequence[Moved]
    wrong: Wrong
    name: str  # of the format


def export_figure(picture: ExportPicture) -> Figure:
    """Draw the torque of the fitted joint and a format's error along the longest recording.

    Below, the error over the joint's speed in all recordings.
    """
    chain, motions, found = picture.chain, picture.motions, picture.wrong
    rotary = chain.motor_motion == "rotary"
    kind, unit = ("torque", "N m") if rotary else ("force", "N")
    speed_unit = "rad/s" if chain.load.motion == "rotary" else "m/s"
    sizes = [m.q.size for m in motions]
    longest = int(np.argmax(sizes))
    ends = np.cumsum(sizes)
    part = slice(int(ends[longest]) - sizes[longest], int(ends[longest]))
    with paper_figure(style.COLUMN, _HEIGHT) as figure:
        above, below = figure.subplots(2, 1)
        time = motions[longest].time
        gaps = np.flatnonzero(np.diff(time) > 20.0 * np.median(np.diff(time))) + 1
        lines = []
        for values, colour, dashes, words in (
            (found.whole[part], style.PALETTE[3], "solid", "fitted joint"),
            (found.difference[part], style.PALETTE[0], "solid", f"{picture.name} less fitted"),
        ):
            x, y = np.insert(time, gaps, np.nan), np.insert(values, gaps, np.nan)
            lines += above.plot(x, y, color=colour, linestyle=dashes, label=words)
        above.set_xlabel("time (s)")
        above.set_ylabel(f"motor {kind} ({unit})")
        speed = np.concatenate([m.qd for m in motions])
        below.plot(
            speed, found.difference, ".", color=style.PALETTE[0], markersize=1.5, rasterized=True
        )
        below.axhline(0.0, color="0.6", linewidth=0.5, zorder=0.5)
        below.set_xlabel(rf"joint speed $\dot q$ ({speed_unit})")
        below.set_ylabel(f"error of motor {kind} ({unit})")
        for ax in (above, below):
            few_ticks(ax.xaxis, 6)
            few_ticks(ax.yaxis, 5)
        legend_above(figure, lines)
    return figure
