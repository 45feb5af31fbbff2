"""Quantities that follow from the parameters: what draws, priors and data say of each."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesfric.estimates.least_squares import TotalsProjection
from bayesfric.estimates.torque import typical_load, weighted_torque
from bayesfric.identifiability.local import LocalInformation, given_by, verdict
from bayesfric.inference.fitting import Fit
from bayesfric.inference.prior.priors import bound_of
from bayesfric.inference.sampling import convergence
from bayesfric.inference.target import Target
from bayesfric.mechanism.derived import Derived, derive
from bayesfric.mechanism.parameter import quantity_of
from bayesfric.recordings.arrays import Array, Flags
from bayesfric.report.summary.rows import Described
from bayesfric.report.words import listed
from bayesfric.results.reported import LEVEL as LEVEL

# Samples times draws for the totals; more draws change nothing that is printed.
_TOTALS_BUDGET = 25_000_000
# A total below this share of the others of its unit is zero but for rounding.
_NOUGHT = 1e-9
# The loss per torque that a factor or an efficiency is made of, eqs. (4) and (6), and the side on
# which one lies where there is none.
_LOSSES: dict[str, tuple[Callable[[Array], Array], str]] = {
    "alpha_drive": (lambda x: 1.0 / x - 1.0, "upper"),
    "alpha_back": (lambda x: 1.0 - 1.0 / x, "lower"),
    "efficiency_drive": (lambda x: 1.0 / x - 1.0, "upper"),
    "efficiency_back": (lambda x: 1.0 - x, "upper"),
}


@dataclass(frozen=True)
class Group:
    """Quantities computed alike.

    ``found`` has the posterior's draws of each; ``of_chain`` brings the chain's parameters
    ``(n, n_parameters)`` to them, ``(k, n)``; ``most`` draws are enough to judge them by;
    ``prior`` is how many of its draws, and the key of their random numbers.
    """

    found: list[Derived]
    target: Target
    of_chain: Callable[[Array], Array]
    most: int
    prior: tuple[int, int]

    def values(self, draws: Array) -> Array:
        """Bring draws ``(n, d)`` of the sampled parameters to the quantities, ``(k, n)``."""
        if not self.found:
            return np.empty((0, len(draws)))
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.of_chain(self.target.chain_values(draws))

    def named(self, draws: Array) -> dict[str, Array]:
        """Give the quantities of draws by name, ``(n,)`` each."""
        return {q.name: x for q, x in zip(self.found, self.values(draws), strict=True)}


Groups = tuple[Group, Group]


def groups(fit: Fit) -> Groups:
    """Give totals, as least squares would find them in each draw's torque, and coefficients.

    The totals take as long as some hundred steps of the sampling: once is enough for a fit.
    """
    return _totals(fit), coefficients(fit)


def described_as(what: Any) -> dict[str, str]:
    """Give unit, symbol and meaning of a parameter or derived quantity."""
    return {key: getattr(what, key) for key in Described.model_fields}


def rms_of(x: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(x**2)))


def spread(x: Array) -> dict[str, Any]:
    """Mean, sd, median and interval of draws; those that are no numbers do not count."""
    x = x[np.isfinite(x)]
    low, middle, high = np.quantile(x, [0.5 - LEVEL / 2, 0.5, 0.5 + LEVEL / 2])
    return {
        "mean": float(x.mean()),
        "sd": float(x.std()),
        "median": float(middle),
        "interval": [float(low), float(high)],
        "level": LEVEL,
    }


def leaning(x: Array, prior: tuple[float, float], possible: tuple[float, float]) -> dict[str, Any]:
    """Say on which bound a posterior leans; it is physical where nothing is possible beyond."""
    side = bound_of(x[np.isfinite(x)], *prior)
    if side is None:
        return {"at_bound": None}
    end = 0 if side == "lower" else 1
    return {
        "at_bound": side,
        "bound": prior[end],
        "bound_physical": prior[end] == possible[end],
    }


def loss_leaning(name: str, x: Array) -> dict[str, Any]:
    """Say whether a factor or efficiency ``(n,)`` is known from one side only, as its loss is.

    As two-sided, ``alpha`` in [0.93, 0.98] would shut out what "at most 0.06" of the loss does not.
    """
    if quantity_of(name) not in _LOSSES:
        return {}
    loss, side = _LOSSES[quantity_of(name)]
    if bound_of(loss(x[np.isfinite(x)]), 0.0, math.inf) is None:
        return {"at_bound": None}
    return {"at_bound": side, "bound": 1.0, "bound_physical": True}


def gradients(fit: Fit, group: Group) -> Array:
    """Give the change of quantities with each free parameter at the median, ``(k, n_free)``."""
    median, k = fit.posterior.median, len(fit.target.free)
    steps = 1e-5 * np.maximum(np.abs(median[:k]), 1e-9)
    either = np.concatenate([np.diag(steps), -np.diag(steps)])
    change = group.values(median + np.pad(either, ((0, 0), (0, median.size - k))))
    return np.asarray((change[:, :k] - change[:, k:]) / (2.0 * steps))


def derived_rows(fit: Fit, local: LocalInformation, derived: Groups) -> dict[str, dict[str, Any]]:
    """Put all derived quantities into the form of ``summary.json``, by name."""
    rows = {}
    for group in (one for one in derived if one.found):
        of_each = (
            group.values(fit.posterior.prior_draws(*group.prior)),
            gradients(fit, group),
            sound_quantities(fit, group),
        )
        for q, prior, change, converged in zip(group.found, *of_each, strict=True):
            told = local.data_sd_of(change, gauge_free=q.gauge_free)
            prior_sd, sd = _robust_sd(prior), _robust_sd(q.values)
            by: dict[str, Any] = {"verdict": verdict(sd, prior_sd, told), "prior_sd": prior_sd}
            if by["verdict"] == "prior":
                by |= weakly_given(given_by(local, fit.posterior.priors, change, sd, prior_sd))
            by |= loss_leaning(q.name, q.values)
            if np.isfinite(prior).any():
                by["prior_interval"] = spread(prior)["interval"]
            rows[q.name] = {
                **described_as(q),
                **spread(q.values),
                "converged": bool(converged),
                **by,
                "undefined_share": 1.0 - float(np.isfinite(q.values).mean()),
                "gauge_free": q.gauge_free,
                **({"of_motion": True} if q.of_motion else {}),
            }
    return rows


def weakly_given(names: list[str]) -> dict[str, Any]:
    """Say that neither data nor a prior of its own settle a number, but told priors do."""
    return {"verdict": "weak", "given_by": names} if names else {}


def _totals(fit: Fit) -> Group:
    """Give the totals of eq. (11) that are determined and no parameter."""
    observations = [o.excerpt() for o in fit.observations]
    projection = TotalsProjection(fit.chain, observations)
    names = list(zip(projection.names, projection.labels, projection.open, strict=True))
    wanted = [
        i for i, (_, label, open_) in enumerate(names) if label not in fit.chain.names and not open_
    ]

    most = max(400, _TOTALS_BUDGET // sum(o.q.size for o in observations))

    maps = projection.of_samples()

    def every(parameters: Array) -> Array:
        pairs = zip(observations, maps, strict=True)
        parts = [weighted_torque(fit.chain, o, one, parameters) for o, one in pairs]
        return np.asarray(np.sum(parts, axis=0))

    drawn = every(fit.chain_draws(most)) if wanted else np.empty((len(names), 1))
    described = [projection.describe(name) for name, *_ in names]
    wanted = [i for i in wanted if not _nought(i, drawn, [unit for unit, *_ in described])]

    # what a load loss adds is spread over the other terms, along each motion differently
    lossy = any(element.load_loss != "none" for element in fit.chain.elements)
    bent = sorted({p.row.bent_by for p in fit.chain.parameters if p.row.bends}, reverse=True)
    without = f", as a fit without {listed(bent)} would find it" if bent else ""
    found = []
    for i in wanted:
        unit, symbol, meaning = described[i]
        meaning += without
        told = {"gauge_free": True, "of_motion": lossy}
        found.append(Derived(names[i][1], unit, symbol, meaning, drawn[i], **told))
    return Group(found, fit.target, lambda parameters: every(parameters)[wanted], most, (300, 3))


def _nought(i: int, drawn: Array, units: Sequence[str]) -> bool:
    """Whether a total is nought by geometry: no finding, for what is left of it is rounding."""
    sizes = np.abs(drawn).max(axis=1)
    alike = [size for size, unit in zip(sizes, units, strict=True) if unit == units[i]]
    return bool(sizes[i] <= _NOUGHT * max(alike))


def coefficients(fit: Fit) -> Group:
    """Give every quantity that has an interval, at the load at which efficiencies are stated."""
    middle = fit.target.chain_values(fit.posterior.median[None])[0]
    at_load = typical_load(fit.chain, fit.observations, middle)
    # what no scaling changes comes first: it is what the torque tells
    every = sorted(derive(fit.chain, fit.chain_draws(), at_load), key=lambda q: not q.gauge_free)
    found = [q for q in every if _has_interval(q.values)]

    def values(parameters: Array) -> Array:
        of = {q.name: q.values for q in derive(fit.chain, parameters, at_load)}
        return np.stack([of[q.name] for q in found])

    return Group(found, fit.target, values, fit.posterior.log_density.size, (2000, 2))


def _has_interval(x: Array) -> bool:
    """Whether a quantity is neither known, of fixed parameters only, nor missing in most draws."""
    defined = x[np.isfinite(x)]
    if defined.size < x.size:
        return defined.size >= 0.5 * x.size
    return bool(np.ptp(x) > 1e-12 * np.abs(x).max())


def _robust_sd(x: Array) -> float:
    """Estimate a sd from quartiles: alpha_2 = 1/(1 - mu_2) has no finite one under many priors."""
    x = x[np.isfinite(x)]
    low, high = np.quantile(x, [0.25, 0.75]) if x.size else (0.0, 0.0)
    return float((high - low) / 1.349)


def sound_quantities(fit: Fit, group: Group) -> Flags:
    """Judge quantities by R-hat and independent draws of their own, ``(k,)``.

    What no scaling changes may be known where the parameters it is made of still wander.
    """
    number, diagnostics = len(group.found), fit.posterior.diagnostics
    if diagnostics.status == "reliable":
        return np.ones(number, dtype=np.bool_)
    draws = convergence.without_stuck(fit.posterior.draws, diagnostics.acceptance)
    ensembles, walkers, steps, d = draws.shape
    draws = draws[:, :, :: max(1, -(-ensembles * walkers * steps // group.most))]
    if draws.shape[2] < 2:
        return np.zeros(number, dtype=np.bool_)
    found = group.values(draws.reshape(-1, d))
    with np.errstate(invalid="ignore"):
        middle = np.nanmedian(np.where(np.isfinite(found), found, np.nan), axis=1, keepdims=True)
    # draws that do not have a quantity say nothing against it
    found = np.where(np.isfinite(found), found, middle)
    series = np.moveaxis(found.reshape(number, *draws.shape[:3]), 0, -1)
    ess = convergence.effective_sample_size(series, convergence.autocorrelation_time(series))
    return diagnostics.sound(convergence.nested_rhat(series), ess)
