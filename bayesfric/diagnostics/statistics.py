"""Statistics of candidates: joint t of each, and how unlikely it is among the replicates'.

Everything here is least squares of a residual on columns, after the model's own columns, its
derivatives by its parameters, are taken out of both (Frisch and Waugh, Econometrica 1, 1933).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import betainc, ndtri_exp

from bayesfric.diagnostics.memory import WHITE, Layout, Memory
from bayesfric.diagnostics.policy import TESTABLE
from bayesfric.diagnostics.scans import DELAY, Scan, push, tone
from bayesfric.recordings.arrays import Array

# Eigenvalues of a Gram matrix, singular values squared, below these shares of the largest are
# rounding, or an open direction.
_ROUNDING, OPEN = 1e-9, 1e-7
# What replicates show as a mean is half known: the recording may share it or not.
HALF = 0.5
# Correlation from which two columns are one, and eigenvalue below which several are.
_SAME, _SINGULAR = 0.9999, 1e-4


@dataclass(frozen=True)
class Key:
    """Which column of which candidate."""

    # The candidate, and which of its columns
    kind: str
    shape: str
    number: int
    # Whether it is no candidate, and goes in with one: for shapes between those of a grid
    beside: bool = False
    # s; its column, the first of two, then has the coefficient one. 0 for what is no far delay
    delay: float = 0.0


@dataclass(frozen=True, eq=False)
class Columns:
    """What passed the filters: of one recording or replicate, or of several together."""

    base: Array  # (n, d) derivatives of the torque by the model's parameters
    others: Array  # (n, m) columns of the candidates
    left: Array  # (n,) what the model leaves of the torque, N m or N
    layout: Layout  # Where outputs lie in time
    keys: tuple[Key, ...]  # m, one for each column of others
    memory: Memory = WHITE  # Autocorrelation of the noise

    @cached_property
    def whitened(self) -> Columns:
        """The same with the noise's autocorrelation taken out."""
        if self.memory is WHITE:
            return self
        both = np.column_stack([self.base, self.others, self.left])
        white, d = self.memory.whitened(both, self.layout), self.base.shape[1]
        return replace(
            self, base=white[:, :d], others=white[:, d:-1], left=white[:, -1], memory=WHITE
        )

    def beside(self, extra: Sequence[int]) -> Array:
        """Put columns of candidates, by number, beside the model's own, ``(n, d + k)``."""
        return np.column_stack([self.base, self.others[:, extra]]) if len(extra) else self.base

    def rest(self, extra: Sequence[int]) -> Array:
        """Give what is left ``(n,)`` when columns of candidates, ``extra``, are fitted, too."""
        return without(basis_of(self.beside(extra)), self.left)


def testable(d: Columns) -> list[tuple[Key, list[int]]]:
    """Group columns to candidates; leave out what the model's own, or each other's, can do."""
    groups: dict[tuple[str, str], list[int]] = {}
    for i, key in enumerate(d.keys):
        if not (key.beside or key.delay):
            groups.setdefault((key.kind, key.shape), []).append(i)
    base = basis_of(d.base)
    found: list[tuple[Key, list[int]]] = []
    singles: list[Array] = []
    for own in groups.values():
        kept, have = [], base
        for i in own:
            column = d.others[:, i]
            rest = without(have, without(have, column))
            if np.linalg.norm(rest) > TESTABLE * np.linalg.norm(column) > 0.0:
                kept.append(i)
                have = np.column_stack([have, rest / np.linalg.norm(rest)])
        if not kept:
            continue
        if len(kept) == 1:
            rest = without(base, d.others[:, kept[0]])
            rest = rest / np.linalg.norm(rest)
            # what is left of several may be another candidate
            if len(own) > 1 and any(abs(rest @ x) > _SAME for x in singles):
                continue
            singles.append(rest)
        found.append((d.keys[kept[0]], kept))
    return found


# Least squares


def basis_of(x: Array) -> Array:
    """Orthonormal basis of what columns span.

    Shapes: ``x`` (n, d), returns (n, k).
    """
    size = np.sqrt((x**2).sum(axis=0))
    x = x[:, size > 0.0] / size[size > 0.0]
    if not x.size:
        return np.zeros((len(x), 0))
    power, vectors = np.linalg.eigh(x.T @ x)
    kept = power > _ROUNDING * power.max()
    return np.asarray(x @ (vectors[:, kept] / np.sqrt(power[kept])))


def without(basis: Array, x: Array) -> Array:
    """Give what a basis ``(n, k)`` leaves of a column ``(n,)`` or of columns ``(n, m)``."""
    return np.asarray(x - basis @ (basis.T @ x))


