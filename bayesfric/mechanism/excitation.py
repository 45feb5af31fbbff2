"""Which torque signals move a simulated joint, and what its electronics make of them.

Every signal is a function of an array of times and returns an array, so signals add with ``+``.
Square waves, as of the paper's 1 Hz tests, let the load drive the motor; sines alone hardly do,
and leave ``alpha_2`` unseen.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from bayesfric.recordings.arrays import Array


def square(time: ArrayLike, amplitude: float, frequency: float) -> Array:
    """Torque ``amplitude`` (N m or N) for half a period of ``frequency`` (Hz), then its negative.

    Times and torques are ``(N,)``. A switch that falls on a sample, up to rounding, has happened at
    that sample.
    """
    halves = np.floor(2.0 * frequency * np.asarray(time, dtype=np.float64) + 1e-9)
    return np.where(halves % 2 == 0, amplitude, -amplitude).astype(np.float64)


def sine(time: ArrayLike, amplitude: float, frequency: float, phase: float = 0.0) -> Array:
    """Sine of ``amplitude`` (N m or N) and ``frequency`` (Hz), with ``phase`` (rad) at time zero.

    Times and torques are ``(N,)``.
    """
    turns = frequency * np.asarray(time, dtype=np.float64)
    return np.asarray(amplitude * np.sin(2.0 * np.pi * turns + phase), dtype=np.float64)


def multisine(
    time: ArrayLike,
    amplitude: ArrayLike,
    frequencies: ArrayLike,
    *,
    seed: int | None = None,
) -> Array:
    """Sum of sines.

    Schroeder, IEEE Transactions on Information Theory 16, 1970.
    """
    hertz = np.atleast_1d(np.asarray(frequencies, dtype=np.float64))
    each = np.broadcast_to(np.asarray(amplitude, dtype=np.float64), hertz.shape)
    if seed is None:
        order = np.arange(hertz.size)
        phases = -np.pi * order * (order + 1) / hertz.size
    else:
        phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, hertz.size)
    total = np.zeros(np.shape(time))
    for a, f, phase in zip(each, hertz, phases, strict=True):
        total += sine(time, float(a), float(f), float(phase))
    return total


def chirp(time: ArrayLike, amplitude: float, first: float, last: float) -> Array:
    """Sine whose frequency rises evenly from ``first`` to ``last`` (Hz) over the ``(N,)`` times.

    Its phase is zero at the first time; ``amplitude`` in N m or N.
    """
    t = np.asarray(time, dtype=np.float64)
    since = t - t[0]
    turns = first * since + 0.5 * (last - first) * since**2 / (since[-1] or 1.0)
    return np.asarray(amplitude * np.sin(2.0 * np.pi * turns), dtype=np.float64)


def current_loop(torque: ArrayLike, period: float, lag: float) -> Array:
    """Torque behind a current loop, a first-order lag from zero on, at the command's samples.

    The lag matters for identification: where the torque is piecewise constant, the equation of
    motion itself makes the regressors linearly dependent.
    """
    command = np.asarray(torque, dtype=np.float64)
    if not (lag >= 0.0 and period > 0.0):
        raise ValueError("lag must not be negative and period must be positive")
    if lag == 0.0:
        return command.copy()
    decay = np.exp(-period / lag)
    actual = lfilter([0.0, -np.expm1(-period / lag)], [1.0, -decay], command)
    return np.asarray(actual, dtype=np.float64)
