"""What a summary says of the model's own error: wider intervals, where recordings show any."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from bayesfric.inference.fitting import Fit
from bayesfric.inference.outlying import Outlying
from bayesfric.report.summary.bounds import leaning
from bayesfric.report.summary.derived_quantities import Groups, spread
from bayesfric.report.summary.noise import correlation_warning
from bayesfric.report.summary.record import ModelError as Told
from bayesfric.report.summary.record import Summary, of_noise

# Share of the prior's sd from which on data do not determine a number, as in
# bayesfric.identifiability.local.verdict.
_WIDE = 0.5


def add_model_error(summary: Summary, fit: Fit, derived: Groups) -> Summary:
    """Put intervals with the model's error into a summary, and judge verdicts by them.

    ``derived`` are the fit's :func:`~bayesfric.report.summary.derived_quantities.groups`.
    """
    error = fit.model_error
    if error is None:
        return summary
    axes = [asdict(axis) | {"differs": axis.differs} for axis in error.axes]
    reason = {} if error.reason is None else {"reason": error.reason}
    outlying = [asdict(one) | {"off": _off(fit, one)} for one in error.outlying]
    far = {"outlying": outlying, "set_aside": error.set_aside}
    told = Told.model_validate({"shown": error.shown, "axes": axes, **reason, **far})
    if not error.shown:
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
    after = summary.with_rows(changes, model_error=told)
    # of which intervals are too narrow it says something else now
    before = correlation_warning(summary)
    warnings = [correlation_warning(after) if w == before else w for w in summary.warnings]
    return after.model_copy(update={"warnings": [w for w in warnings if w]})


def _off(fit: Fit, one: Outlying) -> float:
    """Give what the posterior leaves of an output, in its unit."""
    outputs, left = fit.target.likelihood.outputs, fit.residuals
    (k,) = (k for k, o in enumerate(outputs) if o.name == one.recording)
    return abs(float(left[k][int(np.argmin(np.abs(outputs[k].time - one.time)))]))


def _change(summary: Summary, name: str, draws: np.ndarray) -> dict[str, Any]:
    """Say what changes of a row; nothing of one that the data leave open anyway."""
    row = summary.rows[name]
    if row.verdict == "prior" or np.isfinite(draws).sum() < 0.5 * draws.size:
        return {}
    wide = spread(draws)
    change = {"model_error_interval": wide["interval"], "model_error_sd": wide["sd"]}
    if row.verdict == "data" and row.prior_sd and wide["sd"] > _WIDE * row.prior_sd:
        change["verdict"] = "weak"
    return change