def mean_square(x: Array, taken: int = 0) -> float:
    """Give the variance of a residual ``(n,)`` of which ``taken`` parameters were fitted."""
    return float(x @ x) / max(x.size - taken, 1)


def solved(x: Array, y: Array, size: Array) -> tuple[Array, Array, Array]:
    """Least squares, along the directions that the columns determine.

    Shapes: ``x, y`` (n, d), ``size`` (d,), ``estimate : ndarray`` (d,), ``covariance : ndarray``
    (d, d), ``directions : ndarray`` (d, k).
    """
    rows = x * size
    unit = np.sqrt((rows**2).sum(axis=0))
    unit[unit == 0.0] = 1.0
    power, vectors = np.linalg.eigh((rows / unit).T @ (rows / unit))
    kept = power > OPEN * power.max()
    inverse = (vectors[:, kept] / power[kept]) @ vectors[:, kept].T / np.outer(unit, unit)
    found = inverse @ (rows.T @ y)
    variance = mean_square(y - rows @ found, int(kept.sum()))
    told = np.linalg.qr(vectors[:, kept] * unit[:, None])[0]
    return found * size, variance * inverse * np.outer(size, size), told


@dataclass(frozen=True, eq=False)
class Asked:
    """Statistics of one recording or replicate: of each candidate, and of the scans."""

    t: list[Array]  # Joint t (k,) of each group's k coefficients; NaN where nothing of it is left
    gains: Array  # (m,) what each takes of chi squared
    # The largest of each kind that is looked for at any place: tone, push, far delay
    scans: tuple[Scan, ...]


def asked(
    d: Columns,
    groups: Sequence[tuple[Key, list[int]]],
    extra: Sequence[int],
    width: float,
) -> Asked:
    """Ask every candidate beside the model's own columns and those that were taken in.

    Of whitened columns z and residual y, both beside the model's own, ``b = (z'z)^-1 z'y``; t is b
    over its standard deviations, and the gain is ``b'z'y`` over the variance of what is left.
    """
    white = d.whitened
    basis = basis_of(white.beside(extra))
    y = without(basis, white.left)
    z = without(basis, white.others)
    free, power = y.size - basis.shape[1], float(y @ y)
    there = any(d.keys[i].delay for i in extra)  # one is enough
    delay = _delayed(() if there else d.keys, z, y, free)
    size, rest = (np.sqrt(np.einsum("ij,ij->j", x, x)) for x in (white.others, z))
    told = rest > TESTABLE * size
    unit = np.where(rest > 0.0, rest, 1.0)
    slopes = (z.T @ y) / unit
    found, gains = [np.full(len(own), np.nan) for _, own in groups], np.zeros(len(groups))
    columns = np.ascontiguousarray(z.T)
    for k in {len(own) for _, own in groups}:  # all of a size at once
        chosen = np.array([i for i, (_, own) in enumerate(groups) if len(own) == k])
        own = np.array([groups[i][1] for i in chosen])
        gram = np.ones((len(own), 1, 1))
        if k > 1:
            gram = columns[own] @ columns[own].mT
            gram /= unit[own][:, :, None] * unit[own][:, None, :]
        least, axes = np.linalg.eigh(gram)
        some = told[own].all(axis=1) & (least[:, 0] >= _SINGULAR)
        inverse = (axes[some] / least[some][:, None]) @ axes[some].mT
        slope = slopes[own[some]]
        b = np.einsum("gij,gj->gi", inverse, slope)
        taken = (b * slope).sum(axis=1)
        variance = np.maximum(power - taken, 1e-12 * power) / max(free - k, 1)
        spread = variance[:, None] * np.diagonal(inverse, axis1=1, axis2=2)
        gains[chosen[some]] = taken / variance
        for i, t in zip(chosen[some], b / np.sqrt(spread), strict=True):
            found[i] = t
    return Asked(found, gains, (tone(y, d.layout), push(y, d.layout, width), delay))


def _delayed(keys: Sequence[Key], z: Array, y: Array, free: int) -> Scan:
    """Find the far delay that leaves least: a coefficient of one, and how fast the torque changed.

    As the first is no free coefficient, only that of the rate is fitted.
    """
    first = [i for i, key in enumerate(keys) if key.delay and key.number == 0]
    if not first:
        return Scan(DELAY, 0.0, 0.0)
    rate = z[:, np.add(first, 1)]
    left = y[:, None] - z[:, first]
    size = np.maximum(np.einsum("ij,ij->j", rate, rate), 1e-300)
    left = left - rate * (np.einsum("ij,ij->j", rate, left) / size)
    power = float(y @ y)
    rest = np.maximum(np.einsum("ij,ij->j", left, left), 1e-12 * power)
    gains = (power - rest) / rest * (free - 2)
    best = int(np.argmax(gains))
    return Scan(keys[first[0]].kind, max(float(gains[best]), 0.0), keys[first[best]].delay)


