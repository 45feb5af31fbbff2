"""Sums of products of torque residuals, all that Gaussian noise asks of a recording.

White noise needs the sum of squares. Autoregressive noise of order p needs the products of
each residual with its p predecessors, and, for the exact density of where a stretch of
recording begins, the products among its first p residuals. With these moments at hand the
likelihood of any noise scale and any AR coefficients is a few multiplications.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bayesfric.mechanism import kernels
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

Short = NDArray[np.int16]

# Numbers of torque held at once: about what a fast cache holds.
_AT_ONCE = 500_000


@dataclass(frozen=True, eq=False)
class Moments:
    """Lagged products of the residuals of ``n`` parameter vectors and ``R`` recordings.

    A run is a stretch of outputs that follow each other one period apart; ``p`` is the order.
    """

    # (n, R, p + 1, p + 1), torque unit squared: entry j, k is the sum of r[m - j] r[m - k] over the
    # outputs m with at least p predecessors in their run
    lagged: Array
    # For l from 1 to p an array (n, R, l, l): entry j, k is the sum of r_j r_k of the first l
    # residuals r_0, r_1, .. in time, over the runs whose head, the first p outputs or fewer if the
    # run is shorter, has the length l
    heads: tuple[Array, ...]

    @property
    def sum_of_squares(self) -> Array:
        """Sum of all squared residuals, ``(n, R)``, torque unit squared."""
        total: Array = self.lagged[..., 0, 0].copy()
        for head in self.heads:
            total += np.trace(head, axis1=2, axis2=3)
        return total


def follows(o: Observation) -> NDArray[np.bool_]:
    """Tell which outputs are followed, one period later in the same segment, by the next.

    Shapes: returns (M - 1,).
    """
    step = np.diff(o.filter.starts)
    return np.asarray((step == step.min(initial=step[:1].sum())) & (np.diff(o.segment_of) == 0))


@dataclass(frozen=True, eq=False)
class Runs:
    """Where each output stands in its run."""

    # (M,) outputs before and after it in its run, counted up to the order
    age: Short
    remaining: Short
    head: Short  # (M,) length of its run's head: its outputs, up to the order

    @classmethod
    def of(cls, observation: Observation, order: int) -> Runs:
        """Split the outputs of a recording into runs, for noise of an order; all zeros for 0."""
        n = observation.filter.n_outputs
        if order == 0:
            nothing = np.zeros(n, dtype=np.int16)
            return cls(nothing, nothing, nothing)
        begins = np.concatenate([[0], np.flatnonzero(~follows(observation)) + 1])[: max(n, 0)]
        length = np.diff(np.append(begins, n))
        age = np.arange(n) - np.repeat(begins, length)
        remaining = np.repeat(length, length) - 1 - age
        head = np.repeat(np.minimum(length, order), length)
        return cls(
            np.minimum(age, order).astype(np.int16),
            np.minimum(remaining, order).astype(np.int16),
            head.astype(np.int16),
        )

    def count(self, order: int) -> tuple[int, NDArray[np.int64]]:
        """Count what the density's normalisation needs.

        Shapes: ``heads`` (order,).
        """
        first = self.head[self.age == 0]
        heads = np.array([np.count_nonzero(first == k) for k in range(1, order + 1)], dtype=int)
        return int(np.count_nonzero(self.age == order)), heads


def n_entries(order: int) -> int:
    """Count the different numbers in the moments of one vector and one recording.

    They are laid out as the upper triangle of ``lagged`` and then those of the heads, by rows.
    """
    lagged = (order + 1) * (order + 2) // 2
    return lagged + order * (order + 1) * (order + 2) // 6


def unpacked(flat: Array, order: int) -> Moments:
    """Turn the flat layout ``(n, R, n_entries)`` into moments."""
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
    """Moments by going through every sample for every vector; holds for every chain."""

    def __init__(self, chain: Joint, observations: Sequence[Observation], order: int = 0) -> None:
        self.chain, self.order = chain, order
        runs = [Runs.of(o, order) for o in observations]
        self._inputs = [o.inputs for o in observations]
        counted = [r.count(order) for r in runs]
        self.counts = np.array([n for n, _ in counted], dtype=np.int64)
        self.head_counts = np.array([heads for _, heads in counted]).reshape(len(runs), order)
        self._recordings = [
            (o, chain.samples(o.q, o.qd, o.qdd, o.inputs, o.stamps), r)
            for o, r in zip(observations, runs, strict=True)
        ]

    def at(self, values: Array) -> Moments:
        """Give the moments at parameter vectors ``(n, n_parameters)``, SI units."""
        return unpacked(self.flat(values), self.order)

    def flat(self, values: Array) -> Array:
        """Give the same as :func:`unpacked` takes it, ``(n, R, n_entries)``."""
        flat = np.empty((values.shape[0], len(self._recordings), n_entries(self.order)))
        for i, (o, samples, runs) in enumerate(self._recordings):
            rows = max(1, _AT_ONCE // max(o.q.size, 1))
            for first in range(0, values.shape[0], rows):
                some = slice(first, first + rows)
                tables = self.chain.tables(values[some], o.inputs)
                residual = o.measured - o.filter.apply(kernels.inverse_many(*tables, samples))
                flat[some, i] = _products(residual, runs, self.order)
        return flat


def _products(residual: Array, runs: Runs, order: int) -> Array:
    """Sum the products of residuals ``(n, M)`` with those before them, ``(n, n_entries)``."""
    whole = np.flatnonzero(runs.age == order)
    lagged = [residual.take(whole - j, axis=1) if order else residual for j in range(order + 1)]
    pairs = [(lagged[j], lagged[k]) for j in range(order + 1) for k in range(j, order + 1)]
    for length in range(1, order + 1):
        at = [np.flatnonzero((runs.head == length) & (runs.age == k)) for k in range(length)]
        rows = [residual.take(one, axis=1) for one in at]
        pairs += [(rows[j], rows[k]) for j in range(length) for k in range(j, length)]
    return np.stack([np.einsum("vm,vm->v", one, other) for one, other in pairs], axis=1)


@njit(cache=True, inline="always")
def product_sum(x: Array, y: Array) -> float:
    """Sum of the products of two arrays of one length."""
    # Four sums side by side are as fast as letting the compiler reorder one, and
    # unlike that they come out the same wherever this is compiled.
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    whole = x.shape[0] // 4 * 4
    for k in range(0, whole, 4):
        a += x[k] * y[k]
        b += x[k + 1] * y[k + 1]
        c += x[k + 2] * y[k + 2]
        d += x[k + 3] * y[k + 3]
    for k in range(whole, x.shape[0]):
        a += x[k] * y[k]
    return (a + b) + (c + d)


@njit(cache=True)
def head_entry(order: int, length: int, j: int, k: int) -> int:
    """Place of ``r_j r_k``, ``j <= k``, of a head of this length in the flat layout."""
    before = (order + 1) * (order + 2) // 2 + (length - 1) * length * (length + 1) // 6
    return before + j * length - j * (j - 1) // 2 + k - j
