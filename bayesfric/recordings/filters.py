"""Filters: zero-phase low-pass, differentiation, the parallel filter; and the band they leave."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Literal

import numpy as np
from numba import njit

from bayesfric.base.errors import BadInput
from bayesfric.recordings.arrays import Array, Flags, Index, Segments
from bayesfric.recordings.measurement import Lag, Measurement, Signal

# Largest share of a window's weight on unusable samples, which count for nothing in measurement and
# model. A kink of the acceleration also affects the samples next to them, so few should be missing.
SMALL_SHARE, LARGE_SHARE = 0.02, 1 / 3
# Cut-off of the parallel filter over half the decimated rate at which white noise comes out white
# (correlations of outputs below 0.003). At that half itself intervals were 5 % too narrow.
_WHITE = 1.0983
# The most that rounding to whole samples makes of it, and the least that is not warned of.
FOLDING, SHARING = _WHITE * 2.0 / 1.5, 0.8
# Widest band over the sampling rate.
WIDEST = 0.05
# Averages that at least make up the longest segment of a recording that is averaged.
_LEAST_AVERAGES = 200
# Ratio (rms) of acceleration to its noise below which a user is warned: an inertia is too small by
# about the inverse of its square.
LEAST_RATIO = 10.0
Reason = Literal["sampling", "position", "torque", "length", "model", "asked"]


def check_cutoff(cutoff: float, fs: float, where: str) -> None:
    """Refuse a cut-off in Hz that the sampling cannot carry; ``where`` is the key that set it."""
    if not 1e-6 * fs <= cutoff < fs / 2:
        problem = f"{cutoff:.6g} Hz is not below half the sampling rate ({fs / 2:.6g} Hz)"
        problem = problem if cutoff >= 1e-6 * fs else f"{cutoff:.6g} Hz is too low"
        raise BadInput(where, problem, "choose another cut-off, or 'off' for no low-pass")


@lru_cache(maxsize=1024)  # fifteen cut-offs of many recordings, again for each replicate
def _butterworth(order: int, cutoff: float, fs: float) -> tuple[Array, Array]:
    """Design a Butterworth low-pass: second-order sections, and their states for a constant."""
    from scipy.signal import butter, sosfilt_zi

    sections = butter(order, cutoff, fs=fs, output="sos")
    return np.asarray(sections), np.asarray(sosfilt_zi(sections))


def lowpass(values: Array, segments: Segments, fs: float, cutoff: float, order: int) -> Array:
    """Low-pass signals (..., n) forwards and backwards in every segment, without phase shift.

    ``cutoff`` in Hz is -3 dB a pass, -6 dB in all, and 0 for no filter; ``order`` that of one pass.
    """
    if cutoff == 0:
        return values.copy()
    check_cutoff(cutoff, fs, "processing, lowpass")
    sections, constant = _butterworth(order, cutoff, fs)
    padding = max(3 * (2 * len(sections) + 1), int(np.ceil(3 * fs / cutoff)))
    result = np.array(values, dtype=np.float64, order="C")
    rows = result.reshape(-1, values.shape[-1])
    for a, b in segments:
        if b - a < 2:
            continue
        # reflected at both ends, longer than the transient of a low cut-off
        _there_and_back(rows, a, b, sections, constant, min(padding, b - a - 1))
    return result


@njit(cache=True)
def _there_and_back(rows, a, b, sections, constant, padding):  # type: ignore[no-untyped-def]
    """Filter samples a to b of rows ``(k, N)`` in place by second-order sections, both ways."""
    n = b - a
    x = np.empty(n + 2 * padding)
    for row in rows:
        for i in range(n):
            x[padding + i] = row[a + i]
        for i in range(padding):
            x[i] = 2.0 * row[a] - row[a + padding - i]
            x[padding + n + i] = 2.0 * row[b - 1] - row[b - 2 - i]
        for _ in range(2):
            first = x[0]
            for section in range(len(sections)):
                b0, b1, b2, _, a1, a2 = sections[section]
                z1, z2 = constant[section, 0] * first, constant[section, 1] * first
                for i in range(x.size):
                    y = b0 * x[i] + z1
                    z1 = b1 * x[i] - a1 * y + z2
                    z2 = b2 * x[i] - a2 * y
                    x[i] = y
            for i in range(x.size // 2):
                x[i], x[-1 - i] = x[-1 - i], x[i]
        for i in range(n):
            row[a + i] = x[padding + i]


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

    Else four to 24, so that its gain is right within 1e-4 up to the cut-off; four without (0).
    """
    shortest, longest = 4, 24
    if how == "central":
        return 1
    w = 2.0 * np.pi * cutoff / fs
    angles = np.arange(1, longest + 1)
    for reach in range(shortest, longest):
        gain = 2.0 * differentiator(reach)[reach + 1 :] @ np.sin(angles[:reach] * w)
        if abs(gain - w) <= 1e-4 * w:
            return reach
    return longest if cutoff else shortest


