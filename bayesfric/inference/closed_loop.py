"""Closed-loop likelihood: encoder readings around their prediction from targets and earlier ones.

Without a torque the controller is part of the joint. A cubature Kalman filter predicts every
reading, see :func:`bayesfric.mechanism.closed_loop.innovations`; the likelihood is that of its
prediction errors. Noise is a slow random torque (Ornstein-Uhlenbeck) and a white one, the encoder
beyond its steps, and the instants at which it is read: a reading at another instant is off by the
speed times that.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy

import numpy as np
from scipy.signal import lfilter

from bayesfric.inference.likelihood import LikelihoodMethod, Outputs
from bayesfric.inference.noise import CLOSED_LOOP_NOISE
from bayesfric.mechanism.closed_loop import innovations
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array, Flags, Index
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.signals import Signals

# Longest integration step, s, and times the fastest motion of the closed loop, 1/s: at .6 a
# quadruped's leg is off by 1e-8 rad at most.
_LONGEST, _STEP = 7e-3, 0.6
# How far a prediction reaches that is to see nothing faster, s.
HORIZON = 0.02
_LOG_2PI = math.log(2.0 * math.pi)


class ClosedLoopLikelihood:
    """Likelihood of encoder readings, with steps chosen at a ``point`` ``(n_parameters,)``.

    Every ``stride``-th reading is used. Methods and shapes are those of
    :class:`bayesfric.inference.likelihood.TorqueLikelihood`; what needs noise scales without being
    given them has those of :meth:`at`.
    """

    method: LikelihoodMethod = "closed-loop"
    noise = CLOSED_LOOP_NOISE
    slow_evaluations, fast = 0, False

    def __init__(
        self,
        chain: Joint,
        recordings: Sequence[Measurement],
        observations: Sequence[Signals],
        point: Array,
        stride: int = 1,
    ) -> None:
        self.chain, self.observations = chain, tuple(observations)
        self.recordings, self.stride = tuple(recordings), stride
        pairs = zip(self.recordings, self.observations, strict=True)
        self._steps = [_step(chain, r, o, point) for r, o in pairs]
        self.used = [_used(r, stride) for r in recordings]
        self._values, self._scales = point, np.full((len(recordings), 5), np.nan)
        unit = "rad" if chain.load.motion == "rotary" else "m"
        self.outputs = tuple(
            Outputs(
                name=r.name,
                quantity="joint position",
                unit=unit,
                time=r.time[used],
                measured=r.position[used],
                period=stride * r.period,
                segment_of=(segment := _segment_of(r)[used]),
                follows=np.diff(segment) == 0,
            )
            for r, used in zip(recordings, self.used, strict=True)
        )

    def at(self, values: Array, scales: Array) -> ClosedLoopLikelihood:
        """Return the same likelihood with parameters ``(n_parameters,)`` and scales to refer to."""
        out = copy(self)
        out._values, out._scales = values, scales
        return out

    def with_stride(self, stride: int) -> ClosedLoopLikelihood:
        """Return the likelihood of every ``stride``-th reading."""
        return ClosedLoopLikelihood(
            self.chain, self.recordings, self.observations, self._values, stride
        ).at(self._values, self._scales)

    def of(self, recordings: Sequence[Measurement], values: Array) -> ClosedLoopLikelihood:
        """Return the likelihood of other readings, at parameters ``(n_parameters,)``."""
        return ClosedLoopLikelihood(self.chain, recordings, self.observations, values, self.stride)

    @property
    def longer(self) -> int:
        """Return the stride of predictions that reach :data:`HORIZON` ahead."""
        return max(1, round(HORIZON / max(r.period for r in self.recordings)))

    def subsample(self) -> ClosedLoopLikelihood:
        """Return the likelihood itself."""
        return self

    def precomputed(self, _: Array) -> ClosedLoopLikelihood:
        """Return the likelihood itself."""
        return self

    def errors(self, values: Array, scales: Array) -> list[tuple[Array, Array]]:
        """Return prediction errors ``(n, M)`` and their variances of each recording."""
        scales = np.broadcast_to(scales, (len(values), *self._scales.shape))
        return [self._errors(r, values, scales[:, r]) for r in range(len(self.recordings))]

    def effects(self, r: int, values: Array, scales: Array, torques: Array) -> Array:
        """Return what torques ``(m, N)``, N m or N, do to standardised errors ``(m, M)``.

        Of recording ``r`` at parameters ``(n_parameters,)`` and scales ``(5,)``, to first order.
        """
        changes, variance = self._errors(r, values[None], scales[None], torques)
        return np.asarray(changes / np.sqrt(variance))

    def _errors(
        self, r: int, values: Array, scales: Array, torques: Array | None = None
    ) -> tuple[Array, Array]:
        """Return errors of a recording, or their changes by torques, and variances."""
        recording, o, noise = self.recordings[r], self.observations[r], scales.copy()
        assert recording.law is not None
        noise[:, 2] *= math.sqrt(recording.period)  # a sample's sd to a density
        error, variance = innovations(
            self.chain,
            values,
            noise,
            recording.law,
            recording.period,
            recording.segments,
            recording.position,
            ~recording.excluded,
            pushes=torques,
            resolution=o.position_step,
            stride=self.stride,
            inputs=o.inputs,
            time=recording.time,
            step=self._steps[r],
        )
        return error[:, self.used[r]], variance[:, self.used[r]]

    def log_density(self, values: Array, scales: Array) -> Array:
        """Log-likelihood ``(n,)``; ``-inf`` where a motion is impossible."""
        total = sum(terms.sum(axis=1) for terms in self.pointwise(values, scales))
        return np.where(np.isnan(total), -np.inf, total)

    def pointwise(self, values: Array, scales: Array) -> list[Array]:
        """Log densities ``(n, M)`` a recording, of readings given the earlier ones."""
        return [-0.5 * (e**2 / s + np.log(s) + _LOG_2PI) for e, s in self.errors(values, scales)]

    def predict(self, values: Array) -> list[Array]:
        """Predict readings ``(n, M)`` from the earlier ones, rad or m."""
        errors = self.errors(values, self._scales)
        return [o.measured - e for o, (e, _) in zip(self.outputs, errors, strict=True)]

    def standardised(self, values: Array, scales: Array) -> list[Array]:
        """Return standardised errors and half log variances, ``(n, 2 M)`` a recording.

        With their derivatives ``J``, ``J'J`` is the Fisher information, that of the noise scales
        ``(R, 5)`` or ``(n, R, 5)``, too.
        """
        return [
            np.concatenate([e / np.sqrt(s), 0.5 * np.log(s)], axis=1)
            for e, s in self.errors(values, scales)
        ]

    @property
    def sizes(self) -> Array:
        """Numbers of outputs ``(R,)`` of the recordings."""
        return np.array([o.measured.size for o in self.outputs])

    def noise_sd(self, scales: Array) -> list[Array]:
        """Return sds ``(M,)`` of prediction errors a recording, at scales ``(R, 5)``."""
        return [np.sqrt(s[0]) for _, s in self.errors(self._values[None], scales)]

    def draw_disturbance(
        self, values: Array, scales: Array, count: int, period: float, rng: np.random.Generator
    ) -> tuple[Array, Array, Array]:
        """Draw a random torque ``(count,)``, and errors of readings and of their instants, s.

        At parameters ``(n_parameters,)`` and scales ``(5,)``, for samples a ``period`` apart.
        """
        slow, constant, white, encoder, instants = scales
        first, *steps = rng.standard_normal(count)
        keeps = math.exp(-period / constant)
        drawn = slow * np.r_[first, math.sqrt(1.0 - keeps**2) * np.array(steps)]
        # of white torque, passed in a line, two thirds of the variance stay
        jumps = math.sqrt(1.5) * white * rng.standard_normal(count)
        factor, _ = self.chain.drive_gains(values[None])
        torque = factor * (lfilter([1.0], [1.0, -keeps], drawn) + jumps)
        return torque, *(sd * rng.standard_normal(count) for sd in (encoder, instants))

    def draw_noise(self, scales: Array, rng: np.random.Generator) -> list[Array]:
        """Draw prediction errors ``(n, M)`` a recording, of the sds at the mean scales."""
        sds = self.noise_sd(scales.mean(axis=0))
        return [sd * rng.standard_normal((len(scales), sd.size)) for sd in sds]


def _step(chain: Joint, recording: Measurement, o: Signals, point: Array) -> float:
    """Choose the longest integration step for the closed loop's fastest motion at a point."""
    law = recording.law
    assert law is not None
    still, accelerations = np.zeros(2), np.array([0.0, 1.0])
    torques = inverse_torque(
        chain, point, still, still, accelerations, inputs=o.inputs, time=o.stamps[:2]
    )
    weights, columns, _ = chain.load_columns(point[None], o.inputs, o.stamps)
    inertia = abs(float(torques[1] - torques[0])) + float(np.min(weights[0] @ columns[:, 0]))
    inertia = max(inertia, 1e-300)
    _, kd = chain.drive_gains(point[None])
    scale = float(np.abs(law.scale).max())
    stiff, damped = scale * law.kp / inertia, (scale * law.kd + kd[0] + law.back_emf) / inertia
    return float(min(_LONGEST, _STEP / max(math.sqrt(stiff) + damped, 1e-9)))


def _used(recording: Measurement, stride: int) -> Flags:
    """Flag the readings ``(N,)`` that are compared."""
    used = np.zeros(recording.time.size, dtype=np.bool_)
    for a, b in recording.segments:
        used[a + stride : b : stride] = True
    return used & ~recording.excluded


def _segment_of(recording: Measurement) -> Index:
    lengths = np.diff(np.array(recording.segments), axis=1)[:, 0]
    return np.repeat(np.arange(lengths.size), lengths)
