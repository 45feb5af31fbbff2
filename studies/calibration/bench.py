"""Simulate a bench: a known joint, integrated in fine steps and recorded by realistic sensors.

A recording is a file with a position in counts and a torque at some instants, with noise,
quantisation and a delay between the two. The equation of motion is solved at least twenty times a
sample.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, lfilter

from bayesfric import Element, Joint, Load, Recording, Term
from bayesfric.mechanism import experiment
from bayesfric.mechanism.closed_loop import follow
from bayesfric.mechanism.forward import Motion, simulate
from bayesfric.mechanism.joint import PRESETS
from bayesfric.recordings.measurement import Inputs, Law

Array = NDArray[np.float64]

# Minimum number of simulation steps per sample and per second.
FINE, FINEST = 20, 10_000.0
# Relative variation of parameters between recordings.
SPREAD = 0.3
MAKER = 5.0  # Hz
LINES = (0.31, 0.73, 1.37, 2.9, 5.3)  # Hz


@dataclass(frozen=True)
class Drive:
    """The excitation: a square wave plus a multisine, behind a current loop."""

    amplitude: float  # N m at the motor
    square: float = 0.0  # share of the amplitude
    hertz: float = 1.0  # of the square wave
    lag: float = 0.003  # s of the current loop
    added_mass: float = 0.0
    radius: float = 0.0
    in_step: bool = False  # whether the square wave switches at samples


@dataclass(frozen=True)
class Bench:
    """A measurement setup; every recording draws parameters, phases and noise."""

    joint: Joint
    values: dict[str, float]
    drives: tuple[Drive, ...]
    rate: float = 500.0  # Hz
    duration: float = 10.0  # s
    counts: int = 4096  # a turn
    side: Literal["motor", "joint"] = "joint"
    noise: float = 0.01  # sd of a torque sample over the largest command
    colour: float = 0.0  # s, correlation time of half of the noise's variance
    spread: float = SPREAD  # relative variation of parameters between recordings
    late: float = 0.0  # delay of the position, samples
    maker: int = 0  # order of a causal 5 Hz low-pass of the measured torque; 0 for none
    current: int = 0  # bits of a current sensor, 0 for a torque; it averages over the sample
    memory: Literal["", "ar2", "1/f"] = ""  # autocorrelated noise in place of white
    ripple: tuple[float, int] = (0.0, 0)  # share of the torque's rms, cycles a turn
    true: Joint | None = None  # the simulated joint, where the fitted one lacks a term
    loop: float = 0.0  # Hz of a position loop; else torque is commanded
    path: float = 0.3  # rad, amplitude of each sine of a position loop's target
    sag: float = 0.0  # relative loss of the torque constant at the largest torque
    # fault of the logger: recorded position (rad) and torque from time, position, torque
    fault: Callable[[Array, Array, Array], tuple[Array, Array]] | None = None
    tables: dict[str, Any] = field(default_factory=dict)  # of the configuration

    def truth(self, rng: np.random.Generator) -> dict[str, float]:
        """Draw true parameters; the delay is fixed."""
        factors = rng.uniform(1.0 - self.spread, 1.0 + self.spread, len(self.values))
        drawn = {k: v * f for (k, v), f in zip(self.values.items(), factors, strict=True)}
        return drawn | ({"drive.delay": self.late / self.rate} if self.joint.delay else {})


def axis(*, ratio: float = 1.0) -> Joint:
    """Build a motor that swings a load, behind a gear without load-dependent friction."""
    motor = Element("motor", inertia=True, coulomb="symmetric", viscous=True, ratio=ratio)
    return Joint(elements=(motor,), load=Load(first_moment=True), offset=True)


def recorded(
    bench: Bench,
    rng: np.random.Generator,
    folder: Path,
    motions: list[tuple[Array, Array, Array]] | None = None,
) -> tuple[Any, ...]:
    """Write the files of one recording; return the truth, the recordings and the sticking share.

    Appends the exact position, speed and acceleration at every file's samples to ``motions``.
    """
    truth = bench.truth(rng)
    recordings = []
    stuck = []
    for number, drive in enumerate(bench.drives):
        motion, time, torque = moved(bench, drive, truth, rng)
        stuck.append(float(np.mean(motion.sticking)))
        path = folder / f"recording-{number}.csv"
        columns = measured(bench, motion, time, torque, rng)
        header = ",".join(columns)
        table = np.stack(list(columns.values()), axis=1)
        np.savetxt(path, table, fmt="%.9g", delimiter=",", header=header, comments="")
        if motions is not None:
            motions.append(exactly(bench, motion, time))
        recordings.append(as_recorded(bench, drive, path))
    return truth, recordings, float(np.mean(stuck))


def moved(
    bench: Bench, drive: Drive, truth: dict[str, float], rng: np.random.Generator
) -> tuple[Motion, Array, Array]:
    """Integrate the equation of motion; return it with time and motor torque without ripple."""
    steps = max(FINE, int(np.ceil(FINEST / bench.rate)))
    period = 1.0 / (bench.rate * steps)
    # 0.1 s before and after, for averages and delays
    time = np.arange(round((bench.duration + 0.2) / period)) * period
    sines = experiment.multisine(time, 1.0, LINES, seed=int(rng.integers(2**31)))
    sines *= (1.0 - drive.square) / np.sqrt(len(LINES) / 2.0)
    phase = 0.0 if drive.in_step else rng.uniform(0.0, 1.0)
    command = sines + experiment.square(time + phase, drive.square, drive.hertz)
    torque = experiment.current_loop(drive.amplitude * command, period, drive.lag)
    # the delay is applied to the measured position, see below
    joint = replace(bench.true or bench.joint, delay=False)
    vector = [truth[name] for name in joint.names]
    share, times = bench.ripple
    if share:
        amplitude = float(np.sqrt(2.0) * share * np.sqrt(np.mean(torque**2)))
        ripple = Term("motor.ripple", lambda m, k=float(times): np.sin(k * m.position + 1.0))
        joint = replace(joint, terms=(*joint.terms, ripple))
        values = truth | {"motor.ripple": amplitude}
        vector = [values[name] for name in joint.names]
    inputs = Inputs(drive.added_mass, drive.radius)
    if bench.loop:
        path = experiment.multisine(time, bench.path, LINES[:-1], seed=int(rng.integers(2**31)))
        return _followed(bench, joint, np.array(vector), period, path, inputs)
    motion = simulate(joint, np.array(vector), torque, period, inputs=inputs, substeps=1)
    return motion, time, torque


def _followed(
    bench: Bench, joint: Joint, vector: Array, period: float, path: Array, inputs: Inputs
) -> tuple[Motion, Array, Array]:
    """Move the joint by a position loop with a damping of 0.7, and record the loop's torque."""
    kp, kd = gains(bench.loop, sum(v for k, v in bench.values.items() if k.endswith("inertia")))
    law = Law(kp * path, np.ones(path.size), kp, kd)
    start = [[0, path.size]], [path[0]], [0.0]
    trajectory = follow(joint, vector[None], law, period, *start, inputs=inputs, step=period)
    q, qd = trajectory[0][0], trajectory[1][0]
    torque, time = kp * (path - q) - kd * qd, np.arange(path.size) * period
    motion = Motion(time, q, qd, np.gradient(qd, period), torque, qd == 0.0, 0, 0, 0.0, 1)
    return motion, time, torque


