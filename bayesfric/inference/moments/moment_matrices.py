"""A recording reduced to the matrices of its residual moments, and what they leave out.

With the signs of ``psi2 l`` at a centre, the filtered residuals are ``E c``: rows
``[y, psi1, sign(qd) sigma psi2]`` and the coefficients of
:class:`bayesfric.inference.moments.linear_torque.LinearTorque`. Every moment is then ``c' Q c``.
Where the sign differs from the centre's, a sample changes the outputs it takes part in; samples for
which it can, within the region, are kept.

Rounding. ``c' Q c`` would lose the digits that measured and modelled torque have in common
twice over. So a first pass finds coordinates ``z = A c`` in which the columns of E are nearly
orthonormal, one of them being the residual of a linear fit, and the second pass adds up the
products of ``E inv(A)``. What cancels then cancels once, in ``A c``, as it does in a plain
residual: the sum of squares S is off by about ``K eps (S + s sqrt(S) + eps s^2)``, ``s`` being
the root sum of squares of measured torque and of each column times its coefficient.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bayesfric.inference.moments.linear_torque import LinearTorque
from bayesfric.inference.moments.residual_moments import Runs, product_sum
from bayesfric.inference.moments.sign_region import SignRegion
from bayesfric.recordings.arrays import Array, Index
from bayesfric.recordings.observation import Observation

# Neighbouring kept outputs that are marked together.
CELL = 8
# Raw samples whose columns are held at once.
_CHUNK = 16384
# Relative size below which a direction of the columns is stretched no further.
_STRETCH = 1e-14
# And with columns for unknown shapes, below which it is left out: far below their accuracy.
_SHAPED = 1e-22
# At most this share of the samples is kept one by one, and in any case so many.
_KEPT_SHARE, _KEPT = 0.2, 20_000


@dataclass(frozen=True, eq=False)
class MomentMatrices:
    """One recording, reduced."""

    # (K, k) A': coefficients (n, K) times this are z. k is K, or less where columns for one shape
    # are nearly the same
    to_columns: Array
    # (U,) of the kept samples, rising: at a distance below it a sample has the centre's sign
    ratios: Array
    arrays: tuple[Any, ...]  # As :mod:`bayesfric.inference.moments.fast_moments` has them compiled
    padded: int  # Length of rows, a multiple of four
    entries: int  # How many moments
    radius: float  # Distance up to which all this is complete


@dataclass(frozen=True, eq=False)
class _Chunk:
    """Outputs ``outputs`` of a recording and the raw samples ``samples`` that they rest on.

    Of the samples ``psi2`` ``(n2, n)``, its product ``level`` ``(n,)`` with the centre, and the
    functions of speed ``phi`` ``(m, n)``; of the outputs filtered ``rows`` ``(K, outputs)``.
    """

    outputs: slice
    samples: slice
    psi2: Array
    level: Array
    phi: Array
    rows: Array


def moment_matrices(
    linear: LinearTorque, o: Observation, order: int, region: SignRegion, radius: float
) -> MomentMatrices:
    """Reduce a recording, in two passes of chunks."""
    gram = np.zeros((linear.size, linear.size))
    ratio = np.full(o.q.size, np.inf)
    for chunk in _chunks(linear, o, region):
        gram += chunk.rows @ chunk.rows.T
        ratio[chunk.samples] = region.ratios(chunk.psi2)
    starts, length = o.filter.starts, o.filter.taps.size
    covered = _joined(starts, starts + length, o.q.size)
    kept, ratios, radius = _candidates(o, ratio, covered, radius)
    to_columns, stretch = _orthonormal(gram, _SHAPED if linear.shapes else 0.0)

    runs = Runs.of(o, order)
    low = np.searchsorted(starts, kept - length, side="right")
    high = np.searchsorted(starts, kept, side="right")
    outputs = _with_neighbours(_joined(low, high, starts.size), runs, order)
    size = to_columns.shape[1]
    padded = -(-size // 4) * 4
    rows = np.zeros((outputs.size, padded))  # E inv(A) of the kept outputs
    # sigma psi2 of kept samples; its product with the leg is negative where the sign differs
    signs = np.zeros((len(linear.names2), kept.size))
    jumps = np.zeros((kept.size, linear.functions_of_speed))
    in_place = np.argsort(kept, kind="stable")
    ordered = kept[in_place]

    sums = _Products(order, size, runs)
    for chunk in _chunks(linear, o, region):
        straight = stretch.T @ chunk.rows
        sums.add(straight, chunk.outputs.start)
        a, b = np.searchsorted(outputs, (chunk.outputs.start, chunk.outputs.stop))
        rows[a:b, :size] = straight[:, outputs[a:b] - chunk.outputs.start].T
        a, b = np.searchsorted(ordered, (chunk.samples.start, chunk.samples.stop))
        at = ordered[a:b] - chunk.samples.start
        signs[:, in_place[a:b]] = np.where(chunk.level[at] >= 0.0, 1.0, -1.0) * chunk.psi2[:, at]
        jumps[in_place[a:b]] = chunk.phi[:, at].T

    # the kept outputs first:last that each takes part in, and what it weighs in each of them
    first = np.searchsorted(outputs, low)
    last = first + (high - low)
    weights = np.zeros((kept.size, int((high - low).max(initial=1))))
    for i in range(weights.shape[1]):
        has = np.flatnonzero(low + i < high)
        output = low[has] + i
        weights[has, i] = o.filter.taps[kept[has] - starts[output]] * o.filter.gains[output]
    age, remaining = runs.age[outputs], runs.remaining[outputs]
    inner = (age == order) & (remaining == order)  # the order reaches neither end of the run
    # its product with z times the residual's jump is what the sum over pairs of outputs 0, 1, ..
    # apart changes by, but for the jump's square. Pairs of outputs that are both at the edge of a
    # run are left out
    slopes = np.zeros((kept.size, order + 1, padded))
    _slopes(first, last, weights, rows, age, remaining, inner, slopes)
    # each moment is z' Q z, laid out as in bayesfric.inference.moments.residual_moments.unpacked;
    # each product of two different coordinates once
    matrices = sums.matrices()
    forms = np.zeros((len(matrices), size, padded))
    forms[:, :, :size] = np.triu(2.0 * matrices) - matrices * np.eye(size)
    cells = np.ones((inner.size // CELL + 1) * CELL, dtype=np.bool_)
    cells[: inner.size] = inner
    arrays = (
        forms,
        signs,
        # times lambda_2 and the product of signs with the leg, by so much the residual changes
        2.0 * np.sign(o.qd[kept])[:, None] * jumps,
        first,
        last,
        weights,
        slopes.reshape(kept.size, (order + 1) * padded),
        rows,
        age,
        remaining,
        runs.head[outputs],
        inner,
        cells.reshape(-1, CELL).all(axis=1),
    )
    return MomentMatrices(to_columns, ratios, arrays, padded, len(matrices), radius)


def _chunks(linear: LinearTorque, o: Observation, region: SignRegion) -> Iterator[_Chunk]:
    """Go through a recording; a chunk's rows are filtered columns ``(K, outputs)``."""
    starts, taps = o.filter.starts, o.filter.taps
    # long windows overlap: most of a chunk should not be done twice
    reach = max(_CHUNK, 8 * taps.size) - taps.size
    begin = 0
    while begin < starts.size:
        nearest = starts[begin : begin + reach + 1]
        end = begin + int(np.searchsorted(nearest, starts[begin] + reach, side="right"))
        a, b = int(starts[begin]), int(starts[end - 1]) + taps.size
        psi1, psi2 = linear.columns(o, a, b)
        level = region.centre @ psi2
        phi = linear.functions(o, a, b)
        side = np.where(level >= 0.0, 1.0, -1.0)
        raw = linear.rows(psi1, psi2, phi, np.sign(o.qd[a:b]), side)
        raw *= o.filter.used[a:b]
        rows = np.empty((linear.size, end - begin))
        rows[0] = o.measured[begin:end]
        if taps.size == 1:
            rows[1:] = taps[0] * (raw if b - a == end - begin else raw[:, starts[begin:end] - a])
        else:
            _filter(raw, taps, starts[begin:end] - a, rows[1:])
        rows[1:] *= o.filter.gains[begin:end]
        yield _Chunk(slice(begin, end), slice(a, b), psi2, level, phi, rows)
        begin = end


