"""Summary of a finished fit: what ``summary.json`` holds before it is examined."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayesfric.base import __version__
from bayesfric.base.atomic_write import jsonable
from bayesfric.estimates.autoregression import PASSES, lag_one, ljung_box, predictors
from bayesfric.estimates.point_estimate import Estimate
from bayesfric.identifiability.friction_curve import back_driving_shares
from bayesfric.identifiability.local import (
    LocalInformation,
    local_information,
    meaning_of,
)
from bayesfric.inference.closed_loop import ClosedLoopLikelihood
from bayesfric.inference.fitting import Fit
from bayesfric.inference.likelihood import TorqueLikelihood
from bayesfric.inference.noise import SCALES, NoiseChoice
from bayesfric.inference.posterior import Posterior
from bayesfric.mechanism.quantities import TURN, effort_words
from bayesfric.recordings.arrays import Array, Flags, rms
from bayesfric.report.summary.derived_quantities import (
    Groups,
    derived_rows,
    described_as,
    determination,
    groups,
    leaning,
    spread,
)
from bayesfric.report.summary.doubts import bound_warning
from bayesfric.report.summary.parts import validation_record
from bayesfric.report.summary.record import (
    EstimateTable,
    Identifiability,
    Noise,
    PosteriorRow,
    ReferenceRow,
    Residual,
    Sampler,
    Summary,
    ValueRow,
)
from bayesfric.report.terminal import PrintedSummary
from bayesfric.report.words import line_of


def summarise(
    fit: Fit,
    references: Mapping[str, Any] | None = None,
    choice: NoiseChoice | None = None,
    derived: Groups | None = None,
) -> Summary:
    """Summarise a fit; numbers that do not exist are ``None``.

    ``references`` are as a configuration gives them, ``derived`` are computed where left out.
    """
    local = local_information(fit.target, fit.posterior.median)
    change = None if fit.linearisation is None else _number(fit.linearisation)
    null = [{"parameters": dict(n), "meaning": meaning_of(n)} for n in local.null_directions]
    parameters = _parameters(fit, local)
    summary = PrintedSummary(
        bayesfric=__version__,
        parameters=parameters,
        fixed={
            p.name: ValueRow(**described_as(p), value=float(value))
            for p, value in zip(fit.chain.parameters, fit.chain_draws(1)[0], strict=True)
            if p.name not in fit.target.free
        },
        derived=derived_rows(fit, local, groups(fit) if derived is None else derived),
        estimates={estimate.method: estimate_table(estimate) for estimate in fit.estimates},
        references={name: ReferenceRow(**values) for name, values in (references or {}).items()},
        likelihood={"method": fit.target.likelihood.method, "linearisation": change}
        | (
            {"stride": closed.stride}
            if isinstance(closed := fit.target.likelihood, ClosedLoopLikelihood)
            else {}
        ),
        identifiability=Identifiability(null_directions=null),
        noise=_noise(fit, choice),
        fit=_residual(fit),
        validation=validation_record(fit) if fit.held_out else None,
        sampler=_sampler(fit.posterior),
        warnings=[text for text in _warnings(fit, parameters, change or 0.0) if text],
    )
    return _with_mirrored(summary, fit)


def _warnings(
    fit: Fit, parameters: Mapping[str, PosteriorRow], change: float, linear: float = 1.0
) -> Sequence[str]:
    """Gather warnings; empty ones count for nothing.

    A ``change`` of the log-likelihood by linearising of ``linear`` moves an interval by about one
    standard deviation.
    """
    unseen = fit.chain.unseen_inertia
    held_out = [part.held_out.observation for part in fit.held_out]
    return [
        *fit.posterior.diagnostics.warnings,
        line_of("unseen-inertia", {"names": unseen}) if unseen else "",
        *(bound_warning(name, row) for name, row in parameters.items() if row.converged),
        line_of("linearised", {"change": change}) if change >= linear else "",
        *(f"{o.name}: {text}" for o in (*fit.observations, *held_out) for text in o.warnings),
    ]


def _sampler(posterior: Posterior) -> Sampler:
    d = posterior.diagnostics
    same = ("status", "walkers", "ensembles", "warmup", "steps", "thin", "not_finite")
    return Sampler(
        **{key: getattr(d, key) for key in (*same, "not_finite_share")},
        problems=list(d.problems),
        draws=d.ensembles * d.walkers * d.steps,
        tau=_number(d.tau.max()),
        min_ess=_number(d.ess.min()),
        max_rhat=_number(d.rhat.max()),
        acceptance=_number(d.acceptance.mean()),
        stuck_walkers=int((d.acceptance == 0.0).sum()),
        seconds=round(d.seconds, 3),
        seed=posterior.seed,
    )


def _residual(fit: Fit) -> Residual:
    outputs, observations = fit.target.likelihood.outputs, fit.observations
    of_torque = fit.target.likelihood.method == "input-error"
    measured = np.concatenate([o.measured for o in observations])
    # an offset explains nothing: one of each recording, or of all
    alike = [o.measured for o in observations] if fit.chain.own_offsets else [measured]
    total = sum(float(np.sum((x - x.mean()) ** 2)) for x in alike)
    left = sum(float(r @ r) for r in fit.residuals)
    constants = {o.settings.get("torque_constant") for o in observations}
    (constant,) = constants if len(constants) == 1 and of_torque else (None,)
    return Residual(
        residual_rms=rms(np.concatenate(fit.residuals)),
        measured_rms=rms(measured) if of_torque else None,
        # any simulated position is near the measured one
        explained=1.0 - left / total if of_torque and total > 0.0 else None,
        torque_constant=None if constant is None else float(constant),
        unit=outputs[0].unit,
        quantity=outputs[0].quantity,
        recordings={
            o.name: {
                "residual_rms": rms(r),
                "residual_lag1": _number(lag_one(r, o.follows)),
                "outputs": int(o.measured.size),
                **observation.settings,
            }
            for o, observation, r in zip(outputs, observations, fit.residuals, strict=True)
        },
    )


def _with_mirrored(summary: Summary, fit: Fit, *, seldom: float = 0.1) -> Summary:
    """Mark load-dependent friction of a way of driving that hardly occurred.

    Below a share ``seldom`` of the outputs the friction of one way follows from the other.
    """
    values = fit.target.chain_values(fit.posterior.median[None])
    changes: dict[str, dict[str, Any]] = {}
    for name, back in back_driving_shares(fit.chain, fit.observations, values).items():
        for side, share in (("back", float(back[0])), ("drive", 1.0 - float(back[0]))):
            if f"{name}.load" in fit.chain.names and share < seldom:
                for quantity in (f"{name}.alpha_{side}", f"{name}.efficiency_{side}"):
                    if (row := summary.derived.get(quantity)) is not None:
                        weak = {"verdict": "weak"} if row.verdict == "data" else {}
                        changes[quantity] = {"mirrored": share, **weak}
    return summary.with_rows(changes)


def estimate_table(estimate: Estimate) -> EstimateTable:
    """Put a point estimate into the form of ``summary.json``."""
    rows = {v.name: {**vars(v), "determined": v.determined} for v in estimate.values}
    update = {"parameters": rows, "outputs": estimate.n_outputs, "point": dict(estimate.point)}
    return EstimateTable.read(jsonable({**vars(estimate), **update}))


def _parameters(fit: Fit, local: LocalInformation) -> dict[str, PosteriorRow]:
    d, flat = fit.posterior.diagnostics, fit.posterior.flat()
    described = {p.name: described_as(p) for p in fit.chain.parameters} | _noise_described(fit)
    possible = {p.name: (p.lower, p.upper) for p in fit.chain.parameters}
    noise = fit.target.noise
    scales = dict(zip(noise.names, (SCALES[kind] for kind in noise.quantities), strict=True))
    possible |= {name: (scale.lower, scale.upper) for name, scale in scales.items()}
    rows = {}
    sound = d.sound(d.rhat, d.ess)
    for j, (name, prior) in enumerate(zip(fit.posterior.names, fit.posterior.priors, strict=True)):
        sd, prior_sd = float(flat[:, j].std()), prior.sd()
        # the noise scale's own information: a variance estimated from n residuals
        data_sd = local.data_sd[j] if j < len(local.names) else sd
        change = np.eye(len(local.names))[j : j + 1].ravel()  # none of the noise's
        rows[name] = PosteriorRow(
            **described[name],
            **spread(flat[:, j]),
            rhat=_number(d.rhat[j]),
            ess=_number(d.ess[j]),
            converged=bool(sound[j]),
            prior=prior.text,
            prior_default=prior.default,
            prior_sd=_number(prior_sd),
            contraction=_number(1.0 - (sd / prior_sd) ** 2),
            data_sd=_number(data_sd),
            **determination(fit, local, change, (sd, prior_sd, data_sd), j),
            **leaning(flat[:, j], prior.limits, possible[name]),
            period=TURN if prior.circular else None,
        )
    return rows


def _number(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None


# -- noise


def _noise_described(fit: Fit) -> dict[str, dict[str, Any]]:
    """Give unit, symbol and meaning of every noise parameter, by name."""
    noise, effort = fit.target.noise, fit.chain.torque_unit
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


def _noise(fit: Fit, choice: NoiseChoice | None, *, lags: int = 10) -> Noise:
    """Describe the noise of a fit, with a test of so many ``lags`` of its innovations."""
    likelihood = fit.target.likelihood
    runs = [o.follows for o in likelihood.outputs]
    noise = Noise(
        model=effort_words(likelihood.noise.description, fit.chain.motor_motion),
        parameters=list(fit.target.noise.names),
        accounts_for_correlation=likelihood.noise.accounts_for_correlation,
        residual_lag1=mean_lag(fit.residuals, runs),
    )
    if not isinstance(likelihood, TorqueLikelihood):
        return noise
    order = likelihood.noise.order
    scales = fit.target.noise.scales(fit.posterior.median[None, len(fit.target.free) :])[0]
    left = likelihood.innovations(fit.residuals, scales)
    p = ljung_box(left, runs, lags + order, order)
    test = f"Ljung-Box, {lags + order} lags, all recordings together"
    update: dict[str, Any] = {
        "order": order,
        "innovation_lag1": mean_lag(left, runs),
        "innovation_whiteness": {"test": test, "p_value": p, "white": bool(p >= PASSES)},
    }
    if order:
        update["autoregression"] = {
            o.name: predictors(s[None, 1:])[-1][0].tolist()
            for o, s in zip(likelihood.outputs, scales, strict=True)
        }
    if choice is not None:
        update["order_chosen_from"] = [jsonable(evidence) for evidence in choice.evidence]
        update |= {"memory": [*choice.partial], "room": choice.half_range}
    return noise.model_copy(update=update)


def mean_lag(residuals: Sequence[Array], follows: Sequence[Flags]) -> float | None:
    """Correlate each residual with the next, scaled by its recording's rms."""
    scaled = [r / max(rms(r), 1e-300) for r in residuals]
    # no pair reaches from one recording to the next
    runs = [np.append(f, False)[: r.size] for r, f in zip(scaled, follows, strict=True)]
    return _number(lag_one(np.concatenate(scaled), np.concatenate(runs)[:-1]))
