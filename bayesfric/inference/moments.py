"""Sums of lagged products of torque residuals, from which Gaussian likelihoods follow.

White noise needs the sum of squares; autoregressive noise of order p the products of each residual
with its p predecessors in a run of outputs one period apart, or as many as there are. Then any
noise scale costs a few multiplications.

:class:`FastMoments` computes them at a cost independent of the recording's length, exactly. With
one load-dependent friction the torque is linear except for the direction of power at the gearbox,
eq. (13); unknown shapes, as a Stribeck velocity, add a few columns. Near the posterior that
direction is certain for nearly all samples: with its signs at a centre, the filtered residuals are
``E c``, with rows ``[y, psi1, sign(qd) sigma psi2, ...]`` and the coefficients of
:class:`bayesfric.inference.linear_torque.LinearTorque`. Every moment is then ``c' Q c``. Samples
whose sign may differ from the centre's within a region are kept, and correct the outputs they
contribute to. Far from the posterior every sample is computed.

Rounding. ``c' Q c`` would lose twice the digits that measured and modelled torque have in common.
So a first pass finds coordinates ``z = A c`` in which the columns of E are nearly orthonormal, one
of them being the residual of a linear fit, and the second pass sums the products of ``E inv(A)``.
Cancellation then occurs once, in ``A c``, as in a plain residual: the sum of squares S is off by
about ``K eps (S + s sqrt(S) + eps s^2)``, ``s`` being the root sum of squares of measured torque
and of each column times its coefficient.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bayesfric.estimates import autoregression as ar
from bayesfric.inference.linear_torque import LinearTorque, linear_torque
from bayesfric.mechanism import kernels
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.kernels import INNER
from bayesfric.recordings.arrays import Array, Flags, Index
from bayesfric.recordings.filters import ParallelFilter
from bayesfric.recordings.signals import Signals

Short = NDArray[np.int16]

# Numbers of torque in memory at once: about a fast cache.
_BLOCK_NUMBERS = 500_000
# Radius of the region. Evaluations only visit samples up to their own distance, so a larger radius
# costs memory, up to where rounding matters.
RADIUS = 20.0
# Raw samples in memory at once.
_CHUNK = 16384


# Lagged products of residuals of n parameter vectors and R recordings: for k from 0 to the order p
# an array (n, R, k + 1, k + 1), torque unit squared, whose entry i, j is the sum of
# r[m - i] r[m - j] over the outputs m with k predecessors in their run; for the last at least p.
Moments = tuple[Array, ...]


def runs_of(observation: Signals, order: int) -> tuple[Short, Short]:
    """Count the outputs before and after each ``(M,)`` in its run, up to the order."""
    follows = ar.follows(observation)
    _, length = ar.runs(follows)
    age = ar.ages(follows, follows.size)
    remaining = np.repeat(length, length) - 1 - age
    before, after = (np.minimum(x, order).astype(np.int16) for x in (age, remaining))
    return before, after


def n_entries(order: int) -> int:
    """Return the number of distinct moments of one vector and recording.

    They are the upper triangles of each age, by rows.
    """
    return (order + 1) * (order + 2) * (order + 3) // 6


def _entries(age: Short, order: int) -> Iterator[tuple[Flags, int, int]]:
    """Yield each moment of the flat layout as outputs ``m`` and lags of ``r[m - i] r[m - j]``."""
    for k in range(order + 1):
        for i in range(k + 1):
            for j in range(i, k + 1):
                yield age == k, i, j


def unpacked(flat: Array, order: int) -> Moments:
    """Convert the flat layout ``(n, R, n_entries)`` to moments."""
    parts, begin = [], 0
    for size in range(1, order + 2):
        row, column = np.triu_indices(size)
        full = np.empty((*flat.shape[:2], size, size))
        full[..., row, column] = flat[..., begin : begin + row.size]
        full[..., column, row] = flat[..., begin : begin + row.size]
        parts.append(full)
        begin += row.size
    return tuple(parts)


class PlainMoments:
    """Moments computed sample by sample, for every chain."""

    def __init__(self, chain: Joint, observations: Sequence[Signals], order: int = 0) -> None:
        self.chain, self.order = chain, order
        ages = [runs_of(o, order)[0] for o in observations]
        # (R, p + 1) numbers of outputs by predecessors
        self.counts = np.stack([np.bincount(age, minlength=order + 1) for age in ages])
        self._recordings = [
            (
                o,
                chain.samples(o.q, o.qd, o.qdd, o.inputs, o.stamps),
                [(np.flatnonzero(flags), i, j) for flags, i, j in _entries(age, order)],
            )
            for o, age in zip(observations, ages, strict=True)
        ]

    def at(self, values: Array) -> Moments:
        """Compute moments at parameter vectors ``(n, n_parameters)``, SI units."""
        return unpacked(self.flat(values), self.order)

    def flat(self, values: Array) -> Array:
        """Compute them in the flat layout ``(n, R, n_entries)``."""
        flat = np.empty((values.shape[0], len(self._recordings), n_entries(self.order)))
        for i, (o, samples, entries) in enumerate(self._recordings):
            block = max(1, _BLOCK_NUMBERS // max(o.q.size, 1))
            for start in range(0, values.shape[0], block):
                part = slice(start, start + block)
                tables = self.chain.tables(values[part], o.inputs)
                residual = o.measured - o.filter.apply(kernels.inverse_many(*tables, samples))
                for e, (m, j, k) in enumerate(entries):
                    is_all = m.size == residual.shape[1]
                    a, b = (residual if is_all else residual.take(m - lag, 1) for lag in (j, k))
                    flat[part, i, e] = np.einsum("vm,vm->v", a, b)
        return flat


@njit(**INNER, forceinline=True)
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


@njit(**INNER)
def entry_of(age: int, i: int, j: int) -> int:
    """Return the index of ``r[m - i] r[m - j]``, ``i <= j <= age``, in the flat layout."""
    return age * (age + 1) * (age + 2) // 6 + i * (age + 1) - i * (i - 1) // 2 + j - i


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
        aligned = alignment > 0.2
        if not aligned.any():
            return None
        # scaled to one length along the mean direction, as lengths do not matter
        scaled = unit[aligned] / alignment[aligned, None]
        centre = scaled.mean(axis=0)
        deviations = scaled - centre
        covariance = deviations.T @ deviations / max(scaled.shape[0] - 1, 1)
        # least spread of any direction; the centre has length one
        covariance += (1e-6 * np.trace(covariance) / mean.size + 1e-12) * np.eye(mean.size)
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


class MomentMatrices(NamedTuple):
    """One recording, reduced."""

    # (K, k) A': coefficients (n, K) times this are z; k < K if columns for one shape are nearly
    # equal
    to_columns: Array
    forms: Array  # (entries, k, k) upper triangular Q: each moment is z' Q z
    # kept samples: (U,) increasing ratios; (n2, U) sigma psi2, whose product with the load
    # parameters is negative if the sign differs; (U, m) times lambda_2 and that product, the jump
    # of the residual; kept outputs first:last that each contributes to, and its (U, most) weights
    ratios: Array
    signs: Array
    jumps: Array
    first: Index
    last: Index
    weights: Array
    # kept outputs: (M, k) rows E inv(A), and their places in runs
    rows: Array
    age: Short
    remaining: Short


def moment_matrices(
    linear: LinearTorque, o: Signals, order: int, region: SignRegion, radius: float
) -> MomentMatrices:
    """Reduce a recording, in two passes over blocks."""
    starts, length = o.filter.starts, o.filter.taps.size
    gram, ratio = np.zeros((linear.size, linear.size)), np.full(o.q.size, np.inf)
    for _, samples, psi2, _, rows in _chunks(linear, o, region):
        gram += rows @ rows.T
        ratio[samples] = region.ratios(psi2)
    to_columns, stretch = _orthonormal(gram, drop=bool(linear.shapes))
    size = to_columns.shape[1]

    # at standstill the loss has no direction; unused samples do not count
    kept = _union(starts, starts + length, o.q.size)
    kept = kept[(o.qd[kept] != 0.0) & (o.filter.used[kept] != 0.0) & (ratio[kept] <= radius)]
    age, remaining = runs_of(o, order)
    first_output = np.searchsorted(starts, kept - length, side="right")
    end_output = np.searchsorted(starts, kept, side="right")
    near = _union(first_output, end_output, starts.size)
    neighbours = [near]  # of the same run
    for j in range(1, order + 1):
        neighbours += [near[age[near] >= j] - j, near[remaining[near] >= j] + j]
    kept_outputs = np.unique(np.concatenate(neighbours))

    kept_rows = np.zeros((kept_outputs.size, size))
    signs = np.zeros((len(linear.names2), kept.size))
    jumps = np.zeros((kept.size, linear.functions_of_speed))
    sums = np.zeros((n_entries(order), size, size))
    before = np.zeros((size, order))
    for outputs, samples, psi2, phi, rows in _chunks(linear, o, region):
        transformed = np.concatenate([before, stretch.T @ rows], axis=1)
        before = transformed[:, transformed.shape[1] - order :]
        _add_products(sums, transformed, age[outputs], order)
        a, b = np.searchsorted(kept_outputs, (outputs.start, outputs.stop))
        kept_rows[a:b] = transformed[:, order + kept_outputs[a:b] - outputs.start].T
        a, b = np.searchsorted(kept, (samples.start, samples.stop))
        places = kept[a:b] - samples.start
        at_centre = region.centre @ psi2[:, places]
        signs[:, a:b] = np.where(at_centre >= 0.0, 1.0, -1.0) * psi2[:, places]
        jumps[a:b] = 2.0 * np.sign(o.qd[kept[a:b], None]) * phi[:, places].T

    weights = np.zeros((kept.size, int((end_output - first_output).max(initial=1))))
    for i in range(weights.shape[1]):
        active = np.flatnonzero(first_output + i < end_output)
        output = first_output[active] + i
        weights[active, i] = o.filter.taps[kept[active] - starts[output]] * o.filter.gains[output]
    first = np.searchsorted(kept_outputs, first_output)
    forms = 0.5 * (sums + sums.transpose(0, 2, 1))
    by_ratio = np.argsort(ratio[kept], kind="stable")
    return MomentMatrices(
        to_columns,
        np.triu(2.0 * forms) - forms * np.eye(size),  # products of different coordinates once
        ratio[kept][by_ratio],
        np.ascontiguousarray(signs[:, by_ratio]),
        jumps[by_ratio],
        first[by_ratio],
        (first + end_output - first_output)[by_ratio],
        weights[by_ratio],
        kept_rows,
        age[kept_outputs],
        remaining[kept_outputs],
    )


def _chunks(
    linear: LinearTorque, o: Signals, region: SignRegion
) -> Iterator[tuple[slice, slice, Array, Array, Array]]:
    """Yield blocks of outputs, with the raw samples that they depend on.

    Outputs, samples, ``psi2`` ``(n2, samples)``, functions of speed ``(m, samples)``, and the
    filtered columns ``(K, outputs)``.
    """
    starts, taps = o.filter.starts, o.filter.taps
    # limit the share of overlapping windows
    reach = max(_CHUNK, 8 * taps.size) - taps.size
    start = 0
    while start < starts.size:
        nearest = starts[start : start + reach + 1]
        end = start + int(np.searchsorted(nearest, starts[start] + reach, side="right"))
        a, b = int(starts[start]), int(starts[end - 1]) + taps.size
        psi1, psi2 = linear.columns(o, a, b)
        phi = linear.functions(o, a, b)
        side = np.where(region.centre @ psi2 >= 0.0, 1.0, -1.0)
        raw = linear.rows(psi1, psi2, phi, np.sign(o.qd[a:b]), side)
        rows = np.empty((linear.size, end - start))
        rows[0] = o.measured[start:end]
        windows = starts[start:end] - a
        part = ParallelFilter(taps, windows, o.filter.used[a:b], o.filter.gains[start:end])
        rows[1:] = part.apply(raw)
        yield slice(start, end), slice(a, b), psi2, phi, rows
        start = end


def _union(low: Index, high: Index, n: int) -> Index:
    """Return the sorted union of ranges ``low:high``."""
    change = np.zeros(n + 1, dtype=np.int32)
    np.add.at(change, low, 1)
    np.add.at(change, high, -1)
    return np.flatnonzero(np.cumsum(change[:n]) > 0)


def _orthonormal(gram: Array, *, drop: bool) -> tuple[Array, Array]:
    """Find coordinates in which columns of a Gram matrix are nearly orthonormal.

    Returns ``A'``, for coefficients, and ``inv(A)``, for columns. Columns for unknown shapes are
    nearly collinear: ``drop`` leaves out directions that are rounding; others are not stretched.
    """
    size = np.sqrt(np.diag(gram))
    size = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(gram / size / size[:, None])
    if drop:
        large = values > 1e-22 * values[-1]
        values, vectors = values[large], vectors[:, large]
    length = np.sqrt(np.maximum(values, 1e-14 * max(float(values[-1]), 1.0)))
    # columns of zeros up to a multiple of four, for speed
    a, inverse = size[:, None] * vectors * length, vectors / length / size[:, None]
    padding = ((0, 0), (0, -length.size % 4))
    return np.pad(a, padding), np.pad(inverse, padding)


def _add_products(sums: Array, rows: Array, age: Short, order: int) -> None:
    """Add products of a block's rows, ``order`` previous ones first, in the flat layout."""
    n = age.size
    for entry, (flags, i, j) in enumerate(_entries(age, order)):
        if flags.any():
            later = rows[:, order - i : order - i + n]
            later = later if flags.all() else later * flags
            sums[entry] += later @ rows[:, order - j : order - j + n].T