@njit(cache=True)
def _filter(raw: Array, taps: Array, starts: Index, out: Array) -> None:
    for k in range(raw.shape[0]):
        row = raw[k]
        for m in range(starts.shape[0]):
            out[k, m] = product_sum(taps, row[starts[m] : starts[m] + taps.shape[0]])


@njit(cache=True)
def _slopes(
    first: Index,
    last: Index,
    weights: Array,
    rows: Array,
    age: NDArray[np.int16],
    remaining: NDArray[np.int16],
    inner: NDArray[np.bool_],
    out: Array,
) -> None:
    """Add up what each kept sample's jump changes sums of lagged products by, to first order."""
    for i in range(first.shape[0]):
        for m in range(first[i], last[i]):
            weight = weights[i, m - first[i]]
            if inner[m]:
                _add(out[i, 0], 2.0 * weight, rows[m])
            for h in range(1, out.shape[1]):
                if age[m] >= h and (inner[m] or inner[m - h]):
                    _add(out[i, h], weight, rows[m - h])
                if remaining[m] >= h and (inner[m] or inner[m + h]):
                    _add(out[i, h], weight, rows[m + h])


@njit(cache=True)
def _add(total: Array, weight: float, row: Array) -> None:
    # in one statement this would compile for seconds, for the sake of its error message
    for k in range(row.shape[0]):
        total[k] += weight * row[k]


