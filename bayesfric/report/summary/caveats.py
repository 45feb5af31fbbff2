"""What numbers rest on that no interval has room for: for whoever prints some of them."""

from __future__ import annotations

from bayesfric.report.summary.record import Summary
from bayesfric.report.text_templates import sentence


def constant_sentence(summary: Summary) -> str | None:
    """Say what every torque rests on, where it was a current and its factor is not fitted."""
    constant = summary.fit.torque_constant
    if constant is None or summary.scaled:
        return None
    return sentence("constant", {"constant": constant, "unit": summary.fit.unit})
