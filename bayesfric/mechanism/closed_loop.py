"""The joint under a drive that controls its position: simulated, and predicted from the encoder.

The drive's gains are part of the equation of motion, so a Runge-Kutta step integrates the closed
loop as it does the joint alone; steps end where the target changes and where the drive reaches its
limit. The prediction is a cubature Kalman filter: points around the estimated state go through
the same integrator (Arasaratnam and Haykin, IEEE Transactions on Automatic Control 54 (2009)
1254-1269). Where all of them move on without an event the linearised equation of motion is solved
in closed form: points would say the same, at ten times the cost.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from bayesfric.mechanism.forward import forward_tables, possible
from bayesfric.mechanism.integrate import (
    FREE,
    POSITION,
    SPEED,
    Carried,
    Plant,
    acceleration,
    fed_back,
    integrate,
    motor_torque,
    plant_of,
)
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.kernels import GAIN, INERTIA, LOAD_INERTIA, VISCOUS
from bayesfric.recordings.arrays import Array, Flags, Index
from bayesfric.recordings.measurement import Inputs, Law

# A change of regime within a shorter part of a step than this is not located.
_SHORT = 1e-9


class _Drive(NamedTuple):
    """A :class:`Law` for the compiled functions, with the gains of one parameter vector.

    ``on (scale clip(kp (target - q) - kd qd, limit) - back_emf qd)`` in units of the measured
    torque.
    """

    command: Array  # (N,) kp times the target, or a command where the drive does not look
    factor: float  # by which the vector multiplies it
    bends: Array  # (N,) second derivative of the spline through it, per squared sample
    scale: Array  # (N,)
    on: Array  # (N,) 1 where the drive gives a torque, else 0
    kp: float
    kd: float
    limit: float
    back_emf: float
    held: bool  # whether a command is held until the next
    smoothness: float  # else how it passes there: 0 in a line, 1 in a cubic spline
    delay: float  # by which it acts late on its target, samples
    period: float  # s
    time: Array  # (N,) s
    longest: float  # s, longest step


class _Loop(NamedTuple):
    """A joint and its drive, laid out for ``n`` parameter vectors."""

    elements: Array
    load: Array
    carried: Carried | None
    valid: Flags  # (n,)
    drive: _Drive  # the gains are those of no vector
    gains: Array  # (n, 5) factor of the command, kp, kd, delay in samples, smoothness
    # coefficients (n, c) of the load's inertia and torque (c, 2, N) by further columns
    weights: Array
    columns: Array


def _loop(
    joint: Joint,
    vectors: Array,
    law: Law,
    period: float,
    segments: Index,
    inputs: Inputs,
    time: Array | None,
    step: float,
) -> _Loop:
    even = period * np.arange(law.command.size)
    stamps: Array = np.ascontiguousarray(even if time is None else time, dtype=np.float64)
    weights, columns, inputs = joint.load_columns(vectors, inputs, stamps)
    elements, load, carried = forward_tables(joint, vectors, inputs)
    # gains that are parameters act inside the drive's limit, not as a gain and a viscous loss
    factor, kd = joint.drive_gains(vectors)
    load[:, GAIN] /= factor
    elements[:, 0, VISCOUS] -= kd / joint.ratio
    kp, kd = factor * law.kp, law.kd + kd
    # a loop that is closed every T s looks T/2 ago, and its speed is late by its filter, too
    back, lag = 0.5 * (law.loop or 0.0), law.velocity_filter or 0.0
    elements[:, 0, INERTIA] -= float(law.scale.mean()) * kd * (back + lag) / joint.ratio
    on = np.ones(law.command.size) if law.off is None else 1.0 - law.off
    command, scale, on = (
        np.ascontiguousarray(x, dtype=np.float64) for x in (law.command, law.scale, on)
    )
    late = joint.delays(vectors) / period if joint.by_target and law.closed else 0.0 * factor
    smoothness = joint.smoothnesses(vectors) * (law.held is None)
    gains = np.stack([factor, kp, kd - back * kp, late, smoothness], axis=1)
    limit, back_emf, held = float(law.limit), float(law.back_emf), bool(law.held)
    bends = np.zeros_like(command)
    for a, b in segments if joint.smoothness else ():
        places = np.arange(b - a)
        bends[a:b] = CubicSpline(places, command[a:b], bc_type="natural")(places, 2)
    gains_of_none = 0.0, 0.0, limit, back_emf, held, 0.0, 0.0
    drive = _Drive(command, 1.0, bends, scale, on, *gains_of_none, period, stamps, step)
    least = load.copy()
    least[:, LOAD_INERTIA] += (weights @ columns[:, 0]).min(axis=1)
    valid = possible(joint, vectors, elements, least)
    return _Loop(elements, load, carried, valid, drive, gains, weights, columns)


@njit(cache=True, error_model="numpy", inline="always")
def _with_gains(drive: _Drive, gains: Array) -> _Drive:
    return _Drive(
        drive.command,
        gains[0],
        drive.bends,
        drive.scale,
        drive.on,
        gains[1],
        gains[2],
        drive.limit,
        drive.back_emf,
        drive.held,
        gains[4],
        gains[3],
        drive.period,
        drive.time,
        drive.longest,
    )


@njit(cache=True, error_model="numpy")
def _of_load(weights: Array, columns: Array) -> Array:
    """Inertia and torque of the load ``(2, N)`` by further columns, at coefficients ``(c,)``."""
    out = np.zeros(columns.shape[1:])
    for c in range(columns.shape[0]):
        out += weights[c] * columns[c]
    return out


@njit(cache=True, error_model="numpy", inline="always")
def _command(drive: _Drive, ends: tuple[int, int], place: float, held_at: float) -> float:
    """Command at a place, in samples; one that is held is that at ``held_at``."""
    first, last = ends
    if drive.held:
        i = min(max(math.floor(held_at), first), last)
        return float(drive.factor * drive.command[i])
    place = min(max(place, float(first)), float(last))
    i = min(int(place), max(last - 1, first))
    j = min(i + 1, last)
    u, x = drive.command, place - i
    bend = (2.0 - x) * drive.bends[i] + (1.0 + x) * drive.bends[j]
    y = u[i] + x * (u[j] - u[i]) - drive.smoothness * x * (1.0 - x) / 6.0 * bend
    return drive.factor * float(y)


@njit(cache=True, error_model="numpy", inline="always")
def _under_drive(
    plant: Plant,
    drive: _Drive,
    i: int,
    ends: tuple[int, int],
    now: float,
    end: float,
    held_at: float,
    regime: float,
    of_load: tuple[float, float],
) -> tuple[Plant, float, float]:
    """Return the joint under its drive from ``now`` to ``end`` of sample ``i``, and its torques.

    ``regime`` is zero, or the sign of the limit at which the drive is; ``of_load`` the load's
    inertia and torque; the ``ends`` are those of the segment.
    """
    j = min(i + 1, drive.scale.shape[0] - 1)
    scale0 = drive.scale[i] + now * (drive.scale[j] - drive.scale[i])
    scale1 = drive.scale[i] + end * (drive.scale[j] - drive.scale[i])
    c0 = c1 = regime * drive.limit
    stiffness, damping, on = 0.0, drive.back_emf, drive.on[i]
    if regime == 0.0:
        c0 = _command(drive, ends, i + now - drive.delay, held_at)
        c1 = _command(drive, ends, i + end - drive.delay, held_at)
        scale = 0.5 * (scale0 + scale1)
        stiffness, damping = scale * drive.kp, damping + scale * drive.kd
        if not drive.held:  # a line of the curve's mean (Simpson's rule)
            c = _command(drive, ends, i + 0.5 * (now + end) - drive.delay, held_at)
            c = 2.0 / 3.0 * (c - 0.5 * (c0 + c1))
            c0, c1 = c0 + c, c1 + c
    feedback, (inertia, pull) = on * plant.gain, of_load
    looped = fed_back(plant, feedback * stiffness, feedback * damping, inertia, pull)
    return looped, on * scale0 * c0, on * scale1 * c1


@njit(cache=True, error_model="numpy", inline="always")
def _parts(drive: _Drive, of_load: Array, i: int) -> tuple[float, tuple[float, float]]:
    """Return where in a sample a held target changes, and the load's mean inertia and torque."""
    j = min(i + 1, drive.scale.shape[0] - 1)
    # what passes between samples bends there, which a mean allows for
    knot = drive.delay - math.floor(drive.delay) if drive.held else 0.0
    return knot, (0.5 * (of_load[0, i] + of_load[0, j]), 0.5 * (of_load[1, i] + of_load[1, j]))


