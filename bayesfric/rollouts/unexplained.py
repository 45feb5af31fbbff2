"""The torque that a model leaves unexplained, drawn anew for motions to come.

What residuals of fitted recordings are made of, nobody knows: some of it is noise of sensors and
moves no joint, some of it is friction that the model lacks, and does. So pieces of the residuals
themselves are played to the joint (the stationary bootstrap, Politis and Romano 1994, which keeps
what neighbours have in common), and how much of them is found from the motions that were fitted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesfric.finished_run import Finished
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.sampling.convergence import autocorrelation

Array = NDArray[np.float64]

# Draws that the residuals are those of the mean of.
_DRAWS = 100
# Mean length of a piece in times over which residuals remember, and outputs at least.
_MEMORIES, _LEAST = 10.0, 10
# Of the outputs, the longest memory that is looked for.
_LONGEST = 0.1


@dataclass(frozen=True, eq=False)
class Series:
    """Residuals of one recording, N m or N, one each ``period`` s."""

    values: Array
    period: float


def unexplained(posterior: Finished) -> list[Series]:
    """Take the torque residuals of every fitted recording."""
    likelihood = TorqueLikelihood(posterior.joint, posterior.model.observations)
    predicted = likelihood.predict(posterior.values(posterior.picked(_DRAWS)))
    return [
        Series(o.measured - rows.mean(axis=0), o.period)
        for o, rows in zip(posterior.model.observations, predicted, strict=True)
    ]


def played(
    series: list[Series], draws: int, samples: int, period: float, rng: np.random.Generator
) -> Array:
    """Draw torques ``(draws, samples)``, one each ``period`` s, of pieces of residuals.

    A piece is of any recording, begins anywhere in it, and has either sign; between its outputs
    the torque goes straight.
    """
    lengths = np.array([one.values.size for one in series], dtype=np.float64)
    memories = [memory(one.values) for one in series]
    duration = samples * period
    out = np.zeros((draws, samples))
    time = np.arange(samples) * period
    for row in out:
        stamps, values, now = [], [], 0.0
        while now <= duration:
            k = int(rng.choice(len(series), p=lengths / lengths.sum()))
            one = series[k]
            mean = max(_LEAST, _MEMORIES * memories[k])
            length = min(1 + int(rng.geometric(1.0 / mean)), one.values.size)
            first = int(rng.integers(one.values.size))
            place = (first + np.arange(length)) % one.values.size
            stamps.append(now + one.period * np.arange(length))
            values.append(rng.choice((-1.0, 1.0)) * one.values[place])
            now = stamps[-1][-1] + one.period
        row[:] = np.interp(time, np.concatenate(stamps), np.concatenate(values))
    return out


def memory(values: Array) -> float:
    """Integrated autocorrelation time in outputs, up to the first correlation below zero."""
    if not np.ptp(values) > 0.0:
        return 1.0
    r = autocorrelation(values[np.newaxis])[1 : max(2, int(_LONGEST * values.size))]
    end = int(np.argmax(r <= 0.0)) if (r <= 0.0).any() else r.size
    return 1.0 + 2.0 * float(r[:end].sum())
