"""One recording in SI units on a uniform time base, and how its drive makes the torque."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bayesfric.recordings.arrays import Array, Flags, Index, Segments
from bayesfric.recordings.filters import Lag
from bayesfric.recordings.timebase import LEAST_SAMPLES, Grid


@dataclass(frozen=True, eq=False)
class Signal:
    """A signal of a recording, looked up by time."""

    stamps: Array  # (N,) s, rising
    values: Array  # (N,)

    def at(self, time: Array) -> Array:
        """Interpolate linearly at times ``(n,)``."""
        return np.asarray(np.interp(time, self.stamps, self.values), dtype=np.float64)


# Fields of the inputs that are signals.
_SIGNALS = ("torque_rate", "temperature", "load_torque")
# Reference temperature of losses that depend on it, degrees Celsius.
ROOM = 20.0


@dataclass(frozen=True)
class Inputs:
    """Known inputs of one recording in addition to its motion."""

    added_mass: float = 0.0  # known mass bolted to the load, kg
    radius: float = 0.0  # its distance from the axis, m; a sliding load takes the mass alone
    recording: str = ""  # its name, for separate offsets
    # of the motor torque, N m/s or N/s, for an unknown delay; not compared, as the other signals
    torque_rate: Signal | None = field(default=None, compare=False)
    temperature: Signal | None = field(default=None, compare=False)  # of the joint, degC
    load_torque: Signal | None = field(default=None, compare=False)  # external, N m or N
    others: Mapping[str, Signal] = field(default_factory=dict, compare=False)

    def signal(self, name: str) -> Signal | None:
        """Look up a signal or a further column by name; one that does not exist is zero."""
        if name in _SIGNALS:
            signal: Signal | None = getattr(self, name)
            return signal
        return self.others.get(name, steady(0.0))

    @property
    def known_load(self) -> bool:
        """Whether a known mass or a measured torque loads the joint."""
        return bool(self.added_mass) or self.load_torque is not None

    def load(self, motion: str) -> tuple[float, float]:
        """Inertia and first moment of the known mass: kg m², kg m (``linear``: kg, 0)."""
        if motion == "linear":
            return self.added_mass, 0.0
        return self.added_mass * self.radius**2, self.added_mass * self.radius


def steady(value: float) -> Signal:
    """Make a constant signal."""
    return Signal(np.zeros(1), np.full(1, value))


# Inputs at constant speed and room temperature.
AT_ROOM = Inputs(torque_rate=steady(0.0), temperature=steady(ROOM))


@dataclass(frozen=True, eq=False)
class Law:
    """The motor's torque at any motion of the joint; arrays have the shape (n,).

    ``scale clip(command - kp q - kd qd, limit) - back_emf qd``, and 0 where the drive is off.
    """

    command: Array  # torque, or kp times the target position, in the unit that the drive limits
    scale: Array  # motor torque per command
    kp: float = 0.0  # command per position of the joint; kd per speed
    kd: float = 0.0
    limit: float = np.inf  # of the command, either way
    back_emf: float = 0.0  # motor torque for a speed of the joint
    off: Flags | None = None  # where the drive is off, if known
    held: bool = False  # whether a command is held until the next; else linear

    @property
    def follows(self) -> bool:
        """Whether the torque depends on the motion."""
        return bool(self.kp or self.kd or self.back_emf)

    @property
    def closed(self) -> bool:
        """Whether the drive controls the position."""
        return bool(self.kp)

    def drives(self, q: Array, qd: Array) -> Array:
        """Torque before the back-EMF, ``(n,)``."""
        command = self.command - self.kp * q - self.kd * qd
        return np.asarray(self.scale * np.clip(command, -self.limit, self.limit))

    def limited(self, q: Array, qd: Array) -> Flags:
        """Where the command is at its limit, ``(n,)``."""
        return np.asarray(np.abs(self.command - self.kp * q - self.kd * qd) >= self.limit)

    def on(self, grid: Grid) -> Law:
        """Interpolate from a file's stamps onto a uniform time base."""
        return replace(self, command=grid.linear(self.command), scale=grid.linear(self.scale))

    def part(self, samples: Index | slice) -> Law:
        """Select samples."""
        off = None if self.off is None else self.off[samples]
        return replace(self, command=self.command[samples], scale=self.scale[samples], off=off)


