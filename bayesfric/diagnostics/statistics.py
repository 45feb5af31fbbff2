"""Statistics of candidate effects: joint t of each, and its score among the replicates.

Everything is least squares of a residual on columns after the model's own columns, the derivatives
by its parameters, are projected out of both (Frisch and Waugh, Econometrica 1, 1933).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import betainc, ndtri_exp

from bayesfric.diagnostics.autocorrelation import WHITE, Autocorrelation, Layout
from bayesfric.diagnostics.disturbances import (
    DELAY,
    Scan,
    sinusoidal_disturbance,
    transient_disturbance,
)
from bayesfric.diagnostics.policy import TESTABLE
from bayesfric.recordings.arrays import Array

# Shares of the largest eigenvalue of a Gram matrix below which a direction is rounding, or
# unidentified.
_ROUNDING, OPEN = 1e-9, 1e-7
# Share of the replicates' mean that counts as spread: the recording may have it or not.
HALF = 0.5
# Correlation from which two columns are equal, and eigenvalue below which several are collinear.
_SAME, _SINGULAR = 0.9999, 1e-4


@dataclass(frozen=True)
class Key:
    """Candidate that a column belongs to."""

    kind: str
    shape: str
    number: int
    # Whether it is a nuisance column, which only represents shapes between those of a grid.
    nuisance: bool = False
    # Far delay, s, or 0: its first column has coefficient one, the second is the torque's rate.
    delay: float = 0.0


@dataclass(frozen=True, eq=False)
class Columns:
    """Filtered regression columns of one recording or replicate, or of several together."""

    base: Array  # (n, d) derivatives of the torque by the model's parameters
    others: Array  # (n, m) columns of the candidates
    residual: Array  # (n,) torque less the model's, N m or N
    layout: Layout
    keys: tuple[Key, ...]
    autocorrelation: Autocorrelation = WHITE  # of the noise

    @cached_property
    def whitened(self) -> Columns:
        """The same with whitened noise."""
        if self.autocorrelation is WHITE:
            return self
        both = np.column_stack([self.base, self.others, self.residual])
        white, d = self.autocorrelation.whitened(both, self.layout), self.base.shape[1]
        return replace(
            self,
            base=white[:, :d],
            others=white[:, d:-1],
            residual=white[:, -1],
            autocorrelation=WHITE,
        )

    def with_candidates(self, extra: Sequence[int]) -> Array:
        """Append columns of candidates, by number, to the model's own: ``(n, d + k)``."""
        return np.column_stack([self.base, self.others[:, extra]]) if len(extra) else self.base

    def residual_with(self, extra: Sequence[int]) -> Array:
        """Return the residual ``(n,)`` when columns ``extra`` are fitted, too."""
        return project_out(basis_of(self.with_candidates(extra)), self.residual)


def testable(d: Columns) -> list[tuple[Key, list[int]]]:
    """Group columns by candidate; drop those collinear with the model's or each other."""
    groups: dict[tuple[str, str], list[int]] = {}
    for i, key in enumerate(d.keys):
        if not (key.nuisance or key.delay):
            groups.setdefault((key.kind, key.shape), []).append(i)
    base = basis_of(d.base)
    candidates: list[tuple[Key, list[int]]] = []
    singles: list[Array] = []
    for members in groups.values():
        independent, basis = [], base
        for i in members:
            column = d.others[:, i]
            remainder = project_out(basis, project_out(basis, column))
            if np.linalg.norm(remainder) > TESTABLE * np.linalg.norm(column) > 0.0:
                independent.append(i)
                basis = np.column_stack([basis, remainder / np.linalg.norm(remainder)])
        if not independent:
            continue
        if len(independent) == 1:
            remainder = project_out(base, d.others[:, independent[0]])
            remainder = remainder / np.linalg.norm(remainder)
            # one column of several may equal another candidate
            if len(members) > 1 and any(abs(remainder @ x) > _SAME for x in singles):
                continue
            singles.append(remainder)
        candidates.append((d.keys[independent[0]], independent))
    return candidates


# Least squares


def basis_of(x: Array) -> Array:
    """Return an orthonormal basis ``(n, k)`` of the span of columns ``(n, d)``."""
    size = np.sqrt((x**2).sum(axis=0))
    x = x[:, size > 0.0] / size[size > 0.0]
    if not x.size:
        return np.zeros((len(x), 0))
    power, vectors = np.linalg.eigh(x.T @ x)
    nonzero = power > _ROUNDING * power.max()
    return np.asarray(x @ (vectors[:, nonzero] / np.sqrt(power[nonzero])))


