"""Correction of a delay between torque and position.

A position that is late by ``d`` belongs to the torque of ``d`` before, to first order near ``d0``
``y(t - d0) - (d - d0) y'(t - d0)``. So ``y(t - d0) + d0 y'(t - d0)`` is compared with a model that
has the additional term ``d y'(t - d0)``, linear in the delay, up to second order in ``d - d0``.

Of a torque from a target, the target acts late: ``y(t - d)`` is the torque with the earlier target.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.recordings.arrays import Array, Segments
from bayesfric.recordings.filters import delayed_command, derivative, lowpass
from bayesfric.recordings.measurement import Measurement, Signal
from bayesfric.recordings.observation import (
    Observation,
    as_position,
    target_torque,
    unlimited_command,
)

# Delays in s, in both directions, between which a torque is about linear.
FAR_DELAYS = (0.03, 0.045, 0.07, 0.1, 0.15, 0.2)


def timed(o: Observation, recording: Measurement, delay: float) -> Observation:
    """Use the torque of ``delay`` seconds earlier, up to the trimmed ends."""
    longest = longest_delay(o, recording.period)
    if abs(delay) > longest:
        raise BadInput(
            f"recording '{recording.name}', delay",
            f"the position would come {delay:.3g} s late, which is more than the "
            f"{longest:.3g} s that are trimmed off the ends",
            "correct the time stamps, or raise trim",
        )
    corrected = retimed(o, recording.segments, recording.period, delay, recording)
    signal = "torque" if recording.feedback is None else "target"
    step = f"delay: {signal} of {delay:.3g} s before the position, and what it changes by"
    settings = {**o.settings, "delay": delay}
    return replace(corrected, steps=(*o.steps, step), settings=settings)


def longest_delay(o: Observation, period: float) -> float:
    """Longest delay, s, that the trimmed ends of a recording allow."""
    return float(o.settings.get("trim_samples", 0)) * period


def filtered_rate(o: Observation) -> Array:
    """Rate ``(M,)`` of the torque after :func:`retimed`, N m/s or N/s."""
    assert o.inputs.torque_rate is not None
    return o.filter.apply(o.inputs.torque_rate.values)


def retimed(
    o: Observation,
    segments: Segments,
    period: float,
    delay: float,
    recording: Measurement | None = None,
) -> Observation:
    """Correct as :func:`timed`, without checks; a back-EMF is computed from the position."""
    back_emf = None if recording is None else recording.back_emf
    if recording is not None and recording.feedback is not None:
        before, rate = target_torque(recording, delay), command_rate(o, recording, delay)
    else:
        emf = np.zeros_like(o.torque) if back_emf is None else back_emf
        before = delayed_command(o.torque + emf, segments, delay / period, held=False) - emf
        rate = _rate(o, o.torque + emf, segments, period, delay)
    compared = before + delay * rate
    return replace(
        o,
        compared=compared,
        measured=o.filter.apply(as_position(compared, segments, period, o.settings)),
        inputs=replace(o.inputs, torque_rate=Signal(o.stamps, rate)),
    )


def command_rate(o: Observation, recording: Measurement, delay: float = 0.0) -> Array:
    """Rate ``(N,)`` of the torque by its late target alone, N m/s or N/s; 0 at its limit."""
    law = recording.law
    assert law is not None
    inside = np.abs(unlimited_command(recording, delay)) < law.limit
    late = delay + 0.5 * recording.period * law.held
    rate = _rate(o, law.command, recording.segments, recording.period, late)
    return np.asarray(law.scale * inside * rate)


def _rate(o: Observation, x: Array, segments: Segments, period: float, delay: float) -> Array:
    """Differentiate a delayed signal ``(N,)`` by time, low-passed as the position."""
    cutoff, order = float(o.settings.get("lowpass", 0.0)), int(o.settings.get("order", 1))
    # only noise is above the low-pass that the position has passed
    smooth = lowpass(x, segments, 1.0 / period, cutoff, order)
    late = delayed_command(smooth, segments, delay / period, held=False)
    return derivative(late, segments, period, int(o.settings.get("reach", 1)))
