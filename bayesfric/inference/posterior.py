"""Draws of the posterior, their convergence diagnostics, and posterior predictive checks.

Walkers of one ensemble are not independent chains; ensembles are, and are compared. Draws are
``(ensembles, walkers, steps, d)``.

The torque of held-out recordings, or ends of recordings, is predicted from the motion alone, noise
included, and compared with the measured one; standstills are compared with the law's static
friction.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from bayesfric.base.errors import BadInput
from bayesfric.estimates.torque import filtered_torque
from bayesfric.inference.likelihood import StaticFriction, TorqueLikelihood
from bayesfric.inference.priors import Prior
from bayesfric.inference.target import Target
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.held_out import Part
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.signals import observe
from bayesfric.recordings.source import Processing

# A run is trusted when all ensembles together are this many autocorrelation times long, which
# suffices to estimate that time (Goodman and Weare 2010, emcee's rule).
LONG_ENOUGH = 50.0

Status = Literal["reliable", "tentative", "unusable"]


@dataclass(frozen=True)
class Diagnostics:
    """Convergence diagnostics; arrays are ``(d,)`` over the sampled parameters."""

    # reliable: all criteria met; tentative: not all, but the ensembles roughly agree
    status: Status
    # a sentence with a hint for each criterion that is not met
    problems: tuple[str, ...]
    # nested R-hat
    rhat: Array
    tau: Array  # integrated autocorrelation time, steps
    ess: Array  # effective sample size
    acceptance: Array  # (ensembles, walkers) acceptance fraction
    ensembles: int
    walkers: int
    # steps of warm-up, steps after it, and thinning
    warmup: int
    steps: int
    thin: int
    # non-finite likelihood evaluations with warm-up, and their share of the proposals after it
    not_finite: int
    seconds: float  # wall-clock time
    not_finite_share: float = 0.0
    # doubts of a converged sample, such as walkers that never moved
    warnings: tuple[str, ...] = ()
    max_rhat: float = 1.01  # criterion of the settings

    def sound(self, rhat: Array, ess: Array, least: float = 400.0) -> NDArray[np.bool_]:
        """Flag numbers that may be reported even if others did not converge.

        From ``least`` independent draws ends of a 90 % interval are right to a tenth of a sd.
        """
        if self.status == "reliable":
            return np.ones(rhat.shape, dtype=np.bool_)
        return np.asarray((rhat <= self.max_rhat) & (ess >= least))


@dataclass(frozen=True)
class Posterior:
    """Draws of the sampled parameters, noise scales last."""

    # of the d sampled parameters: the mechanism's free ones, then the noise scales
    names: tuple[str, ...]
    priors: tuple[Prior, ...]
    draws: Array  # (ensembles, walkers, steps, d) in SI units, thinned
    # (ensembles, walkers, steps) log posterior density in the sampler's coordinates
    log_density: Array
    diagnostics: Diagnostics  # before thinning
    seed: int  # later steps derive their streams from it

    def flat(self, max_count: int | None = None) -> Array:
        """Return at most ``max_count`` draws ``(n, d)``, without walkers that never moved."""
        moved = self.diagnostics.acceptance > 0.0
        draws = self.draws if moved.all() or not moved.any() else self.draws[moved]
        flat = draws.reshape(-1, self.draws.shape[-1])
        if max_count is None or max_count >= len(flat):
            return flat
        return np.asarray(flat[np.linspace(0, len(flat) - 1, max_count).astype(int)])

    def with_draws(self, draws: Array) -> Self:
        """Replace the draws by others ``(n, d)``, as of one walker, of unknown density."""
        shape = 1, 1, len(draws)
        return replace(
            self,
            draws=draws[None, None],
            log_density=np.full(shape, np.nan),
            diagnostics=replace(self.diagnostics, acceptance=np.ones(shape[:2])),
        )

    def prior_draws(self, number: int, key: int) -> Array:
        """Draw from the priors, ``(number, d)``, with a random stream ``key``."""
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(key,)))
        return np.stack([prior.draw(number, rng) for prior in self.priors], axis=1)

    @cached_property
    def median(self) -> Array:
        """Median of every parameter, ``(d,)``, SI units."""
        return np.asarray(np.median(self.flat(), axis=0))

    def __getitem__(self, name: str) -> Array:
        """Draws of one parameter, ``(ensembles, walkers, steps)``."""
        return self.draws[..., self.names.index(name)]


def nested_rhat(draws: Array) -> Array:
    """Nested R-hat ``(d,)`` of ensembles as superchains.

    Walkers of an ensemble are not independent chains, so plain R-hat is meaningless; ensembles must
    start further apart than their walkers. Margossian et al., Bayesian Analysis (2024), eq. 6 to 8.
    """
    means = draws.mean(axis=2)
    between = means.mean(axis=1).var(axis=0, ddof=1)
    within = (draws.var(axis=2, ddof=1).mean(axis=1) + means.var(axis=1, ddof=1)).mean(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        rhat = np.sqrt(1.0 + between / within)
    return np.where(np.ptp(draws, axis=(0, 1, 2)) == 0.0, 1.0, rhat)


def autocorrelation_time(draws: Array) -> Array:
    """Estimate the integrated autocorrelation time ``(d,)`` over all ensembles.

    The larger of two estimates: from the walkers' mean autocorrelation around the common mean, and
    from the ensemble means, whose variance includes that walkers move together. On a ridge either
    can be too small. Both are summed over Sokal's window. A maximum over ensembles would be biased
    by its noise.
    """
    _, walkers, steps, d = draws.shape
    times = np.full(d, np.inf)
    # contiguous series of each parameter
    draws = np.ascontiguousarray(np.moveaxis(draws, 3, 0))
    for j in range(d):
        x = draws[j] - draws[j].mean()
        if not np.isfinite(x).all() or (np.ptp(x, axis=2) == 0.0).any():
            continue
        variance = np.mean(x**2)
        subset = x[:, :: -(-walkers // 64)]  # for speed
        tau_walkers = _integrated(_autocovariance(subset.reshape(-1, steps)) / np.mean(subset**2))
        means = x.mean(axis=1)
        means -= means.mean(axis=1, keepdims=True)
        # var(grand mean) = tau_mean var(mean) / n; in steps of a single walker that is tau_mean *
        # walkers * var(mean) / var(x)
        spread = np.mean(means**2)
        tau_means = _integrated(_autocovariance(means) / spread)
        times[j] = max(tau_walkers, tau_means * walkers * spread / variance)
    return times


def autocorrelation(series: Array) -> Array:
    """Autocorrelation of a series ``(walkers, steps)`` around its common mean."""
    x = series - series.mean()
    variance = np.mean(x**2)
    if not variance > 0.0 or np.ptp(series) == 0.0:
        return np.ones(series.shape[1])
    return np.asarray(_autocovariance(x) / variance)


def _autocovariance(x: Array) -> Array:
    """Mean over rows of ``(rows, n)`` of the autocovariance around zero, ``(n,)``."""
    n = x.shape[1]
    spectrum = fft.rfft(x, fft.next_fast_len(2 * n, real=True), axis=1)
    power = np.mean(np.abs(spectrum) ** 2, axis=0)
    return np.asarray(fft.irfft(power, fft.next_fast_len(2 * n, real=True))[:n] / n)


def _integrated(correlation: Array) -> float:
    """Sum an autocorrelation over Sokal's window, the first lag above five times the sum."""
    sums = 2.0 * np.cumsum(correlation) - 1.0
    beyond = np.arange(sums.size) >= 5.0 * sums
    return float(max(sums[int(np.argmax(beyond))] if beyond.any() else sums[-1], 1.0))


