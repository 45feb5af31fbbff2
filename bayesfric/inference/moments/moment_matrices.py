"""Reduction of a recording to matrices of its residual moments.

With the signs of ``psi2 l`` at a centre, the filtered residuals are ``E c``: rows ``[y, psi1,
sign(qd) sigma psi2]`` and the coefficients of
:class:`bayesfric.inference.moments.linear_torque.LinearTorque`. Every moment is then ``c' Q c``.
Samples whose sign may differ from the centre's within the region are kept, to correct the outputs
they contribute to.

Rounding. ``c' Q c`` would lose twice the digits that measured and modelled torque have in common.
So a first pass finds coordinates ``z = A c`` in which the columns of E are nearly orthonormal, one
of them being the residual of a linear fit, and the second pass sums the products of ``E inv(A)``.
Cancellation then occurs once, in ``A c``, as in a plain residual: the sum of squares S is off by
about ``K eps (S + s sqrt(S) + eps s^2)``, ``s`` being the root sum of squares of measured torque
and of each column times its coefficient.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bayesfric.inference.moments.linear_torque import LinearTorque
from bayesfric.inference.moments.residual_moments import Runs, product_sum
from bayesfric.recordings.arrays import Array, Index
from bayesfric.recordings.observation import Observation

# Neighbouring kept outputs with one flag.
CELL = 8
# Raw samples in memory at once.
_CHUNK = 16384
# Relative size below which a direction of the columns is not stretched further.
_STRETCH = 1e-14
# Relative size below which a direction is dropped if there are columns for unknown shapes.
_SHAPED = 1e-22
# Largest share of the samples that is kept, and the number that always may be.
_KEPT_SHARE, _KEPT = 0.2, 20_000
# Least cosine between a draw and the mean direction to shape the region.
_ALONG = 0.2
# Least spread of any direction: relative to the mean, and absolute (the centre has length 1).
_FLOOR, _LEAST = 1e-6, 1e-12


@dataclass(frozen=True, eq=False)
class SignRegion:
    """Ellipsoids ``|inv(root) (l - centre)| <= R`` of load parameters with certain signs.

    The sign of ``psi l``, the direction of power, does not depend on the length of ``l``: the
    distance is that of the ray through ``l``. A sample has the centre's sign at distances below its
    ratio ``|psi centre| / |root' psi|``.
    """

    centre: Array  # (n2,) load parameters in motor units, of any length
    root: Array  # (n2, n2), root root' is the draws' covariance about it

    @cached_property
    def _inverse(self) -> Array:
        return np.asarray(np.linalg.inv(self.root))

    @classmethod
    def around(cls, legs: Array, size: Array) -> SignRegion | None:
        """Fit the region to load parameters ``(n, n2)``; ``size`` ``(n2,)`` scales them."""
        if legs.shape[1] == 0:
            return cls(np.zeros(0), np.zeros((0, 0)))
        torques = legs * size
        length = np.linalg.norm(torques, axis=1)
        valid = np.isfinite(length) & (length > 0.0)
        unit = torques[valid] / length[valid, None]
        mean = unit.mean(axis=0) if unit.size else np.zeros(legs.shape[1])
        if not np.linalg.norm(mean) > 0.0:
            return None
        mean /= np.linalg.norm(mean)
        alignment = unit @ mean
        aligned = alignment > _ALONG
        if not aligned.any():
            return None
        # scaled to one length along the mean direction, as lengths do not matter
        scaled = unit[aligned] / alignment[aligned, None]
        centre = scaled.mean(axis=0)
        deviations = scaled - centre
        covariance = deviations.T @ deviations / max(scaled.shape[0] - 1, 1)
        floor = _FLOOR * np.trace(covariance) / mean.size + _LEAST
        covariance[np.diag_indices(mean.size)] += floor
        return cls(centre / size, np.linalg.cholesky(covariance) / size[:, None])

    def distance(self, legs: Array) -> Array:
        """Return the distance ``(n,)`` of rays through ``(n, n2)`` from the centre."""
        if self.centre.size == 0:
            return np.zeros(legs.shape[0])
        # products with an inverse are faster than solves
        ray = self._inverse @ legs.T
        target = self._inverse @ self.centre
        with np.errstate(all="ignore"):
            # avoid overflow
            ray /= np.abs(ray).max(axis=0)
            closest = target @ ray / (ray * ray).sum(axis=0)
            distance = np.sqrt(((closest * ray - target[:, None]) ** 2).sum(axis=0))
        return np.where(closest > 0.0, distance, np.where(np.isnan(closest), np.nan, np.inf))

    def ratios(self, psi: Array) -> Array:
        """Return the distance ``(n,)`` up to which samples ``(n2, n)`` have the centre's sign."""
        level = self.centre @ psi
        spread = self.root.T @ psi
        width = np.sqrt(np.einsum("kn,kn->n", spread, spread))
        ratio = np.full(level.size, np.inf)
        np.divide(np.abs(level), width, out=ratio, where=width > 0.0)
        return ratio


