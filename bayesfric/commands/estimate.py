"""``bayesfric estimate``: the paper's three methods, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayesfric.base.progress import ProgressCallback, no_progress
from bayesfric.estimates.methods import ESTIMATORS
from bayesfric.estimates.point_estimate import METHODS
from bayesfric.fit.model import Model
from bayesfric.report.summary.summary import estimate_summary

# Robust sds over plain ones beyond which the plain one means nothing.
_TOO_SMALL = 2.0


def estimate(
    model: Model, method: str = "all", *, progress: ProgressCallback = no_progress
) -> tuple[dict[str, Any], list[str]]:
    """Estimate by a method, or ``all``; give what ``--json`` prints, and words line by line."""
    methods: Sequence[Any] = METHODS if method == "all" else [method]
    found = model.estimates(methods, progress=progress)
    references = model.references()
    record = {
        "config": str(model.config.path),
        "estimates": {one.method: estimate_summary(one) for one in found},
        "references": references,
    }
    lines = []
    for one in found:
        lines += [
            ESTIMATORS[one.method].title,
            f"  {one.n_outputs} residuals, rms {one.residual_rms:.4g} {one.residual_unit}. "
            f"{one.assumption}.",
            f"  {'':<30} {'value':>11}   {'sd':>9}   {'sd HAC':>9}   {'sd %':>6}",
            *(f"  {_row(v, references.get(v.name), one.converged)}" for v in one.values),
            *(f"  {note}" for note in one.notes),
            "",
        ]
    return record, lines


def _row(v: Any, reference: dict[str, Any] | None, converged: bool) -> str:
    beside = f"   {reference['source']}: {reference['value']:.5g}" if reference else ""
    unit = f" {v.unit}" if v.unit else ""
    if not converged:
        return f"{v.name:<30} {'-':>11}   not converged{unit}{beside}"
    if v.at_bound:
        return f"{v.name:<30} {v.value:>11.5g}   on its {v.at_bound} bound{unit}{beside}"
    if not v.determined:
        span = f"; {v.span[0]:.3g} to {v.span[1]:.3g} fit as well" if v.span else ""
        return f"{v.name:<30} {'-':>11}   not determined{span}{unit}{beside}"
    robust = f"{v.sd_robust:>9.2g}" if np.isfinite(v.sd_robust) else f"{'-':>9}"
    percent = f"{v.relative_sd:>6.1f}" if np.isfinite(v.relative_sd) else f"{'-':>6}"
    small = "   ? sd too small, see sd HAC" if v.sd_robust > _TOO_SMALL * v.sd else ""
    row = f"{v.name:<30} {v.value:>11.5g} ± {v.sd:>9.2g}   {robust}   {percent}{unit}{beside}"
    return row + small
