"""Autocorrelated noise: autoregressive across gaps, plus low-frequency drift (1/f noise).

Outputs come in runs with gaps between them. A model that restarts at every gap cannot represent
slow noise, which then looks like a drift or a disturbance: so a Kalman filter predicts across gaps
(Jones, Technometrics 22 (1980) 389-395), and cosines of up to 1 Hz represent 1/f noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesfric.estimates import autoregression as ar
from bayesfric.estimates.autoregression import follows
from bayesfric.recordings.arrays import Array, Flags, Index
from bayesfric.recordings.observation import Observation

# Outputs needed for each order.
_OUTPUTS = 20
# Sizes of the drift that are tried, over the innovations' standard deviation.
_SIZES = (0.0, 0.15, 0.45, 1.35, 4.0)


@dataclass(frozen=True, eq=False)
class Layout:
    """Where outputs lie in time, recording by recording."""

    # (M - 1,) of each recording: whether an output is followed by the next one step later
    runs: tuple[Flags, ...]
    at: tuple[Index, ...]  # (M,) of each: whole steps since its first output
    stamps: tuple[Array, ...]  # (M,) of each, s

    @classmethod
    def of(cls, observations: Sequence[Observation]) -> Layout:
        """Read it from preprocessed recordings."""
        steps = [np.round((o.time - o.time[:1].sum()) / o.period) for o in observations]
        return cls(
            tuple(follows(o) for o in observations),
            tuple(step.astype(np.int64) for step in steps),
            tuple(o.time for o in observations),
        )

    def split(self, x: Array) -> list[Array]:
        """Split rows ``(n, ...)`` by recording."""
        return np.split(x, np.cumsum([a.size for a in self.at])[:-1])

    @cached_property
    def outputs(self) -> int:
        """Number of outputs."""
        return sum(a.size for a in self.at)

    @cached_property
    def grid(self) -> tuple[float, float, int, Index]:
        """Grid of the periodogram: step and longest span in s, size, and index ``(n,)`` of outputs.

        Each recording has a part of its own, of ``size``.
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
        """Indicator ``(n,)`` of each recording's outputs."""
        number = np.repeat(np.arange(len(self.at)), [a.size for a in self.at])
        return [(number == k).astype(np.float64) for k in range(len(self.at))]

    @cached_property
    def drift_cosines(self) -> list[Array]:
        """Cosines ``(M, K)`` of each recording, ``cos(pi k (t - t0) / S) / sqrt(k)``, S its span.

        With independent normal coefficients of equal variance they are 1/f noise of up to 1 Hz. One
        for eight outputs at most, and sixty.
        """
        columns = []
        for t in self.stamps:
            span = float(np.ptp(t))
            count = int(min(max(2.0 * span, 4), t.size / 8, 60))
            order = np.arange(1, count + 1)
            phase = np.pi * order * (t - t[0])[:, None] / span
            columns.append(np.cos(phase) / np.sqrt(order))
        return columns


@dataclass(frozen=True, eq=False)
class Autocorrelation:
    """Autocorrelation of noise: autoregressive, plus low-frequency drift."""

    partial: Array  # (p,) partial autocorrelations, each between -1 and 1
    drift: float = 0.0  # standard deviation of its slowest cosine over the innovations'

    def whitened(self, x: Array, layout: Layout) -> Array:
        """Whiten columns ``(n, m)``.

        With W the whitened cosines times their size, the drift is whitened by ``(I + W
        W')^(-1/2)``, which is ``I - W (R + R^2)^-1 W'`` with ``R = (I + W' W)^(1/2)``.
        """
        out, innovations = [], ar.across_gaps(self.partial)
        for part, at, cosines in zip(layout.split(x), layout.at, layout.drift_cosines, strict=True):
            white = innovations(part, at)[0]
            if self.drift:
                wave = innovations(cosines, at)[0] * self.drift
                size, vectors = np.linalg.eigh(wave.T @ wave)
                root, turned = np.sqrt(1.0 + size)[:, None], wave @ vectors
                white = white - turned @ ((turned.T @ white) / (root + root**2))
            out.append(white)
        return np.concatenate(out)

    def drawn(self, layout: Layout, rng: np.random.Generator) -> Array:
        """Draw one series ``(n,)`` with unit innovations."""
        parts = []
        for at in layout.at:
            joined = np.ones(int(at[-1]), dtype=np.bool_)
            parts.append(ar.simulated(self.partial, joined, 1, rng)[0][at])
        x = np.concatenate(parts)
        if self.drift:
            series = [
                cosines @ rng.standard_normal(cosines.shape[1]) for cosines in layout.drift_cosines
            ]
            x = x + self.drift * np.concatenate(series)
        return x

    def variance(self, layout: Layout) -> float:
        """Mean variance of an output over the innovations' variance."""
        variance = float(ar.variances(self.partial[None])[0][0])
        return (
            variance
            + self.drift**2
            * sum(float((w**2).sum()) for w in layout.drift_cosines)
            / layout.outputs
        )


WHITE = Autocorrelation(np.zeros(0))


def choose_autocorrelation(left: Array, layout: Layout) -> tuple[Autocorrelation, float]:
    """Choose order and drift of the noise of a residual ``(n,)`` by BIC, which is returned, too.

    For each size of the drift the order is chosen by ``n sum(log(1 - partial^2)) + p log(n)``;
    sizes are compared by the exact density, ``n log(variance) + log det + p log(n)`` (Schwarz,
    Annals of Statistics 6 (1978) 461-464).
    """
    n, best, least = left.size, WHITE, math.inf
    for size in _SIZES if n > 2 * _OUTPUTS else _SIZES[:1]:
        rest = left
        if size:  # the order describes what the drift leaves
            rest = left - _expected_drift(left, best.partial, size, layout)[0]
        order = min(6, n // _OUTPUTS)
        partial = ar.burg(layout.split(rest), layout.runs, order)
        costs = n * np.cumsum(np.log1p(-(partial**2))) + np.arange(1, order + 1) * math.log(n)
        partial = partial[: int(np.argmin(np.append(0.0, costs)))]
        _, power, cost = _expected_drift(left, partial, size, layout)
        bic = n * math.log(max(power, 1e-300) / n) + cost + partial.size * math.log(n)
        if bic < least:
            least, best = bic, Autocorrelation(partial, size)
        elif best.drift:
            break
    return best, least


def _expected_drift(
    left: Array, partial: Array, size: float, layout: Layout
) -> tuple[Array, float, float]:
    """Return the expected drift ``(n,)``, the power it leaves, and the log determinant.

    It is a ridge regression on whitened cosines.
    """
    drift, power, logs, innovations = [], 0.0, 0.0, ar.across_gaps(partial)
    for part, at, cosines in zip(layout.split(left), layout.at, layout.drift_cosines, strict=True):
        white, log = innovations(np.column_stack([cosines * size, part] if size else [part]), at)
        wave, y = white[:, :-1], white[:, -1]
        inner = wave.T @ wave + np.eye(wave.shape[1])
        scores = wave.T @ y
        shares = np.linalg.solve(inner, scores)
        if size:
            drift.append(size * (cosines @ shares))
        power += float(y @ y - scores @ shares)
        logs += log + float(np.linalg.slogdet(inner)[1])
    return np.concatenate(drift or [left]), power, logs