def effective_sample_size(draws: Array, tau: Array) -> Array:
    """Return the effective sample size ``(d,)``."""
    ensembles, walkers, steps, _ = draws.shape
    return np.asarray(ensembles * walkers * steps / tau)


# Posterior predictive checks


@dataclass(frozen=True, eq=False)
class Prediction:
    """Posterior predictive of a held-out part, output by output.

    A mixture with a component for each draw: its modelled torque plus a residual of its noise. The
    noise's correlation with previous outputs is not used.
    """

    held_out: Part
    torque: Array  # (n, M) filtered torque of each draw, N m or N
    noise: Any  # SciPy's distribution of a residual, of shape (n, 1)
    # noise scale or offset unknown for this recording: each draw uses those of a random fitted one
    borrowed: tuple[str, ...]

    @property
    def measured(self) -> Array:
        """Measured torque ``(M,)``, N m or N."""
        return self.held_out.observation.measured

    @property
    def mean(self) -> Array:
        """Predictive mean, ``(M,)``."""
        return np.asarray(self.torque.mean(axis=0))

    @property
    def variance(self) -> Array:
        """Predictive variance ``(M,)``; infinite if the noise has none."""
        return np.asarray(self.torque.var(axis=0) + np.mean(self.noise.var()))

    @cached_property
    def pit(self) -> Array:
        """Probability integral transform ``(M,)``, uniform for right predictions.

        A. P. Dawid, "Statistical theory: the prequential approach", Journal of the Royal
        Statistical Society A 147 (1984) 278-292.
        """
        pit_, at_once = np.empty(self.measured.size), max(1, 1_000_000 // len(self.torque))
        for begin in range(0, pit_.size, at_once):
            part = slice(begin, begin + at_once)
            below = self.noise.cdf(self.measured[part] - self.torque[:, part])
            pit_[part] = below.mean(axis=0)
        return pit_


def predict_held_out(
    target: Target, posterior: Posterior, held_out: Sequence[Part]
) -> tuple[Prediction, ...]:
    """Predict held-out torque with the posterior of a fit.

    The end of a fitted recording has that recording's noise scale and offset. For a recording of
    its own they are unknown, and the predictive is a mixture over those of the fitted ones. Some
    hundred draws are evaluated; they are shifted so that their mean torque is, to first order, that
    of all draws (a control variate), as mean parameters that are exported are of all.
    """
    likelihood = target.likelihood
    if not isinstance(likelihood, TorqueLikelihood):
        raise TypeError("only the torque is predicted")
    chain, noise = likelihood.chain, likelihood.noise
    names = [o.name for o in likelihood.observations]
    rng = np.random.default_rng(np.random.SeedSequence(posterior.seed, spawn_key=(6,)))
    predictions, mean = [], target.chain_values(posterior.flat()).mean(axis=0)
    for part in held_out:
        outputs = part.observation.measured.size
        draws = posterior.flat(min(400, max(50, 20_000_000 // outputs)))  # to fit in memory
        n = len(draws)
        values = target.chain_values(draws)
        scales = target.noise.scales(draws[:, len(target.free) :])
        source, borrowed = np.full(n, names.index(part.name) if part.name in names else 0), []
        if part.name not in names:
            source = rng.integers(len(names), size=n)
            borrowed += ["noise scale"] if np.ptp(target.noise.places, axis=0).any() else []
            borrowed += ["offset"] if chain.own_offsets else []
        torque = np.empty((n, outputs))
        for r in np.unique(source):
            inputs = replace(part.observation.inputs, recording=names[r])
            observation = replace(part.observation, inputs=inputs)
            drawn = values[source == r]
            at_means = filtered_torque(chain, observation, np.stack([mean, drawn.mean(axis=0)]))
            torque[source == r] = filtered_torque(chain, observation, drawn)
            torque[source == r] += at_means[0] - at_means[1]
        predictions.append(
            Prediction(part, torque, noise.marginal(scales[np.arange(n), source]), tuple(borrowed))
        )
    return tuple(predictions)


def stiction_violations(
    target: Target,
    widened: Posterior,
    residuals: Sequence[Array],
    recordings: Sequence[Measurement],
    processing: Processing,
) -> Iterator[dict[str, Any]]:
    """Yield recordings with standstills outside the limits of 95 % of the widened draws.

    At least three outputs and a tenth of those at standstill must exceed them by three times the
    residuals' rms. Nothing is evaluated if the fit uses standstill or explains positions. Each has
    its ``recording``, the ``share`` of its outputs at standstill, from ``start`` to ``stop`` in s,
    and at the motor, N m or N, the largest torque ``beyond`` the limits and the largest friction
    ``held``, which static friction is at least.
    """
    likelihood = target.likelihood
    if processing.rest or likelihood.method != "input-error":
        return
    values = target.chain_values(widened.flat(200))
    triples = zip(recordings, likelihood.observations, residuals, strict=True)
    for recording, fitted, residual in triples:
        try:
            at_rest = observe(recording, processing.model_copy(update={"rest": True}))
        except BadInput:  # without standstill too little moves
            continue
        if at_rest.rest is None:
            continue
        low, high = StaticFriction(likelihood.chain, at_rest.rest, fitted.inputs).limits(values)
        torque = at_rest.rest.torque
        excess = np.maximum(np.maximum(low - torque, torque - high), 0.0)
        violated = np.quantile(excess, 0.05, axis=0) > 3.0 * np.sqrt(np.mean(residual**2))
        if violated.sum() >= 3 and violated.mean() >= 0.1:
            stamps = at_rest.rest.stamps[violated]
            # friction is the distance from the limits' middle
            friction = np.abs(torque - 0.5 * (low + high))
            beyond, held = (float(np.median(x, axis=0)[violated].max()) for x in (excess, friction))
            yield {
                "recording": recording.name,
                "share": float(violated.mean()),
                "start": float(stamps.min()),
                "stop": float(stamps.max()),
                "beyond": beyond,
                "held": held,
            }
