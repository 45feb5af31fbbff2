"""Standstills that the fitted law contradicts: friction there is larger than the law's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.inference.fitting import Fit
from bayesfric.inference.likelihood.torque_likelihood import StaticFriction
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.observation import observe
from bayesfric.recordings.source import Processing


@dataclass(frozen=True)
class StictionViolation:
    """Standstills of one recording at which the law would have moved the joint."""

    recording: str  # name
    share: float  # share of the outputs at standstill
    # s from the file's first stamp, of the first and the last
    start: float
    stop: float
    # largest excess of the torque over the law's limits, N m or N at the motor
    beyond: float
    # largest friction at standstill, N m or N at the motor: static friction is at least this
    held: float


def stiction_violations(
    fit: Fit, recordings: Sequence[Measurement], processing: Processing
) -> Iterator[StictionViolation]:
    """Yield recordings with standstills outside the limits of 95 % of the widened draws.

    At least three outputs and a tenth of those at standstill must exceed them by three times the
    residuals' rms. Nothing is evaluated if the fit uses standstill or explains positions.
    """
    if processing.rest or fit.target.likelihood.method != "input-error":
        return
    chain = fit.chain
    values = fit.wide.target.chain_values(fit.wide.posterior.flat(200))
    triples = zip(recordings, fit.observations, fit.residuals, strict=True)
    for recording, fitted, residual in triples:
        try:
            at_rest = observe(recording, processing.model_copy(update={"rest": True}))
        except BadInput:  # without standstill too little moves
            continue
        if at_rest.rest is None:
            continue
        low, high = StaticFriction(chain, at_rest.rest, fitted.inputs).limits(values)
        torque = at_rest.rest.torque
        excess = np.maximum(np.maximum(low - torque, torque - high), 0.0)
        violated = np.quantile(excess, 0.05, axis=0) > 3.0 * np.sqrt(np.mean(residual**2))
        if violated.sum() >= 3 and violated.mean() >= 0.1:
            stamps = at_rest.rest.stamps[violated]
            span = float(stamps.min()), float(stamps.max())
            # friction is the distance from the limits' middle
            friction = np.abs(torque - 0.5 * (low + high))
            beyond, held = (float(np.median(x, axis=0)[violated].max()) for x in (excess, friction))
            yield StictionViolation(recording.name, float(violated.mean()), *span, beyond, held)
