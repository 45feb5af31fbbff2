"""What the self-check found, quantity by quantity: bias, coverage, corrected values.

Indirect inference to first order: by as much as estimates lie from the truth where it is known,
the estimate at hand is taken to lie from its own. The bias is that at the estimate and not at the
truth, so what is left is of second order, the bias times its relative change over the bias itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.stats import norm

from bayesfric.diagnostics.policy import TWINS
from bayesfric.diagnostics.self_check import Checked
from bayesfric.inference.fitting import Fit
from bayesfric.recordings.arrays import Array
from bayesfric.report.summary.derived_quantities import LEVEL, Groups
from bayesfric.report.summary.record import SelfCheck, SelfCheckRow, Summary, of_noise
from bayesfric.report.summary.rows import PosteriorRow
from bayesfric.results.reported import Spread

# Bias in posterior sds that is corrected; its own error must be this many times smaller.
BIASED, _SURE = 0.3, 2.0
# Share of an sd of two digits that changes none of them.
_DIGIT = 0.005
# Change of a logarithm beyond which its first order says nothing.
_FIRST_ORDER = 1.0
# Coverage of 90 % intervals below which a number is doubtful, and below which it is told.
POOR, LOW = 0.75, 0.80


def self_check_part(fit: Fit, summary: Summary, checked: Checked, derived: Groups) -> SelfCheck:
    """Sum up a self-check of a fit, for ``summary["self_check"]``.

    ``derived`` are the fit's :func:`~bayesfric.report.summary.derived_quantities.groups`.
    """
    made = len(checked.fits)
    told: dict[str, Any] = {"asked": TWINS, "made": made}
    told |= {"seconds": round(checked.seconds, 3), "cpu_seconds": round(checked.cpu_seconds, 3)}
    if checked.reason is not None:
        return SelfCheck(**told, reason=checked.reason)
    unexplained = np.array([one.unexplained for one in checked.fits])
    support = {p.name: (p.lower, p.upper) for p in fit.chain.parameters}
    rows = {}
    for name, truth, missed in _errors(fit, checked, derived):
        row = summary.rows[name]
        if row.of_motion:  # no table shows it
            continue
        if row.sd > 0.0 and np.isfinite(missed).sum() >= max(2.0, 0.5 * made):
            limits = support.get(name, (-np.inf, np.inf))
            rows[name] = _row(row, truth, missed, unexplained, limits, checked.share)
    return SelfCheck(**told, rows=rows, unexplained=float(unexplained.mean()))


def _held(row: SelfCheckRow) -> float:
    """How often the interval, corrected where it is, holds the truth."""
    return row.coverage if row.corrected_coverage is None else row.corrected_coverage


def self_check_doubts(summary: Summary) -> list[dict[str, Any]]:
    """Name what the data seem to determine and the self-check does not find again."""
    coverage = {
        name: _held(row)
        for name, row in _rows(summary).items()
        # beyond chance
        if summary.rows[name].verdict == "data" and _held(row) + _SURE * row.coverage_error < POOR
    }
    found = {"kind": "self-check", "parameters": list(coverage), "coverage": coverage}
    return [found] if coverage else []


def _rows(summary: Summary) -> dict[str, SelfCheckRow]:
    """Give what was found of all that is not open anyway."""
    rows = summary.self_check.rows if summary.self_check else {}
    return {name: row for name, row in rows.items() if summary.rows[name].verdict != "prior"}


def cited(summary: Summary) -> dict[str, Spread]:
    """Give corrected values, by name.

    What is not among them is reported as the posterior has it, as a limit is.
    """
    found = {}
    for name, checked in _rows(summary).items():
        row, value, ends = summary.rows[name], checked.corrected, checked.corrected_interval
        if value is None or ends is None or row.at_bound is not None:
            continue
        if abs(value - row.middle) < _DIGIT * row.told.sd:
            continue
        low, high = ends
        sd = row.sd * (high - low) / ((row.interval[1] - row.interval[0]) or 1.0)
        if (wide := row.wide) is not None:  # as wide as what has room for the model's error
            low, high = (value + end - row.middle for end in (wide.low, wide.high))
            value, sd = value + (wide.value - row.middle), wide.sd
            low = max(low, 0.0) if wide.low >= 0.0 else low
        found[name] = Spread(value, low, high, sd)
    return found


def off_rows(summary: Summary) -> dict[str, SelfCheckRow]:
    """Pick what is not found again: biased, or in too few intervals."""
    shown = cited(summary)
    return {n: row for n, row in _rows(summary).items() if n in shown or row.coverage < LOW}


def _errors(fit: Fit, checked: Checked, derived: Groups) -> Iterator[tuple[str, Array, Array]]:
    """Give each quantity's name, its true values and by how much fits miss them, a replay each."""
    nearby = np.stack([one.nearby for one in checked.fits])
    shares = np.array([one.share for one in checked.fits])
    for j, name in enumerate(fit.posterior.names):
        if not of_noise(name):
            truth = checked.truth[:, j]
            yield name, truth, (nearby[:, j] - truth) / shares
    for group in derived:
        moved = group.named(nearby)
        for name, true in group.named(checked.truth).items():
            yield name, true, (moved[name] - true) / shares


def _row(
    row: PosteriorRow,
    truth: Array,
    missed: Array,
    unexplained: Array,
    limits: tuple[float, float],
    share: float,
) -> SelfCheckRow:
    """Sum up one quantity; twins may be of excerpts, a ``share`` of what the posterior is of."""
    known = np.isfinite(missed) & np.isfinite(truth)
    truth, missed, unexplained = truth[known], missed[known], unexplained[known]
    z = missed / row.sd
    bias, error = float(z.mean()), float(z.std(ddof=1) / np.sqrt(z.size))
    # the whole scatters less than its excerpts, but is biased by what these know no better
    z = bias + (z - bias) * np.sqrt(min(1.0, share + 1.0 / z.size))
    hit = _coverage(z, unexplained)
    found: dict[str, Any] = {
        "bias": bias,
        "bias_error": error,
        "coverage": float(hit.mean()),
        "coverage_error": float(hit.std(ddof=1) / np.sqrt(z.size)),
    }
    # of what leans on the prior the twins' priors take part in what is missed
    if row.verdict != "data" or abs(bias) <= max(BIASED, _SURE * error):
        return SelfCheckRow(**found)
    ends = np.array([row.middle, *row.interval])
    if np.all(truth > 0.0) and np.all(ends > 0.0):  # a quantity without sign stays so
        change = float(np.mean(missed / truth))
        if abs(change) > _FIRST_ORDER:
            return SelfCheckRow(**found)
        ends = ends * np.exp(-change)
    else:
        ends = np.clip(ends - missed.mean(), *limits)
    middle, low, high = ends.tolist()
    return SelfCheckRow(
        **found,
        corrected=middle,
        corrected_interval=[low, high],
        corrected_coverage=float(_coverage(z - bias, unexplained).mean()),
    )


def _coverage(z: Array, unexplained: Array) -> Array:
    """Chance that an interval holds the truth that noiseless fits miss by ``z`` sds, ``(n,)``.

    The scale of the noise that a fit finds holds what filters and encoder leave of the torque,
    so less of it is noise; where they leave more, the fit finds a larger scale.
    """
    scatter = np.sqrt(np.clip(1.0 - unexplained, 1e-12, None))
    half = norm.ppf(0.5 + LEVEL / 2.0) * np.sqrt(np.clip(unexplained, 1.0, None))
    return np.asarray(norm.cdf((half - z) / scatter) - norm.cdf((-half - z) / scatter))
