"""What is looked for at any place: a tone of any frequency, a push at any time, a far delay.

A scan is one candidate, however many places it has: its statistic is the largest of all, and what
chance makes of that the replicates' largest show.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from bayesfric.diagnostics.along import Along
from bayesfric.diagnostics.memory import Layout
from bayesfric.recordings.acting import commanded
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.filters import later
from bayesfric.recordings.timing import FAR_DELAYS, command_rate

TONE, PUSH, DELAY, TARGET_DELAY = "tone", "push", "delay", "target_delay"
# Of the position, or of a target that the torque is computed from.
DELAYS = DELAY, TARGET_DELAY
# Lower and upper end of the frequencies, in periods of the recording and of the sampling.
_PERIODS, _NYQUIST = 2.0, 0.45
# Steps to a frequency, and the longest in periods of the recording.
_TUNINGS, _FURTHEST = 4, 0.2
# Half of a push in its widths, and outputs that it has at least.
_HALF, _FEW = 1.5, 3
_ROUNDING = 1e-9
# Delay of a target, s, about which shorter ones are linear enough to be found.
_NEAR_DELAY = 0.01


@dataclass(frozen=True)
class Scan:
    """The largest of one kind, as a gain of chi squared."""

    kind: str  # tone, push, or one of :data:`DELAYS`
    # What it takes of the residual's sum of squares, in variances of the residual: about how much
    # twice the log-likelihood rises. A tone's and a delay's variance is of what they leave
    peak: float
    place: float  # Hz of a tone, s of a push and of a delay
    recording: int = 0  # Number of the one that a push is in


def tone(y: Array, layout: Layout) -> Scan:
    """Find the largest peak of a whitened residual's periodogram, over what it leaves.

    The power P of a frequency is scaled to chi squared of two degrees of freedom in white noise;
    the gain is ``P / (1 - P/n)``, which orders peaks as Fisher's test of hidden periods does [1]_.
    Frequencies go from two periods of the longest recording to 0.45 of the rate.

    References
    ----------
    .. [1] R. A. Fisher, "Tests of significance in harmonic analysis", Proceedings of the Royal
       Society A 125 (1929) 54-59.

    Shapes: ``y`` (n,).
    """
    step, span, size, at = layout.grid
    rows = np.bincount(at, y, len(layout.at) * size).reshape(-1, size)
    power = (np.abs(np.fft.rfft(rows)) ** 2).sum(axis=0)
    f = np.fft.rfftfreq(size, step)
    inside = (f >= _PERIODS / span) & (f <= _NYQUIST / step)
    power = np.where(inside, power, 0.0) / (0.5 * float(y @ y))
    power = power / np.maximum(1.0 - power / y.size, 1e-6)
    i = int(np.argmax(power))
    shift = 0.0
    if i:  # between the frequencies of the grid
        low, mid, high = power[i - 1 : i + 2]
        shift = 0.5 * (low - high) / (low - 2.0 * mid + high)
    return Scan(TONE, float(power[i]), float(f[i] + shift * f[1]))


def push(y: Array, layout: Layout, width: float) -> Scan:
    """Find where the mean of a whitened residual over a short while is the farthest off.

    Shapes: ``y`` (n,), returns (sum y)^2 / (count var(y)).
    """
    best = Scan(PUSH, 0.0, 0.0)
    variance = float(np.mean(y**2))
    for k, (t, x) in enumerate(zip(layout.stamps, layout.split(y), strict=True)):
        centres = np.arange(t[0] + width, t[-1], width)
        first = np.searchsorted(t, centres - _HALF * width)
        last = np.searchsorted(t, centres + _HALF * width)
        sums = np.concatenate([[0.0], np.cumsum(x)])
        many = last - first
        gains = np.where(many >= _FEW, (sums[last] - sums[first]) ** 2, 0.0)
        gains /= np.maximum(many, 1) * variance
        if gains.size and gains.max() > best.peak:
            i = int(np.argmax(gains))
            best = Scan(PUSH, float(gains[i]), float(centres[i]), k)
    return best


def waves(layout: Layout, hertz: float) -> Array:
    """Sine and cosine of a tone, of each of K recordings its own, ``(n, 2 K)``."""
    angle = 2.0 * np.pi * hertz * np.concatenate(layout.stamps)
    own = layout.members
    return np.stack([wave(angle) * one for one in own for wave in (np.sin, np.cos)], axis=1)


def bump(layout: Layout, scan: Scan, width: float) -> Array:
    """Give what a push is taken for, ``(n, 5)``: bells over its place and beside, of any course.

    Their standard deviation, and the distance from one to the next, is ``width`` (s).
    """
    t = np.concatenate(layout.stamps)[:, None]
    bells = np.exp(-0.5 * ((t - scan.place) / width - np.arange(-2, 3)) ** 2)
    return np.asarray(bells * layout.members[scan.recording][:, None])


def tuned(y: Array, layout: Layout, hertz: float, left: Callable[[Array], Array]) -> float:
    """Tune a tone's frequency by Gauss and Newton.

    Beside ``b0 sin + b1 cos`` stand ``(t - t0) cos`` and ``(t - t0) sin``, fitted as b2 and b3; the
    step of the angular frequency is ``(b0 b2 - b1 b3) / (b0^2 + b1^2)``, sums over recordings.

    Shapes: ``y`` (n,), ``left`` (n, k).
    """
    t = np.concatenate(layout.stamps)
    span = max(float(np.ptp(one)) for one in layout.stamps)
    middle = float(t.mean())
    for _ in range(_TUNINGS):
        above = below = 0.0
        angle = 2.0 * np.pi * hertz * t
        wave = np.stack([np.sin(angle), np.cos(angle)], axis=1)
        turned = (t - middle)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        for here in layout.members:
            x = left(np.column_stack([wave, turned]) * here[:, None])
            b = np.linalg.lstsq(x, y, rcond=_ROUNDING)[0]
            above += float(b[0] * b[2] - b[1] * b[3])
            below += float(b[0] ** 2 + b[1] ** 2)
        step = above / max(below, 1e-300) / (2.0 * np.pi)
        hertz += float(np.clip(step, -_FURTHEST / span, _FURTHEST / span))
    return hertz


def late(a: Along) -> Mapping[float, tuple[Array, Array]]:
    """Give what the recorded torque has changed by since another time, and how fast it did then.

    A position that comes late by d belongs to the torque of then, ``y(t - d)``, see
    :mod:`bayesfric.recordings.timing`.
    """
    if a.chain.delay:
        return {}
    if a.chain.by_target:
        now, r = commanded(a.recording), a.recording
        far = _NEAR_DELAY, *FAR_DELAYS
        return {d: (a.smooth(now - commanded(r, d)), command_rate(a.o, r, d)) for d in far}
    torque = a.smooth(a.o.torque)
    delays = [d for late in FAR_DELAYS for d in (late, -late)]
    then, known = np.empty((len(delays), torque.size)), np.zeros((len(delays), torque.size))
    for delay, row, there in zip(delays, then, known, strict=True):
        samples = delay / a.recording.period
        for begin, end in a.recording.segments:
            row[begin:end] = later(torque[begin:end], samples)
            there[begin + math.ceil(max(samples, 0.0)) : end + math.floor(min(samples, 0.0))] = 1.0
    both = zip((torque - then) * known, a.rate(then) * known, strict=True)
    return dict(zip(delays, both, strict=True))
