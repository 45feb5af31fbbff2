"""Resolution of a position, and the band in which measured and modelled torque are compared.

Differentiating twice multiplies noise and steps of the position by the square of frequency. Where
that is not far below the motion, least squares underestimates inertia (errors in variables).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import Measurement

Reason = Literal["sampling", "position", "torque", "length", "model", "asked"]

# Least signal-to-noise ratio (power) of the acceleration at each frequency, for noise models that
# weigh the band's end most, and over the band: about the share of an inertia that is lost.
_LOCAL, _OVERALL = 10.0, 300.0
# Ratio over the band beyond which the noise does not matter under any weighting.
_HARMLESS = 1e7
# Below this ratio in the widest band, the band ends where this share of the torque's power lies
# below: beyond there is little but noise.
_CLEAN, _POWER = 1e4, 0.999
# Widest band over the sampling rate.
WIDEST = 0.05
# Cut-off of the position's low-pass over the band, and its largest share of the sampling rate. A
# lower one attenuates the model's torque (0.4 % at the band's end at twice the band); with a higher
# one noise makes the power flow uncertain, and load-dependent friction is off by a third of its sd.
# Higher where samples are left out at reversals, so that their effect reaches fewer neighbours.
ABOVE, ABOVE_GAPS = 3.0, 6.0
_HIGHEST = 0.2
# Least number of outputs of a recording, which bounds the band from below.
_OUTPUTS = 60.0
# Share of the sampling rate above which a position is assumed to be noise.
_QUIET = 0.3
# Fewer samples have no spectrum.
_LEAST = 64
# Number of smallest differences of positions whose divisor is the step, and their tolerance.
_SMALLEST, _UNEVEN = 100, 0.1
# Relative rounding of a position by conversions of units.
_ROUNDING = 64.0 * float(np.finfo(np.float64).eps)
# Ratio (rms) of acceleration to its noise below which a user is warned: an inertia is too small by
# about the inverse of its square.
LEAST_RATIO = 10.0


@dataclass(frozen=True)
class Resolution:
    """The band of a recording and its signal-to-noise ratio.

    The band ends by the ``sampling`` rate, the ``position``'s noise, the ``torque``'s power, the
    ``length`` of the recording, a ``model`` (:mod:`bayesfric.estimates.processing`), or as
    ``asked``.
    """

    band: float  # Hz up to which measured and modelled torque can be compared
    reason: Reason
    noise: float  # sd of the noise of position (or speed, where measured), a sample
    acceleration_ratio: float  # rms of the acceleration over that of its noise, in the band


@dataclass(frozen=True)
class _Spectra:
    """Power densities at frequencies ``(K,)``, averaged over neighbours."""

    frequency: Array
    width: Array
    motion: Array  # of the acceleration
    noise: Array  # of the acceleration for unit white noise in the position (or speed)
    torque: Array


def resolve(recording: Measurement, band: float | None = None) -> Resolution:
    """Determine the signal-to-noise ratio of a recording in a band in Hz, chosen if left out."""
    fs = 1.0 / recording.period
    spectra = _spectra(recording)
    reason: Reason = "sampling" if band is None else "asked"
    if spectra is None:
        chosen = WIDEST * fs if band is None else band
        return Resolution(chosen, reason, 0.0, math.inf)
    # noise is the power where no joint moves, or rounding
    quiet = spectra.frequency >= _QUIET * fs
    floor = float(np.median(spectra.motion[quiet] / spectra.noise[quiet])) if quiet.any() else 0.0
    variance = max(floor, _steps(recording))
    if band is None:
        band, reason = _choose(recording, spectra, variance)
    inside = spectra.frequency <= band
    inside[0] = True
    noise = float((spectra.noise * spectra.width)[inside].sum()) * variance
    motion = float((spectra.motion * spectra.width)[inside].sum()) - noise
    ratio = math.sqrt(max(motion, 0.0) / noise) if noise > 0.0 else math.inf
    return Resolution(float(band), reason, math.sqrt(variance), ratio)


def too_coarse(resolution: Resolution, recording: Measurement) -> Iterator[str]:
    """Warn where the acceleration is not large compared to its noise."""
    if resolution.acceleration_ratio < LEAST_RATIO:
        yield (
            f"{'position' if recording.velocity is None else 'velocity'}: its noise or steps "
            f"({resolution.noise:.2g}, one sd) make the acceleration in the band to "
            f"{resolution.band:.3g} Hz only {resolution.acceleration_ratio:.2g} times as large as "
            f"its noise, at least {LEAST_RATIO:g} are needed: inertia comes out too small; "
            "lower band, or record a faster motion or a finer position"
        )


def finest_step(position: Array) -> float:
    """Find the common divisor of all differences of positions, by Euclid's algorithm; 0 for none.

    A fine encoder on a fast joint hardly ever shows a single step.
    """
    gaps = np.diff(np.unique(position))
    # rounding of a conversion of units is no encoder step
    rounding = _ROUNDING * float(np.abs(position).max())
    gaps = np.sort(gaps[gaps > rounding])[:_SMALLEST]
    if not gaps.size:
        return 0.0
    step = float(gaps.min())
    while True:
        left = np.abs(gaps - step * np.round(gaps / step))
        left = left[left > max(_UNEVEN * step, rounding)]
        if not left.size:
            return step
        step = float(left.min())


def lowpass_above(band: float, fs: float, times: float = ABOVE) -> float:
    """Return the cut-off in Hz of a position's low-pass that hardly attenuates a band."""
    return min(times * band, _HIGHEST * fs)


