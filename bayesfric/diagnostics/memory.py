"""Autocorrelated noise: autoregressive across gaps, on top of a slow wander.

Outputs come in runs, with some missing between them. A model that forgets at every gap has no room
for what is slow, and then a drift or a push is found in any such noise: so what is missing a Kalman
filter passes over [1]_, and a sum of cosines of up to a hertz, sized as those of 1/f noise, stands
for what no few predecessors hold.

References
----------
.. [1] R. H. Jones, "Maximum likelihood fitting of ARMA models to time series with missing
   observations", Technometrics 22 (1980) 389-395.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from scipy.linalg import toeplitz

from bayesfric.inference.likelihood import autoregression as ar
from bayesfric.inference.moments.residual_moments import follows
from bayesfric.recordings.arrays import Array, Flags, Index
from bayesfric.recordings.observation import Observation

# Most predecessors, and at least so many outputs for each.
_ORDER, _OUTPUTS = 6, 20
# Hz up to which the noise may wander; most cosines, and outputs a cosine.
_SLOW, _WAVES, _EACH = 1.0, 60, 8
# Sizes of the wander that are tried, in sds of the innovations.
_SIZES = (0.0, 0.15, 0.45, 1.35, 4.0)
# Outputs further apart know nothing of each other, in steps.
_FORGOTTEN = 300


@dataclass(frozen=True, eq=False)
class Layout:
    """Where outputs lie in time, recording by recording."""

    # (M - 1,) of each recording: whether an output is followed by the next one step later
    runs: tuple[Flags, ...]
    at: tuple[Index, ...]  # (M,) of each: whole steps since its first output
    stamps: tuple[Array, ...]  # (M,) of each, s

    @classmethod
    def of(cls, observations: Sequence[Observation]) -> Layout:
        """Take it from recordings as they were prepared."""
        steps = [np.round((o.time - o.time[:1].sum()) / o.period) for o in observations]
        return cls(
            tuple(follows(o) for o in observations),
            tuple(one.astype(np.int64) for one in steps),
            tuple(o.time for o in observations),
        )

    def split(self, x: Array) -> list[Array]:
        """Divide rows ``(n, ...)`` of all recordings into those of each."""
        return np.split(x, np.cumsum([a.size for a in self.at])[:-1])

    @cached_property
    def outputs(self) -> int:
        """How many there are."""
        return sum(a.size for a in self.at)

    @cached_property
    def grid(self) -> tuple[float, float, int, Index]:
        """Even grids of time, one for each recording, on which a periodogram is taken.

        Shapes: ``places : ndarray`` (n,).
        """
        steps = [float(np.median(np.diff(t))) for t in self.stamps if t.size > 1]
        step, span = float(np.median(steps)), max(float(np.ptp(t)) for t in self.stamps)
        size = 1 << math.ceil(math.log2(2.0 * span / step + 2.0))
        places = [
            np.round((t - t[0]) / step).astype(np.int64) + k * size
            for k, t in enumerate(self.stamps)
        ]
        return step, span, size, np.concatenate(places)

    @cached_property
    def members(self) -> list[Array]:
        """Ones where a recording's outputs are, ``(n,)`` for each recording."""
        number = np.repeat(np.arange(len(self.at)), [a.size for a in self.at])
        return [(number == k).astype(np.float64) for k in range(len(self.at))]

    @cached_property
    def waves(self) -> list[Array]:
        """Cosines of each recording's clock, falling as one over the root of the frequency.

        Of a recording of M outputs and span S they are ``(M, K)``, ``cos(pi k (t - t0) / S) /
        sqrt(k)`` for k from 1 to K; independent normal coefficients of one size make 1/f noise of
        them. K is at most 60, an eighth of M, and 2 S (or 4), where they end at a hertz.
        """
        columns = []
        for t in self.stamps:
            span = float(np.ptp(t))
            many = int(min(max(2 * _SLOW * span, 4), t.size / _EACH, _WAVES))
            order = np.arange(1, many + 1)
            phase = np.pi * order * (t - t[0])[:, None] / span
            columns.append(np.cos(phase) / np.sqrt(order))
        return columns


@dataclass(frozen=True, eq=False)
class Memory:
    """Autocorrelation of noise: autoregressive, with a slow wander on top."""

    partial: Array  # (p,) partial autocorrelations, each between -1 and 1
    # Standard deviation of the slowest cosine of the wander, in that of the innovations; 0 for none
    slow: float = 0.0

    def whitened(self, x: Array, layout: Layout) -> Array:
        """Take from every row what the rows before it predict, over its standard deviation.

        With W the whitened cosines times their size, the wander is taken out by ``(I + W
        W')^(-1/2)``, which is ``I - W (R + R^2)^-1 W'`` with ``R = (I + W' W)^(1/2)``.

        Shapes: ``x`` (n, m), returns (n, m).
        """
        out, unforetold = [], _unforetold(self.partial)
        for part, at, waves in zip(layout.split(x), layout.at, layout.waves, strict=True):
            white = unforetold(part, at)[0]
            if self.slow:
                wave = unforetold(waves, at)[0] * self.slow
                size, vectors = np.linalg.eigh(wave.T @ wave)
                root, turned = np.sqrt(1.0 + size)[:, None], wave @ vectors
                white = white - turned @ ((turned.T @ white) / (root + root**2))
            out.append(white)
        return np.concatenate(out)

    def drawn(self, layout: Layout, rng: np.random.Generator) -> Array:
        """Draw one series ``(n,)`` whose innovations have a standard deviation of one."""
        parts = []
        for at in layout.at:
            joined = np.ones(int(at[-1]), dtype=np.bool_)
            parts.append(ar.simulated(self.partial, joined, 1, rng)[0][at])
        x = np.concatenate(parts)
        if self.slow:
            wander = [waves @ rng.standard_normal(waves.shape[1]) for waves in layout.waves]
            x = x + self.slow * np.concatenate(wander)
        return x

    def variance(self, layout: Layout) -> float:
        """Variance of an output, in the innovations', the mean over all outputs."""
        found = float(ar.variances(self.partial[None])[0][0])
        return (
            found + self.slow**2 * sum(float((w**2).sum()) for w in layout.waves) / layout.outputs
        )


