"""One recording in SI units on a uniform time base, and how its drive makes the torque."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.recordings.arrays import Array, Flags, Segments

# Shorter segments between gaps are left out.
LEAST_SAMPLES = 50
# Reference temperature of losses that depend on it, degrees Celsius.
ROOM = 20.0
# Interpolation of a torque between its samples.
Hold = Literal["zero", "linear"]

# The causal low-pass that a signal passed before it was recorded: cut-off in Hz, -3 dB, and order,
# 1 or, Butterworth, 2.
Lag = tuple[float, int]

# --- time base ----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Grid:
    """A uniform time base in s made from time stamps."""

    stamps: Array  # (n,)
    pieces: Segments  # used ranges of stamps
    time: Array  # (m,) of the grid
    segments: Segments  # ranges of time, one a piece
    period: float
    resampled: bool
    steps: tuple[str, ...]  # a sentence for every choice made
    warnings: tuple[str, ...]

    def bring(self, values: Array, how: Callable[[Array, Array, Array], Array]) -> Array:
        """Interpolate a signal ``(n,)`` on the grid ``(m,)``."""
        pairs = zip(self.pieces, self.segments, strict=True)
        parts = [
            how(self.time[c:d], self.stamps[a:b], values[a:b]) if self.resampled else values[a:b]
            for (a, b), (c, d) in pairs
        ]
        return np.concatenate(parts)

    def linear(self, values: Array) -> Array:
        """Interpolate linearly."""
        return self.bring(values, np.interp)


def make_grid(
    time: Array, chosen: tuple[int, int], where: str, *, gap: float = 5.0, most_jitter: float = 0.01
) -> Grid:
    """Put a uniform grid over the segments without gaps of increasing stamps (n,).

    Only over the range ``chosen``. A gap is a step of more than ``gap`` median ones; steps that
    jitter by more than 1 % rms are resampled to their median.
    """
    (first, last), warnings = chosen, list[str]()
    count = last - first
    if count < LEAST_SAMPLES:
        problem = f"has {count} samples, fewer than {LEAST_SAMPLES}"
        raise BadInput(where, problem, "record longer, or check start and stop")
    intervals = np.diff(time[first:last])
    median = float(np.median(intervals))
    borders = first + 1 + np.flatnonzero(intervals > gap * median)
    ranges = list(pairwise([first, *borders.tolist(), last]))
    pieces = tuple((a, b) for a, b in ranges if b - a >= LEAST_SAMPLES)
    if not pieces:
        longest = max(b - a for a, b in ranges)
        problem = f"time gaps leave {len(ranges)} segments of at most {longest} samples"
        raise BadInput(where, problem, f"record {LEAST_SAMPLES} without gaps")
    inside = np.concatenate([np.diff(time[a:b]) for a, b in pieces])
    period = float(np.mean(inside))
    jitter = float(np.sqrt(np.mean((inside - period) ** 2)) / period)
    times, resampled = [time[a:b] for a, b in pieces], jitter > most_jitter
    how = f"regular every {1e3 * period:.4g} ms"
    if resampled:
        period = median
        # a last stamp that lies on the grid but for rounding stays
        counts = [int(np.floor(np.ptp(x) / period + 1e-9)) + 1 for x in times]
        pairs = zip(times, counts, strict=True)
        times = [np.minimum(x[0] + period * np.arange(n), x[-1]) for x, n in pairs]
        how = f"irregular, resampled linearly (position: PCHIP) to {1e3 * period:.3g} ms"
    steps = [f"time: {count} samples, {how} (jitter {100 * jitter:.2g} %)"]
    if len(ranges) > 1:
        steps.insert(0, f"time: gaps split the recording into {len(ranges)} segments")
    if short := len(ranges) - len(pieces):
        lost = count - sum(b - a for a, b in pieces)
        warnings.append(f"time: {short} short segments ({lost} samples in all) left out")
    span = float(time[last - 1] - time[first])
    if implausible(period, span):
        text = f"time: {count} samples in {span:.3g} s, one every {period:.3g} s, are of no joint's"
        warnings.append(f"{text} motion; is the unit of time right?")
    segments = tuple(pairwise(np.cumsum([0, *map(len, times)]).tolist()))
    sentences = tuple(steps), tuple(warnings)
    return Grid(time, pieces, np.concatenate(times), segments, period, resampled, *sentences)


def implausible(period: float, span: float) -> bool:
    """Whether no joint is recorded so fast, so slowly, or for so short or long a time, in s."""
    return not (2e-5 <= period <= 0.2 and 0.1 <= span <= 86400.0)


def steady_grid(count: int) -> Grid:
    """Make a grid of points at constant speeds, each a segment of its own, by their number."""
    number = np.arange(count, dtype=np.float64)
    segments = tuple((k, k + 1) for k in range(count))
    step = f"time: none; {count} points at constant speed, without an acceleration"
    return Grid(number, segments, number, segments, 1.0, False, (step,), ())


def spread_ranges(
    count: int, limit: int, *, max_parts: int = 8, least_samples: int = 1000
) -> Segments:
    """Spread ranges evenly over ``count`` samples, ``limit`` of them in all."""
    parts = min(max_parts, max(1, limit // least_samples))
    length = limit // parts
    begins = np.linspace(0, count - length, parts).astype(np.int64).tolist()
    return tuple((begin, begin + length) for begin in begins)


# --- signals ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Signal:
    """A signal of a recording, looked up by time."""

    stamps: Array  # (N,) s, rising
    values: Array  # (N,)

    def at(self, time: Array) -> Array:
        """Interpolate linearly at times ``(n,)``."""
        return np.asarray(np.interp(time, self.stamps, self.values), dtype=np.float64)


def steady(value: float) -> Signal:
    """Make a constant signal."""
    return Signal(np.zeros(1), np.full(1, value))


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
        if name in ("torque_rate", "temperature", "load_torque"):
            signal: Signal | None = getattr(self, name)
            return signal
        return self.others.get(name, steady(0.0))

    def inertia_of(self, name: str) -> Signal | None:
        """Look up the column ``NAME inertia``; NAME's torque holds it times ``ACCELERATION``."""
        return self.others.get(f"{name} inertia")

    def each(self, change: Callable[[Signal], Signal]) -> Inputs:
        """Change every recorded signal."""
        measured = {key: getattr(self, key) for key in ("temperature", "load_torque")}
        changed: dict[str, Any] = {
            key: change(signal) for key, signal in measured.items() if signal is not None
        }
        others = {name: change(signal) for name, signal in self.others.items()}
        return replace(self, others=others, **changed)

    @property
    def known_load(self) -> bool:
        """Whether a known mass or a measured torque loads the joint."""
        return bool(self.added_mass) or self.load_torque is not None

    def load(self, motion: str) -> tuple[float, float]:
        """Inertia and first moment of the known mass: kg m², kg m (``linear``: kg, 0)."""
        if motion == "linear":
            return self.added_mass, 0.0
        return self.added_mass * self.radius**2, self.added_mass * self.radius


