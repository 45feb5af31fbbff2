"""Roll-outs: a recording's own input drives the joint, and its motion is compared."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.base.errors import BadInput
from bayesfric.base.progress import Progress, ProgressCallback, no_progress
from bayesfric.fit.finished_run import Finished, finished
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.sampling.convergence import autocorrelation
from bayesfric.mechanism.closed_loop import follow
from bayesfric.mechanism.joint import Joint
from bayesfric.problem.config import Config, parse_config, read_document, read_toml
from bayesfric.problem.config_text import config_of, document_text, recording_table
from bayesfric.problem.problem import Problem
from bayesfric.recordings.arrays import Array, Flags
from bayesfric.recordings.filters import later
from bayesfric.recordings.measurement import Law, Measurement
from bayesfric.recordings.moving import without_excluded
from bayesfric.recordings.observation import Observation
from bayesfric.recordings.recording import Recording
from bayesfric.results.roll_out import LEVEL, MOST_OVER, Error, Input, Part, Rolled, RollOut

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
# Draws that the residuals are those of the mean of.
_DRAWS = 100
# Mean length of a piece in times over which residuals remember, and outputs at least.
_MEMORIES, _LEAST = 10.0, 10
# Of the outputs, the longest memory that is looked for.
_LONGEST = 0.1


@dataclass(frozen=True, eq=False)
class Recorded:
    """A recording to be played, as read and as prepared."""

    measurement: Measurement
    observation: Observation
    part: Part

    @cached_property
    def segments(self) -> NDArray[np.int64]:
        """Stretches that are played, ``(K, 2)``: where the drive is off, the joint goes on.

        Raises
        ------
        BadInput
            If there is none.
        """
        m = self.measurement
        off = False if m.law is None or m.law.off is None else m.law.off
        parts = without_excluded(m.segments, m.excluded & np.logical_not(off))
        kept = [(a, b) for a, b in parts if b - a >= _LEAST_SAMPLES]
        if not kept:
            what = f"has no stretch of {_LEAST_SAMPLES} samples to play"
            raise BadInput(f"recording '{m.name}'", what, "exclude less, or record longer")
        return np.array(kept, dtype=np.int64)

    @cached_property
    def used(self) -> Flags:
        """Samples that are played, ``(N,)``."""
        used = np.zeros(self.measurement.time.size, dtype=np.bool_)
        for a, b in self.segments:
            used[a:b] = True
        return used


_Band = tuple[Array, Array]
# Positions and speeds ``(n, N)`` of draws.
_Plays = tuple[Array, Array]


def rollout(
    posterior: Any,
    recordings: Path | str | Recording | Sequence[Recording] | None = None,
    *,
    every: bool = False,
    draws: int = 100,
    seed: int | None = None,
    progress: ProgressCallback = no_progress,
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
    for one in recorded:
        _ = one.segments  # what cannot be played is refused before anything is simulated
    seed = run.model.config.tables.sampling.seed if seed is None else seed
    series = unexplained(run)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(13,)))
    picked = run.values(run.picked(draws))
    few = run.values(run.picked(min(_FEW, draws)))

    def plays(one: Recorded, values: Array, times: Array) -> tuple[_Plays, _Plays]:
        """Play it without and with ``times`` ``(n,)`` the unexplained torque."""
        m = one.measurement
        alone = _play(run, one, values, None, rng)
        push = times[:, None] * played(series, len(values), m.time.size, m.period, rng)
        return alone, _play(run, one, values, push, rng)

    known = own(run, every=True)[len(run.model.held_out) :]
    factors = {}
    for one in known[:: -(-len(known) // _CALIBRATED)]:
        m = one.measurement
        progress(Progress(f"unexplained torque: {m.name}"))
        (alone, _), (moved, _) = plays(one, few, np.ones(len(few)))
        rounding = _ROUNDED * one.observation.position_step
        stays = ~_over(run.joint, m.position, alone, moved)
        factors[m.name] = moving_share(m.position, alone[stays], moved[stays], rounding)
    # each as often as the others
    each = rng.permutation(np.resize(list(factors.values()), len(picked)))
    found = []
    for one in recorded:
        progress(Progress(f"roll-out: {one.measurement.name}"))
        found.append(_rolled(run, one, *plays(one, picked, each)))
    left = np.concatenate([one.values for one in series])
    unit = "N m" if run.joint.motor_motion == "rotary" else "N"
    rms = float(np.sqrt(np.mean(left**2)))
    return RollOut(run.name, tuple(found), len(picked), seed, factors, rms, unit)


def _play(
    posterior: Finished,
    one: Recorded,
    values: Array,
    push: Array | None,
    rng: np.random.Generator,
) -> _Plays:
    """Simulate positions and speeds ``(n, N)``; NaN where nothing is played or moves."""
    m, o, chain = one.measurement, one.observation, posterior.joint
    law = m.law or Law(m.torque, np.ones(m.torque.shape), held=m.hold == "zero")
    segments, start = one.segments, one.segments[:, 0]
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
            held=law.held,
        )
    if chain.delay and not chain.by_target:  # the motion is recorded late
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


def _over(joint: Joint, position: Array, *played: Array) -> Flags:
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


def _rolled(posterior: Finished, one: Recorded, alone: _Plays, moved: _Plays) -> Rolled:
    m, o, chain, used = one.measurement, one.observation, posterior.joint, one.used
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


def _compared(
    measured: Array, moved: Array, alone: Array, used: Flags, step: float
) -> tuple[_Band, _Band, Array, Error]:
    """Bands with unexplained torque and of the parameters alone, their middle, and its error."""
    ends = np.full((2, 3, used.size), np.nan)
    for rows, values in zip(ends, (moved, alone), strict=True):
        rows[:, used] = np.quantile(
            values[:, used], [0.5 - LEVEL / 2, 0.5, 0.5 + LEVEL / 2], axis=0
        )
    band, narrow = ((low - step, high + step) for low, _, high in ends)
    middle = ends[1, 1]
    left = (measured - middle)[used]
    inside, inside_alone = (
        float(np.mean(((low <= measured) & (measured <= high))[used]))
        for low, high in (band, narrow)
    )
    rms, width = np.sqrt(np.mean(left**2)), np.median((band[1] - band[0])[used])
    error = Error(float(np.mean(np.abs(left))), float(rms), inside, inside_alone, float(width))
    return band, narrow, middle, error


def own(posterior: Finished, *, every: bool = False) -> list[Recorded]:
    """Take what the run held out; what it fitted where it held nothing out, or with ``every``."""
    model = posterior.model
    held = [Recorded(one.recording, one.observation, "held out") for one in model.held_out]
    if held and not every:
        return held
    pairs = zip(model.recordings, model.observations, strict=True)
    return [*held, *(Recorded(m, o, "fitted") for m, o in pairs)]


def of_config(posterior: Finished, path: Path) -> list[Recorded]:
    """Read the recordings of another configuration, which may leave out what the run's says.

    Raises
    ------
    BadInput
        If it describes another mechanism than the run's, or for what cannot be used.
    """
    run = tomllib.loads(posterior.model.config.text)
    document = read_document(read_toml(path), path)
    for table in ("mechanism", "processing"):
        if table in run:
            document.setdefault(table, run[table])
    asked = document["mechanism"]
    if isinstance(asked, dict) and asked.get("terms") == "auto":  # the run knows what was put in
        document["mechanism"] = run["mechanism"]
    config = parse_config(document_text(document, path), path)
    if config.tables.mechanism != posterior.model.config.tables.mechanism:
        raise BadInput(
            f"{path}: mechanism", "is not the run's", "leave it out: it is taken from the run"
        )
    return _new(posterior, config, None)


def of_recordings(posterior: Finished, recordings: Sequence[Recording]) -> list[Recorded]:
    """Read recordings made in Python, prepared as the run's."""
    run = tomllib.loads(posterior.model.config.text)
    document: dict[str, Any] = {k: run[k] for k in ("mechanism", "processing") if k in run}
    tables = [recording_table(one, n) for n, one in enumerate(recordings, start=1)]
    return _new(posterior, config_of({**document, "recordings": tables}), recordings)


