"""What a posterior predicts of measurements that its likelihood did not see.

A fit may follow the recordings it was made from and still predict others badly. So the torque of
a held-out recording, or of a recording's end, is predicted from its motion by posterior draws,
noise included, to be compared with what was measured.
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

# Draws of the posterior that are used, and numbers held at once.
_DRAWS = 400
_BUDGET = 20_000_000
_BLOCK = 1_000_000


@dataclass(frozen=True, eq=False)
class Prediction:
    """Posterior predictive of a held-out part, each output by itself.

    It is a mixture with one component a draw: that draw's modelled torque, and about it
    one residual of that draw's noise. The noise's correlation with neighbouring outputs is not
    used: the prediction is made from the motion alone.
    """

    held_out: HeldOut  # What is predicted, with its measured torque
    torque: Array  # (n, M) modelled by each of n draws, filtered like the measured one, N m or N
    noise: Any  # SciPy's distribution of a residual in each draw, of shape (n, 1)
    # What the recording would have of its own but no fit has seen, noise scale or offset: each draw
    # takes them from one fitted recording, picked at random
    borrowed: tuple[str, ...]

    @property
    def measured(self) -> Array:
        """Measured torque of the outputs, ``(M,)``, N m or N."""
        return self.held_out.observation.measured

    @property
    def mean(self) -> Array:
        """Predictive mean, ``(M,)``."""
        return np.asarray(self.torque.mean(axis=0))

    @property
    def variance(self) -> Array:
        """Predictive variance, ``(M,)``: of the torque over draws, plus the noise's mean one.

        Infinite where the noise has none.
        """
        return np.asarray(self.torque.var(axis=0) + np.mean(self.noise.var()))

    @cached_property
    def pit(self) -> Array:
        """Probability integral transform, ``(M,)``: the predicted one of less than was measured.

        Uniform between 0 and 1 where predictions are right [1]_.

        References
        ----------
        .. [1] A. P. Dawid, "Statistical theory: the prequential approach", Journal of the Royal
           Statistical Society A 147 (1984) 278-292.
        """
        found, at_once = np.empty(self.measured.size), max(1, _BLOCK // len(self.torque))
        for begin in range(0, found.size, at_once):
            part = slice(begin, begin + at_once)
            below = self.noise.cdf(self.measured[part] - self.torque[:, part])
            found[part] = below.mean(axis=0)
        return found


def predict_held_out(
    target: Target, posterior: Posterior, held_out: Sequence[HeldOut]
) -> tuple[Prediction, ...]:
    """Predict what was held out, with the posterior of a finished fit of the torque.

    The end of a fitted recording is predicted with that recording's own noise scale and
    offset. Those of a recording that was held out as a whole are not known; where recordings
    have their own, the predictive is a mixture over those of the fitted ones.
    """
    likelihood = target.likelihood
    if not isinstance(likelihood, TorqueLikelihood):
        raise TypeError("only the torque is predicted")
    chain, noise = likelihood.chain, likelihood.noise
    names = [o.name for o in likelihood.observations]
    rng = np.random.default_rng(np.random.SeedSequence(posterior.seed, spawn_key=(6,)))
    found = []
    for one in held_out:
        outputs = one.observation.measured.size
        draws = posterior.flat(min(_DRAWS, max(50, _BUDGET // outputs)))
        n = len(draws)
        values = target.chain_values(draws)
        scales = target.noise.scales(draws[:, len(target.free) :])
        like, borrowed = np.full(n, names.index(one.name) if one.name in names else 0), []
        if one.name not in names:
            like = rng.integers(len(names), size=n)
            borrowed += ["noise scale"] if np.ptp(target.noise.places, axis=0).any() else []
            borrowed += ["offset"] if chain.own_offsets else []
        torque = np.empty((n, outputs))
        for r in np.unique(like):
            # a recording's offset goes by its name
            inputs = replace(one.observation.inputs, recording=names[r])
            alike = replace(one.observation, inputs=inputs)
            torque[like == r] = filtered_torque(chain, alike, values[like == r])
        found.append(
            Prediction(one, torque, noise.marginal(scales[np.arange(n), like]), tuple(borrowed))
        )
    return tuple(found)
