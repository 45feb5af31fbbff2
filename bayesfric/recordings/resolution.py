"""What a position resolves, where a torque has power, and the band in which to compare them.

Differentiating twice multiplies what the position does not resolve, its steps and its noise, by
the square of frequency. Where that is not far below the motion, the acceleration a model is given
is noise, and least squares then finds too small an inertia (errors in variables).
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

# The motion's power over its noise's, up to the band's end at each frequency and over the whole
# band: the first bounds what a noise model can do that weighs the end of the band most, the
# second is about the share of an inertia that white noise in the position takes away.
_LOCAL, _WHOLE = 10.0, 300.0
# Over the whole band beyond which no weighing makes the noise matter.
_HARMLESS = 1e7
# Where the motion's power is not so many times the noise's in the widest band, the band ends where
# this share of the torque's power lies below: beyond, there is little but noise to compare.
_CLEAN, _POWER = 1e4, 0.999
# Widest band over the sampling rate.
WIDEST = 0.05
# How far above the band the position's low-pass lies, at most this share of the sampling rate.
# Nearer, it takes from the model alone what the torque still has (0.4 % at the band's end at
# twice the band); further, noise from above makes the accelerations' sign, and with it the
# direction of power, uncertain: losses per torque are then off by a third of their sd. Where
# samples are left out at reversals it lies further, as it carries what they do to their
# neighbours the less far.
ABOVE, ABOVE_GAPS = 3.0, 6.0
_HIGHEST = 0.2
# Outputs that a recording should have at least: the band is not made narrower than that takes.
_OUTPUTS = 60.0
# Share of the sampling rate above which a position is taken to hold no motion.
_QUIET = 0.3
# Fewer samples show no spectrum.
_LEAST = 64
# The smallest differences of positions, of which a step is the divisor; and by how much of it they
# may miss its multiples: files round.
_SMALLEST, _UNEVEN = 100, 0.1
# Share of a position that is lost where it is converted from unit to unit.
_ROUNDING = 64.0 * float(np.finfo(np.float64).eps)
# Root mean square of acceleration over its noise below which a user is warned: an inertia then
# comes out too small by about the inverse of its square.
LEAST_RATIO = 10.0


@dataclass(frozen=True)
class Resolution:
    """What a recording resolves.

    ``reason`` is what ends the band: the ``sampling`` rate, the ``position``'s noise, that the
    ``torque`` has no power beyond, the ``length`` of the recording, below which there were too
    few outputs, what a ``model`` of the joint says of its acceleration
    (:mod:`bayesfric.estimates.attenuation`), or that it was ``asked`` for.
    """

    band: float  # Hz up to which measured and modelled torque can be compared
    reason: Reason
    noise: float  # sd of what a sample of position (or speed, where measured) does not resolve
    # rms of the acceleration over its noise's, in the band; infinite where no noise is seen
    acceleration_ratio: float


@dataclass(frozen=True)
class _Spectra:
    """Power densities at frequencies ``(K,)``, averaged over neighbours.

    ``motion`` is the acceleration's. ``noise`` is what a white series of variance one in the
    measured position (or speed) would give it; ``torque`` is the torque's.
    """

    frequency: Array
    width: Array
    motion: Array
    noise: Array
    torque: Array


def resolve(recording: Measurement, band: float | None = None) -> Resolution:
    """Look at the spectra of a recording up to a band in Hz, which is chosen if left out."""
    fs = 1.0 / recording.period
    seen = _spectra(recording)
    reason: Reason = "sampling" if band is None else "asked"
    if seen is None:
        chosen = WIDEST * fs if band is None else band
        return Resolution(chosen, reason, 0.0, math.inf)
    # a position's noise is what it shows where no joint moves, or its rounding
    quiet = seen.frequency >= _QUIET * fs
    floor = float(np.median(seen.motion[quiet] / seen.noise[quiet])) if quiet.any() else 0.0
    variance = max(floor, _steps(recording))
    if band is None:
        band, reason = _choose(recording, seen, variance)
    inside = seen.frequency <= band
    inside[0] = True
    noise = float((seen.noise * seen.width)[inside].sum()) * variance
    motion = float((seen.motion * seen.width)[inside].sum()) - noise
    ratio = math.sqrt(max(motion, 0.0) / noise) if noise > 0.0 else math.inf
    return Resolution(float(band), reason, math.sqrt(variance), ratio)


def too_coarse(found: Resolution, recording: Measurement) -> Iterator[str]:
    """Warn where the acceleration is not large beside its noise."""
    if found.acceleration_ratio < LEAST_RATIO:
        yield (
            f"{'position' if recording.velocity is None else 'velocity'}: its noise or steps "
            f"({found.noise:.2g}, one sd) make the acceleration in the band "
            f"to {found.band:.3g} Hz only {found.acceleration_ratio:.2g} times as large as its own "
            f"noise, at least {LEAST_RATIO:g} are wanted: inertia comes out too small; "
            "lower band, or record a faster motion or a finer position"
        )


def finest_step(position: Array) -> float:
    """Step that all differences of positions read are multiples of; 0 if there is none.

    A fine encoder on a fast joint hardly ever shows one step: it is their common divisor that is
    looked for, by Euclid's algorithm. A position that is not read in steps gives next to nothing.
    """
    gaps = np.diff(np.unique(position))
    # what a conversion of units left is no step of the encoder
    lost = _ROUNDING * float(np.abs(position).max())
    gaps = np.sort(gaps[gaps > lost])[:_SMALLEST]
    if not gaps.size:
        return 0.0
    step = float(gaps.min())
    while True:
        left = np.abs(gaps - step * np.round(gaps / step))
        left = left[left > max(_UNEVEN * step, lost)]
        if not left.size:
            return step
        step = float(left.min())


def lowpass_above(band: float, fs: float, times: float = ABOVE) -> float:
    """Give the cut-off in Hz of a position's low-pass that leaves a band as it is."""
    return min(times * band, _HIGHEST * fs)


