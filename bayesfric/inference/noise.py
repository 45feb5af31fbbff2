"""Noise of the measurements: its scales, the autoregressive model of torque residuals, its order.

Cogging, flexible parts and filters correlate residuals; assumed white, they make intervals too
narrow. But autocorrelated noise weighs frequencies: with a partial autocorrelation near one slow
residuals count as noise, and only the end of the band, where even an acceleration may be noise, is
informative. Then it does not widen intervals but moves estimates. So an order is admissible only if
weighted least squares stays where plain least squares is, within its uncertainty (the idea of
Hausman's test, Econometrica 46 (1978) 1251-1271), with residuals as small.

White residuals do not prove white noise: in a hundred outputs a correlation of a tenth is not
visible, and makes slow effects a tenth less certain. If no order has evidence, the first is sampled
from zero to what the residuals leave plausible: it widens intervals and does not move them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy import stats
from scipy.linalg import toeplitz

from bayesfric.estimates import autoregression as ar
from bayesfric.estimates.torque import filtered_torque, torque_jacobian
from bayesfric.inference.moments import Moments
from bayesfric.inference.priors import Prior, PriorText, read_prior
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import TypicalSizes
from bayesfric.recordings.arrays import Array, Flags, Index
from bayesfric.recordings.signals import Signals

NoiseScale = Literal["shared", "per-recording"]
_LOG_2PI = math.log(2.0 * math.pi)
# Largest partial autocorrelation by default: above it, slow effects of the motion itself would
# count as noise.
MAX_PARTIAL = 0.95
# Largest order that is tried by default.
MAX_ORDER = 4


@dataclass(frozen=True)
class Scale:
    """One parameter of the noise."""

    name: str  # parameter ``noise.<name>``
    symbol: str
    meaning: str  # one line, for rotary joints
    # default prior, for the sizes of the measurements
    prior: Callable[[TypicalSizes], PriorText]
    # Support
    lower: float = 0.0
    upper: float = np.inf
    # of a torque, a position, a time, or none
    unit: Literal["torque", "position", "s", ""] = "torque"
    # whether all recordings share it, and the residuals of an estimate determine if it is used
    chosen: bool = False

    def read_prior(self, texts: Mapping[str, PriorText], sizes: TypicalSizes) -> Prior:
        """Read the configured prior, or use the default."""
        name = f"noise.{self.name}"
        text, default = (texts[name], False) if name in texts else (self.prior(sizes), True)
        return read_prior(name, text, lower=self.lower, upper=self.upper, default=default)


def up_to(size: float, least: float | None = None) -> PriorText:
    """Return a log-uniform prior up to a size."""
    top = float(f"{size:.0e}")
    bottom = 1e-6 * top if least is None else float(f"{least:.0e}")
    return {"distribution": "loguniform", "a": bottom, "b": top}


class NoiseDescription:
    """Scales and description of a noise model."""

    def __init__(
        self, scales: Sequence[Scale], description: str, *, accounts_for_correlation: bool
    ) -> None:
        self.scales, self.description = tuple(scales), description
        self.accounts_for_correlation = accounts_for_correlation
        self.quantities = tuple(scale.name for scale in scales)


class Noise:
    """Noise scales, shared by all recordings or some for each.

    ``names`` are noise.sigma or noise.sigma.<recording>, those of the first recording first, with
    LaTeX ``symbols``, names of their :class:`Scale` and ``priors``; ``places`` ``(R, Q)`` are each
    recording's among them.
    """

    def __init__(
        self,
        recordings: Sequence[str],
        scales: Sequence[Scale],
        priors: Mapping[str, Prior],
        scale: NoiseScale,
    ) -> None:
        separate = scale == "per-recording" and len(recordings) > 1
        sampled: dict[str, tuple[str, str, Prior]] = {}
        self.places = np.zeros((len(recordings), len(scales)), dtype=np.int64)
        for i, recording in enumerate(recordings):
            for j, quantity in enumerate(scales):
                name, symbol = f"noise.{quantity.name}", quantity.symbol
                prior = priors[name]
                if separate and not quantity.chosen:
                    name = f"{name}.{recording}"
                    base, _, subscript = symbol.partition("_")
                    symbol = f"{base}_{{{subscript}{',' * bool(subscript)}{i + 1}}}"
                sampled.setdefault(name, (symbol, quantity.name, prior))
                self.places[i, j] = list(sampled).index(name)
        self.names = tuple(sampled)
        self.symbols, self.quantities, self.priors = zip(*sampled.values(), strict=True)

    def scales(self, parameters: Array) -> Array:
        """Return every recording's scales ``(n, R, Q)`` of parameters ``(n, len(names))``."""
        return parameters[:, self.places]

    def fold(self, information: Array) -> Array:
        """Sum information ``(R, Q, Q)`` over recordings that share a scale."""
        out = np.zeros((len(self.names), len(self.names)))
        for places, block in zip(self.places, information, strict=True):
            out[np.ix_(places, places)] += block
        return out


