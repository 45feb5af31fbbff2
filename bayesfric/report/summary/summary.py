"""Summary of a finished fit: what ``summary.json`` holds before it is examined."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayesfric.base import __version__
from bayesfric.estimates.autoregression import lag_one
from bayesfric.estimates.point_estimate import Estimate
from bayesfric.identifiability.coverage import back_driving_shares
from bayesfric.identifiability.local import (
    LocalInformation,
    given_by,
    local_information,
    meaning_of,
    verdict,
)
from bayesfric.inference.fitting import Fit
from bayesfric.inference.noise import SCALES, NoiseChoice
from bayesfric.inference.posterior import Posterior
from bayesfric.inference.prior.priors import Prior
from bayesfric.mechanism.quantities import TURN
from bayesfric.report.summary import noise as noise_part
from bayesfric.report.summary.conclusions import bound_warning
from bayesfric.report.summary.derived_quantities import (
    LEVEL,
    Groups,
    derived_rows,
    described_as,
    groups,
    leaning,
    rms_of,
    spread,
    weakly_given,
)
from bayesfric.report.summary.parts import validation_record
from bayesfric.report.summary.record import Summary
from bayesfric.report.summary.rows import EstimatedRow
from bayesfric.report.terminal import PrintedSummary
from bayesfric.report.words import line_of

# Share of the outputs in one way of driving below which its friction follows from the other way.
_SELDOM = 0.1


def summarise(
    fit: Fit,
    references: Mapping[str, Any] | None = None,
    choice: NoiseChoice | None = None,
    derived: Groups | None = None,
) -> Summary:
    """Summarise a fit; numbers that do not exist are ``None``.

    ``references`` are as a configuration gives them, ``derived`` are computed where left out.
    """
    posterior = fit.posterior
    local = local_information(fit.target, posterior.median)
    residual = fit.residuals
    outputs = fit.target.likelihood.outputs
    lags = [lag_one(r, o.follows) for o, r in zip(outputs, residual, strict=True)]
    document = {
        "bayesfric": __version__,
        "parameters": _parameters(fit, local),
        "fixed": {
            p.name: {**described_as(p), "value": float(value)}
            for p, value in zip(fit.chain.parameters, fit.chain_draws(1)[0], strict=True)
            if p.name not in fit.target.free
        },
        "derived": derived_rows(fit, local, groups(fit) if derived is None else derived),
        "estimates": {estimate.method: estimate_summary(estimate) for estimate in fit.estimates},
        "references": dict(references or {}),
        "likelihood": {
            "method": fit.target.likelihood.method,
            **({} if fit.linearisation is None else {"linearisation": _number(fit.linearisation)}),
        },
        "identifiability": {
            "null_directions": [
                {"parameters": n, "meaning": meaning_of(n)} for n in local.null_directions
            ],
        },
        "noise": noise_part.noise_record(fit, residual, choice),
        "fit": {
            "residual_rms": rms_of(np.concatenate(residual)),
            **_explained(fit),
            "torque_constant": _torque_constant(fit),
            "unit": outputs[0].unit,
            "quantity": outputs[0].quantity,
            "recordings": {
                o.name: {
                    "residual_rms": rms_of(r),
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
        "sampler": _sampler(posterior),
    }
    summary = _with_mirrored(PrintedSummary.model_validate(document), fit)
    sound = {name: row for name, row in summary.parameters.items() if row.converged}
    unseen = fit.chain.unseen_inertia
    warnings = [
        *posterior.diagnostics.warnings,
        line_of("unseen-inertia", {"names": unseen}) if unseen else "",
        *(bound_warning(name, row) for name, row in sound.items()),
        noise_part.linearisation_warning(summary.likelihood),
        *(
            f"{o.name}: {text}"
            for o in (*fit.observations, *(p.held_out.observation for p in fit.held_out))
            for text in o.warnings
        ),
    ]
    return summary.model_copy(update={"warnings": [text for text in warnings if text]})


def _sampler(posterior: Posterior) -> dict[str, Any]:
    d = posterior.diagnostics
    same = ("status", "walkers", "ensembles", "warmup", "steps", "thin", "not_finite")
    return {key: getattr(d, key) for key in (*same, "not_finite_share")} | {
        "problems": list(d.problems),
        "draws": d.ensembles * d.walkers * d.steps,
        "tau": _number(d.tau.max()),
        "min_ess": _number(d.ess.min()),
        "max_rhat": _number(d.rhat.max()),
        "acceptance": _number(d.acceptance.mean()),
        "stuck_walkers": int((d.acceptance == 0.0).sum()),
        "seconds": round(d.seconds, 3),
        "seed": posterior.seed,
    }


def _torque_constant(fit: Fit) -> float | None:
    """Give torque per current, N m/A or N/A, where torque is explained and all of it a current."""
    if fit.target.likelihood.method == "output-error":
        return None
    constants = {o.settings.get("torque_constant") for o in fit.observations}
    (constant,) = constants if len(constants) == 1 else (None,)
    return None if constant is None else float(constant)


def _with_mirrored(summary: Summary, fit: Fit) -> Summary:
    """Mark load-dependent friction of a way of driving that hardly occurred."""
    values = fit.target.chain_values(fit.posterior.median[None])
    changes: dict[str, dict[str, Any]] = {}
    for name, back in back_driving_shares(fit.chain, fit.observations, values).items():
        for side, share in (("back", float(back[0])), ("drive", 1.0 - float(back[0]))):
            if f"{name}.load" in fit.chain.names and share < _SELDOM:
                for quantity in (f"{name}.alpha_{side}", f"{name}.efficiency_{side}"):
                    if (row := summary.derived.get(quantity)) is not None:
                        weak = {"verdict": "weak"} if row.verdict == "data" else {}
                        changes[quantity] = {"mirrored": share, **weak}
    return summary.with_rows(changes)


def _explained(fit: Fit) -> dict[str, float]:
    """Give the share of the measured torque's variance that the posterior mean explains."""
    if fit.target.likelihood.method == "output-error":
        return {}  # any simulated position is near the measured one
    # each recording about its own mean: an offset explains nothing
    total = sum(float(np.sum((o.measured - o.measured.mean()) ** 2)) for o in fit.observations)
    left = sum(float(r @ r) for r in fit.residuals)
    return {"explained": 1.0 - left / total} if total > 0.0 else {}