def _choose(recording: Measurement, seen: _Spectra, variance: float) -> tuple[float, Reason]:
    """Take the widest band that position, torque and sampling allow."""
    fs, f = 1.0 / recording.period, seen.frequency
    ends: list[tuple[float, Reason]] = [(WIDEST * fs, "sampling")]
    if variance > 0.0:
        noise = seen.noise * variance
        # from the frequency of the largest speeds on: below there is little to resolve
        peak = int(np.argmax(seen.motion / f**2))
        ratio = np.cumsum(seen.motion * seen.width) / np.cumsum(noise * seen.width) - 1.0
        poor = (seen.motion < (1.0 + _LOCAL) * noise) & (ratio < _HARMLESS)
        ended = np.flatnonzero((poor | (ratio < _WHOLE))[peak + 1 :])
        if ended.size:
            ends.append((float(f[peak + ended[0]]), "position"))
        # A torque without power there is no reason by itself: a joint that is driven smoothly
        # jolts when it reverses, and inertia and friction balance at all frequencies.
        if ratio[min(int(np.searchsorted(f, WIDEST * fs)), f.size - 1)] < _CLEAN:
            power = np.cumsum(seen.torque * seen.width)
            last = min(int(np.searchsorted(power, _POWER * power[-1])), f.size - 1)
            ends.append((float(f[last]), "torque"))
    band, reason = min(ends)
    used = recording.time.size - int(recording.excluded.sum())
    least = min(0.5 * _OUTPUTS * fs / max(used, 1), WIDEST * fs)
    if not band >= least:  # nor a number, for a joint that never moves
        band, reason = least, "length"
    widest = recording.widest_band
    return (band, reason) if widest is None or band <= widest else (widest, "model")


def _steps(recording: Measurement) -> float:
    """Variance of the rounding of a position that is read in steps; 0 where none is seen."""
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
        # differences have no leakage from slow motion to speak of, unlike the position itself
        steps = np.diff(moved[part], order) * fs**order
        _, one = welch(steps, fs, nperseg=min(size, steps.size), nfft=size)
        _, other = welch(recording.torque[part], fs, nperseg=min(size, steps.size), nfft=size)
        total, motion, torque = total + weight, motion + weight * one, torque + weight * other
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
