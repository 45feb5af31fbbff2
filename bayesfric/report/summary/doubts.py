"""Reasons not to believe numbers although the sampling has converged.

A posterior says what the data tell if model, noise and recording are what they are taken for.
What is found here says that they are not: such numbers are not called determined by the data, and
the run is not reliable.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bayesfric.diagnostics.before_a_fit import (
    EXPLAINED,
    against_prior,
    alternatives,
    best_share,
    doubts_before,
    few_outputs,
    strange_velocity,
)
from bayesfric.diagnostics.explanation import of_recording
from bayesfric.estimates.information import CORRELATED
from bayesfric.estimates.input_error import CONTRADICTED
from bayesfric.inference.fitting import Fit
from bayesfric.mechanism.parameter import quantity_of
from bayesfric.mechanism.quantities import QUANTITIES, Quantity, State
from bayesfric.recordings.resolution import LEAST_RATIO
from bayesfric.report.summary.conclusions import held, noise_cut
from bayesfric.report.summary.noise import correlation_of
from bayesfric.report.summary.record import Doubt, Summary
from bayesfric.report.summary.rows import PosteriorRow, sd_towards

# Share of a number beyond which first order says little of what moves it.
_FIRST_ORDER = 0.5


def find_doubts(
    fit: Fit, summary: Summary, contradicted: Mapping[str, tuple[float, float]]
) -> list[dict[str, Any]]:
    """Look for what makes the numbers of a fit doubtful, for ``summary["doubts"]``.

    This is the one rule by which a number that data determine is ``identified``: nothing here
    names it. The first doubt is the first sentence of the answer, so what may cause others stands
    before them: priors that the data contradict, then faults of the recording.

    Parameters
    ----------
    fit, summary
        The posterior, and what is known of it so far.
    contradicted
        Priors that the data contradict, see :func:`bayesfric.estimates.input_error.contradicted`.

    Returns
    -------
    list of dict
        ``kind``, ``parameters`` and the numbers that the words need.
    """
    if summary.sampler.status == "unusable":
        return []  # there is no posterior to doubt
    rows = {**summary.joint, **summary.derived}
    told = [name for name, row in rows.items() if row.verdict == "data"]
    # what rests on the data at all: a limit, or what they settle with a prior's help, too
    resting = [name for name, row in rows.items() if row.verdict != "prior" or held(row)]
    found = [
        *against_prior(contradicted),
        *strange_velocity(fit.observations),
        *_missing(summary, resting),
        *_unexplained(fit, summary),
        *doubts_before(fit.estimates[0], fit.observations),
        *_cut(summary),
        *_acceleration(fit, summary, told),
        *_correlated(summary, told),
        *_unchecked(fit, summary),
    ]
    return [{"kind": one.pop("kind"), "parameters": one.pop("of", resting), **one} for one in found]


def put_doubts(summary: Summary, doubts: Sequence[Mapping[str, Any]]) -> Summary:
    """Put doubts into a summary: what they are of is not ``data``, the run not ``reliable``.

    ``undoubted`` keeps what else would be said of a number.
    """
    told = [Doubt.model_validate(one) for one in doubts]
    if not told:
        return summary.model_copy(update={"doubts": told})
    kinds: dict[str, list[str]] = {}
    for one in told:
        for name in one.parameters:
            kinds.setdefault(name, []).append(one.kind)
    sampler = summary.sampler
    if sampler.status == "reliable":
        sampler = sampler.model_copy(update={"status": "tentative"})
    changes: dict[str, dict[str, Any]] = {}
    for name, of in kinds.items():
        row = summary.rows[name]
        changes[name] = {"doubted": of, "undoubted": row.undoubted or row.verdict}
        changes[name] |= {"verdict": "weak"} if row.verdict == "data" else {}
    return summary.with_rows(changes, doubts=told, sampler=sampler)


def _correlated(summary: Summary, told: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Doubt intervals that take correlated residuals for independent, and have no room for it."""
    if (correlation := correlation_of(summary)) is None:
        return
    rows, (lag, times) = summary.rows, correlation
    if narrow := [name for name in told if rows[name].told.sd < times * rows[name].sd]:
        yield {"kind": "independent", "lag": lag, "times": times, "of": narrow}


