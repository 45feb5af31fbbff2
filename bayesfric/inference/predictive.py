"""Posterior prediction of recordings, or ends of recordings, that the likelihood did not use.

The torque is predicted from the motion alone, noise included, and compared with the measured one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from bayesfric.estimates.torque import filtered_torque
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.posterior import Posterior
from bayesfric.inference.target import Target
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.held_out import HeldOut

# Numbers of predicted torque, and of probabilities, in memory at once.
_BUDGET, _BLOCK = 20_000_000, 1_000_000


@dataclass(frozen=True, eq=False)
class Prediction:
    """Posterior predictive of a held-out part, output by output.

    A mixture with a component for each draw: its modelled torque plus a residual of its noise. The
    noise's correlation with previous outputs is not used.
    """

    held_out: HeldOut
    torque: Array  # (n, M) filtered torque of each draw, N m or N
    noise: Any  # SciPy's distribution of a residual, of shape (n, 1)
    # noise scale or offset unknown for this recording: each draw uses those of a random fitted one
    borrowed: tuple[str, ...]

    @property
    def measured(self) -> Array:
        """Measured torque ``(M,)``, N m or N."""
        return self.held_out.observation.measured

    @property
    def mean(self) -> Array:
        """Predictive mean, ``(M,)``."""
        return np.asarray(self.torque.mean(axis=0))

    @property
    def variance(self) -> Array:
        """Predictive variance ``(M,)``; infinite if the noise has none."""
        return np.asarray(self.torque.var(axis=0) + np.mean(self.noise.var()))

    @cached_property
    def pit(self) -> Array:
        """Probability integral transform ``(M,)``, uniform for right predictions.

        A. P. Dawid, "Statistical theory: the prequential approach", Journal of the Royal
        Statistical Society A 147 (1984) 278-292.
        """
        pit_, at_once = np.empty(self.measured.size), max(1, _BLOCK // len(self.torque))
        for begin in range(0, pit_.size, at_once):
            part = slice(begin, begin + at_once)
            below = self.noise.cdf(self.measured[part] - self.torque[:, part])
            pit_[part] = below.mean(axis=0)
        return pit_


def predict_held_out(
    target: Target, posterior: Posterior, held_out: Sequence[HeldOut]
) -> tuple[Prediction, ...]:
    """Predict held-out torque with the posterior of a fit.

    The end of a fitted recording has that recording's noise scale and offset. For a recording of
    its own they are unknown, and the predictive is a mixture over those of the fitted ones.
    """
    likelihood = target.likelihood
    if not isinstance(likelihood, TorqueLikelihood):
        raise TypeError("only the torque is predicted")
    chain, noise = likelihood.chain, likelihood.noise
    names = [o.name for o in likelihood.observations]
    rng = np.random.default_rng(np.random.SeedSequence(posterior.seed, spawn_key=(6,)))
    predictions = []
    for part in held_out:
        outputs = part.observation.measured.size
        draws = posterior.flat(min(400, max(50, _BUDGET // outputs)))
        n = len(draws)
        values = target.chain_values(draws)
        scales = target.noise.scales(draws[:, len(target.free) :])
        source, borrowed = np.full(n, names.index(part.name) if part.name in names else 0), []
        if part.name not in names:
            source = rng.integers(len(names), size=n)
            borrowed += ["noise scale"] if np.ptp(target.noise.places, axis=0).any() else []
            borrowed += ["offset"] if chain.own_offsets else []
        torque = np.empty((n, outputs))
        for r in np.unique(source):
            inputs = replace(part.observation.inputs, recording=names[r])
            observation = replace(part.observation, inputs=inputs)
            torque[source == r] = filtered_torque(chain, observation, values[source == r])
        predictions.append(
            Prediction(part, torque, noise.marginal(scales[np.arange(n), source]), tuple(borrowed))
        )
    return tuple(predictions)
