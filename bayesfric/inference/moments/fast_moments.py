"""Residual moments at a cost independent of the recording's length, exactly.

With one load-dependent friction the torque is linear except for the direction of power at the
gearbox, eq. (13); unknown shapes, as a Stribeck velocity, add a few columns. Near the posterior
that direction is certain for nearly all samples, which are reduced to matrices once. An evaluation
is a quadratic form, plus corrections for the few samples whose direction changes. Far from the
posterior every sample is computed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bayesfric.inference.moments.linear_torque import Coefficients, LinearTorque, linear_torque
from bayesfric.inference.moments.moment_matrices import (
    CELL,
    MomentMatrices,
    SignRegion,
    moment_matrices,
)
from bayesfric.inference.moments.residual_moments import (
    Moments,
    PlainMoments,
    Short,
    head_entry,
    n_entries,
    product_sum,
    unpacked,
)
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array, Index
from bayesfric.recordings.observation import Observation

# Radius of the region. Evaluations only visit samples up to their own distance, so a larger radius
# costs memory, up to where rounding matters.
RADIUS = 20.0
# Largest coefficient; the plain evaluation handles larger ones.
_LARGEST = 1e100
# Operations per sample of a plain evaluation: forms with more columns are not faster.
_OPERATIONS_PER_SAMPLE = 20
# Kept samples whose signs are evaluated at once.
_BATCH = 128


class FastMoments:
    """Moments from matrices, with exact corrections for changed signs; see :func:`fast_moments`."""

    def __init__(
        self,
        linear: LinearTorque,
        region: SignRegion,
        plain: PlainMoments,
        observations: Sequence[Observation],
        radius: float = RADIUS,
    ) -> None:
        self.order = plain.order
        self._linear, self._region, self._plain = linear, region, plain
        self._recordings = [
            moment_matrices(linear, o, plain.order, region, radius) for o in observations
        ]
        self.radius = min(m.radius for m in self._recordings)
        self.uncertain_samples = sum(m.ratios.size for m in self._recordings)
        self.slow_evaluations = 0

    def at(self, values: Array) -> Moments:
        """Compute moments at parameter vectors ``(n, n_parameters)``, SI units."""
        n = values.shape[0]
        flat = np.empty((n, len(self._recordings), n_entries(self.order)))
        with np.errstate(all="ignore"):
            coefficients = self._linear.coefficients(values)
            distance = self._region.distance(coefficients.leg)
            inside = (distance <= self.radius) & (np.abs(coefficients.all).max(axis=1) < _LARGEST)
            inside &= np.isfinite(values).all(axis=1) & coefficients.inside
            for i, m in enumerate(self._recordings):
                flat[:, i] = self._recording_moments(m, coefficients, distance, inside)
        slow = ~inside | ~np.isfinite(flat).all(axis=(1, 2))
        if slow.any():
            self.slow_evaluations += int(np.count_nonzero(slow))
            flat[slow] = self._plain.flat(values[slow])
        return unpacked(flat, self.order)

    def _recording_moments(
        self,
        m: MomentMatrices,
        coefficients: Coefficients,
        distance: Array,
        inside: NDArray[np.bool_],
    ) -> Array:
        """Compute one recording's flat moments ``(n, n_entries)``, nan where not ``inside``."""
        size = m.to_columns.shape[1]
        z = np.zeros((distance.size, m.padded))
        z[:, :size] = coefficients.all @ m.to_columns
        # tolerance at the border, where the sign does not matter
        n_candidates = np.searchsorted(m.ratios, distance * (1.0 + 1e-9) + 1e-12, side="right")
        n_candidates = np.where(inside, n_candidates, -1)
        # one memory layout, to compile once
        leg = np.ascontiguousarray(coefficients.leg)
        lambda2 = np.ascontiguousarray(coefficients.lambda2)
        out = np.empty((distance.size, m.entries))
        _all_vectors(out, z, leg, lambda2, n_candidates, self.order, *m.arrays)
        return out


def fast_moments(
    chain: Joint,
    observations: Sequence[Observation],
    draws: Array,
    order: int = 0,
    radius: float = RADIUS,
    plain: PlainMoments | None = None,
) -> FastMoments | None:
    """Reduce recordings near draws ``(n, n_parameters)``, if the chain allows it."""
    draws = draws[np.isfinite(draws).all(axis=1)]
    linear = linear_torque(chain, observations, draws)
    samples = sum(o.q.size for o in observations)
    if linear is None or (linear.shapes and linear.size**2 > _OPERATIONS_PER_SAMPLE * samples):
        return None
    legs = linear.coefficients(draws).leg
    region = SignRegion.around(legs, linear.typical_size())
    if region is None:
        return None
    plain = PlainMoments(chain, observations, order) if plain is None else plain
    return FastMoments(linear, region, plain, observations, radius)


