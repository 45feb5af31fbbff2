"""``summary.json`` and ``summary.csv``: every number of a fit, once."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bayesfric
from bayesfric.estimates.torque import typical_load
from bayesfric.identifiability.local import LocalInformation, local_information, verdict
from bayesfric.inference.fit import Fit
from bayesfric.mechanism.derived import derive
from bayesfric.recordings.observation import Observation

Array = NDArray[np.float64]

LEVEL = 0.9
# Residual correlation above which white-noise intervals are called too narrow.
_CORRELATED = 0.2


def summarise(fit: Fit) -> dict[str, Any]:
    """Put all numbers of a fit into the form of ``summary.json``.

    Parameters
    ----------
    fit
        A finished fit.

    Returns
    -------
    dict
        Only strings, numbers, lists and dicts; numbers that do not exist are ``None``.
    """
    posterior = fit.posterior
    d = posterior.diagnostics
    flat = posterior.flat()
    median = np.median(flat, axis=0)
    local = local_information(fit.target, median)
    residual = residuals(fit)
    lags = [lag_one(o, r) for o, r in zip(fit.observations, residual, strict=True)]
    weights = [r.size if np.isfinite(lag) else 0 for lag, r in zip(lags, residual, strict=True)]
    correlation = _number(
        np.average(np.nan_to_num(lags), weights=weights) if any(weights) else np.nan
    )
    return {
        "bayesfric": bayesfric.__version__,
        "parameters": _parameters(fit, flat, local),
        "fixed": {
            p.name: {"unit": p.unit, "value": float(value)}
            for p, value in zip(fit.chain.parameters, fit.chain_draws(1)[0], strict=True)
            if p.name not in fit.target.free
        },
        "derived": _derived(fit, median, local),
        "estimates": {
            fit.totals.method: {
                "parameters": {
                    v.name: {"unit": v.unit, "value": v.value, "sd": _number(v.sd)}
                    for v in fit.totals.values
                },
                "residual_rms": fit.totals.residual_rms,
                "assumption": fit.totals.assumption,
            }
        },
        "identifiability": {
            "null_directions": [
                {"parameters": n.exponents, "meaning": n.meaning} for n in local.null_directions
            ],
            "singular_values": [float(x) for x in local.directions.singular_values],
        },
        "noise": {
            "model": "white",
            "parameters": list(fit.target.noise.names),
            "residual_lag1": correlation,
        },
        "fit": {
            "residual_rms": _rms(np.concatenate(residual)),
            "unit": torque_unit(fit),
            "recordings": {
                o.name: {
                    "residual_rms": _rms(r),
                    "residual_lag1": _number(lag_one(o, r)),
                    "outputs": int(o.measured.size),
                    **o.settings,
                }
                for o, r in zip(fit.observations, residual, strict=True)
            },
        },
        "warnings": [
            *_correlated(correlation),
            *(f"{o.name}: {text}" for o in fit.observations for text in o.warnings),
        ],
        "sampler": {
            "status": d.status,
            "problems": list(d.problems),
            "draws": d.ensembles * d.walkers * d.steps,
            "walkers": d.walkers,
            "ensembles": d.ensembles,
            "warmup": d.warmup,
            "steps": d.steps,
            "thin": d.thin,
            "tau": _number(d.tau.max()),
            "min_ess": _number(d.ess.min()),
            "max_rhat": _number(d.rhat.max()),
            "acceptance": _number(d.acceptance.mean()),
            "not_finite": d.not_finite,
            "coordinates": posterior.coordinates,
            "seconds": round(d.seconds, 3),
            "seed": posterior.seed,
        },
    }


def summary_table(summary: Mapping[str, Any]) -> str:
    """Lay the parameters and derived quantities of a summary out as CSV text."""
    columns = ["name", "unit", "mean", "sd", "median", "low", "high", "level", "rhat", "ess"]
    columns += ["prior", "prior_sd", "contraction", "verdict", "at_bound"]
    columns += ["undefined_share"]
    out = io.StringIO()
    writer = csv.DictWriter(out, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for group in ("parameters", "derived"):
        for name, row in summary[group].items():
            low, high = row["interval"]
            writer.writerow({"name": name, **row, "low": low, "high": high})
    return out.getvalue()


def residuals(fit: Fit) -> list[Array]:
    """Measured minus posterior mean torque of each recording."""
    predicted = fit.target.likelihood.predict(fit.chain_draws(200))
    return [
        o.measured - torque.mean(axis=0)
        for o, torque in zip(fit.observations, predicted, strict=True)
    ]


def lag_one(observation: Observation, residual: Array) -> float:
    """Correlate each residual with the next output's, where the next was not left out.

    ``nan`` with fewer than ten such pairs.
    """
    step = np.diff(observation.filter.starts)
    follows = (step == step.min()) & (np.diff(observation.segment_of) == 0)
    first, second = residual[:-1][follows], residual[1:][follows]
    if first.size < 10:
        return float("nan")
    return float(np.mean(first * second) / np.mean(residual**2))


def _correlated(lag: float | None) -> list[str]:
    """Warn that white noise understates the sds, by the factor of a first-order autoregression."""
    if lag is None or lag < _CORRELATED:
        return []
    factor = np.sqrt((1.0 + lag) / (1.0 - min(lag, 0.99)))
    return [
        f"the residuals are correlated (lag 1: {lag:.2f}) but are taken for independent: these "
        f"intervals are about {factor:.1f} times too narrow"
    ]


def torque_unit(fit: Fit) -> str:
    """Name the unit of the measured torque."""
    return "N m" if fit.chain.motor_motion == "rotary" else "N"


def _parameters(fit: Fit, flat: Array, local: LocalInformation) -> dict[str, Any]:
    d = fit.posterior.diagnostics
    units = {p.name: (p.unit, p.meaning) for p in fit.chain.parameters}
    rows = {}
    for j, (name, prior) in enumerate(zip(fit.posterior.names, fit.posterior.priors, strict=True)):
        unit, meaning = units.get(name, (torque_unit(fit), "noise of the filtered torque"))
        sd, prior_sd = float(flat[:, j].std()), prior.sd()
        # the noise scale's own information: a variance estimated from n residuals
        data_sd = local.data_sd[j] if j < len(local.names) else sd
        rows[name] = {
            "unit": unit,
            "meaning": meaning,
            **_spread(flat[:, j]),
            "rhat": _number(d.rhat[j]),
            "ess": _number(d.ess[j]),
            "prior": prior.text,
            "prior_default": prior.default,
            "prior_sd": _number(prior_sd),
            "contraction": _number(1.0 - (sd / prior_sd) ** 2),
            "data_sd": _number(data_sd),
            "verdict": verdict(sd, prior_sd, data_sd),
            "at_bound": _at_bound(flat[:, j], prior.lower, prior.upper),
        }
    return rows


def _derived(fit: Fit, median: Array, local: LocalInformation) -> dict[str, Any]:
    draws = fit.chain_draws()
    middle = fit.target.chain_values(median[None])[0]
    at_load = typical_load(fit.chain, fit.observations, middle)
    found = derive(fit.chain, draws, at_load)
    prior = _prior_sds(fit, at_load)
    gradients = _gradients(fit, median, at_load)
    # what no scaling changes comes first: it is what the torque tells
    rows = {}
    for q in sorted(found, key=lambda q: not q.gauge_free):
        defined = q.values[np.isfinite(q.values)]
        # what only fixed parameters make up is known, and what most draws do not
        # have has no interval
        known = defined.size == q.values.size and np.ptp(defined) <= 1e-12 * np.abs(defined).max()
        if known or defined.size < 0.5 * q.values.size:
            continue
        rows[q.name] = {
            "unit": q.unit,
            "meaning": q.meaning,
            **_spread(defined),
            "verdict": verdict(
                _robust_sd(defined), prior[q.name], local.data_sd_of(gradients[q.name])
            ),
            "undefined_share": 1.0 - defined.size / q.values.size,
            "gauge_free": q.gauge_free,
        }
    return rows


def _prior_sds(fit: Fit, at_load: float) -> dict[str, float]:
    """Compute the sds of the derived quantities that the priors alone imply."""
    rng = np.random.default_rng(np.random.SeedSequence(fit.posterior.seed, spawn_key=(2,)))
    drawn = np.stack([prior.draw(2000, rng) for prior in fit.posterior.priors], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = derive(fit.chain, fit.target.chain_values(drawn), at_load)
    return {
        q.name: _robust_sd(defined) if (defined := q.values[np.isfinite(q.values)]).size else 0.0
        for q in found
    }


def _robust_sd(x: Array) -> float:
    """Estimate a sd from quartiles: alpha_2 = 1/(1 - mu_2) has no finite one under many priors."""
    low, high = np.quantile(x, [0.25, 0.75])
    return float((high - low) / 1.349)


def _gradients(fit: Fit, median: Array, at_load: float) -> dict[str, Array]:
    """Differentiate the derived quantities by the free parameters, centrally."""
    k = len(fit.target.free)
    steps = 1e-5 * np.maximum(np.abs(median[:k]), 1e-9)
    moved = np.tile(median, (2 * k, 1))
    index = np.arange(k)
    moved[index, index] += steps
    moved[k + index, index] -= steps
    found = derive(fit.chain, fit.target.chain_values(moved), at_load)
    return {q.name: (q.values[:k] - q.values[k:]) / (2.0 * steps) for q in found}


def _spread(x: Array) -> dict[str, Any]:
    low, middle, high = np.quantile(x, [0.5 - LEVEL / 2, 0.5, 0.5 + LEVEL / 2])
    return {
        "mean": float(x.mean()),
        "sd": float(x.std()),
        "median": float(middle),
        "interval": [float(low), float(high)],
        "level": LEVEL,
    }


def _at_bound(x: Array, lower: float, upper: float) -> str | None:
    """Say on which bound a posterior leans: 5 % of it within a fifth of an sd of the bound."""
    low, high = np.quantile(x, [0.05, 0.95])
    near = 0.2 * x.std()
    if low - lower < near:
        return "lower"
    return "upper" if upper - high < near else None


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _number(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None