# Further column of the acceleration along which torques of other columns were computed.
ACCELERATION = "acceleration"
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
    # whether a command is held until the next, else linear; None of a target where nobody knows
    held: bool | None = False
    # ranges of gains that are not known, of kp and in addition to kd, as kp and kd; kp is its upper
    # end, or 1 where it is any
    unknown: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    # period at which the drive closes its loop, and lag of the speed that it uses, s
    loop: float | None = None
    velocity_filter: float | None = None

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

    def each(self, change: Callable[[Array], Array]) -> Law:
        """Change all arrays but flags."""
        return replace(self, command=change(self.command), scale=change(self.scale))


def integral(rate: Array, segments: Segments, period: float, speed: Array | None = None) -> Array:
    """Integrate a signal ``(n,)`` from 0 in every segment; it jumps where the speed is 0."""
    share, out = np.full(rate.size - 1, 0.5), np.zeros_like(rate)
    if speed is not None:
        before, after = speed[:-1], speed[1:]
        turns = before * after < 0.0
        share[turns] = before[turns] / (before[turns] - after[turns])
    steps = period * (share * rate[:-1] + (1.0 - share) * rate[1:])
    for a, b in segments:
        out[a + 1 : b] = np.cumsum(steps[a : b - 1])
    return out


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
    held: bool = False  # whether torque is a command held until the next sample
    torque_lag: Lag | None = None
    velocity_lag: Lag | None = None
    ratio: float = 1.0  # of the gear, motor motion per joint motion
    motion: Literal["rotary", "linear"] = "rotary"  # of the joint
    torque_constant: float | None = None  # N m/A or N/A, where a current was measured
    widest_band: float | None = None  # Hz, of a usable acceleration, where a model determines it
    pace: float | None = None  # Hz, of its slowest signal, where rows hold it or lie between
    late: float = 0.0  # delay of the position, s, where a model determines it; trimmed at both ends
    law: Law | None = None  # of the drive; None for a simulated replicate
    integrated: bool = False  # whether the position is the integral of the velocity
    steady: bool = False  # whether every sample is a segment of its own, at constant speed
    lacking: tuple[str, str] = ("", "")  # what is excluded, and what to do where that is too much

    def each(
        self, change: Callable[[Array], Array], of_flags: Callable[[Flags], Flags] | None = None
    ) -> Measurement:
        """Change all arrays of samples, flags by a function of their own."""
        of_flags = of_flags or cast("Callable[[Flags], Flags]", change)
        names = ("time", "position", "velocity", "torque", "back_emf", "feedback")
        arrays: dict[str, Any] = {name: getattr(self, name) for name in names}
        arrays = {name: change(x) for name, x in arrays.items() if x is not None}
        law = self.law and self.law.each(change)
        if law and law.off is not None:
            law = replace(law, off=of_flags(law.off))
        return replace(self, law=law, excluded=of_flags(self.excluded), **arrays)

    def within(self, ranges: Segments) -> Measurement:
        """Select ranges of samples; too short segments go, as in reading."""
        cut = [
            np.arange(max(a, begin), min(b, end))
            for begin, end in ranges
            for a, b in self.segments
            if a < end and b > begin
        ]
        parts = [part for part in cut if part.size >= LEAST_SAMPLES] or cut
        ends, samples = np.cumsum([0, *map(len, parts)]).tolist(), np.concatenate(parts)
        return replace(self.each(lambda x: x[samples]), segments=tuple(pairwise(ends)))

    def excerpt(self, limit: int) -> Measurement:
        """Select at most so many samples, in up to eight ranges all over the recording."""
        count = self.time.size
        return self if count <= limit else self.within(spread_ranges(count, limit))

    @property
    def hold(self) -> Hold:
        """Interpolation of the torque in a simulation."""
        return "zero" if self.held else "linear"

    @property
    def nominal_back_emf(self) -> float:
        """``kt²/R`` as given, N m s or N s/m at the motor; 0 without a voltage."""
        return 0.0 if self.law is None else self.law.back_emf / self.ratio
