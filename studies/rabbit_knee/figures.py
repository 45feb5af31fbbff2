"""Figures of the study, all SIMULATED."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayesfric.estimates.point_estimate import Estimate
from bayesfric.fit.model import Model
from bayesfric.mechanism.forward import simulate
from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.figures.forest import forest_figure
from bayesfric.report.figures.style import (
    COLUMN,
    MEASURED,
    PAGE,
    PALETTE,
    axis_label,
    few_ticks,
    paper_style,
)

# Seconds shown from the start.
_DURATION = 4.0


def fit_figure(problem: Model, estimate: Estimate) -> Figure:
    """Draw the counterpart of Fig. 6: measured angle and one simulation without restarts."""
    (recording,) = problem.recordings
    chain = problem.chain
    motion = simulate(
        chain,
        chain.vector(dict(estimate.point)),
        recording.torque,
        recording.period,
        q0=float(recording.position[0]),
    )
    n = round(_DURATION / recording.period)
    with paper_style():
        figure = Figure(figsize=(COLUMN, 2.5))
        upper, lower = figure.subplots(
            2,
            1,
            sharex=True,
            gridspec_kw={
                "left": 0.15,
                "right": 0.97,
                "bottom": 0.16,
                "top": 0.91,
                "hspace": 0.1,
                "height_ratios": (2.0, 1.0),
            },
        )
        upper.plot(
            recording.time[:n],
            recording.position[:n],
            color=MEASURED,
            linewidth=0.9,
            label="encoder (simulated measurement)",
        )
        upper.plot(
            recording.time[:n],
            motion.q[:n],
            color=PALETTE[2],
            linestyle=(0, (1.0, 1.2)),
            linewidth=1.3,
            label="model",
        )
        error = 1e3 * (recording.position[:n] - motion.q[:n])
        lower.plot(recording.time[:n], error, color=MEASURED, linewidth=0.7)
        upper.set_ylabel("knee angle (rad)")
        lower.set_ylabel("error (mrad)")
        lower.set_xlabel("time (s)")
        lower.set_xlim(0.0, _DURATION)
        few_ticks(lower.yaxis, 3)
        few_ticks(upper.yaxis, 4)
        figure.legend(
            *upper.get_legend_handles_labels(), loc="upper center", ncols=2, borderaxespad=0.1
        )
        figure.align_ylabels([upper, lower])
    return figure


_PANELS = (
    "motor.inertia",
    "motor.viscous",
    "motor.coulomb_positive",
    "gearbox.load_drive",
    "gearbox.load_back",
    "load.inertia",
    "joint.viscous",
    "joint.coulomb_positive",
)


def cutoff_figure(
    by_cutoff: Mapping[float, Mapping[str, Estimate]], truth: Mapping[str, float]
) -> Figure:
    """Draw estimates of the direct and the recursive method against the cut-off."""
    cutoffs = np.array(sorted(by_cutoff))
    with paper_style():
        figure = Figure(figsize=(PAGE, 3.3))
        axes = figure.subplots(
            2,
            4,
            sharex=True,
            gridspec_kw={
                "left": 0.065,
                "right": 0.99,
                "bottom": 0.125,
                "top": 0.92,
                "wspace": 0.38,
                "hspace": 0.12,
            },
        )
        for ax, name in zip(axes.flat, _PANELS, strict=True):
            true = truth[name]
            ax.axhline(true, color=PALETTE[2], linewidth=1.0, label="truth")
            for method, marker, shift, color in (
                ("input-error", "^", 0.97, "#5e5e5e"),
                ("output-error", "D", 1.03, PALETTE[1]),
            ):
                values = [by_cutoff[c][method][name] for c in cutoffs]
                estimates = np.array([v.value for v in values])
                sd = np.array([v.sd_robust for v in values])
                bound = ~np.isfinite(sd)
                ax.errorbar(
                    cutoffs[~bound] * shift,
                    estimates[~bound],
                    1.645 * sd[~bound],
                    marker=marker,
                    markersize=3.0,
                    linestyle="none",
                    linewidth=0.7,
                    color=color,
                    label=f"{method}, 90 %",
                )
                # on a bound there is no interval
                ax.plot(
                    cutoffs[bound] * shift,
                    estimates[bound],
                    marker=marker,
                    markersize=3.0,
                    linestyle="none",
                    color=color,
                    fillstyle="none",
                )
            v: Any = by_cutoff[cutoffs[0]]["input-error"][name]
            ax.set_ylabel(axis_label(v.symbol, name, v.unit), labelpad=1.0)
            ax.set_xscale("log")
            ax.set_xticks([20, 50, 100, 200, 400], ["20", "50", "100", "200", "400"])
            ax.minorticks_off()
            few_ticks(ax.yaxis, 4)
        for ax in axes[1]:
            ax.set_xlabel("cut-off (Hz)")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper center", ncols=3, borderaxespad=0.1)
    return figure


def forest(summaries: Mapping[str, Any]) -> Figure:
    """Draw every method and both posteriors in one forest figure."""
    # all runs are of one recording and share its estimates
    first, *others = summaries
    posteriors = {name: {**summaries[name], "estimates": {}} for name in others}
    return forest_figure(comparison({first: summaries[first], **posteriors}, estimates=True))
