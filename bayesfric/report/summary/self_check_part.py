"""What the calibration check found, quantity by quantity: bias and coverage.

A bias is no longer taken off: on measured joints and on right models it changed nothing
(``studies/replication``). What it makes intervals miss is doubted.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.stats import norm

from bayesfric.diagnostics.calibration_check import CalibrationCheck
from bayesfric.diagnostics.policy import REPLICATES
from bayesfric.inference.fitting import Fit
from bayesfric.recordings.arrays import Array
from bayesfric.report.summary.derived_quantities import LEVEL, Groups
from bayesfric.report.summary.record import SelfCheck, SelfCheckRow, Summary, of_noise
from bayesfric.report.summary.rows import PosteriorRow

# Standard errors by which coverage must be too low.
_SURE = 2.0
# Coverage of 90 % intervals below which a number is doubtful.
POOR = 0.75


def self_check_part(
    fit: Fit, summary: Summary, checked: CalibrationCheck, derived: Groups
) -> SelfCheck:
    """Sum up a self-check of a fit, for ``summary["self_check"]``.

    ``derived`` are the fit's :func:`~bayesfric.report.summary.derived_quantities.groups`.
    """
    made = len(checked.fits)
    told: dict[str, Any] = {"asked": REPLICATES, "made": made}
    told |= {"seconds": round(checked.seconds, 3), "cpu_seconds": round(checked.cpu_seconds, 3)}
    if checked.reason is not None:
        return SelfCheck(**told, reason=checked.reason)
    unexplained = np.array([one.unexplained for one in checked.fits])
    rows = {}
    for name, truth, missed in _errors(fit, checked, derived):
        row = summary.rows[name]
        if row.of_motion:  # no table shows it
            continue
        if row.sd > 0.0 and np.isfinite(missed).sum() >= max(2.0, 0.5 * made):
            rows[name] = _row(row, truth, missed, unexplained, checked.share)
    return SelfCheck(**told, rows=rows, unexplained=float(unexplained.mean()))


def self_check_doubts(summary: Summary) -> list[dict[str, Any]]:
    """Name what the data seem to determine and the self-check does not find again."""
    coverage = {
        name: row.coverage
        for name, row in _rows(summary).items()
        # beyond chance
        if summary.rows[name].verdict == "data" and row.coverage + _SURE * row.coverage_error < POOR
    }
    found = {"kind": "self-check", "parameters": list(coverage), "coverage": coverage}
    return [found] if coverage else []


def _rows(summary: Summary) -> dict[str, SelfCheckRow]:
    """Give what was found of all that is not open anyway."""
    rows = summary.self_check.rows if summary.self_check else {}
    return {name: row for name, row in rows.items() if summary.rows[name].verdict != "prior"}


def off_rows(summary: Summary) -> dict[str, SelfCheckRow]:
    """Pick what is in too few intervals."""
    return {n: row for n, row in _rows(summary).items() if row.coverage < POOR}


def _errors(
    fit: Fit, checked: CalibrationCheck, derived: Groups
) -> Iterator[tuple[str, Array, Array]]:
    """Give each quantity's name, its true values and by how much fits miss them, a replay each."""
    nearby = np.stack([one.near_truth for one in checked.fits])
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
    share: float,
) -> SelfCheckRow:
    """Sum up one quantity; replicates may have a ``share`` of its samples."""
    known = np.isfinite(missed) & np.isfinite(truth)
    missed, unexplained = missed[known], unexplained[known]
    z = missed / row.sd
    bias, error = float(z.mean()), float(z.std(ddof=1) / np.sqrt(z.size))
    # the whole scatters less than its excerpts, but is biased by what these know no better
    z = bias + (z - bias) * np.sqrt(min(1.0, share + 1.0 / z.size))
    # of the interval that is printed, with room for the model's error
    hit = _coverage(z, unexplained, row.told.sd / row.sd)
    return SelfCheckRow(
        bias=bias,
        bias_error=error,
        coverage=float(hit.mean()),
        coverage_error=float(hit.std(ddof=1) / np.sqrt(z.size)),
    )


def _coverage(z: Array, unexplained: Array, width: float) -> Array:
    """Chance that an interval holds the truth that noiseless fits miss by ``z`` sds, ``(n,)``.

    ``width`` is the interval's over the posterior's.

    The scale of the noise that a fit finds holds what filters and encoder leave of the torque,
    so less of it is noise; where they leave more, the fit finds a larger scale.
    """
    scatter = np.sqrt(np.clip(1.0 - unexplained, 1e-12, None))
    half = width * norm.ppf(0.5 + LEVEL / 2.0) * np.sqrt(np.clip(unexplained, 1.0, None))
    return np.asarray(norm.cdf((half - z) / scatter) - norm.cdf((-half - z) / scatter))
