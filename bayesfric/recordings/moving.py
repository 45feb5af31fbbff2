"""Detection of motion and standstill: which samples may be compared with a model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from bayesfric.recordings.arrays import Array, Flags, Segments, runs
from bayesfric.recordings.filters import lay_windows
from bayesfric.recordings.resolution import finest_step


def moving_samples(qd: Array, segments: Segments, dead_zone: float, guard: int) -> Flags:
    """Flag the samples whose speed is not below the dead zone, nor near a standstill.

    The low-pass smears a standstill over ``guard`` samples past its ends. As many slow samples in a
    row are a standstill, fewer a reversal.
    """
    moving = np.abs(qd) >= dead_zone
    still = resting(qd, segments, dead_zone, guard)
    return moving if not still.any() else moving & ~near(still, guard)


def too_slow(limit: str = "the dead zone") -> str:
    """Say why outputs are left out for their speed."""
    return (
        f"at joint speeds below {limit}, as at rest or where it turns round, or filtered together "
        "with such samples"
    )


def resting(qd: Array, segments: Segments, dead_zone: float, guard: int) -> Flags:
    """Flag samples below the dead zone, ``guard`` or more in a row."""
    flags = np.zeros(len(qd), dtype=np.bool_)
    for a, b in without_excluded(segments, np.abs(qd) >= dead_zone):
        flags[a:b] = b - a >= guard
    return flags


def near(flags: Flags, reach: int) -> Flags:
    """Flag what lies no more than ``reach`` samples from a flagged one."""
    n = len(flags)
    before = np.concatenate([[0], np.cumsum(flags)])
    index = np.arange(n)
    inside = before[np.minimum(index + reach + 1, n)] - before[np.maximum(index - reach, 0)]
    return np.asarray(inside > 0)


def without_excluded(segments: Segments, excluded: Flags) -> Segments:
    """Split segments at excluded samples."""
    return tuple(part for a, b in segments for part in runs(~excluded[a:b], a))


# Outputs kept of one recording's standstills, evenly spaced: more hold no more information.
_MAX_OUTPUTS = 200
# Differences of positions below this share of the largest are rounding.
_ROUNDING = 1e-9
# Relative tolerance of an encoder step.
_UNEVEN = 0.05


@dataclass(frozen=True, eq=False)
class Rest:
    """Outputs whose whole window lies in a standstill."""

    q: Array  # (M,) rad or m of the joint
    torque: Array  # (M,) of the motor, filtered as outputs in motion are, N m or N
    stamps: Array  # (M,) s since the file's first stamp


def standstill_samples(position: Array, segments: Segments, least: int) -> Flags:
    """Flag samples ``(N,)`` of runs of ``least`` or more within one encoder step.

    The step is the finest between positions that are read twice in a row: where a recording was
    resampled, others lie between two steps. Allows ±1 count of jitter at standstill.
    """
    flags = np.zeros(position.size, dtype=np.bool_)
    rounding = _ROUNDING * float(np.abs(position).max(initial=0.0))
    repeated = np.abs(np.diff(position)) <= rounding
    if not repeated.any():
        return flags
    step = finest_step(position[1:][repeated]) * (1.0 + _UNEVEN) + rounding
    for a, b in segments:
        if b - a < least:
            continue
        part = sliding_window_view(position[a:b], least)
        begins = np.flatnonzero(part.max(axis=1) - part.min(axis=1) <= step)
        counts = np.zeros(b - a + 1, dtype=np.int64)
        np.add.at(counts, begins, 1)
        np.add.at(counts, begins + least, -1)
        flags[a:b] = np.cumsum(counts[:-1]) > 0
    return flags


def standstill_outputs(
    position: Array,
    torque: Array,
    time: Array,
    taps: Array,
    parts: Segments,
    factor: int,
    still: Flags,
    guard: int,
) -> Rest | None:
    """Lay windows over standstills, ``guard`` samples off their ends; ``None`` where none fits.

    ``torque`` is filtered as for outputs in motion.
    """
    inner = tuple(
        (begin + guard, end - guard)
        for a, b in parts
        for begin, end in runs(still[a:b], a)
        if end - begin > 2 * guard
    )
    windows = lay_windows(taps, inner, factor, np.ones(position.size, dtype=np.bool_))
    if windows.n_outputs == 0:
        return None
    chosen = np.unique(np.linspace(0, windows.n_outputs - 1, _MAX_OUTPUTS).astype(int))
    centres = windows.centres[chosen]
    return Rest(position[centres], windows.apply(torque)[chosen], time[centres])
