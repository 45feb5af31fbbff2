"""What is looked for at any place: a tone of any frequency, a push at any time.

A scan is one candidate, however many places it has: its statistic is the largest of all, and what
chance makes of that the twins' largest tell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayesfric.diagnostics.memory import Layout
from bayesfric.recordings.arrays import Array

TONE, PUSH, DELAY = "tone", "push", "delay"
# Lower and upper end of the frequencies, in periods of the recording and of the sampling.
_PERIODS, _NYQUIST = 2.0, 0.45
# Steps to a frequency, and the longest in periods of the recording.
_TUNINGS, _FURTHEST = 4, 0.2
# Half of a push in its widths, and outputs that it has at least.
_HALF, _FEW = 1.5, 3
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Scan:
    """The largest of one kind, as a gain of chi squared."""

    kind: str
    peak: float
    place: float  # Hz of a tone, s of a push and of a delay
    recording: int = 0  # number of the one that a push is in


def tone(y: Array, layout: Layout) -> Scan:
    """Find the largest peak of a whitened residual's periodogram, over what it leaves."""
    step, span, size, at = layout.grid
    rows = np.bincount(at, y, len(layout.at) * size).reshape(-1, size)
    power = (np.abs(np.fft.rfft(rows)) ** 2).sum(axis=0)
    f = np.fft.rfftfreq(size, step)
    inside = (f >= _PERIODS / span) & (f <= _NYQUIST / step)
    power = np.where(inside, power, 0.0) / (0.5 * float(y @ y))
    power = power / np.maximum(1.0 - power / y.size, 1e-6)
    i = int(np.argmax(power))
    shift = 0.0
    if 0 < i < power.size - 1:  # between the frequencies of the grid
        low, mid, high = power[i - 1 : i + 2]
        if low - 2.0 * mid + high < 0.0:
            shift = 0.5 * (low - high) / (low - 2.0 * mid + high)
    return Scan(TONE, float(power[i]), float(f[i] + shift * f[1]))


def push(y: Array, layout: Layout, width: float) -> Scan:
    """Find where the mean of a whitened residual over three ``width`` (s) is the farthest off."""
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
    """Sine and cosine ``(n, 2 K)`` of a tone, of each recording its own."""
    angle = 2.0 * np.pi * hertz * np.concatenate(layout.stamps)
    own = layout.members
    return np.stack([wave(angle) * one for one in own for wave in (np.sin, np.cos)], axis=1)


def bump(layout: Layout, scan: Scan, width: float) -> Array:
    """Give what a push is taken for, ``(n, 5)``: bells over its place and beside, of any course."""
    t = np.concatenate(layout.stamps)[:, None]
    bells = np.exp(-0.5 * ((t - scan.place) / width - np.arange(-2, 3)) ** 2)
    return np.asarray(bells * layout.members[scan.recording][:, None])


def tuned(y: Array, layout: Layout, hertz: float, left: Callable[[Array], Array]) -> float:
    """Tune a tone's frequency by Gauss and Newton; ``left`` whitens and takes the model's out."""
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
