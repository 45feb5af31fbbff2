"""``summary.json`` and ``summary.csv``: every number of a fit, once."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bayesfric
from bayesfric.estimates.estimate import Estimate
from bayesfric.estimates.information import lag_one
from bayesfric.estimates.least_squares import TotalsProjection
from bayesfric.estimates.torque import filtered_torque, typical_load
from bayesfric.identifiability.influence import influence
from bayesfric.identifiability.local import LocalInformation, local_information, verdict
from bayesfric.inference.fit import Fit
from bayesfric.inference.likelihood.likelihood import Likelihood
from bayesfric.inference.likelihood.noise_choice import Choice
from bayesfric.inference.likelihood.position_likelihood import PositionLikelihood
from bayesfric.inference.noise import SCALES
from bayesfric.mechanism.derived import Derived, derive
from bayesfric.mechanism.parameter import TURN
from bayesfric.report.summary.bounds import bound_warning
from bayesfric.report.summary.noise import (
    correlation_warnings,
    linearisation_warnings,
    noise_meaning,
    noise_record,
    noise_unit,
)
from bayesfric.report.summary.read_back import PosteriorRow
from bayesfric.report.summary.residual_analysis import lacking
from bayesfric.report.summary.soundness import sound_quantities
from bayesfric.report.summary.validation import validation_record

Array = NDArray[np.float64]

LEVEL = 0.9
# Samples times draws for the totals; more draws change nothing that is printed.
_TOTALS_BUDGET = 50_000_000


def summarise(
    fit: Fit, references: Mapping[str, Any] | None = None, choice: Choice | None = None
) -> dict[str, Any]:
    """Put all numbers of a fit into the form of ``summary.json``.

    Parameters
    ----------
    fit
        A finished fit.
    references
        Values to compare with, as a configuration gives them.
    choice
        How the order of the noise was chosen, where it was.

    Returns
    -------
    dict
        Only strings, numbers, lists and dicts; numbers that do not exist are ``None``.
    """
    posterior = fit.posterior
    d = posterior.diagnostics
    flat, median = posterior.flat(), posterior.median
    local = local_information(fit.target, median)
    residual = fit.residuals
    outputs = fit.target.likelihood.outputs
    lags = [lag_one(r, o.follows) for o, r in zip(outputs, residual, strict=True)]
    noise = noise_record(fit, residual, lags, choice)
    parameters = _parameters(fit, flat, local)
    return {
        "bayesfric": bayesfric.__version__,
        "parameters": parameters,
        "fixed": {
            p.name: {"unit": p.unit, "value": float(value)}
            for p, value in zip(fit.chain.parameters, fit.chain_draws(1)[0], strict=True)
            if p.name not in fit.target.free
        },
        "derived": _totals(fit, median, local) | _derived(fit, median, local),
        "estimates": {estimate.method: estimate_summary(estimate) for estimate in fit.estimates},
        "references": dict(references or {}),
        "likelihood": {
            "method": fit.target.likelihood.method,
            "evaluation": fit.target.likelihood.evaluation,
            **({} if fit.linearisation is None else {"linearisation": _number(fit.linearisation)}),
        },
        "identifiability": {
            "null_directions": [
                {"parameters": n.exponents, "meaning": n.meaning} for n in local.null_directions
            ],
            "singular_values": [float(x) for x in local.directions.singular_values],
        },
        "noise": noise,
        "fit": {
            "residual_rms": rms(fit),
            **_explained(fit),
            "unit": outputs[0].unit,
            "quantity": outputs[0].quantity,
            "lacks": list(lacking(fit)),
            **_discretisation(fit.target.likelihood),
            "recordings": {
                o.name: {
                    "residual_rms": _rms(r),
                    "residual_lag1": _number(lag),
                    "outputs": int(o.measured.size),
                    **observation.settings,
                }
                for o, observation, r, lag in zip(
                    outputs, fit.observations, residual, lags, strict=True
                )
            },
        },
        **({"validation": validation_record(fit)} if fit.held_out else {}),
        "warnings": [
            *d.warnings,
            *_bound_warnings(parameters),
            *correlation_warnings(fit, noise),
            *linearisation_warnings(fit),
            *(
                f"{o.name}: {text}"
                for o in (*fit.observations, *(p.held_out.observation for p in fit.held_out))
                for text in o.warnings
            ),
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
            "stuck_walkers": int((d.acceptance == 0.0).sum()),
            "not_finite": d.not_finite,
            "not_finite_share": d.not_finite_share,
            "coordinates": posterior.coordinates,
            "seconds": round(d.seconds, 3),
            "seed": posterior.seed,
        },
    }


def rms(fit: Fit) -> float:
    """Give the root mean square of all residuals."""
    return _rms(np.concatenate(fit.residuals))


def _explained(fit: Fit) -> dict[str, float]:
    """Give the share of the measured torque's variance that the posterior mean explains."""
    if fit.target.likelihood.method == "output-error":
        return {}  # any simulated position is near the measured one
    # each recording about its own mean: an offset explains nothing
    whole = sum(float(np.sum((o.measured - o.measured.mean()) ** 2)) for o in fit.observations)
    left = sum(float(r @ r) for r in fit.residuals)
    return {"explained": 1.0 - left / whole} if whole > 0.0 else {}


