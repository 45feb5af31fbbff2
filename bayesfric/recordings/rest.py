"""Samples at rest: there the torque is known to lie within static friction, no more.

A joint rests where its position as read does not change, or by one step, for a while. How long
tells how slow it may creep unseen; a position that is never read the same twice cannot tell rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from bayesfric.recordings.arrays import Array, Flags, Segments, runs
from bayesfric.recordings.filters import lay_windows
from bayesfric.recordings.resolution import finest_step

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
    inner = _shrunk(still, parts, guard)
    laid = lay_windows(taps, inner, factor, np.ones(position.size, dtype=np.bool_))
    if laid.n_outputs == 0:
        return None
    kept = np.unique(np.linspace(0, laid.n_outputs - 1, _MOST).astype(int))
    centres = laid.centres[kept]
    return Rest(position[centres], laid.apply(torque)[kept], time[centres])


def _shrunk(still: Flags, parts: Segments, guard: int) -> Segments:
    """Give the stretches of rest inside parts, without ``guard`` samples at either end."""
    found = (stretch for a, b in parts for stretch in runs(still[a:b], a))
    return tuple((x + guard, y - guard) for x, y in found if y - x > 2 * guard)