@njit(cache=True, error_model="numpy")
def _over_sample(
    plant: Plant,
    drive: _Drive,
    i: int,
    ends: tuple[int, int],
    q: float,
    qd: float,
    push: float,
    push_rate: float,
    of_load: Array,
    out: Array,
    counts: Index,
) -> tuple[float, float]:
    """Move the joint from sample ``i`` to the next of a segment with the first and last ``ends``.

    ``push`` is a torque in addition at the sample, and its change over it; ``of_load`` ``(2, N)``
    the load's inertia and torque. NaN if it runs away.
    """
    torque = np.empty(2)
    knot, load = _parts(drive, of_load, i)
    for part in range(2):
        a, b = (0.0, knot) if part == 0 else (knot, 1.0)
        if b - a < _SHORT:
            continue
        steps = math.ceil((b - a) * drive.period / drive.longest - 1e-9)
        middle = i + 0.5 * (a + b) - drive.delay
        for s in range(steps):
            now, end = a + s * (b - a) / steps, a + (s + 1) * (b - a) / steps
            aim = _command(drive, ends, i + now - drive.delay, middle)
            aim -= drive.kp * q + drive.kd * qd
            regime = 0.0 if abs(aim) < drive.limit else math.copysign(1.0, aim)
            until, splits = end, 0
            while end - now > _SHORT:
                looped, torque[0], torque[1] = _under_drive(
                    plant, drive, i, ends, now, end, middle, regime, load
                )
                torque[0] += push + now * push_rate
                torque[1] += push + end * push_rate
                if until < end:
                    share = (until - now) / (end - now)
                    torque[1] = torque[0] + share * (torque[1] - torque[0])
                time, h = drive.time[i] + now * drive.period, (until - now) * drive.period
                if integrate(looped, torque, h, time, True, q, qd, 1, out, counts) < 2:
                    return math.nan, math.nan
                q1, qd1 = out[POSITION, 1], out[SPEED, 1]
                if not abs(q1) < 1e6:
                    return math.nan, math.nan
                aim1 = _command(drive, ends, i + until - drive.delay, middle)
                aim1 -= drive.kp * q1 + drive.kd * qd1
                side = math.copysign(1.0, aim1) if regime == 0.0 else regime
                if until == end and splits < 4:
                    # the command crosses the limit: go as far as there, then on without or with it
                    before, after = side * aim - drive.limit, side * aim1 - drive.limit
                    if after > 0.0 if regime == 0.0 else after < 0.0:
                        splits += 1
                        until = now + min(max(before / (before - after), 0.0), 1.0) * (end - now)
                        if until - now >= _SHORT:
                            continue
                        q1, qd1, aim1 = q, qd, aim
                q, qd, now, aim = q1, qd1, until, aim1
                if until < end:
                    regime, until = (side if regime == 0.0 else 0.0), end
    return q, qd


