"""Whether a fit's friction law could hold the joint at standstill, where the fit did not use it.

At standstill the motor's torque lies between the two at which the joint would move. Where it lay
beyond them, static friction is more than the law says, which was learned in motion; unless
something else, such as a brake, held the joint.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.inference.fitting import Fit
from bayesfric.inference.likelihood.static_friction import StaticFriction
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.observation import observe
from bayesfric.recordings.processing import Processing

# Draws whose law is asked; what nineteen in twenty of them do not hold is not held.
_DRAWS, _SURE = 200, 0.05
# Residuals, rms, by which a torque must lie beyond; share of the rests and number that must.
_NOISE, _SHARE, _LEAST = 3.0, 0.1, 3


@dataclass(frozen=True)
class StictionViolation:
    """Standstills of one recording at which the law would have moved the joint."""

    recording: str  # Its name
    share: float  # Of all outputs at standstill in it
    # Of the first and the last, s from the file's first stamp
    start: float
    stop: float
    # How far the torque lies outside what the law can hold, the worst, N m or N at the motor
    beyond: float
    # Most friction that held the joint there, N m or N at the motor: static friction is at least
    # this
    held: float


def stiction_violations(
    fit: Fit, recordings: Sequence[Measurement], processing: Processing
) -> Iterator[StictionViolation]:
    """Find standstills at which the law would have moved, recording by recording.

    Where the fit uses standstill, or explains positions, there is nothing to ask, and nothing is
    found. The friction that holds is the distance of the torque from the middle of the limits: at
    standstill the rest of the law, gravity and offset, is there in both.
    """
    if processing.rest or fit.target.likelihood.method != "input-error":
        return
    chain = fit.chain
    values = fit.wide.target.chain_values(fit.wide.posterior.flat(_DRAWS))
    each = zip(recordings, fit.observations, fit.residuals, strict=True)
    for recording, fitted, residual in each:
        try:
            seen = observe(recording, processing.model_copy(update={"rest": True}))
        except BadInput:  # with rests told apart too little moves
            continue
        if seen.rest is None:
            continue
        low, high = StaticFriction(chain, seen.rest, fitted.inputs).limits(values)
        torque = seen.rest.torque
        out = np.maximum(np.maximum(low - torque, torque - high), 0.0)
        sure = np.quantile(out, _SURE, axis=0) > _NOISE * np.sqrt(np.mean(residual**2))
        if sure.sum() >= _LEAST and sure.mean() >= _SHARE:
            stamps = seen.rest.stamps[sure]
            span = float(stamps.min()), float(stamps.max())
            # between the limits' middle and the torque is what friction took
            friction = np.abs(torque - 0.5 * (low + high))
            worst, held = (float(np.median(x, axis=0)[sure].max()) for x in (out, friction))
            yield StictionViolation(recording.name, float(sure.mean()), *span, worst, held)
