"""What numbers rest on that no interval has room for: for whoever prints some of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from bayesfric.mechanism.quantities import QUANTITIES
from bayesfric.report.summary.record import Summary, quantity_of
from bayesfric.report.text_templates import sentence

# Share of the load's variance by which it goes with the angle.
_BY_ANGLE = 0.98


def constant_sentence(summary: Summary) -> str | None:
    """Say what every torque rests on, where it was a current and its factor is not fitted."""
    constant = summary.fit.torque_constant
    if constant is None or summary.scaled:
        return None
    return sentence("constant", {"constant": constant, "unit": summary.fit.unit})


def load_by_angle(summary: Summary) -> Mapping[str, Any] | None:
    """Name what a loss by the position could pass for, where the load goes with it."""
    share, names = summary.fit.load_by_angle or 0.0, list(_of_load(summary))
    return {"share": share, "names": names} if share > _BY_ANGLE and names else None


def load_by_angle_sentence(summary: Summary) -> str | None:
    """Word :func:`load_by_angle`."""
    told = load_by_angle(summary)
    return None if told is None else sentence("load by angle", told)


def _of_load(summary: Summary) -> Iterator[str]:
    """Name losses by the load that the data tell, alone or with the prior."""
    for name, row in summary.joint.items():
        quantity = QUANTITIES.get(quantity_of(name))
        if quantity is None or row.verdict == "prior" or row.at_bound is not None:
            continue
        if quantity.role == "loss" or quantity.option == "load_square":
            yield name
