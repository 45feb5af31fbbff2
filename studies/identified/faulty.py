"""Simulate recordings of a servo that swings a pendulum, each with one fault of its input.

The servo follows its targets by ``kp (target - position) - kd speed``. Its motion is integrated
with at least ten steps a sample and recorded as in users' files: position in counts, torque or
current with noise of 1 %, and a configuration that ignores the fault.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from bayesfric.base.errors import BadInput
from bayesfric.fit.model import Model
from bayesfric.mechanism.closed_loop import follow
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import Joint
from bayesfric.problem.config import parse_config
from bayesfric.recordings.measurement import Law

Array = NDArray[np.float64]

PENDULUM = Joint(
    elements=(Element("motor", coulomb="symmetric", viscous=True),),
    load=Load(inertia=True, first_moment=True),
)
# kg m2, N m s, N m, kg m
TYPICAL = {
    "motor.viscous": 0.05,
    "motor.coulomb": 0.08,
    "load.inertia": 0.025,
    "load.first_moment": 0.14,
}
SPREAD = 0.3  # relative variation of parameters between recordings
NOISE = 0.01  # sd of a torque sample over the largest torque
STEP = 2e-4  # s, largest step of the simulation
BEFORE = 2.0  # s of motion before the recording begins
# Frequencies (Hz) and amplitudes (rad) of the path.
PATH = ((0.23, 0.8), (0.57, 0.45), (1.1, 0.25), (1.9, 0.12))
CONFIGURATION = """\
[mechanism]
elements.motor = {{ coulomb = "symmetric", viscous = true }}
load = {{ inertia = true, first_moment = true }}

