"""The torque that moves a joint, and its motion, made of what was recorded."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np

from bayesfric.recordings.arrays import Array, Segments
from bayesfric.recordings.filters import averaged, derivative, later, lowpass
from bayesfric.recordings.measurement import Lag, Measurement

# Chance of one bend or more that is none, in a whole recording.
_SELDOM = 0.05


def acting(recording: Measurement, reach: int) -> Array:
    """Give the torque ``(n,)`` that moves the joint, at the samples, as far as a band shows it.

    What its maker's low-pass took is given back, by derivatives of so many neighbours.

    A command that is held until the next sample comes half a sample later, averaged over one;
    see :func:`unkinked` for one that was measured.
    """
    torque, segments = recording.torque, recording.segments
    if recording.feedback is not None:
        return commanded(recording)
    if recording.torque_lag:
        return unlagged(torque, segments, recording.period, recording.torque_lag, reach)
    if recording.held is None:
        return torque
    if not recording.held:
        return unkinked(torque, segments)
    return arriving(torque, segments, 0.0, held=True)


def arriving(command: Array, segments: Segments, samples: float, *, held: bool) -> Array:
    """Give a command ``(n,)`` some samples late, as far as a band shows it.

    One that is held until the next comes half a sample later, averaged over one.
    """
    late = command.copy()
    for a, b in segments:
        late[a:b] = later(command[a:b], samples + 0.5 * held)
    return averaged(late, segments, 1.0) if held else late


def commanded(recording: Measurement, delay: float = 0.0) -> Array:
    """Compute the torque ``(n,)`` of a drive whose target acts ``delay`` s late.

    Position and speed, and so the error and its limit, are those of now.
    """
    law, back_emf = recording.law, recording.back_emf
    assert law is not None
    torque = law.scale * np.clip(aimed(recording, delay), -law.limit, law.limit)
    return np.asarray(torque if back_emf is None else torque - back_emf)


def aimed(recording: Measurement, delay: float) -> Array:
    """Compute the command ``(n,)`` of such a drive before its limit."""
    law, samples = recording.law, delay / recording.period
    assert law is not None
    assert recording.feedback is not None
    command = arriving(law.command, recording.segments, samples, held=law.held)
    return np.asarray(command - recording.feedback)


def filtered_motion(
    recording: Measurement, cutoff: float, order: int, reach: int
) -> tuple[Array, Array]:
    """Position and speed of the joint ``(N,)``, low-passed; differentiated if not recorded."""
    segments, period, fs = recording.segments, recording.period, 1.0 / recording.period
    q = lowpass(recording.position, segments, fs, cutoff, order)
    if recording.velocity is None:
        return q, derivative(q, segments, period, reach)
    qd = lowpass(recording.velocity, segments, fs, cutoff, order)
    if recording.velocity_lag:
        qd = unlagged(qd, segments, period, recording.velocity_lag, reach)
    return q, qd


def unkinked(values: Array, segments: Segments) -> Array:
    """Make a sum over samples ``(n,)`` an integral where the slope jumps at samples.

    What steps behind a current loop bends at the sample of its command. The trapezoid rule misses
    a twelfth of what the slope jumps by there (Euler and Maclaurin), which is added. A bend is a
    second difference that noise alone, as large as most are, would show once in twenty recordings.
    """
    result = values.copy()
    for a, b in segments:
        if b - a < 5:
            continue
        bend = np.zeros(b - a)
        bend[1:-1] = np.diff(values[a:b], 2)
        # a normal's standard deviation from the median absolute value
        sd = 1.482602218505602 * np.median(np.abs(bend))
        seldom = NormalDist().inv_cdf(1.0 - 0.5 * _SELDOM / bend.size) * sd
        beside = np.maximum(np.abs(np.roll(bend, 1)), np.abs(np.roll(bend, -1)))
        kinks = (np.abs(bend) > seldom) & (np.abs(bend) >= beside) & (seldom > 0.0)
        smooth = 0.5 * (np.roll(bend, 2) + np.roll(bend, -2))
        result[a:b] += np.where(kinks, bend - smooth, 0.0) / 12.0
    return result


def unlagged(values: Array, segments: Segments, period: float, lag: Lag, reach: int) -> Array:
    """Give back to a signal ``(n,)`` what a causal low-pass took, as far as a band shows it.

    Its inverse is ``1 + s/w`` or, of a Butterworth filter of second order, ``1 + sqrt(2) s/w +
    (s/w)²``. What has passed it alike, as a sensor's noise, is as it was.
    """
    rate = derivative(values, segments, period, reach) / (2.0 * np.pi * lag.cutoff)
    if lag.order == 1:
        return values + rate
    bent = derivative(rate, segments, period, reach) / (2.0 * np.pi * lag.cutoff)
    return np.asarray(values + math.sqrt(2.0) * rate + bent)