def scored(mine: Asked, others: Sequence[Asked]) -> tuple[Array, Array]:
    """How unlikely each statistic is among the replicates', as a standard normal; scans last.

    The squared distance of a candidate's t from the replicates' mean, in their covariance, is
    Hotelling's [1]_. Half of the mean counts as spread: the recording may share what filters and
    encoder make of a right model or not. The largest of a scan is taken for Gumbel's, with the
    replicates' mean and sd.

    References
    ----------
    .. [1] H. Hotelling, "The generalization of Student's ratio", Annals of Mathematical Statistics
       2 (1931) 360-378.

    Shapes: ``z : ndarray`` (m,), ``null : ndarray`` (n, m).
    """
    n, m = len(others), len(mine.t)
    more = len(mine.scans)
    z, null = np.zeros(m + more), np.zeros((n, m + more))
    for i, x in enumerate(mine.t):
        t = np.array([one.t[i] for one in others])
        if np.isnan(x).any() or np.isnan(t).any():
            continue
        mean, cov = t.mean(axis=0), np.atleast_2d(np.cov(t.T))
        wide = _shrunk(cov) + HALF**2 * np.outer(mean, mean)
        far = float((x - mean) @ np.linalg.solve(wide, x - mean))
        z[i] = float(_normal(np.array(far), x.size, n))
        # of each replicate, without itself in mean and covariance
        apart = (t - mean) * n / (n - 1)
        pairs = apart[:, :, None] * apart[:, None, :]
        each = _shrunk(((n - 1) * cov - (n - 1) / n * pairs) / (n - 2))
        h = np.einsum("ij,ijk,ik->i", apart, np.linalg.inv(each), apart)
        null[:, i] = _normal(h, x.size, n - 1)
    for i, scan in enumerate(mine.scans):
        peaks = np.array([one.scans[i].peak for one in others])
        mean = (peaks.sum() - peaks) / (n - 1)
        sd = np.array([np.delete(peaks, k).std(ddof=1) for k in range(n)])
        # where replicates show nothing at all, a unit of chi squared
        sd, all_sd = np.maximum(sd, 1.0), max(float(peaks.std(ddof=1)), 1.0)
        z[m + i] = _extreme(np.array((scan.peak - peaks.mean()) / all_sd))
        null[:, m + i] = _extreme((peaks - mean) / sd)
    return z, null


def _shrunk(covariance: Array) -> Array:
    """Take a tenth off what covariances ``(..., k, k)`` have beside the diagonal."""
    one = np.eye(covariance.shape[-1])
    return np.asarray(covariance * (0.9 + 0.1 * one) + 1e-9 * one)


def _normal(square: Array, k: int, n: int) -> Array:
    """Give the standard normal as unlikely as a squared distance from ``n`` others in ``k``.

    That is Hotelling's: their mean and covariance are estimates.
    """
    f = square * n / (n + 1) / (n - 1)
    p = betainc(0.5 * (n - k), 0.5 * k, 1.0 / (1.0 + f))
    return np.asarray(-ndtri_exp(np.minimum(np.log(np.maximum(p, 1e-300) / 2.0), -1e-12)))


def _extreme(u: Array) -> Array:
    """Give the standard normal as unlikely as a standardised Gumbel's, the largest of many."""
    g = u * math.pi / math.sqrt(6.0) + float(np.euler_gamma)
    small = np.maximum(-np.expm1(-np.exp(-np.minimum(g, 20.0))), 1e-12)
    logs = np.where(g > 20.0, -g, np.log(small))
    return np.asarray(-ndtri_exp(logs - math.log(2.0)))


def unit_scores(d: Columns, size: Array) -> tuple[Array, float]:
    """Give scores of unit columns beside the model's own, of a whitened replicate, and their sd."""
    base = basis_of(d.base)
    rest, left = without(base, d.others * size), without(base, d.left)
    unit = np.linalg.norm(rest, axis=0)
    scores = rest.T @ left / np.where(unit > 0.0, unit, np.inf)
    return np.asarray(scores), math.sqrt(mean_square(left, base.shape[1]))
