"""Filters: zero-phase low-pass, central differences, and the parallel filter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesfric.errors import BadInput

# A cut-off this small a share of the sampling rate leaves nothing but rounding.
_LOWEST_CUTOFF = 1e-6
# Largest share of a window's weight that may lie on samples that are not usable
_LARGEST_SHARE = 0.02


def check_cutoff(cutoff: float, fs: float, where: str) -> None:
    """Refuse a cut-off that the sampling cannot carry.

    Parameters
    ----------
    cutoff
        Cut-off in Hz.
    fs
        Sampling rate in Hz.
    where
        The key that set it.

    Raises
    ------
    BadInput
        If the cut-off is not below half the sampling rate, or below a millionth of it.
    """
    if cutoff < _LOWEST_CUTOFF * fs:
        raise BadInput(
            where,
            f"the cut-off {cutoff:.3g} Hz is next to nothing beside the sampling rate "
            f"({fs:.6g} Hz)",
            "choose a higher cut-off, or 'off' for no low-pass",
        )
    if cutoff >= fs / 2:
        raise BadInput(
            where,
            f"the cut-off {cutoff:.6g} Hz is not below half the sampling rate ({fs / 2:.6g} Hz)",
            "choose a lower cut-off, or 'off' for no low-pass",
        )


def lowpass(
    values: NDArray[np.float64],
    segments: Sequence[tuple[int, int]],
    fs: float,
    cutoff: float,
    order: int,
) -> NDArray[np.float64]:
    """Low-pass a signal forwards and backwards in every segment.

    Parameters
    ----------
    values
        The signal, shape (n,).
    segments
        Half-open ranges; what lies outside is left as it is.
    fs
        Sampling rate in Hz.
    cutoff
        Cut-off of the Butterworth filter in Hz: -3 dB a pass, -6 dB in all. 0 for no filter.
    order
        Order of the Butterworth filter, one pass.

    Returns
    -------
    numpy.ndarray
        The filtered signal, shape (n,), without phase shift.

    Raises
    ------
    BadInput
        If the cut-off is not below half the sampling rate.
    """
    if cutoff == 0:
        return values.copy()
    check_cutoff(cutoff, fs, "processing, lowpass")
    from scipy.signal import butter, sosfiltfilt

    sections = np.asarray(butter(order, cutoff, fs=fs, output="sos"))
    # scipy's own padding is shorter than a low cut-off's transient
    padding = max(3 * (2 * len(sections) + 1), int(np.ceil(3 * fs / cutoff)))
    result = values.copy()
    for a, b in segments:
        if b - a > 1:
            result[a:b] = sosfiltfilt(sections, values[a:b], padlen=min(padding, b - a - 1))
    return result


def derivative(
    values: NDArray[np.float64], segments: Sequence[tuple[int, int]], period: float
) -> NDArray[np.float64]:
    """Differentiate a signal by central differences in every segment.

    Parameters
    ----------
    values
        The signal, shape (n,).
    segments
        Half-open ranges of at least three samples; outside, the result is 0.
    period
        Sampling period in s.

    Returns
    -------
    numpy.ndarray
        Shape (n,): (x[i+1] - x[i-1]) / (2 period), and the one-sided formula of the same order
        at a segment's two ends.
    """
    result = np.zeros_like(values)
    for a, b in segments:
        if b - a >= 3:
            result[a:b] = np.gradient(values[a:b], period, edge_order=2)
    return result


@dataclass(frozen=True, eq=False)
class ParallelFilter:
    """Low-pass and decimation that measurement and model pass alike.

    Parameters
    ----------
    taps
        Symmetric weights that sum to 1, shape (L,).
    starts
        First sample of every window, shape (M,): output m is ``taps @ x[starts[m]:starts[m]+L]``.
    """

    taps: NDArray[np.float64]
    starts: NDArray[np.int64]

    @property
    def n_outputs(self) -> int:
        """Number of outputs M."""
        return len(self.starts)

    @property
    def centres(self) -> NDArray[np.int64]:
        """Sample in the middle of every window, shape (M,)."""
        return self.starts + len(self.taps) // 2

    def apply(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Filter and decimate a signal.

        Parameters
        ----------
        x
            One or more signals, shape (..., N).

        Returns
        -------
        numpy.ndarray
            Shape (..., M).
        """
        x = np.asarray(x, dtype=np.float64)
        if len(self.taps) == 1:
            return np.asarray(x[..., self.starts] * self.taps[0])
        if self.n_outputs == 0:
            return np.empty((*x.shape[:-1], 0))
        out = np.empty((*x.shape[:-1], self.n_outputs))
        # one signal at a time: the windows of one are already len(taps)/factor times its size
        for index in np.ndindex(x.shape[:-1]):
            windows = np.lib.stride_tricks.sliding_window_view(x[index], len(self.taps))
            out[index] = windows[self.starts] @ self.taps
        return out


