"""Roll-outs: a recording's own input drives the joint, and its motion is compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.errors import BadInput
from bayesfric.finished_run import Finished, finished
from bayesfric.mechanism.closed_loop import follow
from bayesfric.mechanism.joint import Joint
from bayesfric.progress import Progress, Shown, silent
from bayesfric.recordings.drive_law import Law
from bayesfric.recordings.filters import later
from bayesfric.recordings.moving import without_excluded
from bayesfric.recordings.recording import Recording
from bayesfric.results.roll_out import LEVEL, MOST_OVER, Error, Input, Rolled, RollOut
from bayesfric.rollouts.recordings import Recorded, of_config, of_recordings, own
from bayesfric.rollouts.unexplained import played, unexplained

Array = NDArray[np.float64]
# Fitted recordings that say how much of the unexplained torque moves the joint, at most.
_CALIBRATED = 12
# Draws that are enough for that.
_FEW = 40
# How much of it may.
_MOST = 10.0
# Square of a standard normal that 90 % stay below.
_WIDE = 1.6448536269514722**2
# A stretch between gaps that is played by itself has so many samples at least.
_LEAST_SAMPLES = 20
# Standard deviation of a step of the encoder, in steps.
_ROUNDED = 12.0**-0.5


def rollout(
    posterior: Any,
    recordings: Path | str | Recording | Sequence[Recording] | None = None,
    *,
    every: bool = False,
    draws: int = 100,
    seed: int | None = None,
    progress: Shown = silent,
) -> RollOut:
    """Play recordings to the joint, as ``bayesfric rollout`` does, and compare its motion.

    Parameters
    ----------
    posterior
        From :meth:`bayesfric.Model.sample`, or the folder of a finished run.
    recordings
        Others than the run's: recordings, or a configuration that names them. If left out, what
        the run held out, or else what it fitted. Each begins in its own measured state, and anew
        behind gaps and excluded spans.
    every
        What was fitted, too, where some was held out.
    draws
        Of the posterior, each with its own unexplained torque.
    seed
        Of the torques that stand for what the model leaves unexplained; that of the run if left
        out.
    progress
        Called as work goes on.

    Returns
    -------
    RollOut
        ``frame`` is its table; :func:`bayesfric.plot.rollout` draws it.

    Raises
    ------
    BadInput
        If there is no such run, a recording has no stretch to play, or no draw has a motion.
    """
    run = finished(posterior)
    if recordings is None:
        recorded = own(run, every=every)
    elif isinstance(recordings, str | Path):
        recorded = of_config(run, Path(recordings))
    else:
        given = [recordings] if isinstance(recordings, Recording) else recordings
        recorded = of_recordings(run, given)
    seed = run.model.config.tables.sampling.seed if seed is None else seed
    series = unexplained(run)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(13,)))
    picked = run.values(run.picked(draws))
    few = run.values(run.picked(min(_FEW, draws)))
    known = own(run, every=True)[len(run.model.held_out) :]
    factors = {}
    for one in known[:: -(-len(known) // _CALIBRATED)]:
        m = one.measurement
        progress(Progress(f"unexplained torque: {m.name}"))
        alone = _play(run, one, few, None, rng)
        push = played(series, len(few), m.time.size, m.period, rng)
        moved = _play(run, one, few, push, rng)
        rounding = _ROUNDED * one.observation.position_step
        stays = ~_over(run.joint, m.position, alone[0], moved[0])
        factors[m.name] = moving_share(m.position, alone[0][stays], moved[0][stays], rounding)
    # each as often as the others
    each = rng.permutation(np.resize(list(factors.values()), len(picked)))
    found = []
    for one in recorded:
        m = one.measurement
        progress(Progress(f"roll-out: {m.name}"))
        alone = _play(run, one, picked, None, rng)
        push = each[:, None] * played(series, len(picked), m.time.size, m.period, rng)
        moved = _play(run, one, picked, push, rng)
        found.append(_rolled(run, one, alone, moved))
    left = np.concatenate([one.values for one in series])
    unit = "N m" if run.joint.motor_motion == "rotary" else "N"
    rms = float(np.sqrt(np.mean(left**2)))
    return RollOut(run.name, tuple(found), len(picked), seed, factors, rms, unit)


def _segments(one: Recorded) -> NDArray[np.int64]:
    """Stretches that are played, ``(K, 2)``: where the drive is off, the joint goes on."""
    m = one.measurement
    off = np.zeros(m.time.size, dtype=np.bool_) if m.law is None or m.law.off is None else m.law.off
    parts = [
        (a, b)
        for a, b in without_excluded(m.segments, m.excluded & ~off)
        if b - a >= _LEAST_SAMPLES
    ]
    if not parts:
        raise BadInput(
            f"recording '{m.name}'",
            f"has no stretch of {_LEAST_SAMPLES} samples to play",
            "exclude less, or record longer",
        )
    return np.array(parts, dtype=np.int64)


def _play(
    posterior: Finished,
    one: Recorded,
    values: Array,
    push: Array | None,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Simulate positions and speeds ``(n, N)``; NaN where nothing is played or moves."""
    m, o, chain = one.measurement, one.observation, posterior.joint
    law = m.law or Law(m.torque, np.ones(m.torque.shape))
    segments = _segments(one)
    start = segments[:, 0]
    q, qd = np.full((2, len(values), m.time.size), np.nan)
    # what each recording has of its own, a new one borrows from any
    offsets = chain.own_offsets
    borrows = bool(offsets) and m.name not in offsets
    like = rng.integers(len(offsets), size=len(values)) if borrows else np.zeros(len(values))
    for k in np.unique(like).astype(int):
        rows = like == k
        inputs = replace(o.inputs, recording=offsets[k]) if borrows else o.inputs
        q[rows], qd[rows] = follow(
            chain,
            values[rows],
            law,
            m.period,
            segments,
            o.q[start],
            o.qd[start],
            push=None if push is None else push[rows],
            inputs=inputs,
            begin=float(m.time[0]),
            held=m.hold == "zero",
        )
    if chain.delay:  # the motion is recorded late
        for row, delay in enumerate((chain.delays(values) / m.period).tolist()):
            for a, b in segments:
                q[row, a:b] = later(q[row, a:b], delay)
                qd[row, a:b] = later(qd[row, a:b], delay)
    return q, qd


