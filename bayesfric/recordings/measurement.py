"""What was measured: one recording in SI units on a uniform time base."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesfric.recordings.inputs import Inputs


@dataclass(frozen=True, eq=False)
class Measurement:
    """What was measured in one file or table in memory.

    Parameters
    ----------
    name
        Unique among the recordings of a source.
    path
        The file; None for a table in memory.
    sha256
        Of the file, or of the bytes of the columns used; hexadecimal.
    time
        Seconds since the file's first stamp, shape (n,); it begins after 0 if a start was given.
    position
        Of the joint, rad or m, shape (n,).
    velocity
        Of the joint, rad/s or m/s, shape (n,), or None if not recorded.
    torque
        Of the motor as measured, N m or N, shape (n,).
    segments
        Half-open index ranges without gaps; together they are all n samples.
    period
        Sampling period in s, the same in every segment.
    excluded
        True where a sample must not be compared with the model, shape (n,).
    inputs
        What the joint feels besides its motion.
    steps
        One sentence for every choice made in reading.
    warnings
        One sentence for everything a user should look at.
    drive
        What the torque was measured as: torque, force, current or voltage.
    """

    name: str
    path: Path | None
    sha256: str
    time: NDArray[np.float64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64] | None
    torque: NDArray[np.float64]
    segments: tuple[tuple[int, int], ...]
    period: float
    excluded: NDArray[np.bool_]
    inputs: Inputs
    steps: tuple[str, ...]
    warnings: tuple[str, ...]
    drive: str = "torque"