def project_out(basis: Array, x: Array) -> Array:
    """Project an orthonormal basis ``(n, k)`` out of a column ``(n,)`` or columns ``(n, m)``."""
    return np.asarray(x - basis @ (basis.T @ x))


def mean_square(x: Array, parameters: int = 0) -> float:
    """Return the variance of a residual ``(n,)`` after fitting a number of parameters."""
    return float(x @ x) / max(x.size - parameters, 1)


def truncated_least_squares(x: Array, y: Array, size: Array) -> tuple[Array, Array, Array]:
    """Solve ``x b = y`` along the directions that the columns ``(n, d)`` determine.

    Returns estimate ``(d,)``, covariance ``(d, d)`` and these directions ``(d, k)``; ``size``
    ``(d,)`` scales the parameters.
    """
    rows = x * size
    unit = np.sqrt((rows**2).sum(axis=0))
    unit[unit == 0.0] = 1.0
    power, vectors = np.linalg.eigh((rows / unit).T @ (rows / unit))
    identified = power > OPEN * power.max()
    inverse = (
        (vectors[:, identified] / power[identified])
        @ vectors[:, identified].T
        / np.outer(unit, unit)
    )
    solution = inverse @ (rows.T @ y)
    variance = mean_square(y - rows @ solution, int(identified.sum()))
    directions = np.linalg.qr(vectors[:, identified] * unit[:, None])[0]
    return solution * size, variance * inverse * np.outer(size, size), directions


@dataclass(frozen=True, eq=False)
class CandidateScores:
    """Statistics of one recording or replicate."""

    t: list[Array]  # joint t ``(k,)`` of each candidate's k coefficients; NaN if not identified
    gains: Array  # (m,) gain of each in chi squared
    # largest sinusoidal and transient disturbance, and far delay
    scans: tuple[Scan, ...]


def score_candidates(
    d: Columns, groups: Sequence[tuple[Key, list[int]]], extra: Sequence[int], width: float
) -> CandidateScores:
    """Test every candidate in addition to the model's own columns and those already included.

    With whitened columns z and residual y, the model's own projected out, ``b = (z'z)^-1 z'y``; t
    is b over its standard deviations, and the gain ``b'z'y`` over the variance of the residual.
    """
    white = d.whitened
    basis = basis_of(white.with_candidates(extra))
    y = project_out(basis, white.residual)
    z = project_out(basis, white.others)
    free, power = y.size - basis.shape[1], float(y @ y)
    has_delay = any(d.keys[i].delay for i in extra)
    delay = _delayed(() if has_delay else d.keys, z, y, free)
    size, remaining = (np.sqrt(np.einsum("ij,ij->j", x, x)) for x in (white.others, z))
    identified = remaining > TESTABLE * size
    unit = np.where(remaining > 0.0, remaining, 1.0)
    slopes = (z.T @ y) / unit
    t_values, gains = (
        [np.full(len(members), np.nan) for _, members in groups],
        np.zeros(len(groups)),
    )
    columns = np.ascontiguousarray(z.T)
    for k in {len(members) for _, members in groups}:  # all of one size at once
        same_size = np.array([i for i, (_, members) in enumerate(groups) if len(members) == k])
        members = np.array([groups[i][1] for i in same_size])
        gram = np.ones((len(members), 1, 1))
        if k > 1:
            gram = columns[members] @ columns[members].mT
            gram /= unit[members][:, :, None] * unit[members][:, None, :]
        least, axes = np.linalg.eigh(gram)
        solvable = identified[members].all(axis=1) & (least[:, 0] >= _SINGULAR)
        inverse = (axes[solvable] / least[solvable][:, None]) @ axes[solvable].mT
        slope = slopes[members[solvable]]
        b = np.einsum("gij,gj->gi", inverse, slope)
        explained = (b * slope).sum(axis=1)
        variance = np.maximum(power - explained, 1e-12 * power) / max(free - k, 1)
        spread = variance[:, None] * np.diagonal(inverse, axis1=1, axis2=2)
        gains[same_size[solvable]] = explained / variance
        for i, t in zip(same_size[solvable], b / np.sqrt(spread), strict=True):
            t_values[i] = t
    return CandidateScores(
        t_values,
        gains,
        (sinusoidal_disturbance(y, d.layout), transient_disturbance(y, d.layout, width), delay),
    )