class FastMoments:
    """Moments from matrices, with exact corrections for changed signs; see :func:`fast_moments`."""

    def __init__(
        self,
        linear: LinearTorque,
        region: SignRegion,
        plain: PlainMoments,
        observations: Sequence[Signals],
        radius: float = RADIUS,
    ) -> None:
        self.order, self.radius = plain.order, radius
        self._linear, self._region, self._plain = linear, region, plain
        self._recordings = [
            moment_matrices(linear, o, plain.order, region, radius) for o in observations
        ]
        self.uncertain_samples = sum(m.ratios.size for m in self._recordings)
        self.slow_evaluations = 0

    def at(self, values: Array) -> Moments:
        """Compute moments at parameter vectors ``(n, n_parameters)``, SI units."""
        flat = np.empty((len(values), len(self._recordings), n_entries(self.order)))
        with np.errstate(all="ignore"):
            coefficients, leg, lambda2, inside = self._linear.coefficients(values)
            distance = self._region.distance(leg)
            inside = inside & (distance <= self.radius)
            # tolerance at the border, where the sign does not matter
            reached = distance * (1.0 + 1e-9) + 1e-12
            # one memory layout, to compile once
            leg, lambda2 = np.ascontiguousarray(leg), np.ascontiguousarray(lambda2)
            for i, m in enumerate(self._recordings):
                n_candidates = np.searchsorted(m.ratios, reached, side="right")
                n_candidates[~inside] = 0
                flat[:, i] = _moments(
                    m, coefficients @ m.to_columns, leg, lambda2, n_candidates, self.order
                )
        slow = ~inside | ~np.isfinite(flat).all(axis=(1, 2))
        if slow.any():
            self.slow_evaluations += int(np.count_nonzero(slow))
            flat[slow] = self._plain.flat(values[slow])
        return unpacked(flat, self.order)


