"""Gaussian likelihood of the measured position around a simulation driven by the torque.

Nothing is differentiated. The simulation starts anew in every segment from an
unknown state. Two noises are known by their scales: that of a position sample, and
that of a torque sample, which the joint integrates: an error in the driving torque
moves the simulated joint for the rest of the segment. To first order a segment's
residual is

``q - q_sim(theta) = X dx + S e_torque + e_position``

with the derivatives ``X`` by the segment's initial state and ``S`` by its torque
samples, both taken once at a point estimate. Combinations that no initial state
changes, rotated so that ``S S'`` is diagonal, are independent normal numbers with
the variances ``sigma_q² w + sigma_Gamma² lambda``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.errors import BadInput
from bayesfric.inference.likelihood.likelihood import LikelihoodMethod, Outputs, normal_terms
from bayesfric.inference.noise.position import PositionNoise
from bayesfric.mechanism.chain import Chain
from bayesfric.mechanism.forward import simulate_segments
from bayesfric.recordings.observation import Observation
from bayesfric.recordings.trajectory import Trajectory

Array = NDArray[np.float64]

# Positions are averaged over so many samples: a segment has about this many outputs.
_OUTPUTS = 100
# Steps of the derivatives by state and torque, as shares of what is typical.
_STEP = 1e-4
# An initial state that moves no output by this share of what it could is not there.
_RANK = 1e-6
# Segments with fewer outputs than this are left out.
_LEAST_OUTPUTS = 4
# Error of the simulation against the range of the positions: below any encoder's count.
_DISCRETISATION = 1e-8
_MOST_SUBSTEPS = 64
# Rounds of moving the initial states to where the measured positions put them.
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class _Segment:
    """Linear algebra of one segment of M averaged positions.

    ``state`` ``(M, 2)``: them by the initial state, zero where it has no effect. ``response``:
    their covariance for torque noise of one. ``rotation`` ``(terms, M)``: combinations that are
    independent, of the variances ``weights`` ``(terms,)`` for torque noise of one.
    """

    begin: int
    end: int
    state: Array
    response: Array
    rotation: Array
    weights: Array


class PositionLikelihood:
    """How probable the measured positions are, given the joint's parameters and torques.

    See :class:`bayesfric.inference.likelihood.likelihood.Likelihood`.

    Parameters
    ----------
    chain
        The mechanism.
    trajectories
        One or more recordings, cut into segments.
    observations
        The same recordings, prepared.
    point
        ``(n_parameters,)`` where the derivatives are taken, near the posterior's mode.
    substeps
        Integration steps per sample; chosen at ``point`` if left out.

    Raises
    ------
    BadInput
        If the joint cannot be simulated at ``point``.
    """

    method: LikelihoodMethod = "output-error"
    noise = PositionNoise()

    def __init__(
        self,
        chain: Chain,
        trajectories: Sequence[Trajectory],
        observations: Sequence[Observation],
        point: Array,
        substeps: int | None = None,
    ) -> None:
        self.chain = chain
        self.observations = tuple(observations)
        self._trajectories, self._given = tuple(trajectories), substeps
        self._runs = [_Run(chain, t, point, substeps) for t in trajectories]
        self.outputs = tuple(run.outputs for run in self._runs)

    @property
    def discretisation(self) -> tuple[int, float]:
        """Most integration steps per sample of a recording, and the largest error they leave."""
        steps = max(run.substeps for run in self._runs)
        return steps, max(run.step_error for run in self._runs)

    def about(self, values: Array) -> PositionLikelihood:
        """Give the same likelihood with its derivatives taken at ``(n_parameters,)``."""
        return PositionLikelihood(
            self.chain, self._trajectories, self.observations, values, self._given
        )

    @property
    def outside(self) -> int:
        """See :class:`bayesfric.inference.likelihood.likelihood.Likelihood`."""
        return 0

    @property
    def cheap(self) -> bool:
        """Never: it simulates."""
        return False

    @property
    def evaluation(self) -> str:
        """How it is computed, in words."""
        return "simulation of every segment"

    def prepared(self, draws: Array) -> PositionLikelihood:  # noqa: ARG002
        """Give itself: a simulation has no short cut."""
        return self

    def log_density(self, values: Array, scales: Array) -> Array:
        """Log-likelihood, the initial states integrated out with flat priors.

        ``scales`` ``(n, n_recordings, 2)`` are noise of torque and position samples. ``-inf``
        where the joint cannot be simulated.
        """
        total = np.zeros(values.shape[0])
        for r, run in enumerate(self._runs):
            z = run.terms(values)
            variance = run.variances(scales[:, r])
            total += -0.5 * (z**2 / variance + np.log(2.0 * np.pi * variance)).sum(axis=1)
        return np.where(np.isnan(total), -np.inf, total)

    def pointwise(self, values: Array, scales: Array) -> list[Array]:
        """See :class:`bayesfric.inference.likelihood.likelihood.Likelihood`."""
        sds = [np.sqrt(run.variances(scales[:, r])) for r, run in enumerate(self._runs)]
        z = [run.terms(values) / sd for run, sd in zip(self._runs, sds, strict=True)]
        return normal_terms(z, sds)

    def predict(self, values: Array) -> list[Array]:
        """Averaged positions ``(n, M)``, each segment from the state that suits it best."""
        return [run.predict(values) for run in self._runs]

    def standardised(self, values: Array, scales: Array) -> list[Array]:
        """See :class:`bayesfric.inference.likelihood.likelihood.Likelihood`."""
        return [
            -run.terms(values) / np.sqrt(run.variances(scales[None, r]))
            for r, run in enumerate(self._runs)
        ]

    def noise_information(self, scales: Array) -> Array:
        """See :class:`bayesfric.inference.likelihood.likelihood.Likelihood`."""
        found = np.empty((len(self._runs), 2, 2))
        for r, run in enumerate(self._runs):
            torque, position = run.parts(scales[None, r])
            # d log(variance) / d scale is twice the share of the variance over the scale
            shares = 2.0 * np.concatenate([torque, position]) / (torque + position)
            shares /= scales[r][:, None]
            found[r] = 0.5 * shares @ shares.T
        return found

    def noise_sd(self, scales: Array) -> list[Array]:
        """See :class:`bayesfric.inference.likelihood.likelihood.Likelihood`."""
        return [
            np.sqrt(np.concatenate([np.diag(c) for c in run.covariances(scales[r])]))
            for r, run in enumerate(self._runs)
        ]

    def draw_noise(self, scales: Array, rng: np.random.Generator) -> list[Array]:
        """See :class:`bayesfric.inference.likelihood.likelihood.Likelihood`."""
        found = []
        for r, run in enumerate(self._runs):
            # shapes differ little over the draws: one factor, at the mean scales
            roots = [_root(c) for c in run.covariances(scales[:, r].mean(axis=0))]
            z = [rng.standard_normal((scales.shape[0], root.shape[1])) for root in roots]
            found.append(
                np.concatenate([a @ root.T for a, root in zip(z, roots, strict=True)], axis=1)
            )
        return found


class _Run:
    """One recording: its segments and how noise and states move their positions."""

    def __init__(self, chain: Chain, t: Trajectory, point: Array, substeps: int | None) -> None:
        lengths = np.diff(t.segments, axis=1)[:, 0]
        self._factor = max(1, round(float(np.median(lengths)) / _OUTPUTS))
        # two states come off each segment; what has hardly more outputs says nothing
        t = replace(t, **_kept(t, lengths >= _LEAST_OUTPUTS * self._factor))
        self._chain, self._trajectory, self.substeps = chain, t, 1
        self._q0, self._qd0 = t.q0.copy(), t.qd0.copy()
        if not np.isfinite(self._simulate(point[None])).any():
            raise BadInput(
                f"recording '{t.name}'",
                "cannot be simulated with the estimated parameters",
                "give the mechanism an inertia, or use the input-error likelihood",
            )
        for _ in range(_ROUNDS):
            self._settle_states(point)
        self._choose_substeps(point, substeps)
        self._segments = self._linearised(point)
        count = [s.state.shape[0] for s in self._segments]
        number = np.repeat(np.arange(len(count)), count)
        blocks = [self._averaged(t.time, k) for k in range(len(count))]
        self.outputs = Outputs(
            name=t.name,
            quantity="joint position",
            unit="rad" if chain.load.motion == "rotary" else "m",
            time=np.concatenate(blocks),
            measured=np.concatenate([self._averaged(t.position, k) for k in range(len(count))]),
            period=self._factor * t.period,
            segment_of=number,
            follows=np.diff(number) == 0,
        )
        self._weights = np.concatenate([s.weights for s in self._segments])

    def _choose_substeps(self, point: Array, given: int | None) -> None:
        """Halve the step until its error is far below what the position resolves."""
        self.substeps = given or 1
        used = self._trajectory.position[self._trajectory.samples]
        resolution = float(np.ptp(used)) * _DISCRETISATION
        while True:
            coarse = self._simulate(point[None])
            self.substeps *= 2
            change = float(np.nanmax(np.abs(self._simulate(point[None]) - coarse)))
            self.substeps //= 2
            # of a fourth-order method, 16/15 of what halving the step changes
            self.step_error = change * 16.0 / 15.0
            if given or self.step_error < resolution or self.substeps >= _MOST_SUBSTEPS:
                return
            self.substeps *= 2

    def terms(self, values: Array) -> Array:
        """Independent combinations of measured minus simulated position, ``(n, terms)``."""
        q = self._simulate(values)
        return np.concatenate(
            [
                (self._averaged(self._trajectory.position, k) - self._averaged(q, k)) @ s.rotation.T
                for k, s in enumerate(self._segments)
            ],
            axis=1,
        )

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
        q = self._simulate(values)
        blocks = []
        for k, s in enumerate(self._segments):
            simulated = self._averaged(q, k)
            residual = self._averaged(self._trajectory.position, k) - simulated
            whole = s.response + 1e-9 * np.trace(s.response) * np.eye(len(s.response))
            if not whole.any():
                whole = np.eye(len(whole))
            blocks.append(simulated + residual @ (s.state @ _state_gain(s, whole)).T)
        return np.concatenate(blocks, axis=1)

    def _simulate(
        self, values: Array, torque: Array | None = None, move: Array | None = None
    ) -> Array:
        t = self._trajectory
        shift = np.zeros(2) if move is None else move
        return simulate_segments(
            self._chain,
            values,
            t.torque if torque is None else torque,
            t.period,
            t.segments,
            self._q0 + shift[0],
            self._qd0 + shift[1],
            added_mass=t.added_mass,
            radius=t.radius,
            recording=t.name,
            substeps=self.substeps,
        )

    def _averaged(self, x: Array, k: int) -> Array:
        """Average a signal ``(..., N)`` over blocks of the segment's samples."""
        a, b = self._trajectory.segments[k]
        blocks = (b - a) // self._factor
        cut = x[..., a : a + blocks * self._factor]
        return np.asarray(cut.reshape(*x.shape[:-1], blocks, self._factor).mean(axis=-1))

    def _state_derivatives(self, point: Array) -> Array:
        """Positions by initial position and speed, ``(2, N)``."""
        t = self._trajectory
        span = np.ptp(t.position[t.samples])
        steps = _STEP * np.array([span, max(float(np.abs(self._qd0).max()), span)])
        found = []
        for move in np.diag(steps):
            up, down = (
                self._simulate(point[None], None, move),
                self._simulate(point[None], None, -move),
            )
            found.append((up[0] - down[0]) / (2.0 * move.sum()))
        return np.stack(found)

    def _settle_states(self, point: Array) -> None:
        """Move the initial states to where the measured positions, unweighted, put them."""
        t = self._trajectory
        residual = t.position - self._simulate(point[None])[0]
        derivative = self._state_derivatives(point)
        for k, (a, b) in enumerate(t.segments):
            block = derivative[:, a:b].T
            if np.isfinite(block).all() and np.isfinite(residual[a:b]).all():
                move = np.linalg.lstsq(block, residual[a:b], rcond=_RANK)[0]
                self._q0[k] += move[0]
                self._qd0[k] += move[1]

    def _linearised(self, point: Array) -> list[_Segment]:
        t = self._trajectory
        state = self._state_derivatives(point)
        step = _STEP * max(float(np.abs(t.torque[t.samples]).max()), 1e-12)
        longest = int(np.diff(t.segments, axis=1).max())
        blocks = [
            np.zeros(((b - a) // self._factor, b - a)) for a, b in t.segments
        ]  # averaged positions by torque samples
        for j in range(longest):
            # the same sample of every segment at once: segments do not feel each other
            moved = t.torque.copy()
            at = t.segments[:, 0] + j
            at = at[at < t.segments[:, 1]]
            moved[at] += step
            up = self._simulate(point[None], moved)[0]
            moved[at] -= 2.0 * step
            change = (up - self._simulate(point[None], moved)[0]) / (2.0 * step)
            for k, (a, b) in enumerate(t.segments):
                if a + j < b:
                    blocks[k][:, j] = self._averaged(change, k)
        return [
            _segment(int(a), int(b), self._averaged(state, k).T, blocks[k])
            for k, (a, b) in enumerate(t.segments)
        ]


def _kept(t: Trajectory, long_enough: NDArray[np.bool_]) -> dict[str, Any]:
    """Fields of a trajectory without some of its segments."""
    return {name: getattr(t, name)[long_enough] for name in ("segments", "q0", "qd0")}


def _segment(begin: int, end: int, state: Array, by_torque: Array) -> _Segment:
    state, by_torque = np.nan_to_num(state), np.nan_to_num(by_torque)
    size = np.linalg.norm(state, axis=0)
    left, singular, _ = np.linalg.svd(state / np.where(size > 0.0, size, 1.0))
    rank = int((singular > _RANK * max(float(singular[0]), 1e-300)).sum())
    free = left[:, rank:]  # combinations that no initial state changes
    response = by_torque @ by_torque.T
    weights, vectors = np.linalg.eigh(free.T @ response @ free)
    return _Segment(begin, end, state, response, (free @ vectors).T, np.clip(weights, 0.0, None))


def _state_gain(s: _Segment, covariance: Array) -> Array:
    """Best linear estimate of the initial state from a residual, ``(2, M)``."""
    weighted = np.linalg.solve(covariance, s.state)
    return np.asarray(np.linalg.pinv(s.state.T @ weighted, rcond=_RANK**2) @ weighted.T)


def _root(covariance: Array) -> Array:
    """Square root of a covariance that may be singular."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2.0)
    return np.asarray(vectors * np.sqrt(np.clip(values, 0.0, None)))