def _choose(recording: Measurement, spectra: _Spectra, variance: float) -> tuple[float, Reason]:
    """Choose the widest band that position, torque and sampling allow."""
    fs, f = 1.0 / recording.period, spectra.frequency
    ends: list[tuple[float, Reason]] = [(WIDEST * fs, "sampling")]
    if variance > 0.0:
        noise = spectra.noise * variance
        # from the frequency of the largest speeds on: below there is little to resolve
        peak = int(np.argmax(spectra.motion / f**2))
        ratio = np.cumsum(spectra.motion * spectra.width) / np.cumsum(noise * spectra.width) - 1.0
        poor = (spectra.motion < (1.0 + _LOCAL) * noise) & (ratio < _HARMLESS)
        ended = np.flatnonzero((poor | (ratio < _OVERALL))[peak + 1 :])
        if ended.size:
            ends.append((float(f[peak + ended[0]]), "position"))
        # A torque without power is no sufficient reason: a smoothly driven joint jolts when it
        # reverses, and inertia and friction balance at all frequencies.
        if ratio[min(int(np.searchsorted(f, WIDEST * fs)), f.size - 1)] < _CLEAN:
            power = np.cumsum(spectra.torque * spectra.width)
            last = min(int(np.searchsorted(power, _POWER * power[-1])), f.size - 1)
            ends.append((float(f[last]), "torque"))
    band, reason = min(ends)
    used = recording.time.size - int(recording.excluded.sum())
    least = min(0.5 * _OUTPUTS * fs / max(used, 1), WIDEST * fs)
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


def _spectra(recording: Measurement) -> _Spectra | None:
    from scipy.signal import welch

    fs = 1.0 / recording.period
    moved, order = (
        (recording.position, 2) if recording.velocity is None else (recording.velocity, 1)
    )
    parts = [
        slice(a, b)
        for a, b in recording.segments
        if b - a >= _LEAST and not recording.excluded[a:b].all()
    ]
    if not parts:
        return None
    longest = max(p.stop - p.start for p in parts)
    size = max(_LEAST // 2, min(longest // 4, int(4.0 * fs)))
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
    return _averaged(f, motion / total, noise, torque / total)


def _averaged(f: Array, motion: Array, noise: Array, torque: Array) -> _Spectra:
    """Average neighbours, more of them the higher they are."""
    edges = [1]
    while edges[-1] < f.size:
        edges.append(max(edges[-1] + 1, int(edges[-1] * 1.15)))
    edges[-1] = f.size
    starts = np.array(edges[:-1])
    counts = np.diff(edges)

    def mean(x: Array) -> Array:
        return np.add.reduceat(x, starts) / counts

    return _Spectra(mean(f), counts * (f[1] - f[0]), mean(motion), mean(noise), mean(torque))
