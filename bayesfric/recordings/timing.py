"""The delay between torque and position: a recording whose position comes late, put right.

A recorded position that is late by ``d`` belongs to the torque of ``d`` before. Near a time
``d0`` the measured torque of then is, to first order, ``y(t - d0) - (d - d0) y'(t - d0)``: what
is compared with the model is ``y(t - d0) + d0 y'(t - d0)``, and the model has ``d y'(t - d0)``
on top. So the delay is one more coefficient that the torque is linear in, and what this leaves
out is of second order in ``d - d0``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.recordings.arrays import Array, Segments
from bayesfric.recordings.filters import derivative, later, lowpass
from bayesfric.recordings.inputs import Signal
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.observation import Observation, as_position

# Delays in s, either way, between which a torque is about linear in them.
FAR_DELAYS = (0.03, 0.045, 0.07, 0.1, 0.15, 0.2)


def timed(o: Observation, recording: Measurement, delay: float) -> Observation:
    """Take the torque of ``delay`` seconds earlier for a position that comes late.

    Raises
    ------
    BadInput
        If ends that are not compared with the model are shorter than that.
    """
    longest = longest_delay(o, recording.period)
    if abs(delay) > longest:
        raise BadInput(
            f"recording '{recording.name}', delay",
            f"the position would come {delay:.3g} s after the torque, which is more than the "
            f"{longest:.3g} s that are trimmed off the ends",
            "correct the time stamps, or raise trim",
        )
    made = retimed(o, recording.segments, recording.period, delay, recording.back_emf)
    told = f"delay: torque of {delay:.3g} s before the position, and what it changes by"
    settings = {**o.settings, "delay": delay}
    return replace(made, steps=(*o.steps, told), settings=settings)


def longest_delay(o: Observation, period: float) -> float:
    """Longest delay, s, that the trimmed ends of a recording leave room for."""
    return float(o.settings.get("trim_samples", 0)) * period


def filtered_rate(o: Observation) -> Array:
    """Rate ``(M,)`` of the torque of a recording that was :func:`retimed`, N m/s or N/s."""
    assert o.inputs.torque_rate is not None
    return o.filter.apply(o.inputs.torque_rate.values)


def retimed(
    o: Observation, segments: Segments, period: float, delay: float, back_emf: Array | None = None
) -> Observation:
    """See :func:`timed`; nothing is checked or told.

    ``back_emf`` ``(N,)`` is what the speed has taken off the torque where this was computed from a
    voltage: it comes with the position, not late against it.
    """
    taken = np.zeros_like(o.torque) if back_emf is None else back_emf
    given = o.torque + taken
    cutoff, order = float(o.settings.get("lowpass", 0.0)), int(o.settings.get("order", 1))
    # only noise is above the low-pass that the position has passed
    smooth = lowpass(given, segments, 1.0 / period, cutoff, order)
    before, slope = np.empty_like(given), np.empty_like(given)
    for a, b in segments:
        before[a:b] = later(given[a:b], delay / period)
        slope[a:b] = later(smooth[a:b], delay / period)
    rate = derivative(slope, segments, period, int(o.settings.get("reach", 1)))
    compared = before - taken + delay * rate
    return replace(
        o,
        compared=compared,
        measured=o.filter.apply(as_position(compared, segments, period, o.settings)),
        inputs=replace(o.inputs, torque_rate=Signal(o.stamps, rate)),
    )
