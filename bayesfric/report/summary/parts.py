"""Parts of a summary: held-out validation, calibration check, friction at recorded speeds.

A bias in the calibration check is not corrected: on measured joints and on right models that
changed nothing (``studies/replication``). Intervals that miss the truth too often are doubted.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import norm

from bayesfric.diagnostics.explanation import CalibrationCheck
from bayesfric.diagnostics.statistics import REPLICATES
from bayesfric.estimates.autoregression import long_run_variance
from bayesfric.estimates.torque import places
from bayesfric.identifiability.friction_curve import friction_curves, friction_torque
from bayesfric.inference.fitting import Fit
from bayesfric.inference.likelihood import Outputs
from bayesfric.inference.posterior import Prediction
from bayesfric.recordings.arrays import Array, Flags, rms
from bayesfric.report.numbers import Medium
from bayesfric.report.summary.derived_quantities import Groups
from bayesfric.report.summary.record import PosteriorRow, Summary, of_noise
from bayesfric.report.words import line_of
from bayesfric.results.reported import LEVEL, Status

# -- held-out validation

# Standard errors by which a coverage must be off.
_SURE = 2.0


def share_of(inside: Flags, at: NDArray[np.int64], fallback: Array) -> dict[str, float]:
    """Estimate the share of autocorrelated outputs inside an interval, with its standard error.

    The variance of the sum comes from the autocorrelation of the indicator (Andrews, Econometrica
    59, 1991), never less than for independent outputs; the error is that of Agresti and Coull (The
    American Statistician 52, 1998) for the effective number. ``at`` is the place of each on an even
    grid of time, ``fallback`` ``(M,)`` has the autocorrelation where the indicator never changes.
    """
    n = inside.size
    share = float(inside.mean())
    series: Array = inside.astype(np.float64) - share if 0.0 < share < 1.0 else fallback
    power = float(series @ series)
    inflation = long_run_variance(series, at) / power if power > 0.0 else 1.0
    effective = n / max(inflation, 1.0)
    middle = (share * effective + 2.0) / (effective + 4.0)
    error = math.sqrt(middle * (1.0 - middle) / (effective + 4.0))
    return {"share": share, "standard_error": error, "effective_outputs": effective}


def validation_record(fit: Fit) -> dict[str, Any]:
    """Compare predictions with held-out outputs."""
    outputs = fit.target.likelihood.outputs[0]
    borrowed = sorted({quantity for p in fit.held_out for quantity in p.borrowed})
    how = (
        "each output separately: every draw's inverse model along the measured motion, and one "
        "residual of its noise; its autocorrelation is not used"
    )
    if borrowed:
        how += (
            f"; the {' and the '.join(borrowed)} of a recording held out whole is that of a "
            "fitted one, picked at random for each draw"
        )
    return {
        "predictive": how,
        "quantity": outputs.quantity,
        "unit": outputs.unit,
        "parts": {
            p.held_out.name: _held_out([p], outputs, p.held_out.held_out) for p in fit.held_out
        },
        "pooled": _held_out(fit.held_out, outputs, "all together"),
    }


def _held_out(predictions: Sequence[Prediction], outputs: Outputs, part: str) -> dict[str, Any]:
    at = places([p.held_out.observation for p in predictions])
    pit = np.concatenate([p.pit for p in predictions])
    residual = np.concatenate([p.measured - p.mean for p in predictions])
    variance = np.concatenate([p.variance for p in predictions])
    standard = residual / np.sqrt(variance)
    centred = standard - standard.mean()
    out = np.abs(pit - 0.5)  # how far from the middle of what was predicted
    shares = {level: share_of(out <= level / 2.0, at, centred) for level in (0.5, LEVEL, 0.99)}
    off = _discrepancy(residual**2 - variance, at)
    verdict = _verdict(shares[LEVEL], off)
    inside, error, effective = shares[LEVEL].values()
    words = {"covers": f"{100 * inside:.1f} ± {100 * error:.1f} %", "effective": effective}
    if off["interval"][0] > 0.0:
        words["beyond"] = f"{off['value']:.3g} {outputs.unit}"
    return {
        "held_out": part,
        "outputs": residual.size,
        "coverage": {f"{level:g}": share for level, share in shares.items()},
        "residual_rms": rms(residual),
        "predictive_sd": math.sqrt(float(variance.mean())),
        "discrepancy": off,
        "verdict": verdict,
        "says": line_of(verdict, words | {"quantity": outputs.quantity}),
    }


def _discrepancy(excess: Array, at: NDArray[np.int64]) -> dict[str, Any]:
    """Root of the mean squared residual beyond the predictive variance, with its interval."""
    mean = float(excess.mean())
    error = math.sqrt(long_run_variance(excess - mean, at)) / excess.size
    reach = float(ndtri(0.5 + LEVEL / 2.0)) * error
    low, value, high = (math.sqrt(max(x, 0.0)) for x in (mean - reach, mean, mean + reach))
    return {"value": value, "interval": [low, high], "level": LEVEL}


def _verdict(coverage: Mapping[str, float], off: Mapping[str, Any], *, least: float = 0.85) -> str:
    """Judge by the share inside 90 % intervals, which is to be 90 % within 5 (``least``)."""
    share = coverage["share"]
    if abs(share - LEVEL) <= LEVEL - least:
        return "covered"
    # too few are inside, and what is outside is too far out: then both say the same
    beyond = share < least and off["interval"][0] > 0.0
    if not beyond and abs(share - LEVEL) <= _SURE * coverage["standard_error"]:
        return "undecided"
    return "too wide" if share > LEVEL else "model discrepancy"


# -- calibration check

# Coverage of 90 % intervals below which a number is doubtful.
POOR = 0.75


def self_check_part(
    fit: Fit, summary: Summary, checked: CalibrationCheck, derived: Groups
) -> dict[str, Any]:
    """Sum up the calibration check of a fit, for ``summary["self_check"]``."""
    count = len(checked.truth)
    part: dict[str, Any] = {
        "asked": REPLICATES,
        "made": count,
        "reason": checked.reason,  # why there are no rows
        "rows": {},
        # what filters, encoder and differentiation leave of the torque, as a share of the noise's
        # variance
        "unexplained": None,
        "seconds": round(checked.seconds, 3),
        "cpu_seconds": round(checked.cpu_seconds, 3),
    }
    if checked.reason is not None:
        return part
    rows = {}
    for name, truth, missed in _replicate_errors(fit, checked, derived):
        row = summary.rows[name]
        if row.of_motion:  # no table shows it
            continue
        if row.sd > 0.0 and np.isfinite(missed).sum() >= max(2.0, 0.5 * count):
            rows[name] = _self_check_row(row, truth, missed, checked.unexplained, checked.share)
    return part | {"rows": rows, "unexplained": float(checked.unexplained.mean())}


def off_rows(summary: Summary, beyond: float = 0.0) -> dict[str, dict[str, float]]:
    """Give the rows whose truth is in too few intervals, by so many standard errors.

    Not those of what is open anyway.
    """
    rows = summary.self_check["rows"] if summary.self_check else {}
    return {
        name: row
        for name, row in rows.items()
        if summary.rows[name].verdict != "prior"
        and row["coverage"] + beyond * row["coverage_error"] < POOR
    }


def _replicate_errors(
    fit: Fit, checked: CalibrationCheck, derived: Groups
) -> Iterator[tuple[str, Array, Array]]:
    """Give each quantity's name, true values and errors ``(n,)``, one for each replicate."""
    for j, name in enumerate(fit.posterior.names):
        if not of_noise(name):
            truth = checked.truth[:, j]
            yield name, truth, (checked.near_truth[:, j] - truth) / checked.steps
    for group in derived:
        moved = group.named(checked.near_truth)
        for name, truth in group.named(checked.truth).items():
            yield name, truth, (moved[name] - truth) / checked.steps


