"""Outputs that the fitted noise has hardly made: something else happened there.

One such output among few raises the noise that is found, and hides what the others say of the
model. They are looked for from the farthest on, each against the spread of those that are left, as
in Rosner's procedure [1]_, so that several do not hide each other.

References
----------
.. [1] B. Rosner, "Percentage points for a generalized ESD many-outlier procedure",
   Technometrics 25 (1983) 165-172.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from bayesfric.recordings.observation import Observation

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Index = NDArray[np.intp]

# Share of recordings of nothing but normal noise that have one; to look there costs little.
_SELDOM = 0.05
# Share of the outputs that are a few, or their number; more are no accident but the noise's form.
_FEW, _FEW_OF = 0.01, 3
# The same place in a motion: shares of the position's range and of the largest speed; and of how
# many such places the motion must have left it in between.
_PLACE, _SPEED, _LEFT = 0.02, 0.05, 3.0


@dataclass(frozen=True)
class Outlying:
    """One output that is too far off for noise."""

    recording: str
    time: float  # s since the file's first stamp, at the middle of what it averages
    period: float  # s from one output to the next
    times: float  # by how many sds of the other outputs it is off
    # whether another is off the same way when the motion is at the same place again: then it is
    # the motion that makes it, not something that happened
    recurs: bool = False


def far_off(innovations: Array, spent: int = 0) -> Array:
    """Sds by which each output is off where that is too far for noise, else zero, ``(M,)``.

    ``innovations`` ``(M,)`` are of one recording, what the noise's memory foretells taken off, and
    ``spent`` is how many numbers were fitted to them. All zero where too many are far off: then it
    is the noise that is not normal.
    """
    n = innovations.size
    size, found = np.abs(innovations), np.zeros(n)
    kept = np.ones(n, dtype=np.bool_)
    for _ in range(max(_FEW_OF, int(_FEW * n)) + 1):
        free = int(kept.sum()) - 1 - spent
        farthest = int(np.argmax(np.where(kept, size, -1.0)))
        kept[farthest] = False
        sd = float(np.sqrt(np.sum(innovations[kept] ** 2) / free)) if free > 0 else np.inf
        # of t, and by Bonferroni: any of the outputs may be the one
        bound = float(stats.t.isf(0.5 * _SELDOM / n, free)) if free > 0 else np.inf
        if not size[farthest] > bound * sd > 0.0:
            return found
        found[farthest] = size[farthest] / sd
    return np.zeros(n)


def _recurring(o: Observation, far: Index, signs: Array) -> list[bool]:
    """Tell which of the outputs ``far`` are off the same way at the same place in the motion."""
    if far.size < 2:
        return [False] * far.size
    q, qd = o.q[o.filter.centres], o.qd[o.filter.centres]
    # no nearer than from one output to the next
    near_q = _PLACE * np.ptp(q) + o.period * np.abs(qd)
    near_qd = _SPEED * np.abs(qd).max() + o.period * np.abs(o.acceleration)

    def again(i: int, k: int) -> bool:
        if np.sign(qd[i]) != np.sign(qd[k]) or signs[i] != signs[k]:
            return False
        apart = np.maximum(np.abs(q - q[i]) / near_q[i], np.abs(qd - qd[i]) / near_qd[i])
        between = apart[min(i, k) : max(i, k)]
        return bool(apart[k] <= 1.0 and between.max() > _LEFT)

    places = far.tolist()
    return [any(again(i, k) for k in places if k != i) for i in places]


def outlying(
    innovations: Array, observations: Sequence[Observation], spent: int, memory: int
) -> tuple[tuple[Outlying, ...], Flags]:
    """Name outputs of all recordings that are too far off, the farthest first.

    ``innovations`` ``(M,)`` of all recordings, one after the other. The second, ``(M,)``, says
    which outputs hold nothing of them: neither they nor the ``memory`` next ones, whose
    innovations they are part of.
    """
    found: list[Outlying] = []
    clean = np.ones(innovations.size, dtype=np.bool_)
    begin: int = 0
    for o in observations:
        n = int(o.measured.size)
        times = far_off(innovations[begin : begin + n], spent)
        far = np.flatnonzero(times)
        again = _recurring(o, far, np.sign(innovations[begin : begin + n]))
        for i, recurs in zip(far.tolist(), again, strict=True):
            found.append(Outlying(o.name, float(o.time[i]), o.period, float(times[i]), recurs))
            clean[begin + i : begin + min(i + memory + 1, n)] = False
        begin += n
    return tuple(sorted(found, key=lambda one: one.times, reverse=True)), clean
