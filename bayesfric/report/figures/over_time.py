"""Outputs of a recording over time, with breaks where some are missing."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from bayesfric.inference.likelihood.likelihood import Outputs
from bayesfric.recordings.observation import Observation
from bayesfric.report.figures.style import BAND, MEASURED, Array
from bayesfric.results.roll_out import Rolled

# Lines of more points are drawn as pixels; as paths they would make a slow and huge PDF.
_MOST_POINTS = 5000


def as_pixels(o: Outputs | Observation | Rolled) -> bool:
    """Whether there are too many outputs to draw them as paths."""
    return o.time.size > _MOST_POINTS


def broken(o: Outputs | Observation, *values: Array) -> list[Array]:
    """Give time and values with a break wherever outputs are missing."""
    gaps = (np.diff(o.time) > 1.5 * o.period) | (np.diff(o.segment_of) != 0)
    at: NDArray[np.intp] = np.flatnonzero(gaps) + 1
    # a time inside the gap keeps the order; the values there are none
    between = 0.5 * (o.time[at - 1] + o.time[at])
    return [
        np.insert(o.time, at, between),
        *(np.insert(np.asarray(v, dtype=np.float64), at, np.nan) for v in values),
    ]


def draw_band(ax: Axes, o: Outputs | Observation, low: Array, high: Array, **named: Any) -> None:
    """Draw the band between two ends, ``(n_outputs,)`` each; ``named`` is its label and name."""
    time, low, high = broken(o, low, high)
    ax.fill_between(time, low, high, color=BAND, linewidth=0.0, rasterized=as_pixels(o), **named)


def draw_measured(
    ax: Axes, o: Outputs | Observation, time: Array, values: Array, **named: Any
) -> None:
    """Draw what was measured, broken already; ``named`` is its width, label and name.

    An output between two gaps is a dot: no line reaches it.
    """
    here = np.pad(np.isfinite(values), 1)
    alone = np.flatnonzero(here[1:-1] & ~here[:-2] & ~here[2:]).tolist()
    named |= {"marker": ".", "markersize": 1.5, "markevery": alone, "rasterized": as_pixels(o)}
    ax.plot(time, values, color=MEASURED, **named)
