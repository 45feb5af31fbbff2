"""Calibration check: bias of the estimates on simulated replicates with known parameters.

It cannot show whether the model is right: replicates are simulated from it.
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
from bayesfric.inference.likelihood import TorqueLikelihood
from bayesfric.inference.posterior import Posterior
from bayesfric.inference.target import Target, units_of
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

Reason = Literal["likelihood", "rest", "sampling", "still", "few"]


class CalibrationCheckOptions(Options):
    """The ``[self_check]`` table."""

    recordings: int | None = Field(
        None,
        ge=0,
        examples=[0],
        description="0 to skip it; else simulated replicates of the recordings are fitted",
    )


@dataclass(frozen=True, eq=False)
class CalibrationCheck:
    """True parameters of replicates without torque noise, and the fits to them."""

    truth: Array  # (n, d) sampled parameters
    # (n, d) a short step from the truth towards the estimate, and (n,) its share of the full step:
    # full steps along unidentified directions have any length
    near_truth: Array
    steps: Array
    unexplained: Array  # (n,) mean square of the residual over the noise variance
    seconds: float
    cpu_seconds: float
    # Why it was not made: a likelihood of the position, samples at standstill, failed sampling,
    # replicates that stand still, or too few outputs
    reason: Reason | None = None
    share: float = 1.0  # of the recordings' samples; below one for subsamples


def calibration_check(
    target: Target,
    posterior: Posterior,
    observations: Sequence[Observation],
    explained: Explanation,
) -> CalibrationCheck:
    """Estimate the bias by filters, encoder and differentiation, by a parametric bootstrap.

    The mean of estimate less truth over the replicates is the bias (Efron and Tibshirani, "An
    Introduction to the Bootstrap", 1993). Each fit is one Gauss-Newton step from the truth, as the
    torque is nearly linear in the parameters; replicates have no torque noise, so few suffice.
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
    columns = [target.likelihood.chain.names.index(name) for name in target.free]
    truth = np.tile(posterior.median, (len(replicates), 1))
    for row, replicate in zip(truth, replicates, strict=True):  # the noise stays the posterior's
        row[: len(columns)] = replicate.values[columns]
    near_truth, (steps, unexplained) = truth.copy(), np.ones((2, len(truth)))
    for k, replicate in enumerate(replicates):
        fit = _fit(target, truth[k], replicate, columns, explained.share)
        near_truth[k], steps[k], unexplained[k] = fit
    seconds = time.perf_counter() - begun, time.process_time() - worked
    return CalibrationCheck(
        truth, near_truth, steps, unexplained, *seconds, reason, explained.share
    )


def _fit(
    target: Target, truth: Array, replicate: Replicate, columns: Sequence[int], share: float
) -> tuple[Array, float, float]:
    """Take one Gauss-Newton step from the true parameters ``(d,)`` of a replicate.

    The prior is centred on the truth, as its pull is no bias; for a subsample its information is
    scaled by ``share``.
    """
    assert isinstance(target.likelihood, TorqueLikelihood)
    k = len(target.free)
    units, noise = units_of(target, truth), target.likelihood.noise
    scales = target.noise.scales(truth[None, k:])[0]
    rows = np.column_stack([replicate.base[:, columns] * units.units, replicate.residual])
    parts = zip(replicate.layout.split(rows), replicate.layout.runs, scales, strict=True)
    white = np.concatenate([noise.standard(x.T, runs, scale)[0].T for x, runs, scale in parts])
    jacobian, error = white[:, :-1], white[:, -1]
    sds = np.array([prior.sd() for prior in target.priors[:k]])
    precision = np.where(np.isfinite(sds), (units.units / sds) ** 2, 0.0)
    information = jacobian.T @ jacobian + share * np.diag(precision)
    step = np.asarray(np.linalg.lstsq(information, jacobian.T @ error)[0], dtype=np.float64)
    # quantities are assumed to be linear along a thousandth of the parameters' units
    step_share = 1e-3 / max(float(np.abs(step).max(initial=0.0)), 1e-3)
    near_truth = np.concatenate([units.moved(truth[:k], step_share * step), truth[k:]])
    residual = error - jacobian @ step
    return near_truth, step_share, float(np.mean(residual**2))
