"""What the self-check found, quantity by quantity: bias, coverage, corrected values.

Indirect inference to first order: by as much as estimates lie from the truth where it is known,
the estimate at hand is taken to lie from its own. The bias is that at the estimate and not at the
truth, so what is left is of second order, the bias times its relative change over the bias itself.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from bayesfric.diagnostics.self_check import Checked
from bayesfric.inference.fitting import Fit
from bayesfric.report.numbers import text_rounded
from bayesfric.report.summary.derived_quantities import LEVEL, Groups
from bayesfric.report.summary.record import SelfCheck, SelfCheckRow, Summary, of_noise
from bayesfric.report.summary.rows import PosteriorRow
from bayesfric.report.text_templates import filled, sentence

Array = NDArray[np.float64]

# Bias in posterior sds that is corrected; its own error must be this many times smaller.
BIASED, _SURE = 0.3, 2.0
# Change of a logarithm beyond which its first order says nothing.
_FIRST_ORDER = 1.0
# Coverage of 90 % intervals below which a number is doubtful, and below which it is told.
POOR, LOW = 0.75, 0.80


@dataclass(frozen=True, eq=False)
class _Errors:
    """By how much fits miss one quantity; ``(n,)``, a replay each."""

    name: str
    truth: Array
    missed: Array  # in the quantity's unit, without noise


def self_check_part(fit: Fit, summary: Summary, checked: Checked, derived: Groups) -> SelfCheck:
    """Sum up a self-check of a fit, for ``summary["self_check"]``.

    ``derived`` are the fit's :func:`~bayesfric.report.summary.derived_quantities.groups`.
    """
    begun, worked = time.perf_counter(), time.process_time()
    made = len(checked.fits)
    told: dict[str, Any] = {"asked": checked.asked, "made": made}
    if checked.reason is not None:
        told |= {"seconds": checked.seconds, "cpu_seconds": checked.cpu_seconds}
        return SelfCheck(**told, reason=checked.reason, said=checked.said)
    unexplained = np.array([one.unexplained for one in checked.fits])
    support = {p.name: (p.lower, p.upper) for p in fit.chain.parameters}
    rows = {}
    for errors in _errors(fit, checked, derived):
        row = summary.rows[errors.name]
        if row.of_motion:  # no table shows it
            continue
        if row.sd > 0.0 and np.isfinite(errors.missed).sum() >= max(2.0, 0.5 * made):
            limits = support.get(errors.name, (-np.inf, np.inf))
            rows[errors.name] = _row(row, errors, unexplained, limits)
    return SelfCheck(
        **told,
        rows=rows,
        unexplained=float(unexplained.mean()),
        seconds=round(checked.seconds + time.perf_counter() - begun, 3),
        cpu_seconds=round(checked.cpu_seconds + time.process_time() - worked, 3),
    )


def poor(row: SelfCheckRow) -> bool:
    """Whether an interval, corrected where it is, holds too few truths, beyond chance."""
    coverage = row.coverage if row.corrected_coverage is None else row.corrected_coverage
    return coverage + _SURE * row.coverage_error < POOR


def self_check_doubts(summary: Summary) -> list[dict[str, Any]]:
    """Name what the data seem to determine and the self-check does not find again."""
    if summary.self_check is None:
        return []
    found = {
        name: row
        for name, row in summary.self_check.rows.items()
        if summary.rows[name].verdict == "data" and poor(row)
    }
    if not found:
        return []
    coverage = {
        name: row.coverage if row.corrected_coverage is None else row.corrected_coverage
        for name, row in found.items()
    }
    return [{"kind": "self-check", "parameters": list(found), "coverage": coverage}]


def off_rows(summary: Summary) -> dict[str, SelfCheckRow]:
    """Pick what is not found again: biased, or in too few intervals; not what is open anyway."""
    check = summary.self_check
    return {
        name: row
        for name, row in (check.rows.items() if check else ())
        if summary.rows[name].verdict != "prior"
        and (_corrects(summary.rows[name], row) or row.coverage < LOW)
    }


def biased(summary: Summary) -> list[str]:
    """Name what is biased enough to be corrected; not what is open anyway."""
    rows = summary.self_check.rows if summary.self_check else {}
    return [
        n for n, r in rows.items() if r.corrected_interval and summary.rows[n].verdict != "prior"
    ]


def _corrects(row: PosteriorRow, checked: SelfCheckRow) -> bool:
    """Whether it is corrected, and printed otherwise than it was; a limit is told as it is."""
    if checked.corrected is None or checked.corrected_interval is None or row.at_bound is not None:
        return False
    before = row.middle, *row.interval
    after = checked.corrected, *checked.corrected_interval
    return any(
        text_rounded(a, row.told_sd) != text_rounded(b, row.told_sd)
        for a, b in zip(before, after, strict=True)
    )


def cited(summary: Summary) -> dict[str, tuple[float, float, float, float]]:
    """Give corrected values: value, ends of the interval and sd, by name.

    What is not among them is reported as the posterior has it.
    """
    found = {}
    for name, checked in off_rows(summary).items():
        row = summary.rows[name]
        value, ends = checked.corrected, checked.corrected_interval
        if not _corrects(row, checked) or value is None or ends is None:
            continue
        low, high = ends
        sd = row.sd * (high - low) / ((row.interval[1] - row.interval[0]) or 1.0)
        if row.model_error_interval:  # as wide as what has room for the model's error
            wide, sd = row.model_error_interval, row.model_error_sd or sd
            low, high = (value + end - row.middle for end in wide)
            value += (row.model_error_value or row.middle) - row.middle
            low = max(low, 0.0) if wide[0] >= 0.0 else low
        found[name] = value, low, high, sd
    return found


def seldom_held(summary: Summary) -> dict[str, float]:
    """Give how often intervals that are printed hold the truth, of those that do so too seldom."""
    shown, found = cited(summary), {}
    for name, row in off_rows(summary).items():
        coverage = row.corrected_coverage if name in shown else row.coverage
        if coverage is not None and coverage < LOW:
            found[name] = coverage
    return found


def seldom_held_sentence(summary: Summary, names: Collection[str]) -> str:
    """Say of ``names`` whose intervals hold the truth too seldom that they do; or empty."""
    held = {name: share for name, share in seldom_held(summary).items() if name in names}
    told = {"held": held, "level": LEVEL, "allowed": summary.widened}
    return sentence("seldom held", told) if held else ""


def self_check_lines(summary: Summary) -> Iterator[str]:
    """Word it for a terminal, line by line."""
    if (check := summary.self_check) is not None:
        why = sentence("no self-check", check.model_dump()) if check.reason else ""
        told = {"check": check, "why": why, "off": off_rows(summary), "allowed": summary.widened}
        told["corrected"] = set(cited(summary))
        text = filled("self_check.txt.j2", **told)
        yield from text.splitlines()


def _errors(fit: Fit, checked: Checked, derived: Groups) -> Iterator[_Errors]:
    nearby = np.stack([one.nearby for one in checked.fits])
    shares = np.array([one.share for one in checked.fits])
    for j, name in enumerate(fit.posterior.names):
        if not of_noise(name):
            truth = checked.truth[:, j]
            yield _Errors(name, truth, (nearby[:, j] - truth) / shares)
    with np.errstate(divide="ignore", invalid="ignore"):
        for group in derived:
            if not group.found:
                continue
            true = group.values(fit.target.chain_values(checked.truth))
            moved = group.values(fit.target.chain_values(nearby))
            for q, before, after in zip(group.found, true, moved, strict=True):
                yield _Errors(q.name, before, (after - before) / shares)


def _row(
    row: PosteriorRow, errors: _Errors, unexplained: Array, limits: tuple[float, float]
) -> SelfCheckRow:
    known = np.isfinite(errors.missed) & np.isfinite(errors.truth)
    truth, missed, share = errors.truth[known], errors.missed[known], unexplained[known]
    z = missed / row.sd
    bias, error = float(z.mean()), float(z.std(ddof=1) / np.sqrt(z.size))
    hit = _coverage(z, share)
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
        corrected_coverage=float(_coverage(z - bias, share).mean()),
    )


def _coverage(z: Array, unexplained: Array) -> Array:
    """Chance that an interval holds the truth that noiseless fits miss by ``z`` sds, ``(n,)``.

    The scale of the noise that a fit finds holds what filters and encoder leave of the torque,
    so less of it is noise; where they leave more, the fit finds a larger scale.
    """
    scatter = np.sqrt(np.clip(1.0 - unexplained, 1e-12, None))
    half = norm.ppf(0.5 + LEVEL / 2.0) * np.sqrt(np.clip(unexplained, 1.0, None))
    return np.asarray(norm.cdf((half - z) / scatter) - norm.cdf((-half - z) / scatter))