@dataclass(frozen=True, eq=False)
class MomentMatrices:
    """One recording, reduced."""

    # (K, k) A': coefficients (n, K) times this are z; k < K if columns for one shape are nearly
    # equal
    to_columns: Array
    # (U,) increasing ratios of the kept samples
    ratios: Array
    arrays: tuple[Any, ...]  # compiled arguments of :mod:`bayesfric.inference.moments.fast_moments`
    padded: int  # length of rows, a multiple of four
    entries: int  # number of moments
    radius: float  # distance up to which kept samples are complete


@dataclass(frozen=True, eq=False)
class _Chunk:
    """A block of outputs and the raw samples that they depend on."""

    outputs: slice
    samples: slice
    psi2: Array  # (n2, samples)
    level: Array  # (samples,) psi2 at the centre
    phi: Array  # (m, samples) functions of speed
    rows: Array  # (K, outputs) filtered columns


def moment_matrices(
    linear: LinearTorque, o: Observation, order: int, region: SignRegion, radius: float
) -> MomentMatrices:
    """Reduce a recording, in two passes over blocks."""
    gram = np.zeros((linear.size, linear.size))
    ratio = np.full(o.q.size, np.inf)
    for chunk in _chunks(linear, o, region):
        gram += chunk.rows @ chunk.rows.T
        ratio[chunk.samples] = region.ratios(chunk.psi2)
    starts, length = o.filter.starts, o.filter.taps.size
    covered = _union(starts, starts + length, o.q.size)
    kept, ratios, radius = _candidates(o, ratio, covered, radius)
    to_columns, stretch = _orthonormal(gram, _SHAPED if linear.shapes else 0.0)

    runs = Runs.of(o, order)
    first_output = np.searchsorted(starts, kept - length, side="right")
    end_output = np.searchsorted(starts, kept, side="right")
    outputs = _with_neighbours(_union(first_output, end_output, starts.size), runs, order)
    size = to_columns.shape[1]
    padded = -(-size // 4) * 4
    rows = np.zeros((outputs.size, padded))  # E inv(A) of the kept outputs
    # sigma psi2 of kept samples; its product with the load parameters is negative if the sign
    # differs
    signs = np.zeros((len(linear.names2), kept.size))
    jumps = np.zeros((kept.size, linear.functions_of_speed))
    by_sample = np.argsort(kept, kind="stable")
    ordered = kept[by_sample]

    sums = _Products(order, size, runs)
    for chunk in _chunks(linear, o, region):
        transformed = stretch.T @ chunk.rows
        sums.add(transformed, chunk.outputs.start)
        a, b = np.searchsorted(outputs, (chunk.outputs.start, chunk.outputs.stop))
        rows[a:b, :size] = transformed[:, outputs[a:b] - chunk.outputs.start].T
        a, b = np.searchsorted(ordered, (chunk.samples.start, chunk.samples.stop))
        places = ordered[a:b] - chunk.samples.start
        signs[:, by_sample[a:b]] = (
            np.where(chunk.level[places] >= 0.0, 1.0, -1.0) * chunk.psi2[:, places]
        )
        jumps[by_sample[a:b]] = chunk.phi[:, places].T

    # the kept outputs first:last that each sample contributes to, and its weights
    first = np.searchsorted(outputs, first_output)
    last = first + (end_output - first_output)
    weights = np.zeros((kept.size, int((end_output - first_output).max(initial=1))))
    for i in range(weights.shape[1]):
        active = np.flatnonzero(first_output + i < end_output)
        output = first_output[active] + i
        weights[active, i] = o.filter.taps[kept[active] - starts[output]] * o.filter.gains[output]
    age, remaining = runs.age[outputs], runs.remaining[outputs]
    inner = (age == order) & (remaining == order)  # the order reaches neither end of the run
    # times z and the residual's jump, the first-order change of lagged products; pairs of outputs
    # at the edge of a run are excluded
    slopes = np.zeros((kept.size, order + 1, padded))
    _slopes(first, last, weights, rows, age, remaining, inner, slopes)
    # each moment is z' Q z, in the layout of bayesfric.inference.moments.residual_moments.unpacked;
    # products of different coordinates once
    matrices = sums.matrices()
    forms = np.zeros((len(matrices), size, padded))
    forms[:, :, :size] = np.triu(2.0 * matrices) - matrices * np.eye(size)
    cells = np.ones((inner.size // CELL + 1) * CELL, dtype=np.bool_)
    cells[: inner.size] = inner
    arrays = (
        forms,
        signs,
        # times lambda_2 and the product of signs with the load parameters, the change of the
        # residual
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
    """Yield blocks of a recording with filtered columns ``(K, outputs)``."""
    starts, taps = o.filter.starts, o.filter.taps
    # limit the share of overlapping windows
    reach = max(_CHUNK, 8 * taps.size) - taps.size
    start = 0
    while start < starts.size:
        nearest = starts[start : start + reach + 1]
        end = start + int(np.searchsorted(nearest, starts[start] + reach, side="right"))
        a, b = int(starts[start]), int(starts[end - 1]) + taps.size
        psi1, psi2 = linear.columns(o, a, b)
        level = region.centre @ psi2
        phi = linear.functions(o, a, b)
        side = np.where(level >= 0.0, 1.0, -1.0)
        raw = linear.rows(psi1, psi2, phi, np.sign(o.qd[a:b]), side)
        raw *= o.filter.used[a:b]
        rows = np.empty((linear.size, end - start))
        rows[0] = o.measured[start:end]
        if taps.size == 1:
            rows[1:] = taps[0] * (raw if b - a == end - start else raw[:, starts[start:end] - a])
        else:
            _filter(raw, taps, starts[start:end] - a, rows[1:])
        rows[1:] *= o.filter.gains[start:end]
        yield _Chunk(slice(start, end), slice(a, b), psi2, level, phi, rows)
        start = end


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
    """Sum the first-order change of lagged products by each kept sample's jump."""
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
    # one statement would compile for seconds
    for k in range(row.shape[0]):
        total[k] += weight * row[k]


def _candidates(
    o: Observation, ratio: Array, covered: Index, radius: float
) -> tuple[Index, Array, float]:
    """Select samples whose sign can differ within a radius, by increasing ratio.

    If they are too many, the nearest are kept and the radius is reduced.
    """
    # at standstill the loss has no direction; unused samples do not count
    counts = (o.qd[covered] != 0.0) & (o.filter.used[covered] != 0.0)
    uncertain = covered[counts & (ratio[covered] <= radius)]
    if uncertain.size > (limit := max(_KEPT, int(_KEPT_SHARE * o.q.size))):
        # the radius ends at the first sample that is not kept
        border = float(np.partition(ratio[uncertain], limit)[limit])
        uncertain, radius = uncertain[ratio[uncertain] < border], border * (1.0 - 1e-6)
    uncertain = uncertain[np.argsort(ratio[uncertain], kind="stable")]
    return uncertain, ratio[uncertain], radius


def _union(low: Index, high: Index, n: int) -> Index:
    """Return the sorted union of ranges ``low:high``."""
    change = np.zeros(n + 1, dtype=np.int32)
    np.add.at(change, low, 1)
    np.add.at(change, high, -1)
    return np.flatnonzero(np.cumsum(change[:n]) > 0)


def _with_neighbours(outputs: Index, runs: Runs, order: int) -> Index:
    """Add outputs of the same run at most ``order`` before or after."""
    neighbours = [outputs]
    for j in range(1, order + 1):
        neighbours.append(outputs[runs.age[outputs] >= j] - j)
        neighbours.append(outputs[runs.remaining[outputs] >= j] + j)
    return np.unique(np.concatenate(neighbours)) if order else outputs


def _orthonormal(gram: Array, minimum: float) -> tuple[Array, Array]:
    """Find coordinates in which columns of a Gram matrix are nearly orthonormal.

    Returns ``A'``, for coefficients, and ``inv(A)``, for columns. Directions below the ``minimum``
    share are dropped.
    """
    size = np.sqrt(np.diag(gram))
    size = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(gram / size / size[:, None])
    if minimum > 0.0:
        large = values > minimum * values[-1]
        values, vectors = values[large], vectors[:, large]
    length = np.sqrt(np.maximum(values, _STRETCH * max(float(values[-1]), 1.0)))
    return size[:, None] * vectors * length, vectors / length / size[:, None]


class _Products:
    """Sum products of rows by blocks, in the layout of the moments."""

    def __init__(self, order: int, size: int, runs: Runs) -> None:
        self._order, self._runs = order, runs
        self._before = np.zeros((size, order))
        self._lagged = [
            [np.zeros((size, size)) for _ in range(j, order + 1)] for j in range(order + 1)
        ]
        self._heads = [np.zeros((k, k, size, size)) for k in range(1, order + 1)]

    def add(self, rows: Array, first: int) -> None:
        """Add rows ``(size, n)`` of the outputs from ``first`` on."""
        p, n = self._order, rows.shape[1]
        if p == 0:
            self._lagged[0][0] += rows @ rows.T
            return
        rows = np.concatenate([self._before, rows], axis=1)
        self._before = rows[:, n:]
        age = self._runs.age[first : first + n]
        full = np.flatnonzero(age == p)
        if full.size < n:
            self._add_heads(rows, np.flatnonzero(age < p), first)
        for h in range(p + 1):
            if full.size == n:
                total = rows[:, p:] @ rows[:, p - h : p - h + n].T
            for j in range(p + 1 - h):
                later, earlier = p - j, p - j - h
                if full.size == n:
                    # same pairs except at both ends
                    dropped = rows[:, later + n : p + n] @ rows[:, earlier + n : p - h + n].T
                    added = rows[:, later:p] @ rows[:, earlier : p - h].T
                    self._lagged[j][h] += total + (added - dropped)
                else:
                    self._lagged[j][h] += rows[:, full + later] @ rows[:, full + earlier].T

    def _add_heads(self, rows: Array, outputs: Index, first: int) -> None:
        age, head = self._runs.age[first + outputs], self._runs.head[first + outputs]
        for length, sums in enumerate(self._heads, start=1):
            for k in range(length):
                later = outputs[(age == k) & (head == length)] + self._order
                for j in range(k + 1):
                    sums[j, k] += rows[:, later - (k - j)] @ rows[:, later].T

    def matrices(self) -> Array:
        """Return all sums, symmetric, ``(entries, size, size)``."""
        sums = [q for row in self._lagged for q in row]
        for k, head in enumerate(self._heads, start=1):
            sums += list(head[np.triu_indices(k)])
        stacked = np.stack(sums)
        return np.asarray(0.5 * (stacked + stacked.transpose(0, 2, 1)))