def spreads(fit: Fit) -> dict[str, dict[str, Any]]:
    """Mean, sd, median and interval of all that :func:`summarise` gives an interval, by name."""
    flat = fit.posterior.flat()
    found = {name: _spread(flat[:, j]) for j, name in enumerate(fit.posterior.names)}
    projection = TotalsProjection(fit.chain, fit.observations)
    if wanted := _wanted_totals(fit, projection):
        draws = _total_draws(fit, projection)
        found |= {label: _spread(draws[:, i]) for i, _, label in wanted}
    at_load = _at_load(fit, fit.posterior.median)
    return found | {q.name: _spread(defined) for q, defined in _derived_draws(fit, at_load)}


def summary_table(summary: Mapping[str, Any]) -> str:
    """Lay the parameters and derived quantities of a summary out as CSV text."""
    columns = ["name", "unit", "mean", "sd", "median", "low", "high", "level", "rhat", "ess"]
    columns += ["prior", "prior_sd", "contraction", "verdict", "at_bound"]
    columns += ["converged", "undefined_share", "prior_sensitivity", "likelihood_sensitivity"]
    columns += ["white_low", "white_high"]
    out = io.StringIO()
    writer = csv.DictWriter(out, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for group in ("parameters", "derived"):
        for name, row in summary.get(group, {}).items():
            low, high = row["interval"]
            white_low, white_high = row.get("white_interval") or (None, None)
            ends = {"low": low, "high": high, "white_low": white_low, "white_high": white_high}
            writer.writerow({"name": name, **row, **ends})
    return out.getvalue()


def _discretisation(likelihood: Likelihood) -> dict[str, Any]:
    """Give steps and error of the simulation, where the likelihood simulates."""
    if not isinstance(likelihood, PositionLikelihood):
        return {}
    steps, error = likelihood.discretisation
    return {"integration_steps": steps, "discretisation_error": error}


def estimate_summary(estimate: Estimate) -> dict[str, Any]:
    """Put a point estimate into the form of ``summary.json``."""
    return {
        "parameters": {
            v.name: {
                "unit": v.unit,
                "symbol": v.symbol,
                "meaning": v.meaning,
                "value": v.value,
                "sd": _number(v.sd),
                "sd_robust": _number(v.sd_robust),
                "kind": v.kind,
                "gauge_free": v.gauge_free,
                "determined": v.determined,
                "at_bound": v.at_bound,
                "span": list(v.span) if v.span else None,
            }
            for v in estimate.values
        },
        "converged": estimate.converged,
        "point": dict(estimate.point),
        "residual_rms": estimate.residual_rms,
        "residual_unit": estimate.residual_unit,
        "outputs": estimate.n_outputs,
        "assumption": estimate.assumption,
        "notes": list(estimate.notes),
    }


def _parameters(fit: Fit, flat: Array, local: LocalInformation) -> dict[str, Any]:
    d = fit.posterior.diagnostics
    described = {p.name: (p.unit, p.symbol, p.meaning) for p in fit.chain.parameters}
    possible = {p.name: (p.lower, p.upper) for p in fit.chain.parameters}
    noise = fit.target.noise
    for name, symbol, quantity in zip(noise.names, noise.symbols, noise.quantities, strict=True):
        described[name] = (noise_unit(fit, quantity), symbol, noise_meaning(fit, quantity))
        possible[name] = (SCALES[quantity].lower, SCALES[quantity].upper)
    rows = {}
    moved_by = influence(fit)
    sound = d.sound(d.rhat, d.ess)
    for j, (name, prior) in enumerate(zip(fit.posterior.names, fit.posterior.priors, strict=True)):
        unit, symbol, meaning = described[name]
        sd, prior_sd = float(flat[:, j].std()), prior.sd()
        # the noise scale's own information: a variance estimated from n residuals
        data_sd = local.data_sd[j] if j < len(local.names) else sd
        rows[name] = {
            "unit": unit,
            "symbol": symbol,
            "meaning": meaning,
            **_spread(flat[:, j]),
            "rhat": _number(d.rhat[j]),
            "ess": _number(d.ess[j]),
            "converged": bool(sound[j]),
            "prior": prior.text,
            "prior_default": prior.default,
            "prior_sd": _number(prior_sd),
            "contraction": _number(1.0 - (sd / prior_sd) ** 2),
            "data_sd": _number(data_sd),
            "verdict": verdict(sd, prior_sd, data_sd),
            **_at_bound(flat[:, j], prior.limits, possible[name]),
            "prior_sensitivity": _number(moved_by[name].prior),
            "likelihood_sensitivity": _number(moved_by[name].likelihood),
            "diagnosis": moved_by[name].diagnosis,
            **({"period": TURN} if prior.circular else {}),
        }
    return rows


def _derived(fit: Fit, median: Array, local: LocalInformation) -> dict[str, Any]:
    at_load = _at_load(fit, median)
    prior = _prior_sds(fit, at_load)
    gradients = _gradients(fit, median, at_load)
    found = list(_derived_draws(fit, at_load))
    names = [q.name for q, _ in found]

    def values(draws: Array) -> Array:
        of = {q.name: q.values for q in derive(fit.chain, draws, at_load)}
        return np.stack([of[name] for name in names])

    sound = (
        sound_quantities(fit, values, len(names), fit.posterior.log_density.size) if names else ()
    )
    return {
        q.name: {
            "unit": q.unit,
            "symbol": q.symbol,
            "meaning": q.meaning,
            **_spread(defined),
            "converged": bool(converged),
            "verdict": verdict(
                _robust_sd(defined),
                prior[q.name],
                local.data_sd_of(gradients[q.name], gauge_free=q.gauge_free),
            ),
            "undefined_share": 1.0 - defined.size / q.values.size,
            "gauge_free": q.gauge_free,
        }
        for (q, defined), converged in zip(found, sound, strict=True)
    }


def _at_load(fit: Fit, median: Array) -> float:
    """Give the load at which efficiencies are stated."""
    middle = fit.target.chain_values(median[None])[0]
    return typical_load(fit.chain, fit.observations, middle)


def _derived_draws(fit: Fit, at_load: float) -> Iterator[tuple[Derived, Array]]:
    """Give every derived quantity that has an interval, with the draws where it is defined."""
    # what no scaling changes comes first: it is what the torque tells
    for q in sorted(derive(fit.chain, fit.chain_draws(), at_load), key=lambda q: not q.gauge_free):
        defined = q.values[np.isfinite(q.values)]
        # what only fixed parameters make up is known, and what most draws do not
        # have has no interval
        known = defined.size == q.values.size and np.ptp(defined) <= 1e-12 * np.abs(defined).max()
        if not known and defined.size >= 0.5 * q.values.size:
            yield q, defined


def _totals(fit: Fit, median: Array, local: LocalInformation) -> dict[str, Any]:
    """State what least squares, eq. (11), would find in each draw's torque."""
    projection = TotalsProjection(fit.chain, fit.observations)
    wanted = _wanted_totals(fit, projection)
    if not wanted:
        return {}
    draws = _total_draws(fit, projection)
    rng = np.random.default_rng(np.random.SeedSequence(fit.posterior.seed, spawn_key=(3,)))
    drawn = np.stack([prior.draw(300, rng) for prior in fit.posterior.priors], axis=1)
    prior = projection.solve(_stacked(fit, fit.target.chain_values(drawn))).T
    k = len(fit.target.free)
    steps = 1e-5 * np.maximum(np.abs(median[:k]), 1e-9)
    moved = fit.target.chain_values(_moved(median, steps))
    change = projection.solve(_stacked(fit, moved))
    gradients = (change[:, :k] - change[:, k:]) / (2.0 * steps)
    sound = sound_quantities(
        fit,
        lambda values: projection.solve(_stacked(fit, values)),
        len(projection.names),
        _totals_at_most(fit),
    )
    rows = {}
    for i, name, label in wanted:
        unit, symbol, meaning = projection.describe(name)
        rows[label] = {
            "unit": unit,
            "symbol": symbol,
            "meaning": f"{meaning}, as a fit without load losses would find it",
            **_spread(draws[:, i]),
            "converged": bool(sound[i]),
            "verdict": verdict(
                _robust_sd(draws[:, i]),
                _robust_sd(prior[:, i]),
                local.data_sd_of(gradients[i], gauge_free=True),
            ),
            "undefined_share": 0.0,
            "gauge_free": True,
        }
    return rows


def _wanted_totals(fit: Fit, projection: TotalsProjection) -> list[tuple[int, str, str]]:
    """List number, name and label of the totals that are determined and no parameter."""
    return [
        (i, name, label)
        for i, (name, label) in enumerate(zip(projection.names, projection.labels, strict=True))
        if label not in fit.chain.names and not projection.open[i]
    ]


def _total_draws(fit: Fit, projection: TotalsProjection) -> Array:
    """Find all totals in the torque of each draw, ``(n, totals)``."""
    values = fit.chain_draws(_totals_at_most(fit))
    return projection.solve(_stacked(fit, values)).T


def _totals_at_most(fit: Fit) -> int:
    """Count the draws whose totals are found."""
    return max(400, _TOTALS_BUDGET // sum(o.q.size for o in fit.observations))


def _stacked(fit: Fit, values: Array) -> Array:
    """Filter the torques of parameter vectors over all recordings, ``(outputs, n)``."""
    return np.concatenate(
        [filtered_torque(fit.chain, o, values) for o in fit.observations], axis=1
    ).T


def _moved(median: Array, steps: Array) -> Array:
    """Vectors a step to either side in each free parameter, ``(2k, d)``."""
    k = steps.size
    moved = np.tile(median, (2 * k, 1))
    index = np.arange(k)
    moved[index, index] += steps
    moved[k + index, index] -= steps
    return moved


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
    found = derive(fit.chain, fit.target.chain_values(_moved(median, steps)), at_load)
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


def _at_bound(
    x: Array, prior: tuple[float, float], possible: tuple[float, float]
) -> dict[str, Any]:
    """Say on which bound a posterior leans: 5 % of it within a fifth of an sd of the bound.

    A bound of the prior is physical where the parameter can go no further.
    """
    low, high = np.quantile(x, [0.05, 0.95])
    near = 0.2 * x.std()
    if low - prior[0] < near:
        side = 0
    elif prior[1] - high < near:
        side = 1
    else:
        return {"at_bound": None}
    return {
        "at_bound": ("lower", "upper")[side],
        "bound": prior[side],
        "bound_physical": prior[side] == possible[side],
    }


def _bound_warnings(parameters: Mapping[str, Any]) -> list[str]:
    found = (
        bound_warning(name, PosteriorRow.model_validate(row))
        for name, row in parameters.items()
        if row["converged"]
    )
    return [text for text in found if text]


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _number(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None
