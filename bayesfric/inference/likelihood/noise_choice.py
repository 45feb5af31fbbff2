"""Choice of the noise model of torque residuals, and its evidence.

Autocorrelated noise weighs frequencies: with a partial autocorrelation near one slow residuals
count as noise, and only the end of the band, where even an acceleration may be noise, is
informative. Then it does not widen intervals but moves estimates. So an order is admissible only if
weighted least squares stays where plain least squares is, within its uncertainty (the idea of
Hausman's test, Econometrica 46 (1978) 1251-1271), with residuals as small.

White residuals do not prove white noise: in a hundred outputs a correlation of a tenth is not
visible, and makes slow effects a tenth less certain. If no order has evidence, the first is sampled
from zero to what the residuals leave plausible: it widens intervals and does not move them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesfric.estimates.information import long_run_variance
from bayesfric.estimates.torque import filtered_torque, torque_jacobian
from bayesfric.inference.likelihood import autoregression as ar
from bayesfric.inference.moments.residual_moments import follows
from bayesfric.inference.noise.autoregressive import MAX_ORDER, MAX_PARTIAL
from bayesfric.inference.priors import Prior, read_prior
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array, Flags
from bayesfric.recordings.observation import Observation

# Lags of the Ljung-Box test, in addition to those fitted.
_LAGS = 10
# Gain in BIC that autocorrelation needs: less is hardly evidence (Kass and Raftery, JASA 90, 1995).
EVIDENCE = 6.0
# Standard errors above the estimate up to which autocorrelation without evidence is plausible.
_PLAUSIBLE = 4.0
# Shift of an estimate in its standard deviations, and rise of the residuals, up to which an order
# is harmless; and the shift allowed without evidence.
_MAX_SHIFT, _MAX_RISE, _SAFE_SHIFT = 3.0, 1.1, 1.0
# Singular value, in prior standard deviations over residuals, above which data identify a
# direction.
_IDENTIFIED = 3.0
# Steps between runs, so that no kernel spans two.
_GAP = 50


@dataclass(frozen=True)
class Evidence:
    """Evidence for autoregressive noise of one order."""

    order: int  # 0 for white noise
    bic: float  # Bayesian information criterion less that of white noise
    innovation_share: float  # rms of the innovations over that of the residuals
    p_value: float  # Ljung-Box test of the innovations
    shift: float = 0.0  # largest shift of the estimate, in robust standard deviations
    # rms of the residuals over that of plain least squares
    rise: float = 1.0

    @property
    def harmless(self) -> bool:
        """Whether estimate and residuals stay where plain least squares is."""
        return self.shift <= _MAX_SHIFT and self.rise <= _MAX_RISE


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
                ends = [
                    max(middle - self.half_range, -MAX_PARTIAL),
                    min(middle + self.half_range, MAX_PARTIAL),
                ]
                restricted[name] = read_prior(name, ends, lower=-1.0, upper=1.0, default=True)
        return restricted


def choose_noise(
    chain: Joint,
    observations: Sequence[Observation],
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
    return choose_order(
        residuals,
        [follows(o) for o in observations],
        per_recording,
        effects=np.split(effects, np.cumsum([r.size for r in residuals])[:-1]),
    )


def choose_order(
    residuals: Sequence[Array],
    follows: Sequence[Flags],
    per_recording: bool,
    effects: Sequence[Array] | None = None,
) -> NoiseChoice:
    """Choose the order of autoregressive noise by the Bayesian information criterion.

    Up to four partial autocorrelations are estimated by Burg's method, all runs together. The
    criterion is ``-2 log L + p log n`` of the exact Gaussian density at the estimated innovation
    variance (Schwarz, Annals of Statistics 6 (1978) 461-464). Residuals ``(M,)`` and effects of
    parameters ``(M, k)`` a recording.
    """
    n = sum(r.size for r in residuals)
    power = sum(float(r @ r) for r in residuals)
    if not power > 0.0:
        return NoiseChoice(0, (Evidence(0, 0.0, 1.0, 1.0),))
    sizes = [_size([r]) if per_recording else _size(residuals) for r in residuals]
    scaled = _over(residuals, sizes)
    reference = None if effects is None else _WhiteReference(scaled, follows, _over(effects, sizes))
    tried: list[Evidence] = []
    for order in range(min(MAX_ORDER, n // 20) + 1):
        # the prior's limit
        partial = np.clip(ar.burg(scaled, follows, order), -MAX_PARTIAL, MAX_PARTIAL)
        innovations = [ar.whitened(r, partial, f) for r, f in zip(scaled, follows, strict=True)]
        # the first of a run have larger standard deviations
        deviance = 2.0 * sum(float(_log_sds(partial, f).sum()) for f in follows)
        innovation_sizes = [
            _size([z]) if per_recording else _size(innovations) for z in innovations
        ]
        for z, size in zip(innovations, innovation_sizes, strict=True):
            deviance += 2.0 * z.size * math.log(size) if size > 0.0 else 0.0
        innovation_power = sum(
            z.size * (a * b) ** 2
            for z, a, b in zip(innovations, sizes, innovation_sizes, strict=True)
        )
        tried.append(
            Evidence(
                order,
                # white noise is the reference
                deviance + order * math.log(n) if order else 0.0,
                math.sqrt(innovation_power / power),
                ar.ljung_box(_over(innovations, innovation_sizes), follows, _LAGS + order, order),
                *(reference.compared(partial) if reference is not None and order else ()),
            )
        )
    best = min(
        (evidence for evidence in tried if evidence.harmless), key=lambda evidence: evidence.bic
    )
    if best.bic < -EVIDENCE:
        # Burg's estimates are nested
        best_partial = tuple(partial[: best.order].tolist())
        return NoiseChoice(best.order, tuple(tried), best_partial, 1.0 / math.sqrt(n))
    first_harmless = len(tried) > 1 and tried[1].harmless
    largest = float(partial[0]) + _PLAUSIBLE / math.sqrt(n) if first_harmless else 0.0
    while reference is not None and largest > 0.0 and not reference.keeps_estimate(largest):
        largest /= 2.0
    if largest <= 0.0:
        return NoiseChoice(0, tuple(tried))
    half_range = min(largest, MAX_PARTIAL) / 2.0
    return NoiseChoice(1, tuple(tried), (half_range,), half_range)


class _WhiteReference:
    """Least squares without autocorrelation, the reference for others.

    Residuals and effects ``(M, k)`` are over the size of the residuals. Only directions that the
    data identify without priors count; standard deviations allow for correlated residuals.
    """

    def __init__(
        self, residuals: Sequence[Array], follows: Sequence[Flags], effects: Sequence[Array]
    ) -> None:
        self._follows = follows
        self._ends = np.cumsum([r.size for r in residuals])[:-1]
        self._residual = np.concatenate(residuals)
        basis, singular, _ = np.linalg.svd(np.concatenate(effects), full_matrices=False)
        identified = singular > _IDENTIFIED
        self._basis = basis[:, identified]
        steps = [np.concatenate([[_GAP], np.where(f, 1, _GAP)]) for f in follows]
        places = np.cumsum(np.concatenate(steps))
        scores = self._basis.T * self._residual
        # at least the variance of uncorrelated residuals
        variance = float(np.mean(self._residual**2))
        self._sds = np.sqrt([max(long_run_variance(s, places), variance) for s in scores])

    def keeps_estimate(self, first: float) -> bool:
        """Whether the estimate stays within its sd for a first partial autocorrelation."""
        return self.compared(np.clip([first], -MAX_PARTIAL, MAX_PARTIAL))[0] <= _SAFE_SHIFT

    def compared(self, partial: Array) -> tuple[float, float]:
        """Return shift and rise, see :class:`Evidence`, for partial autocorrelations ``(p,)``."""
        if not self._sds.size:
            return 0.0, 1.0
        rows = np.vstack([self._residual, self._basis.T])
        pieces = zip(np.split(rows, self._ends, axis=1), self._follows, strict=True)
        weighted = np.concatenate([ar.whitened(part, partial, f) for part, f in pieces], axis=1)
        step = np.linalg.lstsq(weighted[1:].T, weighted[0], rcond=None)[0]
        shift = step - self._basis.T @ self._residual
        residual = self._residual - self._basis @ step
        smallest = self._residual - self._basis @ (self._basis.T @ self._residual)
        rise = math.sqrt(float(residual @ residual) / max(float(smallest @ smallest), 1e-300))
        return float(np.max(np.abs(shift) / self._sds)), rise


def _log_sds(partial: Array, follows: Flags) -> Array:
    """Log standard deviations, over the innovations', of the first values of every run."""
    heads = np.log(ar.variances(partial[None])[0]) / 2.0
    _, lengths = ar.runs(follows)
    return np.concatenate([heads[: min(k, partial.size)] for k in lengths.tolist()] or [heads[:0]])


def _over(parts: Sequence[Array], sizes: Sequence[float]) -> list[Array]:
    """Divide by non-zero sizes."""
    return [x / size if size > 0.0 else x for x, size in zip(parts, sizes, strict=True)]


def _size(parts: Sequence[Array]) -> float:
    """Root mean square of all parts."""
    return math.sqrt(sum(float(p @ p) for p in parts) / sum(p.size for p in parts))