def _pacf(lag: int) -> Scale:
    """Describe the partial autocorrelation at a lag."""
    return Scale(
        f"pacf_{lag}",
        rf"\phi_{{{lag}{lag}}}",
        f"partial autocorrelation of the noise at lag {lag}",
        lambda _: [-MAX_PARTIAL, MAX_PARTIAL],
        lower=-1.0,
        upper=1.0,
        unit="",
        chosen=True,
    )


def _position(sizes: TypicalSizes) -> PriorText:
    """Return the prior of the position's noise, from below the encoder's step.

    Rounding to steps is noise of step/sqrt(12): the prior begins at a third of it. With a gearbox
    between encoder and joint that may be a hundred-millionth of the range.
    """
    return up_to(sizes.position, max(0.1 * sizes.position_step, 1e-10 * sizes.position))


_SIGMA = Scale("sigma", r"\sigma", "noise of the filtered torque", lambda s: up_to(s.torque))
_POSITION_SCALES = (
    Scale("torque", r"\sigma_\Gamma", "noise of a torque sample", lambda s: up_to(s.torque)),
    Scale("position", r"\sigma_q", "noise of a position sample", _position, unit="position"),
)


def _around(size: Callable[[TypicalSizes], float], spread: float) -> Callable[..., PriorText]:
    """Return a log-normal prior around a size."""
    return lambda sizes: {
        "distribution": "lognorm", "s": spread, "scale": float(f"{max(size(sizes), 1e-300):.0e}"),
    }  # fmt: skip


_CLOSED_LOOP_SCALES = (
    Scale(
        "slow_torque", r"\sigma_d", "slow random torque", _around(lambda s: 0.05 * s.torque, 2.0)
    ),
    Scale(
        "slow_time", r"\tau_d", "time constant of the slow random torque",
        _around(lambda _: 0.03, 1.3), unit="s",
    ),
    Scale(
        "white_torque", r"\sigma_w", "random torque of one sample",
        _around(lambda s: 0.01 * s.torque, 2.0),
    ),
    Scale(
        "encoder", r"\sigma_q", "noise of a reading beyond the encoder's steps",
        _around(lambda s: max(0.1 * s.position_step, 1e-6 * s.position), 1.5), unit="position",
    ),
    Scale(
        "instants", r"\sigma_t", "scatter of the instants at which the encoder is read",
        _around(lambda s: 0.03 * s.period, 1.5), unit="s",
    ),
)  # fmt: skip
# All scales, by their names behind ``noise.`` in priors.
SCALES: dict[str, Scale] = {
    scale.name: scale
    for scale in (
        _SIGMA,
        *(_pacf(lag) for lag in range(1, 10)),
        *_POSITION_SCALES,
        *_CLOSED_LOOP_SCALES,
    )
}
# White noise of position and torque samples; the joint integrates the latter, so errors are
# correlated.
POSITION_NOISE = NoiseDescription(
    _POSITION_SCALES,
    "white in torque and position, torque noise carried through the simulation",
    accounts_for_correlation=True,
)
# Slow and white random torque, the encoder, and the instants at which it is read.
CLOSED_LOOP_NOISE = NoiseDescription(
    _CLOSED_LOOP_SCALES,
    "random torque, slow and white, carried through the closed loop; encoder; sampling instants",
    accounts_for_correlation=True,
)


