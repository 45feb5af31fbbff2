"""What a load loss that may be none leaves of the factors that it alone makes: a limit, too."""

from __future__ import annotations

from typing import Any

from bayesfric.report.summary.part import Bound
from bayesfric.report.summary.record import Own
from bayesfric.report.summary.rows import PosteriorRow

# Quantities that a loss per torque makes by itself, and on which side of one they are, eq. (6).
_SIDES: dict[str, dict[str, Bound]] = {
    "load": {"alpha_drive": "upper", "alpha_back": "lower"},
    "load_drive": {"alpha_drive": "upper"},
    "load_back": {"alpha_back": "lower"},
}
# Efficiencies, which are those factors where no constant loss counts in them.
_EFFICIENCY = {"alpha_drive": "efficiency_drive", "alpha_back": "efficiency_back"}
_SAME = 1e-9


def limits_of_losses(summary: Own) -> Own:
    """Say that a torque factor is known from one side only where its loss is.

    As two-sided, ``alpha`` in [0.93, 0.98] would shut out what "at most 0.06" of the loss does not.
    """
    changes: dict[str, dict[str, Any]] = {}
    for name, row in summary.parameters.items():
        element, _, quantity = name.partition(".")
        if row.at_bound != "lower" or row.bound != 0.0:
            continue
        for alpha, side in _SIDES.get(quantity, {}).items():
            factor = summary.derived.get(f"{element}.{alpha}")
            if factor is None:
                continue
            limit = {"bound": 1.0, "bound_physical": True}
            changes[f"{element}.{alpha}"] = {"at_bound": side, **limit}
            efficiency = f"{element}.{_EFFICIENCY[alpha]}"
            if _same(summary.derived.get(efficiency), factor.middle, side):
                changes[efficiency] = {"at_bound": "upper", **limit}
    return summary.with_rows(changes) if changes else summary


def _same(efficiency: PosteriorRow | None, factor: float, side: Bound) -> bool:
    """Whether an efficiency is nothing but a torque factor, or one over it."""
    share = factor if side == "upper" else 1.0 / factor
    return efficiency is not None and abs(efficiency.middle - share) < _SAME