def gains(hertz: float, inertia: float) -> tuple[float, float]:
    """Return stiffness and damping of a position loop with a damping ratio of 0.7."""
    omega = 2.0 * np.pi * hertz
    return inertia * omega**2, 1.4 * omega * inertia


def instants(bench: Bench) -> Array:
    """Return the sample times; the simulation begins 0.1 s earlier."""
    return np.arange(int(bench.duration * bench.rate)) / bench.rate + 0.1


def exactly(bench: Bench, motion: Motion, time: Array) -> tuple[Array, Array, Array]:
    """Sample the true motion at the position's instants, averaged if the torque is."""
    samples = instants(bench) - bench.late / bench.rate
    signals = []
    for x in (motion.q, motion.qd * ~motion.sticking, motion.qdd):
        if bench.current:
            signals.append(_means(x, time, samples, bench.rate))
        else:
            signals.append(x[np.round(samples / (time[1] - time[0])).astype(int)])
    return signals[0], signals[1], signals[2]


def _means(x: Array, time: Array, samples: Array, rate: float) -> Array:
    """Average a piecewise linear signal over the sampling period about each instant."""
    steps = 0.5 * (x[1:] + x[:-1]) * (time[1] - time[0])
    integral = np.concatenate([[0.0], np.cumsum(steps)])
    ends = np.append(samples - 0.5 / rate, samples[-1] + 0.5 / rate)
    return np.asarray(np.diff(np.interp(ends, time, integral)) * rate)


def measured(
    bench: Bench, motion: Motion, time: Array, torque: Array, rng: np.random.Generator
) -> dict[str, Array]:
    """Sample position and torque by the bench's sensors."""
    samples = instants(bench)
    position = np.interp(samples - bench.late / bench.rate, time, motion.q)
    position *= bench.joint.ratio if bench.side == "motor" else 1.0
    counts = np.round(position * bench.counts / (2.0 * np.pi))
    peak = float(np.max(np.abs(torque)))
    noise = bench.noise * peak * rng.standard_normal(samples.size)
    if bench.colour:
        correlation = float(np.exp(-1.0 / (bench.rate * bench.colour)))
        white = bench.noise * peak * rng.standard_normal(samples.size)
        slow = lfilter([np.sqrt(1.0 - correlation**2)], [1.0, -correlation], white)
        noise = (noise + slow) / np.sqrt(2.0)
    if bench.memory:
        noise = bench.noise * peak * remembering(bench.memory, samples.size, rng)
    columns = {"time": samples - 0.1, "counts": counts}
    if bench.sag:  # measured m exceeds the acting torque a = m (1 - s m / peak)
        torque = torque * (1.0 + bench.sag * np.abs(torque) / peak)
    if not bench.current:
        sensed = np.interp(samples, time, torque) + noise
        if bench.maker:
            # at the drive's clock rate, noise interpolated
            fine = np.interp(time, samples, noise, left=noise[0], right=noise[-1]) + torque
            taps = butter(bench.maker, MAKER, fs=1.0 / (time[1] - time[0]))
            sensed = np.interp(samples, time, lfilter(*taps, fine))
        if bench.fault:
            turn = (
                bench.counts / (2.0 * np.pi) * (bench.joint.ratio if bench.side == "motor" else 1)
            )
            position, sensed = bench.fault(samples, counts / turn, sensed)
            columns["counts"] = turn * position
        return columns | {"torque": sensed}
    # mean over the sample about the stamp; the constant is 1 N m/A
    current = _means(torque, time, samples, bench.rate) + noise
    step = 4.0 * peak / 2**bench.current
    return columns | {"current": np.round(current / step) * step}