# --- simulated --------------------------------------------------------------------------


def follow(
    joint: Joint,
    values: ArrayLike,
    law: Law,
    period: float,
    segments: ArrayLike,
    q0: ArrayLike,
    qd0: ArrayLike,
    *,
    push: ArrayLike | None = None,
    inputs: Inputs = Inputs(),  # noqa: B008  (frozen)
    time: Array | None = None,
    step: float = 2e-3,
) -> tuple[Array, Array]:
    """Simulate the joint while a drive follows its command, restarted in every segment ``(K, 2)``.

    ``push`` is a torque ``(1, N)`` or ``(n, N)`` in addition. Returns positions and speeds
    ``(n, N)``.
    """
    vectors = np.ascontiguousarray(values, dtype=np.float64)
    pieces = np.asarray(segments, dtype=np.int64)
    rows = np.zeros((1, law.command.size)) if push is None else push
    q, qd = _follow(
        *_loop(joint, vectors, law, float(period), pieces, inputs, time, float(step)),
        np.ascontiguousarray(rows, dtype=np.float64),
        pieces,
        np.asarray(q0, dtype=np.float64),
        np.asarray(qd0, dtype=np.float64),
    )
    return np.asarray(q), np.asarray(qd)


@njit(cache=True, error_model="numpy", parallel=True)
def _follow(
    elements: Array,
    loads: Array,
    carried: Carried | None,
    valid: Flags,
    drive: _Drive,
    gains: Array,
    weights: Array,
    columns: Array,
    pushes: Array,
    segments: Index,
    q0: Array,
    qd0: Array,
) -> tuple[Array, Array]:
    """Integrate every vector and segment in parallel."""
    n, pieces, samples = len(elements), segments.shape[0], pushes.shape[1]
    q_out, qd_out = np.full((n, samples), np.nan), np.full((n, samples), np.nan)
    for job in prange(n * pieces):
        v, k = job // pieces, job % pieces
        if not valid[v]:
            continue
        plant = plant_of(elements, loads, carried, v)
        looped = _with_gains(drive, gains[v])
        of_load = _of_load(weights[v], columns)
        push = pushes[v if pushes.shape[0] > 1 else 0]
        out, counts = np.empty((4, 2)), np.zeros(2, dtype=np.int64)
        a, b = segments[k]
        q, qd = q0[k], qd0[k]
        for i in range(a, b):
            q_out[v, i], qd_out[v, i] = q, qd
            if i < b - 1 and not np.isnan(q):
                rate = push[i + 1] - push[i]
                q, qd = _over_sample(
                    plant, looped, i, (a, b - 1), q, qd, push[i], rate, of_load, out, counts
                )
    return q_out, qd_out


