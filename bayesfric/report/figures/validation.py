"""Held-out torque in its predicted band, and whether bands cover what they say."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesfric.inference.fitting import Fit
from bayesfric.inference.predictive import Prediction
from bayesfric.report.figures import style
from bayesfric.report.figures.over_time import broken, draw_band, draw_measured
from bayesfric.report.figures.registry import FinishedRun, RunFigure
from bayesfric.report.figures.style import (
    Array,
    Look,
    few_ticks,
    legend_above,
    paper_figure,
    shortened,
)
from bayesfric.report.summary.record import HeldOut, Validation
from bayesfric.report.summary.validation_part import covered

_LEVEL = 0.9
_BINS = 10
_HEIGHT = 4.6


def validation_figure(fit: Fit, validation: Validation | None) -> Figure | None:
    """Draw how well what was held out is predicted, a column wide; ``None`` where nothing was.

    Above, over time, the measured torque of the part whose 90 % bands cover the share furthest
    from 90 %, that band, and the residual. Below, of all parts together: the probability integral
    transform, whose bars are level where predictions are right and heap up at both ends where
    they are too narrow; and the share of outputs inside intervals of every level, with two
    standard errors at three of them.
    """
    if not fit.held_out or validation is None:
        return None
    pits = [p.pit for p in fit.held_out]
    off = [abs(covered(pit, _LEVEL).mean() - _LEVEL) for pit in pits]
    worst = fit.held_out[int(np.argmax(off))]
    outputs = fit.target.likelihood.outputs[0]
    with paper_figure(style.COLUMN, _HEIGHT) as figure:
        above, beneath, transform, coverage = figure.subplot_mosaic(
            [["above"] * 2, ["beneath"] * 2, ["transform", "coverage"]],
            height_ratios=(1.5, 1.0, 1.3),
        ).values()
        beneath.sharex(above)
        above.tick_params(labelbottom=False)
        _torque(above, beneath, worst)
        above.set_ylabel(f"{outputs.quantity} ({outputs.unit})")
        beneath.set(ylabel=f"residual ({outputs.unit})", xlabel="time (s)")
        legend_above(figure, above.get_legend_handles_labels()[0])
        words = f"{shortened(worst.held_out.name)}, {worst.held_out.part}"
        if len(fit.held_out) > 1:
            words += f" (furthest off of {len(fit.held_out)})"
        above.set_title(words, fontsize=style.SMALL, pad=2.5)
        every = np.concatenate(pits)
        _transform(transform, every)
        _coverage(coverage, validation.pooled, every)
        figure.align_ylabels([above, beneath])
    return figure


def _torque(above: Axes, beneath: Axes, p: Prediction) -> None:
    """Draw the torque, and what is left of it, for its own scale hides a good fit's band."""
    o, mean = p.held_out.observation, p.mean
    ends = [p.quantile(0.5 - _LEVEL / 2.0), p.quantile(0.5 + _LEVEL / 2.0)]
    for ax, less in ((above, 0.0), (beneath, mean)):
        low, high = (end - less for end in ends)
        draw_band(ax, o, low, high, label=f"predicted, {100 * _LEVEL:.0f} % band", gid="band")
        time, measured = broken(o, p.measured - less)
        named = {"marker": "." if time.size < 400 else None, "label": "measured, held out"}
        draw_measured(ax, o, time, measured, linewidth=0.6, gid="measured", **named)
        ax.set_xlim(float(o.time.min()), float(o.time.max()))
        few_ticks(ax.yaxis, 5)
    few_ticks(above.xaxis, 6)


def _transform(ax: Axes, pit: Array) -> None:
    counts, edges = np.histogram(pit, bins=_BINS, range=(0.0, 1.0))
    look: Look = {"fill": True, "color": style.BAND, "edgecolor": style.PALETTE[1], "gid": "pit"}
    ax.stairs(counts * _BINS / pit.size, edges, **look)
    ax.axhline(1.0, color=style.PALETTE[2], linewidth=0.9, linestyle=style.DASHED)
    ax.set(xlim=(0.0, 1.0), xlabel="predicted probability of less", ylabel="density")
    ax.set_xticks([0.0, 0.5, 1.0], labels=["0", "0.5", "1"])
    few_ticks(ax.yaxis, 4)


def _coverage(ax: Axes, pooled: HeldOut, pit: Array) -> None:
    levels = np.linspace(0.0, 1.0, 101)
    # an interval of probability one covers everything
    shares = [100.0 * covered(pit, level).mean() for level in levels]
    ax.plot(
        [0.0, 100.0], [0.0, 100.0], color=style.PALETTE[2], linewidth=0.9, linestyle=style.DASHED
    )
    ax.plot(100.0 * levels, shares, color=style.PALETTE[1], gid="coverage")
    for level, one in pooled.coverage.items():
        look: Look = {"linewidth": 0.8, "marker": "o", "markersize": 2.5, "capsize": 1.5}
        bar = 200.0 * one.standard_error
        x, y = 100.0 * float(level), 100.0 * one.share
        ax.errorbar(x, y, yerr=bar, color=style.PALETTE[0], **look)
    ax.set(xlim=(0.0, 103.0), ylim=(0.0, 105.0), xlabel="predicted (%)", ylabel="inside (%)")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_ticks([0.0, 50.0, 100.0])


def _caption(run: FinishedRun) -> str:
    names = ", ".join(f"{p.held_out.name} ({p.held_out.part})" for p in run.fit.held_out)
    return (
        f"Predicted and measured torque of what the fit did not see: {names}. Above: "
        f"{100 * _LEVEL:.0f} % band of the posterior predictive, noise included. Below left: "
        "predicted probability of less than was measured, level where predictions are right. "
        "Below right: share of outputs inside central predictive intervals; bars: two standard "
        "errors that account for correlation."
    )


FIGURE = RunFigure(
    stem="validation",
    title="What was held out, predicted",
    section="held-out",
    draw=lambda run: validation_figure(run.fit, run.summary.validation),
    caption=_caption,
)
