r"""Gaussian likelihood of the measured position around a simulation driven by the torque.

Nothing is differentiated. The simulation starts anew in every segment from an
unknown state. Two noises are known by their scales: that of a position sample, and
that of a torque sample, which the joint integrates: an error in the driving torque
moves the simulated joint for the rest of the segment. To first order a segment's
residual is

.. math:: q - q_{sim}(\theta) = X \, dx + S e_{torque} + e_{position}

with the derivatives ``X`` by the segment's initial state and ``S`` by its torque
samples, both taken once at a point estimate. Combinations that no initial state
changes, rotated so that ``S S'`` is diagonal, are independent normal numbers with
the variances ``sigma_q² w + sigma_Gamma² lambda``; positions are averages of ``1/w`` samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bayesfric.base.errors import BadInput
from bayesfric.estimates.shooting import Sensitivities, Shooting, choose_substeps
from bayesfric.inference.likelihood.likelihood import Likelihood, Outputs
from bayesfric.inference.noise.position import POSITION_NOISE
from bayesfric.mechanism.forward import simulate_segments
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation
from bayesfric.recordings.trajectory import Trajectory

# Positions are averaged over so many samples: a segment has about this many outputs.
_OUTPUTS = 100
# Steps of the derivatives by state and torque, as shares of what is typical.
_STEP = 1e-4
# The same of a state for one sample only: fine enough to move no event from sample to sample.
_ONE_STEP = 1e-6
# A torque sample is felt for half as many samples on either side, however torque is interpolated.
_FELT = 16
# An initial state that moves no output by this share of what it could is not there.
_RANK = 1e-6
# Segments with fewer outputs than this are left out.
_LEAST_OUTPUTS = 4
# Error of the simulation against the range of the positions: below any encoder's count.
_DISCRETISATION = 1e-8
# Rounds of moving the initial states to where the measured positions put them.
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class _Segment:
    """Linear algebra of one segment of M averaged positions.

    ``state`` ``(M, 2)``: their derivatives by the initial state, each over its own norm; zero where
    it has no effect.
    ``response``: their covariance for torque noise of one. ``rotation`` ``(terms, M)``:
    combinations that are independent, of the variances ``weights`` ``(terms,)`` for torque noise of
    one.
    """

    state: Array
    response: Array
    rotation: Array
    weights: Array


class PositionLikelihood(Likelihood):
    """How probable the measured positions are, given the joint's parameters and torques.

    Shapes: ``point`` (n_parameters,).
    """

    method = "output-error"
    noise = POSITION_NOISE

    def __init__(
        self,
        chain: Joint,
        trajectories: Sequence[Trajectory],
        observations: Sequence[Observation],
        point: Array,
    ) -> None:
        self.chain, self.observations = chain, tuple(observations)
        self._trajectories = tuple(trajectories)
        self._runs = [_Run(chain, t, point) for t in trajectories]
        self.outputs = tuple(run.outputs for run in self._runs)

    def relinearised_at(self, values: Array) -> PositionLikelihood:
        """Give the same likelihood with its derivatives taken at ``(n_parameters,)``."""
        return PositionLikelihood(self.chain, self._trajectories, self.observations, values)

    def log_density(self, values: Array, scales: Array) -> Array:
        """See :class:`Likelihood`; initial states are integrated out with flat priors.

        ``-inf`` where nothing can be simulated.
        """
        total = sum(terms.sum(axis=1) for terms in self.pointwise(values, scales))
        return np.where(np.isnan(total), -np.inf, total)

    def pointwise(self, values: Array, scales: Array) -> list[Array]:
        """See :class:`Likelihood`: of independent combinations of positions, not single ones."""
        sds = [np.sqrt(run.variances(scales[:, r])) for r, run in enumerate(self._runs)]
        z = [run.terms(values) / sd for run, sd in zip(self._runs, sds, strict=True)]
        return [
            -0.5 * a**2 - np.log(s) - 0.5 * np.log(2.0 * np.pi) for a, s in zip(z, sds, strict=True)
        ]

    def predict(self, values: Array) -> list[Array]:
        """Predict averaged positions, each segment from the state that suits it best.

        ``(n, M)`` a recording, rad or m.
        """
        return [run.predict(values) for run in self._runs]

    def standardised(self, values: Array, scales: Array) -> list[Array]:
        """See :class:`Likelihood`."""
        return [
            -run.terms(values) / np.sqrt(run.variances(scales[None, r]))
            for r, run in enumerate(self._runs)
        ]

    def noise_information(self, scales: Array) -> Array:
        """See :class:`Likelihood`."""
        found = np.empty((len(self._runs), 2, 2))
        for r, run in enumerate(self._runs):
            torque, position = run.parts(scales[None, r])
            # d log(variance) / d scale is twice the share of the variance over the scale
            shares = 2.0 * np.concatenate([torque, position]) / (torque + position)
            shares /= scales[r][:, None]
            found[r] = 0.5 * shares @ shares.T
        return found

    def noise_sd(self, scales: Array) -> list[Array]:
        """See :class:`Likelihood`."""
        return [
            np.sqrt(np.concatenate([np.diag(c) for c in run.covariances(scales[r])]))
            for r, run in enumerate(self._runs)
        ]

    def draw_noise(self, scales: Array, rng: np.random.Generator) -> list[Array]:
        """See :class:`Likelihood`; the shape of the covariance is that of the mean scales."""
        found = []
        for r, run in enumerate(self._runs):
            # shapes differ little over the draws: one factor, at the mean scales
            roots = [_root(c) for c in run.covariances(scales[:, r].mean(axis=0))]
            z = [rng.standard_normal((len(scales), len(root))) for root in roots]
            found.append(
                np.concatenate([a @ root.T for a, root in zip(z, roots, strict=True)], axis=1)
            )
        return found


class _Run:
    """One recording: its segments and how noise and states move their positions.

    Of segments with at least four averaged positions. Initial states are moved to where the
    measured positions put them before derivatives are taken. BadInput where nothing can be
    simulated.
    """

    def __init__(self, chain: Joint, t: Trajectory, point: Array) -> None:
        lengths = np.diff(t.segments, axis=1)[:, 0]
        self._factor = max(1, round(float(np.median(lengths)) / _OUTPUTS))
        # two states come off each segment; what has hardly more outputs says nothing
        long = lengths >= _LEAST_OUTPUTS * self._factor
        t = replace(t, segments=t.segments[long], q0=t.q0[long], qd0=t.qd0[long])
        self._trajectory, self._shooting = t, Shooting(chain, [t], 1)
        self._states = self._shooting.initial.copy()
        if not np.isfinite(self._shooting.positions(point[None], self._states)).any():
            raise BadInput(
                f"recording '{t.name}'",
                "cannot be simulated with the estimated parameters",
                "give the mechanism an inertia, or use the input-error likelihood",
            )
        for _ in range(_ROUNDS):
            self._settle_states(point)
        small = float(np.ptp(self._shooting.measured)) * _DISCRETISATION
        self.substeps, _ = choose_substeps(self._shooting, point, self._states, small)
        self._shooting.substeps = self.substeps
        self._segments = self._linearised(point)
        count = [s.state.shape[0] for s in self._segments]
        number = np.repeat(np.arange(len(count)), count)
        self._measured = [self._averaged(self._shooting.measured, k) for k in range(len(count))]
        time = t.time[t.samples]
        self.outputs = Outputs(
            name=t.name,
            quantity="joint position",
            unit="rad" if chain.load.motion == "rotary" else "m",
            time=np.concatenate([self._averaged(time, k) for k in range(len(count))]),
            measured=np.concatenate(self._measured),
            period=self._factor * t.period,
            segment_of=number,
            follows=np.diff(number) == 0,
        )
        self._weights = np.concatenate([s.weights for s in self._segments])

    def terms(self, values: Array) -> Array:
        """Independent combinations of measured minus simulated position, ``(n, terms)``."""
        q = self._shooting.positions(values, self._states)
        segments = zip(self._measured, self._segments, strict=True)
        left = [(m - self._averaged(q, k)) @ s.rotation.T for k, (m, s) in enumerate(segments)]
        return np.concatenate(left, axis=1)

    def parts(self, scales: Array) -> tuple[Array, Array]:
        """Variances from torque and from position noise, ``(n, terms)`` each."""
        torque = scales[:, :1] ** 2 * self._weights
        # an average of independent samples
        return torque, np.broadcast_to(scales[:, 1:] ** 2 / self._factor, torque.shape)

    def variances(self, scales: Array) -> Array:
        """Variances of the terms, ``(n, terms)``; ``scales`` ``(n, 2)``."""
        torque, position = self.parts(scales)
        return torque + position

    def covariances(self, scales: Array) -> list[Array]:
        """Covariance of residuals after the best state is taken off, a segment each."""
        found = []
        for s in self._segments:
            whole = scales[0] ** 2 * s.response
            whole = whole + scales[1] ** 2 / self._factor * np.eye(len(whole))
            fit = s.state @ _state_gain(s, whole)
            found.append(whole - fit @ whole)
        return found

    def predict(self, values: Array) -> Array:
        """Averaged positions ``(n, M)`` from the states that suit the measured ones best."""
        q = self._shooting.positions(values, self._states)
        blocks = []
        for k, s in enumerate(self._segments):
            simulated = self._averaged(q, k)
            residual = self._measured[k] - simulated
            whole = s.response + 1e-9 * np.trace(s.response) * np.eye(len(s.response))
            if not whole.any():
                whole = np.eye(len(whole))
            blocks.append(simulated + residual @ (s.state @ _state_gain(s, whole)).T)
        return np.concatenate(blocks, axis=1)

    def _averaged(self, x: Array, k: int) -> Array:
        """Average a signal ``(..., n)`` over blocks of the segment's samples."""
        a, b = self._shooting.borders[k : k + 2]
        blocks = (b - a) // self._factor
        cut = x[..., a : a + blocks * self._factor]
        return np.asarray(cut.reshape(*x.shape[:-1], blocks, self._factor).mean(axis=-1))

    def _state_derivatives(self, point: Array) -> Sensitivities:
        """Positions, and them by initial position and speed."""
        span = float(np.ptp(self._shooting.measured))
        steps = (_STEP * span, _STEP * max(float(np.abs(self._states[:, 1]).max()), span))
        return self._shooting.sensitivities(point, self._states, np.zeros(point.size), steps)

    def _settle_states(self, point: Array) -> None:
        """Move the initial states to where the measured positions, unweighted, put them."""
        found = self._state_derivatives(point)
        residual = self._shooting.measured - found.positions
        for k, (a, b) in enumerate(pairwise(self._shooting.borders)):
            if np.isfinite(found.states[a:b]).all() and np.isfinite(residual[a:b]).all():
                self._states[k] += np.linalg.lstsq(found.states[a:b], residual[a:b], rcond=_RANK)[0]

    def _linearised(self, point: Array) -> list[_Segment]:
        state = self._state_derivatives(point).states.T
        blocks = enumerate(self._by_torque(point))
        return [_segment(self._averaged(state, k).T, block) for k, block in blocks]

    def _by_torque(self, point: Array) -> list[Array]:
        """Differentiate averaged positions by torque samples, ``(M, samples)`` a segment."""
        t = self._trajectory
        lengths = np.diff(t.segments, axis=1)[:, 0]
        blocks = [np.zeros((n // self._factor, n)) for n in lengths]
        maps, pushes = self._steps(point)
        # position and speed by torque samples, of all segments side by side
        moved = np.zeros((lengths.size, int(lengths.max()), 2))
        for i in range(int(lengths.max()) - 1):
            some = np.flatnonzero(lengths > i + 1)
            at = t.segments[some, 0] + i
            moved[some] = moved[some] @ maps[at].swapaxes(1, 2)
            for first in range(_FELT):
                j = i - (i - first + _FELT // 2) % _FELT + _FELT // 2
                felt = lengths[some] > j
                if j >= 0 and felt.any():
                    moved[some[felt], j] += pushes[at[felt], first]
            for k in some:
                block = (i + 1) // self._factor
                if block < len(blocks[k]):
                    blocks[k][block] += moved[k, : lengths[k], 0] / self._factor
        return blocks

    def _steps(self, point: Array) -> tuple[Array, Array]:
        """Differentiate the motion from each sample to the next by state and torque.

        Position and speed by those a sample before, ``(N, 2, 2)``, and by torque samples, one in
        ``_FELT`` of which is moved at a time, ``(N, _FELT, 2)``: what a step feels of one further
        off is nothing.
        """
        t = self._trajectory
        n = t.position.size
        q, qd = np.zeros((2, n))
        # a segment that runs away has no motion, and no derivatives
        q[t.samples], qd[t.samples] = (
            np.nan_to_num(x[0]) for x in self._shooting.motion(point[None], self._states)
        )
        place = np.zeros(n, dtype=np.int64)  # in the segment
        place[t.samples] = np.concatenate([np.arange(b - a) for a, b in t.segments])
        before = np.concatenate([np.arange(a, b - 1) for a, b in t.segments])
        speed = max(float(np.abs(qd).max()), float(np.ptp(q)))
        small = _ONE_STEP * np.array([float(np.ptp(q)), speed])
        push = _STEP * max(float(np.abs(t.torque[t.samples]).max()), 1e-12)
        maps, pushes = np.zeros((n, 2, 2)), np.zeros((n, _FELT, 2))
        shifts = np.concatenate([np.diag(small), -np.diag(small)])
        for odd in (0, 1):  # ranges of samples may not overlap
            at = before[place[before] % 2 == odd]
            if not at.size:
                continue
            begin = np.stack([q[at], qd[at]], axis=1)
            ends = partial(self._ends, point, at)
            up, down = np.split(ends(begin + shifts[:, None], t.torque), 2)
            maps[at] = np.moveaxis((up - down) / (2.0 * small[:, None, None]), 0, 2)
            for first in range(_FELT):
                change = push * (place % _FELT == first)
                up, down = (ends(begin[None], t.torque + s * change)[0] for s in (1.0, -1.0))
                pushes[at, first] = (up - down) / (2.0 * push)
        return np.nan_to_num(maps), np.nan_to_num(pushes)

    def _ends(self, point: Array, at: NDArray[np.int64], begin: Array, torque: Array) -> Array:
        """Position and speed a sample after ``at`` ``(m,)`` from ``(n, m, 2)``; so many."""
        t = self._trajectory
        positions, speeds = simulate_segments(
            self._shooting.chain,
            np.tile(point, (len(begin), 1)),
            torque,
            t.period,
            np.stack([at, at + 2], axis=1),
            begin[..., 0],
            begin[..., 1],
            inputs=t.inputs,
            begin=float(t.time[0]),
            hold=t.hold,
            substeps=self.substeps,
        )
        return np.stack([positions[:, at + 1], speeds[:, at + 1]], axis=-1)


def _segment(state: Array, by_torque: Array) -> _Segment:
    """Find the combinations of a segment's positions that no initial state changes.

    From derivatives by state ``(M, 2)`` and by torque samples ``(M, samples)``.
    """
    state, by_torque = np.nan_to_num(state), np.nan_to_num(by_torque)
    size = np.linalg.norm(state, axis=0)
    state = state / np.where(size > 0.0, size, 1.0)
    left, singular, _ = np.linalg.svd(state)
    rank = int((singular > _RANK * max(float(singular[0]), 1e-300)).sum())
    free = left[:, rank:]  # combinations that no initial state changes
    response = by_torque @ by_torque.T
    weights, vectors = np.linalg.eigh(free.T @ response @ free)
    return _Segment(state, response, (free @ vectors).T, np.clip(weights, 0.0, None))


def _state_gain(s: _Segment, covariance: Array) -> Array:
    """Best linear estimate of the initial state from a residual, ``(2, M)``, over its norms."""
    weighted = np.linalg.solve(covariance, s.state)
    return np.asarray(np.linalg.pinv(s.state.T @ weighted, rcond=_RANK**2) @ weighted.T)


def _root(covariance: Array) -> Array:
    """Square root of a covariance that may be singular."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2.0)
    return np.asarray(vectors * np.sqrt(np.clip(values, 0.0, None)))
