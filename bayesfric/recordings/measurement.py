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
    """A signal of a recording, looked up by time, so that any part of its samples finds it."""

    stamps: Array  # (N,) s, rising
    values: Array  # (N,)

    def at(self, time: Array) -> Array:
        """Values at some times ``(n,)``; exact at stamps, straight lines between them."""
        return np.asarray(np.interp(time, self.stamps, self.values), dtype=np.float64)


# Fields of the inputs that are signals.
_SIGNALS = ("torque_rate", "temperature", "load_torque")
# Degrees Celsius at which losses that depend on temperature are what their parameters say.
ROOM = 20.0


@dataclass(frozen=True)
class Inputs:
    """Known of one recording; travels whole from the file to the kernels."""

    added_mass: float = 0.0  # known mass bolted to the load, kg
    radius: float = 0.0  # its distance from the axis, m; a sliding load takes the mass alone
    recording: str = ""  # its name, for what each has of its own, as an offset
    # of the measured motor torque, N m/s or N/s, for a joint with an unknown delay; recordings
    # alike in the rest are alike
    torque_rate: Signal | None = field(default=None, compare=False)
    # of the joint, degrees Celsius, for a joint whose losses depend on it
    temperature: Signal | None = field(default=None, compare=False)

    # that acts on the load from outside, as measured, N m or N
    load_torque: Signal | None = field(default=None, compare=False)
    # further columns by name, which no model has
    others: Mapping[str, Signal] = field(default_factory=dict, compare=False)

    def signal(self, name: str) -> Signal | None:
        """Look up what a term may be multiplied by; a further column, if there is one, by name.

        Where no file is, as of motions that are thought of, a further column is zero.
        """
        if name in _SIGNALS:
            own: Signal | None = getattr(self, name)
            return own
        return self.others.get(name, steady(0.0))

    @property
    def known_load(self) -> bool:
        """Whether a known mass or a measured torque loads the joint."""
        return bool(self.added_mass) or self.load_torque is not None

    def load(self, motion: str) -> tuple[float, float]:
        """Inertia and first moment that the known mass brings to a load of a motion.

        They are kg m² and kg m for a ``rotary`` load, kg and 0 for a ``linear`` one.
        """
        if motion == "linear":
            return self.added_mass, 0.0
        return self.added_mass * self.radius**2, self.added_mass * self.radius


def steady(value: float) -> Signal:
    """Give a signal that never changes."""
    return Signal(np.zeros(1), np.full(1, value))


# What a joint feels at constant speed and room temperature.
AT_ROOM = Inputs(torque_rate=steady(0.0), temperature=steady(ROOM))


@dataclass(frozen=True, eq=False)
class Law:
    """The motor's torque at any motion of the joint; arrays have the shape (n,).

    ``scale clip(command - kp q - kd qd, limit) - back_emf qd``, and none where the drive is off:
    a winding without current.
    """

    command: Array  # torque, or kp times the position aimed at, in what the drive limits
    scale: Array  # motor torque for one of that
    kp: float = 0.0  # command for a position of the joint; so is the next for its speed
    kd: float = 0.0
    limit: float = np.inf  # of the command, either way
    back_emf: float = 0.0  # motor torque for a speed of the joint
    off: Flags | None = None  # where the drive gives nothing, if anywhere
    held: bool = False  # whether a command stands until the next; else it goes straight

    @property
    def follows(self) -> bool:
        """Whether the torque hangs on the motion."""
        return bool(self.kp or self.kd or self.back_emf)

    @property
    def closed(self) -> bool:
        """Whether the drive goes for a position."""
        return bool(self.kp)

    def drives(self, q: Array, qd: Array) -> Array:
        """Torque before the back-EMF, ``(n,)``."""
        aimed = self.command - self.kp * q - self.kd * qd
        return np.asarray(self.scale * np.clip(aimed, -self.limit, self.limit))

    def limited(self, q: Array, qd: Array) -> Flags:
        """Where the command is at its limit, ``(n,)``."""
        return np.asarray(np.abs(self.command - self.kp * q - self.kd * qd) >= self.limit)

    def on(self, grid: Grid) -> Law:
        """Bring it from a file's stamps onto a uniform time base."""
        return replace(self, command=grid.linear(self.command), scale=grid.linear(self.scale))

    def part(self, samples: Index | slice) -> Law:
        """Give that of some of the samples."""
        off = None if self.off is None else self.off[samples]
        return replace(self, command=self.command[samples], scale=self.scale[samples], off=off)


