"""Simulated positions of a joint, and their derivatives by parameters and initial states.

Every segment of a recording is simulated from its own initial state, driven by the measured
torque (section 4.3). Segments do not depend on each other, so moving all their initial positions
(or speeds) at once differentiates by each of them, and taking them out of a least-squares
problem is one small QR decomposition a segment (variable projection). This is multiple
shooting without continuity constraints.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from bayesfric.mechanism.forward import simulate_segments
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.trajectory import Trajectory

# Most integration steps a sample; more do not pay where measured torque has kinks at samples.
_MAX_SUBSTEPS = 64
# Tolerated discretisation error, as a share of the encoder's resolution.
_SHARE_OF_RESOLUTION = 0.01
# Share of a sample for which an initial speed must carry the joint to be identified.
_LEAST_REACH = 1e-2


class Sensitivities(NamedTuple):
    """Simulated positions and their derivatives."""

    positions: Array  # (n,) rad or m
    parameters: Array  # (n, d) by the free parameters
    states: Array  # (n, 2) by position and speed at the start of the segment each sample is in


class Shooting:
    """Simulation of recordings, each of their K segments from its own state."""

    def __init__(self, chain: Joint, trajectories: Sequence[Trajectory], substeps: int) -> None:
        self.chain, self.trajectories, self.substeps = chain, tuple(trajectories), substeps
        # (n,) position inside the segments of all recordings, rad or m; of each sample the
        # recording, the segment counted over all, the place on an even grid of time
        self.measured = np.concatenate([t.position[t.samples] for t in trajectories])
        sizes = [t.samples.size for t in trajectories]
        self.recording_of = np.repeat(np.arange(len(sizes)), sizes)
        lengths = np.concatenate([np.diff(t.segments, axis=1)[:, 0] for t in trajectories])
        # (K + 1,): segment k is borders[k]:borders[k + 1] of these
        self.borders = np.concatenate([[0], np.cumsum(lengths)])
        self.segment_of = np.repeat(np.arange(lengths.size), lengths)
        self.periods = np.repeat(
            [t.period for t in trajectories], [len(t.segments) for t in trajectories]
        )
        # (K, 2) position and speed to start the search for the initial states from
        self.initial = np.concatenate([np.stack([t.q0, t.qd0], axis=1) for t in trajectories])
        places, first = [], 0
        for t in trajectories:
            # a gap of a tenth of the recording keeps it from being a neighbour of the next
            places.append(t.samples + first)
            first += t.position.size + t.position.size // 10 + 1
        self.places = np.concatenate(places)

    @property
    def n_segments(self) -> int:
        """Number of segments of all recordings."""
        return int(self.initial.shape[0])

    def positions(self, values: Array, states: Array, substeps: int | None = None) -> Array:
        """Simulate the positions ``(m, n)`` of vectors ``(m, n_parameters)``; NaN if unstable.

        ``states`` are ``(K, 2)``, or ``(m, K, 2)`` for each vector.
        """
        return self.motion(values, states, substeps)[0]

    def motion(
        self, values: Array, states: Array, substeps: int | None = None
    ) -> tuple[Array, Array]:
        """Simulate as :meth:`positions` does; positions and speeds, ``(m, n)`` each."""
        m = values.shape[0]
        states = np.broadcast_to(states, (m, self.n_segments, 2))
        blocks, first = [], 0
        for t in self.trajectories:
            part = states[:, first : first + len(t.segments)]
            first += len(t.segments)
            simulated = simulate_segments(
                self.chain,
                values,
                t.torque,
                t.period,
                t.segments,
                part[..., 0],
                part[..., 1],
                inputs=t.inputs,
                begin=float(t.time[0]),
                hold=t.hold,
                substeps=self.substeps if substeps is None else substeps,
            )
            blocks.append([x[:, t.samples] for x in simulated])
        q, qd = (np.concatenate(both, axis=1) for both in zip(*blocks, strict=True))
        return q, qd

    def sensitivities(
        self,
        values: Array,
        states: Array,
        steps: Array,
        state_steps: tuple[float, float],
        limits: tuple[Array, Array] | None = None,
        *,
        central: bool = True,
    ) -> Sensitivities:
        """Simulate and differentiate, all finite differences side by side.

        By the parameters with a step ``(n_parameters,)``. Central differences, of the same order
        but one-sided at a limit; or plain one-sided ones, at half the cost.
        """
        if limits is None:
            lower = np.array([p.lower for p in self.chain.parameters])
            upper = np.array([p.upper for p in self.chain.parameters])
        else:
            lower, upper = limits
        moving = np.flatnonzero(steps)
        d = moving.size
        h = steps[moving]
        first_side = np.where(values[moving] - h < lower[moving], 1.0, -1.0)
        second_side = np.where(
            first_side > 0, 2.0, np.where(values[moving] + h > upper[moving], -2.0, 1.0)
        )
        sides = np.array([first_side, second_side]) * h
        widths = np.concatenate([sides, np.multiply.outer([1.0, -1.0], state_steps)], axis=1)
        widths = widths if central else widths[:1]
        # for each way a row a parameter and a row a state; then the middle
        rows = widths.size + 1
        vectors, starts = np.tile(values, (rows, 1)), np.tile(states, (rows, 1, 1))
        for side, changes in enumerate(widths):
            first = side * (d + 2)
            vectors[first + np.arange(d), moving] += changes[:d]
            for i in range(2):
                starts[first + d + i, :, i] += changes[d + i]
        *out, middle = self.positions(vectors, starts)
        slopes = np.stack(
            [
                _slope(middle, out[j], out[d + 2 + j] if central else None, *widths[:, j])
                for j in range(d + 2)
            ],
            axis=1,
        )
        return Sensitivities(middle, slopes[:, :d], slopes[:, d:])


class Elimination:
    """A least-squares problem with the initial states eliminated, by a QR of each segment.

    ``projected`` and ``onto`` are those of its columns, ``lost`` the number of states eliminated,
    and ``back`` ``(K, 2, 2)`` leads from coefficients of orthonormal bases to the states.
    """

    def __init__(self, shooting: Shooting, states: Array, columns: Array) -> None:
        self._borders, self.lost = shooting.borders, 0
        self._base = np.zeros((columns.shape[0], 2))
        self.back = np.zeros((shooting.n_segments, 2, 2))
        for k, (a, b) in enumerate(pairwise(self._borders)):
            q, r = np.linalg.qr(states[a:b])
            # where the joint sticks at the start, its speed is noise of the differences
            full = abs(r[1, 1]) > _LEAST_REACH * shooting.periods[k] * abs(r[0, 0])
            rank = 2 if full else 1
            self.lost += rank
            self._base[a:b, :rank] = q[:, :rank]
            self.back[k, :rank, :rank] = np.linalg.inv(r[:rank, :rank])
        self.projected, self.onto = self.of(columns)

    def of(self, columns: Array) -> tuple[Array, Array]:
        """Eliminate the states of columns ``(n, k)``: projected ``(n, k)``, onto ``(K, 2, k)``."""
        parts = self._base[:, :, None] * columns[:, None, :]
        coefficients = np.add.reduceat(parts, self._borders[:-1], axis=0)
        spread = np.repeat(coefficients, np.diff(self._borders), axis=0)
        return columns - np.einsum("ni,nik->nk", self._base, spread), self.back @ coefficients


def resolution(position: Array) -> float:
    """Smallest change of position ``(N,)`` that a recording resolves.

    The larger of the smallest step between values and the noise of neighbouring samples (third
    differences: motion itself hardly shows in them).
    """
    span = float(np.ptp(position))
    gaps = np.diff(np.unique(position))
    # rounding of a conversion of units is not a step of the encoder
    gaps = gaps[gaps > 1e-9 * span]
    step = float(gaps.min()) if gaps.size else 0.0
    noise = float(np.median(np.abs(np.diff(position, 3)))) / (0.6745 * np.sqrt(20.0))
    return float(max(step, noise, 1e-9 * span, 1e-12))


def choose_substeps(
    shooting: Shooting, values: Array, states: Array, small: float | None = None
) -> tuple[int, float]:
    """Choose integration steps a sample: the fewest powers of two that err little."""
    if small is None:
        small = _SHARE_OF_RESOLUTION * min(resolution(t.position) for t in shooting.trajectories)
    substeps = 1
    coarse = shooting.positions(values[None], states, substeps)[0]
    while True:
        error, fine = step_error(shooting, values, states, substeps, coarse)
        if not error > small or substeps >= _MAX_SUBSTEPS:
            return substeps, error
        substeps, coarse = 2 * substeps, fine


def step_error(
    shooting: Shooting, values: Array, states: Array, substeps: int, coarse: Array | None = None
) -> tuple[float, Array]:
    """Discretisation error at a number of substeps, and positions ``(n,)`` with twice as many."""
    if coarse is None:
        coarse = shooting.positions(values[None], states, substeps)[0]
    fine = shooting.positions(values[None], states, 2 * substeps)[0]
    return float(np.nanmax(np.abs(fine - coarse))) * 16.0 / 15.0, fine


def _slope(middle: Array, first: Array, second: Array | None, a: float, b: float = 0.0) -> Array:
    """Differentiate at zero the parabola through 0, ``a`` and ``b``; a line if one is missing."""
    if second is None or not np.isfinite(second).all():
        return np.asarray((first - middle) / a)
    if not np.isfinite(first).all():
        return np.asarray((second - middle) / b)
    return np.asarray(((first - middle) * b / a - (second - middle) * a / b) / (b - a))
