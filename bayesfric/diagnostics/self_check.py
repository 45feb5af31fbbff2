"""What a fit makes of recordings like its own whose truth is known: the replicates'.

It is asked how far estimates lie from the truth, nothing else: whether the joint is what the model
takes it for, no simulation of the model can show.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from bayesfric.base.options import Options
from bayesfric.diagnostics.explanation import Explanation
from bayesfric.diagnostics.regression import Replicate
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.local_units import units_of
from bayesfric.inference.posterior import Posterior
from bayesfric.inference.target import Target
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

# Longest step, in units of the parameters, along which quantities are taken to be linear.
_SMALL = 1e-3

Reason = Literal["likelihood", "rest", "sampling", "still", "few"]


class SelfCheckOptions(Options):
    """The ``[self_check]`` table: whether the fit is tried on recordings like its own."""

    recordings: int | None = Field(
        None,
        ge=0,
        examples=[0],
        description="0 for none; else the replicates, recordings simulated like the fitted ones, are "
        "fitted anew",
    )


@dataclass(frozen=True, eq=False)
class QuickFit:
    """What a fit finds of a replicate without noise in the torque."""

    # (d,) sampled parameters, a small way from the truth towards the estimate. How any quantity
    # changes is asked there, since steps along what is open may be of any length
    nearby: Array
    share: float  # Which share of the way that is
    # Mean square of what the model then cannot explain, over the variance of the noise
    unexplained: float


@dataclass(frozen=True, eq=False)
class Checked:
    """What came of it: truths, and where fits went from them."""

    truth: Array  # (n, d) sampled parameters that replicates were made with
    fits: tuple[QuickFit, ...]  # Of each replicate
    # That it took
    seconds: float
    cpu_seconds: float
    # Why it could not be made, else None: the likelihood is not of the torque, samples at rest say
    # what a quick fit cannot use, the sampling failed, most replicates stood still, or there are too few
    # outputs
    reason: Reason | None = None
    share: float = (
        1.0  # Of the recordings' samples that replicates have: below one they are of excerpts
    )


def self_check(
    target: Target,
    posterior: Posterior,
    observations: Sequence[Observation],
    explained: Explanation,
) -> Checked:
    """Fit the replicates of recordings from where their truth is: a parametric bootstrap of the bias.

    Filters, steps of the encoder and differentiation bias an estimate: the mean over replicates of fit
    less truth is that bias [1]_. Each fit is one Gauss-Newton step, as the torque is linear in
    nearly every parameter. The replicates' torque has no noise here, so few of them show the bias well.

    References
    ----------
    .. [1] B. Efron, R. J. Tibshirani, "An Introduction to the Bootstrap", Chapman and Hall (1993).
    """
    begun, worked = time.perf_counter(), time.process_time()
    reason: Reason | None = explained.reason
    if not isinstance(target.likelihood, TorqueLikelihood):
        reason = "likelihood"
    elif any(o.rest is not None for o in observations):
        reason = "rest"
    elif posterior.diagnostics.status == "unusable":
        reason = "sampling"
    replicates = () if reason else explained.replicates
    # a prior that is cut takes a quadrature
    sds = np.array([prior.sd() for prior in target.priors[: len(target.free)]])
    sds = np.where(np.isfinite(sds), sds, np.inf)
    columns = [target.likelihood.chain.names.index(name) for name in target.free]
    truth = np.tile(posterior.median, (len(replicates), 1))
    for row, replicate in zip(truth, replicates, strict=True):  # the noise stays the posterior's
        row[: len(columns)] = replicate.values[columns]
    return Checked(
        truth,
        tuple(
            _fit(target, *pair, sds, columns, explained.share)
            for pair in zip(truth, replicates, strict=True)
        ),
        time.perf_counter() - begun,
        time.process_time() - worked,
        reason,
        explained.share,
    )


def _fit(
    target: Target,
    truth: Array,
    replicate: Replicate,
    prior_sds: Array,
    columns: Sequence[int],
    share: float,
) -> QuickFit:
    """Take one Gauss-Newton step from the truth ``(d,)`` that a replicate was made with.

    Filters, steps of the encoder and differentiation make the modelled torque differ from the
    simulated one. By how much that moves an estimate is asked of a posterior with the noise of the
    truth, as a normal about it. The prior counts as one more measurement, of sd ``prior_sds``
    ``(free,)`` and centred on the truth: its pull is meant, and no bias. Of an excerpt, a ``share``
    of the recordings, it counts for as much less.
    """
    assert isinstance(target.likelihood, TorqueLikelihood)
    k = len(target.free)
    at, noise = units_of(target, truth), target.likelihood.noise
    scales = target.noise.scales(truth[None, k:])[0]
    rows = np.column_stack([replicate.base[:, columns] * at.units, replicate.left])
    pieces = [
        noise.standard(piece.T, runs, scale)[0].T
        for piece, runs, scale in zip(
            replicate.layout.split(rows), replicate.layout.runs, scales, strict=True
        )
    ]
    white = np.concatenate(pieces)
    jacobian, error = white[:, :-1], white[:, -1]
    information = jacobian.T @ jacobian + share * np.diag((at.units / prior_sds) ** 2)
    step = np.asarray(np.linalg.lstsq(information, jacobian.T @ error)[0], dtype=np.float64)
    part = _SMALL / max(float(np.abs(step).max(initial=0.0)), _SMALL)
    nearby = np.concatenate([at.moved(truth[:k], part * step), truth[k:]])
    left = error - jacobian @ step
    return QuickFit(nearby, part, float(np.mean(left**2)))
