"""Sums of lagged products of torque residuals, from which Gaussian likelihoods follow.

White noise needs the sum of squares; autoregressive noise of order p the products of each residual
with its p predecessors, and for the exact density of the beginning of a run those among its first p
residuals. Then any noise scale costs a few multiplications.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bayesfric.estimates import autoregression as ar
from bayesfric.mechanism import kernels
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

Short = NDArray[np.int16]

# Numbers of torque in memory at once: about a fast cache.
_BLOCK_NUMBERS = 500_000


@dataclass(frozen=True, eq=False)
class Moments:
    """Lagged products of residuals of ``n`` parameter vectors and ``R`` recordings, order ``p``.

    A run is a sequence of outputs one period apart.
    """

    # (n, R, p + 1, p + 1), torque unit squared: entry j, k is the sum of r[m - j] r[m - k] over
    # outputs m with at least p predecessors in their run
    lagged: Array
    # for l from 1 to p an array (n, R, l, l): entry j, k is the sum of r_j r_k over runs whose
    # head, the first p outputs or fewer, has length l
    heads: tuple[Array, ...]

    @property
    def sum_of_squares(self) -> Array:
        """Sum of all squared residuals ``(n, R)``, torque unit squared."""
        total: Array = self.lagged[..., 0, 0].copy()
        for head in self.heads:
            total += np.trace(head, axis1=2, axis2=3)
        return total


@dataclass(frozen=True, eq=False)
class Runs:
    """Position of each output in its run."""

    # (M,) outputs before and after it in its run, at most the order
    age: Short
    remaining: Short
    head: Short  # (M,) length of its run's head, at most the order

    @classmethod
    def of(cls, observation: Observation, order: int) -> Runs:
        """Split the outputs of a recording into runs; zeros for order 0."""
        follows = ar.follows(observation)
        _, length = ar.runs(follows)
        age = ar.ages(follows, follows.size)
        remaining = np.repeat(length, length) - 1 - age
        head = np.repeat(length, length)
        return cls(*(np.minimum(x, order).astype(np.int16) for x in (age, remaining, head)))


def n_entries(order: int) -> int:
    """Return the number of distinct moments of one vector and recording.

    They are the upper triangle of ``lagged`` and then those of the heads, by rows.
    """
    lagged = (order + 1) * (order + 2) // 2
    return lagged + order * (order + 1) * (order + 2) // 6


def unpacked(flat: Array, order: int) -> Moments:
    """Convert the flat layout ``(n, R, n_entries)`` to moments."""
    parts, begin = [], 0
    for size in (order + 1, *range(1, order + 1)):
        row, column = np.triu_indices(size)
        full = np.empty((*flat.shape[:2], size, size))
        full[..., row, column] = flat[..., begin : begin + row.size]
        full[..., column, row] = flat[..., begin : begin + row.size]
        parts.append(full)
        begin += row.size
    return Moments(parts[0], tuple(parts[1:]))


class PlainMoments:
    """Moments computed sample by sample, for every chain."""

    def __init__(self, chain: Joint, observations: Sequence[Observation], order: int = 0) -> None:
        self.chain, self.order = chain, order
        runs = [Runs.of(o, order) for o in observations]
        self._inputs = [o.inputs for o in observations]
        # outputs with a full past, and heads (R, p) by length
        self.counts = np.array([np.count_nonzero(r.age == order) for r in runs], dtype=np.int64)
        lengths = [r.head[r.age == 0] for r in runs]
        self.head_counts = np.stack([np.bincount(x, minlength=order + 1)[1:] for x in lengths])
        self._recordings = [
            (o, chain.samples(o.q, o.qd, o.qdd, o.inputs, o.stamps), r)
            for o, r in zip(observations, runs, strict=True)
        ]

    def at(self, values: Array) -> Moments:
        """Compute moments at parameter vectors ``(n, n_parameters)``, SI units."""
        return unpacked(self.flat(values), self.order)

    def flat(self, values: Array) -> Array:
        """Compute them in the flat layout ``(n, R, n_entries)``."""
        flat = np.empty((values.shape[0], len(self._recordings), n_entries(self.order)))
        for i, (o, samples, runs) in enumerate(self._recordings):
            block = max(1, _BLOCK_NUMBERS // max(o.q.size, 1))
            for start in range(0, values.shape[0], block):
                part = slice(start, start + block)
                tables = self.chain.tables(values[part], o.inputs)
                residual = o.measured - o.filter.apply(kernels.inverse_many(*tables, samples))
                flat[part, i] = _products(residual, runs, self.order)
        return flat


def _products(residual: Array, runs: Runs, order: int) -> Array:
    """Sum lagged products of residuals ``(n, M)`` to ``(n, n_entries)``."""
    full = np.flatnonzero(runs.age == order)
    lagged = [residual.take(full - j, axis=1) if order else residual for j in range(order + 1)]
    pairs = [(lagged[j], lagged[k]) for j in range(order + 1) for k in range(j, order + 1)]
    for length in range(1, order + 1):
        places = [np.flatnonzero((runs.head == length) & (runs.age == k)) for k in range(length)]
        rows = [residual.take(place, axis=1) for place in places]
        pairs += [(rows[j], rows[k]) for j in range(length) for k in range(j, length)]
    return np.stack([np.einsum("vm,vm->v", a, b) for a, b in pairs], axis=1)


@njit(cache=True, inline="always")
def product_sum(x: Array, y: Array) -> float:
    """Sum of products of two arrays."""
    # four sums are as fast as reordering by the compiler, and reproducible
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    blocks = x.shape[0] // 4 * 4
    for k in range(0, blocks, 4):
        a += x[k] * y[k]
        b += x[k + 1] * y[k + 1]
        c += x[k + 2] * y[k + 2]
        d += x[k + 3] * y[k + 3]
    for k in range(blocks, x.shape[0]):
        a += x[k] * y[k]
    return (a + b) + (c + d)


@njit(cache=True)
def head_entry(order: int, length: int, j: int, k: int) -> int:
    """Return the index of ``r_j r_k``, ``j <= k``, of a head of a length in the flat layout."""
    before = (order + 1) * (order + 2) // 2 + (length - 1) * length * (length + 1) // 6
    return before + j * length - j * (j - 1) // 2 + k - j
