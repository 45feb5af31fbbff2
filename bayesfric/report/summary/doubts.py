"""Bounds, model discrepancy, and doubts about the numbers of a posterior.

A posterior holds if model, noise and recording are what they are assumed to be. A doubt says that
they are not: such numbers are not called determined by the data, and the run is not reliable.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import norm

from bayesfric.diagnostics.before_a_fit import (
    EXPLAINED,
    against_prior,
    doubts_before,
    few_outputs,
    strange_velocity,
)
from bayesfric.diagnostics.explanation import of_recording
from bayesfric.estimates.autoregression import CORRELATED
from bayesfric.estimates.input_error import CONTRADICTED
from bayesfric.identifiability.local import WIDE
from bayesfric.inference.fitting import Fit
from bayesfric.inference.noise import SCALES
from bayesfric.mechanism.quantities import QUANTITIES, Quantity, State, quantity_of
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.filters import LEAST_RATIO
from bayesfric.report.summary.derived_quantities import Groups, leaning, loss_leaning, spread
from bayesfric.report.summary.parts import off_rows
from bayesfric.report.summary.record import (
    Message,
    PosteriorRow,
    Summary,
    of_noise,
    sd_towards,
    unwrapped,
)
from bayesfric.report.words import line_of

# -- bounds


def bound_hint(name: str, row: PosteriorRow) -> str:
    """Say what to do about the bound that holds a number, unless an autocorrelation's."""
    if not row.held or row.bound is None or _of_residuals(name):
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
    if not of_noise(name) or row.at_bound != "upper" or row.bound_physical or not row.held:
        return False
    return name.split(".")[1] in SCALES and not _of_residuals(name) and row.bound is not None


def bound_warning(name: str, row: PosteriorRow) -> str:
    """Warn of a bound that was set and cuts a posterior off, unless it is a doubt of all."""
    if row.bound_physical or noise_cut(name, row) or not (hint := bound_hint(name, row)):
        return ""
    return line_of("bound", {"name": name, "side": row.at_bound, "fix": hint})


# -- model discrepancy