class Autoregressive(NoiseDescription):
    """Autoregressive Gaussian noise.

    ``r_t = a_1 r_(t-1) + .. + a_p r_(t-p) + e_t`` with innovations ``e_t`` of standard deviation
    ``sigma``, stationary from each run's beginning; runs are independent. Scales ``(n, R, Q)``, ``Q
    = p + 1``, are ``sigma`` and the partial autocorrelations ``pacf_1, .., pacf_p``, see
    :mod:`bayesfric.estimates.autoregression`.
    """

    def __init__(self, order: int = 0) -> None:
        self.order = order
        scales = [SCALES["sigma"], *(SCALES[f"pacf_{k + 1}"] for k in range(order))]
        if order:
            scales[0] = replace(scales[0], meaning="sd of the noise's innovations")
        words = f"AR({order})" if order else "white"
        super().__init__(scales, words, accounts_for_correlation=order > 0)

    def log_density(self, moments: Moments, counts: Index, scales: Array) -> Array:
        """Exact log density ``(n,)`` from lagged products and numbers of outputs ``(R, p + 1)``.

        The product of each output's normal density given up to ``p`` predecessors, of variance
        ``sigma^2 / prod(1 - pacf_k^2)`` over the lags ``k`` that are not used yet.
        """
        shape = scales.shape[:2]
        partial = scales[..., 1:].reshape(shape[0] * shape[1], self.order)
        squares, logs = np.zeros((2, *shape))
        variances = ar.variances(partial).T.reshape(-1, *shape)
        predictors = zip(moments, ar.predictors(partial), variances, counts.T, strict=True)
        for products, coefficients, variance, number in predictors:
            squares += _prediction_errors(products, coefficients) / variance
            logs += number * np.log(variance)
        sigma, outputs = scales[..., 0], counts.sum(axis=1)
        with np.errstate(over="ignore"):  # the density is zero there
            total = squares / sigma**2 + logs + outputs * (2.0 * np.log(sigma) + _LOG_2PI)
        return np.asarray(-0.5 * total.sum(axis=1))

    def standard(self, residual: Array, follows: Flags, scales: Array) -> tuple[Array, Array]:
        """Whiten residuals ``(..., M)`` and return their prediction standard deviations, too."""
        z = ar.whitened(residual, scales[1:], follows) / scales[0]
        variances = ar.variances(scales[None, 1:])[0]
        return z, scales[0] * np.sqrt(variances[ar.ages(follows, self.order)])

    def log_terms(self, standard: Array, sds: Array) -> Array:
        """Log densities ``(..., M)`` given predecessors, of the output of :meth:`standard`."""
        return np.asarray(-0.5 * standard**2 - np.log(sds) - 0.5 * _LOG_2PI)

    def sd(self, scales: Array) -> float:
        """Marginal standard deviation of a residual, N m or N; ``scales`` ``(Q,)``."""
        return float(scales[0] * math.sqrt(ar.variances(scales[None, 1:])[0, 0]))

    def marginal(self, scales: Array) -> Any:
        """SciPy's distribution of a residual, ``(n, 1)`` for scales ``(n, Q)``."""
        return stats.norm(scale=scales[:, :1] * np.sqrt(ar.variances(scales[:, 1:])[:, :1]))

    def draw(self, follows: Flags, scales: Array, rng: np.random.Generator) -> Array:
        """Draw residuals ``(n, M)`` for scales ``(n, Q)``."""
        return np.concatenate([s[0] * ar.simulated(s[1:], follows, 1, rng) for s in scales])

    def information(self, scales: Array, outputs: int) -> Array:
        """Fisher information ``(Q, Q)`` of scales ``(Q,)`` from a number of outputs.

        ``2/sigma^2`` an output for ``sigma``; for the coefficients of a long series their
        autocovariance matrix over the innovations' variance (Box and Jenkins, "Time Series
        Analysis", section 7.2), converted to partial autocorrelations by the chain rule.
        """
        out = np.zeros((scales.size, scales.size))
        out[0, 0] = 2.0 / scales[0] ** 2
        if self.order:
            partial = scales[None, 1:]
            step = 1e-6 * np.eye(self.order)
            up, down = ar.predictors(partial + step)[-1], ar.predictors(partial - step)[-1]
            slope = ((up - down) / 2e-6).T
            out[1:, 1:] = slope.T @ toeplitz(ar.autocovariance(partial[0])[:-1]) @ slope
        return np.asarray(outputs * out)

    def starts(self, sigma: float) -> Array:
        """Scales ``(k, Q)`` to start a search from."""
        if not self.order:
            return np.array([[sigma]])
        first = np.array([0.0, 0.5, 0.9])
        rest = np.zeros((first.size, self.order - 1))
        return np.column_stack([sigma * np.sqrt(1.0 - first**2), first, rest])


