"""The noise in a summary: its model, and the evidence for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from bayesfric.estimates.autoregression import CORRELATED, PASSES, lag_one, ljung_box, predictors
from bayesfric.inference.fitting import Fit
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.noise import SCALES, NoiseChoice
from bayesfric.mechanism.quantities import effort_words
from bayesfric.recordings.arrays import Array, Flags
from bayesfric.report.summary.derived_quantities import rms_of
from bayesfric.report.summary.record import Likelihood, Summary
from bayesfric.report.words import line_of

# Correlations of the innovations that are tested together.
_LAGS = 10
# A log-likelihood this uncertain moves an interval by about a standard deviation.
_LINEAR = 1.0


def noise_described(fit: Fit) -> dict[str, dict[str, str]]:
    """Give unit, symbol and meaning of every noise parameter, by name."""
    noise, effort = fit.target.noise, "N m" if fit.chain.motor_motion == "rotary" else "N"
    units = {"position": fit.target.likelihood.outputs[0].unit, "": ""}
    meanings = {scale.name: scale.meaning for scale in fit.target.likelihood.noise.scales}
    described = {}
    for name, symbol, kind in zip(noise.names, noise.symbols, noise.quantities, strict=True):
        # one scale a recording, by its name
        _, _, recording = name.removeprefix("noise.").partition(".")
        meaning = effort_words(meanings[kind], fit.chain.motor_motion)
        meaning += f", {recording}" if recording else ""
        unit = units.get(SCALES[kind].unit, effort)
        described[name] = {"unit": unit, "symbol": symbol, "meaning": meaning}
    return described


def noise_record(fit: Fit, residuals: list[Array], choice: NoiseChoice | None) -> dict[str, Any]:
    """Put the noise of a fit into the form of ``summary.json``.

    ``residuals`` ``(M,)`` of every recording are measured minus posterior mean.
    """
    likelihood = fit.target.likelihood
    runs = [o.follows for o in likelihood.outputs]
    record: dict[str, Any] = {
        "model": effort_words(likelihood.noise.description, fit.chain.motor_motion),
        "parameters": list(fit.target.noise.names),
        "accounts_for_correlation": likelihood.noise.accounts_for_correlation,
        "residual_lag1": mean_lag(residuals, runs),
    }
    if not isinstance(likelihood, TorqueLikelihood):
        return record
    noise = likelihood.noise
    median = fit.posterior.median
    scales = fit.target.noise.scales(median[None, len(fit.target.free) :])[0]
    left = likelihood.innovations(residuals, scales)
    p = ljung_box(left, runs, _LAGS + noise.order, noise.order)
    record |= {
        "order": noise.order,
        "innovation_lag1": mean_lag(left, runs),
        "innovation_whiteness": {
            "test": f"Ljung-Box, {_LAGS + noise.order} lags, all recordings together",
            "p_value": p,
            "white": bool(p >= PASSES),
        },
    }
    if noise.order:
        record["autoregression"] = {
            o.name: predictors(s[None, 1:])[-1][0].tolist()
            for o, s in zip(likelihood.outputs, scales, strict=True)
        }
    if choice is not None:
        record["order_chosen_from"] = [asdict(order) for order in choice.evidence]
        record |= {"memory": [*choice.partial], "room": choice.half_range}
    return record


def linearisation_warning(likelihood: Likelihood) -> str | None:
    """Warn where linearising the simulation changes the output-error likelihood much."""
    change = likelihood.linearisation
    if change is None or change < _LINEAR:
        return None
    return line_of("linearised", {"change": change})


def correlation_of(summary: Summary) -> tuple[float, float] | None:
    """Give lag-one correlation of residuals assumed independent, and how much it matters.

    That is the factor by which intervals are too narrow, of a first-order autoregression.
    """
    lag = summary.noise.innovation_lag1
    # simulated positions are correlated by their model
    if summary.likelihood.method != "input-error" or lag is None or lag < CORRELATED:
        return None
    return lag, float(np.sqrt((1.0 + lag) / (1.0 - min(lag, 0.99))))


def mean_lag(residuals: Sequence[Array], follows: Sequence[Flags]) -> float | None:
    """Correlate each residual with the next, scaled by its recording's rms."""
    scaled = [r / max(rms_of(r), 1e-300) for r in residuals]
    # no pair reaches from one recording to the next
    runs = [np.append(f, False)[: r.size] for r, f in zip(scaled, follows, strict=True)]
    lag = lag_one(np.concatenate(scaled), np.concatenate(runs)[:-1])
    return lag if np.isfinite(lag) else None