# Stretches of a recording that an excerpt is made of, at most, and the samples of one, at least.
_STRETCHES, _STRETCH = 8, 1000
# How a torque goes between its samples.
Hold = Literal["zero", "linear", "cubic"]


def stretches(count: int, most: int) -> Segments:
    """Spread up to eight stretches evenly over ``count`` samples, ``most`` of them in all."""
    many = min(_STRETCHES, max(1, most // _STRETCH))
    length = most // many
    begins = np.linspace(0, count - length, many).astype(np.int64).tolist()
    return tuple((begin, begin + length) for begin in begins)


@dataclass(frozen=True, eq=False)
class Measurement:
    """What was measured in one file or table in memory; arrays have the shape (n,)."""

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
    inputs: Inputs  # what the joint feels besides its motion
    steps: tuple[str, ...]  # one sentence for every choice made in reading
    warnings: tuple[str, ...]  # one sentence for everything a user should look at
    # (n,) what the motor's speed has taken off a torque computed from a voltage, N m or N; None
    # where it was not
    back_emf: Array | None = None
    # (n,) what position and speed take off the command of a torque that is computed from a
    # target, in the command's unit; None where the torque was measured
    feedback: Array | None = None
    # whether the torque is a command that the drive holds until the next sample, or else was
    # measured behind a loop that gets its commands at the samples; None where nobody says
    held: bool | None = None
    torque_lag: Lag | None = None  # that torque and velocity passed before they were recorded
    velocity_lag: Lag | None = None
    ratio: float = 1.0  # of the gear, motor motion per joint motion
    motion: Literal["rotary", "linear"] = "rotary"  # of the joint
    torque_constant: float | None = None  # N m/A or N/A, where a current was measured
    # Hz beyond which an acceleration is not what the joint's is, where a model has told
    widest_band: float | None = None
    # s by which the position comes after the torque, where a model has told: so much is cut off
    # both ends, where torque of then is not known
    late: float = 0.0
    # how the drive makes its torque, in the closed loop where a target was recorded; None for
    # what no file tells, as a simulated twin
    law: Law | None = None

    def part(self, samples: Index | slice, segments: Segments) -> Measurement:
        """Cut out samples, which make up ``segments`` then."""
        law, names = (
            self.law,
            ("time", "position", "velocity", "torque", "back_emf", "excluded", "feedback"),
        )
        arrays = {name: getattr(self, name) for name in names}
        cut: dict[str, Any] = {
            name: None if x is None else x[samples] for name, x in arrays.items()
        }
        return replace(
            self, segments=segments, law=None if law is None else law.part(samples), **cut
        )

    def excerpt(self, most: int) -> Measurement:
        """Cut out so many samples at most, in up to eight stretches all over the recording.

        Stumps of segments go, as in reading. The same where there are no more samples.
        """
        if self.time.size <= most:
            return self
        cut = [
            np.arange(max(a, begin), min(b, end))
            for begin, end in stretches(self.time.size, most)
            for a, b in self.segments
            if a < end and b > begin
        ]
        kept = [part for part in cut if part.size >= LEAST_SAMPLES] or cut
        ends = np.cumsum([0, *(part.size for part in kept)]).tolist()
        return self.part(np.concatenate(kept), tuple(pairwise(ends)))

    @property
    def hold(self) -> Hold:
        """How the torque goes between samples in what simulates."""
        return "zero" if self.held else "linear"

    @property
    def nominal_back_emf(self) -> float:
        """``kt²/R`` as given, N m s or N s/m at the motor; 0 of no torque from a voltage."""
        return 0.0 if self.law is None else self.law.back_emf / self.ratio