[[recordings]]
file = "recording.csv"
time = {{ column = "time", unit = "s" }}
position = {{ column = "position", unit = "{unit}" }}
{drive}
"""
TORQUE = 'torque = { column = "torque", unit = "N m" }'


@dataclass(frozen=True)
class Faulty:
    """A recording with its true parameters and its fault."""

    configuration: str  # TOML, without knowledge of the fault
    columns: dict[str, Array]  # of its file, (N,) each
    truth: dict[str, float]  # by parameter, SI
    fault: str = ""  # variant of the fault; empty if its kind has only one
    size: float = 0.0  # in the unit of KINDS

    def model(self, folder: Path) -> Model:
        """Write the file and read it as ``bayesfric fit`` does."""
        table = np.stack(list(self.columns.values()), axis=1)
        header = ",".join(self.columns)
        path = folder / "recording.csv"
        np.savetxt(path, table, fmt="%.9g", delimiter=",", header=header, comments="")
        return Model.from_config(parse_config(self.configuration, folder / "recording.toml"))


@dataclass(frozen=True)
class Servo:
    """A servo, its controller and its sampling."""

    truth: dict[str, float]
    rate: float  # Hz
    duration: float  # s
    counts: int  # a turn
    kp: float  # N m/rad
    kd: float  # N m s/rad

    @classmethod
    def draw(cls, rng: np.random.Generator, *, rates: tuple[float, float] = (50.0, 250.0)) -> Servo:
        """Draw a servo: gains over a decade, damping ratios of 0.2 to 0.7."""
        factors = rng.uniform(1.0 - SPREAD, 1.0 + SPREAD, len(TYPICAL))
        truth = {k: v * f for (k, v), f in zip(TYPICAL.items(), factors.tolist(), strict=True)}
        kp = _log_uniform(rng, 5.0, 50.0)
        damping = float(rng.uniform(0.2, 0.7))
        return cls(
            truth,
            rate=round(_log_uniform(rng, *rates), 1),
            duration=float(rng.uniform(12.0, 24.0)),
            counts=int(2 ** rng.integers(12, 17)),
            kp=kp,
            kd=2.0 * damping * float(np.sqrt(kp * truth["load.inertia"])),
        )


@dataclass(frozen=True)
class Motion:
    """Motion of the servo at the samples, ``(N,)`` each."""

    time: Array
    target: Array
    position: Array
    speed: Array
    torque: Array  # of the motor


def moved(
    servo: Servo,
    rng: np.random.Generator,
    *,
    late: float = 0.0,
    held: bool = False,
    disturbed: bool = False,
) -> Motion:
    """Simulate the servo.

    A target acts ``late`` samples after its stamp, ``held`` for a sample or continuously.
    ``disturbed`` adds noise of 1 % to the acting torque; a measured torque has sensor noise.
    """
    period = 1.0 / servo.rate
    steps = max(10, int(np.ceil(period / STEP)))
    before = int(np.ceil(BEFORE * servo.rate))
    samples = before + int(servo.duration * servo.rate)
    phases = rng.uniform(0.0, 2.0 * np.pi, len(PATH))
    fine = np.arange(samples * steps) / steps  # in samples
    instants = np.floor(fine - late + 1e-9) if held else fine - late

    def path(time: Array) -> Array:
        waves = zip(PATH, phases.tolist(), strict=True)
        return np.sum([a * np.sin(2.0 * np.pi * f * time + p) for (f, a), p in waves], axis=0)

    stamps = np.arange(samples) / servo.rate
    target, applied = path(stamps), path(instants / servo.rate)
    vector = np.array([[servo.truth[name] for name in PENDULUM.names]])
    law = Law(servo.kp * applied, np.ones(applied.size), servo.kp, servo.kd, held=held)
    ends = [[0, applied.size]], [applied[0]], [0.0]
    noise = rng.standard_normal(samples)  # always drawn, so that other draws do not depend on it

    def solve(push: Array | None) -> tuple[Array, Array, Array]:
        q, qd = follow(PENDULUM, vector, law, period / steps, *ends, push=push)
        rows = [x[0, ::steps][before:] for x in (q, qd)]
        return *rows, servo.kp * (applied[::steps][before:] - rows[0]) - servo.kd * rows[1]

    q, qd, torque = solve(None)
    if disturbed:
        push = NOISE * float(np.max(np.abs(torque))) * noise
        q, qd, torque = solve(np.interp(fine, np.arange(samples), push)[None])
    return Motion(stamps[before:] - stamps[before], target[before:], q, qd, torque)


def encoder(servo: Servo, position: Array) -> Array:
    """Convert a position to counts, ``(N,)``."""
    return np.round(position * servo.counts / (2.0 * np.pi))


def noisy(signal: Array, rng: np.random.Generator) -> Array:
    """Add white noise of 1 % of the largest value, ``(N,)``."""
    return signal + NOISE * float(np.max(np.abs(signal))) * rng.standard_normal(signal.size)


def late_target(rng: np.random.Generator, *, fault: bool = True) -> Faulty:
    """Record targets that act 0 to 4 samples after their stamps."""
    servo, late = Servo.draw(rng), float(rng.uniform(0.0, 4.0))
    motion = moved(servo, rng, late=late if fault else 0.0, held=fault, disturbed=True)
    columns = _counted(servo, motion) | {"target": motion.target}
    # a held target is half a sample late relative to its interpolation
    delay = (late + 0.5) / servo.rate if fault else 0.0
    truth = servo.truth | {"target.delay": delay}
    return Faulty(_towards_target(servo), columns, truth, size=late)


def current_column(rng: np.random.Generator, *, fault: bool = True) -> Faulty:
    """Record another current than the winding's: the supply's, or one with a wrong sign."""
    servo = Servo.draw(rng)
    which = ("supply", "signed by power", "absolute")[int(rng.integers(3))]
    constant, resistance = float(rng.uniform(0.4, 1.2)), float(rng.uniform(2.0, 6.0))
    motion = moved(servo, rng)
    current = motion.torque / constant
    volts = resistance * current + constant * motion.speed
    duty = volts / (1.1 * float(np.max(np.abs(volts))))
    wrong = {
        "supply": current * np.abs(duty),
        "signed by power": current * np.sign(motion.speed),
        "absolute": np.abs(current),
    }
    recorded = noisy(wrong[which] if fault else current, rng)
    columns = _counted(servo, motion) | {"current": recorded}
    # torque constant of the data sheet
    drive = f'current = {{ column = "current", unit = "A", torque_constant = "{constant} N m/A" }}'
    return Faulty(_configuration(servo, drive), columns, servo.truth, which)


def smoothed(rng: np.random.Generator, *, fault: bool = True) -> Faulty:
    """Record signals after a zero-phase low-pass at 1 to 20 Hz."""
    servo = Servo.draw(rng)
    which = ("target", "torque")[int(rng.integers(2))]
    hertz = _log_uniform(rng, 1.0, 20.0)
    of_target = which == "target"
    motion = moved(servo, rng, disturbed=of_target)
    drive = motion.target if of_target else noisy(motion.torque, rng)
    position = encoder(servo, motion.position) * 2.0 * np.pi / servo.counts
    columns = {"time": motion.time, "position": position, which: drive}
    if fault:
        filter_ = butter(4, hertz, fs=servo.rate, output="sos")
        columns |= {name: sosfiltfilt(filter_, columns[name]) for name in ("position", which)}
    text = _towards_target(servo, "rad") if of_target else _configuration(servo, TORQUE, "rad")
    return Faulty(text, columns, servo.truth, which, hertz)


def wrong_prior(rng: np.random.Generator, *, fault: bool = True) -> Faulty:
    """Specify a prior whose nearest value is 1 to 10 of its sds from the truth."""
    servo = Servo.draw(rng)
    name = list(TYPICAL)[int(rng.integers(len(TYPICAL)))]
    which = ("range", "normal")[int(rng.integers(2))]
    sds, true = float(rng.uniform(1.0, 10.0)), servo.truth[name]
    # bound or centre of the prior, on either side of the truth
    near = true * float(rng.uniform(1.2, 3.0)) ** float(rng.choice([-1.0, 1.0]))
    sd = abs(near - true) / sds
    if which == "normal":
        prior = f'{{ distribution = "norm", loc = {near}, scale = {sd} }}'
    else:
        far = near + np.sign(near - true) * np.sqrt(12.0) * sd
        prior = f"[{min(near, max(far, 0.0))}, {max(near, far)}]"
    columns = _torque_columns(servo, moved(servo, rng), rng)
    priors = f'\n[priors]\n"{name}" = {prior}\n' if fault else ""
    text = _configuration(servo, TORQUE) + priors
    return Faulty(text, columns, servo.truth, f"{which} of {name}", sds)


def swinging_current(rng: np.random.Generator, *, fault: bool = True) -> Faulty:
    """Record a current that varies with the motor's angle by 3 to 15 %."""
    servo, size = Servo.draw(rng), float(rng.uniform(0.03, 0.15))
    cycles, phase = int(rng.integers(1, 15)), float(rng.uniform(0.0, 2.0 * np.pi))
    motion = moved(servo, rng)
    swing = size * np.sin(cycles * motion.position + phase) if fault else 0.0
    columns = _counted(servo, motion) | {"current": noisy(motion.torque * (1.0 + swing), rng)}
    drive = 'current = { column = "current", unit = "A", torque_constant = "1 N m/A" }'
    text = _configuration(servo, drive)
    return Faulty(text, columns, servo.truth, f"{cycles} a turn", size)