# --- predicted --------------------------------------------------------------------------

# Parameters of the noise: sd of a slow random torque and its time constant, density of white
# torque noise, sd of the encoder beyond its steps, and sd of the sampling instants.
SLOW_TORQUE, SLOW_TIME, WHITE_TORQUE, ENCODER, INSTANTS = range(5)
# Readings in a row that repeat their rounding error, at most.
_REPEATS = 20
# Share of a reading's sd by which a linearised motion may be off before it is corrected.
_LINEAR = 1e-3
# Terms of the series of a linearised motion, and the product of its rate and time that they allow.
_TERMS, _FASTEST = 16, 2.0


def innovations(
    joint: Joint,
    values: ArrayLike,
    noise: ArrayLike,
    law: Law,
    period: float,
    segments: ArrayLike,
    position: Array,
    compared: Flags,
    *,
    pushes: Array | None = None,
    resolution: float,
    stride: int = 1,
    inputs: Inputs = Inputs(),  # noqa: B008  (frozen)
    time: Array | None = None,
    step: float = 5e-3,
) -> tuple[Array, Array]:
    """Predict every encoder reading from the ones before it, for parameter vectors ``(n, d)``.

    Parameters
    ----------
    noise
        ``(n, 5)`` sd of the slow random torque (in units of the measured torque) and its time
        constant, s; density of white torque noise, torque times root of s; sd of the encoder
        beyond its steps, rad or m; sd of the sampling instants, s.
    position, compared
        ``(N,)`` readings, and whether each is one that the model must explain.
    pushes
        ``(m, N)`` known torques in addition, in units of the measured torque, of which the effects
        are requested.
    resolution
        Step of the encoder, rad or m.
    stride
        Only every so many readings are used: the horizon of the prediction.

    Returns
    -------
    tuple of ndarray
        Readings less their predictions, and the variances of these differences, ``(n, N)``; zero
        and one where no reading is compared, NaN where a motion is impossible. With ``pushes`` the
        differences are the changes ``(m, N)`` by each of a single vector's, to first order.
    """
    vectors = np.ascontiguousarray(values, dtype=np.float64)
    pieces = np.asarray(segments, dtype=np.int64)
    linearised = 0 if pushes is None else len(vectors)
    gains, moves = (np.zeros((linearised, position.size, *shape)) for shape in ((3,), (3, 3)))
    error, variance = _innovations(
        *_loop(joint, vectors, law, float(period), pieces, inputs, time, float(step)),
        np.ascontiguousarray(noise, dtype=np.float64),
        pieces,
        np.ascontiguousarray(position, dtype=np.float64),
        compared,
        float(resolution) / math.sqrt(12.0),
        stride,
        gains,
        moves,
    )
    if pushes is not None:
        error = _effects(gains[0], moves[0], pieces, np.ascontiguousarray(pushes, np.float64))
    return np.asarray(error), np.asarray(variance)


