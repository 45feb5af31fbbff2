"""Time stamps: their order, their gaps, and a uniform grid over them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bayesfric.errors import BadInput
from bayesfric.recordings import units
from bayesfric.recordings.processing import Processing

Segments = tuple[tuple[int, int], ...]
_SLOWEST = 1.0
_FASTEST = 1e-6
# a period outside these is no sampling at all, and its square leaves floating point
_POSSIBLE = (1e-12, 1e9)
_MOST_SAMPLES = 10_000_000


@dataclass(frozen=True, eq=False)
class Grid:
    """A uniform time base made from time stamps.

    Parameters
    ----------
    stamps
        Measured times in s, shape (n,).
    pieces
        Half-open ranges of the stamps that are used.
    time
        Times of the grid in s, shape (m,).
    segments
        Half-open ranges of the grid, one a piece.
    period
        Step of the grid in s.
    resampled
        Whether the grid's times differ from the stamps.
    steps, warnings
        One sentence for every choice made, and for everything to look at.
    """

    stamps: NDArray[np.float64]
    pieces: Segments
    time: NDArray[np.float64]
    segments: Segments
    period: float
    resampled: bool
    steps: tuple[str, ...]
    warnings: tuple[str, ...]

    def linear(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Bring a signal onto the grid by linear interpolation.

        Parameters
        ----------
        values
            One value a stamp, shape (n,).

        Returns
        -------
        numpy.ndarray
            Shape (m,).
        """
        return self._bring(values, np.interp)

    def smooth(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Bring a signal onto the grid by PCHIP, which keeps its slope continuous.

        Parameters
        ----------
        values
            One value a stamp, shape (n,).

        Returns
        -------
        numpy.ndarray
            Shape (m,).
        """

        def pchip(
            x: NDArray[np.float64], xp: NDArray[np.float64], fp: NDArray[np.float64]
        ) -> NDArray[np.float64]:
            from scipy.interpolate import PchipInterpolator

            return np.asarray(PchipInterpolator(xp, fp)(x), dtype=np.float64)

        return self._bring(values, pchip)

    def _bring(
        self,
        values: NDArray[np.float64],
        interpolate: Callable[..., NDArray[np.float64]],
    ) -> NDArray[np.float64]:
        parts = []
        for (a, b), (lo, hi) in zip(self.pieces, self.segments, strict=True):
            if self.resampled:
                parts.append(interpolate(self.time[lo:hi], self.stamps[a:b], values[a:b]))
            else:
                parts.append(values[a:b])
        return np.concatenate(parts)


def check_order(time: NDArray[np.float64], where: str, row: Callable[[int], str]) -> None:
    """Refuse time stamps that do not increase.

    Parameters
    ----------
    time
        Time stamps, shape (n,).
    where
        File and column.
    row
        Names a row by its index.

    Raises
    ------
    BadInput
        For a stamp that repeats the one before it or lies before it.
    """
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
    raise BadInput(
        f"{where}, {row(index)}",
        f"goes back in time, from {time[index - 1]:.9g} s to {time[index]:.9g} s",
        "sort the rows by time, or split the file there",
    )


def make_grid(
    time: NDArray[np.float64], chosen: tuple[int, int], processing: Processing, where: str
) -> Grid:
    """Find segments and put a uniform grid over them.

    Parameters
    ----------
    time
        Increasing time stamps in s, shape (n,).
    chosen
        Half-open range of the samples to use.
    processing
        Its gap, jitter, resample and min_samples are used.
    where
        The file, for messages.

    Returns
    -------
    Grid
        The uniform time base.

    Raises
    ------
    BadInput
        If no segment has enough samples.
    """
    first, last = chosen
    count = last - first
    if count < max(processing.min_samples, 2):
        raise BadInput(
            where,
            f"has {count} samples, fewer than min_samples = {processing.min_samples}",
            "record longer, or check start and stop",
        )
    intervals = np.diff(time[first:last])
    if intervals.min() < _POSSIBLE[0]:
        raise BadInput(
            where,
            f"two time stamps are only {float(intervals.min()):.3g} s apart",
            "check the unit of time, or cut repeated rows out",
        )
    median = float(np.median(intervals))
    borders = first + 1 + np.flatnonzero(intervals > processing.gap * median)
    edges = [first, *borders.tolist(), last]
    found = list(pairwise(edges))
    pieces = tuple((a, b) for a, b in found if b - a >= processing.min_samples)
    if not pieces:
        longest = max(b - a for a, b in found)
        raise BadInput(
            where,
            f"time gaps leave no segment of min_samples = {processing.min_samples}"
            f" (the longest of {len(found)} has {longest})",
            "record without gaps, or raise gap",
        )
    steps: list[str] = []
    warnings: list[str] = []
    if len(found) > 1:
        steps.append(f"time: gaps split the recording into {len(found)} segments")
    if len(pieces) < len(found):
        lost = count - sum(b - a for a, b in pieces)
        warnings.append(
            f"time: {len(found) - len(pieces)} segments of fewer than {processing.min_samples} "
            f"samples left out ({lost} samples)"
        )
    inside = np.concatenate([np.diff(time[a:b]) for a, b in pieces])
    mean = float(np.mean(inside))
    jitter = float(np.sqrt(np.mean((inside - mean) ** 2)) / mean)
    period, resampled, told = _choose(jitter, mean, median, processing, warnings)
    steps.append(f"time: {count} samples, {told}")
    if not _POSSIBLE[0] <= period <= _POSSIBLE[1]:
        raise BadInput(where, f"the sampling period is {period:.3g} s", "check the unit of time")
    if not _FASTEST <= period <= _SLOWEST:
        warnings.append(f"time: the sampling period is {period:.3g} s; is the unit of time right?")
    times: list[NDArray[np.float64]] = []
    segments: list[tuple[int, int]] = []
    begin = 0
    for a, b in pieces:
        if resampled:
            # the tolerance keeps a last stamp that lies on the grid but for rounding
            n = int(np.floor((time[b - 1] - time[a]) / period + 1e-9)) + 1
            if begin + n > _MOST_SAMPLES:
                raise BadInput(
                    where,
                    f"resampling to {period:.3g} s makes more than {_MOST_SAMPLES} samples",
                    "choose a longer period in resample",
                )
            part = np.minimum(time[a] + period * np.arange(n), time[b - 1])
        else:
            part = time[a:b]
        if len(part) < processing.min_samples:
            raise BadInput(
                where,
                f"resampling to {period:.3g} s leaves {len(part)} samples in a segment, fewer than "
                f"min_samples = {processing.min_samples}",
                "choose a shorter period in resample",
            )
        times.append(part)
        segments.append((begin, begin + len(part)))
        begin += len(part)
    return Grid(
        stamps=time,
        pieces=pieces,
        time=np.concatenate(times),
        segments=tuple(segments),
        period=period,
        resampled=resampled,
        steps=tuple(steps),
        warnings=tuple(warnings),
    )


def _choose(
    jitter: float, mean: float, median: float, processing: Processing, warnings: list[str]
) -> tuple[float, bool, str]:
    """Return the grid's period, whether to resample, and the choice in words."""
    how = "by linear interpolation (PCHIP for position)"
    percent = f"jitter {100 * jitter:.2g} %"
    if processing.resample not in ("auto", "never"):
        period = units.quantity(processing.resample, "time")
        if period < 0.5 * median:
            warnings.append(
                f"time: resampled to {1e3 * period:.3g} ms, much finer than the measured "
                f"{1e3 * median:.3g} ms; the samples in between are invented"
            )
        elif period > 1.5 * median:
            warnings.append(
                f"time: resampled to {1e3 * period:.3g} ms, coarser than the measured "
                f"{1e3 * median:.3g} ms without a filter; use decimate instead"
            )
        return period, True, f"{percent}, resampled as asked to {1e3 * period:.3g} ms {how}"
    if jitter <= processing.jitter:
        return mean, False, f"regular every {1e3 * mean:.4g} ms ({percent})"
    if processing.resample == "never":
        warnings.append(f"time: irregular ({percent}) but taken as regular (resample = 'never')")
        return mean, False, f"irregular ({percent}), taken as regular every {1e3 * mean:.4g} ms"
    return median, True, f"irregular ({percent}), resampled to {1e3 * median:.3g} ms {how}"
