"""What was measured: one recording in SI units on a uniform time base."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bayesfric.recordings.arrays import Array, Flags, Index, Segments
from bayesfric.recordings.drive_law import Law
from bayesfric.recordings.inputs import Inputs
from bayesfric.recordings.timebase import LEAST_SAMPLES

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


@dataclass(frozen=True)
class Lag:
    """The causal low-pass that a maker applied to a signal: first order, or second, Butterworth."""

    cutoff: float  # Hz, -3 dB
    order: int  # 1 or 2


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
    # what no file tells, as a simulated replicate
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