def _new(
    posterior: Finished, config: Config, recordings: Sequence[Recording] | None
) -> list[Recorded]:
    made = Problem.from_config(config, terms=posterior.joint.terms, recordings=recordings)
    parts = [*zip(made.recordings, made.observations, strict=True)]
    parts += [(one.recording, one.observation) for one in made.held_out]
    return [Recorded(m, o, _part(posterior, m)) for m, o in parts]


def _part(posterior: Finished, m: Measurement) -> Part:
    """Say whether any of it was fitted: a piece of a file that was is not new by another name."""
    same = (one for one in posterior.model.recordings if one.sha256 == m.sha256)
    within = any(one.time[0] <= m.time[-1] and m.time[0] <= one.time[-1] for one in same)
    return "fitted" if within else "new"


@dataclass(frozen=True, eq=False)
class Series:
    """Residuals of one recording, N m or N, one each ``period`` s."""

    values: Array
    period: float


def unexplained(posterior: Finished) -> list[Series]:
    """Take the torque residuals of every fitted recording."""
    likelihood = TorqueLikelihood(posterior.joint, posterior.model.observations)
    predicted = likelihood.predict(posterior.values(posterior.picked(_DRAWS)))
    return [
        Series(o.measured - rows.mean(axis=0), o.period)
        for o, rows in zip(posterior.model.observations, predicted, strict=True)
    ]


def played(
    series: list[Series], draws: int, samples: int, period: float, rng: np.random.Generator
) -> Array:
    """Draw torques ``(draws, samples)``, one each ``period`` s, of pieces of residuals.

    A piece is of any recording, begins anywhere in it, and has either sign; between its outputs
    the torque goes straight.
    """
    lengths = np.array([one.values.size for one in series], dtype=np.float64)
    memories = [memory(one.values) for one in series]
    duration = samples * period
    out = np.zeros((draws, samples))
    time = np.arange(samples) * period
    for row in out:
        stamps, values, now = [], [], 0.0
        while now <= duration:
            k = int(rng.choice(len(series), p=lengths / lengths.sum()))
            one = series[k]
            mean = max(_LEAST, _MEMORIES * memories[k])
            length = min(1 + int(rng.geometric(1.0 / mean)), one.values.size)
            first = int(rng.integers(one.values.size))
            place = (first + np.arange(length)) % one.values.size
            stamps.append(now + one.period * np.arange(length))
            values.append(rng.choice((-1.0, 1.0)) * one.values[place])
            now = stamps[-1][-1] + one.period
        row[:] = np.interp(time, np.concatenate(stamps), np.concatenate(values))
    return out


def memory(values: Array) -> float:
    """Integrated autocorrelation time in outputs, up to the first correlation below zero."""
    if not np.ptp(values) > 0.0:
        return 1.0
    r = autocorrelation(values[np.newaxis])[1 : max(2, int(_LONGEST * values.size))]
    end = int(np.argmax(r <= 0.0)) if (r <= 0.0).any() else r.size
    return 1.0 + 2.0 * float(r[:end].sum())
