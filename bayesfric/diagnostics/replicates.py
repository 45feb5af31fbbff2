"""Replicates: the recording once more, with its encoder, rate and filters, of a known joint.

Replicates are what a recording looks like where the model is right: by them estimates are tried, and
what a check finds in a recording is held against what it finds in them. A replicate moves as the
recording says that the joint did, a spline through its filtered positions; the torque is the one
that the inverse model asks for along it, exactly. So it has the recording's reversals and rests,
and needs neither a simulation nor what would hold one to the recorded motion.

It must differ from the recording as another one would. Its encoder has the same steps elsewhere,
and its samples come at other instants between them: were all rounded alike, their error would be
the same in each.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import make_interp_spline

from bayesfric.base.errors import BadInput
from bayesfric.estimates.fine_motion import fine_motion
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.acting import arriving
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.filters import later
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.observation import Observation, observe
from bayesfric.recordings.processing import Processing
from bayesfric.recordings.resolution import Resolution, finest_step
from bayesfric.recordings.timing import timed

# Degree of the spline: its second derivative is then as exact as the filters'.
_DEGREE = 5


class ReplicateError(Exception):
    """A joint that hardly moves."""


def replicates(
    chain: Joint,
    values: Array,
    recording: Measurement,
    observation: Observation,
    processing: Processing,
    seeds: Sequence[np.random.SeedSequence],
) -> Iterator[Observation | None]:
    """Repeat a recording at parameter vectors ``(n, n_parameters)``, and look at each alike."""
    alike = settled_as(processing, observation)
    for one, seed in zip(values, seeds, strict=True):
        rng = np.random.default_rng(seed)
        motion = played(chain, one, recording, observation, rng.uniform(-0.5, 0.5))
        seen = _seen(recording, observation, motion, rng)
        if seen is not None and seen.feedback is not None:
            seen = _aimed(seen, motion, float(chain.delays(one[None])[0]))
        yield None if seen is None else _observed(chain, one, seen, observation, alike)


def excerpt(
    chain: Joint,
    values: Array,
    recording: Measurement,
    observation: Observation,
    processing: Processing,
    most: int,
) -> tuple[Measurement, Observation]:
    """Cut a recording to ``most`` samples, prepared as the whole was; the same if it has fewer.

    ``values`` ``(n_parameters,)`` are those that its motion is refined with.
    """
    short = recording.excerpt(most)
    if short is recording:
        return recording, observation
    alike = settled_as(processing, observation)
    seen = _observed(chain, values, short, observation, alike)
    if seen is None:
        raise ReplicateError("an excerpt hardly moves")
    return short, seen


def settled_as(processing: Processing, observation: Observation) -> Processing:
    """Write down the filters of a recording, so that its replicates are treated alike.

    Low-pass, decimation, dead zone and trim become those that were used, whoever chose them.
    """
    told = observation.settings
    numbers = {key: told[key] for key in ("lowpass", "decimate", "dead_zone", "trim")}
    return processing.model_copy(update=numbers)


def played(
    chain: Joint, values: Array, recording: Measurement, observation: Observation, phase: float
) -> tuple[Array, Array, Array]:
    """Give a recorded motion ``phase`` samples late, and what a joint needs for it.

    Shapes: ``chain, values`` (n_parameters,), returns (N,).
    """
    o, period = observation, recording.period
    q, qd, qdd = np.empty((3, recording.time.size))
    for a, b in recording.segments:
        place = np.arange(b - a, dtype=np.float64)
        spline = make_interp_spline(place, o.q[a:b], min(_DEGREE, b - a - 1))
        for k, out in enumerate((q, qd, qdd)):
            out[a:b] = spline(place - phase, nu=k) / period**k
    now = np.where([name == chain.delay_name for name in chain.names], 0.0, values)
    # what a joint feels besides is sampled when its motion is
    torque = inverse_torque(chain, now, q, qd, qdd, inputs=o.inputs, time=o.stamps)
    if chain.delay and not chain.by_target:
        late = float(chain.delays(values[None])[0])
        for a, b in recording.segments:
            torque[a:b] = later(torque[a:b], -late / period)
    return q, qd, torque


def _seen(
    recording: Measurement,
    observation: Observation,
    motion: tuple[Array, Array, Array],
    rng: np.random.Generator,
) -> Measurement | None:
    """Read a motion with the recording's sensors, without noise of the torque's."""
    q, qd, torque = motion
    if not np.isfinite(torque).all():
        return None
    noise = float(observation.settings["noise_seen"])
    moved = recording.velocity is None
    position = _sensed(recording.position, q, noise if moved else 0.0, rng)
    velocity = None if recording.velocity is None else _sensed(recording.velocity, qd, noise, rng)
    # no maker has filtered what the joint needs
    return replace(
        recording,
        position=position,
        velocity=velocity,
        torque=torque,
        held=None,
        torque_lag=None,
        velocity_lag=None,
    )


def _aimed(seen: Measurement, motion: tuple[Array, Array, Array], late: float) -> Measurement:
    """Give the target, ``late`` s early, with which a drive gives the torque of a motion."""
    (q, qd, torque), law = motion, seen.law
    assert law is not None
    feedback = law.kp * q + law.kd * qd
    given = torque if seen.back_emf is None else torque + seen.back_emf
    error = np.divide(given, law.scale, out=np.zeros_like(given), where=law.scale != 0.0)
    command = arriving(error + feedback, seen.segments, -late / seen.period, held=False)
    return replace(seen, feedback=feedback, law=replace(law, command=command, held=False))


def _observed(
    chain: Joint,
    values: Array,
    seen: Measurement,
    observation: Observation,
    processing: Processing,
) -> Observation | None:
    """Filter what was read, and refine its motion, as the recording's was.

    ``None`` where the filters leave nothing, as of a joint that hardly moves.
    """
    told, looked = observation.settings, None
    if told["motion"] != "refined":  # what the position resolves is not asked then
        looked = Resolution(float(told["band"]), "asked", float(told["noise_seen"]), math.inf)
    try:
        found = observe(seen, processing, looked)
        late = told.get("delay")
        found = found if late is None else timed(found, seen, float(late))
    except BadInput:  # with these parameters the joint hardly moves
        return None
    return found if looked else fine_motion(chain, values, seen, found)


def _sensed(recorded: Array, true: Array, noise: float, rng: np.random.Generator) -> Array:
    """Read a signal as the recorded one was: in its steps, with what noise it has besides.

    The steps lie anywhere.
    """
    step = finest_step(recorded)
    besides = math.sqrt(max(noise**2 - step**2 / 12.0, 0.0))
    noisy = true + besides * rng.standard_normal(true.size)
    if not step:
        return noisy
    grid = recorded[0] + step * rng.uniform()
    return np.asarray(grid + step * np.round((noisy - grid) / step))