def moving_share(position: Array, alone: Array, moved: Array, rounding: float) -> float:
    """Find how much of the unexplained torque moved the joint in a fitted recording.

    So much that its band holds 90 % of the positions ``(N,)``, were all normal and the motion
    linear in it.

    Parameters
    ----------
    position
        As measured.
    alone, moved
        ``(n, N)`` positions of draws without and with the whole of the torque.
    rounding
        Standard deviation of the encoder's step.
    """
    fine = np.isfinite(alone).all(axis=0) & np.isfinite(moved).all(axis=0)
    if not fine.any() or len(alone) < 2:
        return 1.0
    squares = (position - np.median(alone, axis=0))[fine] ** 2
    before = alone.var(axis=0)[fine] + rounding**2
    more = np.maximum(moved.var(axis=0)[fine] - alone.var(axis=0)[fine], 0.0)
    # a quantile of what each position asks for
    with np.errstate(divide="ignore", invalid="ignore"):
        asked = np.where(squares > _WIDE * before, (squares / _WIDE - before) / more, 0.0)
    return float(min(np.sqrt(np.quantile(asked, LEVEL, method="inverted_cdf")), _MOST))


def _over(joint: Joint, position: Array, *played: Array) -> NDArray[np.bool_]:
    """Tell which plays ``(n, N)`` went another way than the joint over the top, ``(n,)``.

    They came half a turn away from its position, where gravity acts: from there on each turn is
    like the others, and one such play is as good as any other.
    """
    if not _weighed(joint):
        return np.zeros(len(played[0]), dtype=np.bool_)
    away = [np.nanmax(np.abs(one - position), axis=1, initial=0.0) for one in played]
    return np.asarray(np.max(away, axis=0) >= np.pi)


def _weighed(joint: Joint) -> bool:
    """Whether gravity acts on what turns."""
    moment = any(p.quantity == "first_moment" for p in joint.parameters)
    return moment and joint.load.motion == "rotary"


def _rolled(
    posterior: Finished, one: Recorded, alone: tuple[Array, Array], moved: tuple[Array, Array]
) -> Rolled:
    m, o, chain = one.measurement, one.observation, posterior.joint
    used = np.zeros(m.time.size, dtype=np.bool_)
    for a, b in _segments(one):
        used[a:b] = True
    lost = ~np.isfinite(moved[0][:, used]).all(axis=1) | ~np.isfinite(alone[0][:, used]).all(axis=1)
    if lost.all():
        raise BadInput(
            f"recording '{m.name}'",
            "no draw of the posterior moves under its input without running away",
            "exclude what pushes the joint from outside, or record in a closed loop",
        )
    over = _over(chain, m.position, alone[0], moved[0]) & ~lost
    share = float(over.sum() / (~lost).sum())
    kept = ~lost & ~over if share <= MOST_OVER else ~lost
    speed = m.velocity if m.velocity is not None else o.qd
    # the encoder's step is wider than the band where the joint hardly moves
    step = _ROUNDED * o.position_step
    band, q_alone, middle, at_position = _compared(
        m.position, moved[0][kept], alone[0][kept], used, step
    )
    *_, at_speed = _compared(speed, moved[1][kept], alone[1][kept], used, 0.0)
    kind: Input = "torque"
    if m.law is not None and m.law.follows:
        kind = "target" if m.law.closed else "voltage"
    room = float(np.ptp(m.position[used]))
    if _weighed(chain):
        room = min(room, np.pi)
    return Rolled(
        name=m.name,
        part=one.part,
        input=kind,
        unit="rad" if chain.load.motion == "rotary" else "m",
        time=m.time,
        position=m.position,
        speed=speed,
        middle=middle,
        band=band,
        alone=q_alone,
        at_position=at_position,
        at_speed=at_speed,
        runaway=float(lost.mean()),
        room=room,
        blind=float(np.mean((band[1] - band[0])[used] > room)),
        over=share,
    )


_Band = tuple[Array, Array]


def _compared(
    measured: Array, moved: Array, alone: Array, used: NDArray[np.bool_], step: float
) -> tuple[_Band, _Band, Array, Error]:
    """Bands with unexplained torque and of the parameters alone, their middle, and its error."""

    def quantile(values: Array, share: float) -> Array:
        out = np.full(used.size, np.nan)
        out[used] = np.quantile(values[:, used], share, axis=0)
        return out

    low, high = 0.5 - LEVEL / 2.0, 0.5 + LEVEL / 2.0
    band, narrow = ((quantile(x, low) - step, quantile(x, high) + step) for x in (moved, alone))
    middle = quantile(alone, 0.5)
    left = (measured - middle)[used]
    inside, inside_alone = (
        float(np.mean((measured >= ends[0])[used] & (measured <= ends[1])[used]))
        for ends in (band, narrow)
    )
    rms, width = np.sqrt(np.mean(left**2)), np.median((band[1] - band[0])[used])
    error = Error(float(np.mean(np.abs(left))), float(rms), inside, inside_alone, float(width))
    return band, narrow, middle, error
