"""Roll-outs: the input of a recording drives the joint, and motions are compared."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from bayesfric.base.errors import BadInput
from bayesfric.base.progress import Progress, ProgressCallback, no_progress
from bayesfric.fit.model import Model, Result
from bayesfric.fit.result import result_of
from bayesfric.inference.likelihood import TorqueLikelihood
from bayesfric.inference.posterior import autocorrelation
from bayesfric.mechanism.closed_loop import follow
from bayesfric.mechanism.joint import Joint
from bayesfric.problem.config import (
    document_text,
    parse_config,
    read_document,
    read_toml,
    recording_table,
)
from bayesfric.recordings.arrays import Array, Flags, rms, without_excluded
from bayesfric.recordings.filters import later
from bayesfric.recordings.measurement import Law, Measurement
from bayesfric.recordings.signals import Signals
from bayesfric.recordings.source import Recording
from bayesfric.results.roll_out import LEVEL, MOST_OVER, Error, Input, Part, Rolled, RollOut

# Standard deviation of an encoder's rounding error, in steps.
_ROUNDING = 12.0**-0.5
_Simulated = tuple[Array, Array]  # positions and speeds ``(n, N)`` of draws
# Torque residuals of one recording, N m or N, and their period, s.
Residuals = tuple[Array, float]


@dataclass(frozen=True, eq=False)
class PreparedRecording:
    """A recording to be simulated, as read and as prepared."""

    measurement: Measurement
    observation: Signals
    part: Part

    def segments(self, *, shortest: int = 20) -> NDArray[np.int64]:
        """Segments ``(K, 2)`` of so many samples at least, also where the drive is off."""
        m = self.measurement
        off = False if m.law is None or m.law.off is None else m.law.off
        parts = without_excluded(m.segments, m.excluded & np.logical_not(off))
        segments = [(a, b) for a, b in parts if b - a >= shortest]
        if not segments:
            problem = f"has no segment of {shortest} samples"
            raise BadInput(f"recording '{m.name}'", problem, "exclude less, or record longer")
        return np.array(segments, dtype=np.int64)


def rollout(
    posterior: Any,
    recordings: Path | str | Recording | Sequence[Recording] | None = None,
    *,
    every: bool = False,
    draws: int = 100,
    seed: int | None = None,
    progress: ProgressCallback = no_progress,
) -> RollOut:
    """Simulate the joint under the inputs of recordings, and compare its motion.

    Parameters
    ----------
    posterior
        From :meth:`bayesfric.Model.sample`, or the folder of a finished run.
    recordings
        Other recordings, or a configuration that names them. By default those that the run held
        out, or else those that it fitted. The state is set to the measured one at the start, and
        after gaps and excluded spans.
    every
        Whether to include fitted recordings where some were held out.
    draws
        Number of draws of the posterior, each with its own residual torque.
    seed
        Of the residual torques; that of the run if left out.
    progress
        Callback.

    Returns
    -------
    RollOut
        ``frame`` is its table; :func:`bayesfric.plot.rollout` draws it.

    Raises
    ------
    BadInput
        If there is no such run, a recording has no segment to simulate, or no draw has a motion.
    """
    run = result_of(posterior)
    if recordings is None:
        prepared = recordings_of_run(run, every=every)
    elif isinstance(recordings, str | Path):
        prepared = recordings_of_config(run, Path(recordings))
    else:
        new = [recordings] if isinstance(recordings, Recording) else recordings
        prepared = recordings_of_config(run, new)
    for recording in prepared:
        recording.segments()  # raises before anything is simulated
    seed = run.model.config.tables.sampling.seed if seed is None else seed
    residuals = torque_residuals(run)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(13,)))
    picked = run.values(run.picked(draws))

    def simulations(
        recording: PreparedRecording, values: Array, shares: Array
    ) -> tuple[_Simulated, _Simulated]:
        """Simulate without residual torque, and with ``shares`` ``(n,)`` of it."""
        m = recording.measurement
        without = _simulate(run, recording, values, None, rng)
        blocks = bootstrapped(residuals, len(values), m.time.size, m.period, rng)
        return without, _simulate(run, recording, values, shares[:, None] * blocks, rng)

    # fitted recordings calibrate the share of the residual torque, at most twelve by forty draws
    fitted = recordings_of_run(run, every=True)[len(run.model.held_out) :]
    picked, shares = run.values(run.picked(min(40, draws))), {}
    for recording in fitted[:: -(-len(fitted) // 12)]:
        m = recording.measurement
        progress(Progress(f"unexplained torque: {m.name}"))
        (without, _), (disturbed, _) = simulations(recording, picked, np.ones(len(picked)))
        rounding = _ROUNDING * recording.observation.position_step
        stays = ~_overturned(run.joint, m.position, without, disturbed)
        shares[m.name] = moving_share(m.position, without[stays], disturbed[stays], rounding)
    # each as often as the others
    share_of_draw = rng.permutation(np.resize(list(shares.values()), len(picked)))
    compared = []
    for recording in prepared:
        progress(Progress(f"roll-out: {recording.measurement.name}"))
        compared.append(_compare(run, recording, *simulations(recording, picked, share_of_draw)))
    unit = run.joint.torque_unit
    left = rms(np.concatenate([values for values, _ in residuals]))
    return RollOut(run.name, tuple(compared), len(picked), seed, shares, left, unit)


def _simulate(
    run: Result,
    recording: PreparedRecording,
    values: Array,
    disturbance: Array | None,
    rng: np.random.Generator,
) -> _Simulated:
    """Simulate positions and speeds ``(n, N)``; NaN outside segments, or if they diverge."""
    m, o, chain = recording.measurement, recording.observation, run.joint
    law = m.law or Law(m.torque, np.ones(m.torque.shape), held=m.hold == "zero")
    segments = recording.segments()
    start = segments[:, 0]
    q, qd = np.full((2, len(values), m.time.size), np.nan)
    # a new recording has the separate offset of a random fitted one
    offsets = chain.own_offsets
    new = bool(offsets) and m.name not in offsets
    source = rng.integers(len(offsets), size=len(values)) if new else np.zeros(len(values))
    for k in np.unique(source).astype(int):
        rows = source == k
        q[rows], qd[rows] = follow(
            chain,
            values[rows],
            law,
            m.period,
            segments,
            o.q[start],
            o.qd[start],
            push=None if disturbance is None else disturbance[rows],
            inputs=replace(o.inputs, recording=offsets[k]) if new else o.inputs,
            time=m.time,
        )
    if chain.delay and not chain.by_target:  # the motion is recorded late
        for row, delay in enumerate((chain.delays(values) / m.period).tolist()):
            for a, b in segments:
                q[row, a:b] = later(q[row, a:b], delay)
                qd[row, a:b] = later(qd[row, a:b], delay)
    return q, qd


def moving_share(
    position: Array, without: Array, disturbed: Array, rounding: float, *, largest: float = 10.0
) -> float:
    """Estimate the share of the residual torque that moved the joint in a fitted recording.

    With it the band holds 90 % of the measured positions ``(N,)``, if all are normal and the motion
    is linear in it. Draws ``(n, N)`` are without and with all of the torque; ``rounding`` is the
    standard deviation of the encoder's rounding error.
    """
    finite = np.isfinite(without).all(axis=0) & np.isfinite(disturbed).all(axis=0)
    if not finite.any() or len(without) < 2:
        return 1.0
    quantile = chi2.ppf(LEVEL, 1)
    squares = (position - np.median(without, axis=0))[finite] ** 2
    variance = without.var(axis=0)[finite] + rounding**2
    added = np.maximum(disturbed.var(axis=0)[finite] - without.var(axis=0)[finite], 0.0)
    # the squared share by which each position is on the edge of its band
    with np.errstate(divide="ignore", invalid="ignore"):
        needed = (squares / quantile - variance) / added
    needed = np.where(squares > quantile * variance, needed, 0.0)
    return float(min(np.sqrt(np.quantile(needed, LEVEL, method="inverted_cdf")), largest))


def _overturned(joint: Joint, position: Array, *simulated: Array) -> Flags:
    """Find the draws ``(n, N)`` that came half a turn away from the joint, where gravity acts.

    They took another way over the top, and from there on each turn is like the others.
    """
    if not _pendulum(joint):
        return np.zeros(len(simulated[0]), dtype=np.bool_)
    distance = [np.nanmax(np.abs(q - position), axis=1, initial=0.0) for q in simulated]
    return np.asarray(np.max(distance, axis=0) >= np.pi)


def _pendulum(joint: Joint) -> bool:
    """Whether gravity acts on a joint that turns."""
    moment = any(p.quantity == "first_moment" for p in joint.parameters)
    return moment and joint.load.motion == "rotary"


def _compare(
    run: Result, recording: PreparedRecording, without: _Simulated, disturbed: _Simulated
) -> Rolled:
    """Compare simulated motions, without and with residual torque, with the measured one."""
    m, o, chain = recording.measurement, recording.observation, run.joint
    used = np.zeros(m.time.size, dtype=np.bool_)
    for a, b in recording.segments():
        used[a:b] = True
    (q, qd), (q_disturbed, qd_disturbed) = without, disturbed
    finite = np.isfinite(q_disturbed[:, used]).all(axis=1) & np.isfinite(q[:, used]).all(axis=1)
    if not finite.any():
        raise BadInput(
            f"recording '{m.name}'",
            "the motion diverges under its input for every draw of the posterior",
            "exclude external forces, or record in a closed loop",
        )
    over = _overturned(chain, m.position, q, q_disturbed) & finite
    share = float(over.sum() / finite.sum())
    rows = finite & ~over if share <= MOST_OVER else finite
    speed = m.velocity if m.velocity is not None else o.qd
    # the encoder's step is wider than the band where the joint hardly moves
    step = _ROUNDING * o.position_step
    band, narrow, middle, at_position = _bands(m.position, q_disturbed[rows], q[rows], used, step)
    *_, at_speed = _bands(speed, qd_disturbed[rows], qd[rows], used, 0.0)
    kind: Input = "torque"
    if m.law is not None and m.law.follows:
        kind = "target" if m.law.closed else "voltage"
    motion = float(np.ptp(m.position[used]))
    if _pendulum(chain):
        motion = min(motion, np.pi)
    return Rolled(
        name=m.name,
        part=recording.part,
        input=kind,
        unit="rad" if chain.load.motion == "rotary" else "m",
        time=m.time,
        position=m.position,
        middle=middle,
        band=band,
        alone=narrow,
        errors={"position": at_position, "speed": at_speed},
        room=motion,
        blind=float(np.mean((band[1] - band[0])[used] > motion)),
        over=share,
    )


def _bands(
    measured: Array, disturbed: Array, without: Array, used: Flags, step: float
) -> tuple[tuple[Array, Array], tuple[Array, Array], Array, Error]:
    """Compute bands with residual torque and of the parameters alone, median, and its error."""
    ends = np.full((2, 3, used.size), np.nan)
    levels = [0.5 - LEVEL / 2, 0.5, 0.5 + LEVEL / 2]
    for rows, values in zip(ends, (disturbed, without), strict=True):
        rows[:, used] = np.quantile(values[:, used], levels, axis=0)
    band, narrow = ((low - step, high + step) for low, _, high in ends)
    middle = ends[1, 1]
    difference = (measured - middle)[used]
    inside, inside_alone = (
        float(np.mean(((low <= measured) & (measured <= high))[used]))
        for low, high in (band, narrow)
    )
    mean, rmse = float(np.mean(np.abs(difference))), rms(difference)
    width = float(np.median((band[1] - band[0])[used]))
    return band, narrow, middle, Error(mean, rmse, inside, inside_alone, width)


def recordings_of_run(run: Result, *, every: bool = False) -> list[PreparedRecording]:
    """List the held-out recordings of a run; the fitted ones if there is none, or ``every``."""
    model = run.model
    held_out = [PreparedRecording(x.recording, x.observation, "held out") for x in model.held_out]
    if held_out and not every:
        return held_out
    pairs = zip(model.recordings, model.observations, strict=True)
    return [*held_out, *(PreparedRecording(m, o, "fitted") for m, o in pairs)]


def recordings_of_config(
    run: Result, source: Path | Sequence[Recording]
) -> list[PreparedRecording]:
    """Prepare other recordings, or those of a configuration, as the run's.

    Mechanism and processing of the configuration may be left out.
    """
    tables, recordings = tomllib.loads(run.model.config.text), None
    path = source if isinstance(source, Path) else Path("recordings")
    if isinstance(source, Path):
        document = read_document(read_toml(path), path)
    else:
        recordings = source
        items = [recording_table(x, n) for n, x in enumerate(recordings, start=1)]
        document = {"recordings": items}
    for table in ("mechanism", "processing"):
        if table in tables:
            document.setdefault(table, tables[table])
    mechanism = document["mechanism"]
    if isinstance(mechanism, dict) and mechanism.get("terms") == "auto":  # the run's has the terms
        document["mechanism"] = tables["mechanism"]
    config = parse_config(document_text(document, path), path)
    if config.tables.mechanism != run.model.config.tables.mechanism:
        raise BadInput(
            f"{path}: mechanism", "is not the run's", "leave it out: it is taken from the run"
        )
    problem = Model.from_config(config, terms=run.joint.terms, recordings=recordings)
    parts = [*zip(problem.recordings, problem.observations, strict=True)]
    parts += [(x.recording, x.observation) for x in problem.held_out]
    return [PreparedRecording(m, o, _part(run, m)) for m, o in parts]


def _part(run: Result, m: Measurement) -> Part:
    """Whether any part of a recording was fitted, also under another name."""
    same = (fitted for fitted in run.model.recordings if fitted.sha256 == m.sha256)
    overlap = any(x.time[0] <= m.time[-1] and m.time[0] <= x.time[-1] for x in same)
    return "fitted" if overlap else "new"


def torque_residuals(run: Result, *, draws: int = 100) -> list[Residuals]:
    """Compute the residuals of every fitted recording from the mean prediction of draws."""
    likelihood = TorqueLikelihood(run.joint, run.model.observations)
    predicted = likelihood.predict(run.values(run.picked(draws)))
    return [
        (o.measured - rows.mean(axis=0), o.period)
        for o, rows in zip(run.model.observations, predicted, strict=True)
    ]


def bootstrapped(
    residuals: Sequence[Residuals],
    draws: int,
    samples: int,
    period: float,
    rng: np.random.Generator,
    *,
    shortest: int = 10,
) -> Array:
    """Draw torques ``(draws, samples)``, every ``period`` s, by a block bootstrap of residuals.

    A block is of any recording, begins anywhere in it, has either sign, and on average ten
    autocorrelation times, at least ``shortest`` samples; between its samples the torque is
    interpolated linearly.
    """
    sizes = np.array([values.size for values, _ in residuals], dtype=np.float64)
    means = [max(shortest, 10.0 * autocorrelation_time(values)) for values, _ in residuals]
    out, time = np.zeros((draws, samples)), np.arange(samples) * period
    for row in out:
        stamps, values, start = [], [], 0.0
        while start <= samples * period:
            k = int(rng.choice(len(residuals), p=sizes / sizes.sum()))
            series, series_period = residuals[k]
            length = min(1 + int(rng.geometric(1.0 / means[k])), series.size)
            first = int(rng.integers(series.size))
            block = (first + np.arange(length)) % series.size
            stamps.append(start + series_period * np.arange(length))
            values.append(rng.choice((-1.0, 1.0)) * series[block])
            start = stamps[-1][-1] + series_period
        row[:] = np.interp(time, np.concatenate(stamps), np.concatenate(values))
    return out


def autocorrelation_time(values: Array) -> float:
    """Integrate the autocorrelation, in samples, up to the first below zero or a tenth."""
    if not np.ptp(values) > 0.0:
        return 1.0
    r = autocorrelation(values[np.newaxis])[1 : max(2, int(0.1 * values.size))]
    end = int(np.argmax(r <= 0.0)) if (r <= 0.0).any() else r.size
    return 1.0 + 2.0 * float(r[:end].sum())