def _unchecked(fit: Fit, summary: Summary) -> Iterator[dict[str, Any]]:
    """Doubt all numbers of a recording on which the model could not be checked."""
    regression = summary.regression
    if regression is not None and regression.reason == "still":
        yield {"kind": "still"}
    elif regression is not None and regression.reason == "few":
        yield from few_outputs(fit.observations, len(fit.chain.names))  # as it was judged


def _missing(summary: Summary, resting: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Doubt what something moves that the model lacks; where any number may be it, all.

    A fault of the recording may be in any number. Intervals with room for a finding have it to
    first order: what it moves by more than half of itself is doubted all the same.
    """
    for one in summary.findings:
        of = [name for name in resting if name in one.moves and not of_recording(one.kind)]
        if one.severity == "note":
            of = [name for name in of if _far(summary.rows[name], one.moves[name])]
            if not of:
                continue
        told = one.model_dump() | {"kind": "missing", "what": one.kind}
        told["of"] = of or list(resting)
        yield {key: x for key, x in told.items() if key != "parameters"}


def _far(row: PosteriorRow, move: float) -> bool:
    """Whether a number moves, by so many posterior sds, by more than half of its value."""
    signed = row.interval[0] < 0.0 < row.interval[1] or row.period is not None
    return not signed and abs(move) * row.sd > _FIRST_ORDER * abs(row.middle)


def _unexplained(fit: Fit, summary: Summary) -> list[dict[str, Any]]:
    share, lag = summary.fit.explained, summary.noise.residual_lag1
    if share is None or share >= EXPLAINED or lag is None or lag <= CORRELATED:
        return []
    told = {"kind": "unexplained", "share": share, "quantity": summary.fit.quantity}
    best, _ = best_share(fit.chain, fit.observations)
    return [told | alternatives(fit.chain, fit.observations, best)]


def _cut(summary: Summary) -> Iterator[dict[str, Any]]:
    """Name noise that a prior keeps smaller than the data have it."""
    for name, row in summary.parameters.items():
        if row.converged and noise_cut(name, row):
            yield {"kind": "noise-bound", "noise": name, "bound": row.bound, "unit": row.unit}


def _acceleration(fit: Fit, summary: Summary, told: list[str]) -> Iterator[dict[str, Any]]:
    power, noise = 0.0, 0.0
    for o in fit.observations:
        ratio = float(o.settings.get("acceleration_ratio", np.inf))
        seen = float(np.sum(o.filter.apply(o.qdd) ** 2))
        power, noise = power + seen, noise + seen / (1.0 + ratio**2)
    if not noise > 0.0:
        return
    # about the share of an inertia that noise in its acceleration takes away
    lost = noise / power
    own = {p.name: p.row for p in fit.chain.parameters}
    names = [
        name
        for name in told
        if _accelerates(own.get(name) or QUANTITIES.get(quantity_of(name)))
        and summary.rows[name].told.sd < lost * abs(summary.rows[name].middle)
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
    """Name references far from what was found, and by how many standard deviations.

    Those of the told interval and the reference's own; what the data leave open contradicts
    nothing.
    """
    times = {}
    for name, reference in summary.references.items():
        row = summary.rows.get(name)
        if row is not None and row.verdict != "prior" and row.converged is not False:
            sd = sd_towards(reference.value, row.middle, (row.told.low, row.told.high), row.told.sd)
            times[name] = _times(row, reference.value, reference.sd, row.middle, sd)
    return {name: far for name, far in times.items() if far > CONTRADICTED}


def _times(
    row: PosteriorRow, value: float, known: float | None, found: float, found_sd: float
) -> float:
    """Give how many sds what was found is from a value that is ``known`` so well."""
    away = found - value
    if row.period:
        away -= row.period * round(away / row.period)
    sd = float(np.hypot(found_sd, known or 0.0))
    return abs(away) / sd if sd > 0.0 else 0.0
