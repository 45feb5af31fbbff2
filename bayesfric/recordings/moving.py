"""Which samples may be compared with a model: those that move, away from what is left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from bayesfric.recordings.arrays import Array, Flags, Segments, runs
from bayesfric.recordings.filters import lay_windows
from bayesfric.recordings.resolution import finest_step


def moving_samples(qd: Array, segments: Segments, dead_zone: float, guard: int) -> Flags:
    """Flag the samples that may be used for their speed: those not below the dead zone.

    ``guard`` samples beside a rest are not used either: the low-pass carries its torque and speed
    a little way past its ends. As many slow samples in a row are a rest, fewer a reversal.
    """
    moving = np.abs(qd) >= dead_zone
    rests = resting(qd, segments, dead_zone, guard)
    return moving if not rests.any() else moving & ~near(rests, guard)


def too_slow(limit: str = "the dead zone") -> str:
    """Say of outputs why their speed leaves them out, as :func:`moving_samples` and windows do."""
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
    """Split segments at excluded samples, so that no window touches one."""
    return tuple(part for a, b in segments for part in runs(~excluded[a:b], a))


# Outputs that are kept of one recording's rests, evenly: more say the same again.
_MOST = 200
# Differences of positions below this share of the largest are rounding.
_ROUNDING = 1e-9
# What steps may differ by.
_UNEVEN = 0.05


@dataclass(frozen=True, eq=False)
class Rest:
    """Outputs whose whole window the joint is at rest in."""

    q: Array  # (M,) rad or m of the joint
    torque: Array  # (M,) of the motor, filtered as outputs in motion are, N m or N
    stamps: Array  # (M,) s since the file's first stamp


def at_rest(position: Array, segments: Segments, least: int) -> Flags:
    """Flag samples ``(N,)`` of stretches of ``least`` or more within one step of the reading.

    That step is the finest between positions that are read twice in a row: where a recording was
    resampled, others lie between two steps. An encoder at rest may well flicker by one.
    """
    flags = np.zeros(position.size, dtype=np.bool_)
    lost = _ROUNDING * float(np.abs(position).max(initial=0.0))
    again = np.abs(np.diff(position)) <= lost
    if not again.any():
        return flags
    step = finest_step(position[1:][again]) * (1.0 + _UNEVEN) + lost
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


def rests(
    position: Array,
    torque: Array,
    time: Array,
    taps: Array,
    parts: Segments,
    factor: int,
    still: Flags,
    guard: int,
) -> Rest | None:
    """Lay windows over rests, ``guard`` samples off their ends; ``None`` where none fits.

    ``torque`` has passed what outputs in motion have passed before the windows.
    """
    inner = tuple(
        (begin + guard, end - guard)
        for a, b in parts
        for begin, end in runs(still[a:b], a)
        if end - begin > 2 * guard
    )
    laid = lay_windows(taps, inner, factor, np.ones(position.size, dtype=np.bool_))
    if laid.n_outputs == 0:
        return None
    kept = np.unique(np.linspace(0, laid.n_outputs - 1, _MOST).astype(int))
    centres = laid.centres[kept]
    return Rest(position[centres], laid.apply(torque)[kept], time[centres])