def _self_check_row(
    row: PosteriorRow, truth: Array, missed: Array, unexplained: Array, share: float
) -> dict[str, float]:
    """Sum up one quantity; replicates may be subsamples, a ``share`` of the recording.

    The bias is in posterior sds. The coverage is the chance that an interval holds the truth that
    noiseless fits miss by ``z`` sds. The noise scale of a fit includes what filters and encoder
    leave of the torque, so less of it is noise; where they leave more, it is larger.
    """
    finite = np.isfinite(missed) & np.isfinite(truth)
    missed, unexplained = missed[finite], unexplained[finite]
    z = missed / row.sd
    bias, error = float(z.mean()), float(z.std(ddof=1) / np.sqrt(z.size))
    # the recording scatters less than its subsamples, but has the same bias
    z = bias + (z - bias) * np.sqrt(min(1.0, share + 1.0 / z.size))
    scatter = np.sqrt(np.clip(1.0 - unexplained, 1e-12, None))
    # of the interval that is printed, with model discrepancy
    width = row.reported.sd / row.sd * norm.ppf(0.5 + LEVEL / 2.0)
    half = width * np.sqrt(np.clip(unexplained, 1.0, None))
    hit = norm.cdf((half - z) / scatter) - norm.cdf((-half - z) / scatter)
    return {
        "bias": bias,
        "bias_error": error,
        "coverage": float(hit.mean()),
        "coverage_error": float(hit.std(ddof=1) / np.sqrt(z.size)),
    }


