"""Measured outputs with their posterior predictive, residuals, simulated motion, and friction."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.ndimage import binary_dilation
from scipy.special import ndtri

from bayesfric.estimates.torque import load_at_outputs
from bayesfric.identifiability.friction_curve import FEWEST, Curve, friction_curves
from bayesfric.inference.fitting import Fit
from bayesfric.inference.likelihood import Outputs
from bayesfric.recordings.signals import Signals
from bayesfric.report.figures import style
from bayesfric.report.figures.style import Array, Look
from bayesfric.report.summary.derived_quantities import LEVEL
from bayesfric.results.roll_out import RollOut

# Recordings that a figure has room for.
MOST = 3
_BAND: Look = {"color": style.BAND, "linewidth": 0.0, "gid": "band"}


def predictive(fit: Fit) -> list[tuple[Array, Array, Array]]:
    """Predict every recording: mean, half the 90 % interval, and sd of the noise, ``(M,)`` each.

    The predictive is assumed normal: it is the normal noise, spread a little by the parameters.
    Quantiles of a few hundred draws would be far rougher than that.
    """
    draws, likelihood = fit.predicting, fit.target.likelihood
    scales = fit.target.noise.scales(draws[:, len(fit.target.free) :])
    # the noise changes little over the draws
    sds = [likelihood.noise_sd(scales[i]) for i in range(0, len(draws), max(len(draws) // 20, 1))]
    predictions = []
    for r, rows in enumerate(likelihood.predict(fit.target.chain_values(draws))):
        noise = np.mean([sd[r] ** 2 for sd in sds], axis=0)
        half = float(ndtri(0.5 + LEVEL / 2.0)) * np.sqrt(rows.var(axis=0) + noise)
        predictions.append((rows.mean(axis=0), half, noise**0.5))
    return predictions


def prediction_figure(fit: Fit) -> Figure:
    """Draw measured and predicted torque or position, and residuals, over time, a page wide.

    Where outputs are missing (dead zone, excluded spans) the lines break; excluded spans are
    hatched.
    """
    outputs = fit.target.likelihood.outputs
    shown = outputs[:MOST]
    quantity, unit = outputs[0].quantity, outputs[0].unit
    with style.paper_figure(style.PAGE, 3.4) as figure:
        axes = figure.subplots(
            2, len(shown), squeeze=False, sharex="col", sharey="row", height_ratios=(1.8, 1.0)
        )
        recordings = zip(axes.T, shown, predictive(fit), fit.observations, strict=False)
        for (above, below), o, p, observation in recordings:
            _predicted(above, below, o, *p)
            for ax in (above, below):
                _hatch_excluded(ax, observation)
            below.set_xlabel("time (s)")
            below.set_xlim(float(o.time.min()), max(float(o.time.max()), o.time.min() + 1e-9))
            style.few_ticks(below.xaxis, 8 if len(shown) == 1 else 4)
            above.set_title(style.shortened(o.name), fontsize=style.SMALL, pad=2.5)
        for ax, max_count, words in zip(axes[:, 0], (5, 4), (quantity, "residual"), strict=True):
            style.few_ticks(ax.yaxis, max_count)
            ax.set_ylabel(f"{words} ({unit})")
        figure.align_ylabels(axes[:, 0])
        style.legend_above(figure)
        if len(outputs) > MOST:
            style.remark_below(figure, f"first {MOST} of {len(outputs)} recordings")
    return figure


def _predicted(above: Axes, below: Axes, o: Outputs, *predicted: Array) -> None:
    """Draw measured outputs and the predictive, and below them the residuals."""
    time, measured, mean, reach, sigma = _broken(o, o.measured, *predicted)
    pixels = as_pixels(o.time)
    band = _BAND | {"rasterized": pixels}
    label = f"{100 * LEVEL:.0f} % predictive band"
    above.fill_between(time, mean - reach, mean + reach, label=label, **band)
    # on the scale of the torque a good fit's band is a hairline
    below.fill_between(time, -reach, reach, **band)
    # wide below and thin above, so that both are seen where they agree
    look: Look = {"color": style.PALETTE[2], "linewidth": 1.0 if pixels else 1.5, "gid": "mean"}
    above.plot(time, mean, label="predictive mean", rasterized=pixels, **look)
    line: Look = {"color": style.MEASURED, "rasterized": pixels}
    above.plot(time, measured, linewidth=0.5, label="measured", gid="measured", **line)
    below.plot(time, measured - mean, linewidth=0.4, gid="residual", **line)
    look = {"color": style.PALETTE[1], "linewidth": 0.8, "linestyle": style.DASHED, "gid": "sigma"}
    below.plot(time, -2.0 * sigma, **look)
    below.plot(time, 2.0 * sigma, label="$\\pm 2$ sds of the noise", **look)


def _hatch_excluded(ax: Axes, observation: Signals) -> None:
    """Hatch the spans that the user excluded."""
    if spans := [(start, stop - start) for start, stop in observation.left_out]:
        look: Look = {"facecolor": "none", "edgecolor": "#8a8a8a", "hatch": style.OPEN_HATCH}
        named: Look = {"label": "left out by the user", "gid": "left-out", "linewidth": 0.0}
        ax.broken_barh(spans, (0.0, 1.0), transform=ax.get_xaxis_transform(), **look, **named)


def as_pixels(time: Array) -> bool:
    """Whether there are too many points for paths, which would make a slow and huge PDF."""
    return time.size > 5000


def _broken(o: Outputs, *values: Array) -> list[Array]:
    """Give time and values with a break wherever outputs are missing."""
    gaps = (np.diff(o.time) > 1.5 * o.period) | (np.diff(o.segment_of) != 0)
    at = np.flatnonzero(gaps) + 1
    # a time inside the gap keeps the order; the values there are none
    between = 0.5 * (o.time[at - 1] + o.time[at])
    return [
        np.insert(o.time, at, between),
        *(np.insert(np.asarray(v, dtype=np.float64), at, np.nan) for v in values),
    ]


def residual_figure(fit: Fit) -> Figure | None:
    """Draw residuals against speed, load and angle, as far as they vary, a page wide."""
    rotary = fit.chain.load.motion == "rotary"
    labels = {
        "speed": rf"joint speed $\dot q$ ({'rad/s' if rotary else 'm/s'})",
        "load": rf"load $\Gamma$ ({'N m' if rotary else 'N'})",
        "position": "joint angle $q$ (rad)" if rotary else "position $q$ (m)",
    }
    if not (bins := binned_residuals(fit)):
        return None
    with style.paper_figure(style.PAGE, 2.1) as figure:
        axes = figure.subplots(1, len(bins), sharey=True, squeeze=False)[0]
        for ax, (key, (place, mean, low, high)) in zip(axes, bins.items(), strict=True):
            ax.axhline(0.0, color="0.6", linewidth=0.5)
            label = f"{100 * LEVEL:.0f} % of the residuals"
            ax.fill_between(place, low, high, label=label, **_BAND)
            look: Look = {"color": style.PALETTE[0], "marker": "o", "markersize": 2.4}
            ax.plot(place, mean, label="their mean", **look)
            ax.set_xlabel(labels[key])
            style.few_ticks(ax.xaxis, 5)
        style.few_ticks(axes[0].yaxis, 5)
        axes[0].set_ylabel(f"residual ({fit.target.likelihood.outputs[0].unit})")
        style.legend_above(figure)
    return figure


def binned_residuals(fit: Fit, max_count: int = 16) -> dict[str, Array]:
    """Bin residuals by speed, load and position, as far as these vary.

    Of bins of equally many outputs, five at least, the place, mean, and ends of the central 90 %,
    ``(4, n)``.
    """
    median = fit.target.chain_values(fit.posterior.median[None])[0]
    motion: dict[str, list[Array]] = {"speed": [], "load": [], "position": []}
    for o, observation in zip(fit.target.likelihood.outputs, fit.observations, strict=True):
        load = load_at_outputs(fit.chain, observation, median)
        position = observation.q[observation.filter.centres]
        # outputs of a simulation are at other times than those of the filter
        for of, x in zip(motion.values(), (observation.speed, load, position), strict=True):
            of.append(np.interp(o.time, observation.time, x))
    residual, bins = np.concatenate(fit.residuals), {}
    count = max(1, min(max_count, residual.size // 5))
    levels = [0.5 - LEVEL / 2, 0.5 + LEVEL / 2]
    for key, parts in motion.items():
        x = np.concatenate(parts)
        if np.ptp(x) > 0.0:
            rows = []
            for place in np.array_split(np.argsort(x, kind="stable"), count):
                part = residual[place]
                rows.append([x[place].mean(), part.mean(), *np.quantile(part, levels)])
            bins[key] = np.array(rows).T
    return bins


def rollout_figure(rollout: RollOut) -> Figure:
    """Draw measured positions, the middle of the draws and both bands, a column wide.

    Of many recordings those furthest inside and furthest outside their bands, and one between.
    """
    ranked = sorted(
        rollout.rolled, key=lambda x: (-x.errors["position"].inside, x.errors["position"].mae)
    )
    places = np.unique(np.linspace(0, len(ranked) - 1, min(MOST, len(ranked))).round().astype(int))
    with style.paper_figure(style.COLUMN, 0.35 + 1.35 * len(places)) as figure:
        axes = np.atleast_1d(figure.subplots(len(places), 1))
        for ax, recording in zip(axes, (ranked[k] for k in places), strict=True):
            time, pixels = recording.time, {"rasterized": as_pixels(recording.time)}
            label = f"{100 * rollout.level:.0f} % band"
            ax.fill_between(time, *recording.band, label=label, **pixels, **_BAND)
            narrow: Look = {"color": style.PALETTE[1], "alpha": 0.45, "linewidth": 0.0} | pixels
            ax.fill_between(time, *recording.alone, label="of the parameters alone", **narrow)
            line: Look = {"color": style.PALETTE[2], "linewidth": 0.8, "gid": "measured"} | pixels
            ax.plot(time, recording.position, label="measured", **line)
            ax.set(xlim=(float(time[0]), float(time[-1])), ylabel=f"position ({recording.unit})")
            share = f"{100 * recording.errors['position'].inside:.0f} % inside"
            share += " a band too wide to judge" if recording.wide else ""
            title = f"{style.shortened(recording.name)}: {share}"
            ax.set_title(title, fontsize=style.SMALL, pad=2.5)
            style.few_ticks(ax.yaxis, 4)
            style.few_ticks(ax.xaxis, 6)
        axes[-1].set_xlabel("time (s)")
        style.legend_above(figure)
        figure.align_ylabels(list(axes))
    return figure


_OUTSIDE: Look = {"linestyle": (0, (3.0, 2.0)), "linewidth": 0.6, "gid": "outside"}


def friction_figure(fit: Fit) -> Figure:
    """Draw friction at the motor over speed, a column wide, at some loads if it depends on load.

    Loads below zero drive the motor (back-driving). Where hardly any outputs are near, the median
    is dashed, without a band; where the data do not determine the curve the band is hatched.
    """
    curves = friction_curves(fit)
    rotary = fit.chain.motor_motion == "rotary"
    kind, unit, per = ("torque", "N m", "rad/s") if rotary else ("force", "N", "m/s")
    colour = style.PALETTE[0]
    handles = [
        Line2D([], [], color=colour, label="posterior median", gid="median"),
        Patch(label=f"{100 * LEVEL:.0f} % band", **_area(colour, False)),
        Line2D([], [], color=colour, label=f"fewer than {FEWEST} outputs near", **_OUTSIDE),
        Patch(label="NOT determined by the data", **_area(colour, True)),
    ]
    with style.paper_figure(style.COLUMN, 2.4) as figure:
        ax = figure.subplots()
        for colour, curve in zip(style.PALETTE, curves, strict=False):
            load = float(curve.load[0])
            label = f"{load:+.3g} {unit}".replace("-", "\N{MINUS SIGN}") if load else "no load"
            _draw(ax, curve, colour, label)
        ax.axhline(0.0, color="0.6", linewidth=0.5, zorder=0.5)
        ax.set(xlabel=rf"motor speed $\dot q_m$ ({per})", ylabel=f"friction {kind} $F$ ({unit})")
        style.few_ticks(ax.xaxis, 6)
        style.few_ticks(ax.yaxis, 6)
        if len(curves) > 1:
            ax.legend(title="at load", title_fontsize=style.SMALL, alignment="left")
        drawn = {artist.get_gid() for artist in ax.get_children()}
        style.legend_above(figure, [h for h in handles if h.get_gid() in drawn], 2)
    return figure


def _draw(ax: Axes, curve: Curve, colour: str, label: str) -> None:
    """Draw median and band where recordings were, and beyond that a dashed median alone."""
    x, shown, (low, median, high) = curve.speed, curve.shown, np.sign(curve.speed) * curve.ends
    for is_open in (False, True):
        where = shown & (curve.determined != is_open)
        if where.any():
            # grown by one neighbour, so that parts of a band meet
            inside = (binary_dilation(where) & shown).tolist()
            ax.fill_between(x, low, high, where=inside, **_area(colour, is_open))
    if not shown[np.isfinite(median)].all():
        ax.plot(x, median, color=colour, **_OUTSIDE)
    near = np.where(binary_dilation(shown), median, np.nan)
    ax.plot(x, near, color=colour, label=label, gid="median")


def _area(colour: str, is_open: bool) -> Look:
    if is_open:
        hatch = {"hatch": style.OPEN_HATCH, "linewidth": 0.4, "gid": "open"}
        return {"facecolor": "none", "edgecolor": colour} | hatch
    return {"facecolor": colour, "edgecolor": "none", "alpha": 0.3, "linewidth": 0.0, "gid": "band"}
