"""What the posterior leaves unexplained: is it noise, or is it friction that the model lacks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from bayesfric.estimates.torque import load_at_outputs
from bayesfric.inference.fitting import Fit
from bayesfric.inference.likelihood.likelihood import Outputs
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.report.summary.dependence import smooth_p_value
from bayesfric.report.summary.derived_quantities import rms_of
from bayesfric.report.text_templates import filled

Array = NDArray[np.float64]
Places = NDArray[np.int64]

_POSITION = "q"  # the symbol of where the joint stands
_LAGS = 40
_BINS = 16
# Outputs a bin needs, or its mean says nothing.
_LEAST = 5
# Points that are shown of the quantiles; more lie on top of each other.
_POINTS = 200
_WHITE = float(stats.norm.ppf(0.975))
# A dependence is told where one as large comes by chance in one of a thousand recordings.
_BY_CHANCE = 1e-3
# Share beyond the one expected of chance that is too large to be passed over.
_LARGE = 0.05
# Step of the derivatives of the predictions, in posterior sds.
_STEP = 1e-3
# Excess kurtosis worth a word.
_TAILS = 0.5


@dataclass(frozen=True, eq=False)
class Binned:
    """Residuals against one quantity, in bins of equally many outputs, ``(bins,)`` each."""

    name: str
    symbol: str  # LaTeX without dollar signs
    unit: str
    centre: Array
    mean: Array
    sd: Array
    error: Array  # sd of the mean, wider where residuals are correlated
    explained: float  # share of the residuals' variance that the bins' means hold
    chance: float  # share that means of residuals with this memory are expected to hold by chance
    # that the bins' means differ, and that there is a smooth curve: of the two tests together
    p_value: float

    @property
    def what(self) -> str:
        """The quantity with its symbol, for an axis."""
        return f"{self.name} ${self.symbol}$"

    @property
    def outcome(self) -> Literal["depends", "open", "none"]:
        """Whether the mean depends on the quantity; ``open`` where that cannot be told."""
        if self.p_value < _BY_CHANCE:
            return "depends"
        return "open" if self.explained > self.chance + _LARGE else "none"


@dataclass(frozen=True, eq=False)
class ResidualAnalysis:
    """Residuals of all recordings, looked at from several sides."""

    unit: str
    lags: Array  # (L,) in outputs
    correlation: Array  # (L,) over all runs without a gap
    white: Array  # (L,) half width of the 95 % band that white residuals keep to
    # (L,) of what the noise's memory does not foretell; None where the model has no memory
    innovations: Array | None
    # (K,) quantiles of a standard normal, and of residuals (or innovations) over their rms
    normal: Array
    quantiles: Array
    kurtosis: float  # excess of theirs over a normal's
    against: tuple[Binned, ...]  # speed, load and joint angle, where they vary


def residual_analysis(fit: Fit) -> ResidualAnalysis:
    """Look at what the posterior mean leaves of the measurements."""
    outputs, left = fit.target.likelihood.outputs, fit.residuals
    lags, correlation, white = _autocorrelation(outputs, left)
    inner = _innovations(fit, left)
    # each recording over its own rms: they may differ in noise
    scaled = np.concatenate([r / max(rms_of(r), 1e-300) for r in inner or left])
    n = scaled.size
    # the tails tell most: all of their points
    spaced = np.linspace(0, n - 1, min(n, _POINTS)).astype(int)
    shown = np.unique(np.r_[spaced, : min(20, n), max(n - 20, 0) : n])
    columns = _columns(fit)
    against = [
        _binned((name, symbol, unit), np.concatenate(x), outputs, left, columns)
        for name, symbol, unit, x in _abscissae(fit, outputs)
        if np.ptp(np.concatenate(x)) > 0.0
    ]
    return ResidualAnalysis(
        outputs[0].unit,
        lags,
        correlation,
        white,
        _autocorrelation(outputs, inner)[1] if inner else None,
        np.asarray(stats.norm.ppf((shown + 0.5) / n)),
        np.sort(scaled)[shown],
        float(stats.kurtosis(scaled)),
        tuple(b for b in against if b.centre.size > 1),
    )


def _innovations(fit: Fit, left: list[Array]) -> list[Array] | None:
    """Take from residuals what the noise model foretells, where it foretells anything."""
    likelihood = fit.target.likelihood
    if not isinstance(likelihood, TorqueLikelihood) or not likelihood.noise.order:
        return None
    median = fit.posterior.median
    scales = fit.target.noise.scales(median[None, len(fit.target.free) :])[0]
    return likelihood.innovations(left, scales)


def _columns(fit: Fit) -> Array:
    """Differentiate the predictions by the free parameters, ``(M, k)``."""
    median = fit.posterior.median
    k = len(fit.target.free)
    moved = np.tile(median, (k + 1, 1))
    moved[np.arange(k), np.arange(k)] += _STEP * fit.posterior.flat().std(axis=0)[:k]
    predicted = fit.target.likelihood.predict(fit.target.chain_values(moved))
    return np.concatenate([rows[:-1] - rows[-1] for rows in predicted], axis=1).T


def _autocorrelation(outputs: tuple[Outputs, ...], left: list[Array]) -> tuple[Array, Array, Array]:
    """Correlate residuals at even distances in time about zero, gaps left out.

    About zero, as noise is modelled, and as lag 1 is told elsewhere.
    """
    longest = max(r.size for r in left)
    lags = np.arange(1, min(_LAGS, max(longest // 4, 1)) + 1)
    products, pairs = np.zeros(lags.size), np.zeros(lags.size)
    power, total = 0.0, 0
    for o, r in zip(outputs, left, strict=True):
        rms = rms_of(r)
        if not rms > 0.0:
            continue
        scaled = r / rms
        power += float(scaled @ scaled)
        total += r.size
        for k, (here, there) in enumerate(_pairs(o, lags.size)):
            products[k] += scaled[here] @ scaled[there]
            pairs[k] += here.size
    seen = (pairs > 0) & (power > 0.0)
    correlation = (products[seen] / pairs[seen]) / (power / total if power > 0.0 else 1.0)
    white = _WHITE / np.sqrt(pairs[seen])
    return lags[seen].astype(np.float64), correlation, np.asarray(white)


def _pairs(o: Outputs, most: int) -> Iterator[tuple[Places, Places]]:
    """Give the outputs that are 1, 2, .., ``most`` periods apart, gaps left out."""
    # place on an even grid of time; segments are not in step with each other
    begin = o.time[np.searchsorted(o.segment_of, o.segment_of)]
    place = np.rint((begin - o.time[0]) / o.period) + np.rint((o.time - begin) / o.period)
    place = place.astype(np.int64) + o.segment_of * (most + 1)
    number = np.full(int(place.max()) + 1 + most, -1)
    number[place] = np.arange(place.size)
    for lag in range(1, most + 1):
        there = number[place + lag]
        here = np.flatnonzero(there >= 0)
        yield here, there[here]


def _abscissae(fit: Fit, outputs: tuple[Outputs, ...]) -> list[tuple[str, str, str, list[Array]]]:
    """Speed, load torque and angle at every output."""
    median = fit.target.chain_values(fit.posterior.median[None])[0]
    speed: list[Array] = []
    load: list[Array] = []
    angle: list[Array] = []
    for o, seen in zip(outputs, fit.observations, strict=True):
        q, gamma = seen.q[seen.filter.centres], load_at_outputs(fit.chain, seen, median)
        # outputs of a simulation are at other times than those of the filter
        same = np.array_equal(seen.time, o.time)
        for kept, x in ((speed, seen.speed), (load, gamma), (angle, q)):
            kept.append(x if same else np.interp(o.time, seen.time, x))
    rotary = fit.chain.load.motion == "rotary"
    return [
        ("joint speed", r"\dot q", "rad/s" if rotary else "m/s", speed),
        ("load", r"\Gamma", "N m" if rotary else "N", load),
        ("joint angle" if rotary else "position", _POSITION, "rad" if rotary else "m", angle),
    ]


def _binned(
    quantity: tuple[str, str, str],
    x: Array,
    outputs: tuple[Outputs, ...],
    left: list[Array],
    columns: Array,
) -> Binned:
    """Mean and spread in bins, and whether the means are more than chance.

    Residuals that repeat what the ones before them said count once. That is measured with
    the bins' means taken off, or a dependence on ``x`` would pass for memory and hide itself.
    """
    r = np.concatenate(left)
    order = np.argsort(x, kind="stable")
    bins = max(1, min(_BINS, r.size // _LEAST))
    parts = np.array_split(order, bins)
    centre = np.array([x[p].mean() for p in parts])
    mean = np.array([r[p].mean() for p in parts])
    sd = np.array([r[p].std() for p in parts])
    sizes = np.array([p.size for p in parts])
    bin_of = np.empty(r.size, dtype=np.int64)
    bin_of[order] = np.repeat(np.arange(bins), sizes)
    inside = r - mean[bin_of]
    ends = np.cumsum([one.size for one in left])[:-1]
    centred = [one - one.mean() for one in np.split(inside, ends)]
    lags, correlation, white = _autocorrelation(outputs, centred)
    # up to the first that chance explains
    few = int(np.argmin(np.append(correlation > white, False)))
    memory = dict(zip(lags[:few].astype(int).tolist(), correlation[:few].tolist(), strict=True))
    independent = 1.0 + 2.0 * sum(memory.values())
    # of a bin's outputs only those that are near in time too say the same
    repeated = np.ones(bins)
    for o, where in zip(outputs, np.split(bin_of, ends), strict=True):
        for lag, (here, there) in enumerate(_pairs(o, max(memory, default=0)), start=1):
            both = where[here][where[here] == where[there]]
            repeated += 2.0 * memory.get(lag, 0.0) * np.bincount(both, minlength=bins) / sizes
    total = float(((r - r.mean()) ** 2).sum())
    between = float((sizes * (mean - r.mean()) ** 2).sum())
    explained = between / total if total > 0.0 else 0.0
    p_value = 1.0
    if 0.0 < explained < 1.0 and bins > 1:
        freedom = r.size / independent - bins
        if freedom > 0.0:
            ratio = (explained / (bins - 1)) / ((1.0 - explained) / freedom)
            p_value = float(stats.f.sf(ratio, bins - 1, freedom))
        # one for sharp dependences, one for smooth ones that a memory would hide; recordings
        # may differ in noise
        size = np.concatenate([np.full(one.size, max(rms_of(one), 1e-300)) for one in left])
        smooth = smooth_p_value(r / size, x, columns / size[:, None])
        p_value = min(1.0, 2.0 * min(p_value, smooth))
    return Binned(
        *quantity,
        centre,
        mean,
        sd,
        sd * np.sqrt(repeated / sizes),
        explained,
        max(0.0, float(repeated.sum()) - independent) / r.size,
        p_value,
    )


def residual_words(fit: Fit) -> tuple[str, ...]:
    """Say what the residual figure shows, one sentence each."""
    found = residual_analysis(fit)
    text = filled(
        "residual.txt.j2",
        found=found,
        residuals=_outside(found.correlation, found.white),
        innovations=_outside(found.innovations, found.white),
        drifts=fit.target.likelihood.method == "output-error",
        tails=_TAILS,
    )
    return tuple(text.splitlines())


def _outside(correlation: Array | None, white: Array) -> dict[str, Any] | None:
    """Count the lags outside the white band, and tell whether they are too many for chance."""
    if correlation is None or not correlation.size:
        return None
    outside = int((np.abs(correlation) > white).sum())
    # too many, or one that is too large for the largest of so many
    largest = float((np.abs(correlation) / white).max()) * _WHITE
    by_chance = float(stats.binom.sf(outside - 1, white.size, 0.05))
    some = bool(by_chance < _BY_CHANCE or 2.0 * white.size * stats.norm.sf(largest) < _BY_CHANCE)
    return {
        "first": correlation[0], "outside": outside, "lags": white.size, "some": some,
        "by_chance": by_chance,
    }  # fmt: skip
