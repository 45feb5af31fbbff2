"""Residual moments whose cost does not grow with the recording, exactly.

Mechanisms with one load-dependent friction have a torque that is linear but for the
direction of power at the gearbox, eq. (13); shapes that are not known, as a Stribeck velocity's,
make a few more columns. Near the posterior that direction is certain at nearly every
sample; these go into matrices once. A draw then costs a quadratic form, a look at the few
samples whose direction it can change, and a correction for those where it does. Far from the
posterior every sample is computed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bayesfric.inference.moments.linear_torque import Coefficients, LinearTorque, linear_torque
from bayesfric.inference.moments.moment_matrices import CELL, MomentMatrices, moment_matrices
from bayesfric.inference.moments.residual_moments import (
    Moments,
    PlainMoments,
    Short,
    head_entry,
    n_entries,
    product_sum,
    unpacked,
)
from bayesfric.inference.moments.sign_region import SignRegion
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array, Index
from bayesfric.recordings.observation import Observation

# How far the region reaches. Draws look only as far as they are away themselves, so width costs
# memory alone, up to where rounding of what is added far away would show.
RADIUS = 20.0
# Coefficients beyond this are left to the plain evaluation, which overflows where it does.
_LARGEST = 1e100
# Operations that a sample takes, about: forms of so many columns that they take more spare nothing.
_A_SAMPLE = 20
# Kept samples whose signs are looked at in one go.
_LOOK = 128


class FastMoments:
    """Moments from matrices, with the exact correction where a sample's sign differs.

    Made by :func:`fast_moments`.
    """

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
        """Give the moments at parameter vectors ``(n, n_parameters)``, SI units.

        From matrices where a vector lies within the region, sample by sample elsewhere.
        """
        n = values.shape[0]
        flat = np.empty((n, len(self._recordings), n_entries(self.order)))
        with np.errstate(all="ignore"):
            known = self._linear.coefficients(values)
            distance = self._region.distance(known.leg)
            inside = (distance <= self.radius) & (np.abs(known.all).max(axis=1) < _LARGEST)
            inside &= np.isfinite(values).all(axis=1) & known.inside
            for i, m in enumerate(self._recordings):
                flat[:, i] = self._one_recording(m, known, distance, inside)
        far = ~inside | ~np.isfinite(flat).all(axis=(1, 2))
        if far.any():
            self.slow_evaluations += int(np.count_nonzero(far))
            flat[far] = self._plain.flat(values[far])
        return unpacked(flat, self.order)

    def _one_recording(
        self,
        m: MomentMatrices,
        known: Coefficients,
        distance: Array,
        inside: NDArray[np.bool_],
    ) -> Array:
        """Give one recording's flat moments, ``(n, n_entries)``; nan where not ``inside``.

        The nearer a vector is to the centre, the fewer kept samples can have another sign.
        """
        size = m.to_columns.shape[1]
        z = np.zeros((distance.size, m.padded))
        z[:, :size] = known.all @ m.to_columns
        # rounding may blur the border, where the sign does not matter
        looked = np.searchsorted(m.ratios, distance * (1.0 + 1e-9) + 1e-12, side="right")
        looked = np.where(inside, looked, -1)
        # one layout: for another all would be compiled again
        leg = np.ascontiguousarray(known.leg)
        lambda2 = np.ascontiguousarray(known.lambda2)
        out = np.empty((distance.size, m.entries))
        _all_vectors(out, z, leg, lambda2, looked, self.order, *m.arrays)
        return out


def fast_moments(
    chain: Joint,
    observations: Sequence[Observation],
    draws: Array,
    order: int = 0,
    radius: float = RADIUS,
    plain: PlainMoments | None = None,
) -> FastMoments | None:
    """Reduce recordings for a chain that allows it.

    Shapes: ``draws`` (n, n_parameters).
    """
    draws = draws[np.isfinite(draws).all(axis=1)]
    linear = linear_torque(chain, observations, draws)
    samples = sum(o.q.size for o in observations)
    if linear is None or (linear.shapes and linear.size**2 > _A_SAMPLE * samples):
        return None
    legs = linear.coefficients(draws).leg
    region = SignRegion.around(legs, linear.typical_size())
    if region is None:
        return None
    whole = PlainMoments(chain, observations, order) if plain is None else plain
    return FastMoments(linear, region, whole, observations, radius)


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
    """Add what a changed output does to products with others that are at a run's edge too.

    The pair of an earlier output x and a later one y gives ``dx (ry + dy) + rx dy``: the
    change of the earlier goes with the other's new residual. It counts in entry ``j, k`` if
    the output j periods after y is there and has a whole past.
    """
    delta, place = change[at], int(age[at])
    for h in range(-order, order + 1):
        there = remaining[at] >= h if h >= 0 else place >= -h
        if not there or inner[at + h]:
            continue
        other = at + h
        value = product_sum(rows[other], z)
        if h >= 0:
            value += change[other]
        if h == 0:
            value += product_sum(rows[at], z)
        value *= delta
        later, apart = max(at, other), abs(h)
        entry = apart
        for j in range(order + 1 - apart):
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
    looked: Index,
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

    A quadratic form for each entry; then the kept samples whose power flows the other way, what
    each changes in its outputs, and from that the products of outputs that both change.
    """
    n_kept, size = rows.shape[0], forms.shape[1]
    alone = order == 0 and weights.shape[1] == 1
    # kept outputs whose residuals change are found again by cells
    n_cells = n_kept // CELL + 1
    change = np.zeros(n_cells * CELL + order)
    in_list, touched = np.zeros(n_cells, np.bool_), np.empty(n_cells, np.int64)
    level, hit = np.empty(_LOOK), np.empty(_LOOK, np.int64)
    apart, slope = np.empty(order + 1), np.empty(slopes.shape[1])
    for v in range(z.shape[0]):
        if looked[v] < 0:
            out[v] = np.nan
            continue
        one = z[v]
        for e in range(forms.shape[0]):
            total = 0.0
            for j in range(size):
                total += one[j] * product_sum(forms[e, j], one)
            out[v, e] = total
        n_touched = 0
        apart[:] = 0.0
        slope[:] = 0.0
        for i0 in range(0, looked[v], _LOOK):
            n = min(_LOOK, looked[v] - i0)
            now = level[:n]
            now[:] = 0.0
            for k in range(signs.shape[0]):
                row, factor = signs[k, i0 : i0 + n], leg[v, k]
                for i in range(n):
                    now[i] += row[i] * factor
            # no branch on what the next sample is like: half of them differ
            n_hits = 0
            for i in range(n):
                hit[n_hits] = i
                n_hits += now[i] < 0.0
            for i in hit[:n_hits]:
                s = i0 + i
                jump = product_sum(jumps[s], lambda2[v]) * now[i]
                row = slopes[s]
                for k in range(slope.shape[0]):
                    slope[k] += jump * row[k]
                if alone:
                    apart[0] += (weights[s, 0] * jump) ** 2
                    continue
                a, b = first[s], last[s]
                part, weight = change[a:b], weights[s, : b - a]
                for i in range(b - a):
                    part[i] += weight[i] * jump
                for c in range(a // CELL, (b - 1) // CELL + 1):
                    if not in_list[c]:
                        in_list[c] = True
                        touched[n_touched] = c
                        n_touched += 1
        for h in range(order + 1):
            apart[h] += product_sum(slope[h * one.size : (h + 1) * one.size], one)
        for c in touched[:n_touched]:
            if all_inner[c]:
                a, b = c * CELL, (c + 1) * CELL
                for h in range(order + 1):
                    apart[h] += product_sum(change[a:b], change[a + h : b + h])
                continue
            for m in range(c * CELL, min((c + 1) * CELL, n_kept)):
                if change[m] == 0.0:
                    continue
                if inner[m]:
                    for h in range(order + 1):
                        apart[h] += change[m] * change[m + h]
                    continue
                for h in range(1, order + 1):
                    if remaining[m] >= h and inner[m + h]:
                        apart[h] += change[m] * change[m + h]
                _correct_edge(m, order, one, rows, age, remaining, head, inner, change, out[v])
        entry = 0
        for j in range(order + 1):
            for h in range(order + 1 - j):
                out[v, entry] += apart[h]
                entry += 1
        for c in touched[:n_touched]:
            change[c * CELL : (c + 1) * CELL] = 0.0
            in_list[c] = False
