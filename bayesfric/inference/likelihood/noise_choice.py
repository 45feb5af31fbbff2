"""Which noise model the residuals of an estimate ask for, and the evidence.

Autocorrelated noise weighs frequencies: with a partial autocorrelation near one slow residuals are
taken for noise, and what is believed then is the end of the band, where an acceleration may be
noise itself. Then it does not widen intervals but moves estimates, to any fit however bad. So an
order counts only as long as weighted least squares with it stays where plain least squares is,
within what plain least squares knows (the idea of Hausman's test [1]_), and leaves residuals as
small.

That residuals show no memory is no proof that noise has none: of a hundred outputs a tenth of
correlation cannot be seen, and makes slow effects a tenth less certain. So where no order has
evidence the first is sampled, from none as far as residuals leave it open: it is to widen intervals
and not to move them.

References
----------
.. [1] J. A. Hausman, "Specification tests in econometrics", Econometrica 46 (1978) 1251-1271.
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
from bayesfric.inference.noise.autoregressive import MAX_PARTIAL, MAX_ORDER
from bayesfric.inference.prior.priors import Prior, read_prior
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array, Flags
from bayesfric.recordings.observation import Observation

# Correlations that the test of what is left looks at, beyond those fitted.
_LAGS = 10
# What a memory must gain over none: less is hardly evidence (Kass and Raftery, JASA 90, 1995).
EVIDENCE = 6.0
# Standard errors beyond what residuals show that a memory without evidence may have.
_OPEN = 4.0
# Shift of an estimate, in its sd, and rise of the residuals from which on a memory does harm; and
# the shift where residuals do not show it.
_SHIFT, _RISE, _STILL = 3.0, 1.1, 1.0
# Singular value, in prior sds over residuals, above which data alone tell a direction.
_TOLD = 3.0
# Places between runs, so that no kernel spans them.
_APART = 50


@dataclass(frozen=True)
class Evidence:
    """How well residuals are autoregressive noise of one order."""

    order: int  # Of the autoregression, 0 for white noise
    bic: float  # Bayesian information criterion less that of white noise; the smallest is chosen
    innovation_share: float  # Root mean square of the innovations over that of the residuals
    p_value: float  # Of the Ljung-Box test that the innovations are white
    shift: float = 0.0  # By how much it moves the estimate at most, in robust standard deviations
    # Root mean square of the residuals that it then has, over that of least squares
    rise: float = 1.0

    @property
    def harmless(self) -> bool:
        """Whether the estimate stays where it was: a shift of at most 3, a rise of at most 1.1."""
        return self.shift <= _SHIFT and self.rise <= _RISE


@dataclass(frozen=True)
class NoiseChoice:
    """The order chosen, and every one that was tried."""

    order: int  # Chosen one, 0 for white noise
    tried: tuple[Evidence, ...]  # Evidence by order, from white noise on
    # Partial autocorrelations, as many as the order: those of the residuals, or the middle of what
    # these leave open
    partial: tuple[float, ...] = ()
    half_range: float = 0.0  # How far each may be from that

    def priors(self, priors: Mapping[str, Prior]) -> dict[str, Prior]:
        """Give priors in which the autocorrelation is that of these residuals.

        Sampled freely it may leave where it is harmless: with a longer one any fit is a good one.
        What the user said of it stays.
        """
        found = dict(priors)
        for k, middle in enumerate(self.partial, start=1):
            name = f"noise.pacf_{k}"
            if priors[name].default:
                ends = [max(middle - self.half_range, -MAX_PARTIAL), min(middle + self.half_range, MAX_PARTIAL)]
                found[name] = read_prior(name, ends, lower=-1.0, upper=1.0, default=True)
        return found


def choose_noise(
    chain: Joint,
    observations: Sequence[Observation],
    priors: Mapping[str, Prior],
    point: Mapping[str, float],
    *,
    per_recording: bool,
) -> NoiseChoice:
    """Choose the order that the torque residuals of a parameter vector ask for."""
    values = chain.vector(point)
    residuals = [o.measured - filtered_torque(chain, o, values[None])[0] for o in observations]
    # prior sds of the chain's parameters, 0 of fixed ones; 1 of those without any
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
    own_scales: bool,
    effects: Sequence[Array] | None = None,
) -> NoiseChoice:
    """Choose the order of autoregressive noise by the Bayesian information criterion.

    Up to four partial autocorrelations are estimated by Burg's method, all runs together. With the
    standardised innovations ``e`` and their sds ``s``, the criterion is ``-2 log L + p log n``, in
    which ``log L`` is the exact Gaussian density, its innovation variance at its estimate [1]_.

    References
    ----------
    .. [1] G. Schwarz, "Estimating the dimension of a model", Annals of Statistics 6 (1978) 461-464.
    .. [2] R. E. Kass, A. E. Raftery, "Bayes factors", Journal of the American Statistical
       Association 90 (1995) 773-795.

    Shapes: ``residuals`` (M,), ``follows`` (M - 1,), ``effects`` (M, k).
    """
    n = sum(r.size for r in residuals)
    whole = sum(float(r @ r) for r in residuals)
    if not whole > 0.0:
        return NoiseChoice(0, (Evidence(0, 0.0, 1.0, 1.0),))
    sizes = [_size([r]) if own_scales else _size(residuals) for r in residuals]
    scaled = _over(residuals, sizes)
    plain = None if effects is None else _Plain(scaled, follows, _over(effects, sizes))
    tried: list[Evidence] = []
    for order in range(min(MAX_ORDER, n // 20) + 1):
        # beyond, the prior ends too
        partial = np.clip(ar.burg(scaled, follows, order), -MAX_PARTIAL, MAX_PARTIAL)
        left = [ar.whitened(r, partial, f) for r, f in zip(scaled, follows, strict=True)]
        # the first of a run are divided by their own, larger sds
        deviance = 2.0 * sum(float(_log_sds(partial, f).sum()) for f in follows)
        inner = [_size([z]) if own_scales else _size(left) for z in left]
        for z, size in zip(left, inner, strict=True):
            deviance += 2.0 * z.size * math.log(size) if size > 0.0 else 0.0
        power = sum(z.size * (a * b) ** 2 for z, a, b in zip(left, sizes, inner, strict=True))
        tried.append(
            Evidence(
                order,
                # of white noise, over its own size, it is none
                deviance + order * math.log(n) if order else 0.0,
                math.sqrt(power / whole),
                ar.ljung_box(_over(left, inner), follows, _LAGS + order, order),
                *(plain.compared(partial) if plain is not None and order else ()),
            )
        )
    best = min((one for one in tried if one.harmless), key=lambda one: one.bic)
    if best.bic < -EVIDENCE:
        # of fewer predecessors Burg's are the first of these
        memory = tuple(partial[: best.order].tolist())
        return NoiseChoice(best.order, tuple(tried), memory, 1.0 / math.sqrt(n))
    may = len(tried) > 1 and tried[1].harmless
    end = float(partial[0]) + _OPEN / math.sqrt(n) if may else 0.0
    while plain is not None and end > 0.0 and not plain.stays(end):
        end /= 2.0
    if end <= 0.0:
        return NoiseChoice(0, tuple(tried))
    half = min(end, MAX_PARTIAL) / 2.0
    return NoiseChoice(1, tuple(tried), (half,), half)


class _Plain:
    """Least squares without autocorrelation, to compare others with.

    Residuals and effects ``(M, k)`` a recording are over the size of the residuals. Only directions
    that the data identify without their priors count. Their sds allow for correlated residuals.
    """

    def __init__(
        self, residuals: Sequence[Array], follows: Sequence[Flags], effects: Sequence[Array]
    ) -> None:
        self._follows = follows
        self._ends = np.cumsum([r.size for r in residuals])[:-1]
        self._residual = np.concatenate(residuals)
        basis, singular, _ = np.linalg.svd(np.concatenate(effects), full_matrices=False)
        told = singular > _TOLD
        self._basis = basis[:, told]
        steps = [np.concatenate([[_APART], np.where(f, 1, _APART)]) for f in follows]
        places = np.cumsum(np.concatenate(steps))
        scores = self._basis.T * self._residual
        # never less than uncorrelated residuals would give
        variance = float(np.mean(self._residual**2))
        self._sds = np.sqrt([max(long_run_variance(s, places), variance) for s in scores])

    def stays(self, first: float) -> bool:
        """Whether the estimate stays within a sd with a first partial autocorrelation."""
        return self.compared(np.clip([first], -MAX_PARTIAL, MAX_PARTIAL))[0] <= _STILL

    def compared(self, partial: Array) -> tuple[float, float]:
        """Give ``shift`` and ``rise`` of :class:`Evidence` for autocorrelations ``(p,)``."""
        if not self._sds.size:
            return 0.0, 1.0
        rows = np.vstack([self._residual, self._basis.T])
        pieces = zip(np.split(rows, self._ends, axis=1), self._follows, strict=True)
        weighted = np.concatenate([ar.whitened(part, partial, f) for part, f in pieces], axis=1)
        step = np.linalg.lstsq(weighted[1:].T, weighted[0], rcond=None)[0]
        apart = step - self._basis.T @ self._residual
        left = self._residual - self._basis @ step
        least = self._residual - self._basis @ (self._basis.T @ self._residual)
        rise = math.sqrt(float(left @ left) / max(float(least @ least), 1e-300))
        return float(np.max(np.abs(apart) / self._sds)), rise


def _log_sds(partial: Array, follows: Flags) -> Array:
    """Logarithms of the sds, over the innovations', that the first of every run have."""
    heads = np.log(ar.variances(partial[None])[0]) / 2.0
    _, lengths = ar.runs(follows)
    return np.concatenate([heads[: min(k, partial.size)] for k in lengths.tolist()] or [heads[:0]])


def _over(parts: Sequence[Array], sizes: Sequence[float]) -> list[Array]:
    """Divide by sizes that are not zero."""
    return [x / size if size > 0.0 else x for x, size in zip(parts, sizes, strict=True)]


def _size(parts: Sequence[Array]) -> float:
    """Root mean square of all parts together."""
    return math.sqrt(sum(float(p @ p) for p in parts) / sum(p.size for p in parts))
