"""What is concluded of every number of a summary, from all that was asked of it."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import norm

from bayesfric.identifiability.local import WIDE
from bayesfric.inference.fitting import Fit
from bayesfric.report.summary.bounds import held, leaning, told_by_data
from bayesfric.report.summary.derived_quantities import Groups, spread
from bayesfric.report.summary.record import ModelError, Summary, of_noise
from bayesfric.report.summary.rows import PosteriorRow
from bayesfric.report.summary.self_check_part import cited
from bayesfric.results.reported import Reported, Spread, concluded


def add_model_error(summary: Summary, fit: Fit, derived: Groups) -> Summary:
    """Put intervals with room for what the model may lack into a summary, and judge by them.

    ``derived`` are the fit's :func:`~bayesfric.report.summary.derived_quantities.groups`.
    """
    room = fit.discrepancy
    if room is None:
        return summary
    told = ModelError(shown=room.shown, chance=room.chance, taken=room.taken)
    if not room.shown:
        return summary.model_copy(update={"model_error": told})
    wide = fit.wide.posterior.flat()
    found = {n: wide[:, j] for j, n in enumerate(fit.posterior.names) if not of_noise(n)}
    for group in derived:
        if group.found:
            some = wide[:: -(-len(wide) // group.most)]
            with np.errstate(divide="ignore", invalid="ignore"):
                values = group.values(fit.target.chain_values(some))
            found |= {q.name: x for q, x in zip(group.found, values, strict=True)}
    changes = {name: _change(summary, name, x) for name, x in found.items()}
    limits = {p.name: (p.lower, p.upper) for p in fit.chain.parameters}
    for name, prior in zip(fit.posterior.names, fit.posterior.priors, strict=True):
        if changes.get(name) and summary.rows[name].at_bound is None:
            # what has more room may come to lean on a bound
            changes[name] |= leaning(found[name], prior.limits, limits[name])
    return summary.with_rows(changes, model_error=told)


def _change(summary: Summary, name: str, draws: np.ndarray) -> dict[str, Any]:
    """Say what changes of a row; nothing of one that the data leave open anyway."""
    row = summary.rows[name]
    is_open = row.verdict == "prior" and not held(row)
    if is_open or np.isfinite(draws).sum() < 0.5 * draws.size:
        return {}
    wide = spread(draws)
    low, high = wide["interval"]
    # what is improbable and far is no standard deviation: that of a normal as wide
    sd = min(wide["sd"], (high - low) / (2.0 * norm.ppf(0.5 + 0.5 * wide["level"])))
    change = {"model_error_value": wide["median"], "model_error_sd": sd}
    change["model_error_interval"] = wide["interval"]
    if row.verdict == "data" and row.prior_sd and sd > WIDE * row.prior_sd:
        change["verdict"] = "weak"
    return change


def put_reported(summary: Summary) -> Summary:
    """Put the one value, interval and status into every row; the last thing that is done.

    Runs of older versions, which have none, are concluded as they are read; what has all stays.
    """
    if all(row.reported is not None for row in summary.rows.values()):
        return summary
    corrected = cited(summary)
    changes: dict[str, dict[str, Any]] = {}
    rows = summary.self_check.rows if summary.self_check else {}
    for name, row in summary.rows.items():
        right = corrected.get(name)
        bias = rows[name].bias if right else None
        changes[name] = {"reported": _reported(summary, row, right, bias)}
    return summary.with_rows(changes)


def _reported(
    summary: Summary,
    row: PosteriorRow,
    corrected: tuple[float, float, float, float] | None,
    bias: float | None,
) -> Reported:
    widened = None
    if row.model_error_interval is not None and row.model_error_sd is not None:
        low, high = row.model_error_interval
        value = row.middle if row.model_error_value is None else row.model_error_value
        widened = Spread(value, low, high, row.model_error_sd)
    leans = row.at_bound is not None and (row.verdict == "data" or told_by_data(row))
    unusable = summary.sampler.status == "unusable"
    reliable = summary.sampler.status == "reliable"
    low, high = row.interval
    return concluded(
        Spread(row.middle, low, high, row.sd),
        verdict=row.verdict,
        own_prior=bool(row.given_by) or (not row.prior_default and bool(row.prior)),
        converged=reliable or (not unusable if row.converged is None else row.converged),
        widened=widened,
        corrected=Spread(*corrected) if corrected else None,
        bias=bias,
        limit=row.at_bound if leans else None,
        findings=row.doubted if row.verdict != "prior" else (),
    )