@njit(cache=True)
def _correct_edge(
    at: int,
    order: int,
    z: Array,
    rows: Array,
    age: Short,
    remaining: Short,
    head: Short,
    inner: NDArray[np.bool_],
    change: Array,
    out: Array,
) -> None:
    """Add a changed output's effect on products with others at a run's edge.

    A pair of an earlier output x and a later one y gives ``dx (ry + dy) + rx dy``: the change of
    the earlier is combined with the other's new residual. It counts in entry ``j, k`` if the output
    j periods after y exists and has a full past.
    """
    delta, place = change[at], int(age[at])
    for h in range(-order, order + 1):
        exists = remaining[at] >= h if h >= 0 else place >= -h
        if not exists or inner[at + h]:
            continue
        other = at + h
        value = product_sum(rows[other], z)
        if h >= 0:
            value += change[other]
        if h == 0:
            value += product_sum(rows[at], z)
        value *= delta
        later, lag = max(at, other), abs(h)
        entry = lag
        for j in range(order + 1 - lag):
            if remaining[later] >= j and age[later] + j >= order:
                out[entry] += value
            entry += order + 1 - j
        if place < order and 0 <= place + h < head[at]:
            j, k = min(place, place + h), max(place, place + h)
            out[head_entry(order, head[at], j, k)] += value


@njit(cache=True)
def _all_vectors(
    out: Array,
    z: Array,
    leg: Array,
    lambda2: Array,
    n_candidates: Index,
    order: int,
    forms: Array,
    signs: Array,
    jumps: Array,
    first: Index,
    last: Index,
    weights: Array,
    slopes: Array,
    rows: Array,
    age: Short,
    remaining: Short,
    head: Short,
    inner: NDArray[np.bool_],
    all_inner: NDArray[np.bool_],
) -> None:
    """Fill ``out`` ``(n, n_entries)`` with the moments of each vector.

    A quadratic form for each entry, then the changes by kept samples whose power flows the other
    way, and the products of outputs that both change.
    """
    n_kept, size = rows.shape[0], forms.shape[1]
    single_output = order == 0 and weights.shape[1] == 1
    # changed outputs are found again by cells
    n_cells = n_kept // CELL + 1
    change = np.zeros(n_cells * CELL + order)
    in_list, changed_cells = np.zeros(n_cells, np.bool_), np.empty(n_cells, np.int64)
    level, flipped = np.empty(_BATCH), np.empty(_BATCH, np.int64)
    correction, slope = np.empty(order + 1), np.empty(slopes.shape[1])
    for v in range(z.shape[0]):
        if n_candidates[v] < 0:
            out[v] = np.nan
            continue
        vector = z[v]
        for e in range(forms.shape[0]):
            total = 0.0
            for j in range(size):
                total += vector[j] * product_sum(forms[e, j], vector)
            out[v, e] = total
        n_changed = 0
        correction[:] = 0.0
        slope[:] = 0.0
        for i0 in range(0, n_candidates[v], _BATCH):
            n = min(_BATCH, n_candidates[v] - i0)
            levels = level[:n]
            levels[:] = 0.0
            for k in range(signs.shape[0]):
                row, factor = signs[k, i0 : i0 + n], leg[v, k]
                for i in range(n):
                    levels[i] += row[i] * factor
            # branch-free, as half of the samples differ
            n_flipped = 0
            for i in range(n):
                flipped[n_flipped] = i
                n_flipped += levels[i] < 0.0
            for i in flipped[:n_flipped]:
                s = i0 + i
                jump = product_sum(jumps[s], lambda2[v]) * levels[i]
                row = slopes[s]
                for k in range(slope.shape[0]):
                    slope[k] += jump * row[k]
                if single_output:
                    correction[0] += (weights[s, 0] * jump) ** 2
                    continue
                a, b = first[s], last[s]
                changes, weight = change[a:b], weights[s, : b - a]
                for i in range(b - a):
                    changes[i] += weight[i] * jump
                for c in range(a // CELL, (b - 1) // CELL + 1):
                    if not in_list[c]:
                        in_list[c] = True
                        changed_cells[n_changed] = c
                        n_changed += 1
        for h in range(order + 1):
            correction[h] += product_sum(slope[h * vector.size : (h + 1) * vector.size], vector)
        for c in changed_cells[:n_changed]:
            if all_inner[c]:
                a, b = c * CELL, (c + 1) * CELL
                for h in range(order + 1):
                    correction[h] += product_sum(change[a:b], change[a + h : b + h])
                continue
            for m in range(c * CELL, min((c + 1) * CELL, n_kept)):
                if change[m] == 0.0:
                    continue
                if inner[m]:
                    for h in range(order + 1):
                        correction[h] += change[m] * change[m + h]
                    continue
                for h in range(1, order + 1):
                    if remaining[m] >= h and inner[m + h]:
                        correction[h] += change[m] * change[m + h]
                _correct_edge(m, order, vector, rows, age, remaining, head, inner, change, out[v])
        entry = 0
        for j in range(order + 1):
            for h in range(order + 1 - j):
                out[v, entry] += correction[h]
                entry += 1
        for c in changed_cells[:n_changed]:
            change[c * CELL : (c + 1) * CELL] = 0.0
            in_list[c] = False
