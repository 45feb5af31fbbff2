"""Searches over place: sinusoidal disturbances, transient disturbances and far delays.

A search is one candidate: its statistic is the maximum over all places, and the maxima of the
replicates are its null distribution.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from bayesfric.diagnostics.autocorrelation import Layout
from bayesfric.diagnostics.motion import MotionSignals
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.filters import later
from bayesfric.recordings.observation import FAR_DELAYS, command_rate, target_torque

SINUSOID, TRANSIENT, DELAY, TARGET_DELAY = "tone", "push", "delay", "target_delay"
# Delay of the position, or of a target that the torque is computed from.
DELAYS = DELAY, TARGET_DELAY


@dataclass(frozen=True)
class Scan:
    """Maximum of one search."""

    kind: str  # SINUSOID, TRANSIENT, or one of :data:`DELAYS`
    # reduction of the residual's sum of squares over the residual's variance, about twice the rise
    # of the log-likelihood; for sinusoids and delays the variance is that after the fit
    peak: float
    place: float  # Hz of a sinusoid, s of a transient or delay
    recording: int = 0  # index of the recording with the transient


def sinusoidal_disturbance(y: Array, layout: Layout) -> Scan:
    """Find the largest peak of the periodogram of a whitened residual ``(n,)``.

    The power P of a frequency is chi squared with two degrees of freedom in white noise; the gain
    is ``P / (1 - P/n)``, which orders peaks as Fisher's test does (Proceedings of the Royal Society
    A 125 (1929) 54-59). Frequencies are from two periods of the recording to 0.45 of the rate.
    """
    step, span, size, places = layout.grid
    rows = np.bincount(places, y, len(layout.at) * size).reshape(-1, size)
    power = (np.abs(np.fft.rfft(rows)) ** 2).sum(axis=0)
    f = np.fft.rfftfreq(size, step)
    inside = (f >= 2.0 / span) & (f <= 0.45 / step)
    power = np.where(inside, power, 0.0) / (0.5 * float(y @ y))
    power = power / np.maximum(1.0 - power / y.size, 1e-6)
    i = int(np.argmax(power))
    shift = 0.0
    if i:  # interpolate between the frequencies of the grid
        low, mid, high = power[i - 1 : i + 2]
        shift = 0.5 * (low - high) / (low - 2.0 * mid + high)
    return Scan(SINUSOID, float(power[i]), float(f[i] + shift * f[1]))


def transient_disturbance(y: Array, layout: Layout, width: float) -> Scan:
    """Find the window in which the mean of a whitened residual ``(n,)`` deviates most.

    It is three widths long, and has at least three outputs.
    """
    best = Scan(TRANSIENT, 0.0, 0.0)
    variance = float(np.mean(y**2))
    for k, (t, x) in enumerate(zip(layout.stamps, layout.split(y), strict=True)):
        centres = np.arange(t[0] + width, t[-1], width)
        first = np.searchsorted(t, centres - 1.5 * width)
        last = np.searchsorted(t, centres + 1.5 * width)
        sums = np.concatenate([[0.0], np.cumsum(x)])
        counts = last - first
        gains = np.where(counts >= 3, (sums[last] - sums[first]) ** 2, 0.0)
        gains /= np.maximum(counts, 1) * variance
        if gains.size and gains.max() > best.peak:
            i = int(np.argmax(gains))
            best = Scan(TRANSIENT, float(gains[i]), float(centres[i]), k)
    return best


def sinusoid_columns(layout: Layout, hertz: float) -> Array:
    """Return sine and cosine for each of K recordings, ``(n, 2 K)``."""
    angle = 2.0 * np.pi * hertz * np.concatenate(layout.stamps)
    members = layout.members
    return np.stack(
        [wave(angle) * member for member in members for wave in (np.sin, np.cos)], axis=1
    )


def transient_columns(layout: Layout, scan: Scan, width: float) -> Array:
    """Return five bell curves ``(n, 5)`` around a transient, spaced by their sd ``width``, s."""
    t = np.concatenate(layout.stamps)[:, None]
    bells = np.exp(-0.5 * ((t - scan.place) / width - np.arange(-2, 3)) ** 2)
    return np.asarray(bells * layout.members[scan.recording][:, None])


def tune_frequency(
    y: Array, layout: Layout, hertz: float, project: Callable[[Array], Array]
) -> float:
    """Refine a sinusoid's frequency by four Gauss-Newton steps on a residual ``(n,)``.

    Columns ``(t - t0) cos`` and ``(t - t0) sin`` are fitted as b2 and b3 together with ``b0 sin +
    b1 cos``; the step of the angular frequency is ``(b0 b2 - b1 b3) / (b0^2 + b1^2)``, summed over
    recordings. ``project`` whitens columns and projects the model's out.
    """
    t = np.concatenate(layout.stamps)
    longest = 0.2 / max(float(np.ptp(stamps)) for stamps in layout.stamps)
    middle = float(t.mean())
    for _ in range(4):
        numerator = denominator = 0.0
        angle = 2.0 * np.pi * hertz * t
        wave = np.stack([np.sin(angle), np.cos(angle)], axis=1)
        derivatives = (t - middle)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        for member in layout.members:
            x = project(np.column_stack([wave, derivatives]) * member[:, None])
            b = np.linalg.lstsq(x, y, rcond=1e-9)[0]
            numerator += float(b[0] * b[2] - b[1] * b[3])
            denominator += float(b[0] ** 2 + b[1] ** 2)
        step = numerator / max(denominator, 1e-300) / (2.0 * np.pi)
        hertz += float(np.clip(step, -longest, longest))
    return hertz


def delay_columns(m: MotionSignals) -> Mapping[float, tuple[Array, Array]]:
    """Return the change of the torque over each far delay, and its rate then, ``(N,)`` each.

    A position that is late by d belongs to the torque ``y(t - d)``, see
    :mod:`bayesfric.recordings.observation`.
    """
    if m.chain.delay:
        return {}
    if m.chain.by_target:
        command, r = target_torque(m.recording), m.recording
        # from 0.01 s one linear column no longer suffices
        return {
            d: (m.smooth(command - target_torque(r, d)), command_rate(m.o, r, d))
            for d in (0.01, *FAR_DELAYS)
        }
    torque = m.smooth(m.o.torque)
    delays = [d for late in FAR_DELAYS for d in (late, -late)]
    delayed, is_known = np.empty((len(delays), torque.size)), np.zeros((len(delays), torque.size))
    for delay, row, valid in zip(delays, delayed, is_known, strict=True):
        samples = delay / m.recording.period
        for begin, end in m.recording.segments:
            row[begin:end] = later(torque[begin:end], samples)
            valid[begin + math.ceil(max(samples, 0.0)) : end + math.floor(min(samples, 0.0))] = 1.0
    pairs = zip((torque - delayed) * is_known, m.rate(delayed) * is_known, strict=True)
    return dict(zip(delays, pairs, strict=True))
