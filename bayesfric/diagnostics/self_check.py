"""What a fit makes of recordings like its own whose truth is known.

The true parameters are draws of the posterior, so that every recording that is simulated is one
that this fit holds possible. It is asked how far estimates lie from them, nothing else: whether the
joint is what the model takes it for, no simulation of the model can tell.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field, field_validator

from bayesfric.diagnostics.quick_fit import QuickFit, quick_fit
from bayesfric.diagnostics.twins import NoTwin, twins
from bayesfric.errors import Unfit
from bayesfric.estimates.descent import few_threads
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.posterior import Posterior
from bayesfric.inference.target import Target
from bayesfric.mechanism.forward import simulate
from bayesfric.options import Options
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.observation import Observation
from bayesfric.recordings.processing import Processing

# Recordings that are simulated where none are asked for, and samples in all: of long recordings
# fewer are made, as the check should never take longer than the sampling.
_RECORDINGS, _SAMPLES = 40, 1_500_000
# With fewer, the spread of a bias is not known.
_LEAST = 10
# Share of the recordings that must have come to a fit.
_ENOUGH = 0.5

Reason = Literal["likelihood", "rest", "sampling", "still", "simulation"]


class SelfCheckOptions(Options):
    """The ``[self_check]`` table: how the fit is tried on recordings simulated like its own."""

    recordings: int | None = Field(
        None,
        ge=0,
        examples=[40],
        description="that are simulated at draws of the posterior, with the recording's own "
        "torque, encoder and filters, and fitted anew; 0 for none; if left out 40, fewer of very "
        "long recordings",
    )

    @field_validator("recordings")
    @classmethod
    def _enough(cls, value: int | None) -> int | None:
        if value is not None and 0 < value < _LEAST:
            raise Unfit(f"0, or at least {_LEAST}", f"got {value}")
        return value

    def number(self, samples: int) -> int:
        """Say how many to simulate of recordings with so many samples in all."""
        if self.recordings is not None:
            return self.recordings
        return int(np.clip(_SAMPLES // max(samples, 1), _LEAST, _RECORDINGS))


@dataclass(frozen=True, eq=False)
class Checked:
    """What came of it: truths, and where fits went from them.

    Where it could not be made, ``reason`` is why: the ``likelihood`` is not of the torque, samples
    at ``rest`` say what a quick fit cannot use, the
    ``sampling`` failed, most simulated joints stood ``still``, or the ``simulation`` is
    impossible, for which ``said`` has the words.
    """

    asked: int
    truth: Array  # (n, d) sampled parameters
    fits: tuple[QuickFit, ...]  # of each
    seconds: float
    cpu_seconds: float
    reason: Reason | None = None
    said: str = ""


def self_check(
    target: Target,
    posterior: Posterior,
    recordings: Sequence[Measurement],
    observations: Sequence[Observation],
    processing: Processing,
    number: int,
) -> Checked:
    """Simulate ``number`` recordings like these at draws of the posterior, and fit each.

    Random numbers are of the posterior's seed, a stream for each simulated recording: the
    result does not depend on how work is shared out.
    """
    begun, worked = time.perf_counter(), time.process_time()
    truth = posterior.flat(number)
    fits: list[QuickFit | None] = []
    reason: Reason | None = None
    said = ""
    if not isinstance(target.likelihood, TorqueLikelihood):
        reason = "likelihood"
    elif any(o.rest is not None for o in observations):
        reason = "rest"
    elif posterior.diagnostics.status == "unusable":
        reason = "sampling"
    else:
        try:
            fits = _fits(target, truth, recordings, observations, processing, posterior.seed)
        except NoTwin as error:
            reason, said = "simulation", str(error)
    made = np.array([fit is not None for fit in fits], dtype=np.bool_)
    if reason is None and made.sum() < _ENOUGH * number:
        said = _obstacle(target, posterior.median, recordings[0].period)
        reason = "simulation" if said else "still"
    return Checked(
        asked=number,
        truth=truth[made] if reason is None else truth[:0],
        fits=tuple(fit for fit in fits if fit is not None) if reason is None else (),
        seconds=time.perf_counter() - begun,
        cpu_seconds=time.process_time() - worked,
        reason=reason,
        said=said,
    )


def _fits(
    target: Target,
    truth: Array,
    recordings: Sequence[Measurement],
    observations: Sequence[Observation],
    processing: Processing,
    seed: int,
) -> list[QuickFit | None]:
    """Fit replays at each truth ``(n, d)``; ``None`` where one could not be made."""
    chain, values = target.likelihood.chain, target.chain_values(truth)
    streams = np.random.SeedSequence(seed, spawn_key=(7,)).spawn(len(recordings))
    parts = [
        twins(chain, values, recording, observation, processing, stream.spawn(len(truth)))
        for recording, observation, stream in zip(recordings, observations, streams, strict=True)
    ]
    # a prior that is cut takes a quadrature
    sds = np.array([prior.sd() for prior in target.priors[: len(target.free)]])
    sds = np.where(np.isfinite(sds), sds, np.inf)
    found: list[QuickFit | None] = []
    for one, seen in zip(truth, zip(*parts, strict=True), strict=True):
        made = [o for o in seen if o is not None]
        with few_threads(observations):
            found.append(quick_fit(target, one, made, sds) if len(made) == len(seen) else None)
    return found


def _obstacle(target: Target, parameters: Array, period: float) -> str:
    """Say why a joint cannot be simulated; nothing where it can."""
    values = target.chain_values(parameters[None])[0]
    try:
        simulate(target.likelihood.chain, values, np.zeros(2), period)
    except ValueError as error:
        return str(error)
    return ""