def _delayed(keys: Sequence[Key], z: Array, y: Array, free: int) -> Scan:
    """Find the far delay with the smallest residual.

    Its first column has coefficient one; only that of the torque's rate is fitted.
    """
    first = [i for i, key in enumerate(keys) if key.delay and key.number == 0]
    if not first:
        return Scan(DELAY, 0.0, 0.0)
    rate = z[:, np.add(first, 1)]
    residual = y[:, None] - z[:, first]
    size = np.maximum(np.einsum("ij,ij->j", rate, rate), 1e-300)
    residual = residual - rate * (np.einsum("ij,ij->j", rate, residual) / size)
    power = float(y @ y)
    remaining = np.maximum(np.einsum("ij,ij->j", residual, residual), 1e-12 * power)
    gains = (power - remaining) / remaining * (free - 2)
    best = int(np.argmax(gains))
    return Scan(keys[first[0]].kind, max(float(gains[best]), 0.0), keys[first[best]].delay)


def standard_normal_scores(
    recorded: CandidateScores, others: Sequence[CandidateScores]
) -> tuple[Array, Array]:
    """Score each statistic among the replicates' as a standard normal, disturbances last.

    The squared distance of a candidate's t from the replicates' mean, in their covariance, is
    Hotelling's (Annals of Mathematical Statistics 2 (1931) 360-378). The maximum of a disturbance
    search is assumed to be Gumbel distributed, with the replicates' mean and standard deviation.
    Returns scores ``(m,)`` of the recording and ``(n, m)`` of the replicates.
    """
    n, m = len(others), len(recorded.t)
    n_scans = len(recorded.scans)
    z, null = np.zeros(m + n_scans), np.zeros((n, m + n_scans))
    for i, x in enumerate(recorded.t):
        t = np.array([other.t[i] for other in others])
        if np.isnan(x).any() or np.isnan(t).any():
            continue
        mean, cov = t.mean(axis=0), np.atleast_2d(np.cov(t.T))
        wide = _shrunk(cov) + HALF**2 * np.outer(mean, mean)
        distance = float((x - mean) @ np.linalg.solve(wide, x - mean))
        z[i] = float(_normal(np.array(distance), x.size, n))
        # each replicate is left out of mean and covariance
        deviation = (t - mean) * n / (n - 1)
        pairs = deviation[:, :, None] * deviation[:, None, :]
        covariances = _shrunk(((n - 1) * cov - (n - 1) / n * pairs) / (n - 2))
        h = np.einsum("ij,ijk,ik->i", deviation, np.linalg.inv(covariances), deviation)
        null[:, i] = _normal(h, x.size, n - 1)
    for i, scan in enumerate(recorded.scans):
        peaks = np.array([other.scans[i].peak for other in others])
        mean = (peaks.sum() - peaks) / (n - 1)
        sd = np.array([np.delete(peaks, k).std(ddof=1) for k in range(n)])
        # at least a unit of chi squared
        sd, all_sd = np.maximum(sd, 1.0), max(float(peaks.std(ddof=1)), 1.0)
        z[m + i] = _extreme(np.array((scan.peak - peaks.mean()) / all_sd))
        null[:, m + i] = _extreme((peaks - mean) / sd)
    return z, null


def _shrunk(covariance: Array) -> Array:
    """Shrink the off-diagonal elements of covariances ``(..., k, k)`` by a tenth."""
    identity = np.eye(covariance.shape[-1])
    return np.asarray(covariance * (0.9 + 0.1 * identity) + 1e-9 * identity)


def _normal(square: Array, k: int, n: int) -> Array:
    """Convert Hotelling's squared distance, k-dimensional, to a standard normal score."""
    f = square * n / (n + 1) / (n - 1)
    p = betainc(0.5 * (n - k), 0.5 * k, 1.0 / (1.0 + f))
    return np.asarray(-ndtri_exp(np.minimum(np.log(np.maximum(p, 1e-300) / 2.0), -1e-12)))


def _extreme(u: Array) -> Array:
    """Convert a standardised Gumbel variable to a normal score."""
    g = u * math.pi / math.sqrt(6.0) + float(np.euler_gamma)
    small = np.maximum(-np.expm1(-np.exp(-np.minimum(g, 20.0))), 1e-12)
    logs = np.where(g > 20.0, -g, np.log(small))
    return np.asarray(-ndtri_exp(logs - math.log(2.0)))


def unit_scores(d: Columns, size: Array) -> tuple[Array, float]:
    """Return scores of unit columns of a whitened replicate, and the residual's sd."""
    base = basis_of(d.base)
    remainder, residual = project_out(base, d.others * size), project_out(base, d.residual)
    unit = np.linalg.norm(remainder, axis=0)
    scores = remainder.T @ residual / np.where(unit > 0.0, unit, np.inf)
    return np.asarray(scores), math.sqrt(mean_square(residual, base.shape[1]))
