"""Which motion a model's columns are made of, as fine as encoder and torque tell it.

**The rule for every column.** A column is made of the motion and passes the same parallel filter
as the measured torque, and nothing else. What is not linear in the motion (its direction, its
absolute value, the side on which power flows) is not the same of a low-passed motion as low-passed
itself: where friction turns round the acceleration jumps, and the low-passed speed crosses zero at
another time. So the motion that columns are made of must not be low-passed.

Below the position's low-pass ``L`` the encoder tells the motion. Above it there is only the
encoder's noise; there the motion is the one with which the model takes the measured torque. With
``a'`` the acceleration that solves ``torque(q, v, a') = measured`` at every sample,

    a = L a_encoder + (1 - L) a'
    v = H v_encoder + (1 - H) (integral of a'),   q likewise,

complementary filters. Speed and position are handed over at ``H``, where the encoder's noise
outgrows that of the torque, brought to the speed; a model that is wrong leaves more torque
unexplained, which raises it. The acceleration is not: the torque's noise in it would be in
what it is compared with, too. The band that is compared ends well below ``L``.
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
from bayesfric.recordings.filters import lowpass
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.moving import resting
from bayesfric.recordings.observation import Observation, refinable, with_motion

# An estimate that the encoder's motion made is off by a sd or more; one that this made is not.
_PASSES = 2
# Each round takes the direction of motion from the one before; more change nothing.
_ROUNDS = 4


def with_fine_motion(
    chain: Joint,
    recordings: Sequence[Measurement],
    observations: Sequence[Observation],
    knowledge: Knowledge,
    options: Estimation,
) -> tuple[Array | None, list[Observation]]:
    """Refine the motion of recordings by what a first estimate of the joint makes of their torque.

    Two passes: an estimate by the encoder's motion may be off by a standard deviation or more, one
    by the motion that the first pass made is not.

    Shapes: returns values (n_parameters,).
    """
    found, point = list(observations), None
    if not any(map(refinable, found)):
        return None, found
    try:
        for _ in range(_PASSES):
            some = [o.excerpt() for o in found]
            point = dict(input_error(chain, some, knowledge, options, point).point)
            values = chain.vector(point)
            pairs = zip(recordings, observations, strict=True)
            found = [fine_motion(chain, values, r, o) for r, o in pairs]
    except BadInput:
        return None, list(observations)
    return values, found


def fine_motion(
    chain: Joint, values: Array, recording: Measurement, observation: Observation
) -> Observation:
    """Refine the motion of one recording by the parameters of its joint.

    Four rounds, each with the direction of motion of the one before. At standstill and in excluded
    spans the encoder's acceleration is kept.

    Shapes: values (n_parameters,).
    """
    if not refinable(observation):
        return observation
    o, told, segments = observation, observation.settings, recording.segments
    still = resting(o.qd, segments, float(told["dead_zone"]), int(told["guard"]))
    unknown = still | recording.excluded

    def above(x: Array, cutoff: float) -> Array:
        return x - lowpass(x, segments, 1.0 / recording.period, cutoff, int(told["order"]))

    end = float(told["lowpass"])
    speed, place = above(o.qd, end), above(o.q, end)
    step = float(np.std(o.qdd)) or 1.0
    inputs = with_motion(o, recording, o.q, o.qd, o.qdd).inputs
    q, qd, qdd, handover = o.q, o.qd, o.qdd, 0.0
    for _ in range(_ROUNDS):
        low, torque, high = (
            inverse_torque(chain, values, q, qd, qdd + d, inputs=inputs, time=o.stamps)
            for d in (-step, 0.0, step)
        )
        inertia, left = (high - low) / (2.0 * step), o.compared - torque
        if not (inertia > 0.0).all():
            return observation
        handover = handover or min(_handover(o, recording, left, float(np.median(inertia))), end)
        wanted = np.where(unknown, o.qdd, qdd + left / inertia)
        more = above(_integral(wanted - o.qdd, qd, recording), handover)
        further = above(_integral(speed + more, None, recording), handover)
        q, qd, qdd = o.q + place + further, o.qd + speed + more, o.qdd + above(wanted, end)
    made = with_motion(o, recording, q, qd, qdd)
    return made if _near(o, made, recording) else observation


def _near(o: Observation, made: Observation, recording: Measurement) -> bool:
    """Whether a refined motion lies no further from the recorded one than noise puts it."""
    if recording.velocity is None:
        recorded, before, after = recording.position, o.q, made.q
    else:
        recorded, before, after = recording.velocity, o.qd, made.qd
    noise = float(o.settings["noise_seen"]) ** 2
    return bool(np.mean((recorded - after) ** 2) <= np.mean((recorded - before) ** 2) + noise)


def _handover(o: Observation, recording: Measurement, left: Array, inertia: float) -> float:
    """Frequency in Hz above which the torque determines a speed better than the encoder.

    ``left`` ``(N,)`` is the torque that is not explained; behind the parallel filter it is
    ``S_t`` a hertz. The speed's noise is ``S_t/(J w)²`` by the torque; by the encoder it is
    ``w² S_q``, or ``S_v`` where the speed was measured.
    """
    torque = float(np.mean(o.filter.apply(left) ** 2)) / float(o.settings["band"])
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
