"""The motion of a model's regressors, refined above the encoder's bandwidth by the torque.

Regressors are computed from the motion and pass the same filter as the measured torque. Those
nonlinear in the motion (direction, absolute value, direction of power) need a motion that is not
low-passed: at a reversal friction makes the acceleration jump, and a low-passed speed crosses zero
at another time.

Below the position's low-pass ``L`` the motion is the encoder's, above it the one with which the
model takes the measured torque. With ``a'`` the acceleration that solves
``torque(q, v, a') = measured`` at every sample,

    a = L a_encoder + (1 - L) a'
    v = H v_encoder + (1 - H) (integral of a'),   q likewise,

complementary filters. ``H`` is where the encoder's noise outgrows that of the torque, both as
speeds; torque that a wrong model leaves unexplained raises it. The acceleration changes over at
``L``, well above the band that is compared, for the torque's noise must not be in both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.estimates.input_error import input_error
from bayesfric.estimates.knowledge import Estimation, Knowledge
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.checks import resting
from bayesfric.recordings.filters import lowpass
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.observation import Observation, refinable, with_motion

# An estimate from the encoder's motion may be off by an sd, one from the refined motion is not.
_PASSES = 2
# Each round takes the direction of motion of the last; further ones change nothing.
_ROUNDS = 4


def with_fine_motion(
    chain: Joint,
    recordings: Sequence[Measurement],
    observations: Sequence[Observation],
    knowledge: Knowledge,
    options: Estimation,
) -> tuple[Array | None, list[Observation]]:
    """Refine the motion of recordings by a first input-error estimate, in two passes.

    Gives the estimate ``(n_parameters,)`` too: ``None``, with the recordings as they were, where
    none can be made, or no filter separates the compared band.
    """
    refined, point = list(observations), None
    if not any(map(refinable, refined)):
        return None, refined
    try:
        for _ in range(_PASSES):
            excerpts = [o.excerpt() for o in refined]
            point = dict(input_error(chain, excerpts, knowledge, options, point).point)
            values = chain.vector(point)
            pairs = zip(recordings, observations, strict=True)
            refined = [fine_motion(chain, values, r, o) for r, o in pairs]
    except BadInput:
        return None, list(observations)
    return values, refined


def fine_motion(
    chain: Joint, values: Array, recording: Measurement, observation: Observation
) -> Observation:
    """Refine the motion of one recording by parameters ``(n_parameters,)`` of its joint.

    At standstill and in excluded spans the encoder's acceleration stays. The recording is unchanged
    where the model has no unique acceleration, or the result is too far from what was recorded.
    """
    if not refinable(observation):
        return observation
    o, settings, segments = observation, observation.settings, recording.segments
    still = resting(o.qd, segments, float(settings["dead_zone"]), int(settings["guard"]))
    unknown = still | recording.excluded

    def above(x: Array, cutoff: float) -> Array:
        return x - lowpass(x, segments, 1.0 / recording.period, cutoff, int(settings["order"]))

    end = float(settings["lowpass"])
    speed, position = above(o.qd, end), above(o.q, end)
    step = float(np.std(o.qdd)) or 1.0
    inputs = with_motion(o, recording, o.q, o.qd, o.qdd).inputs
    q, qd, qdd, handover = o.q, o.qd, o.qdd, 0.0
    for _ in range(_ROUNDS):
        low, torque, high = (
            inverse_torque(chain, values, q, qd, qdd + d, inputs=inputs, time=o.stamps)
            for d in (-step, 0.0, step)
        )
        inertia, residual = (high - low) / (2.0 * step), o.compared - torque
        if not (inertia > 0.0).all():
            return observation
        if not handover:
            handover = min(_handover(o, recording, residual, float(np.median(inertia))), end)
        acceleration = np.where(unknown, o.qdd, qdd + residual / inertia)
        dqd = above(_integral(acceleration - o.qdd, qd, recording), handover)
        dq = above(_integral(speed + dqd, None, recording), handover)
        q, qd = o.q + position + dq, o.qd + speed + dqd
        qdd = o.qdd + above(acceleration, end)
    refined = with_motion(o, recording, q, qd, qdd)
    return refined if _near(o, refined, recording) else observation


def _near(o: Observation, refined: Observation, recording: Measurement) -> bool:
    """Whether a refined motion is as close to the recorded one as noise explains."""
    if recording.velocity is None:
        recorded, before, after = recording.position, o.q, refined.q
    else:
        recorded, before, after = recording.velocity, o.qd, refined.qd
    noise = float(o.settings["noise_seen"]) ** 2
    return bool(np.mean((recorded - after) ** 2) <= np.mean((recorded - before) ** 2) + noise)


def _handover(o: Observation, recording: Measurement, residual: Array, inertia: float) -> float:
    """Frequency in Hz above which the torque determines a speed better than the encoder does.

    Of the residual torque ``(N,)``, ``S_t`` a hertz behind the parallel filter, the speed has noise
    ``S_t/(J w)²``; of the encoder ``w² S_q``, or ``S_v`` where the speed was measured.
    """
    torque = float(np.mean(o.filter.apply(residual) ** 2)) / float(o.settings["band"])
    noise = 2.0 * recording.period * float(o.settings["noise_seen"]) ** 2
    if not noise > 0.0:
        return math.inf
    power = 4 if recording.velocity is None else 2
    return float((torque / (inertia**2 * noise)) ** (1.0 / power)) / (2.0 * math.pi)


def _integral(x: Array, speed: Array | None, recording: Measurement) -> Array:
    """Integrate a signal ``(N,)`` in every segment; it jumps where the ``speed`` crosses zero."""
    share = np.full(x.size - 1, 0.5)
    if speed is not None:
        before, after = speed[:-1], speed[1:]
        turns = before * after < 0.0
        share[turns] = before[turns] / (before[turns] - after[turns])
    steps = recording.period * (share * x[:-1] + (1.0 - share) * x[1:])
    out = np.zeros_like(x)
    for a, b in recording.segments:
        out[a + 1 : b] = np.cumsum(steps[a : b - 1])
    return out