def _candidates(
    o: Observation, ratio: Array, covered: Index, radius: float
) -> tuple[Index, Array, float]:
    """Choose samples whose sign can differ within a radius: which, their rising ratios, and it.

    ``ratio`` is of every sample. Where they are too many these are the nearest, and the radius is
    smaller.
    """
    # at rest there is no loss to have a direction, and what is not used has no say
    counts = (o.qd[covered] != 0.0) & (o.filter.used[covered] != 0.0)
    near = covered[counts & (ratio[covered] <= radius)]
    if near.size > (most := max(_KEPT, int(_KEPT_SHARE * o.q.size))):
        # one sample more than is kept, so that the radius is where samples begin to lack
        border = float(np.partition(ratio[near], most)[most])
        near, radius = near[ratio[near] < border], border * (1.0 - 1e-6)
    near = near[np.argsort(ratio[near], kind="stable")]
    return near, ratio[near], radius


def _joined(low: Index, high: Index, n: int) -> Index:
    """All numbers in any of the ranges ``low:high``, rising."""
    change = np.zeros(n + 1, dtype=np.int32)
    np.add.at(change, low, 1)
    np.add.at(change, high, -1)
    return np.flatnonzero(np.cumsum(change[:n]) > 0)


def _with_neighbours(outputs: Index, runs: Runs, order: int) -> Index:
    """Give outputs and those of their runs at most ``order`` before or after."""
    found = [outputs]
    for j in range(1, order + 1):
        found.append(outputs[runs.age[outputs] >= j] - j)
        found.append(outputs[runs.remaining[outputs] >= j] + j)
    return np.unique(np.concatenate(found)) if order else outputs


def _orthonormal(gram: Array, least: float) -> tuple[Array, Array]:
    """Coordinates in which the columns with these products are nearly orthonormal.

    Returns ``A'``, which coefficients are multiplied by, and ``inv(A)``, which columns are.
    Directions with less than the ``least`` share of the squares are left out.
    """
    size = np.sqrt(np.diag(gram))
    size = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(gram / size / size[:, None])
    if least > 0.0:
        kept = values > least * values[-1]
        values, vectors = values[kept], vectors[:, kept]
    length = np.sqrt(np.maximum(values, _STRETCH * max(float(values[-1]), 1.0)))
    return size[:, None] * vectors * length, vectors / length / size[:, None]


class _Products:
    """Adds up products of rows chunk by chunk, laid out as the moments are."""

    def __init__(self, order: int, size: int, runs: Runs) -> None:
        self._order, self._runs = order, runs
        self._before = np.zeros((size, order))
        self._lagged = [
            [np.zeros((size, size)) for _ in range(j, order + 1)] for j in range(order + 1)
        ]
        self._heads = [np.zeros((k, k, size, size)) for k in range(1, order + 1)]

    def add(self, rows: Array, first: int) -> None:
        """Take rows ``(size, n)`` of the outputs from ``first`` on."""
        p, n = self._order, rows.shape[1]
        if p == 0:
            self._lagged[0][0] += rows @ rows.T
            return
        rows = np.concatenate([self._before, rows], axis=1)
        self._before = rows[:, n:]
        age = self._runs.age[first : first + n]
        whole = np.flatnonzero(age == p)
        if whole.size < n:
            self._add_heads(rows, np.flatnonzero(age < p), first)
        for h in range(p + 1):
            if whole.size == n:
                total = rows[:, p:] @ rows[:, p - h : p - h + n].T
            for j in range(p + 1 - h):
                late, early = p - j, p - j - h
                if whole.size == n:
                    # the same pairs, but for a few at both ends
                    gone = rows[:, late + n : p + n] @ rows[:, early + n : p - h + n].T
                    come = rows[:, late:p] @ rows[:, early : p - h].T
                    self._lagged[j][h] += total + (come - gone)
                else:
                    self._lagged[j][h] += rows[:, whole + late] @ rows[:, whole + early].T

    def _add_heads(self, rows: Array, at: Index, first: int) -> None:
        age, head = self._runs.age[first + at], self._runs.head[first + at]
        for length, sums in enumerate(self._heads, start=1):
            for k in range(length):
                late = at[(age == k) & (head == length)] + self._order
                for j in range(k + 1):
                    sums[j, k] += rows[:, late - (k - j)] @ rows[:, late].T

    def matrices(self) -> Array:
        """All sums, symmetric, ``(entries, size, size)``."""
        found = [q for row in self._lagged for q in row]
        for k, head in enumerate(self._heads, start=1):
            found += list(head[np.triu_indices(k)])
        stacked = np.stack(found)
        return np.asarray(0.5 * (stacked + stacked.transpose(0, 2, 1)))
