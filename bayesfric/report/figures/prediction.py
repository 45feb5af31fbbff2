"""Measured torque, or position, against what the posterior predicts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.special import ndtri

from bayesfric.inference.fit import Fit
from bayesfric.inference.likelihood.likelihood import Outputs
from bayesfric.report.figures.over_time import as_pixels, broken, draw_band, draw_measured
from bayesfric.report.figures.style import (
    PAGE,
    PALETTE,
    SMALL,
    Array,
    AxesGrid,
    few_ticks,
    margins,
    paper_style,
    shortened,
)
from bayesfric.report.summary.summary import LEVEL

_MOST = 3
# The same draws as the residuals of the summary.
_DRAWS = 200
# Numbers held at once while predicting: windows of the filter, 160 MB.
_BUDGET = 20_000_000
# Above so many outputs an inch, dots would hide the lines.
_MOST_DOTS = 150.0

_HEIGHT = 3.4
_LEFT, _RIGHT, _BOTTOM, _TOP = 0.62, 0.14, 0.36, 0.36


@dataclass(frozen=True)
class Predictive:
    """Posterior predictive of one recording.

    Attributes
    ----------
    mean
        ``(n_outputs,)``
    sd
        ``(n_outputs,)``, noise included.
    sigma
        ``(n_outputs,)`` noise alone, root mean square over the draws.
    """

    mean: Array
    sd: Array
    sigma: Array

    def band(self, level: float) -> tuple[Array, Array]:
        """Lower and upper end of the central interval of probability ``level``.

        The predictive is taken for normal: it is the normal noise, spread a
        little by what is unknown of the parameters. Quantiles of a few hundred
        draws would be far rougher than that.
        """
        reach = float(ndtri(0.5 + level / 2.0)) * self.sd
        return self.mean - reach, self.mean + reach


def predictive(fit: Fit) -> list[Predictive]:
    """Mean and standard deviation of the predicted outputs of every recording.

    Parameters
    ----------
    fit
        A finished fit.
    """
    flat = fit.posterior.flat(_DRAWS)
    n = len(flat)
    values = fit.target.chain_values(flat)
    scales = fit.target.noise.scales(flat[:, len(fit.target.free) :])
    windows = sum(o.measured.size * o.filter.taps.size for o in fit.observations)
    at_once = max(1, _BUDGET // max(windows, 1))

    likelihood = fit.target.likelihood
    # about one draw's prediction: squares of small differences lose no digits
    origin = [f[0] for f in likelihood.predict(values[:1])]
    first = [np.zeros_like(f) for f in origin]
    second = [np.zeros_like(f) for f in origin]
    for begin in range(0, n, at_once):
        for r, f in enumerate(likelihood.predict(values[begin : begin + at_once])):
            first[r] += (f - origin[r]).sum(axis=0)
            second[r] += ((f - origin[r]) ** 2).sum(axis=0)
    # the noise changes little over the draws
    sds = [likelihood.noise_sd(scales[i]) for i in range(0, n, max(n // 20, 1))]
    found = []
    for r in range(len(origin)):
        variance = np.maximum(second[r] / n - (first[r] / n) ** 2, 0.0)
        noise = np.mean([one[r] ** 2 for one in sds], axis=0)
        found.append(Predictive(origin[r] + first[r] / n, np.sqrt(variance + noise), noise**0.5))
    return found


def prediction_figure(fit: Fit) -> Figure:
    """Draw measured and predicted torque or position, and what is left, over time.

    A column for each of at most three recordings: above, the measured output
    (torque after the parallel filter, or position), the posterior predictive mean and
    its 90 % band, noise included; below, the residual and two noise scales on either side.
    Where outputs are missing (dead zone, excluded spans) the lines break.

    Parameters
    ----------
    fit
        A finished fit.

    Returns
    -------
    matplotlib.figure.Figure
        A page wide.
    """
    outputs = fit.target.likelihood.outputs
    shown = outputs[:_MOST]
    what, unit = outputs[0].quantity, outputs[0].unit
    with paper_style():
        figure = Figure(figsize=(PAGE, _HEIGHT))
        axes = figure.subplots(
            2,
            len(shown),
            squeeze=False,
            sharex="col",
            sharey="row",
            gridspec_kw={
                **margins(figure, left=_LEFT, right=_RIGHT, bottom=_BOTTOM, top=_TOP),
                "wspace": 0.06,
                "hspace": 0.08,
                "height_ratios": (1.8, 1.0),
            },
        )
        for r, (o, p) in enumerate(zip(shown, predictive(fit), strict=False)):
            _torque(axes[0, r], o, p)
            _residual(axes[1, r], o, p)
            axes[1, r].set_xlabel("time (s)")
            axes[1, r].set_xlim(float(o.time.min()), max(float(o.time.max()), o.time.min() + 1e-9))
            few_ticks(axes[1, r].xaxis, 8 if len(shown) == 1 else 4)
            axes[0, r].set_title(shortened(o.name), fontsize=SMALL, pad=2.5)
        few_ticks(axes[0, 0].yaxis, 5)
        few_ticks(axes[1, 0].yaxis, 4)
        axes[0, 0].set_ylabel(f"{what} ({unit})")
        axes[1, 0].set_ylabel(f"residual ({unit})")
        figure.align_ylabels(axes[:, 0])
        _legend(figure, axes, len(outputs))
    return figure


def _torque(ax: Axes, o: Outputs, p: Predictive) -> None:
    draw_band(ax, o, *p.band(LEVEL), label=f"{100 * LEVEL:.0f} % predictive band", gid="band")
    time, measured, mean = broken(o, o.measured, p.mean)
    # wide below and thin above, so that both are seen where they agree
    ax.plot(
        time,
        mean,
        color=PALETTE[2],
        linewidth=1.0 if as_pixels(o) else 1.5,
        label="predictive mean",
        rasterized=as_pixels(o),
        gid="mean",
    )
    draw_measured(
        ax,
        time,
        measured,
        linewidth=0.5,
        pixels=as_pixels(o),
        marker=".",
        markevery=_dots(ax, measured),
        label="measured",
        gid="measured",
    )


def _residual(ax: Axes, o: Outputs, p: Predictive) -> None:
    # once more, for on the scale of the torque a good fit's band is a hairline
    draw_band(ax, o, *(end - p.mean for end in p.band(LEVEL)))
    time, residual = broken(o, o.measured - p.mean)
    draw_measured(
        ax,
        time,
        residual,
        linewidth=0.4,
        pixels=as_pixels(o),
        marker=".",
        markevery=_dots(ax, residual),
        gid="residual",
    )
    for side in (-2.0, 2.0):
        broken_time, sigma = broken(o, side * p.sigma)
        ax.plot(
            broken_time,
            sigma,
            color=PALETTE[1],
            linewidth=0.8,
            linestyle=(0, (4.0, 1.5)),
            label=r"$\pm 2\sigma$" if side > 0 else None,
            gid="sigma",
        )


def _dots(ax: Axes, broken: Array) -> list[int]:
    """Which points to mark: all where there is room, else those no line reaches."""
    present = np.isfinite(broken)
    inches = ax.get_position().width * PAGE
    if present.sum() > _MOST_DOTS * inches:
        padded = np.concatenate([[False], present, [False]])
        present &= ~padded[:-2] & ~padded[2:]
    return [int(i) for i in np.flatnonzero(present)]


def _legend(figure: Figure, axes: AxesGrid, n: int) -> None:
    handles, labels = [], []
    for ax in axes[:, 0]:
        some, words = ax.get_legend_handles_labels()
        handles += some
        labels += words
    figure.legend(
        handles,
        labels,
        loc="upper left",
        ncols=len(labels),
        bbox_to_anchor=(_LEFT / PAGE, 1.0),
        borderaxespad=0.2,
        borderpad=0.2,
        columnspacing=1.4,
    )
    if n > _MOST:
        figure.text(
            1.0 - _RIGHT / PAGE,
            1.0 - 0.04 / _HEIGHT,
            f"first {_MOST} of {n} recordings",
            ha="right",
            va="top",
            fontsize=SMALL,
        )