def _prediction_errors(products: Array, coefficients: Array) -> Array:
    """Sum of squared errors ``(n, R)`` of predictors ``(n R, k)``, from lagged products."""
    weights = np.concatenate([np.ones((len(coefficients), 1)), -coefficients], axis=1)
    weights = weights.reshape(products.shape[:-1])
    return np.asarray(np.einsum("nri,nrij,nrj->nr", weights, products, weights))


# The order of the noise


@dataclass(frozen=True)
class Evidence:
    """Evidence for autoregressive noise of one order."""

    order: int  # 0 for white noise
    bic: float  # Bayesian information criterion less that of white noise
    shift: float = 0.0  # largest shift of the estimate, in robust standard deviations
    rise: float = 1.0  # rms of the residuals over that of plain least squares

    @property
    def harmless(self) -> bool:
        """Whether estimate and residuals stay where plain least squares is."""
        return self.shift <= 3.0 and self.rise <= 1.1


@dataclass(frozen=True)
class NoiseChoice:
    """The order chosen, and the evidence for each."""

    order: int  # 0 for white noise
    evidence: tuple[Evidence, ...]  # by order, from white noise on
    # partial autocorrelations, as many as the order: estimates, or the middle of the plausible
    # range
    partial: tuple[float, ...] = ()
    half_range: float = 0.0  # of each around that

    def priors(self, priors: Mapping[str, Prior]) -> dict[str, Prior]:
        """Restrict default priors of the autocorrelation to the residuals'.

        Sampled freely it may leave its harmless range.
        """
        restricted = dict(priors)
        for k, middle in enumerate(self.partial, start=1):
            name = f"noise.pacf_{k}"
            if priors[name].default:
                around = np.array([middle - self.half_range, middle + self.half_range])
                ends = around.clip(-MAX_PARTIAL, MAX_PARTIAL).tolist()
                restricted[name] = read_prior(name, ends, lower=-1.0, upper=1.0, default=True)
        return restricted


def choose_noise(
    chain: Joint,
    observations: Sequence[Signals],
    priors: Mapping[str, Prior],
    point: Mapping[str, float],
    *,
    per_recording: bool,
) -> NoiseChoice:
    """Choose the noise from the torque residuals at a parameter vector."""
    values = chain.vector(point)
    residuals = [o.measured - filtered_torque(chain, o, values[None])[0] for o in observations]
    # prior standard deviations, 0 if fixed, 1 if infinite
    sds = np.array([priors[name].sd() for name in chain.names])
    sds = np.where(np.isfinite(sds), sds, 1.0)
    steps = np.where(sds > 0.0, 1e-6 * np.maximum(np.abs(values), 1e-3 * sds), 0.0)
    effects = torque_jacobian(chain, observations, values, steps) * sds
    ends = np.cumsum([r.size for r in residuals])[:-1]
    follows = [ar.follows(o) for o in observations]
    return choose_order(residuals, follows, per_recording, np.split(effects, ends))


