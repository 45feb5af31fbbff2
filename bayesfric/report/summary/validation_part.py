"""How well a posterior predicts held-out outputs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from bayesfric.estimates.information import long_run_variance
from bayesfric.estimates.torque import places
from bayesfric.inference.fitting import Fit
from bayesfric.inference.likelihood.likelihood import Outputs
from bayesfric.inference.predictive import Prediction
from bayesfric.recordings.arrays import Array, Flags
from bayesfric.report.summary.derived_quantities import rms_of
from bayesfric.report.summary.record import Coverage
from bayesfric.report.words import line_of

LEVELS = (0.5, 0.9, 0.99)
# Coverage of the 90 % intervals that passes.
_JUDGED, _PASSES = 0.9, (0.85, 0.95)
# Standard errors from the nominal share, outside those limits, that decide.
_SURE = 2.0
# Level of the interval of the discrepancy.
_LEVEL = 0.9


def share_of(inside: Flags, at: NDArray[np.int64], fallback: Array) -> Coverage:
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
    return Coverage(share=share, standard_error=error, effective_outputs=effective)


def validation_record(fit: Fit) -> dict[str, Any]:
    """Compare predictions with held-out outputs, for ``summary.json``."""
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
            p.held_out.name: {
                "held_out": p.held_out.part,
                "from": float(p.held_out.observation.time[0]),
                "to": float(p.held_out.observation.time[-1]),
                **_numbers([p], outputs),
            }
            for p in fit.held_out
        },
        "pooled": _numbers(fit.held_out, outputs),
    }


def _numbers(predictions: Sequence[Prediction], outputs: Outputs) -> dict[str, Any]:
    observations = [p.held_out.observation for p in predictions]
    at = places(observations)
    pit = np.concatenate([p.pit for p in predictions])
    residual = np.concatenate([p.measured - p.mean for p in predictions])
    variance = np.concatenate([p.variance for p in predictions])
    standard = residual / np.sqrt(variance)
    centred = standard - standard.mean()
    out = np.abs(pit - 0.5)  # how far from the middle of what was predicted
    shares = {level: share_of(out <= level / 2.0, at, centred) for level in LEVELS}
    numbers: dict[str, Any] = {
        "outputs": residual.size,
        "coverage": {f"{level:g}": share.as_dict() for level, share in shares.items()},
        "residual_rms": rms_of(residual),
        "predictive_sd": math.sqrt(float(variance.mean())),
        "discrepancy": _discrepancy(residual**2 - variance, at),
    }
    verdict = _verdict(shares[_JUDGED], numbers["discrepancy"])
    share, off = shares[_JUDGED], numbers["discrepancy"]
    words = {"covers": share.text, "effective": share.effective_outputs}
    if off["interval"][0] > 0.0:
        words["beyond"] = f"{off['value']:.3g} {outputs.unit}"
    says = line_of(verdict, words | {"quantity": outputs.quantity})
    return numbers | {"verdict": verdict, "says": says}


def _discrepancy(excess: Array, at: NDArray[np.int64]) -> dict[str, Any]:
    """Root of the mean squared residual beyond the predictive variance, with its interval."""
    mean = float(excess.mean())
    error = math.sqrt(long_run_variance(excess - mean, at)) / excess.size
    reach = float(ndtri(0.5 + _LEVEL / 2.0)) * error
    low, value, high = (math.sqrt(max(x, 0.0)) for x in (mean - reach, mean, mean + reach))
    return {"value": value, "interval": [low, high], "level": _LEVEL}


def _verdict(share: Coverage, discrepancy: Mapping[str, Any]) -> str:
    low, high = _PASSES
    if low <= share.share <= high:
        return "covered"
    # too few are inside, and what is outside is too far out: then both say the same
    beyond = share.share < low and discrepancy["interval"][0] > 0.0
    if not beyond and abs(share.share - _JUDGED) <= _SURE * share.standard_error:
        return "undecided"
    return "too wide" if share.share > high else "model discrepancy"
