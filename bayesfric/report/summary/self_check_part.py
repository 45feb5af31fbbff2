"""Calibration check in a summary: bias and coverage of every quantity.

A bias is not corrected: on measured joints and on right models that changed nothing
(``studies/replication``). Intervals that miss the truth too often are doubted.
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

# Standard errors by which coverage must be too low.
_SURE = 2.0
# Coverage of 90 % intervals below which a number is doubtful.
POOR = 0.75


def self_check_part(fit: Fit, summary: Summary, checked: Checked, derived: Groups) -> SelfCheck:
    """Sum up the calibration check of a fit, for ``summary["self_check"]``."""
    count = len(checked.fits)
    part: dict[str, Any] = {"asked": TWINS, "made": count}
    part |= {"seconds": round(checked.seconds, 3), "cpu_seconds": round(checked.cpu_seconds, 3)}
    if checked.reason is not None:
        return SelfCheck(**part, reason=checked.reason)
    unexplained = np.array([replicate.unexplained for replicate in checked.fits])
    rows = {}
    for name, truth, missed in _errors(fit, checked, derived):
        row = summary.rows[name]
        if row.of_motion:  # no table shows it
            continue
        if row.sd > 0.0 and np.isfinite(missed).sum() >= max(2.0, 0.5 * count):
            rows[name] = _row(row, truth, missed, unexplained, checked.share)
    return SelfCheck(**part, rows=rows, unexplained=float(unexplained.mean()))


def self_check_doubts(summary: Summary) -> list[dict[str, Any]]:
    """Doubt what the data seem to determine and the calibration check does not recover."""
    coverage = {
        name: row.coverage
        for name, row in _rows(summary).items()
        # beyond chance
        if summary.rows[name].verdict == "data" and row.coverage + _SURE * row.coverage_error < POOR
    }
    doubt = {"kind": "self-check", "parameters": list(coverage), "coverage": coverage}
    return [doubt] if coverage else []


def _rows(summary: Summary) -> dict[str, SelfCheckRow]:
    """Give the rows of all that is not open anyway."""
    rows = summary.self_check.rows if summary.self_check else {}
    return {name: row for name, row in rows.items() if summary.rows[name].verdict != "prior"}


def off_rows(summary: Summary) -> dict[str, SelfCheckRow]:
    """Give the rows whose truth is in too few intervals."""
    return {n: row for n, row in _rows(summary).items() if row.coverage < POOR}


def _errors(fit: Fit, checked: Checked, derived: Groups) -> Iterator[tuple[str, Array, Array]]:
    """Give each quantity's name, true values and errors ``(n,)``, one for each replicate."""
    nearby = np.stack([replicate.nearby for replicate in checked.fits])
    shares = np.array([replicate.share for replicate in checked.fits])
    for j, name in enumerate(fit.posterior.names):
        if not of_noise(name):
            truth = checked.truth[:, j]
            yield name, truth, (nearby[:, j] - truth) / shares
    for group in derived:
        moved = group.named(nearby)
        for name, truth in group.named(checked.truth).items():
            yield name, truth, (moved[name] - truth) / shares


def _row(
    row: PosteriorRow, truth: Array, missed: Array, unexplained: Array, share: float
) -> SelfCheckRow:
    """Sum up one quantity; replicates may be subsamples, a ``share`` of the recording."""
    finite = np.isfinite(missed) & np.isfinite(truth)
    missed, unexplained = missed[finite], unexplained[finite]
    z = missed / row.sd
    bias, error = float(z.mean()), float(z.std(ddof=1) / np.sqrt(z.size))
    # the recording scatters less than its subsamples, but has the same bias
    z = bias + (z - bias) * np.sqrt(min(1.0, share + 1.0 / z.size))
    # of the interval that is printed, with model discrepancy
    hit = _coverage(z, unexplained, row.printed.sd / row.sd)
    return SelfCheckRow(
        bias=bias,
        bias_error=error,
        coverage=float(hit.mean()),
        coverage_error=float(hit.std(ddof=1) / np.sqrt(z.size)),
    )


def _coverage(z: Array, unexplained: Array, width: float) -> Array:
    """Chance that an interval holds the truth that noiseless fits miss by ``z`` sds, ``(n,)``.

    ``width`` is the interval's over the posterior's. The noise scale of a fit includes what filters
    and encoder leave of the torque, so less of it is noise; where they leave more, it is larger.
    """
    scatter = np.sqrt(np.clip(1.0 - unexplained, 1e-12, None))
    half = width * norm.ppf(0.5 + LEVEL / 2.0) * np.sqrt(np.clip(unexplained, 1.0, None))
    return np.asarray(norm.cdf((half - z) / scatter) - norm.cdf((-half - z) / scatter))
