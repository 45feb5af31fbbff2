"""What estimates tell about the processing of recordings: their band, delay and fine motion.

**Band.** Errors in a regressor lower its coefficient (attenuation) and leave torque unexplained.
Noise of the acceleration at standstill is not all of it: wrong time stamps make noise that grows
with speed and frequency. So recordings are fitted in narrower bands: where the inertia grows and
less torque is unexplained per hertz, the wider band is wrong.

**Delay.** The torque is linear in a small delay (:mod:`bayesfric.recordings.signals`), so the
delay of the position is one more coefficient; recordings are shifted by it until it settles.

**Fine motion.** Regressors pass the same filter as the measured torque. Those nonlinear in the
motion (direction, absolute value, direction of power) need a motion that is not low-passed: at a
reversal friction makes the acceleration jump, and a low-passed speed crosses zero at another time.
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
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import stats

from bayesfric.base.errors import BadInput
from bayesfric.estimates.input_error import input_error
from bayesfric.estimates.least_squares import TotalsProjection, least_squares, totals_regressors
from bayesfric.estimates.point_estimate import Estimate, Estimation, Knowledge
from bayesfric.estimates.torque import minimum_norm
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.kernels import inverse_many
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.checks import resting
from bayesfric.recordings.filters import lowpass, lowpass_above
from bayesfric.recordings.measurement import Measurement, integral
from bayesfric.recordings.signals import (
    FAR_DELAYS,
    Signals,
    filtered_rate,
    longest_delay,
    observe,
    refinable,
    retimed,
    with_motion,
)
from bayesfric.recordings.source import Processing

# Least relative growth of the inertia that counts: load-dependent friction, which totals leave out,
# makes as much.
_LEAST_GROWTH = 0.01


class BandFit(NamedTuple):
    """Least squares of the totals in one band."""

    band: float  # its upper end, Hz
    inertia: float  # total inertia seen by the motor and its standard deviation
    sd: float
    unexplained: float  # variance of the torque per hertz of the band
    freedom: int


def attenuations(
    joint: Joint,
    recordings: Sequence[Measurement],
    observations: Sequence[Signals],
    processing: Processing,
    *,
    misses: int = 2,
) -> dict[str, tuple[BandFit, BandFit]]:
    """List the recordings whose band is contradicted by a narrower one, by name, with both.

    Bands narrow by a factor of 1.4, low-pass and decimation going with them, until two in a row
    contradict the best so far no more.
    """
    attenuated = {}
    for recording, observation in zip(recordings, observations, strict=True):
        first = _fit_band(joint, recording, observation)
        # noise that takes a share of the inertia leaves at least that share of its torque
        if first is None or first.freedom * first.sd**2 < _LEAST_GROWTH * first.inertia**2:
            continue
        fs, share, factor = 1.0 / recording.period, 1.0, int(observation.settings["decimate"])
        best, missed = first, 0
        while missed < misses:
            share *= 1.4
            decimation = round(share * factor)
            if decimation <= factor:
                continue
            cutoff = lowpass_above(fs / (2 * decimation), fs)
            settings = {"decimate": decimation, "lowpass": cutoff, "band": None}
            try:
                filtered = observe(recording, processing.model_copy(update=settings))
            except BadInput:  # it leaves no output
                break
            if (fit := _fit_band(joint, recording, filtered)) is None:
                break
            best, missed = (fit, 0) if _contradicts(fit, best) else (best, missed + 1)
        if best is not first:
            attenuated[recording.name] = first, best
    return attenuated


def _fit_band(
    joint: Joint, recording: Measurement, o: Signals, *, least_freedom: int = 20
) -> BandFit | None:
    """Fit the totals in a band; ``None`` where the inertia is not identified.

    The torque's rate is one more regressor: a delay leaves torque as well, and is another matter.
    """
    names, totals = totals_regressors(replace(joint, delay=False), [o])
    freedom = o.measured.size - len(names) - 1
    if "inertia" not in names or freedom < least_freedom:
        return None
    undelayed = retimed(o, recording.segments, recording.period, 0.0, recording)
    regressors = np.column_stack([totals, filtered_rate(undelayed)])
    _, shared, solution, _ = minimum_norm(regressors)
    i = names.index("inertia")
    if shared[i]:
        return None
    values = solution @ o.measured
    residual = o.measured - regressors @ values
    variance, band = float(residual @ residual) / freedom, 0.5 / o.period
    sd = float(np.sqrt(variance * (solution[i] @ solution[i])))
    return BandFit(band, float(values[i]), sd, variance / band, freedom)


def _contradicts(narrow: BandFit, wide: BandFit) -> bool:
    """Whether a narrower band contradicts a wider one, as noise of the acceleration makes it.

    An inertia of more than 4 sds grows by more than 1 %, less variance is left per hertz, and the
    growth exceeds 1.7 sds of both or the variances differ twofold and by more than an F test at one
    in a thousand allows. Bands share outputs, so chance alone hardly ever reaches that; errors of
    the model leave less per hertz in wider bands.
    """
    growth = narrow.inertia - wide.inertia
    if not (
        narrow.inertia > 4.0 * narrow.sd
        and growth > _LEAST_GROWTH * abs(narrow.inertia)
        and wide.unexplained > narrow.unexplained
    ):
        return False
    if growth > 1.7 * np.hypot(narrow.sd, wide.sd):
        return True
    ratio = wide.unexplained / narrow.unexplained if narrow.unexplained > 0.0 else np.inf
    return bool(ratio > max(2.0, stats.f.isf(1e-3, wide.freedom, narrow.freedom)))


def estimate_delay(
    joint: Joint,
    recordings: Sequence[Measurement],
    observations: Sequence[Signals],
    knowledge: Knowledge,
    options: Estimation,
) -> float:
    """Estimate ``drive.delay``, s: by least squares of a linear torque, else input error."""
    pairs = list(zip(recordings, observations, strict=True))
    if any(p.row.bends for p in joint.parameters):
        point: dict[str, float] | None = None

        def estimate(observations: Sequence[Signals]) -> Estimate:
            nonlocal point  # the next round starts where this one ends
            fitted = input_error(joint, observations, knowledge, options, point)
            point = dict(fitted.point)
            return fitted

        return settled_delay(pairs, estimate, joint)
    return settled_delay(pairs, lambda observations: least_squares(joint, observations), joint)


def settled_delay(
    pairs: Sequence[tuple[Measurement, Signals]],
    estimate: Callable[[Sequence[Signals]], Estimate],
    joint: Joint,
) -> float:
    """Repeat an estimate, recordings shifted by its delay, until it settles; 0 if undetermined."""
    delay = _first(TotalsProjection(replace(joint, delay=False), [o for _, o in pairs]), pairs)
    for _ in range(10):  # each linear about the delay of the last
        fitted = estimate([retimed(o, r.segments, r.period, delay, r) for r, o in pairs])
        value, previous = fitted[joint.delay_name], delay
        if fitted.method == "least-squares" and not value.determined:
            return 0.0
        delay = _within(value.value, pairs)
        # a delay without an sd, or at the end of the range, moves no more
        if not abs(delay - previous) > 0.02 * value.larger_sd:
            break
    return delay


def _within(
    delay: float, pairs: Sequence[tuple[Measurement, Signals]], *, longest: float = 0.25
) -> float:
    """Limit a delay, s, to the ``longest`` to look for, at most a tenth of the recording."""
    trimmed = min(longest_delay(o, r.period) for r, o in pairs)
    duration = min(float(np.ptp(o.stamps)) for _, o in pairs)
    furthest = max(trimmed, min(longest, 0.1 * duration))
    lowest = 0.0 if any(r.feedback is not None for r, _ in pairs) else -furthest
    return float(np.clip(delay, lowest, furthest))


def _first(projection: TotalsProjection, pairs: Sequence[tuple[Measurement, Signals]]) -> float:
    """Choose the first delay, by linear fits of the totals and the torque's rate.

    Zero, or a far one that leaves less than half of the squares: at one frequency a quarter of a
    period looks like a spring.
    """
    near = max(longest_delay(o, r.period) for r, o in pairs)
    far = [d for d in FAR_DELAYS if near < d == _within(d, pairs)]
    basis, _ = np.linalg.qr(projection.regressors)

    def unexplained(delay: float) -> float:
        shifted = [retimed(o, r.segments, r.period, delay, r) for r, o in pairs]
        columns = [np.concatenate([o.measured for o in shifted])]
        columns.append(np.concatenate([filtered_rate(o) for o in shifted]))
        y, rate = (x - basis @ (basis.T @ x) for x in columns)
        rest = y - rate * float(rate @ y) / max(float(rate @ rate), 1e-300)
        return float(rest @ rest)

    delays = {_within(d, pairs) for d in (0.0, *far, *(-d for d in far))}
    squares = {d: unexplained(d) for d in delays} if far else {0.0: 1.0}
    best = min(squares, key=squares.__getitem__)
    return best if squares[best] < 0.5 * squares[0.0] else 0.0


def with_fine_motion(
    joint: Joint,
    recordings: Sequence[Measurement],
    observations: Sequence[Signals],
    knowledge: Knowledge,
    options: Estimation,
) -> tuple[Array | None, list[Signals]]:
    """Refine the motion of recordings by a first input-error estimate, in two passes.

    An estimate from the encoder's motion may be off by an sd, one from the refined motion is not.
    Gives the estimate ``(n_parameters,)`` too: ``None``, with the recordings as they were, where
    none can be made, or no filter separates the compared band.
    """
    refined, point = list(observations), None
    if not any(map(refinable, refined)):
        return None, refined
    try:
        for _ in range(2):
            excerpts = [o.excerpt() for o in refined]
            point = dict(input_error(joint, excerpts, knowledge, options, point).point)
            values = joint.vector(point)
            pairs = zip(recordings, observations, strict=True)
            refined = [fine_motion(joint, values, r, o) for r, o in pairs]
    except BadInput:
        return None, list(observations)
    return values, refined


def fine_motion(
    joint: Joint, values: Array, recording: Measurement, observation: Signals
) -> Signals:
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
    tables = joint.tables(np.atleast_2d(values), inputs)
    q, qd, qdd, handover = o.q, o.qd, o.qdd, 0.0
    for _ in range(4):  # each takes the direction of motion of the last
        motion = joint.samples(q, qd, qdd, inputs, o.stamps)
        low, torque, high = (
            inverse_many(*tables, motion._replace(acceleration=qdd + d))[0]
            for d in (-step, 0.0, step)
        )
        inertia, residual = (high - low) / (2.0 * step), o.compared - torque
        del motion, low, torque, high  # each is as long as the recording
        if not (inertia > 0.0).all():
            return observation
        if not handover:
            handover = min(_handover(o, recording, residual, float(np.median(inertia))), end)
        acceleration = np.where(unknown, o.qdd, qdd + residual / inertia)
        del residual, inertia
        dqd = above(integral(acceleration - o.qdd, segments, recording.period, qd), handover)
        dq = above(integral(speed + dqd, segments, recording.period), handover)
        q, qd = o.q + position + dq, o.qd + speed + dqd
        qdd = o.qdd + above(acceleration, end)
    refined = with_motion(o, recording, q, qd, qdd)
    if recording.velocity is None:
        recorded, before, after = recording.position, o.q, refined.q
    else:
        recorded, before, after = recording.velocity, o.qd, refined.qd
    # as close to what was recorded as noise explains
    noise = float(settings["noise_seen"]) ** 2
    near = np.mean((recorded - after) ** 2) <= np.mean((recorded - before) ** 2) + noise
    return refined if near else observation


def _handover(o: Signals, recording: Measurement, residual: Array, inertia: float) -> float:
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