def choose_order(
    residuals: Sequence[Array],
    follows: Sequence[Flags],
    per_recording: bool,
    effects: Sequence[Array] | None = None,
    *,
    least_gain: float = 6.0,  # in BIC: less is hardly evidence (Kass and Raftery, JASA 90, 1995)
    plausible: float = 4.0,  # standard errors above the estimate
) -> NoiseChoice:
    """Choose the order of autoregressive noise by the Bayesian information criterion.

    Up to four partial autocorrelations are estimated by Burg's method, all runs together. The
    criterion is ``-2 log L + p log n`` of the exact Gaussian density at the estimated innovation
    variance (Schwarz, Annals of Statistics 6 (1978) 461-464). Residuals ``(M,)`` and effects of
    parameters ``(M, k)``, in prior standard deviations, a recording.
    """
    n = sum(r.size for r in residuals)
    evidence = [Evidence(0, 0.0)]
    if not any(r.any() for r in residuals):
        return NoiseChoice(0, tuple(evidence))
    sizes = _rms(residuals, per_recording)
    scaled = [r / size for r, size in zip(residuals, sizes, strict=True)]
    if effects is None:
        effects = [np.zeros((r.size, 1)) for r in residuals]
    scaled_effects = [x / size for x, size in zip(effects, sizes, strict=True)]
    compared = _comparison(scaled, follows, scaled_effects)
    partial = np.clip(ar.burg(scaled, follows, min(MAX_ORDER, n // 20)), -MAX_PARTIAL, MAX_PARTIAL)
    for order in range(1, partial.size + 1):
        first = partial[:order]
        innovations = [ar.whitened(r, first, f) for r, f in zip(scaled, follows, strict=True)]
        # the first of a run have larger standard deviations
        logs = np.log(ar.variances(first[None])[0])
        deviance = sum(float(logs[ar.ages(f, order)].sum()) for f in follows)
        for z, size in zip(innovations, _rms(innovations, per_recording), strict=True):
            deviance += 2.0 * z.size * math.log(size)
        evidence.append(Evidence(order, deviance + order * math.log(n), *compared(first)))
    best = min((e for e in evidence if e.harmless), key=lambda e: e.bic)
    if best.bic < -least_gain:
        known = tuple(partial[: best.order].tolist())
        return NoiseChoice(best.order, tuple(evidence), known, 1.0 / math.sqrt(n))
    largest = 0.0
    if partial.size and evidence[1].harmless:
        largest = float(partial[0]) + plausible / math.sqrt(n)
    # at most one standard deviation without evidence
    while largest > 0.0 and compared(np.array([min(largest, MAX_PARTIAL)]))[0] > 1.0:
        largest /= 2.0
    if largest <= 0.0:
        return NoiseChoice(0, tuple(evidence))
    half_range = min(largest, MAX_PARTIAL) / 2.0
    return NoiseChoice(1, tuple(evidence), (half_range,), half_range)


def _comparison(
    residuals: Sequence[Array],
    follows: Sequence[Flags],
    effects: Sequence[Array],
    identified: float = 3.0,  # least singular value, in prior standard deviations over residuals
    gap: int = 50,  # steps between runs, so that no kernel spans two
) -> Callable[[Array], tuple[float, float]]:
    """Return a function from partial autocorrelations to shift and rise, see :class:`Evidence`.

    The reference is least squares without autocorrelation. Residuals and effects ``(M, k)`` are
    over the size of the residuals. Only directions that the data identify without priors count;
    standard deviations allow for correlated residuals.
    """
    residual = np.concatenate(residuals)
    basis, singular, _ = np.linalg.svd(np.concatenate(effects), full_matrices=False)
    basis = basis[:, singular > identified]
    if not basis.size:
        return lambda _: (0.0, 1.0)
    places = np.cumsum(np.concatenate([np.append(gap, np.where(f, 1, gap)) for f in follows]))
    # at least the variance of uncorrelated residuals
    variance = float(np.mean(residual**2))
    scores = basis.T * residual
    sds = np.sqrt([max(ar.long_run_variance(s, places), variance) for s in scores])
    plain = basis.T @ residual
    smallest = residual - basis @ plain
    rows = np.split(np.vstack([residual, basis.T]), np.cumsum([r.size for r in residuals])[:-1], 1)

    def compared(partial: Array) -> tuple[float, float]:
        pieces = zip(rows, follows, strict=True)
        weighted = np.concatenate([ar.whitened(part, partial, f) for part, f in pieces], axis=1)
        step = np.linalg.lstsq(weighted[1:].T, weighted[0], rcond=None)[0]
        left = residual - basis @ step
        rise = math.sqrt(float(left @ left) / max(float(smallest @ smallest), 1e-300))
        return float(np.max(np.abs(step - plain) / sds)), rise

    return compared


def _rms(parts: Sequence[Array], per_recording: bool) -> list[float]:
    """Root mean square of each recording, or of all; one where it is zero."""
    groups = [[p] for p in parts] if per_recording else [parts] * len(parts)
    return [
        math.sqrt(sum(float(p @ p) for p in group) / sum(p.size for p in group)) or 1.0
        for group in groups
    ]