def parallel_length(factor: int, band: float | None, fs: float) -> int:
    """Return how many weights :func:`parallel_taps` has, without making them.

    Parameters and what is raised are as there.
    """
    if band is None and factor == 1:
        return 1
    nyquist = fs / (2 * factor)
    if band is None:
        return 8 * factor + 1
    check_cutoff(band, fs, "processing, band")
    # a narrower band needs a longer window for the same steepness
    return 2 * int(np.ceil(2 * fs / band)) + 1 if band < nyquist else 8 * factor + 1


def parallel_taps(factor: int, band: float | None, fs: float) -> NDArray[np.float64]:
    """Design the weights of a parallel filter.

    Parameters
    ----------
    factor
        Samples an output.
    band
        Cut-off in Hz; None for half the decimated rate, or no filter if nothing is decimated.
    fs
        Sampling rate in Hz.

    Returns
    -------
    numpy.ndarray
        Weights that sum to 1, shape (L,), L odd.

    Raises
    ------
    BadInput
        If the cut-off is not below half the sampling rate.
    """
    length = parallel_length(factor, band, fs)
    if length == 1:
        return np.ones(1)
    cutoff = fs / (2 * factor) if band is None else band
    check_cutoff(cutoff, fs, "processing, band")
    from scipy.signal import firwin

    taps = np.asarray(firwin(length, cutoff, fs=fs, window="hamming"), dtype=np.float64)
    return np.asarray(taps / taps.sum())


def parallel_filter(
    segments: Sequence[tuple[int, int]],
    factor: int,
    band: float | None,
    fs: float,
    usable: NDArray[np.bool_],
) -> ParallelFilter:
    """Lay windows of a parallel filter over the usable samples.

    Parameters
    ----------
    segments
        Half-open ranges; every window lies fully inside one.
    factor
        Samples from one window's start to the next.
    band
        Cut-off in Hz; None for half the decimated rate, or no filter if nothing is decimated.
    fs
        Sampling rate in Hz.
    usable
        Samples that may be used, shape (N,). Windows with more than 2 % of their weight on
        others are left out.

    Returns
    -------
    ParallelFilter
        Possibly without outputs.

    Raises
    ------
    BadInput
        If the cut-off is not below half the sampling rate.
    """
    return lay_windows(parallel_taps(factor, band, fs), segments, factor, usable)


def lay_windows(
    taps: NDArray[np.float64],
    segments: Sequence[tuple[int, int]],
    factor: int,
    usable: NDArray[np.bool_],
) -> ParallelFilter:
    """Lay windows of given weights ``(L,)`` as :func:`parallel_filter` does."""
    length = len(taps)
    parts = [np.arange(a, b - length + 1, factor, dtype=np.int64) for a, b in segments]
    starts = np.concatenate(parts) if parts else np.empty(0, dtype=np.int64)
    if len(starts) and not usable.all():
        weights = np.abs(taps) / np.abs(taps).sum()
        share = ParallelFilter(weights, starts).apply((~usable).astype(np.float64))
        starts = starts[share <= _LARGEST_SHARE]
    return ParallelFilter(taps, starts)
