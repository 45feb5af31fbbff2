"""Simulated replicates of a recording with known parameters (a parametric bootstrap).

A replicate follows the recorded motion, a spline through its filtered positions, so it has the
recording's reversals and standstills; its torque is exactly that of the inverse model. No forward
simulation is needed. Encoder steps and sampling instants are shifted at random: otherwise all
replicates would have the same quantisation error.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

from bayesfric.base.errors import BadInput
from bayesfric.estimates.processing import fine_motion
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.filters import Resolution, delayed_command, finest_step, later
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.signals import Signals, observe, timed
from bayesfric.recordings.source import Processing


class ReplicateError(Exception):
    """Raised when the motion is too small to simulate replicates."""


def replicates(
    chain: Joint,
    values: Array,
    recording: Measurement,
    observation: Signals,
    processing: Processing,
    seeds: Sequence[np.random.SeedSequence],
) -> Iterator[Signals | None]:
    """Simulate a recording at parameters ``(n, n_parameters)``, preprocessed as the original."""
    fixed = fixed_processing(processing, observation)
    for vector, seed in zip(values, seeds, strict=True):
        rng = np.random.default_rng(seed)
        motion = replicate_motion(chain, vector, recording, observation, rng.uniform(-0.5, 0.5))
        measured = _measure(recording, observation, motion, rng)
        if measured is not None and measured.feedback is not None:
            measured = _with_target(measured, motion, float(chain.delays(vector[None])[0]))
        yield None if measured is None else _preprocess(chain, vector, measured, observation, fixed)


def subsample(
    chain: Joint,
    values: Array,
    recording: Measurement,
    observation: Signals,
    processing: Processing,
    max_count: int,
) -> tuple[Measurement, Signals]:
    """Limit a recording to ``max_count`` samples, preprocessed as before.

    The motion is refined with parameters ``values`` ``(n_parameters,)``.
    """
    short = recording.excerpt(max_count)
    if short is recording:
        return recording, observation
    fixed = fixed_processing(processing, observation)
    subsampled = _preprocess(chain, values, short, observation, fixed)
    if subsampled is None:
        raise ReplicateError("the subsample hardly moves")
    return short, subsampled


def fixed_processing(processing: Processing, observation: Signals) -> Processing:
    """Fix low-pass, decimation, dead zone and trim to what was used for a recording."""
    settings = observation.settings
    numbers = {key: settings[key] for key in ("lowpass", "decimate", "dead_zone", "trim")}
    return processing.model_copy(update=numbers)


def replicate_motion(
    chain: Joint, values: Array, recording: Measurement, observation: Signals, phase: float
) -> tuple[Array, Array, Array]:
    """Return position, speed and torque ``(N,)`` of the recorded motion ``phase`` samples late."""
    o, period = observation, recording.period
    q, qd, qdd = np.stack([o.q, o.qd, o.qdd])
    for a, b in () if recording.steady else recording.segments:
        place = np.arange(b - a, dtype=np.float64)
        # of degree five its second derivative is as exact as the filters'
        spline = make_interp_spline(place, o.q[a:b], min(5, b - a - 1))
        for k, out in enumerate((q, qd, qdd)):
            out[a:b] = spline(place - phase, nu=k) / period**k
    parameters = np.where([name == chain.delay_name for name in chain.names], 0.0, values)
    # other inputs of the joint are sampled at the same instants
    torque = inverse_torque(chain, parameters, q, qd, qdd, inputs=o.inputs, time=o.stamps)
    if chain.delay and not chain.by_target:
        late = float(chain.delays(values[None])[0])
        for a, b in recording.segments:
            torque[a:b] = later(torque[a:b], -late / period)
    return q, qd, torque


def _measure(
    recording: Measurement,
    observation: Signals,
    motion: tuple[Array, Array, Array],
    rng: np.random.Generator,
) -> Measurement | None:
    """Measure a motion with the recording's sensors; the torque has no noise."""
    q, qd, torque = motion
    if not np.isfinite(torque).all():
        return None
    noise = float(observation.settings["noise_seen"])
    noisy_position = recording.velocity is None
    position = _quantise(recording.position, q, noise if noisy_position else 0.0, rng)
    velocity = recording.velocity
    if velocity is not None:  # the speeds of steady points have no noise
        velocity = qd if recording.steady else _quantise(velocity, qd, noise, rng)
    # the replicate's torque passes no filter of the drive
    raw: dict[str, Any] = {"held": False, "torque_lag": None, "velocity_lag": None}
    return replace(recording, position=position, velocity=velocity, torque=torque, **raw)


def _with_target(
    measured: Measurement, motion: tuple[Array, Array, Array], late: float
) -> Measurement:
    """Add the drive's target, ``late`` s early, that produces the torque of a motion."""
    (q, qd, torque), law = motion, measured.law
    assert law is not None
    feedback = law.kp * q + law.kd * qd
    torque_command = torque if measured.back_emf is None else torque + measured.back_emf
    error = np.zeros_like(torque)
    np.divide(torque_command, law.scale, out=error, where=law.scale != 0.0)
    late_samples = late / measured.period
    command = delayed_command(error + feedback, measured.segments, -late_samples, held=False)
    return replace(measured, feedback=feedback, law=replace(law, command=command, held=False))


def _preprocess(
    chain: Joint,
    values: Array,
    measured: Measurement,
    observation: Signals,
    processing: Processing,
) -> Signals | None:
    """Filter and refine as the recording was; ``None`` if the filters leave no output."""
    settings, resolution = observation.settings, None
    if settings["motion"] != "refined":  # then the band is not searched
        band, noise = float(settings["band"]), float(settings["noise_seen"])
        resolution = Resolution(band, "asked", noise, math.inf)
    try:
        preprocessed = observe(measured, processing, resolution)
        late = settings.get("delay")
        preprocessed = preprocessed if late is None else timed(preprocessed, measured, float(late))
    except BadInput:  # with these parameters the joint hardly moves
        return None
    return preprocessed if resolution else fine_motion(chain, values, measured, preprocessed)


def _quantise(recorded: Array, true: Array, noise: float, rng: np.random.Generator) -> Array:
    """Quantise a signal in the recorded one's steps at a random offset, with its other noise."""
    step = finest_step(recorded)
    remaining = math.sqrt(max(noise**2 - step**2 / 12.0, 0.0))
    noisy = true + remaining * rng.standard_normal(true.size)
    if not step:
        return noisy
    grid = recorded[0] + step * rng.uniform()
    return np.asarray(grid + step * np.round((noisy - grid) / step))
