"""Time stamps: their order, their gaps, and a uniform grid over them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.recordings.arrays import Array, Segments

_SLOWEST = 1.0
_FASTEST = 1e-6
# possible sampling periods, whose squares stay in floating point
_POSSIBLE = (1e-12, 1e9)
# A step longer than so many median ones separates segments, of which shorter ones are left out.
_GAP = 5.0
LEAST_SAMPLES = 50
# Relative rms jitter of the steps above which a recording is resampled.
_JITTER = 0.01


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

    def linear(self, values: Array) -> Array:
        """Interpolate a signal ``(n,)`` linearly on the grid ``(m,)``."""
        return self._bring(values, np.interp)

    def smooth(self, values: Array) -> Array:
        """Interpolate by PCHIP, which keeps the slope continuous."""
        from scipy.interpolate import pchip_interpolate

        return self._bring(values, lambda x, xp, fp: np.asarray(pchip_interpolate(xp, fp, x)))

    def _bring(self, values: Array, interpolate: Callable[[Array, Array, Array], Array]) -> Array:
        parts = [values[a:b] for a, b in self.pieces]
        if self.resampled:
            parts = [
                interpolate(self.time[lo:hi], self.stamps[a:b], part)
                for part, (a, b), (lo, hi) in zip(parts, self.pieces, self.segments, strict=True)
            ]
        return np.concatenate(parts)


def check_order(time: Array, where: str, row: Callable[[int], str]) -> None:
    """Refuse time stamps that do not increase; ``row`` names a row by its index."""
    steps = np.diff(time)
    if np.all(steps > 0):
        return
    index = int(np.argmax(steps <= 0)) + 1
    if steps[index - 1] == 0:
        raise BadInput(
            f"{where}, {row(index)}",
            f"repeats the time stamp {time[index]:.9g} s of the row before",
            "cut the repeated rows out, or record time with finer resolution",
        )
    problem = f"goes back in time, from {time[index - 1]:.9g} s to {time[index]:.9g} s"
    raise BadInput(
        f"{where}, {row(index)}", problem, "sort the rows by time, or split the file there"
    )


def make_grid(time: Array, chosen: tuple[int, int], where: str) -> Grid:
    """Put a uniform grid over the segments without gaps of increasing stamps (n,).

    Only the half-open range ``chosen`` is used. Steps that jitter by more than 1 % rms are
    resampled to their median.
    """
    steps: list[str] = []
    warnings: list[str] = []
    pieces, median = _pieces(time, chosen, where, steps, warnings)
    inside = np.concatenate([np.diff(time[a:b]) for a, b in pieces])
    period = float(np.mean(inside))
    jitter = float(np.sqrt(np.mean((inside - period) ** 2)) / period)
    times, percent = [time[a:b] for a, b in pieces], f"jitter {100 * jitter:.2g} %"
    resampled = jitter > _JITTER
    if resampled:
        period = median
        times = [_evenly(part, period) for part in times]
        how = f"irregular ({percent}), resampled to {1e3 * period:.3g} ms "
        how += "by linear interpolation (PCHIP for position)"
    else:
        how = f"regular every {1e3 * period:.4g} ms ({percent})"
    steps.append(f"time: {chosen[1] - chosen[0]} samples, {how}")
    if not _POSSIBLE[0] <= period <= _POSSIBLE[1]:
        raise BadInput(where, f"the sampling period is {period:.3g} s", "check the unit of time")
    if not _FASTEST <= period <= _SLOWEST:
        warnings.append(f"time: the sampling period is {period:.3g} s; is the unit of time right?")
    ends = np.cumsum([len(part) for part in times]).tolist()
    segments = tuple(pairwise([0, *ends]))
    sentences = tuple(steps), tuple(warnings)
    return Grid(time, pieces, np.concatenate(times), segments, period, resampled, *sentences)


def _evenly(stamps: Array, period: float) -> Array:
    # the tolerance keeps a last stamp that lies on the grid but for rounding
    n = int(np.floor((stamps[-1] - stamps[0]) / period + 1e-9)) + 1
    return np.asarray(np.minimum(stamps[0] + period * np.arange(n), stamps[-1]))


def _pieces(
    time: Array, chosen: tuple[int, int], where: str, steps: list[str], warnings: list[str]
) -> tuple[Segments, float]:
    """Split the stamps at gaps; also return the median step."""
    first, last = chosen
    count = last - first
    if count < LEAST_SAMPLES:
        problem = f"has {count} samples, fewer than {LEAST_SAMPLES}"
        raise BadInput(where, problem, "record longer, or check start and stop")
    intervals = np.diff(time[first:last])
    if intervals.min() < _POSSIBLE[0]:
        problem = f"two time stamps are only {float(intervals.min()):.3g} s apart"
        raise BadInput(where, problem, "check the unit of time, or cut repeated rows out")
    median = float(np.median(intervals))
    borders = first + 1 + np.flatnonzero(intervals > _GAP * median)
    ranges = list(pairwise([first, *borders.tolist(), last]))
    pieces = tuple((a, b) for a, b in ranges if b - a >= LEAST_SAMPLES)
    if not pieces:
        longest = max(b - a for a, b in ranges)
        problem = f"time gaps leave no segment of {LEAST_SAMPLES} samples"
        problem += f" (the longest of {len(ranges)} has {longest})"
        raise BadInput(where, problem, "record without gaps")
    if len(ranges) > 1:
        steps.append(f"time: gaps split the recording into {len(ranges)} segments")
    if len(pieces) < len(ranges):
        lost = count - sum(b - a for a, b in pieces)
        warnings.append(
            f"time: {len(ranges) - len(pieces)} segments of fewer than {LEAST_SAMPLES} "
            f"samples left out ({lost} samples)"
        )
    return pieces, median
