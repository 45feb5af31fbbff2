"""Filters: zero-phase low-pass, differentiation, and the parallel filter."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from statistics import NormalDist
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.base.errors import BadInput
from bayesfric.recordings.arrays import Array, Flags, Index, Segments
from bayesfric.recordings.measurement import Lag

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# A cut-off at a smaller share of the sampling rate leaves only rounding.
_LOWEST_CUTOFF = 1e-6
# Largest share of a window's weight that may lie on unusable samples. They count for nothing, in
# both measurement and model, and the others for more; but a kink of the acceleration also affects
# the samples next to them, so few should be missing.
SMALL_SHARE, LARGE_SHARE = 0.02, 1 / 3
# Largest gain error of differentiation at the cut-off of the low-pass.
_GAIN_ERROR = 1e-4
# Cut-off of the parallel filter over half the decimated rate at which white noise comes out white
# (correlations of outputs below 0.003 for any factor). At that half itself neighbours had
# 0.10, the next -0.07, and intervals from thousands of outputs came out 5 % too narrow.
_WHITE = 1.0983
# The most that rounding to whole samples makes of it, where 1.5 are rounded to 2 (neighbours then
# have -0.2); and the least that is not warned of, where they have 0.3.
FOLDING, SHARING = _WHITE * 2.0 / 1.5, 0.8
# Neighbours on either side that a derivative is made of: at least, and at most.
_REACH = (4, 24)
# Chance of one false kink or more in a whole recording.
_FALSE_KINK = 0.05
# Neighbours on either side of an interpolated value.
_NEIGHBOURS = 4


def check_cutoff(cutoff: float, fs: float, where: str) -> None:
    """Refuse a cut-off in Hz that the sampling cannot carry; ``where`` is the key that set it."""
    if cutoff < _LOWEST_CUTOFF * fs:
        raise BadInput(
            where,
            f"the cut-off {cutoff:.3g} Hz is too low for the sampling rate ({fs:.6g} Hz)",
            "choose a higher cut-off, or 'off' for no low-pass",
        )
    if cutoff >= fs / 2:
        problem = (
            f"the cut-off {cutoff:.6g} Hz is not below half the sampling rate ({fs / 2:.6g} Hz)"
        )
        raise BadInput(where, problem, "choose a lower cut-off, or 'off' for no low-pass")


@lru_cache(maxsize=64)
def _sections(order: int, cutoff: float, fs: float) -> Array:
    """Design a Butterworth low-pass as second-order sections."""
    from scipy.signal import butter

    return np.asarray(butter(order, cutoff, fs=fs, output="sos"))


def lowpass(values: Array, segments: Segments, fs: float, cutoff: float, order: int) -> Array:
    """Low-pass signals (..., n) forwards and backwards in every segment, without phase shift.

    ``cutoff`` in Hz is -3 dB a pass, -6 dB in all, and 0 for no filter; ``order`` that of one pass.
    """
    if cutoff == 0:
        return values.copy()
    from scipy.signal import sosfiltfilt

    check_cutoff(cutoff, fs, "processing, lowpass")
    sections = _sections(order, cutoff, fs)
    # scipy's own padding is shorter than a low cut-off's transient
    padding = max(3 * (2 * len(sections) + 1), int(np.ceil(3 * fs / cutoff)))
    result = np.array(values, dtype=np.float64, order="C")
    for row in result.reshape(-1, values.shape[-1]):
        for a, b in segments:
            if b - a > 1:
                row[a:b] = sosfiltfilt(sections, row[a:b], padlen=min(padding, b - a - 1))
    return result


@lru_cache(maxsize=64)
def differentiator(reach: int) -> Array:
    """Weights ``(2 reach + 1,)`` of the derivative that is exact for degree ``2 reach``.

    Its gain at ``w`` rad a sample lacks about ``(reach!)^2 / (2 reach + 1)! (2 sin(w/2))^(2
    reach)`` of ``w`` (Fornberg, Math. Comp. 51, 1988).
    """
    weights = np.zeros(2 * reach + 1)
    for k in range(1, reach + 1):
        # (-1)^(k+1) (reach!)^2 / (k (reach-k)! (reach+k)!)
        share = math.comb(2 * reach, reach - k) / math.comb(2 * reach, reach)
        weights[reach + k] = -((-1) ** k) * share / k
        weights[reach - k] = -weights[reach + k]
    return weights


def reach_of(how: Literal["exact", "central"], cutoff: float, fs: float) -> int:
    """Choose the neighbours on either side of a derivative: one for ``central`` differences.

    Else 4 to 24, so that its gain is right within 1e-4 up to the cut-off; 4 without low-pass (0).
    """
    if how == "central":
        return 1
    shortest, longest = _REACH
    w = 2.0 * np.pi * cutoff / fs
    angles = np.arange(1, longest + 1)
    for reach in range(shortest, longest):
        gain = 2.0 * differentiator(reach)[reach + 1 :] @ np.sin(angles[:reach] * w)
        if abs(gain - w) <= _GAIN_ERROR * w:
            return reach
    return longest if cutoff else shortest


def derivative(values: Array, segments: Segments, period: float, reach: int = 1) -> Array:
    """Differentiate signals (..., n) in every segment of at least three samples; else it is 0.

    Of ``reach`` neighbours on either side, see :func:`differentiator`, or of as many as there are;
    at a segment's ends by the one-sided formula of second order.
    """
    result = np.zeros_like(values)
    for a, b in segments:
        if b - a < 3:
            continue
        part, out = values[..., a:b], result[..., a:b]
        out[...] = np.gradient(part, period, edge_order=2, axis=-1)
        for k in range(2, min(reach, (b - a - 1) // 2) + 1):
            weights = differentiator(k) / period
            if k < reach:  # one sample at either end
                out[..., k] = part[..., : 2 * k + 1] @ weights
                out[..., -1 - k] = part[..., -1 - 2 * k :] @ weights
                continue
            for row in np.ndindex(part.shape[:-1]):
                out[row][k : b - a - k] = np.correlate(part[row], weights, mode="valid")
    return result


def averaged(values: Array, segments: Segments, length: float) -> Array:
    """Average a signal ``(n,)`` over ``length`` samples about each, exact to the fourth order."""
    result = values.copy()
    for a, b in segments:
        result[a + 1 : b - 1] += length**2 / 24.0 * np.diff(values[a:b], 2)
    return result


def later(values: Array, samples: float, neighbours: int = _NEIGHBOURS) -> Array:
    """Delay a signal ``(n,)`` by a possibly fractional or negative number of samples.

    Interpolates by the polynomial through ``neighbours`` on either side: with four right within
    1e-4 at a tenth of the sampling rate. A signal is constant beyond its ends.
    """
    shift = math.floor(-samples)
    weights = _between(-samples - shift, neighbours)
    # beyond the whole signal there is only its end
    furthest = len(values) + neighbours
    shift = int(np.clip(shift, -furthest, furthest))
    index = np.arange(shift - neighbours + 1, len(values) + shift + neighbours)
    padded = values[np.clip(index, 0, len(values) - 1)]
    return np.asarray(np.correlate(padded, weights, mode="valid"))


@lru_cache(maxsize=1024)
def _between(share: float, neighbours: int) -> Array:
    """Interpolation weights ``(2 neighbours,)`` between two samples."""
    offsets = np.arange(-neighbours + 1, neighbours + 1)
    return np.array(
        [
            np.prod([(share - m) / (k - m) for m in offsets if m != k]) if share else float(k == 0)
            for k in offsets.tolist()
        ]
    )


def delayed_command(command: Array, segments: Segments, samples: float, *, held: bool) -> Array:
    """Delay a command ``(n,)`` by some samples, exact within the band.

    One that is held until the next sample acts half a sample later, averaged over one.
    """
    late = command.copy()
    for a, b in segments:
        late[a:b] = later(command[a:b], samples + 0.5 * held)
    return averaged(late, segments, 1.0) if held else late


def integrated_kinks(values: Array, segments: Segments) -> Array:
    """Correct a torque ``(n,)`` behind a current loop for the kinks at its commands' samples.

    The trapezoid rule misses a twelfth of the slope's jump there (Euler and Maclaurin), which is
    added. A kink is a second difference that noise of their median size would show once in twenty
    recordings.
    """
    result = values.copy()
    for a, b in segments:
        if b - a < 5:
            continue
        bend = np.zeros(b - a)
        bend[1:-1] = np.diff(values[a:b], 2)
        # a normal's standard deviation from the median absolute value
        sd = 1.482602218505602 * np.median(np.abs(bend))
        threshold = NormalDist().inv_cdf(1.0 - 0.5 * _FALSE_KINK / bend.size) * sd
        neighbour = np.maximum(np.abs(np.roll(bend, 1)), np.abs(np.roll(bend, -1)))
        kinks = (np.abs(bend) > threshold) & (np.abs(bend) >= neighbour) & (threshold > 0.0)
        smooth = 0.5 * (np.roll(bend, 2) + np.roll(bend, -2))
        result[a:b] += np.where(kinks, bend - smooth, 0.0) / 12.0
    return result


def inverse_lowpass(
    values: Array, segments: Segments, period: float, lag: Lag, reach: int
) -> Array:
    """Undo a causal low-pass on a signal ``(n,)``, within the band that its derivatives show.

    The inverse is ``1 + s/w`` or, of a Butterworth filter of second order, ``1 + sqrt(2) s/w +
    (s/w)²``.
    """
    rate = derivative(values, segments, period, reach) / (2.0 * np.pi * lag.cutoff)
    if lag.order == 1:
        return values + rate
    curvature = derivative(rate, segments, period, reach) / (2.0 * np.pi * lag.cutoff)
    return np.asarray(values + math.sqrt(2.0) * rate + curvature)


@dataclass(frozen=True, eq=False)
class ParallelFilter:
    """Low-pass and decimation of both measurement and model.

    Output m is ``gains[m] * taps @ (used * x)[starts[m]:starts[m]+L]``; the gains preserve a
    constant where samples do not count.
    """

    taps: Array  # (L,) symmetric weights that sum to 1
    starts: NDArray[np.int64]  # (M,) first sample of every window
    used: Array  # (N,) 1 for samples that count and 0 for others
    gains: Array  # (M,)

    @classmethod
    def every_sample(cls, n: int) -> ParallelFilter:
        """Make the filter whose outputs are the ``n`` samples."""
        return cls(np.ones(1), np.arange(n, dtype=np.int64), np.ones(n), np.ones(n))

    @property
    def n_outputs(self) -> int:
        """Number of outputs M."""
        return len(self.starts)

    def excerpt(self, outputs: Index) -> tuple[ParallelFilter, Index]:
        """Return the filter of some rising outputs ``(m,)``, and the samples that it takes."""
        # one after the first, minus one after the last sample of every window
        borders = np.zeros(self.used.size + 1, dtype=np.int64)
        np.add.at(borders, self.starts[outputs], 1)
        np.add.at(borders, self.starts[outputs] + len(self.taps), -1)
        inside = np.cumsum(borders[:-1]) > 0
        places = np.cumsum(inside) - 1
        chosen = ParallelFilter(
            self.taps, places[self.starts[outputs]], self.used[inside], self.gains[outputs]
        )
        return chosen, np.flatnonzero(inside)

    @property
    def centres(self) -> NDArray[np.int64]:
        """Sample in the middle of every window, shape (M,)."""
        return self.starts + len(self.taps) // 2

    def reached(self, weights: Array) -> Array:
        """Transpose the filter: ``weights @ apply(x)`` is ``reached(weights) @ x``.

        From weights (k, M) of outputs to (k, N) of samples.
        """
        out = np.zeros((len(weights), self.used.size))
        weighed = weights * self.gains
        for shift, tap in enumerate(self.taps):
            # windows begin at different samples
            out[:, self.starts + shift] += tap * weighed
        return out * self.used

    def apply(self, x: Array) -> Array:
        """Filter and decimate one or more signals, shape (..., N) to (..., M)."""
        x = np.asarray(x, dtype=np.float64)
        if len(self.taps) == 1:
            return np.asarray(x[..., self.starts] * (self.taps[0] * self.gains))
        rows = x.reshape(-1, x.shape[-1]).T
        out = np.ascontiguousarray((self._matrix @ rows).T)
        return out.reshape(*x.shape[:-1], self.n_outputs)

    @cached_property
    def _matrix(self) -> csr_array:
        """From samples to outputs, ``(M, N)``."""
        from scipy.sparse import csr_array

        n, length = self.n_outputs, len(self.taps)
        samples = self.starts[:, None] + np.arange(length)
        weights = self.gains[:, None] * self.taps * self.used[samples]
        ends = np.arange(0, n * length + 1, length)
        return csr_array((weights.ravel(), samples.ravel(), ends), (n, self.used.size))


def decimation(band: float, fs: float) -> int:
    """Return the samples per output with which noise of a band in Hz stays nearly white."""
    return max(1, round(_WHITE * fs / (2.0 * band)))


def parallel_length(factor: int, band: float | None, fs: float) -> int:
    """Return how many weights :func:`parallel_taps` has, without making them."""
    if band is None and factor == 1:
        return 1
    nyquist = fs / (2 * factor)
    if band is None:
        return 8 * factor + 1
    check_cutoff(band, fs, "processing, band")
    # a narrower band needs a longer window for the same steepness
    return 2 * int(np.ceil(2 * fs / band)) + 1 if band < nyquist else 8 * factor + 1


def parallel_cutoff(factor: int, band: float | None, fs: float) -> float:
    """Cut-off in Hz, -6 dB, of the parallel filter; see :func:`parallel_taps`."""
    return _WHITE * fs / (2 * factor) if band is None else band


def parallel_taps(factor: int, band: float | None, fs: float) -> Array:
    """Design the weights ``(L,)`` of a parallel filter, L odd; they sum to 1.

    ``factor`` is samples an output. ``band`` is the cut-off in Hz; None for the one near half the
    decimated rate that keeps noise white, or no filter if nothing is decimated.
    """
    length = parallel_length(factor, band, fs)
    if length == 1:
        return np.ones(1)
    cutoff = parallel_cutoff(factor, band, fs)
    check_cutoff(cutoff, fs, "processing, band")
    from scipy.signal import firwin

    taps = np.asarray(firwin(length, cutoff, fs=fs, window="hamming"), dtype=np.float64)
    return np.asarray(taps / taps.sum())


def lay_windows(
    taps: Array, segments: Segments, factor: int, usable: Flags, largest_share: float = SMALL_SHARE
) -> ParallelFilter:
    """Lay windows of weights ``taps`` (L,), one every ``factor`` samples, fully inside segments.

    Samples that are not ``usable`` (N,) count for nothing; windows with more than
    ``largest_share`` of their weight on them are left out. There may be no window.
    """
    length = len(taps)
    parts = [np.arange(a, b - length + 1, factor, dtype=np.int64) for a, b in segments]
    starts = np.concatenate(parts) if parts else np.empty(0, dtype=np.int64)
    used, every = usable.astype(np.float64), np.ones(usable.size)
    if len(starts) and not usable.all():
        sizes = np.abs(taps) / np.abs(taps).sum()
        lost = ParallelFilter(sizes, starts, every, np.ones(len(starts))).apply(1.0 - used)
        starts = starts[lost <= largest_share]
    windows = ParallelFilter(taps, starts, used, np.ones(len(starts)))
    if usable.all():
        return windows
    # never near zero: two thirds of the absolute weight are there
    return replace(windows, gains=1.0 / windows.apply(every))