@njit(cache=True, error_model="numpy", parallel=True)
def _innovations(
    elements: Array,
    loads: Array,
    carried: Carried | None,
    valid: Flags,
    drive: _Drive,
    gains_of: Array,
    weights: Array,
    columns: Array,
    noise: Array,
    segments: Index,
    y: Array,
    compared: Flags,
    rounding: float,
    stride: int,
    gains: Array,
    moves: Array,
) -> tuple[Array, Array]:
    n = len(elements)
    errors, variances = np.zeros((n, y.size)), np.ones((n, y.size))
    for v in prange(n):
        if not valid[v]:
            errors[v] = np.nan
            continue
        plant = plant_of(elements, loads, carried, v)
        looped = _with_gains(drive, gains_of[v])
        of_load = _of_load(weights[v], columns)
        # nothing is kept of an empty array
        at = v if v < gains.shape[0] else 0
        gain, move = gains[at : at + 1], moves[at : at + 1]
        for k in range(segments.shape[0]):
            ends = segments[k, 0], segments[k, 1] - 1
            _filter(
                plant,
                looped,
                noise[v],
                of_load,
                ends,
                y,
                compared,
                rounding,
                stride,
                errors[v],
                variances[v],
                gain,
                move,
            )
    return errors, variances


@njit(cache=True, error_model="numpy")
def _effects(gains: Array, moves: Array, segments: Index, pushes: Array) -> Array:
    """Change ``(m, N)`` of prediction errors by torques, given what the filter does at each sample.

    Its gains are ``(N, 3)``, and the derivatives of each state by that before ``(N, 3, 3)``.
    """
    out = np.zeros(pushes.shape)
    for m in range(pushes.shape[0]):
        for k in range(segments.shape[0]):
            x, after = np.zeros(3), np.zeros(3)
            for i in range(segments[k, 0], segments[k, 1]):
                error = -x[0] if gains[i, 0] != 0.0 else 0.0
                out[m, i] = error
                for a in range(3):
                    x[a] += gains[i, a] * error
                push = 0.5 * (pushes[m, i] + pushes[m, min(i + 1, pushes.shape[1] - 1)])
                for a in range(3):
                    after[a] = moves[i, a, 0] * x[0] + moves[i, a, 1] * x[1]
                    after[a] += moves[i, a, 2] * (x[2] + (push if a < 2 else 0.0))
                x[:] = after
    return out


@njit(cache=True, error_model="numpy")
def _root(p: Array, root: Array) -> None:
    """Cholesky root of a covariance (3, 3), also of a singular one."""
    for i in range(3):
        for j in range(i + 1):
            s = p[i, j]
            for m in range(j):
                s -= root[i, m] * root[j, m]
            if i == j:
                root[i, i] = math.sqrt(max(s, 0.0))
            else:
                root[i, j] = s / root[j, j] if root[j, j] > 1e-150 else 0.0