def short_recording(rng: np.random.Generator, *, fault: bool = True) -> Faulty:
    """Record a right model so briefly that filters leave 10 to 60 outputs."""
    for _ in range(200):
        servo = Servo.draw(rng, rates=(20.0, 150.0))
        duration = float(rng.uniform(0.5, 4.0)) if fault else servo.duration
        short = Servo(**vars(servo) | {"duration": duration})
        columns = _torque_columns(short, moved(short, rng), rng)
        faulty = Faulty(_configuration(short, TORQUE), columns, short.truth, size=duration)
        if not fault:
            return faulty
        with TemporaryDirectory() as folder:
            try:
                observations = faulty.model(Path(folder)).observations
            except BadInput:  # too short
                continue
        if 10 <= sum(o.measured.size for o in observations) <= 60:
            return faulty
    raise RuntimeError("no recording left 10 to 60 outputs")


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _counted(servo: Servo, motion: Motion) -> dict[str, Array]:
    return {"time": motion.time, "position": encoder(servo, motion.position)}


def _torque_columns(servo: Servo, motion: Motion, rng: np.random.Generator) -> dict[str, Array]:
    return _counted(servo, motion) | {"torque": noisy(motion.torque, rng)}


def _configuration(servo: Servo, drive: str, unit: str = "") -> str:
    return CONFIGURATION.format(unit=unit or f"turn/{servo.counts}", drive=drive)


def _towards_target(servo: Servo, unit: str = "") -> str:
    drive = (
        'target = { column = "target", unit = "rad", '
        f'kp = "{servo.kp} N m/rad", kd = "{servo.kd} N m s/rad" }}'
    )
    return _configuration(servo, drive, unit)


@dataclass(frozen=True)
class Kind:
    """A kind of fault: its simulation, the unit of its size, and the messages that name it."""

    record: Callable[..., Faulty]
    unit: str
    causes: frozenset[str]


# Causes are kinds of findings, doubts and notes, keys of bayesfric/report/words.toml.
KINDS: dict[str, Kind] = {
    "late target": Kind(late_target, "samples", frozenset({"target_delay"})),
    "current column": Kind(
        current_column,
        "",
        frozenset({"current_column"}),
    ),
    "smoothed": Kind(smoothed, "Hz", frozenset({"smoothed"})),
    "prior": Kind(wrong_prior, "prior sds", frozenset({"prior"})),
    "swing": Kind(
        swinging_current,
        "of the current",
        frozenset({"torque_constant_by_angle"}),
    ),
    "short": Kind(short_recording, "s", frozenset({"few"})),
}


def recording(kind: str, seed: int, number: int, *, fault: bool = True) -> Faulty:
    """Simulate a recording of a kind; without its ``fault``, of the same joint and motion."""
    rng = np.random.default_rng([seed, *kind.encode(), number])
    return KINDS[kind].record(rng, fault=fault)