# Most parts of a subsample of a recording, and least samples of one.
_MAX_PARTS, _PART = 8, 1000
# Interpolation of a torque between its samples.
Hold = Literal["zero", "linear", "cubic"]


def spread_ranges(count: int, limit: int) -> Segments:
    """Spread up to eight ranges evenly over ``count`` samples, ``limit`` of them in all."""
    parts = min(_MAX_PARTS, max(1, limit // _PART))
    length = limit // parts
    begins = np.linspace(0, count - length, parts).astype(np.int64).tolist()
    return tuple((begin, begin + length) for begin in begins)


@dataclass(frozen=True, eq=False)
class Measurement:
    """One recorded file or table in memory in SI units; arrays have the shape (n,)."""

    name: str  # unique among the recordings of a source
    path: Path | None  # None for a table in memory
    sha256: str  # of the file, or of the bytes of the columns used; hexadecimal
    time: Array  # s since the file's first stamp; it begins after 0 if a start was given
    position: Array  # of the joint, rad or m
    velocity: Array | None  # of the joint, rad/s or m/s; None if not recorded
    torque: Array  # of the motor as measured, N m or N
    segments: Segments  # without gaps; together they are all n samples
    period: float  # s, the same in every segment
    excluded: Flags  # true where a sample must not be compared with the model
    inputs: Inputs
    steps: tuple[str, ...]  # a sentence for every choice made in reading
    warnings: tuple[str, ...]
    back_emf: Array | None = None  # (n,) subtracted from a torque from a voltage, N m or N
    # (n,) subtracted from the command of a position target, in its unit
    feedback: Array | None = None
    # torque is a command held until the next sample, or else measured behind a loop that gets its
    # commands at the samples; None where neither is known
    held: bool | None = None
    torque_lag: Lag | None = None  # low-pass before recording
    velocity_lag: Lag | None = None
    ratio: float = 1.0  # of the gear, motor motion per joint motion
    motion: Literal["rotary", "linear"] = "rotary"  # of the joint
    torque_constant: float | None = None  # N m/A or N/A, where a current was measured
    widest_band: float | None = None  # Hz, of a usable acceleration, where a model determines it
    late: float = 0.0  # delay of the position, s, where a model determines it; trimmed at both ends
    law: Law | None = None  # of the drive; None for a simulated replicate

    def part(self, samples: Index | slice, segments: Segments) -> Measurement:
        """Select samples, which then make up ``segments``."""
        names = ("time", "position", "velocity", "torque", "back_emf", "excluded", "feedback")
        arrays: dict[str, Any] = {
            name: None if (x := getattr(self, name)) is None else x[samples] for name in names
        }
        law = None if self.law is None else self.law.part(samples)
        return replace(self, segments=segments, law=law, **arrays)

    def excerpt(self, limit: int) -> Measurement:
        """Select at most so many samples, in up to eight ranges all over the recording.

        Too short segments go, as in reading.
        """
        if self.time.size <= limit:
            return self
        cut = [
            np.arange(max(a, begin), min(b, end))
            for begin, end in spread_ranges(self.time.size, limit)
            for a, b in self.segments
            if a < end and b > begin
        ]
        parts = [part for part in cut if part.size >= LEAST_SAMPLES] or cut
        ends = np.cumsum([0, *(part.size for part in parts)]).tolist()
        return self.part(np.concatenate(parts), tuple(pairwise(ends)))

    @property
    def hold(self) -> Hold:
        """Interpolation of the torque in a simulation."""
        return "zero" if self.held else "linear"

    @property
    def nominal_back_emf(self) -> float:
        """``kt²/R`` as given, N m s or N s/m at the motor; 0 without a voltage."""
        return 0.0 if self.law is None else self.law.back_emf / self.ratio