@njit(cache=True, error_model="numpy")
def _linearised(
    plant: Plant,
    drive: _Drive,
    i: int,
    ends: tuple[int, int],
    x: Array,
    p: Array,
    of_load: Array,
    tolerance: float,
    move: Array,
) -> bool:
    """Move the state ``(3,)`` over a sample in which nothing happens, by its linearised equation.

    ``move`` ``(3, 3)`` becomes the derivatives of the state by that before. False, and nothing is
    moved, if the joint may reverse or meet the limit within three sds of the covariance ``p``, the
    power flow turns, or the motion is not so linear, rad or m.
    """
    knot, load = _parts(drive, of_load, i)
    sds = math.sqrt(p[0, 0]), math.sqrt(p[1, 1])
    reach = 3.0 * (drive.kp * sds[0] + drive.kd * sds[1])
    q, qd, sign = x[0], x[1], math.copysign(1.0, x[1])
    for a in range(3):
        for b in range(3):
            move[a, b] = 1.0 if a == b else 0.0
    for part in range(2):
        begin, end = (0.0, knot) if part == 0 else (knot, 1.0)
        if end - begin < _SHORT:
            continue
        middle = i + 0.5 * (begin + end) - drive.delay
        time, h = drive.time[i] + begin * drive.period, (end - begin) * drive.period
        looped, first, last = _under_drive(plant, drive, i, ends, begin, end, middle, 0.0, load)
        torque = plant.gain * (first + x[2]) - plant.offset
        rise = plant.gain * (last - first)
        start, flow = acceleration(looped, q, qd, torque, time, sign, FREE)
        by_q, _ = acceleration(looped, q + sds[0], qd, torque, time, sign, flow)
        by_qd, _ = acceleration(looped, q, qd + sign * sds[1], torque, time, sign, flow)
        small = max(1e-3 * abs(torque), 1e-9)
        by_push, _ = acceleration(looped, q, qd, torque + small, time, sign, flow)
        by_q, by_qd = (by_q - start) / sds[0], (by_qd - start) / (sign * sds[1])
        by_push = (by_push - start) / small
        if not abs(by_qd) * h + abs(by_q) * h * h < _FASTEST:
            return False
        # series of the response to a push of unit acceleration from the start on
        again, response, slope, integral = 0.0, 0.0, 0.0, 0.0
        now, power = 1.0, h
        for n in range(2, _TERMS):
            # now is the n-th derivative at the start, power h^(n-1) / (n-1)!
            slope += now * power
            power *= h / n
            response += now * power
            integral += now * power * h / (n + 1)
            again, now = now, by_qd * now + by_q * again
        bend = 1.0 + by_qd * slope + by_q * response
        free, rate = start - by_qd * qd, by_push * rise / h
        q1 = q + free * response + qd * slope + rate * integral
        qd1 = free * slope + qd * bend + rate * response
        linear = start + by_q * (q1 - q) + by_qd * (qd1 - qd) + by_push * rise
        true, flow_after = acceleration(looped, q1, qd1, torque + rise, time + h, sign, FREE)
        error = true - linear  # grows with the square of the time
        least = min(sign * qd, sign * qd1)
        if sign * start < 0.0 < sign * true:  # above both tangents
            least = min(least, max(sign * (qd + h * start), sign * (qd1 - h * true)))
        aim = abs(
            _command(drive, ends, i + begin - drive.delay, middle) - drive.kp * q - drive.kd * qd
        )
        aim1 = abs(
            _command(drive, ends, i + end - drive.delay, middle) - drive.kp * q1 - drive.kd * qd1
        )
        if not (
            least > 3.0 * sds[1]
            and max(aim, aim1) + reach < drive.limit
            and flow == flow_after
            and abs(error) * h * h < 12.0 * tolerance
        ):
            return False
        q, qd = q1 + error * h * h / 12.0, qd1 + error * h / 3.0
        by_push *= plant.gain
        for b in range(3):
            by0, by1, by2 = move[0, b], move[1, b], 1.0 if b == 2 else 0.0
            by2 *= by_push
            move[0, b] = (1.0 + by_q * response) * by0 + slope * by1 + response * by2
            move[1, b] = by_q * slope * by0 + bend * by1 + slope * by2
    x[0], x[1] = q, qd
    return True


