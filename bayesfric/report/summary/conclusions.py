"""Conclusions on every number of a summary: bounds, model discrepancy, and what is reported."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.stats import norm

from bayesfric.identifiability.local import WIDE
from bayesfric.inference.fitting import Fit
from bayesfric.inference.noise import SCALES
from bayesfric.report.summary.derived_quantities import Groups, leaning, loss_leaning, spread
from bayesfric.report.summary.record import ModelError, Summary, of_noise
from bayesfric.report.summary.rows import PosteriorRow
from bayesfric.report.words import line_of
from bayesfric.results.reported import Spread, concluded


def told_by_data(row: PosteriorRow) -> bool:
    """Whether the data, with the priors on a scale if need be, say how far from its bound it is."""
    known = row.data_sd is not None and row.data_sd < WIDE * (row.prior_sd or math.inf)
    return known or bool(row.given_by)


def held(row: PosteriorRow) -> bool:
    """Whether the data push a number against its bound; a prior alone leans on bounds too."""
    return row.at_bound is not None and (row.verdict != "prior" or told_by_data(row))


def bound_hint(name: str, row: PosteriorRow) -> str:
    """Say what to do about the bound that holds a number; nothing where none does.

    Nor where the bound is that of the residuals' autocorrelation.
    """
    if not held(row) or row.bound is None or _of_residuals(name):
        return ""
    bound = f"{row.bound:.4g} {row.unit}".strip()
    kind = "physical bound" if row.bound_physical else "set bound"
    return line_of(kind, {"name": name, "bound": bound})


def _of_residuals(name: str) -> bool:
    """Whether it is of the noise, and the residuals of an estimate choose it."""
    scale = SCALES.get(name.split(".")[1]) if of_noise(name) else None
    return scale is not None and scale.chosen


def noise_cut(name: str, row: PosteriorRow) -> bool:
    """Whether a prior keeps noise smaller than in the data: intervals are then too narrow."""
    if not of_noise(name) or row.at_bound != "upper" or row.bound_physical or not held(row):
        return False
    return name.split(".")[1] in SCALES and not _of_residuals(name) and row.bound is not None


def bound_warning(name: str, row: PosteriorRow) -> str | None:
    """Warn of a bound that was set, not given by physics: it cuts the posterior off.

    Where that concerns all numbers it is a doubt (:func:`noise_cut`).
    """
    if row.bound_physical or noise_cut(name, row) or not (hint := bound_hint(name, row)):
        return None
    return line_of("bound", {"name": name, "side": row.at_bound, "fix": hint})


def add_model_error(summary: Summary, fit: Fit, derived: Groups) -> Summary:
    """Put intervals with model discrepancy into a summary, and judge by them."""
    discrepancy = fit.discrepancy
    if discrepancy is None:
        return summary
    part = ModelError(shown=discrepancy.is_plausible, chance=discrepancy.chance)
    if not discrepancy.moved:
        return summary.model_copy(update={"model_error": part})
    wide = fit.wide.posterior.flat()
    draws = {n: wide[:, j] for j, n in enumerate(fit.posterior.names) if not of_noise(n)}
    for group in derived:
        draws |= group.named(wide[:: -(-len(wide) // group.most)])
    changes = {name: _change(summary, name, x) for name, x in draws.items()}
    possible = {p.name: (p.lower, p.upper) for p in fit.chain.parameters}
    priors = {n: p.limits for n, p in zip(fit.posterior.names, fit.posterior.priors, strict=True)}
    for name, change in changes.items():
        if change and summary.rows[name].at_bound is None:
            # a wider posterior may come to lean on a bound
            limits, x = priors.get(name), draws[name]
            change |= leaning(x, limits, possible[name]) if limits else loss_leaning(name, x)
    return summary.with_rows(changes, model_error=part)


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
    change = {"model_error_sd": sd, "model_error_interval": wide["interval"]}
    if row.verdict == "data" and row.prior_sd and sd > WIDE * row.prior_sd:
        change["verdict"] = "weak"
    return change


def put_reported(summary: Summary) -> Summary:
    """Put the one value, interval and status into every row, as the last step of all.

    A summary whose rows all have them stays as it is.
    """
    if all(row.reported is not None for row in summary.rows.values()):
        return summary
    status = summary.sampler.status
    changes: dict[str, dict[str, Any]] = {}
    for name, row in summary.rows.items():
        leans = row.at_bound is not None and (row.verdict == "data" or told_by_data(row))
        low, high = row.interval
        sound = status != "unusable" if row.converged is None else row.converged
        changes[name] = {
            "reported": concluded(
                Spread(row.middle, low, high, row.sd),
                verdict=row.verdict,
                own_prior=bool(row.given_by) or (not row.prior_default and bool(row.prior)),
                converged=status == "reliable" or sound,
                widened=row.widened,
                limit=row.at_bound if leans else None,
                findings=row.doubted if row.verdict != "prior" else (),
            )
        }
    return summary.with_rows(changes)
