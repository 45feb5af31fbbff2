r"""Output-error likelihood: measured position around a simulation driven by the torque.

Nothing is differentiated. The simulation restarts in every segment from an unknown state. Position
and torque samples are noisy; the joint integrates torque noise, so a torque error moves the
simulation for the rest of the segment. To first order a segment's residual is

.. math:: q - q_{sim}(\theta) = X \, dx + S e_{torque} + e_{position}

with the derivatives ``X`` by the segment's initial state and ``S`` by its torque samples, both at a
point estimate. Combinations orthogonal to ``X``, rotated so that ``S S'`` is diagonal, are
independent normal with variances ``sigma_q² w + sigma_Gamma² lambda``; positions are averages of
``1/w`` samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from scipy import stats

from bayesfric.base.errors import BadInput
from bayesfric.estimates.output_error import Shooting, choose_substeps
from bayesfric.estimates.trajectory import Trajectory
from bayesfric.inference.likelihood import LikelihoodMethod, Outputs
from bayesfric.inference.noise import POSITION_NOISE
from bayesfric.mechanism.forward import simulate_segments
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array, Index
from bayesfric.recordings.filters import later
from bayesfric.recordings.signals import Signals

# Relative steps of the derivatives by state and torque.
_STEP = 1e-4
# Relative singular value below which an initial state has no effect.
_RANK = 1e-6


@dataclass(frozen=True, eq=False)
class _Segment:
    """Linear algebra of one segment of M averaged positions."""

    state: Array  # (M, 2) derivatives by the initial state over their norms; zero if no effect
    response: Array  # (M, M) covariance for unit torque noise
    rotation: Array  # (terms, M) independent combinations
    weights: Array  # (terms,) their variances for unit torque noise


class PositionLikelihood:
    """Likelihood of the measured positions, linearised at a ``point`` ``(n_parameters,)``.

    Methods and shapes are those of :class:`bayesfric.inference.likelihood.TorqueLikelihood`.
    """

    method: LikelihoodMethod = "output-error"
    noise = POSITION_NOISE
    slow_evaluations, fast = 0, False

    def __init__(
        self,
        chain: Joint,
        trajectories: Sequence[Trajectory],
        observations: Sequence[Signals],
        point: Array,
    ) -> None:
        self.chain, self.observations = chain, tuple(observations)
        self._trajectories = tuple(trajectories)
        self._runs = [_Recording(chain, t, point) for t in trajectories]
        self.outputs = tuple(run.outputs for run in self._runs)

    def relinearised_at(self, values: Array) -> PositionLikelihood:
        """Return the same likelihood, linearised at ``(n_parameters,)``."""
        return PositionLikelihood(self.chain, self._trajectories, self.observations, values)

    def subsample(self) -> PositionLikelihood:
        """Return the likelihood itself: positions are averaged already."""
        return self

    def precomputed(self, _: Array) -> PositionLikelihood:
        """Return the likelihood itself: simulations cannot be precomputed."""
        return self

    def log_density(self, values: Array, scales: Array) -> Array:
        """Log-likelihood ``(n,)``; ``-inf`` if simulation fails.

        Initial states are integrated out with flat priors.
        """
        total = sum(terms.sum(axis=1) for terms in self.pointwise(values, scales))
        return np.where(np.isnan(total), -np.inf, total)

    def pointwise(self, values: Array, scales: Array) -> list[Array]:
        """Log densities ``(n, terms)`` a recording, of independent combinations of positions."""
        sds = [np.sqrt(run.variances(scales[:, r])) for r, run in enumerate(self._runs)]
        z = [run.terms(values) / sd for run, sd in zip(self._runs, sds, strict=True)]
        return [stats.norm.logpdf(a) - np.log(s) for a, s in zip(z, sds, strict=True)]

    def predict(self, values: Array) -> list[Array]:
        """Predict averaged positions ``(n, M)`` from the best initial states, rad or m."""
        return [run.predict(values) for run in self._runs]

    def standardised(self, values: Array, scales: Array) -> list[Array]:
        """Modelled terms with unit noise, ``(n, terms)`` a recording; ``scales`` ``(R, 2)``."""
        return [
            -run.terms(values) / np.sqrt(run.variances(scales[None, r]))
            for r, run in enumerate(self._runs)
        ]

    def noise_information(self, scales: Array) -> Array:
        """Fisher information ``(R, 2, 2)`` of noise scales ``(R, 2)``."""
        information = np.empty((len(self._runs), 2, 2))
        for r, run in enumerate(self._runs):
            torque, position = run.parts(scales[None, r])
            # d log(variance) / d scale is twice the share of the variance over the scale
            shares = 2.0 * np.concatenate([torque, position]) / (torque + position)
            shares /= scales[r][:, None]
            information[r] = 0.5 * shares @ shares.T
        return information

    def noise_sd(self, scales: Array) -> list[Array]:
        """Return standard deviations ``(M,)`` of averaged positions a recording."""
        return [
            np.sqrt(np.concatenate([np.diag(c) for c in run.covariances(scales[r])]))
            for r, run in enumerate(self._runs)
        ]

    def draw_noise(self, scales: Array, rng: np.random.Generator) -> list[Array]:
        """Draw noise ``(n, M)`` a recording, with the correlations at the mean scales."""
        draws = []
        for r, run in enumerate(self._runs):
            # correlations hardly differ between draws
            roots = [_root(c) for c in run.covariances(scales[:, r].mean(axis=0))]
            z = [rng.standard_normal((len(scales), len(root))) for root in roots]
            draws.append(
                np.concatenate([a @ root.T for a, root in zip(z, roots, strict=True)], axis=1)
            )
        return draws


class _Recording:
    """One recording: its segments, and the effect of noise and initial states on positions.

    BadInput if it cannot be simulated.
    """

    def __init__(self, chain: Joint, t: Trajectory, point: Array) -> None:
        lengths = np.diff(t.segments, axis=1)[:, 0]
        self._factor = max(1, round(float(np.median(lengths)) / 100))  # positions a segment
        # two states are fitted in each segment
        long = lengths >= 4 * self._factor
        t = replace(t, segments=t.segments[long], q0=t.q0[long], qd0=t.qd0[long])
        self._trajectory, self._shooting = t, Shooting(chain, [t], 1)
        self._states = self._shooting.initial.copy()
        if not np.isfinite(self._shooting.positions(point[None], self._states)).any():
            raise BadInput(
                f"recording '{t.name}'",
                "cannot be simulated with the estimated parameters",
                "give the mechanism an inertia, or use the input-error likelihood",
            )
        for _ in range(3):
            self._fit_states(point)
        small = 1e-8 * float(np.ptp(self._shooting.measured))  # below an encoder's count
        self.substeps, _ = choose_substeps(self._shooting, point, self._states, small)
        self._shooting.substeps = self.substeps
        state = self._state_derivatives(point)[1].T
        self._segments = [
            _segment(self._averaged(state, k).T, by_torque)
            for k, by_torque in enumerate(self._by_torque(point))
        ]
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
        """Independent combinations ``(n, terms)`` of measured minus simulated position."""
        q = self._shooting.positions(values, self._states)
        segments = zip(self._measured, self._segments, strict=True)
        residuals = [(m - self._averaged(q, k)) @ s.rotation.T for k, (m, s) in enumerate(segments)]
        return np.concatenate(residuals, axis=1)

    def parts(self, scales: Array) -> tuple[Array, Array]:
        """Variances ``(n, terms)`` from torque and from position noise."""
        torque = scales[:, :1] ** 2 * self._weights
        # an average of independent samples
        return torque, np.broadcast_to(scales[:, 1:] ** 2 / self._factor, torque.shape)

    def variances(self, scales: Array) -> Array:
        """Variances ``(n, terms)`` of the terms; ``scales`` ``(n, 2)``."""
        torque, position = self.parts(scales)
        return torque + position

    def covariances(self, scales: Array) -> list[Array]:
        """Covariance of residuals after fitting the initial state, a segment each."""
        remaining = []
        for s in self._segments:
            total = scales[0] ** 2 * s.response
            total = total + scales[1] ** 2 / self._factor * np.eye(len(total))
            fit = s.state @ _state_gain(s, total)
            remaining.append(total - fit @ total)
        return remaining

    def predict(self, values: Array) -> Array:
        """Averaged positions ``(n, M)`` from the best initial states."""
        q = self._shooting.positions(values, self._states)
        blocks = []
        for k, s in enumerate(self._segments):
            simulated = self._averaged(q, k)
            residual = self._measured[k] - simulated
            response = s.response + 1e-9 * np.trace(s.response) * np.eye(len(s.response))
            if not response.any():
                response = np.eye(len(response))
            blocks.append(simulated + residual @ (s.state @ _state_gain(s, response)).T)
        return np.concatenate(blocks, axis=1)

    def _averaged(self, x: Array, k: int) -> Array:
        """Average a signal ``(..., n)`` over blocks of the segment's samples."""
        a, b = self._shooting.borders[k : k + 2]
        blocks = (b - a) // self._factor
        trimmed = x[..., a : a + blocks * self._factor]
        return np.asarray(trimmed.reshape(*x.shape[:-1], blocks, self._factor).mean(axis=-1))

    def _state_derivatives(self, point: Array) -> tuple[Array, Array]:
        """Positions ``(n,)``, and their derivatives ``(n, 2)`` by initial position and speed."""
        span = float(np.ptp(self._shooting.measured))
        steps = (_STEP * span, _STEP * max(float(np.abs(self._states[:, 1]).max()), span))
        held = np.zeros(point.size)
        positions, _, by_state = self._shooting.sensitivities(point, self._states, held, steps)
        return positions, by_state

    def _fit_states(self, point: Array) -> None:
        """Fit the initial states to the measured positions."""
        positions, by_state = self._state_derivatives(point)
        residual = self._shooting.measured - positions
        for k, (a, b) in enumerate(pairwise(self._shooting.borders)):
            if np.isfinite(by_state[a:b]).all() and np.isfinite(residual[a:b]).all():
                self._states[k] += np.linalg.lstsq(by_state[a:b], residual[a:b], rcond=_RANK)[0]

    def _by_torque(self, point: Array) -> list[Array]:
        """Differentiate averaged positions by torque samples, ``(M, samples)`` a segment."""
        t = self._trajectory
        lengths = np.diff(t.segments, axis=1)[:, 0]
        blocks = [np.zeros((n // self._factor, n)) for n in lengths]
        by_state, by_torque = self._steps(point)
        # derivatives of position and speed by torque samples, of all segments
        derivatives = np.zeros((lengths.size, int(lengths.max()), 2))
        for i in range(int(lengths.max()) - 1):
            running = np.flatnonzero(lengths > i + 1)
            samples = t.segments[running, 0] + i
            derivatives[running] = derivatives[running] @ by_state[samples].swapaxes(1, 2)
            for end in (0, 1):
                derivatives[running, i + end] += by_torque[samples, end]
            for k in running:
                block = (i + 1) // self._factor
                if block < len(blocks[k]):
                    blocks[k][block] += derivatives[k, : lengths[k], 0] / self._factor
        return blocks

    def _steps(self, point: Array) -> tuple[Array, Array]:
        """Differentiate the motion over one sample by state and by torque, ``(N, 2, 2)`` each.

        The torque, at the time that the motion shows it, acts between two samples. Every other one
        is moved at a time.
        """
        t, chain = self._trajectory, self._shooting.chain
        n = t.position.size
        q, qd = np.zeros((2, n))
        # a diverging segment has no derivatives
        q[t.samples], qd[t.samples] = (
            np.nan_to_num(x[0]) for x in self._shooting.motion(point[None], self._states)
        )
        place = np.zeros(n, dtype=np.int64)  # in the segment
        place[t.samples] = np.concatenate([np.arange(b - a) for a, b in t.segments])
        before = np.concatenate([np.arange(a, b - 1) for a, b in t.segments])
        speed = max(float(np.abs(qd).max()), float(np.ptp(q)))
        # small enough not to shift events between samples
        small = 1e-6 * np.array([float(np.ptp(q)), speed])
        torque_step = _STEP * max(float(np.abs(t.torque[t.samples]).max()), 1e-12)
        by_state, by_torque = np.zeros((2, n, 2, 2))
        torque = t.torque
        if chain.delay and not chain.by_target:
            torque = later(torque, float(chain.delays(point[None])[0]) / t.period)
        prompt = replace(chain, delay=None), point[[n != chain.delay_name for n in chain.names]]
        shifts = np.concatenate([np.diag(small), -np.diag(small)])
        for parity in (0, 1):  # ranges of samples must not overlap
            samples = before[place[before] % 2 == parity]
            if not samples.size:
                continue
            initial = np.stack([q[samples], qd[samples]], axis=1)
            ends = partial(self._next_states, *prompt, samples)
            up, down = np.split(ends(initial + shifts[:, None], torque), 2)
            by_state[samples] = np.moveaxis((up - down) / (2.0 * small[:, None, None]), 0, 2)
            for end in (0, 1):
                change = torque_step * (place % 2 == (parity + end) % 2)
                up, down = (ends(initial[None], torque + s * change)[0] for s in (1.0, -1.0))
                by_torque[samples, end] = (up - down) / (2.0 * torque_step)
        return np.nan_to_num(by_state), np.nan_to_num(by_torque)

    def _next_states(
        self, chain: Joint, point: Array, samples: Index, initial: Array, torque: Array
    ) -> Array:
        """Position and speed one sample after ``samples`` ``(m,)`` from states ``(n, m, 2)``."""
        t = self._trajectory
        positions, speeds = simulate_segments(
            chain,
            np.tile(point, (len(initial), 1)),
            torque,
            t.period,
            np.stack([samples, samples + 2], axis=1),
            initial[..., 0],
            initial[..., 1],
            inputs=t.inputs,
            begin=float(t.time[0]),
            hold=t.hold,
            substeps=self.substeps,
        )
        return np.stack([positions[:, samples + 1], speeds[:, samples + 1]], axis=-1)


def _segment(state: Array, by_torque: Array) -> _Segment:
    """Find combinations of a segment's positions that are independent of the initial state.

    From derivatives by state ``(M, 2)`` and by torque samples ``(M, samples)``.
    """
    state, by_torque = np.nan_to_num(state), np.nan_to_num(by_torque)
    size = np.linalg.norm(state, axis=0)
    state = state / np.where(size > 0.0, size, 1.0)
    left_vectors, singular, _ = np.linalg.svd(state)
    rank = int((singular > _RANK * max(float(singular[0]), 1e-300)).sum())
    free = left_vectors[:, rank:]  # independent of the initial state
    response = by_torque @ by_torque.T
    weights, vectors = np.linalg.eigh(free.T @ response @ free)
    return _Segment(state, response, (free @ vectors).T, np.clip(weights, 0.0, None))


def _state_gain(s: _Segment, covariance: Array) -> Array:
    """Best linear estimate ``(2, M)`` of the scaled initial state from a residual."""
    weighted = np.linalg.solve(covariance, s.state)
    return np.asarray(np.linalg.pinv(s.state.T @ weighted, rcond=_RANK**2) @ weighted.T)


def _root(covariance: Array) -> Array:
    """Square root of a covariance that may be singular."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2.0)
    return np.asarray(vectors * np.sqrt(np.clip(values, 0.0, None)))