@njit(cache=True, error_model="numpy")
def _filter(
    plant: Plant,
    drive: _Drive,
    noise: Array,
    of_load: Array,
    ends: tuple[int, int],
    y: Array,
    compared: Flags,
    rounding: float,
    stride: int,
    errors: Array,
    variances: Array,
    gains: Array,
    moves: Array,
) -> None:
    """Filter one segment; the state is position, speed and the slow torque (measured units).

    Its gains ``(1, N, 3)``, and derivatives ``(1, N, 3, 3)`` of the state by that before are kept
    if there is room.
    """
    period, (first, final) = drive.period, ends
    x, p, root = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
    points, gain = np.zeros((6, 3)), np.zeros(3)
    move, moved = np.zeros((3, 3)), np.zeros((3, 3))
    out, counts = np.empty((4, 2)), np.zeros(2, dtype=np.int64)
    # in units of the measured torque, at the gains that the law was read with
    unit, slow = drive.factor, noise[SLOW_TORQUE] * drive.factor
    base = noise[ENCODER] ** 2 + rounding**2
    last = min(first + 2, final)
    speed = (y[last] - y[first]) / max((last - first) * period, period)
    x[0], x[1] = y[first], speed
    p[0, 0], p[1, 1] = base, (0.3 * speed) ** 2 + base / period**2
    p[2, 2] = slow**2
    keeps = math.exp(-period / noise[SLOW_TIME])
    random = plant.gain * noise[WHITE_TORQUE] * unit
    run = 1
    for k in range(first, final + 1):
        if k > first and (k - first) % stride == 0 and compared[k]:
            run = run + 1 if y[k] == y[k - stride] else 1
            # repeated readings repeat their error; one at another instant is off by its speed
            s = p[0, 0] + noise[ENCODER] ** 2 + rounding**2 * min(run, _REPEATS)
            s += (noise[INSTANTS] * x[1]) ** 2
            error = y[k] - x[0]
            errors[k], variances[k] = error, s
            for i in range(3):
                gain[i] = p[i, 0] / s
            for i in range(3):
                x[i] += gain[i] * error
            for i in range(3):
                for j in range(i + 1):
                    p[i, j] -= gain[i] * gain[j] * s
                    p[j, i] = p[i, j]
            for kept in gains:
                kept[k] = gain
        if k == final:
            break
        tolerance = _LINEAR * math.sqrt(base + p[0, 0])
        if _linearised(plant, drive, k, ends, x, p, of_load, tolerance, move):
            x[2] *= keeps
            move[2, 2] = keeps
            for i in range(3):
                for j in range(3):
                    moved[i, j] = 0.0
                    for m in range(3):
                        moved[i, j] += move[i, m] * p[m, j]
            for i in range(3):
                for j in range(i + 1):
                    s = 0.0
                    for m in range(3):
                        s += moved[i, m] * move[j, m]
                    p[i, j] = p[j, i] = s
        else:
            _root(p, root)
            for r in range(6):
                i, shift = r // 2, math.sqrt(3.0) * (1.0 if r % 2 == 0 else -1.0)
                push = x[2] + shift * root[2, i]
                points[r, 0], points[r, 1] = _over_sample(
                    plant,
                    drive,
                    k,
                    ends,
                    x[0] + shift * root[0, i],
                    x[1] + shift * root[1, i],
                    push,
                    0.0,
                    of_load,
                    out,
                    counts,
                )
                points[r, 2] = keeps * push
            for i in range(3):
                x[i] = points[:, i].mean()
            for i in range(3):
                for j in range(i + 1):
                    s = 0.0
                    for r in range(6):
                        s += (points[r, i] - x[i]) * (points[r, j] - x[j])
                    p[i, j] = p[j, i] = s / 6.0
            for i in range(3):  # the root is triangular: back substitution
                for j in range(2, -1, -1):
                    s = (points[2 * j, i] - points[2 * j + 1, i]) / math.sqrt(12.0)
                    for m in range(j + 1, 3):
                        s -= move[i, m] * root[m, j]
                    move[i, j] = s / root[j, j] if root[j, j] > 1e-150 else 0.0
        for kept in moves:
            kept[k] = move
        at_load = fed_back(plant, 0.0, 0.0, of_load[0, k], 0.0)
        inertia = motor_torque(at_load, 0.0, 0.0, 1.0, 0.0, 0.0)
        inertia -= motor_torque(at_load, 0.0, 0.0, 0.0, 0.0, 0.0)
        kick = (random / inertia) ** 2 * period
        p[2, 2] += slow**2 * (1.0 - keeps**2)
        p[1, 1] += kick
        p[0, 1] += 0.5 * kick * period
        p[1, 0] = p[0, 1]
        p[0, 0] += kick * period**2 / 3.0
        if not (abs(x[0]) < 1e6 and math.isfinite(x[1])):
            errors[k + 1 : final + 1] = math.nan
            return