def estimate_summary(estimate: Estimate) -> dict[str, Any]:
    """Put a point estimate into the form of ``summary.json``."""
    rows = {}
    for v in estimate.values:
        row = {key: getattr(v, key) for key in EstimatedRow.model_fields}
        sds = {"sd": _number(v.sd), "sd_robust": _number(v.sd_robust)}
        rows[v.name] = row | sds | {"span": list(v.span) if v.span else None}
    return {
        "parameters": rows,
        "converged": estimate.converged,
        "point": dict(estimate.point),
        "residual_rms": estimate.residual_rms,
        "residual_unit": estimate.residual_unit,
        "outputs": estimate.n_outputs,
        "assumption": estimate.assumption,
        "notes": list(estimate.notes),
    }


def _parameters(fit: Fit, local: LocalInformation) -> dict[str, Any]:
    d, flat = fit.posterior.diagnostics, fit.posterior.flat()
    described = {p.name: described_as(p) for p in fit.chain.parameters}
    possible = {p.name: (p.lower, p.upper) for p in fit.chain.parameters}
    described |= noise_part.noise_described(fit)
    noise = fit.target.noise
    scales = dict(zip(noise.names, (SCALES[kind] for kind in noise.quantities), strict=True))
    possible |= {name: (scale.lower, scale.upper) for name, scale in scales.items()}
    rows = {}
    sound = d.sound(d.rhat, d.ess)
    for j, (name, prior) in enumerate(zip(fit.posterior.names, fit.posterior.priors, strict=True)):
        sd, prior_sd = float(flat[:, j].std()), prior.sd()
        # the noise scale's own information: a variance estimated from n residuals
        data_sd = local.data_sd[j] if j < len(local.names) else sd
        judged: dict[str, Any] = {"verdict": verdict(sd, prior_sd, data_sd)}
        if judged["verdict"] == "prior" and j < len(local.names):
            gradient = np.eye(len(local.names))[j]
            judged |= weakly_given(given_by(local, fit.posterior.priors, gradient, sd, prior_sd, j))
        rows[name] = {
            **described[name],
            **spread(flat[:, j]),
            "rhat": _number(d.rhat[j]),
            "ess": _number(d.ess[j]),
            "converged": bool(sound[j]),
            "prior": prior.text,
            "prior_default": prior.default,
            "prior_sd": _number(prior_sd),
            **_prior_interval(prior),
            "contraction": _number(1.0 - (sd / prior_sd) ** 2),
            "data_sd": _number(data_sd),
            **judged,
            **leaning(flat[:, j], prior.limits, possible[name]),
            **({"period": TURN} if prior.circular else {}),
        }
    return rows


def _prior_interval(prior: Prior) -> dict[str, Any]:
    ends = prior.interval(LEVEL)
    # a whole turn has none: where it is cut means nothing
    exists = np.isfinite(ends).all() and not prior.whole_turn
    return {"prior_interval": list(ends)} if exists else {}


def _number(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None