def derivative(values: Array, segments: Segments, period: float, reach: int = 1) -> Array:
    """Differentiate signals (..., n) in every segment of three or more, by `differentiator`."""
    result = np.zeros_like(values)
    for a, b in segments:
        n = b - a
        if n < 3:
            continue
        part, out = values[..., a:b], result[..., a:b]
        out[..., :1] = np.gradient(part[..., :3], period, edge_order=2, axis=-1)[..., :1]
        out[..., -1:] = np.gradient(part[..., -3:], period, edge_order=2, axis=-1)[..., -1:]
        widest = max(1, min(reach, (n - 1) // 2))
        for k in range(1, widest):  # one sample at either end
            weights = differentiator(k) / period
            out[..., k] = part[..., : 2 * k + 1] @ weights
            out[..., -1 - k] = part[..., -1 - 2 * k :] @ weights
        weights, last = differentiator(widest) / period, n - widest
        for k in range(1, widest + 1):
            change = part[..., widest + k : last + k] - part[..., widest - k : last - k]
            out[..., widest:last] += weights[widest + k] * change
    return result


def averaged(values: Array, segments: Segments, length: float) -> Array:
    """Average a signal ``(n,)`` over ``length`` samples about each, exact to the fourth order."""
    result = values.copy()
    for a, b in segments:
        result[a + 1 : b - 1] += length**2 / 24.0 * np.diff(values[a:b], 2)
    return result


def later(values: Array, samples: float, neighbours: int = 4) -> Array:
    """Delay a signal ``(n,)`` by some samples, by the polynomial through its ``neighbours``."""
    shift, furthest = math.floor(-samples), len(values) + neighbours
    weights = _between(-samples - shift, neighbours)
    # beyond the whole signal there is only its end
    shift = int(np.clip(shift, -furthest, furthest))
    index = np.arange(shift - neighbours + 1, len(values) + shift + neighbours)
    padded = values[np.clip(index, 0, len(values) - 1)]
    return np.asarray(np.correlate(padded, weights, mode="valid"))


def interpolated(time: Array, values: Array, at: Array) -> Array:
    """Interpolate signals ``(..., n)`` by a cubic spline, constant beyond its ends."""
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(time, values, axis=-1)(np.clip(at, time[0], time[-1])))


@lru_cache(maxsize=1024)
def _between(share: float, neighbours: int) -> Array:
    """Interpolation weights ``(2 neighbours,)`` between two samples."""
    offsets = np.arange(-neighbours + 1, neighbours + 1).tolist()
    if not share:
        return np.array([float(k == 0) for k in offsets])
    others = ([(share - m) / (k - m) for m in offsets if m != k] for k in offsets)
    return np.array([np.prod(factors) for factors in others])


def delayed_command(command: Array, segments: Segments, samples: float, *, held: bool) -> Array:
    """Delay a command ``(n,)`` by some samples, half a one more where it is held until the next."""
    late = command.copy()
    for a, b in segments:
        late[a:b] = later(command[a:b], samples + 0.5 * held)
    return averaged(late, segments, 1.0) if held else late


def inverse_lowpass(
    values: Array, segments: Segments, period: float, lag: Lag, reach: int
) -> Array:
    """Undo a causal low-pass of first or second order on a signal ``(n,)``, within the band."""
    cutoff, order = lag
    rate = derivative(values, segments, period, reach) / (2.0 * np.pi * cutoff)
    if order == 1:
        return values + rate
    curvature = derivative(rate, segments, period, reach) / (2.0 * np.pi * cutoff)
    return np.asarray(values + math.sqrt(2.0) * rate + curvature)


@dataclass(frozen=True, eq=False)
class ParallelFilter:
    """Low-pass and decimation of both measurement and model.

    Output m is ``gains[m] * taps @ (used * x)[starts[m]:starts[m]+L]``; the gains preserve a
    constant where samples do not count.
    """

    taps: Array  # (L,) symmetric weights that sum to 1
    starts: Index  # (M,) first sample of every window
    used: Array  # (N,) 1 for samples that count and 0 for others
    gains: Array  # (M,)

    @property
    def n_outputs(self) -> int:
        """Number of outputs M."""
        return len(self.starts)

    def excerpt(self, outputs: Index) -> tuple[ParallelFilter, Index]:
        """Return the filter of some rising outputs ``(m,)``, and the samples that it takes."""
        # one after the first, minus one after the last sample of every window
        borders, starts = np.zeros(self.used.size + 1, dtype=np.int64), self.starts[outputs]
        np.add.at(borders, starts, 1)
        np.add.at(borders, starts + len(self.taps), -1)
        inside = np.cumsum(borders[:-1]) > 0
        starts = (np.cumsum(inside) - 1)[starts]
        chosen = ParallelFilter(self.taps, starts, self.used[inside], self.gains[outputs])
        return chosen, np.flatnonzero(inside)

    @property
    def centres(self) -> Index:
        """Sample in the middle of every window, shape (M,)."""
        return self.starts + len(self.taps) // 2

    def apply(self, x: Array) -> Array:
        """Filter and decimate one or more signals, shape (..., N) to (..., M)."""
        rows = np.ascontiguousarray(x, dtype=np.float64).reshape(-1, x.shape[-1])
        out = _windowed(rows, self.used, self.taps, self.starts, self.gains)
        return np.asarray(out).reshape(*x.shape[:-1], self.n_outputs)


@njit(cache=True, fastmath={"reassoc", "nsz", "contract"})
def _windowed(rows, used, taps, starts, gains):  # type: ignore[no-untyped-def]
    """Apply a parallel filter to rows ``(k, N)``: ``(k, M)``."""
    out, row = np.empty((len(rows), starts.size)), np.empty(used.size)
    for k in range(len(rows)):
        for i in range(used.size):
            row[i] = rows[k, i] * used[i]
        for m in range(starts.size):
            window, total = row[starts[m] : starts[m] + taps.size], 0.0
            for j in range(taps.size):  # in any order, several at once
                total += taps[j] * window[j]
            out[k, m] = gains[m] * total
    return out


def decimation(band: float, fs: float) -> int:
    """Return the samples per output with which noise of a band in Hz stays nearly white."""
    return max(1, round(_WHITE * fs / (2.0 * band)))


def parallel_length(factor: int, band: float | None, fs: float) -> int:
    """Return how many weights :func:`parallel_taps` has, without making them."""
    if band is None:
        return 8 * factor + 1 if factor > 1 else 1
    check_cutoff(band, fs, "processing, band")
    # a narrower band needs a longer window for the same steepness
    return 2 * int(np.ceil(2 * fs / band)) + 1 if band < fs / (2 * factor) else 8 * factor + 1


def parallel_cutoff(factor: int, band: float | None, fs: float) -> float:
    """Return the cut-off in Hz, -6 dB, of the parallel filter; see :func:`parallel_taps`."""
    return _WHITE * fs / (2 * factor) if band is None else band


def parallel_taps(factor: int, band: float | None, fs: float) -> Array:
    """Design the weights ``(L,)`` of a parallel filter, L odd, for ``factor`` samples an output."""
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

    Those with more than ``largest_share`` of their weight on unusable samples are left out.
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


def averaged_to(recording: Measurement, rate: float) -> Measurement:
    """Average a recording that is faster than ``rate`` Hz; its white noise stays white."""
    r, fs = recording, 1.0 / recording.period
    longest = max(b - a for a, b in r.segments)
    factor = int(min(fs / rate + 1e-9, longest / _LEAST_AVERAGES))
    if factor < 2:
        return r
    everything = np.ones(r.time.size, dtype=np.bool_)
    windows = lay_windows(parallel_taps(factor, None, fs), r.segments, factor, everything)
    sizes = replace(windows, taps=np.abs(windows.taps) / np.abs(windows.taps).sum())
    borders = [(windows.starts >= a) & (windows.starts < b) for a, b in r.segments]
    ends = np.cumsum([0, *(n for inside in borders if (n := int(inside.sum())))]).tolist()

    def partly(flags: Flags) -> Flags:
        return np.asarray(sizes.apply(flags.astype(np.float64)) > SMALL_SHARE)

    # a command that is held acts later by half a sample of the faster rate
    if r.held:
        r = replace(r, torque=delayed_command(r.torque, r.segments, 0.0, held=True), held=False)
    if r.law and r.law.held:
        command = delayed_command(r.law.command, r.segments, 0.0, held=True)
        r = replace(r, law=replace(r.law, command=command, held=False))
    time, stamps = r.time[windows.centres], r.time
    return replace(
        r.each(windows.apply, partly),
        time=time,
        segments=tuple(pairwise(ends)),
        period=factor * r.period,
        inputs=r.inputs.each(lambda x: Signal(time, windows.apply(x.at(stamps)))),
        steps=(*r.steps, f"time: averaged over {factor} samples, at {rate:.3g} Hz"),
    )


# --- band ---------------------------------------------------------------------------------------
#
# Differentiating twice multiplies noise and steps of the position by the square of frequency. Where
# that is not far below the motion, least squares underestimates inertia (errors in variables).


@dataclass(frozen=True)
class Resolution:
    """The band of a recording, what ends it, and its signal-to-noise ratio."""

    band: float  # Hz up to which measured and modelled torque can be compared
    reason: Reason
    noise: float  # sd of the noise of position (or speed, where measured), a sample
    acceleration_ratio: float  # rms of the acceleration over that of its noise, in the band


# Power densities at frequencies (K,), averaged over neighbours: frequency and its width in Hz, and
# the densities of the acceleration, of its noise for unit white noise in the position (or speed),
# and of the torque.
_Spectra = tuple[Array, Array, Array, Array, Array]


def resolve(recording: Measurement, band: float | None = None) -> Resolution:
    """Determine the signal-to-noise ratio of a recording in a band in Hz, chosen if left out."""
    fs = 1.0 / recording.period
    spectra = _spectra(recording)
    reason: Reason = "sampling" if band is None else "asked"
    if spectra is None:
        widest = WIDEST * (recording.pace or fs)
        return Resolution(widest if band is None else band, reason, 0.0, math.inf)
    frequency, width, motion, unit_noise, _ = spectra
    # a position is assumed to be noise above 0.3 of the sampling rate, where no joint moves
    quiet = frequency >= 0.3 * fs
    floor = float(np.median(motion[quiet] / unit_noise[quiet])) if quiet.any() else 0.0
    variance = max(floor, _steps(recording))
    if band is None:
        band, reason = _choose(recording, spectra, variance)
    inside = frequency <= band
    inside[0] = True
    noise = float((unit_noise * width)[inside].sum()) * variance
    power = float((motion * width)[inside].sum()) - noise
    ratio = math.sqrt(max(power, 0.0) / noise) if noise > 0.0 else math.inf
    return Resolution(float(band), reason, math.sqrt(variance), ratio)


def finest_step(position: Array, *, smallest: int = 100, uneven: float = 0.1) -> float:
    """Find the common divisor of differences of positions by Euclid's algorithm; 0 for none."""
    gaps = np.diff(np.unique(position))
    # rounding of a conversion of units is no encoder step
    rounding = 64.0 * float(np.finfo(np.float64).eps) * float(np.abs(position).max())
    gaps = np.sort(gaps[gaps > rounding])[:smallest]
    if not gaps.size:
        return 0.0
    step = float(gaps.min())
    while True:
        left = np.abs(gaps - step * np.round(gaps / step))
        left = left[left > max(uneven * step, rounding)]
        if not left.size:
            return step
        step = float(left.min())


def lowpass_above(band: float, fs: float, times: float = 3.0) -> float:
    """Return the cut-off in Hz of a position's low-pass that hardly attenuates a band.

    A lower one attenuates the model's torque (0.4 % at the end of half of it); a higher one makes
    power flow uncertain, and load-dependent friction is off by a third of its sd.
    """
    return min(times * band, 0.2 * fs)


def _choose(
    recording: Measurement,
    spectra: _Spectra,
    variance: float,
    *,
    local: float = 10.0,
    overall: float = 300.0,
    least_outputs: float = 60.0,
) -> tuple[float, Reason]:
    """Choose the widest band that position, torque and sampling allow.

    ``local`` and ``overall`` are the least signal-to-noise ratios (power) of the acceleration, at
    each frequency and over the band: about the inverse share of an inertia that is lost.
    """
    fs, (f, width, motion, unit_noise, torque) = 1.0 / recording.period, spectra
    ends: list[tuple[float, Reason]] = [(WIDEST * (recording.pace or fs), "sampling")]
    if variance > 0.0:
        noise = unit_noise * variance
        # from the frequency of the largest speeds on: below there is little to resolve
        peak = int(np.argmax(motion / f**2))
        ratio = np.cumsum(motion * width) / np.cumsum(noise * width) - 1.0
        # beyond a ratio of 1e7 noise does not matter under any weighting
        poor = (motion < (1.0 + local) * noise) & (ratio < 1e7)
        ended = np.flatnonzero((poor | (ratio < overall))[peak + 1 :])
        if ended.size:
            ends.append((float(f[peak + ended[0]]), "position"))
        # A torque without power is no sufficient reason: a smoothly driven joint jolts when it
        # reverses, and inertia and friction balance at all frequencies.
        unresolved = ratio[min(int(np.searchsorted(f, WIDEST * fs)), f.size - 1)] < 1e4
        if unresolved and np.ptp(recording.torque):
            power = np.cumsum(torque * width)
            last = min(int(np.searchsorted(power, 0.999 * power[-1])), f.size - 1)
            ends.append((float(f[last]), "torque"))
    band, reason = min(ends)
    used = recording.time.size - int(recording.excluded.sum())
    least = min(0.5 * least_outputs * fs / max(used, 1), WIDEST * fs)
    if not band >= least:  # NaN for a joint that never moves
        band, reason = least, "length"
    widest = recording.widest_band
    return (band, reason) if widest is None or band <= widest else (widest, "model")


def _steps(recording: Measurement) -> float:
    """Variance of the rounding of a quantised position; 0 for others."""
    levels = np.unique(recording.position if recording.velocity is None else recording.velocity)
    if not 3 <= levels.size <= recording.time.size / 3:
        return 0.0
    return float(np.min(np.diff(levels))) ** 2 / 12.0


def _spectra(recording: Measurement, least: int = 64) -> _Spectra | None:
    """Estimate the spectra; ``None`` without a segment of ``least`` samples."""
    from scipy.signal import welch

    fs = 1.0 / recording.period
    moved, order = recording.velocity, 1
    if moved is None:
        moved, order = recording.position, 2
    parts = [slice(a, b) for a, b in recording.segments if b - a >= least]
    parts = [part for part in parts if not recording.excluded[part].all()]
    if not parts:
        return None
    longest = max(p.stop - p.start for p in parts)
    size = max(least // 2, min(longest // 4, int(4.0 * fs)))
    f = np.fft.rfftfreq(size, recording.period).astype(np.float64)
    total, motion, torque = 0.0, np.zeros_like(f), np.zeros_like(f)
    for part in parts:
        weight = float(part.stop - part.start)
        # differences have hardly any leakage from slow motion, unlike the position
        steps = np.diff(moved[part], order) * fs**order
        _, power = welch(steps, fs, nperseg=min(size, steps.size), nfft=size)
        motion = motion + weight * power
        _, power = welch(recording.torque[part], fs, nperseg=min(size, steps.size), nfft=size)
        total, torque = total + weight, torque + weight * power
    # differences of white noise of variance one: (2 sin(w/2))^2 each
    noise: Array = 2.0 / fs * (2.0 * fs * np.sin(np.pi * f / fs)) ** (2 * order)
    # neighbours are averaged, more of them the higher they are
    edges = [1]
    while edges[-1] < f.size:
        edges.append(max(edges[-1] + 1, int(edges[-1] * 1.15)))
    edges[-1] = f.size
    counts = np.diff(edges)

    def mean(x: Array) -> Array:
        return np.add.reduceat(x, edges[:-1]) / counts

    width = counts * (f[1] - f[0])
    return mean(f), width, mean(motion / total), mean(noise), mean(torque / total)