def fast_moments(
    chain: Joint,
    observations: Sequence[Signals],
    draws: Array,
    order: int = 0,
    radius: float = RADIUS,
    plain: PlainMoments | None = None,
) -> FastMoments | None:
    """Reduce recordings near draws ``(n, n_parameters)``, if the chain allows it."""
    draws = draws[np.isfinite(draws).all(axis=1)]
    linear = linear_torque(chain, observations, draws)
    if linear is None:
        return None
    # a plain evaluation takes about twenty operations a sample
    if linear.shapes and linear.size**2 > 20 * sum(o.q.size for o in observations):
        return None
    region = SignRegion.around(linear.coefficients(draws)[1], linear.typical_size())
    if region is None:
        return None
    plain = PlainMoments(chain, observations, order) if plain is None else plain
    return FastMoments(linear, region, plain, observations, radius)


@njit(cache=True)
def _moments(
    m: MomentMatrices, z: Array, leg: Array, lambda2: Array, n_candidates: Index, order: int
) -> Array:
    """Compute the flat moments ``(n, n_entries)`` of each vector.

    A quadratic form for each entry, then the changes by kept samples whose power flows the other
    way.
    """
    out = np.empty((z.shape[0], m.forms.shape[0]))
    batch = 128
    n_outputs = m.rows.shape[0]
    change, is_changed = np.empty(n_outputs), np.empty(n_outputs, np.bool_)
    changed = np.empty(n_outputs, np.int64)
    residual = np.empty(n_outputs)  # of changed outputs and their neighbours
    for k in range(n_outputs):
        change[k], is_changed[k], residual[k] = 0.0, False, np.nan
    level, flipped = np.empty(batch), np.empty(batch, np.int64)
    for v in range(z.shape[0]):
        vector = z[v]
        for e in range(m.forms.shape[0]):
            total = 0.0
            for j in range(vector.size):
                total += vector[j] * product_sum(m.forms[e, j], vector)
            out[v, e] = total
        n_changed = 0
        for i0 in range(0, n_candidates[v], batch):
            n = min(batch, n_candidates[v] - i0)
            for i in range(n):  # assignments of slices take seconds to compile
                level[i] = 0.0
            for k in range(m.signs.shape[0]):
                row, factor = m.signs[k, i0 : i0 + n], leg[v, k]
                for i in range(n):
                    level[i] += row[i] * factor
            # branch-free, as half of the samples differ
            n_flipped = 0
            for i in range(n):
                flipped[n_flipped] = i
                n_flipped += level[i] < 0.0
            for i in flipped[:n_flipped]:
                s = i0 + i
                jump = product_sum(m.jumps[s], lambda2[v]) * level[i]
                for k in range(m.first[s], m.last[s]):
                    change[k] += m.weights[s, k - m.first[s]] * jump
                    if not is_changed[k]:
                        is_changed[k] = True
                        changed[n_changed] = k
                        n_changed += 1
        for k in changed[:n_changed]:
            for y in range(k - m.age[k], k + m.remaining[k] + 1):
                if np.isnan(residual[y]):
                    residual[y] = product_sum(m.rows[y], vector)
            _add_change(m, k, order, residual, change, out[v])
        for k in changed[:n_changed]:
            change[k], is_changed[k] = 0.0, False
            for y in range(k - m.age[k], k + m.remaining[k] + 1):
                residual[y] = np.nan
    return out


@njit(**INNER)
def _add_change(
    m: MomentMatrices, x: int, order: int, residual: Array, change: Array, out: Array
) -> None:
    """Add a changed output's effect on products with others of its run.

    A pair of an earlier output x and a later one y gives ``dx (ry + dy) + rx dy``: the change of
    the earlier is combined with the other's new residual. It counts for every output until
    ``order`` periods after x.
    """
    for y in range(x - m.age[x], x + m.remaining[x] + 1):
        value = 2.0 * residual[y] if y == x else residual[y]
        if y >= x:
            value += change[y]
        value *= change[x]
        earlier, later = min(x, y), max(x, y)
        lag = later - earlier
        for i in range(min(order - lag, m.remaining[later]) + 1):
            out[entry_of(min(m.age[later] + i, order), i, i + lag)] += value