WHITE = Memory(np.zeros(0))


def memory_of(left: Array, layout: Layout) -> tuple[Memory, float]:
    """Choose the memory of a residual: order and wander together.

    For sizes of the wander, none and four that grow (none alone for 40 outputs and fewer), the
    order is chosen first, by ``n sum(log(1 - partial^2)) + p log(n)``; then wander and order are
    compared by the exact density, ``n log(variance) + log det + p log(n)`` [1]_. Once a wander
    helps, the first that is worse ends it.

    References
    ----------
    .. [1] G. Schwarz, "Estimating the dimension of a model", Annals of Statistics 6 (1978) 461-464.

    Shapes: ``left`` (n,).
    """
    n, found, least = left.size, WHITE, math.inf
    for size in _SIZES if n > 2 * _OUTPUTS else _SIZES[:1]:
        rest = left
        if size:  # what wanders, by the memory before, is none of the predecessors'
            rest = left - _wandering(left, found.partial, size, layout)[0]
        order = min(_ORDER, n // _OUTPUTS)
        partial = ar.burg(layout.split(rest), layout.runs, order)
        costs = n * np.cumsum(np.log1p(-(partial**2))) + np.arange(1, order + 1) * math.log(n)
        partial = partial[: int(np.argmin(np.append(0.0, costs)))]
        _, power, cost = _wandering(left, partial, size, layout)
        bic = n * math.log(max(power, 1e-300) / n) + cost + partial.size * math.log(n)
        if bic < least:
            least, found = bic, Memory(partial, size)
        elif found.slow:
            break
    return found, least


def _wandering(
    left: Array, partial: Array, size: float, layout: Layout
) -> tuple[Array, float, float]:
    """Give the expected wander ``(n,)``, the power it leaves, and the log of the determinant.

    The wander's coefficients are normal, so its expectation is a ridge regression on whitened
    cosines.
    """
    wander, power, logs, unforetold = [], 0.0, 0.0, _unforetold(partial)
    for part, at, waves in zip(layout.split(left), layout.at, layout.waves, strict=True):
        white, log = unforetold(np.column_stack([waves * size, part] if size else [part]), at)
        wave, y = white[:, :-1], white[:, -1]
        inner = wave.T @ wave + np.eye(wave.shape[1])
        taken = wave.T @ y
        shares = np.linalg.solve(inner, taken)
        if size:
            wander.append(size * (waves @ shares))
        power += float(y @ y - taken @ shares)
        logs += log + float(np.linalg.slogdet(inner)[1])
    return np.concatenate(wander or [left]), power, logs


def _unforetold(partial: Array) -> Callable[[Array, Index], tuple[Array, float]]:
    """Make what takes from rows ``(n, m)`` of a recording what the rows before them predict.

    It also gives the log of the determinant of what that divides by.
    """
    if not partial.size:
        return lambda x, _: (x, 0.0)
    phi = np.ascontiguousarray(ar.predictors(partial[None])[-1][0])
    stationary = toeplitz(ar.autocovariance(partial)[:-1])
    return lambda x, at: _innovations(np.ascontiguousarray(x), at, phi, stationary)


@njit(cache=True, error_model="numpy")
def _innovations(x, at, phi, stationary):  # type: ignore[no-untyped-def]
    """Innovations of columns ``(n, m)`` over their sds, and the sum of the logs of their variances.

    A Kalman filter whose state holds the last p values; ``at`` ``(n,)`` are whole steps, what lies
    between them is predicted and not corrected. After more than ``_FORGOTTEN`` steps it begins
    anew.
    """
    n, m = x.shape
    p = phi.size
    out = np.empty((n, m))
    state = np.zeros((p, m))
    cov = stationary.copy()
    u = np.empty(p)
    logs = 0.0
    for i in range(n):
        if i:
            gap = at[i] - at[i - 1]
            if gap < 1 or gap > _FORGOTTEN:
                state[:] = 0.0
                cov[:] = stationary
            else:
                for _ in range(gap):
                    for j in range(m):
                        first = 0.0
                        for k in range(p - 1, -1, -1):
                            first += phi[k] * state[k, j]
                            state[k, j] = state[k - 1, j] if k else first
                    for k in range(p):
                        u[k] = 0.0
                        for j in range(p):
                            u[k] += cov[k, j] * phi[j]
                    variance = 1.0
                    for k in range(p):
                        variance += phi[k] * u[k]
                    for k in range(p - 1, 0, -1):
                        for j in range(p - 1, 0, -1):
                            cov[k, j] = cov[k - 1, j - 1]
                    for k in range(1, p):
                        cov[0, k] = u[k - 1]
                        cov[k, 0] = u[k - 1]
                    cov[0, 0] = variance
        variance = cov[0, 0]
        sd = math.sqrt(variance)
        logs += math.log(variance)
        for k in range(p):
            u[k] = cov[k, 0] / variance
        for j in range(m):
            error = x[i, j] - state[0, j]
            out[i, j] = error / sd
            for k in range(p):
                state[k, j] += u[k] * error
        for k in range(p):
            for j in range(p):
                cov[k, j] -= u[k] * u[j] * variance
    return out, logs
