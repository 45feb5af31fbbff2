"""Quantities derived from the parameters: their draws, priors and rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesfric.estimates.least_squares import TotalsProjection
from bayesfric.estimates.torque import filtered_torque, typical_load
from bayesfric.identifiability.local import LocalInformation, given_by, verdict
from bayesfric.inference.fitting import Fit
from bayesfric.inference.posterior import (
    autocorrelation_time,
    effective_sample_size,
    nested_rhat,
)
from bayesfric.inference.priors import bound_of
from bayesfric.inference.target import Target
from bayesfric.mechanism.derived import Derived, derive
from bayesfric.mechanism.quantities import quantity_of
from bayesfric.recordings.arrays import Array, Flags
from bayesfric.report.summary.record import Described, PosteriorRow
from bayesfric.report.words import listed
from bayesfric.results.reported import LEVEL as LEVEL

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
    """Derived quantities that are computed together."""

    quantities: list[Derived]  # with the posterior's draws of each
    target: Target
    of_chain: Callable[[Array], Array]  # the chain's parameters `(n, n_parameters)` to `(k, n)`
    max_count: int  # draws that are enough to judge them by
    prior: tuple[int, int]  # number of draws of the prior, and the key of their random numbers

    def values(self, draws: Array) -> Array:
        """Compute the quantities ``(k, n)`` of draws ``(n, d)`` of the sampled parameters."""
        if not self.quantities:
            return np.empty((0, len(draws)))
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.of_chain(self.target.chain_values(draws))

    def named(self, draws: Array) -> dict[str, Array]:
        """Give the quantities of draws by name, ``(n,)`` each."""
        return {q.name: x for q, x in zip(self.quantities, self.values(draws), strict=True)}


Groups = tuple[Group, Group]


def groups(fit: Fit) -> Groups:
    """Give totals, as least squares would estimate them from each draw's torque, and coefficients.

    The totals take as long as some hundred steps of the sampling: compute them once for a fit.
    """
    return _totals(fit), coefficients(fit)


def described_as(quantity: Any) -> dict[str, Any]:
    """Give unit, symbol and meaning of a parameter or derived quantity."""
    return {key: getattr(quantity, key) for key in Described.model_fields}


def spread(x: Array) -> dict[str, Any]:
    """Give mean, sd, median and interval of the finite draws."""
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
    """Give the bound on which a posterior leans; physical where nothing is possible beyond."""
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
    """Give the bound on which a factor or efficiency ``(n,)`` leans, as its loss does.

    Two-sided, ``alpha`` in [0.93, 0.98] would exclude what "at most 0.06" of the loss does not.
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


def derived_rows(fit: Fit, local: LocalInformation, derived: Groups) -> dict[str, PosteriorRow]:
    """Put all derived quantities into the form of ``summary.json``, by name."""
    rows = {}
    for group in (group for group in derived if group.quantities):
        of_each = (
            group.values(fit.posterior.prior_draws(*group.prior)),
            gradients(fit, group),
            sound_quantities(fit, group),
        )
        for q, prior, change, converged in zip(group.quantities, *of_each, strict=True):
            data_sd = local.data_sd_of(change, gauge_free=q.gauge_free)
            prior_sd, sd = _robust_sd(prior), _robust_sd(q.values)
            by = determination(fit, local, change, (sd, prior_sd, data_sd))
            by |= {"prior_sd": prior_sd, **loss_leaning(q.name, q.values)}
            rows[q.name] = PosteriorRow(
                **described_as(q),
                **spread(q.values),
                converged=bool(converged),
                **by,
                undefined_share=1.0 - float(np.isfinite(q.values).mean()),
                gauge_free=q.gauge_free,
                of_motion=q.of_motion,
            )
    return rows


def determination(
    fit: Fit, local: LocalInformation, change: Array, sds: Sequence[float], own: int | None = None
) -> dict[str, Any]:
    """Say what determines a number: data, data and prior, a prior, or priors on others.

    ``change`` is with each parameter, ``sds`` are of posterior, prior and data, ``own`` is which
    parameter it is.
    """
    sd, prior_sd, _ = sds
    judged = verdict(*sds)
    if judged == "prior" and change.size:
        names = given_by(local, fit.posterior.priors, change, sd, prior_sd, own)
        if names:
            return {"verdict": "weak", "given_by": names}
    return {"verdict": judged}