# -- friction at recorded speeds

# Of the sizes of recorded speeds: those in summary.json, and of them those that are printed.
QUANTILES, PRINTED = (0.1, 0.25, 0.5, 0.75, 0.95), (0.1, 0.5, 0.95)


def friction_part(fit: Fit, summary: Summary) -> dict[str, Any] | None:
    """Tabulate friction at recorded speeds; ``None`` where none of its parameters was sampled.

    Coefficients of friction trade against each other; their sum at a speed that was recorded is
    often known to a per cent. Speed, load and friction are of the motor, the latter two positive
    against the motion.

    A doubt in ``summary`` about a parameter of friction concerns friction.
    """
    wide, rotary = fit.wide, fit.chain.motor_motion == "rotary"
    curves = friction_curves(wide, QUANTILES)
    median = wide.target.chain_values(wide.posterior.median[None])
    columns = [fit.chain.names.index(name) for name in fit.target.free]
    without = np.repeat(median, len(columns), axis=0)
    without[np.arange(len(columns)), columns] = 0.0
    names = set()
    for curve in curves:
        every = np.concatenate([median, without])
        at = curve.speed[curve.shown], curve.load[curve.shown]
        torque = friction_torque(fit.chain, every, *at, open_scale=True)
        changed = (torque[1:] != torque[0]).any(axis=1)
        names |= {n for n, c in zip(fit.target.free, changed, strict=True) if c}
    if not names:
        return None
    sampled: Status = "doubtful" if any(summary.rows[n].doubtful for n in names) else "identified"
    unusable = summary.sampler.status == "unusable"
    rows = [
        {
            "speed": float(curve.speed[k]),
            "quantile": QUANTILES[k % len(QUANTILES)],
            "load": float(curve.load[k]),
            "value": float(curve.median[k]),
            "interval": [float(curve.ends[0, k]), float(curve.ends[2, k])],
            "status": sampled if curve.determined[k] and not unusable else "unidentified",
        }
        for curve in curves
        for k in np.flatnonzero(curve.shown)
    ]
    return {
        "unit": "N m" if rotary else "N",
        "speed_unit": "rad/s" if rotary else "m/s",
        "level": LEVEL,
        "parameters": [name for name in fit.target.free if name in names],
        "rows": rows,
    }


def friction_cells(friction: Mapping[str, Any] | None, medium: Medium) -> Iterator[tuple[str, ...]]:
    """Write speed, load, value, interval and status of the rows to print.

    Both directions share a row where the law is symmetric.
    """
    rows = [r for r in friction["rows"] if r["quantile"] in PRINTED] if friction else []
    by_place = {(row["speed"], row["load"]): row for row in rows}
    for (at, load), row in by_place.items():
        value, (low, high) = row["value"], row["interval"]
        other = by_place.get((-at, load))
        same = other is not None and np.allclose(
            [value, low, high], [other["value"], *other["interval"]], rtol=1e-9, atol=0.0
        )
        if same and at < 0.0:
            continue
        status, sd = row["status"], (high - low) / (2.0 * float(norm.ppf(0.5 + 0.5 * LEVEL)))
        place = ("±" if same else "") + medium.number(at, 3), medium.number(load, 3) if load else ""
        if status == "unidentified" or not (math.isfinite(sd) and sd > 0.0):
            yield *place, "", "", status
        else:
            yield *place, medium.ends(value, low, high, sd), medium.interval(low, high, sd), status
