"""``bayesfric estimate``: the paper's three methods, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayesfric.base.progress import ProgressCallback, no_progress
from bayesfric.estimates import METHODS
from bayesfric.estimates.methods import TITLES
from bayesfric.fit.model import Model
from bayesfric.report.summary.summary import estimate_table

# Ratio of robust to plain standard deviation from which the plain one is marked.
_TOO_SMALL = 2.0


def estimate(
    model: Model, method: str = "all", *, progress: ProgressCallback = no_progress
) -> tuple[dict[str, Any], list[str]]:
    """Estimate by a method, or ``all``; return the record and lines of text."""
    methods: Sequence[Any] = METHODS if method == "all" else [method]
    estimates = model.estimates(methods, progress=progress)
    references = model.references
    record = {
        "config": str(model.config.path),
        "estimates": {
            estimate.method: estimate_table(estimate).as_dict() for estimate in estimates
        },
        "references": references,
    }
    lines = []
    for estimate in estimates:
        lines += [
            TITLES[estimate.method],
            f"  {estimate.n_outputs} residuals, rms {estimate.residual_rms:.4g} "
            f"{estimate.residual_unit}. {estimate.assumption}.",
            f"  {'':<30} {'value':>11}   {'sd':>9}   {'sd HAC':>9}   {'sd %':>6}",
            *(f"  {_row(v, references.get(v.name), estimate.converged)}" for v in estimate.values),
            *(f"  {note}" for note in estimate.notes),
            "",
        ]
    return record, lines


def _row(v: Any, reference: dict[str, Any] | None, converged: bool) -> str:
    reference_text = f"   {reference['source']}: {reference['value']:.5g}" if reference else ""
    unit = f" {v.unit}" if v.unit else ""
    if not converged:
        return f"{v.name:<30} {'-':>11}   not converged{unit}{reference_text}"
    if v.at_bound:
        return f"{v.name:<30} {v.value:>11.5g}   on its {v.at_bound} bound{unit}{reference_text}"
    if not v.determined:
        span = f"; {v.span[0]:.3g} to {v.span[1]:.3g} fit as well" if v.span else ""
        return f"{v.name:<30} {'-':>11}   not determined{span}{unit}{reference_text}"
    robust = f"{v.sd_robust:>9.2g}" if np.isfinite(v.sd_robust) else f"{'-':>9}"
    percent = f"{v.relative_sd:>6.1f}" if np.isfinite(v.relative_sd) else f"{'-':>6}"
    small = "   ? sd too small, see sd HAC" if v.sd_robust > _TOO_SMALL * v.sd else ""
    row = (
        f"{v.name:<30} {v.value:>11.5g} ± {v.sd:>9.2g}   {robust}   {percent}{unit}{reference_text}"
    )
    return row + small