def _totals(fit: Fit, *, budget: int = 25_000_000) -> Group:
    """Give the totals of eq. (11) that are determined and no parameter.

    ``budget`` is samples times draws; more draws change no printed digit.
    """
    observations = [o.excerpt() for o in fit.observations]
    projection = TotalsProjection(fit.chain, observations)
    names = list(zip(projection.names, projection.labels, projection.open, strict=True))
    # a torque that was computed with another gain has no totals
    wanted = [
        i
        for i, (_, label, open_) in enumerate(names)
        if not (label in fit.chain.names or open_ or fit.chain.kp)
    ]
    max_count = max(400, budget // sum(o.q.size for o in observations))

    def every(parameters: Array) -> Array:
        torques = [filtered_torque(fit.chain, o, parameters) for o in observations]
        return projection.solve(np.concatenate(torques, axis=1).T)

    drawn = every(fit.chain_draws(max_count)) if wanted else np.empty((len(names), 1))
    described = [projection.describe(name) for name, *_ in names]
    wanted = [i for i in wanted if not _is_zero(i, drawn, [unit for unit, *_ in described])]

    # load-dependent friction biases the other terms, along each motion differently
    lossy = any(element.load_loss != "none" for element in fit.chain.elements)
    bent = sorted({p.row.bent_by for p in fit.chain.parameters if p.row.bends}, reverse=True)
    without = f", as a fit without {listed(bent)} estimates it" if bent else ""
    quantities = []
    for i in wanted:
        unit, symbol, meaning = described[i]
        flags = {"gauge_free": True, "of_motion": lossy}
        quantities.append(Derived(names[i][1], unit, symbol, meaning + without, drawn[i], **flags))
    return Group(
        quantities, fit.target, lambda parameters: every(parameters)[wanted], max_count, (300, 3)
    )


def _is_zero(i: int, drawn: Array, units: Sequence[str], *, rounding: float = 1e-9) -> bool:
    """Whether a total is zero by geometry, but for a share of the others of its unit."""
    sizes = np.abs(drawn).max(axis=1)
    same_unit = [size for size, unit in zip(sizes, units, strict=True) if unit == units[i]]
    return bool(sizes[i] <= rounding * max(same_unit))


def coefficients(fit: Fit) -> Group:
    """Derive every quantity that has an interval, at the load at which efficiencies are stated."""
    middle = fit.target.chain_values(fit.posterior.median[None])[0]
    at_load = typical_load(fit.chain, fit.observations, middle)
    # what no scaling changes comes first
    every = sorted(derive(fit.chain, fit.chain_draws(), at_load), key=lambda q: not q.gauge_free)
    shown = [q for q in every if _has_interval(q.values)]

    def values(parameters: Array) -> Array:
        of = {q.name: q.values for q in derive(fit.chain, parameters, at_load)}
        return np.stack([of[q.name] for q in shown])

    return Group(shown, fit.target, values, fit.posterior.log_density.size, (2000, 2))


def _has_interval(x: Array) -> bool:
    """Whether a quantity is neither of fixed parameters only nor undefined in most draws."""
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
    """Judge the convergence of quantities by their R-hat and effective sample size, ``(k,)``.

    What no scaling changes may have converged where the parameters it is made of have not.
    """
    number, diagnostics = len(group.quantities), fit.posterior.diagnostics
    if diagnostics.status == "reliable":
        return np.ones(number, dtype=np.bool_)
    draws = fit.posterior.draws
    ensembles, walkers, steps, d = draws.shape
    draws = draws[:, :, :: max(1, -(-ensembles * walkers * steps // group.max_count))]
    if draws.shape[2] < 2:
        return np.zeros(number, dtype=np.bool_)
    values = group.values(draws.reshape(-1, d))
    with np.errstate(invalid="ignore"):
        middle = np.nanmedian(np.where(np.isfinite(values), values, np.nan), axis=1, keepdims=True)
    # draws in which a quantity is undefined say nothing against it
    values = np.where(np.isfinite(values), values, middle)
    series = np.moveaxis(values.reshape(number, *draws.shape[:3]), 0, -1)
    ess = effective_sample_size(series, autocorrelation_time(series))
    return diagnostics.sound(nested_rhat(series), ess)
