"""What a summary says of the noise: its model, why that one, and what white noise would give."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.estimate import Estimate
from bayesfric.estimates.information import CORRELATED, lag_one
from bayesfric.inference.fit import Fit
from bayesfric.inference.likelihood.autoregression import PASSES, ljung_box, predictors
from bayesfric.inference.likelihood.noise_choice import Choice
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.noise import SCALES
from bayesfric.mechanism.parameter import effort_words

Array = NDArray[np.float64]

# Correlations of the innovations that are tested together.
_LAGS = 10


def noise_unit(fit: Fit, quantity: str) -> str:
    """Name the unit of a noise scale, such as ``sigma``, ``torque`` or ``position``."""
    unit = SCALES[quantity].unit
    if unit == "position":
        return fit.target.likelihood.outputs[0].unit
    return unit and ("N m" if fit.chain.motor_motion == "rotary" else "N")


def noise_meaning(fit: Fit, quantity: str) -> str:
    """Say in a line what a noise scale is."""
    (scale,) = (s for s in fit.target.likelihood.noise.scales if s.name == quantity)
    return effort_words(scale.meaning, fit.chain.motor_motion)


def noise_record(
    fit: Fit, residuals: list[Array], lags: list[float], choice: Choice | None
) -> dict[str, Any]:
    """Put the noise of a fit into the form of ``summary.json``.

    Parameters
    ----------
    fit
        A finished fit.
    residuals
        ``(M,)`` of every recording, measured minus posterior mean.
    lags
        Their lag-1 correlations.
    choice
        How the order was chosen, where it was.
    """
    likelihood = fit.target.likelihood
    record: dict[str, Any] = {
        "model": effort_words(likelihood.noise.description, fit.chain.motor_motion),
        "parameters": list(fit.target.noise.names),
        "accounts_for_correlation": likelihood.noise.accounts_for_correlation,
        "residual_lag1": mean_lag(lags, residuals),
    }
    if not isinstance(likelihood, TorqueLikelihood):
        return record
    noise = likelihood.noise
    median = fit.posterior.median
    scales = fit.target.noise.scales(median[None, len(fit.target.free) :])[0]
    left = likelihood.innovations(residuals, scales)
    runs = [o.follows for o in likelihood.outputs]
    p = ljung_box(left, runs, _LAGS + noise.order, noise.order)
    record |= {
        "order": noise.order,
        "innovation_lag1": mean_lag([lag_one(r, f) for r, f in zip(left, runs, strict=True)], left),
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
        record["order_chosen_from"] = [
            {
                "order": one.order,
                "bic": one.bic,
                "innovation_share": one.innovations,
                "p_value": one.p_value,
            }
            for one in choice.tried
        ]
    return record


def add_white_intervals(
    summary: dict[str, Any], white: Mapping[str, Mapping[str, Any]] | None
) -> None:
    """Put beside every interval of a summary the one that white noise would have given.

    Parameters
    ----------
    summary
        Changed: rows get ``white_interval`` and ``white_sd``, or ``warnings`` says why not.
    white
        From :func:`bayesfric.report.summary.summary.spreads`, of the same problem with white noise;
        ``None`` if its sampling is unusable.
    """
    if white is None:
        summary["warnings"].append(
            "the sampling with white noise, for comparison only, did not converge, and its "
            "intervals are left out: raise sampling.max_steps"
        )
        return
    for group in ("parameters", "derived"):
        for name, row in summary[group].items():
            other = white.get(name)
            if other is not None and not name.startswith("noise."):
                row["white_interval"], row["white_sd"] = other["interval"], other["sd"]


def noise_lines(record: Mapping[str, Any]) -> Iterator[str]:
    """Word the noise of a summary for a person."""
    yield f"Noise: {record['model']}"
    tried = record.get("order_chosen_from")
    if tried and len(tried) > 1:
        shown = ", ".join(f"AR({one['order']}) {one['bic']:.0f}" for one in tried[1:])
        yield f"  order chosen by BIC; against white noise, 0: {shown}"
    for name, coefficients in record.get("autoregression", {}).items():
        yield f"  {name}: coefficients {', '.join(f'{c:.3f}' for c in coefficients)}"
    test = record.get("innovation_whiteness")
    if test is not None:
        yield f"  innovations {white_words(test['white'])} (Ljung-Box {p_words(test['p_value'])})"


def white_words(white: bool) -> str:
    """Say of innovations whether they are white noise by their test."""
    return "pass as white" if white else "do NOT pass as white: intervals may be too narrow"


def p_words(p_value: float) -> str:
    """Write a p-value; one too small for a floating-point number is not zero."""
    return " ".join(("p", *p_parts(p_value)))


def p_parts(p_value: float) -> tuple[str, str]:
    """Give sign and number of a p-value."""
    return ("=", f"{p_value:.2g}") if p_value > 0.0 else ("<", "1e-300")


# A log-likelihood this uncertain moves an interval by about a standard deviation.
_LINEAR = 1.0


def linearisation_warnings(fit: Fit) -> Iterator[str]:
    """Warn where the output-error likelihood is another one at every draw."""
    if fit.linearisation is None or fit.linearisation < _LINEAR:
        return
    yield (
        "how torque noise moves the joint is linearised at the posterior's mode, and elsewhere in "
        f"the posterior that changes the log-likelihood by {fit.linearisation:.2g} (below "
        f"{_LINEAR:g} it would not matter): do not trust these intervals; take likelihood.method = "
        '"input-error", or a motion that sticks and reverses less often'
    )


def correlation_warnings(fit: Fit, record: Mapping[str, Any]) -> Iterator[str]:
    """Warn where residuals that count as independent are not, and by how much it matters."""
    likelihood = fit.target.likelihood
    # drifting positions are correlated by their model; there it says nothing
    if not isinstance(likelihood, TorqueLikelihood):
        return
    lag = record["innovation_lag1"]
    if lag is None or lag < CORRELATED:
        return
    what = "innovations" if likelihood.noise.order else "residuals"
    yield (
        f"the {what} are correlated (lag 1: {lag:.2f}) but are taken for independent: "
        f"{_too_narrow(() if likelihood.noise.order else fit.estimates, lag)}"
    )


def _too_narrow(estimates: Sequence[Estimate], lag: float) -> str:
    """Say by how much intervals are too narrow, by estimates of the same kind where there are."""
    ratios = [
        v.sd_robust / v.sd
        for e in estimates
        if e.method == "input-error"
        for v in e.values
        if v.determined and v.sd > 0.0 and np.isfinite(v.sd_robust)
    ]
    if max(ratios, default=0.0) > 1.0:
        return (
            f"these intervals are up to {max(ratios):.2g} times too narrow, as the input-error "
            "estimate's robust sds over its plain ones say"
        )
    # the factor of a first-order autoregression
    factor = np.sqrt((1.0 + lag) / (1.0 - min(lag, 0.99)))
    return f"these intervals are about {factor:.1f} times too narrow"


def white_alternative(fit: Fit) -> bool:
    """Whether the noise has a memory, so that white noise would have given other intervals."""
    likelihood = fit.target.likelihood
    return isinstance(likelihood, TorqueLikelihood) and likelihood.noise.order > 0


def mean_lag(lags: list[float], residuals: list[Array]) -> float | None:
    """Average lag-1 correlations over recordings that have one, by their numbers of residuals."""
    weights = [r.size if np.isfinite(lag) else 0 for lag, r in zip(lags, residuals, strict=True)]
    return float(np.average(np.nan_to_num(lags), weights=weights)) if any(weights) else None
