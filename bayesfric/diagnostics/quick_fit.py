"""A fit without sampling: one Gauss-Newton step from where the truth is known to be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesfric.estimates.torque import filtered_torque
from bayesfric.identifiability.local import units_of
from bayesfric.identifiability.virtual_recording import scaled_jacobian, torque_noise
from bayesfric.inference.target import Target
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

# Longest step, in units of the parameters, along which quantities are taken to be linear.
_SMALL = 1e-3


@dataclass(frozen=True, eq=False)
class QuickFit:
    """What a fit finds of recordings without noise in the torque."""

    # (d,) sampled parameters a small ``share`` of the way from the truth to the estimate: how
    # any quantity changes is asked there, since steps along what is open may be of any length
    nearby: Array
    share: float
    # mean square of what the model then cannot explain, over the variance of the noise
    unexplained: float


def quick_fit(
    target: Target, truth: Array, observations: Sequence[Observation], prior_sds: Array
) -> QuickFit:
    """Fit replays whose torque has no noise, starting at the truth ``(d,)`` they were made with.

    Filters, steps of the encoder and differentiation make the modelled torque differ from the
    simulated one. By how much that moves an estimate is asked of a posterior with the noise of
    the truth, as a normal about it: the torque is linear in nearly every parameter. The prior
    counts as one more measurement, of sd ``prior_sds`` ``(free,)`` and centred on the truth: its
    pull is meant, and no bias.
    """
    k = len(target.free)
    at = units_of(target, truth)
    values = target.chain_values(truth[None])[0]
    rows, errors = [], []
    for number, observation in enumerate(observations):
        noise = torque_noise(target, truth, number)
        error = observation.measured - filtered_torque(
            target.likelihood.chain, observation, values[None]
        )
        errors.append(noise.whitened(error, observation)[0])
        rows.append(scaled_jacobian(target, observation, values, at, noise))
    jacobian, error = np.concatenate(rows), np.concatenate(errors)
    information = jacobian.T @ jacobian + np.diag((at.units / prior_sds) ** 2)
    step = np.asarray(np.linalg.lstsq(information, jacobian.T @ error)[0], dtype=np.float64)
    share = _SMALL / max(float(np.abs(step).max(initial=0.0)), _SMALL)
    nearby = np.concatenate([at.moved(truth[:k], share * step), truth[k:]])
    left = error - jacobian @ step
    return QuickFit(nearby, share, float(np.mean(left**2)))