def add_model_error(summary: Summary, fit: Fit, derived: Groups) -> Summary:
    """Put intervals with model discrepancy into a summary, and judge by them."""
    discrepancy = fit.discrepancy
    if discrepancy is None:
        return summary
    part = {"shown": discrepancy.is_plausible, "chance": discrepancy.chance}
    if not discrepancy.moved:
        return summary.model_copy(update={"model_error": part})
    wide = fit.wide.posterior.flat()
    draws = {n: wide[:, j] for j, n in enumerate(fit.posterior.names) if not of_noise(n)}
    for group in derived:
        draws |= group.named(wide[:: -(-len(wide) // group.max_count)])
    possible = {p.name: (p.lower, p.upper) for p in fit.chain.parameters}
    priors = {n: p.limits for n, p in zip(fit.posterior.names, fit.posterior.priors, strict=True)}
    changes = {}
    for name, x in draws.items():
        row = summary.rows[name]
        if change := _widened(row, x):
            if row.at_bound is None:  # a wider posterior may come to lean on a bound
                limits = priors.get(name)
                change |= leaning(x, limits, possible[name]) if limits else loss_leaning(name, x)
            changes[name] = change
    return summary.with_rows(changes, model_error=part)


def _widened(row: PosteriorRow, draws: Array) -> dict[str, Any]:
    """Say what changes of a row; nothing of one that the data leave open anyway."""
    is_open = row.verdict == "prior" and not row.held
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


# -- doubts


def find_doubts(
    fit: Fit, summary: Summary, contradicted: Mapping[str, tuple[float, float]]
) -> list[dict[str, Any]]:
    """Find what makes the numbers of a fit doubtful, for ``summary["doubts"]``.

    A number that data determine is ``identified`` where nothing here names it. What may cause
    other doubts comes first: priors that the data contradict (as
    :func:`bayesfric.estimates.input_error.contradicted` gives them), then faults of the recording.
    """
    if summary.sampler.status == "unusable":
        return []  # there is no posterior to doubt
    rows = {**summary.joint, **summary.derived}
    determined = [name for name, row in rows.items() if row.verdict == "data"]
    # of the data in any way: a limit, or what they determine with a prior's help, too
    of_data = [name for name, row in rows.items() if row.verdict != "prior" or row.held]
    # its torque is computed, and only starts the search
    closed = fit.target.likelihood.method == "closed-loop"
    doubts = [
        *against_prior(contradicted),
        *strange_velocity(fit.observations),
        *_missing(summary, of_data),
        *_unexplained(summary),
        *([] if closed else doubts_before(fit.estimates[0], fit.observations)),
        *([{"kind": "faster", "names": [*fit.faster]}] if fit.faster else []),
        *_cut(summary),
        *([] if closed else _acceleration(fit, summary, determined)),
        *correlated(summary, determined),
        *_unchecked(fit, summary),
        *self_check_doubts(summary),
    ]
    return [
        {"kind": doubt.pop("kind"), "parameters": doubt.pop("of", of_data), **doubt}
        for doubt in doubts
    ]


def self_check_doubts(summary: Summary, sure: float = 2.0) -> Iterator[dict[str, Any]]:
    """Doubt what the data seem to determine and the calibration check does not recover.

    By ``sure`` standard errors of its coverage.
    """
    coverage = {
        name: row["coverage"]
        for name, row in off_rows(summary, beyond=sure).items()
        if summary.rows[name].verdict == "data"
    }
    if coverage:
        yield {"kind": "self-check", "of": list(coverage), "coverage": coverage}


def put_doubts(summary: Summary, doubts: Sequence[Mapping[str, Any]]) -> Summary:
    """Put doubts into a summary: their numbers are not ``data``, the run not ``reliable``."""
    messages = [Message.model_validate(doubt) for doubt in doubts]
    if not messages:
        return summary.model_copy(update={"doubts": messages})
    kinds: dict[str, list[str]] = {}
    for message in messages:
        for name in message.parameters:
            kinds.setdefault(name, []).append(message.kind)
    sampler = summary.sampler
    if sampler.status == "reliable":
        sampler = sampler.model_copy(update={"status": "tentative"})
    changes = {}
    for name, of in kinds.items():
        verdict = summary.rows[name].verdict
        undoubted = summary.rows[name].undoubted or verdict
        changes[name] = {"doubted": of, "undoubted": undoubted}
        changes[name]["verdict"] = "weak" if verdict == "data" else verdict
    return summary.with_rows(changes, doubts=messages, sampler=sampler)


def correlated(summary: Summary, determined: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Doubt intervals that assume correlated residuals to be independent.

    Of a first-order autoregression they are too narrow by ``times``.
    """
    lag, rows = summary.noise.innovation_lag1, summary.rows
    # simulated positions are correlated by their model
    if summary.likelihood["method"] != "input-error" or lag is None or lag < CORRELATED:
        return
    times = float(np.sqrt((1.0 + lag) / (1.0 - min(lag, 0.99))))
    if narrow := [name for name in determined if rows[name].reported.sd < times * rows[name].sd]:
        yield {"kind": "independent", "lag": lag, "times": times, "of": narrow}


def _unchecked(fit: Fit, summary: Summary) -> Iterator[dict[str, Any]]:
    """Doubt all numbers of a recording on which the model could not be checked."""
    reason = summary.regression and summary.regression["reason"]
    if reason == "still":
        yield {"kind": "still"}
    elif reason == "few":
        yield from few_outputs(fit.observations, len(fit.chain.names))  # as it was judged


def _missing(summary: Summary, of_data: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Doubt what a missing effect moves; where any number may be it, all.

    A fault of the recording may be in any number. Intervals with model discrepancy allow for a
    finding to first order: what it moves by more than half of itself is doubted all the same.
    """
    for finding in summary.findings:
        moves = {} if of_recording(finding.kind) else finding.details["moves"]
        of = [name for name in of_data if name in moves]
        if finding.severity == "note":
            of = [name for name in of if _far(summary.rows[name], moves[name])]
            if not of:
                continue
        message = finding.of_kind("missing", severity="doubt", of=of or list(of_data))
        yield message.model_dump(exclude={"parameters", "remark"})


def _far(row: PosteriorRow, move: float, *, first_order: float = 0.5) -> bool:
    """Whether a number moves, by so many posterior sds, by more than half of its value.

    Beyond ``first_order``, a share of the number, first order says little of what moves it.
    """
    signed = row.interval[0] < 0.0 < row.interval[1] or row.period is not None
    return not signed and abs(move) * row.sd > first_order * abs(row.middle)


def _unexplained(summary: Summary) -> list[dict[str, Any]]:
    share, lag = summary.fit.explained, summary.noise.residual_lag1
    if share is None or share >= EXPLAINED or lag is None or lag <= CORRELATED:
        return []
    return [{"kind": "unexplained", "share": share, "quantity": summary.fit.quantity}]


def _cut(summary: Summary) -> Iterator[dict[str, Any]]:
    """Name noise that a prior keeps smaller than in the data."""
    for name, row in summary.parameters.items():
        if row.converged and noise_cut(name, row):
            yield {"kind": "noise-bound", "noise": name, "bound": row.bound, "unit": row.unit}


def _acceleration(fit: Fit, summary: Summary, determined: list[str]) -> Iterator[dict[str, Any]]:
    power, noise = 0.0, 0.0
    for o in fit.observations:
        ratio = float(o.settings.get("acceleration_ratio", np.inf))
        filtered = float(np.sum(o.filter.apply(o.qdd) ** 2))
        power, noise = power + filtered, noise + filtered / (1.0 + ratio**2)
    if not noise > 0.0:
        return
    # about the share of an inertia that noise in its acceleration takes away
    lost = noise / power
    terms = {p.name: p.row for p in fit.chain.parameters}
    names = [
        name
        for name in determined
        if _accelerates(terms.get(name) or QUANTITIES.get(quantity_of(name)))
        and summary.rows[name].reported.sd < lost * abs(summary.rows[name].middle)
    ]
    if names and lost > 1.0 / LEAST_RATIO**2:
        yield {"kind": "acceleration", "ratio": float(lost**-0.5), "of": names}


def _accelerates(row: Quantity | None) -> bool:
    """Whether its torque depends on the acceleration."""
    if row is None or row.column is None:
        return False
    still = State(0.0, 0.0, 0.0, 0.0, 0.0)
    # of what another parameter shapes, at any value of that
    shape = (1.0,) if row.shape else ()
    faster = still._replace(acceleration=1.0)
    return bool(row.column(still, *shape) != row.column(faster, *shape))


def references_off(summary: Summary) -> dict[str, float]:
    """Name references far from the reported value, and by how many standard deviations.

    Those of the printed interval and of the reference; what the data leave open contradicts
    nothing.
    """
    off = {}
    for name, reference in summary.references.items():
        row = summary.rows.get(name)
        if row is None or row.verdict == "prior" or not row.converged:
            continue
        value = unwrapped(reference, row.middle if row.period else None).value
        posterior_sd = sd_towards(value, row.middle, row.reported.interval, row.reported.sd)
        sd = float(np.hypot(posterior_sd, reference.sd or 0.0))
        if abs(row.middle - value) > CONTRADICTED * sd > 0.0:
            off[name] = abs(row.middle - value) / sd
    return off