def remembering(memory: str, n: int, rng: np.random.Generator) -> Array:
    """Draw noise ``(n,)`` of unit variance: AR(2) with 20 samples of memory, or 1/f."""
    if memory == "ar2":
        x = lfilter([1.0], [1.0, -1.6, 0.68], rng.standard_normal(n + 500))[500:]
    else:
        f = np.fft.rfftfreq(n)
        f[0] = f[1]
        x = np.fft.irfft(np.fft.rfft(rng.standard_normal(n)) / np.sqrt(f), n)
    return np.asarray(x / np.std(x))


def as_recorded(bench: Bench, drive: Drive, path: Path) -> Recording:
    """Describe the columns of a file as a recording."""
    lag = {"lowpass": f"{MAKER} Hz", "lowpass_order": bench.maker} if bench.maker else {}
    keys: dict[str, Any] = {"torque": {"column": "torque", "unit": "N m", **lag}}
    if bench.current:
        current = {"column": "current", "unit": "A", "sampled": "average"}
        keys = {"current": {**current, "torque_constant": "1 N m/A"}}
    return Recording.from_file(
        path,
        time={"column": "time", "unit": "s"},
        position={"column": "counts", "unit": f"turn/{bench.counts}"},
        side=bench.side,
        added_mass=drive.added_mass,
        radius=drive.radius,
        **keys,
    )


PLAIN = {
    "motor.inertia": 0.05,
    "motor.viscous": 0.1,
    "motor.coulomb": 0.3,
    "load.first_moment": 0.3,
    "offset": 0.05,
}
GEARED = {
    "motor.inertia": 2e-5,
    "motor.viscous": 4e-5,
    "motor.coulomb": 6e-3,
    "load.first_moment": 0.3,
    "offset": 1e-3,
}
KNEE = dict(PRESETS["rabbit-knee"].values)
_plain = Bench(axis(), PLAIN, (Drive(3.0),))
# friction is a third of the torque, and torque noise is small compared with encoder noise
_slow = replace(_plain, drives=(Drive(1.0),), noise=0.003)
_geared = replace(
    _plain, joint=axis(ratio=50.0), values=GEARED, drives=(Drive(0.06),), counts=8192, side="motor"
)
_knee = Bench(
    PRESETS["rabbit-knee"].chain(),
    KNEE,
    (Drive(0.9, square=0.5, lag=0.005),),
    rate=1000.0,
    counts=8192,
    side="motor",
)
_late = replace(_plain, joint=replace(_plain.joint, delay=True))
CASES: dict[str, Bench] = {
    "plain": _plain,
    "slow": _slow,
    "geared": _geared,
    "plain, 100 Hz": replace(_plain, rate=100.0, duration=20.0),
    "plain, 1 kHz": replace(_plain, rate=1000.0),
    "geared, encoder at the joint": replace(_geared, counts=65536, side="joint"),
    "sticking": replace(_plain, values={**PLAIN, "motor.coulomb": 1.0}, drives=(Drive(1.25),)),
    "current": replace(_geared, current=12),
    "knee": _knee,
    "knee, loaded pair": replace(
        _knee, drives=(_knee.drives[0], Drive(1.2, 0.5, lag=0.005, added_mass=2.0, radius=0.35))
    ),
    "knee, in step": replace(_knee, noise=0.002, drives=(replace(_knee.drives[0], in_step=True),)),
    "slow, filtered once": replace(_slow, maker=1),
    "slow, filtered twice": replace(_slow, maker=2),
    "knee, filtered once": replace(_knee, maker=1),
    "knee, filtered twice": replace(_knee, maker=2),
    "late by 0.3 samples": replace(_late, late=0.3),
    "late by 2 samples": replace(_late, late=2.0),
    "ripple, 100 a turn": replace(_plain, ripple=(0.02, 100)),
    "ripple, once a turn": replace(_plain, ripple=(0.02, 1)),
    "geared, central differences": replace(
        _geared, noise=0.002, tables={"processing": {"differentiation": "central"}}
    ),
}
